"""The command `run`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import counted
from .app import ExitCode, Json, Stopped, as_typed, named, names_from, out_folder, print_json, warn
from .map_options import Unit, Up
from .studies import Map, NoPlugins, Runs, Seed, StudyFile, read_study, tell_odd_study

if TYPE_CHECKING:
    from ..evaluation import ClusterTls, Results, Row, Study
    from ..evaluation.consistency.gates import GateLine

WHERE_PANEL = "Where it runs"
KEPT_PANEL = "What is kept"


def figures() -> list[str]:
    """Names of figures that gates may ask for, of a pose."""
    from ..evaluation.consistency.gates import figures as all_figures

    names = all_figures(("x1", "x2", "heading"), beliefs=True, bounds=True)
    return [f"{name}=" for name in names if not name.endswith(("_low", "_high"))]


def run(
    study: StudyFile,
    runs: Runs = None,
    seed: Seed = None,
    out: Annotated[
        Path | None, out_folder("Folder of results; results/STUDY unless given.", KEPT_PANEL)
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers",
            "-w",
            min=1,
            metavar="N",
            help="Processes; they change no number. Unless given, as many as pay where built-in estimators "
            "take more than some 20 s.",
            rich_help_panel=WHERE_PANEL,
        ),
    ] = None,
    cluster: Annotated[
        str | None,
        typer.Option(
            rich_help_panel=WHERE_PANEL,
            metavar="ADDRESS",
            help="Workers of a dask scheduler, such as tcp://HOST:8786, instead. Dask asks nobody who it is: "
            "whoever reaches the scheduler can run code on its workers and in this process. Over a network "
            "that is not yours alone take tls://HOST:8786.",
        ),
    ] = None,
    cluster_tls_ca: Annotated[
        Path | None,
        typer.Option(
            parser=named,
            metavar="FILE",
            help="PEM: who signed the certificates of the cluster.",
            rich_help_panel=WHERE_PANEL,
        ),
    ] = None,
    cluster_tls_cert: Annotated[
        Path | None,
        typer.Option(
            parser=named, metavar="FILE", help="PEM: your certificate.", rich_help_panel=WHERE_PANEL
        ),
    ] = None,
    cluster_tls_key: Annotated[
        Path | None,
        typer.Option(
            parser=named,
            metavar="FILE",
            help="PEM: its key, if not in the same file.",
            rich_help_panel=WHERE_PANEL,
        ),
    ] = None,
    resume: Annotated[
        bool, typer.Option(help="Take parts that are there and whole.", rich_help_panel=KEPT_PANEL)
    ] = True,
    map_path: Map = None,
    unit: Unit = None,
    up: Up = None,
    no_plugins: NoPlugins = False,
    gate: Annotated[
        list[str] | None,
        typer.Option(
            "--gate",
            "-g",
            metavar="GATE",
            autocompletion=names_from(figures),
            help="Exit with 4 unless this holds: ESTIMATOR (not overconfident), FIGURE=LOW:HIGH or "
            "ESTIMATOR:FIGURE=LOW:HIGH, such as anees=0.8:1.25; may be repeated.",
        ),
    ] = None,
    bounds: Annotated[
        bool,
        typer.Option(
            "--bounds",
            help="Work out how good anybody could be, too, and show how near each estimator comes: see "
            "`rangefix bounds`. It may take minutes.",
        ),
    ] = False,
    force: Annotated[
        bool,
        typer.Option(
            "--force", help="Remove the results of another study from the folder.", rich_help_panel=KEPT_PANEL
        ),
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
            rich_help_panel=WHERE_PANEL,
            help="Memory that the arrays may take; half of the machine's unless given. Beyond it the study "
            "is refused before it begins; it changes no number.",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Compare estimators by Monte Carlo: what they claim against what is true."""
    from ..evaluation import check_gates, parse_gates, summarise
    from ..evaluation import run as run_study
    from ..evaluation.consistency.gates import need_sound

    gates = parse_gates(gate or ())
    tls = _tls(cluster, cluster_tls_ca, cluster_tls_cert, cluster_tls_key)
    if cluster is not None and workers is not None:
        raise ValueError("--workers has no effect with --cluster: its workers are those of the cluster")
    if memory_gb is not None and not memory_gb > 0:
        raise ValueError(f"--memory-gb must be above 0, got {memory_gb:g}")
    described = read_study(study, runs, seed, map_path, not no_plugins, unit=unit, up=up)
    experiment = described.experiment()
    tell_odd_study(described, experiment)
    names = experiment.assumed_problem.space.names
    need_sound(gates, tuple(experiment.estimators), names, bool(described.beliefs), bounds)
    folder = Path("results") / described.name if out is None else out
    if only_run is not None:
        from .one_run import show_run

        others = workers, cluster, memory_gb, *(gates or ())
        if any(other is not None for other in others) or force or bounds or not resume:
            raise ValueError(
                "--only-run goes with --runs, --seed, --out, --map, --unit, --up, --no-plugins, --json alone"
            )
        answered = show_run(described, only_run, folder, as_json)
        raise typer.Exit(ExitCode.FINE if answered else ExitCode.SOME_FAILED)
    try:
        results = run_study(
            described,
            folder,
            workers=workers,
            cluster=cluster,
            cluster_tls=tls,
            plugins=not no_plugins,
            progress=True,
            command_line=_words(study, out, map_path, unit, up, no_plugins),
            resume=resume,
            force=force,
            bounds=bounds,
            memory_gb=memory_gb,
            say=warn,
        )
    except KeyboardInterrupt:
        begun = f"stopped; what was finished is in {folder}: run again to go on"
        raise Stopped(begun if folder.exists() else "stopped") from None
    rows = summarise(results)
    lines = check_gates(gates, rows)
    if as_json:
        print_json(_document(described, results, rows, lines, folder))
    else:
        _show(described, results, rows, lines, folder)
    if not any(row.ok for row in rows):
        raise typer.Exit(ExitCode.NOTHING_RAN)
    if not all(line.passed for line in lines):
        raise typer.Exit(ExitCode.GATE_FAILED)
    if any(row.ok < row.made for row in rows):
        raise typer.Exit(ExitCode.SOME_FAILED)


