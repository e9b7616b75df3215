"""Every table on the terminal."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import product
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from rich.table import Table

from ..errors import listed
from ..evaluation import Fusion, PairedComparison, Results, Row
from ..evaluation.comparison.compare import Comparison, Difference
from ..evaluation.consistency.formatting import beams_in_words, factor, format_number, format_percent, unit
from ..evaluation.consistency.intervals import UNKNOWN, uniform_p_value
from ..evaluation.consistency.metrics import MAX_ERROR, MIN_EFFECTIVE, Metric
from ..evaluation.consistency.verdict import decide
from ..evaluation.paper import BAND, CELLS, Paper
from .screen import WIDTH, least_width, new_table

if TYPE_CHECKING:
    from ..evaluation.bounds.catalogue import Row as BoundRow

SHOWN = 40  # lines of a config's diff


def table1(paper: Paper) -> Table:
    """The paper's Table 1: noise-free values beside the printed ones, with the band over noise draws."""
    low, high = BAND
    cells = f"cells of {CELLS[-1]:g} m, {paper.draws} noise draws"
    columns = [
        "beams",
        "",
        "noise-free",
        "paper prints",
        f"{low:g}-{high:g} % of draws",
        "paper's percentile",
    ]
    table = new_table(f"Table 1: conditional standard deviations, m ({cells})", columns, left=2)
    for row in paper.rows:
        for i, inside in enumerate(row.in_band()):
            first, last = row.percentile[i]
            table.add_row(
                row.beams if i == 0 else "",
                ("x1", "x2")[i],
                f"{row.std[i]:.4f}",
                row.printed[i],
                f"{row.band[i, 0]:.4f} - {row.band[i, 1]:.4f}",
                f"{first:.0f} - {last:.0f}" + ("" if inside else " outside"),
                end_section=i == 1,
            )
    return table


def table1_notes(paper: Paper) -> list[str]:
    """What must be said with Table 1."""
    agreeing = round(paper.agreeing * paper.draws)
    outside = sum(not inside for row in paper.rows for inside in row.in_band())
    some = f"All printed figures but {outside} lie in their bands."
    inside = some if outside else "Every printed figure lies in its band."
    return [
        "The paper prints one unstated draw of the noise and cuts off: 0.64 is anything from 0.64 to 0.65,"
        " hence a range of percentiles.",
        f"{inside} All 14 at once come out for {agreeing} of {paper.draws} draws"
        + ("." if agreeing else ": the rows hardly come from a single draw."),
    ]


IMPROBABLE = "share_improbable"  # stands in one wide table where it is not zero; words below it tell it, too
MAX_NAMED = 20  # rows that share a verdict; the table above has all
UNTOLD_SHARE = 5e-4  # of a variance: an error that is not shown


def bounds(rows: Sequence[BoundRow], components: Sequence[str], title: str) -> Table:
    """Deviations of the optimum and of bounds, and their variances as shares of the optimum's."""
    from ..evaluation.bounds.catalogue import NOT_BELOW  # brings scipy.stats, which no other table needs

    columns = ["", *(f"std {name}, {unit(name)}" for name in components)]
    columns += [f"variance {name}\nof the optimum's" for name in components]
    table = new_table(title, columns)
    for beams in dict.fromkeys(row.beams for row in rows):
        table.add_row(beams_in_words(beams), style="bold")
        for row in (row for row in rows if row.beams == beams and row.bound is not None):
            assert row.bound is not None
            variances = np.where(np.diagonal(row.bound.matrix) > 0, np.diagonal(row.bound.matrix), np.nan)
            stds = np.sqrt(variances)  # a bound of 0 says nothing, and is shown as "-"
            shown = [format_number(factor(name) * std) for name, std in zip(components, stds, strict=True)]
            shares = [""] * len(components)
            if row.name in NOT_BELOW:
                shares = [_known_to(share) for share in np.diagonal(row.bound.error) / variances]
            elif row.of_optimum is not None:
                shares = [
                    "-" if np.isnan(variance) else format_percent(share)
                    for share, variance in zip(row.of_optimum, variances, strict=True)
                ]
            table.add_row(f"  {row.name}", *shown, *shares)
    return table


