"""The commands `new`, `validate` and `run`."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .app import ExitCode, Json, Stopped, named, print_json, say, warn

if TYPE_CHECKING:
    from ..evaluation import ClusterTls

EXAMPLES = Path(__file__).parents[1] / "evaluation/study/examples"  # listed without what a study loads
OURS = ", ".join(sorted(file.stem for file in EXAMPLES.glob("*.toml")))
StudyFile = Annotated[str, typer.Argument(metavar="STUDY", help=f"A study file, or one of ours: {OURS}.")]
Runs = Annotated[int | None, typer.Option(help="Monte Carlo runs, instead of the study's.")]
Seed = Annotated[int | None, typer.Option(help="Seed, instead of the study's.")]
Map = Annotated[
    str | None,
    typer.Option("--map", metavar="MAP", help="A map file or room:4x6 (m), instead of the study's map."),
]
NoPlugins = Annotated[
    bool,
    typer.Option("--no-plugins", help="Refuse a study that names estimators which are not built in."),
]


def new(
    study: Annotated[Path, typer.Argument(metavar="STUDY", help="The file to write.")], as_json: Json = False
) -> None:
    """Write a commented study to begin with."""
    path = study if study.suffix == ".toml" else study.with_name(f"{study.name}.toml")
    text = (EXAMPLES.parent / "starter.toml").read_text(encoding="utf-8")
    name = re.sub(r'["\\\x00-\x1f]', "_", path.stem)
    schema = (EXAMPLES.parent / "study.schema.json").as_uri()  # editors complete and check a study by it
    text = (
        text.replace("STUDY.toml", path.name.replace("\n", "_"))
        .replace("NAME", name)
        .replace("SCHEMA", schema)
    )
    made = False
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("x", encoding="utf-8") as file:
            made = True
            file.write(text)
    except FileExistsError:
        raise ValueError(f"{path} is there already: choose another name, or remove it") from None
    except OSError as error:
        if made:
            path.unlink(missing_ok=True)
        raise ValueError(f"cannot write {path}: {error.strerror or error}") from None
    if as_json:
        print_json({"study": str(path)})
    else:
        say(f"{path}   Run it: rangefix run {path}")


def validate(
    study: StudyFile,
    runs: Runs = None,
    seed: Seed = None,
    map_path: Map = None,
    no_plugins: NoPlugins = False,
    as_json: Json = False,
) -> None:
    """Check a study, but for the code of plug-ins, and say what would run; nothing is run or written."""
    from ..evaluation import load_study
    from ..evaluation.study.outline import outline

    told = outline(load_study(study, runs=runs, seed=seed, map_path=map_path, plugins=not no_plugins))
    if as_json:
        print_json(told.as_json())
        return
    for line in told.lines():
        say(line)


def run(
    study: StudyFile,
    runs: Runs = None,
    seed: Seed = None,
    out: Annotated[
        Path | None,
        typer.Option(parser=named, metavar="PATH", help="Folder of results; results/STUDY unless given."),
    ] = None,
    workers: Annotated[int, typer.Option(min=1, help="Processes; they change no number.")] = 1,
    cluster: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Workers of a dask scheduler, such as tcp://HOST:8786, instead. Dask asks nobody who it is: "
            "whoever reaches the scheduler can run code on its workers and in this process. Over a network "
            "that is not yours alone take tls://HOST:8786.",
        ),
    ] = None,
    cluster_tls_ca: Annotated[
        Path | None,
        typer.Option(parser=named, metavar="FILE", help="PEM: who signed the certificates of the cluster."),
    ] = None,
    cluster_tls_cert: Annotated[
        Path | None, typer.Option(parser=named, metavar="FILE", help="PEM: your certificate.")
    ] = None,
    cluster_tls_key: Annotated[
        Path | None,
        typer.Option(parser=named, metavar="FILE", help="PEM: its key, if not in the same file."),
    ] = None,
    resume: Annotated[bool, typer.Option(help="Take parts that are there and whole.")] = True,
    map_path: Map = None,
    no_plugins: NoPlugins = False,
    gate: Annotated[
        list[str] | None,
        typer.Option(
            metavar="GATE",
            help="Exit with 4 unless this holds: ESTIMATOR (not overconfident), FIGURE=LOW:HIGH or "
            "ESTIMATOR:FIGURE=LOW:HIGH, such as anees=0.8:1.25; may be repeated.",
        ),
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Remove the results of another study from the folder.")
    ] = False,
    only_run: Annotated[
        int | None,
        typer.Option(metavar="NUMBER", help="Repeat this run of the study alone, and draw what is believed."),
    ] = None,
    memory_gb: Annotated[
        float | None,
        typer.Option(
            "--memory-gb",
            metavar="GB",
            help="Memory that the arrays may take; half of the machine's unless given. Beyond it the study "
            "is refused before it begins; it changes no number.",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Compare estimators by Monte Carlo: what they claim against what is true."""
    from ..evaluation import check_gates, decide, load_study, parse_gates, summarise
    from ..evaluation import run as run_study
    from ..evaluation.consistency.gates import need_sound
    from .progress import bars

    gates = parse_gates(gate or ())
    tls = _tls(cluster, cluster_tls_ca, cluster_tls_cert, cluster_tls_key)
    described = load_study(study, runs=runs, seed=seed, map_path=map_path, plugins=not no_plugins)
    experiment = described.experiment()
    names = experiment.assumed_problem.space.names
    need_sound(gates, tuple(experiment.estimators), names, bool(described.beliefs))
    folder = Path("results") / described.name if out is None else out
    if only_run is not None:
        from .one_run import show_run

        if workers > 1 or cluster is not None or gates or force or not resume:
            raise ValueError("--only-run goes with --runs, --seed, --out, --map, --no-plugins, --json alone")
        answered = show_run(described, only_run, folder, as_json)
        raise typer.Exit(ExitCode.FINE if answered else ExitCode.SOME_FAILED)
    try:
        with bars() as progress:
            results = run_study(
                described,
                folder,
                workers=workers,
                cluster=cluster,
                cluster_tls=tls,
                plugins=not no_plugins,
                progress=progress,
                command_line=["rangefix", *sys.argv[1:]],
                resume=resume,
                force=force,
                memory_gb=memory_gb,
                say=warn,
            )
    except KeyboardInterrupt:
        begun = f"stopped; what was finished is in {folder}: run again to go on"
        raise Stopped(begun if folder.exists() else "stopped") from None
    rows = summarise(results)
    lines = check_gates(gates, rows)
    if as_json:
        print_json(
            {
                "study": described.name,
                "runs": results.runs,
                "seed": results.manifest.get("seed"),
                "folder": str(folder),
                "rows": [row.flat() | {"verdict": decide(row).words} for row in rows],
                "gates": [
                    {"gate": line.gate.text, "passed": line.passed, "text": line.text} for line in lines
                ],
            }
        )
    else:
        from .tables import beliefs, collapsed, comparison, console, failures, improbable, inaccurate

        screen = console()
        screen.print(
            comparison(rows, f"{described.title or described.name}: {results.runs} runs", screen.width)
        )
        if (sampled := beliefs(rows)) is not None:
            screen.print(sampled)
        for text in (*collapsed(rows), *inaccurate(rows), *improbable(rows), *failures(results)):
            screen.say(text)
        for line in lines:
            screen.say(line.text)
        screen.say(f"Results: {folder}   Figures: rangefix plot {folder}")
    if not any(row.ok for row in rows):
        raise typer.Exit(ExitCode.NOTHING_RAN)
    if not all(line.passed for line in lines):
        raise typer.Exit(ExitCode.GATE_FAILED)
    if any(row.ok < row.planned for row in rows):
        raise typer.Exit(ExitCode.SOME_FAILED)


def _tls(
    cluster: str | None, ca: Path | None, certificate: Path | None, key: Path | None
) -> ClusterTls | None:
    """The certificates for a cluster, if any are given.

    Raises:
        ValueError: If there is no cluster, or one of them is missing.
    """
    from ..evaluation import ClusterTls

    if not (ca or certificate or key):
        return None
    if cluster is None:
        raise ValueError("--cluster-tls-ca, -cert and -key are for --cluster tls://HOST:PORT")
    if not (ca and certificate):
        raise ValueError(
            "give both --cluster-tls-ca and --cluster-tls-cert, or neither: dask has settings, too"
        )
    return ClusterTls(ca, certificate, key)
