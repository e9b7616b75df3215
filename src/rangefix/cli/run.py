"""The command `run`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from .app import ExitCode, Json, print_json

EXAMPLES = (
    Path(__file__).parents[1] / "evaluation" / "study" / "examples"
)  # listed without what a study loads
OURS = ", ".join(sorted(file.stem for file in EXAMPLES.glob("*.toml")))


def run(
    study: Annotated[str, typer.Argument(help=f"A study file, or one of ours: {OURS}.")],
    runs: Annotated[int | None, typer.Option(help="Monte Carlo runs, instead of the study's.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed, instead of the study's.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder of results; results/STUDY unless given.")] = None,
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
    as_json: Json = False,
) -> None:
    """Compare estimators by Monte Carlo: what they claim against what is true."""
    from ..evaluation import check_gates, load_study, parse_gates, summarise
    from ..evaluation import run as run_study
    from ..evaluation.consistency import need_sound
    from ..evaluation.consistency.verdict import verdict_text
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
            )
    except KeyboardInterrupt:
        print(f"rangefix: stopped; what was finished is in {folder}: run again to go on", file=sys.stderr)
        raise typer.Exit(ExitCode.INTERRUPTED) from None
    rows = summarise(results)
    lines = check_gates(gates, rows)
    if as_json:
        print_json(
            {
                "study": described.name,
                "runs": results.runs,
                "seed": results.manifest.get("seed"),
                "folder": str(folder),
                "rows": [row.flat() | {"verdict": verdict_text(row)} for row in rows],
                "gates": [
                    {"gate": line.gate.text, "passed": line.passed, "text": line.text} for line in lines
                ],
            }
        )
    else:
        from .tables import beliefs, comparison, console, failures, improbable

        screen = console()
        screen.print(
            comparison(rows, f"{described.title or described.name}: {results.runs} runs", screen.width)
        )
        if (sampled := beliefs(rows)) is not None:
            screen.print(sampled)
        for text in (*improbable(rows), *failures(results)):
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
