"""Whether claims come out run by run: coverage, PIT or ranks, reliability, as strips of small cells."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...arrays import Array
from ..consistency import calibration
from ..consistency.belief_scores import RANK_DRAWS, rank_histogram
from ..consistency.formatting import factor, format_number, unit
from ..consistency.intervals import Interval
from ..consistency.metrics import RunBlock
from .tables import Cell

EVERY_OTHER = slice(1, None, 2)  # of the levels of a coverage curve: 10, 20, ... 90 %


class StripCell(NamedTuple):
    """One cell of a strip.

    Attributes:
        head: What it is for: a level, a tenth, a claim.
        value: The figure.
        ends: Its interval, if it has one.
        kind: The class that colours it.
        bar: Height of its bar, and of the lower and upper end of the band for the honest, as shares of the
            height of the strip; None where no bar is drawn.
    """

    head: str
    value: str
    ends: str
    kind: str
    bar: tuple[float, float, float] | None = None


class Strip(NamedTuple):
    """A line of cells under a title, with a note that sums them up."""

    title: str
    note: str
    cells: Sequence[StripCell]


def calibration_of(runs: RunBlock) -> list[Strip]:
    """How well the claims and errors of runs agree, where one at least went well."""
    claimed = calibration.coverage_curve(runs.nees, len(runs.names))
    strips = [_coverage("Coverage, %", claimed)]
    if runs.belief is not None:
        levels, ranks = claimed.levels, (runs.belief.distance_rank + 0.5) / (RANK_DRAWS + 1)
        drawn = calibration.curve(ranks, levels, levels)
        strips.append(_coverage("Coverage, % (of the sampled belief)", drawn))
    stds = np.sqrt(np.maximum(runs.variances, 0.0))
    for i, name in enumerate(runs.names):
        if runs.belief is None:
            counts = calibration.histogram(calibration.pit(runs.errors[:, i], stds[:, i]))
            strips.append(_histogram(f"PIT of {name}, %", counts, "pit"))
        else:
            strips.append(_histogram(f"Ranks of {name}, %", rank_histogram(runs.belief.ranks[:, i]), "ranks"))
    for i, name in enumerate(runs.names):
        groups = calibration.reliability(factor(name) * runs.errors[:, i], factor(name) * stds[:, i])
        strips.append(_reliability(f"Reliability of {name}, {unit(name)}", groups))
    return strips


def _coverage(title: str, found: calibration.Curve) -> Strip:
    """The share of truths inside the ellipses of each level."""
    cells = []
    for level, share in zip(found.levels[EVERY_OTHER], found.shares[EVERY_OTHER], strict=True):
        low, high = max(level - found.margin, 0.0), min(level + found.margin, 1.0)
        kind = "" if low <= share <= high else "outside"
        bar = float(share), float(low), float(high)
        cells.append(StripCell(f"{100 * level:.0f}", f"{100 * share:.0f}", "", kind, bar))
    return Strip(title, f"band: level \u00b1 {100 * found.margin:.2g}", cells)


def _histogram(title: str, counts: Array, kind: str) -> Strip:
    """Shares of runs in tenths, with the band that holds them all if the claim is honest."""
    total, bins = float(counts.sum()), len(counts)
    low, high = (end / total for end in calibration.uniform_band(int(total), bins))
    shares = counts / total
    top = 1.08 * max(shares.max(), high)
    wrong = (shares < low) | (shares > high)
    cells = [
        StripCell(
            f"{100 * i // bins}", f"{100 * share:.3g}", "", f"{kind}{' outside' * bool(wrong[i])}",
            (share / top, low / top, high / top),
        )
        for i, share in enumerate(shares)
    ]  # fmt: skip
    note = f"band: {100 * low:.2g} to {100 * high:.2g}; {wrong.sum()} of {bins} outside"
    return Strip(title, note, cells)


def _reliability(title: str, groups: Sequence[calibration.Reliability]) -> Strip:
    """Root mean squared error beside the claimed standard deviation, in groups of runs by that claim."""
    cells = []
    for claimed, true, _ in groups:
        kind = "overconfident" if true.low > claimed else "cautious" if true.high < claimed else "honest"
        cells.append(StripCell(format_number(claimed), *Cell.of(true)[:2], kind))
    above = sum(cell.kind == "overconfident" for cell in cells)
    note = f"the claim, and below it the true error: larger in {above} of {len(groups)} groups of runs"
    return Strip(title, note, cells)


def course(figures: Sequence[tuple[Interval, str]]) -> Strip:
    """ANEES / n after each measurement, each with the class that colours its verdict."""
    cells = [StripCell(str(step), *Cell.of(anees)[:2], kind) for step, (anees, kind) in enumerate(figures, 1)]
    return Strip("ANEES / n after each measurement", "1 is honest", cells)
