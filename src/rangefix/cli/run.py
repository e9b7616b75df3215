"""The commands `new` and `run`."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Annotated

import typer

from .app import ExitCode, Json, Stopped, named, print_json

EXAMPLES = Path(__file__).parents[1] / "evaluation/study/examples"  # listed without what a study loads
OURS = ", ".join(sorted(file.stem for file in EXAMPLES.glob("*.toml")))


def new(
    study: Annotated[Path, typer.Argument(metavar="STUDY", help="The file to write.")], as_json: Json = False
) -> None:
    """Write a commented study to begin with."""
    path = study if study.suffix == ".toml" else study.with_name(f"{study.name}.toml")
    text = (EXAMPLES.parent / "starter.toml").read_text(encoding="utf-8")
    name = re.sub(r'["\\\x00-\x1f]', "_", path.stem)
    text = text.replace("STUDY.toml", path.name.replace("\n", "_")).replace("NAME", name)
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
        typer.echo(f"{path}   Run it: rangefix run {path}")


def run(
    study: Annotated[str, typer.Argument(help=f"A study file, or one of ours: {OURS}.")],
    runs: Annotated[int | None, typer.Option(help="Monte Carlo runs, instead of the study's.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed, instead of the study's.")] = None,
    out: Annotated[
        Path | None,
        typer.Option(parser=named, metavar="PATH", help="Folder of results; results/STUDY unless given."),
    ] = None,
    workers: Annotated[int, typer.Option(min=1, help="Processes; they change no number.")] = 1,
    cluster: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Dask scheduler, such as tcp://HOST:8786, instead.")
    ] = None,
    resume: Annotated[bool, typer.Option(help="Take parts that are there and whole.")] = True,
    map_path: Annotated[
        str | None,
        typer.Option("--map", metavar="MAP", help="A map file or room:4x6 (m), instead of the study's map."),
    ] = None,
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
    as_json: Json = False,
) -> None:
    """Compare estimators by Monte Carlo: what they claim against what is true."""
    from ..evaluation import check_gates, decide, load_study, parse_gates, summarise
    from ..evaluation import run as run_study
    from ..evaluation.consistency.gates import need_sound
    from .progress import bars

    gates = parse_gates(gate or ())
    described = load_study(study, runs=runs, seed=seed, map_path=map_path)
    experiment = described.experiment()
    need_sound(gates, tuple(experiment.estimators), experiment.assumed_problem.space.names, described.beliefs)
    for warning in described.warnings:
        print(f"rangefix: {warning}", file=sys.stderr)
    folder = Path("results") / described.name if out is None else out
    try:
        with bars() as progress:
            results = run_study(
                described,
                folder,
                workers=workers,
                cluster=cluster,
                progress=progress,
                command_line=["rangefix", *sys.argv[1:]],
                resume=resume,
                force=force,
                say=lambda line: print(f"rangefix: {line}", file=sys.stderr),
            )
    except KeyboardInterrupt:
        raise Stopped(f"stopped; what was finished is in {folder}: run again to go on") from None
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
        from .tables import beliefs, comparison, console, failures, improbable, unresolved

        screen = console()
        screen.print(
            comparison(rows, f"{described.title or described.name}: {results.runs} runs", screen.width)
        )
        if (sampled := beliefs(rows)) is not None:
            screen.print(sampled)
        for text in (*improbable(rows), *unresolved(rows), *failures(results)):
            screen.print(text, markup=False, soft_wrap=True)
        for line in lines:
            screen.print(line.text, markup=False, soft_wrap=True)
        screen.print(f"Results: {folder}   Figures: rangefix plot {folder}")
    if not any(row.ok for row in rows):
        raise typer.Exit(ExitCode.NOTHING_RAN)
    if not all(line.passed for line in lines):
        raise typer.Exit(ExitCode.GATE_FAILED)
    if any(row.ok < row.planned for row in rows):
        raise typer.Exit(ExitCode.SOME_FAILED)
