"""The command line. Heavy modules are imported by the commands that need them, so that help is quick."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer

from . import __version__
from .arguments import explain, gather_bearings

FINE, SOME_FAILED, BAD_INPUT, NOTHING_RAN, GATE_FAILED = range(5)
INTERRUPTED = 130

app = typer.Typer(
    name="rangefix",
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")]


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


def _print_json(document: Any) -> None:
    """One JSON document on standard output; numbers that are not finite become null."""

    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            return {str(key): plain(each) for key, each in value.items()}
        if isinstance(value, list | tuple):
            return [plain(each) for each in value]
        return None if isinstance(value, float) and not math.isfinite(value) else value

    typer.echo(json.dumps(plain(document), indent=2, allow_nan=False))


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
        _print_json(solved.to_json())
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
    map_path: Annotated[
        Path | None, typer.Option("--map", metavar="FILE", help="Map file, instead of the study's.")
    ] = None,
    gate: Annotated[
        list[str] | None,
        typer.Option(metavar="ESTIMATOR", help="Exit with 4 if this one is overconfident; may be repeated."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Compare estimators by Monte Carlo: what they claim against what is true."""
    from .evaluation.results import summarise
    from .evaluation.runner import run as run_study
    from .evaluation.study import load_study
    from .evaluation.verdict import overconfident, verdict
    from .progress import bars

    described = load_study(study, runs=runs, seed=seed, map_path=map_path)
    folder = Path("results") / described.name if out is None else out
    try:
        with bars() as progress:
            results = run_study(
                described,
                folder,
                workers=workers,
                progress=progress,
                command_line=["rangefix", *sys.argv[1:]],
            )
    except KeyboardInterrupt:
        print(f"rangefix: stopped; what was finished is in {folder}: run again to go on", file=sys.stderr)
        raise typer.Exit(INTERRUPTED) from None
    if unknown := set(gate or ()) - set(results.estimators):
        raise ValueError(
            f"--gate names {', '.join(sorted(unknown))}; there are {', '.join(results.estimators)}"
        )
    rows = summarise(results)
    if as_json:
        _print_json(
            {
                "study": described.name,
                "runs": len(results.truth),
                "seed": results.manifest.get("seed"),
                "folder": str(folder),
                "rows": [row.flat() | {"verdict": verdict(row)} for row in rows],
            }
        )
    else:
        from .tables import comparison, console

        screen = console()
        screen.print(comparison(rows, f"{described.title or described.name}: {len(results.truth)} runs"))
        screen.print(f"Results: {folder}   Figures: rangefix plot {folder}")
    if not any(row.ok for row in rows):
        raise typer.Exit(NOTHING_RAN)
    if any(overconfident(row) for row in rows if row.estimator in (gate or ())):
        raise typer.Exit(GATE_FAILED)
    if any(row.ok < row.planned for row in rows):
        raise typer.Exit(SOME_FAILED)


@app.command()
def plot(folder: Annotated[Path, typer.Argument(help="Folder of results.")], as_json: Json = False) -> None:
    """Draw the figures of a folder of results anew."""
    from .evaluation.plots import draw

    paths = draw(folder)
    if as_json:
        _print_json({"figures": [str(path) for path in paths]})
        return
    for path in paths:
        typer.echo(path)


@app.command()
def estimators(as_json: Json = False) -> None:
    """The estimators that there are, with their options."""
    from .listing import describe

    described = describe()
    if as_json:
        _print_json({"estimators": described})
        return
    for each in described:
        listed = ", ".join(f"{name}={value}" for name, value in each["options"].items())
        typer.echo(f"{each['name']:<12} {each['summary']}\n{'':<12} options: {listed or 'none'}")


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
        _print_json({"map": map_name, "at_m": list(at), "heading_deg": heading_deg, "beams": rows})
        return
    typer.echo("bearing, deg   range, m")
    for row in rows:
        typer.echo(f"{row['bearing_deg']:>12.2f}   {row['range_m']:>8.4f}")
