"""Tables of two results side by side, of the estimators of one, and of what claims cost in fusion."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from rich.table import Table

from ...errors import listed
from ...evaluation import Fusion, PairedComparison
from ...evaluation.comparison.compare import Comparison, Difference
from ...evaluation.consistency.formatting import beams_in_words, format_number, format_percent
from ..screen import new_table
from .study import MAX_NAMED

SHOWN = 40  # lines of a config's diff


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
    a, b = each.shown
    yield from (f"  {each.label_with_unit}", str(each.runs), format_number(a), format_number(b))
    yield f"{b / a:.3g}" if a and math.isfinite(a) and math.isfinite(b) else "-"
    yield "-" if each.adjusted != each.adjusted else f"{each.adjusted:.2g}"
    yield f"B is {each.words}" if each.words in ("larger", "smaller") else each.words


def _brief(value: object) -> str:
    text = str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