def _known_to(share: float) -> str:
    """How well the optimum's variance is known, where it is not all but exact."""
    return "" if share < UNTOLD_SHARE else f"+- {format_percent(share)}"


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
    """Verdicts after the last measurement in words, but for plainly honest ones; equal words share a line."""
    end = max(row.step for row in rows)
    told: dict[str, list[str]] = {}
    for row in rows:
        verdict = decide(row)
        if row.step == end and not verdict.plain:
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


REMARKS = {  # share of a row -> what is said of it where it is not zero
    "collapsed": ("collapsed", f"; fewer than {MIN_EFFECTIVE} effective particles"),
    "inaccurate": ("inaccurate", f"; numerical error above {MAX_ERROR:g} deviations"),
    "undirected": ("no mean heading", ""),
    "improbable": ("improbable", "; its own model all but excludes what was measured"),
}


def remarks(rows: Sequence[Row], estimators: Mapping[str, Any] | None = None) -> list[str]:
    """A line for each estimator and set of beams with a fault in some runs, after the last measurement.

    Args:
        rows: What came out.
        estimators: Label -> name and options, as a manifest has them, for what is to be done about it.
    """
    end = max(row.step for row in rows)
    lines = []
    for name, (words, why) in REMARKS.items():
        for row in (row for row in rows if row.step == end):
            share: float = getattr(row, name).value
            if share > 0:
                where = f"{row.estimator}, {beams_in_words(row.beams)}"
                advice = _smaller_cells((estimators or {}).get(row.estimator)) if name == "inaccurate" else ""
                lines.append(f"{where}: {words} in {100 * share:.3g} % of the runs{why}{advice}")
    lines += [
        f"{row.estimator}, {beams_in_words(row.beams)}: a run takes long; the time is that of its first "
        f"{row.updates_timed} of {end + 1} updates"
        for row in rows
        if row.step == end and row.updates_timed is not None
    ]
    return lines


def _smaller_cells(estimator: Any) -> str:
    """What mends cells that are too wide, with a semicolon before it; "" where none are given."""
    options = estimator.get("options") if isinstance(estimator, Mapping) else None
    if not isinstance(options, Mapping) or estimator.get("name") != "point-mass":
        return ""
    cell, turn = options.get("cell"), options.get("heading_cell")
    told = (
        [f"cell_m = {cell:g}"] if isinstance(cell, int | float) else ["those of `cell`"] * (cell is not None)
    )
    told += [f"heading_cell_deg = {math.degrees(turn):g}"] if isinstance(turn, int | float) else []
    return f"; smaller cells than {' and '.join(told)} mend it" if told else ""


def failures(results: Results) -> list[str]:
    """A line for each estimator and set of beams of which runs failed: how many, and why the first did."""
    lines = []
    for estimator, beams in product(results.estimators, results.beam_sets):
        first, counts = "", Counter[str]()
        for block in results.blocks():
            trials = results.source.trials(estimator, beams, *block)
            counts.update(trials.failures)
            if not first and trials.reasons:
                run = min(trials.reasons)
                first = f"run {run}: {trials.reasons[run]}"
        if counts:
            told = ", ".join(f"{count} {status}" for status, count in counts.items())
            lines.append(f"{estimator}, {beams_in_words(beams)}: {told}; {first}")
    return lines


def preamble(comparison: Comparison, a: str, b: str) -> list[str]:
    """What differs beside the numbers."""
    lines = [f"A: {a}", f"B: {b}", ""]
    lines += [
        f"{name}: {_brief(one)} -> {_brief(other)}" for name, (one, other) in comparison.settings.items()
    ]
    config = comparison.config
    lines += ["config:", *(f"  {line}" for line in config[:SHOWN])] if config else ["config: the same"]
    if len(config) > SHOWN:
        lines.append(f"  ... and {len(config) - SHOWN} lines more")
    for name, only in (("A", comparison.only_a), ("B", comparison.only_b)):
        lines += [f"only in {name}: {estimator}, {beams_in_words(beams)}" for estimator, beams in only]
    same = "the same" if comparison.same_truths else "other"
    return [*lines, f"truths: {same}; runs are paired by number", ""]


