"""Every table on the terminal."""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from itertools import product

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from ..evaluation import Results, Row
from ..evaluation.consistency.compare import Comparison, Difference
from ..evaluation.consistency.formatting import beams_in_words, format_number, unit
from ..evaluation.consistency.intervals import UNKNOWN, uniform_p_value
from ..evaluation.consistency.metrics import Metric
from ..evaluation.consistency.verdict import MENTION_SHARE, decide
from ..evaluation.paper import BAND, CELLS, Paper

NARROW = 130  # columns; below, the table of a study has fewer
WIDTH = 150  # where the output is not a terminal
SHOWN = 40  # lines of a config's diff


def console() -> Console:
    """Standard output; as wide as the terminal, or WIDTH. Labels and titles are shown as they are."""
    width = None if sys.stdout.isatty() else WIDTH
    return Console(width=width, highlight=False, markup=False, emoji=False)


def new_table(title: str, columns: Iterable[str], left: int = 1) -> Table:
    """An empty table whose first `left` columns stand left and the others right."""
    table = Table(title=title, box=SIMPLE_HEAD, title_justify="left", title_style="bold", padding=(0, 1))
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if i < left else "right", no_wrap=i >= left)
    return table


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


def comparison(rows: Sequence[Row], title: str, width: int = WIDTH) -> Table:
    """The comparison of a study: true and claimed standard deviations, ANEES / n, time, and the verdict.

    Of many measurements it shows the last. On a narrow screen the verdict stands below the figures, and
    intervals, energy scores and times are left out: they are in `summary.csv`.
    """
    narrow = width < NARROW
    shown = dict.fromkeys(each[:2] for row in rows for each in row.shown("terminal"))
    figures = [figure for figure in shown if figure[0].honest is not None or not narrow]
    columns = ["\nestimator", f"ok of\n{rows[0].planned}", *_std_headings(rows[0].names, "true / claimed")]
    columns += [_heading(metric, component, narrow) for metric, component in figures]
    table = new_table(title, columns if narrow else [*columns, "ms per\nupdate"])
    if not narrow:
        table.add_column("\nverdict", justify="left", min_width=24)
    end = max(row.step for row in rows)
    for beams in dict.fromkeys(row.beams for row in rows if row.step == end):
        last = f", after the last of {end + 1} measurements" if end else ""
        table.add_row(f"{beams_in_words(beams)}{last}", style="bold")
        for row in (row for row in rows if (row.beams, row.step) == (beams, end)):
            verdict = decide(row)
            style = "bold red" if verdict.overconfident else ""
            cells = [f"  {row.estimator}", str(row.ok), *row.pairs_of_stds(row.g, row.p)]
            cells += [_cell(row, metric, component, narrow) for metric, component in figures]
            if not narrow:
                cells += [row.milliseconds, verdict.words]
            table.add_row(*cells, style=style)
            if narrow:
                table.add_row(f"  {verdict.words}", style=style)
        table.add_section()
    return table


def _heading(metric: Metric, component: str, narrow: bool) -> str:
    """On two lines. What has an honest value is shown with its interval, to be compared with it."""
    if metric.honest is not None:
        return f"\n{metric.short_label(component)}" if narrow else f"{metric.short_label(component)}\n[95 %]"
    first, _, rest = metric.full_label(component).partition(" ")
    return f"{first}\n{rest}"


def _cell(row: Row, metric: Metric, component: str, narrow: bool) -> str:
    interval = metric.in_shown_unit(row.figures.get(metric.column(component), UNKNOWN), component)
    if metric.honest is None:
        return format_number(interval.value) if row.ok else "-"
    if narrow or not math.isfinite(interval.value):
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


def improbable(rows: Sequence[Row]) -> list[str]:
    """A line for each estimator and set of beams whose own model all but excludes many measurements."""
    end = max(row.step for row in rows)
    return [
        f"{row.estimator}, {beams_in_words(row.beams)}: improbable in {100 * row.improbable.value:.3g} % "
        "of the runs; its own model all but excludes what was measured"
        for row in rows
        if row.step == end and row.improbable.value > MENTION_SHARE
    ]


def unresolved(rows: Sequence[Row]) -> list[str]:
    """A line for each estimator and set of beams whose numbers are too coarse, by its own account."""
    end = max(row.step for row in rows)
    return [
        f"{row.estimator}, {beams_in_words(row.beams)}: numerically unresolved in "
        f"{100 * row.unresolved.value:.3g} % of the runs; it is off by more than 5 % of a deviation"
        for row in rows
        if row.step == end and row.unresolved.value > MENTION_SHARE
    ]


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
    columns = ("estimator", "beams", "figure", "runs", "A", "B", "B / A", "p (Holm)")
    table = new_table("", columns, left=3)
    table.add_column("", justify="left")
    last = max((difference.step for difference in comparison.differences), default=0)
    for difference in comparison.differences:
        if difference.step in (-1, last):
            table.add_row(*_difference_cells(difference), style="bold" if difference.significant else "")
    return table


def _difference_cells(each: Difference) -> Iterator[str]:
    a, b = (math.sqrt(value) if each.is_variance and value >= 0 else value for value in (each.a, each.b))
    yield from (each.estimator, each.beams, each.label, str(each.runs), format_number(a), format_number(b))
    yield f"{b / a:.3g}" if a and math.isfinite(a) and math.isfinite(b) else "-"
    yield "-" if each.adjusted != each.adjusted else f"{each.adjusted:.2g}"
    if each.change.value == 0 and each.p == 1.0:
        yield "the same"
    else:
        yield ("B is larger" if b > a else "B is smaller") if each.significant else "no difference seen"


def _brief(value: object) -> str:
    text = str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
