"""The tables of a report: all settings after the last measurement, by set of beams."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from ..comparison.paired import PairedComparison
from ..consistency.formatting import beams_in_words, format_interval, format_number, format_percent, unit
from ..consistency.intervals import UNKNOWN, Interval, uniform_p_value
from ..consistency.metrics import Metric
from ..consistency.row import Row

SMALLEST_P_VALUE_SHOWN = 1e-6
BELIEF = "belief_"  # how the names of figures of sampled beliefs begin


class Cell(NamedTuple):
    """What stands in a cell of a table: a value and, small beneath it, the ends of its interval."""

    value: str
    ends: str = ""

    @classmethod
    def of(cls, interval: Interval) -> Cell:
        """The cell of an interval."""
        value, _, ends = format_interval(interval).partition(" ")
        return cls(value, ends)


class Table(NamedTuple):
    """A table of estimators, in groups by set of beams.

    Attributes:
        columns: Headings of all columns but the first.
        groups: The heading of each group, and in it the estimators with their cells.
    """

    columns: list[str]
    groups: list[tuple[str, list[tuple[str, list[Cell]]]]]

    @classmethod
    def of(cls, columns: list[str], rows: Sequence[Row], cells: Callable[[Row], list[Cell]]) -> Table:
        """A table with a line for each row."""
        groups: dict[str, list[tuple[str, list[Cell]]]] = {}
        for row in rows:
            groups.setdefault(beams_in_words(row.beams), []).append((row.estimator, cells(row)))
        return cls(columns, list(groups.items()))


def overview(rows: Sequence[Row]) -> Table:
    """True and claimed standard deviations, ANEES / n, energy score and time."""
    stds = [f"std of {name}, {unit(name)}: true / claimed" for name in rows[0].names]
    columns = ["ok", *stds, "ANEES / n", "energy score, m", "ms per update"]

    def cells(row: Row) -> list[Cell]:
        return [
            Cell(str(row.ok) if row.ok == row.planned else f"{row.ok} of {row.planned}"),
            *(Cell(stds if row.ok else "-") for stds in row.pairs_of_stds(row.g, row.p)),
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
        p_value = _format_p_value(uniform_p_value(belief.ranks[-1]))
        return [*line, Cell(f"{100 * belief.share.value:.3g} %"), Cell(p_value)]

    return Table.of(columns, rows, cells)


def accuracy(pairs: Sequence[PairedComparison]) -> Table:
    """Each estimator beside the most accurate one on the same truths."""
    columns = ["runs of both", "rms error of the position, m", "that of the best", "closer than it in", "p"]
    groups: dict[str, list[tuple[str, list[Cell]]]] = {}
    for pair in pairs:
        closer, p = (format_percent(pair.closer), _format_p_value(pair.p)) if pair.runs else ("-", "-")
        rms = format_number(pair.rmse), format_number(pair.best_rmse)
        cells = [Cell(text) for text in (str(pair.runs), *rms, closer, p, pair.words)]
        heading = f"{beams_in_words(pair.beams)}; the most accurate is {pair.best}"
        groups.setdefault(heading, []).append((pair.estimator, cells))
    return Table([*columns, "in words"], list(groups.items()))


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


def _format_p_value(p: float) -> str:
    if math.isnan(p):
        return "-"
    return f"{p:.2g}" if p >= SMALLEST_P_VALUE_SHOWN else f"< {SMALLEST_P_VALUE_SHOWN:g}"
