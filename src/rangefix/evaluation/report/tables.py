"""The tables of a report, and what stands in their cells."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from ...arrays import Array
from ..comparison.paired import PairedComparison
from ..consistency.formatting import beams_in_words, format_interval, format_number, format_percent, unit
from ..consistency.intervals import UNKNOWN, Interval, uniform_p_value
from ..consistency.metrics import Metric
from ..consistency.row import Row
from ..consistency.verdict import CERTAIN, Verdict

SMALLEST_P_VALUE_SHOWN = 1e-6
BELIEF = "belief_"  # how the names of figures of sampled beliefs begin


class Spot(NamedTuple):
    """Where a figure of the page shows what a line or cell says; pointing at one marks the other.

    Attributes:
        figure: Its id.
        at: Places in per cent of its width and height, across and down, in turn.
        tip: What is said of the place.
        run: The number of the run that is shown, if it is one.
    """

    figure: str
    at: tuple[float, ...]
    tip: str
    run: int | None = None

    @classmethod
    def at_shares(cls, figure: str, shares: Array, tip: str, run: int | None = None) -> Spot:
        """The same from shares of the figure's width and height, to a hundredth of a per cent."""
        return cls(figure, tuple(round(100 * float(share), 2) for share in shares), tip, run)


class Cell(NamedTuple):
    """What stands in a cell of a table: a value and, small beneath it, the ends of its interval.

    Attributes:
        value, ends: The two.
        verdict: What is shown instead, as a badge.
        spot: Where a figure shows the same.
        kind: The class of its looks.
    """

    value: str
    ends: str = ""
    verdict: Verdict | None = None
    spot: Spot | None = None
    kind: str = ""

    @classmethod
    def of(cls, interval: Interval, spot: Spot | None = None) -> Cell:
        """The cell of an interval."""
        value, _, ends = format_interval(interval).partition(" ")
        return cls(value, ends, spot=spot)

    @property
    def order(self) -> float | None:
        """By what it is sorted, where that is not the number in its text."""
        if self.verdict is None:
            return None
        value = self.verdict.factor.value
        return (
            -1.0 if self.verdict.kind in ("failed", "pending") or math.isnan(value) else min(value, CERTAIN)
        )


class Line(NamedTuple):
    """A line of a table: its heading, its cells, and where a figure shows the same."""

    name: str
    cells: Sequence[Cell]
    spot: Spot | None = None


class Table(NamedTuple):
    """A table in groups.

    Attributes:
        columns: Headings of all columns but the first.
        groups: The heading of each group, "" for none, and its lines.
        texts: Places of the columns that hold words, from 0; the others hold numbers.
        head: The heading of the first column.
    """

    columns: Sequence[str]
    groups: Sequence[tuple[str, Sequence[Line]]]
    texts: frozenset[int] = frozenset()
    head: str = "estimator"

    @classmethod
    def of(cls, columns: list[str], rows: Sequence[Row], cells: Callable[[Row], list[Cell]]) -> Table:
        """A table with a line for each row, in groups by set of beams."""
        groups: dict[str, list[Line]] = {}
        for row in rows:
            groups.setdefault(beams_in_words(row.beams), []).append(Line(row.estimator, cells(row)))
        return cls(columns, list(groups.items()))


def overview(rows: Sequence[Row]) -> Table:
    """True and claimed standard deviations, those of bounds and efficiencies, ANEES / n, score and time."""
    bounded = any(row.bound is not None for row in rows)
    told = "bound / true / claimed" if bounded else "true / claimed"
    stds = [f"std of {name}, {unit(name)}: {told}" for name in rows[0].names]
    shown = dict.fromkeys(each[:2] for row in rows for each in row.shown("terminal"))
    figures = [(metric, name) for metric, name in shown if name]
    columns = [
        "ok",
        *stds,
        *(metric.full_label(name) for metric, name in figures),
        "ANEES / n",
        "energy score, m",
        "ms per update",
    ]

    def cells(row: Row) -> list[Cell]:
        return [
            Cell(str(row.ok) if row.ok == row.planned else f"{row.ok} of {row.planned}"),
            *(Cell(stds if row.ok else "-") for stds in row.stds_beside_bound(bounded)),
            *(
                Cell.of(metric.in_shown_unit(row.figures.get(metric.column(name), UNKNOWN), name))
                for metric, name in figures
            ),
            Cell.of(row.anees),
            Cell.of(row.scores.energy),
            Cell(row.milliseconds_range),
        ]

    return Table.of(columns, rows, cells)


