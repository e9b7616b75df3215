"""The commands that show what came out: plot, report, compare, paper."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .app import Json, named, print_json, say


def plot(folder: Annotated[Path, typer.Argument(help="Folder of results.")], as_json: Json = False) -> None:
    """Draw the figures of a folder of results anew."""
    from ..evaluation.drawing import draw

    paths = draw(folder)
    if as_json:
        print_json({"figures": [str(path) for path in paths]})
        return
    for path in paths:
        say(path)


def report(
    folders: Annotated[
        list[Path],
        typer.Argument(metavar="DIR", help="Folder of results; of several, of one study, in this order."),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            parser=named,
            metavar="PATH",
            help="The page; DIR/report.html unless given, or comparison.html for several folders.",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Write one self-contained page about a folder of results, or about several of the same study."""
    from ..evaluation import write_comparison, write_report

    path = write_report(folders[0], out) if len(folders) == 1 else write_comparison(folders, out)
    if as_json:
        print_json({"report": str(path)})
    else:
        say(path)


def compare(
    a: Annotated[Path, typer.Argument(metavar="A", help="Folder of results.")],
    b: Annotated[
        Path | None, typer.Argument(metavar="B", help="Another one; without it, the estimators of A.")
    ] = None,
    as_json: Json = False,
) -> None:
    """What differs between two results, or between the estimators of one, and what of it may be chance."""
    from ..evaluation import load
    from ..evaluation.comparison.compare import compare as compared

    if b is None:
        _compare_estimators(a, as_json)
        return
    comparison = compared(load(a), load(b))
    if as_json:
        print_json({"a": str(a), "b": str(b)} | comparison.to_json())
        return
    from .tables import console, differences, preamble

    screen = console()
    for line in preamble(comparison, str(a), str(b)):
        screen.say(line)
    screen.print(differences(comparison))


def _compare_estimators(folder: Path, as_json: bool) -> None:
    from ..evaluation import compare_estimators, load

    pairs = compare_estimators(load(folder))
    if as_json:
        print_json({"folder": str(folder), "pairs": [vars(pair) | {"words": pair.words} for pair in pairs]})
        return
    from .tables import accuracy, console

    screen = console()
    screen.print(accuracy(pairs))


def paper(
    out: Annotated[
        Path | None,
        typer.Option(parser=named, metavar="PATH", help="Folder for the table, the posteriors and figures."),
    ] = None,
    as_json: Json = False,
    draws: Annotated[int, typer.Option(min=20, help="Noise draws for the bands.")] = 1000,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the noise draws.")] = 0,
) -> None:
    """The table and figures of the paper of Stepanov and Mansour."""
    from ..evaluation.paper import save, solve

    solved = solve(draws, seed)
    if out is not None:
        from ..evaluation.drawing import draw

        save(solved, out)
        draw(out)
    if as_json:
        print_json(solved.to_json())
        return
    from .tables import console, table1, table1_notes

    screen = console()
    screen.print(table1(solved))
    for note in table1_notes(solved):
        screen.say(note)
    if out is not None:
        screen.say(f"Figures: {out / 'figures'}")
