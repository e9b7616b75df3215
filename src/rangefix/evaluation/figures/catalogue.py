"""THE table of the figures of a study: `rangefix plot`, the report and the gallery read it.

To add a figure, add a line; or, from another package, a `FigureKind` as an entry point of "rangefix.figures".
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from matplotlib.figure import Figure

from ...errors import suggestion
from ...extensions import extensions
from ..results import Results, ResultsError
from .beliefs import draw_posterior
from .claims import draw_anees, draw_covariance, draw_efficiency, draw_time
from .data import FigureData
from .drives import draw_steps, draw_ways
from .errors import draw_errors, draw_runs
from .layout import Layout
from .maps import draw_map
from .ranks import draw_ranks
from .sheet import Sheet

Data = TypeVar("Data")
SILENT = "no run went well"
NOT_BEGUN = "no run was made yet"


@dataclass(frozen=True)
class FigureKind(Generic[Data]):
    """A kind of figure.

    Attributes:
        name: Of its files.
        title: What it is called.
        caption: What it shows: a phrase that goes on after the title.
        draw: Draws it.
        needs: Whether the data hold what it shows; any data do unless given.
        lacking: Why it cannot be drawn where they do not.
        other_names: That also mean it where figures are asked for by name.
    """

    name: str
    title: str
    caption: str
    draw: Callable[[Data], Figure]
    needs: Callable[[Data], bool] = lambda data: True
    lacking: str = "the results do not hold what it shows"
    other_names: tuple[str, ...] = ()


Draw = Callable[[FigureData, Sheet], None]


def alone(draw: Draw) -> Callable[[FigureData], Figure]:
    """A function that draws a figure of its own."""

    def drawn(data: FigureData) -> Figure:
        sheet = Sheet(data.layout)
        draw(data, sheet)
        return sheet.root

    return drawn


FIGURES: tuple[FigureKind[FigureData], ...] = (
    FigureKind("map", "The map", "walls, free space, true positions, and the beams of the first run",
               alone(draw_map), FigureData.has_map, "the map was not saved"),
    FigureKind("covariance", "Standard deviations", "claimed (hollow, root of mean P) and true (filled, root "
               "of G), with 95 % intervals", alone(draw_covariance), FigureData.has_rows, SILENT,
               other_names=("claims",)),
    FigureKind("anees", "ANEES / n", "squared error over claimed variance, with 95 % intervals; 1 is honest, "
               "to the right the errors are larger than claimed", alone(draw_anees), FigureData.has_rows,
               SILENT),
    FigureKind("efficiency", "Efficiency", "variance of the best estimate that there is, or of the largest "
               "bound, over the true one, with 95 % intervals; 100 % is as good as anybody can be",
               alone(draw_efficiency), FigureData.has_bounds,
               "it was not worked out how good anybody could be: rangefix bounds"),
    FigureKind("errors", "Errors in the plane", "with the ellipses of the true covariance G and the mean "
               "claimed P", alone(draw_errors), FigureData.has_answers, SILENT),
    FigureKind("runs", "Errors run by run", "in the band that each run claims, in the order of that claim",
               alone(draw_runs), FigureData.has_answers, SILENT),
    FigureKind("posterior", "Beliefs", "what is believed in the first run", alone(draw_posterior),
               FigureData.has_pictures, "no pictures of beliefs were saved, or no run went well"),
    FigureKind("steps", "Along the way", "true and claimed errors after each measurement", alone(draw_steps),
               FigureData.has_steps, "each run has one measurement, or none went well"),
    FigureKind("ways", "The way of the first run", "true and estimated", alone(draw_ways),
               FigureData.has_ways, "nothing moved, the map was not saved, or no run went well"),
    FigureKind("ranks", "Ranks", "where the truth lies among samples of the belief; flat within the band if "
               "honest", alone(draw_ranks), FigureData.has_samples,
               "beliefs were not sampled: beliefs = true"),
    FigureKind("time", "Accuracy against time", "true and claimed error against time per update",
               alone(draw_time), FigureData.has_times, "no estimator that answered was timed"),
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


def study_figures(results: Results, layout: Layout | None = None) -> Iterator[tuple[FigureKind[Any], Figure]]:
    """All figures of a study; those of single runs are for the last set of beams."""
    return drawn(figure_kinds(), FigureData.of(results, layout))


def why_lacking(kind: FigureKind[Any], data: object) -> str:
    """Why a figure cannot be drawn of data that do not hold what it shows."""
    if isinstance(data, FigureData) and not data.is_begun and kind.name != "map":
        return NOT_BEGUN
    return kind.lacking


def chosen(kinds: Iterable[FigureKind[Data]], names: Iterable[str]) -> list[FigureKind[Data]]:
    """The kinds of these names, in the order of the table, each once.

    Raises:
        ResultsError: If there is no figure of a name; it says which was meant, or which there are.
    """
    kinds, wanted = list(kinds), list(names)
    by_name = {name: kind for kind in kinds for name in (kind.name, *kind.other_names)}
    for name in wanted:
        if name not in by_name:
            raise ResultsError(f"there is no figure {name!r}; {suggestion(name, by_name)}")
    if not wanted:
        raise ResultsError(f"no figure is named; there are {', '.join(by_name)}")
    return [kind for kind in kinds if any(by_name[name] is kind for name in wanted)]
