"""THE table of the figures of a study: `rangefix plot`, the report and the gallery read it.

To add a figure, add a line; or, from another package, a `FigureKind` as an entry point of "rangefix.figures".
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from matplotlib.figure import Figure

from ...extensions import extensions
from ..results import Results
from .beliefs import beliefs_figure
from .claims import anees_figure, covariance_figure, time_figure
from .data import FigureData
from .drives import steps_figure, ways_figure
from .errors import ellipses_figure, runs_figure
from .maps import map_figure
from .ranks import ranks_figure

Data = TypeVar("Data")


@dataclass(frozen=True)
class FigureKind(Generic[Data]):
    """A kind of figure.

    Attributes:
        name: Of its files.
        title: What it is called.
        caption: What it shows: a phrase that goes on after the title.
        draw: Draws it.
        needs: Whether the data hold what it shows; any data do unless given.
    """

    name: str
    title: str
    caption: str
    draw: Callable[[Data], Figure]
    needs: Callable[[Data], bool] = lambda data: True


FIGURES: tuple[FigureKind[FigureData], ...] = (
    FigureKind("map", "The map", "walls, free space, true positions, and the beams of the first run",
               map_figure, FigureData.has_map),
    FigureKind("covariance", "Standard deviations", "claimed (hollow, root of mean P) and true (filled, root "
               "of G), with 95 % intervals", covariance_figure),
    FigureKind("anees", "ANEES / n", "squared error over claimed variance, with 95 % intervals; 1 is honest, "
               "to the right the errors are larger than claimed", anees_figure),
    FigureKind("errors", "Errors in the plane", "with the ellipses of the true covariance G and the mean "
               "claimed P", ellipses_figure),
    FigureKind("runs", "Errors run by run", "in the band that each run claims, in the order of that claim",
               runs_figure),
    FigureKind("posterior", "Beliefs", "what is believed in the first run", beliefs_figure,
               FigureData.has_pictures),
    FigureKind("steps", "Along the way", "true and claimed errors after each measurement", steps_figure,
               FigureData.has_steps),
    FigureKind("ways", "The way of the first run", "true and estimated", ways_figure, FigureData.has_ways),
    FigureKind("ranks", "Ranks", "where the truth lies among samples of the belief; flat within the band if "
               "honest", ranks_figure, FigureData.has_samples),
    FigureKind("time", "Accuracy against time", "true and claimed error against time per update", time_figure,
               FigureData.has_times),
)  # fmt: skip


def figure_kinds() -> list[FigureKind[FigureData]]:
    """The figures of the table, then those that other packages offer.

    What is no `FigureKind`, or has the name of another figure, is left out with a warning.
    """
    kinds = {kind.name: kind for kind in FIGURES}
    for entry, kind in extensions("rangefix.figures").items():
        if isinstance(kind, FigureKind) and kind.name not in kinds:
            kinds[kind.name] = kind
        else:
            why = f"is another {kind.name!r}" if isinstance(kind, FigureKind) else "is no FigureKind"
            warnings.warn(f"rangefix.figures: {entry!r} {why}", RuntimeWarning, stacklevel=2)
    return list(kinds.values())


def drawn(kinds: Iterable[FigureKind[Data]], data: Data) -> Iterator[tuple[FigureKind[Any], Figure]]:
    """The kinds of figures whose needs the data meet, each with the figure, drawn when it is asked for."""
    return ((kind, kind.draw(data)) for kind in kinds if kind.needs(data))


def study_figures(results: Results) -> Iterator[tuple[FigureKind[Any], Figure]]:
    """All figures of a study; those of single runs are for the last set of beams."""
    return drawn(figure_kinds(), FigureData.of(results))