def scores(rows: Sequence[Row], sampled: bool) -> Table:
    """Mean scores of each claim and, where beliefs were sampled, beside them those of the belief itself."""
    shown = [figure[:2] for row in rows for figure in row.shown("report") if _is_score(figure[0])]
    figures = [(metric, name) for metric, name in dict.fromkeys(shown) if not metric.name.startswith(BELIEF)]
    beliefs = {metric.name for metric, _ in shown if metric.name.startswith(BELIEF)}
    columns = []
    for metric, name in figures:
        both = f"{BELIEF}{metric.name}" in beliefs
        of_claim = " of the claim" if sampled and not both else ""
        columns.append(metric.full_label(name).replace(",", f"{of_claim},") + ": claim / belief" * both)
    if sampled:
        columns += [f"std of {name}, {unit(name)}: whole belief / main mode" for name in rows[0].names]
        columns += ["share of the main mode", "ranks, p"]

    def cells(row: Row) -> list[Cell]:
        line = [_score(row, metric, name, f"{BELIEF}{metric.name}" in beliefs) for metric, name in figures]
        if not sampled:
            return line
        if (belief := row.beliefs) is None:
            return line + [Cell("-")] * (len(columns) - len(line))
        line += map(Cell, row.pairs_of_stds(belief.whole, belief.mode))
        p_value = format_p_value(uniform_p_value(belief.ranks[-1]))
        return [*line, Cell(f"{100 * belief.share.value:.3g} %"), Cell(p_value)]

    return Table.of(columns, rows, cells)


def accuracy(pairs: Sequence[PairedComparison]) -> Table:
    """Each estimator beside the most accurate one on the same truths."""
    columns = ["runs of both", "rms error of the position, m", "that of the best", "closer than it in", "p"]
    groups: dict[str, list[Line]] = {}
    for pair in pairs:
        closer, p = (format_percent(pair.closer), format_p_value(pair.p)) if pair.runs else ("-", "-")
        rms = format_number(pair.rmse), format_number(pair.best_rmse)
        cells = [Cell(text) for text in (str(pair.runs), *rms, closer, p, pair.words)]
        heading = f"{beams_in_words(pair.beams)}; the most accurate is {pair.best}"
        groups.setdefault(heading, []).append(Line(pair.estimator, cells))
    return Table([*columns, "in words"], list(groups.items()), frozenset([len(columns)]))


def _is_score(metric: Metric) -> bool:
    """Whether a figure is a mean of which less is better."""
    return metric.average == "mean" and metric.better == "lower" and metric.unit != "%"


def _score(row: Row, metric: Metric, name: str, both: bool) -> Cell:
    """The score of a claim with its interval or, where beliefs are sampled, beside that of the belief."""
    column = metric.column(name)
    claim, belief = (row.figures.get(column, UNKNOWN) for column in (column, f"{BELIEF}{column}"))
    if not both:
        return Cell.of(metric.in_shown_unit(claim, name))
    values = [metric.in_shown_unit(interval, name).value for interval in (claim, belief)]
    return Cell(" / ".join("-" if math.isnan(value) else format_number(value) for value in values))


def format_p_value(p: float) -> str:
    """A p-value to two digits; "-" where there is none."""
    if math.isnan(p):
        return "-"
    return f"{p:.2g}" if p >= SMALLEST_P_VALUE_SHOWN else f"< {SMALLEST_P_VALUE_SHOWN:g}"
