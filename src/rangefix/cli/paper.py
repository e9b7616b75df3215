"""The command `paper`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .app import Json, named, print_json


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
        screen.print(note)
    if out is not None:
        screen.print(f"Figures: {out / 'figures'}")
