"""The command line. Heavy modules are imported by the commands that need them, so that help is quick."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from . import __version__
from . import commands as commands  # which register themselves
from .application import (
    BAD_INPUT,
    FINE,
    GATE_FAILED,
    INTERRUPTED,
    NOTHING_RAN,
    SOME_FAILED,
    Json,
    app,
    print_json,
)
from .arguments import explain, gather_bearings


def main(arguments: list[str] | None = None) -> NoReturn:
    """Run a command and end the process with its exit code; mistakes of the user are one line each."""
    arguments = sys.argv[1:] if arguments is None else arguments
    try:
        code = app(gather_bearings(arguments), prog_name="rangefix", standalone_mode=False)
    except typer.Abort:
        code = INTERRUPTED
    except Exception as error:
        mistakes = explain(error)
        if mistakes is None:
            raise
        for line in mistakes:
            print(f"rangefix: {line}", file=sys.stderr)
        code = BAD_INPUT
    sys.exit(code if isinstance(code, int) else FINE)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"rangefix {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """How far an indoor position estimate can be trusted."""


@app.command()
def paper(
    out: Annotated[
        Path | None, typer.Option(help="Folder for the table, the posteriors and figures.")
    ] = None,
    as_json: Json = False,
    draws: Annotated[int, typer.Option(min=20, help="Noise draws for the bands.")] = 1000,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the noise draws.")] = 0,
) -> None:
    """The table and figures of the paper of Stepanov and Mansour."""
    from .evaluation.paper import save, solve

    solved = solve(draws, seed)
    if out is not None:
        from .evaluation.plots import draw

        save(solved, out)
        draw(out)
    if as_json:
        print_json(solved.to_json())
        return
    from .tables import console, table1, table1_notes

    screen = console()
    screen.print(table1(solved))
    for note in table1_notes(solved):
        screen.print(note)
    if out is not None:
        screen.print(f"Figures: {out / 'figures'}")


@app.command()
def run(
    study: Annotated[
        str, typer.Argument(help="A study file, or the name of one of ours: paper, point, mesh.")
    ],
    runs: Annotated[int | None, typer.Option(help="Monte Carlo runs, instead of the study's.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed, instead of the study's.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder of results; results/STUDY unless given.")] = None,
    workers: Annotated[int, typer.Option(min=1, help="Processes; they change no number.")] = 1,
    cluster: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Dask scheduler, such as tcp://HOST:8786, instead.")
    ] = None,
    resume: Annotated[bool, typer.Option(help="Take parts that are there and whole.")] = True,
    map_path: Annotated[
        Path | None, typer.Option("--map", metavar="FILE", help="Map file, instead of the study's.")
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
    from .evaluation.results import summarise
    from .evaluation.runner import run as run_study
    from .evaluation.study import load_study
    from .evaluation.verdict import verdict
    from .evaluation.verdict_gates import check_gates, need_sound, parse_gates
    from .progress import bars

    gates = parse_gates(gate or ())
    described = load_study(study, runs=runs, seed=seed, map_path=map_path)
    experiment = described.experiment()
    need_sound(gates, tuple(experiment.estimators), experiment.told.space.names, described.beliefs)
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
        raise typer.Exit(INTERRUPTED) from None
    rows = summarise(results)
    lines = check_gates(gates, rows)
    if as_json:
        print_json(
            {
                "study": described.name,
                "runs": results.runs,
                "seed": results.manifest.get("seed"),
                "folder": str(folder),
                "rows": [row.flat() | {"verdict": verdict(row)} for row in rows],
                "gates": [
                    {"gate": line.gate.text, "passed": line.passed, "text": line.text} for line in lines
                ],
            }
        )
    else:
        from .listing import failures
        from .tables import beliefs, comparison, console

        screen = console()
        screen.print(
            comparison(rows, f"{described.title or described.name}: {results.runs} runs", screen.width)
        )
        if (sampled := beliefs(rows)) is not None:
            screen.print(sampled)
        for text in failures(results):
            screen.print(text, markup=False, soft_wrap=True)
        for line in lines:
            screen.print(line.text, markup=False, soft_wrap=True)
        screen.print(f"Results: {folder}   Figures: rangefix plot {folder}")
    if not any(row.ok for row in rows):
        raise typer.Exit(NOTHING_RAN)
    if not all(line.passed for line in lines):
        raise typer.Exit(GATE_FAILED)
    if any(row.ok < row.planned for row in rows):
        raise typer.Exit(SOME_FAILED)


@app.command()
def ranges(
    map_name: Annotated[
        str, typer.Argument(metavar="MAP", help="A map file, or a room such as room:4x6 (m).")
    ],
    at: Annotated[tuple[float, float], typer.Option("--at", metavar="X1 X2", help="Position, m.")],
    bearings_deg: Annotated[
        str, typer.Option(metavar="B1 B2 ...", help="Beam directions, deg clockwise from the heading.")
    ],
    heading_deg: Annotated[float, typer.Option(help="Heading, deg clockwise from +x2.")] = 0.0,
    sensor_height: Annotated[float | None, typer.Option(help="Height of the beams in a mesh, m.")] = None,
    as_json: Json = False,
) -> None:
    """What a rangefinder would measure there, without noise."""
    from .listing import cast

    rows = cast(map_name, at, heading_deg, bearings_deg, sensor_height)
    if as_json:
        print_json({"map": map_name, "at_m": list(at), "heading_deg": heading_deg, "beams": rows})
        return
    typer.echo("bearing, deg   range, m")
    for row in rows:
        typer.echo(f"{row['bearing_deg']:>12.2f}   {row['range_m']:>8.4f}")
