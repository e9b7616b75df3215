"""The tables of a study: true and claimed deviations with verdicts, and what samples of beliefs say."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Literal, NamedTuple

from rich.table import Table

from ...errors import listed
from ...evaluation import Row
from ...evaluation.consistency.formatting import beams_in_words, format_number, unit
from ...evaluation.consistency.intervals import UNKNOWN, uniform_p_value
from ...evaluation.consistency.metrics import Metric
from ...evaluation.consistency.verdict import decide
from ..screen import WIDTH, least_width, new_table

IMPROBABLE = "share_improbable"  # stands in one wide table where it is not zero; words below it tell it, too
MAX_NAMED = 20  # rows that share a verdict; the table above has all


def comparison(rows: Sequence[Row], title: str, width: int = WIDTH) -> list[Table]:
    """The comparison of a study: true and claimed standard deviations, ANEES / n, time, and the verdict.

    Of many measurements it shows the last. What a screen has no room for is left out in turn: energy scores
    and times, then intervals; verdicts and deviations may stand in two tables. All is in `summary.csv`.
    """
    tables: list[Table] = []
    for layout in LAYOUTS:
        tables = [_comparison(rows, title, layout, part) for part in _parts(rows, layout)]
        if all(least_width(table) <= width for table in tables):
            break
    return tables


Part = Literal["all", "verdicts", "deviations", "components"]


class Layout(NamedTuple):
    """What is shown of a study: times and figures without an honest value, intervals; in one table or two."""

    extras: bool
    intervals: bool
    apart: bool


LAYOUTS = (
    Layout(True, True, False),
    Layout(False, True, False),
    Layout(False, False, False),
    Layout(False, True, True),
    Layout(False, False, True),
)


def _parts(rows: Sequence[Row], layout: Layout) -> tuple[Part, ...]:
    """What stands in the tables of a layout."""
    if not layout.apart:
        return ("all",)
    of_components = any(component for row in rows for _, component, _ in row.shown("terminal"))
    return ("verdicts", "deviations", "components") if of_components else ("verdicts", "deviations")


def _comparison(rows: Sequence[Row], title: str, layout: Layout, part: Part) -> Table:
    """One table of a study in a layout: verdicts, deviations, other figures of components, or all."""
    end = max(row.step for row in rows)
    names = rows[0].names if part in ("all", "deviations") else ()
    judges = part in ("all", "verdicts")
    shown = dict.fromkeys(each[:2] for row in rows for each in row.shown("terminal"))
    figures = [
        figure
        for figure in shown
        if figure[0].honest is not None
        or figure[1]
        or layout.extras
        or (figure[0].name == IMPROBABLE and not layout.apart)
    ]
    figures = [figure for figure in figures if _is_told(figure[0], rows)]
    figures = [figure for figure in figures if part in ("all", "components" if figure[1] else "verdicts")]
    columns = ["\nestimator"]
    columns += [] if not judges else [f"ok of\n{rows[0].planned}"]
    bounded = any(row.bound is not None for row in rows if row.step == end)
    columns += _std_headings(names, "bound / true / claimed" if bounded else "true / claimed")
    columns += [_heading(metric, component, layout) for metric, component in figures]
    columns += ["ms per\nupdate"] * layout.extras
    table = new_table(title if judges else "", columns)
    if judges:
        table.add_column("\nverdict", justify="left", no_wrap=True)
        table.add_column("by a\nfactor", justify="right", no_wrap=True)
    for beams in dict.fromkeys(row.beams for row in rows if row.step == end):
        last = f", after the last of {end + 1} measurements" if end else ""
        table.add_row(f"{beams_in_words(beams)}{last}", style="bold")
        for row in (row for row in rows if (row.beams, row.step) == (beams, end)):
            verdict = decide(row)
            cells = [f"  {row.estimator}"] + [str(row.ok)] * judges
            cells += row.stds_beside_bound(bounded) if names else []
            cells += [_cell(row, metric, component, layout) for metric, component in figures]
            cells += [row.milliseconds] * layout.extras
            cells += [] if not judges else [verdict.short, verdict.by]
            table.add_row(*cells, style="bold red" if verdict.overconfident else "")
        table.add_section()
    return table


def _is_told(metric: Metric, rows: Sequence[Row]) -> bool:
    """Whether a figure has a column: that of improbable measurements only where there are any."""
    return metric.name != IMPROBABLE or any(row.improbable.value > 0 for row in rows)


def verdicts(rows: Sequence[Row]) -> list[str]:
    """Verdicts after the last measurement in words, but for plainly honest ones; equal words share a line.

    First those that must not be trusted, last those of which too few runs tell nothing.
    """
    end = max(row.step for row in rows)
    judged = [(decide(row), row) for row in rows if row.step == end]
    told: dict[str, list[str]] = {}
    for verdict, row in sorted(judged, key=lambda each: (not each[0].severe, each[0].kind == "unsure")):
        if not verdict.plain:
            told.setdefault(verdict.words, []).append(f"{row.estimator}, {beams_in_words(row.beams)}")
    return [
        f"{where[0]}: {words}" if len(where) == 1 else f"{words}: {listed(where, MAX_NAMED)}"
        for words, where in told.items()
    ]


def _heading(metric: Metric, component: str, layout: Layout) -> str:
    """On two lines. What has an honest value is shown with its interval, to be compared with it."""
    if metric.honest is not None:
        label = metric.short_label(component)
        return f"{label}\n[95 %]" if layout.intervals else f"\n{label}"
    first, _, rest = metric.full_label(component).partition(" (")[0].partition(" ")
    return f"{first}\n{rest}"


def _cell(row: Row, metric: Metric, component: str, layout: Layout) -> str:
    interval = metric.in_shown_unit(row.figures.get(metric.column(component), UNKNOWN), component)
    if metric.honest is None or not layout.intervals or not math.isfinite(interval.value):
        return format_number(interval.value)
    return f"{format_number(interval.value)} [{format_number(interval.low)}, {format_number(interval.high)}]"


def _std_headings(names: Iterable[str], pair: str) -> list[str]:
    return [f"{name} std, {unit(name)}\n{pair}" for name in names]


def beliefs(rows: Sequence[Row]) -> Table | None:
    """What samples of the beliefs say, after the last measurement; None where none were sampled."""
    end = max(row.step for row in rows)
    sampled = [(row, row.beliefs) for row in rows if row.step == end]
    if not any(found for _, found in sampled):
        return None
    columns = ["\nestimator", *_std_headings(rows[0].names, "whole / main mode"), "share of\nmain mode"]
    columns += ["energy score, m\nclaim / belief", "\nranks, p"]
    table = new_table("Beliefs: 99 samples of each", columns)
    for beams in dict.fromkeys(row.beams for row, found in sampled if found):
        table.add_row(beams_in_words(beams), style="bold")
        for row, found in sampled:
            if found and row.beams == beams:
                table.add_row(
                    f"  {row.estimator}",
                    *row.pairs_of_stds(found.whole, found.mode),
                    f"{100 * found.share.value:.3g} %",
                    f"{format_number(row.scores.energy.value)} / {format_number(found.energy.value)}",
                    format_number(uniform_p_value(found.ranks[-1])),
                )
        table.add_section()
    return table