def _document(
    study: Study, results: Results, rows: Sequence[Row], lines: Sequence[GateLine], folder: Path
) -> dict[str, Any]:
    """What came out, for programs."""
    from ..evaluation import decide

    return {
        "study": study.name,
        "runs": results.runs,
        "seed": results.manifest.get("seed"),
        "folder": str(folder),
        "rows": [row.flat() | {"verdict": decide(row).words} for row in rows],
        "gates": [{"gate": line.gate.text, "passed": line.passed, "text": line.text} for line in lines],
    }


def _show(
    study: Study, results: Results, rows: Sequence[Row], lines: Sequence[GateLine], folder: Path
) -> None:
    """The same for people."""
    from .screen import console
    from .tables.remarks import failures, remarks
    from .tables.study import beliefs, comparison, verdicts

    screen = console()
    for table in comparison(
        rows, f"{study.title or study.name}: {counted(results.runs, 'run')}", screen.width
    ):
        screen.print(table)
    if (sampled := beliefs(rows)) is not None:
        screen.print(sampled)
    told = remarks(rows, results.manifest.get("estimators"))
    for text in (*verdicts(rows), *told, *failures(results), *(line.text for line in lines)):
        screen.say(text)
    screen.say(f"Results: {folder}   Figures: {as_typed('rangefix', 'plot', folder)}")


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


def _words(
    study: str, out: Path | None, map_path: str | None, unit: str | None, up: str | None, no_plugins: bool
) -> list[str]:
    """The words of a command that runs the same world into the same folder."""
    given = {"--map": map_path, "--unit": unit, "--up": up, "--out": None if out is None else str(out)}
    options = [word for name, value in given.items() if value is not None for word in (name, value)]
    return ["rangefix", "run", study, *options, *["--no-plugins"] * no_plugins]
