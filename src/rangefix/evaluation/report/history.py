"""How the figures of estimators went from folder to folder: drawn, and as tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from ..consistency.formatting import beams_in_words, format_interval, unit
from ..consistency.row import Row
from .embedding import ShownFigure
from .folders import Folder
from .tables import Cell, Line, Spot, Table

MAX_SETS_DRAWN = 6  # sets of beams whose history is drawn; tables have the others
Rows = Mapping[str, Sequence[Row | None]]  # estimator -> its row in each folder
Place = tuple[str, int, int]  # estimator, number of the panel, number of the folder


class History(NamedTuple):
    """How the figures of a set of beams went from folder to folder.

    Attributes:
        id: Of the figure.
        beams: The set.
        figure: The figure; None where it is left out.
        table: All numbers.
    """

    id: str
    beams: str
    figure: ShownFigure | None
    table: Table


def histories(
    folders: Sequence[Folder], labels: Sequence[str], drawn: Sequence[str], sets: Sequence[str]
) -> list[History]:
    """The history of each set of beams.

    Args:
        folders: In the order given.
        labels: Of all estimators.
        drawn: Of those that are drawn.
        sets: Labels of the sets of beams.
    """
    return [_history(folders, labels, drawn, beams, number) for number, beams in enumerate(sets)]


def _history(
    folders: Sequence[Folder], labels: Sequence[str], drawn: Sequence[str], beams: str, number: int
) -> History:
    from ..figures.embedded.history import shown

    names = folders[0].results.space.names
    panels = ["ANEES / n", *(f"true std of {name}, {unit(name)}" for name in names)]
    rows = {label: [folder.last_row(label, beams) for folder in folders] for label in labels}
    figure, spots, id = None, dict[Place, Spot](), f"history-{number + 1}"
    if number < MAX_SETS_DRAWN and any(row for label in drawn for row in rows[label]):
        own = {label: rows[label] for label in drawn}
        figure, spots = _drawing(folders, own, panels, beams, id)
    groups = [
        (
            label,
            [
                Line(
                    what,
                    [
                        Cell.of(shown(row, panel), spots.get((label, panel, folder)))
                        for folder, row in enumerate(rows[label])
                    ],
                )
                for panel, what in enumerate(panels)
            ],
        )
        for label in labels
    ]
    return History(id, beams, figure, Table([folder.letter for folder in folders], groups, head="figure"))


def _drawing(
    folders: Sequence[Folder], rows: Rows, panels: Sequence[str], beams: str, id: str
) -> tuple[ShownFigure, dict[Place, Spot]]:
    """The figure, and where in it each number stands."""
    from ..figures.embedded.history import history_figure, is_drawn, place_of, shown
    from ..figures.embedded.places import Drawing
    from ..figures.style import styled

    title = f"History with {beams_in_words(beams)}"
    caption = "ANEES / n and true standard deviations, folder by folder, with 95 % intervals"
    with styled():
        made, places = history_figure([folder.tick for folder in folders], rows)
        figure = ShownFigure.of(Drawing.of(made), title, caption)
    spots = {}
    for estimator, label in enumerate(rows):
        for panel, what in enumerate(panels):
            for folder, row in enumerate(rows[label]):
                if is_drawn(interval := shown(row, panel)):
                    point = place_of(folder, estimator, len(rows)), interval.value
                    tip = f"{label}, {folders[folder].letter}: {what} {format_interval(interval)}"
                    spots[label, panel, folder] = Spot.at_shares(id, places[panel].of([point])[0], tip)
    return figure, spots