def differences(comparison: Comparison) -> Table:
    """A line for each figure; standard deviations are roots of mean squares."""
    table = new_table("", ("figure", "runs", "A", "B", "B / A", "p (Holm)"))
    table.add_column("", justify="left")
    last = max((difference.step for difference in comparison.differences), default=0)
    shown = [each for each in comparison.differences if each.step in (-1, last)]
    for estimator, beams in dict.fromkeys((each.estimator, each.beams) for each in shown):
        table.add_row(f"{estimator}, {beams_in_words(beams)}", style="bold")
        for each in (each for each in shown if (each.estimator, each.beams) == (estimator, beams)):
            table.add_row(*_difference_cells(each), style="bold" if each.significant else "")
        table.add_section()
    return table


def accuracy(pairs: Sequence[PairedComparison]) -> Table:
    """Each estimator beside the most accurate one on the same truths."""
    columns = ["\nestimator", "runs of\nboth", "rms error,\nposition, m", "that of\nthe best"]
    columns += ["closer than\nthe best in", "\np"]
    table = new_table("Who is more accurate on the same truths, after the last measurement", columns)
    for beams in dict.fromkeys(pair.beams for pair in pairs):
        table.add_row(beams_in_words(beams), style="bold")
        for pair in (pair for pair in pairs if pair.beams == beams):
            p = "-" if pair.p != pair.p else f"{pair.p:.2g}"
            closer = "-" if not pair.runs else format_percent(pair.closer)
            rms = format_number(pair.rmse), format_number(pair.best_rmse)
            style = "bold" if pair.significant else ""
            table.add_row(f"  {pair.estimator}", str(pair.runs), *rms, closer, p, style=style)
        table.add_section()
    return table


def fusions(found: Sequence[Fusion]) -> Table:
    """What a claimed covariance costs where an estimate is fused with a second position."""
    second = format_number(found[0].second_alone)
    columns = ["\nestimator", "\nruns", "rms error,\nposition, m", "fused by\nits claims, m"]
    columns += ["fused by\nthe true G, m", "price,\nm"]
    title = f"Fused with a second position of rms error {second} m, after the last measurement"
    table = new_table(title, columns)
    for beams in dict.fromkeys(each.beams for each in found):
        table.add_row(beams_in_words(beams), style="bold")
        for each in (each for each in found if each.beams == beams):
            figures = (each.alone, each.claimed, each.true, each.price)
            worse = each.claimed > each.second_alone  # than the second position alone
            table.add_row(
                f"  {each.estimator}", str(each.runs), *map(format_number, figures),
                style="bold red" if worse else "",
            )  # fmt: skip
        table.add_section()
    return table


def accuracy_in_words(pairs: Sequence[PairedComparison]) -> list[str]:
    """Whether one is more accurate, and by how much; equal words about one set of beams share a line."""
    told: dict[tuple[str, str], list[str]] = {}
    for pair in pairs:
        told.setdefault((pair.beams, pair.words), []).append(pair.estimator)
    return [
        f"{names[0]}, {beams_in_words(beams)}: {words}"
        if len(names) == 1
        else f"{beams_in_words(beams)}: {words}: {listed(names, MAX_NAMED)}"
        for (beams, words), names in told.items()
    ]


def _difference_cells(each: Difference) -> Iterator[str]:
    a, b = (math.sqrt(value) if each.is_variance and value >= 0 else value for value in (each.a, each.b))
    yield from (f"  {each.label}", str(each.runs), format_number(a), format_number(b))
    yield f"{b / a:.3g}" if a and math.isfinite(a) and math.isfinite(b) else "-"
    yield "-" if each.adjusted != each.adjusted else f"{each.adjusted:.2g}"
    yield f"B is {each.words}" if each.words in ("larger", "smaller") else each.words


def _brief(value: object) -> str:
    text = str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
