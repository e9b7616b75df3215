"""How the figures of an estimator would scatter if each truth were a draw from its belief.

That is what an exact Bayesian filter claims, whatever the shape of its beliefs: the truth and independent
draws from the belief can be exchanged. So draws are put in the place of the truths, and the sums over runs
that they give have the distribution of the sum that the truths give, long tails, rare far modes and all (a
parametric bootstrap: Davison and Hinkley, Bootstrap Methods and their Application, 1997, section 4.2). Ranks
of the truth among the draws are uniform (Talts et al., 2018).

Runs are added up in groups, so that no more memory is taken than for the sums of some dozen runs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...arrays import Array, BoolArray, IntArray, sum_terms
from ..results import KEPT_DRAWS, HalfArray, Whitening
from ..results.draws import FARTHEST
from .belief_scores import rank_histogram
from .intervals import LEVEL, Interval, Moments, uniform_p_value
from .scores import SLAB

if TYPE_CHECKING:
    from .metrics import RunBlock

GROUPS = 32  # of runs whose sums are drawn together; 39 draws each make 39^32 studies
REPEATS = 4000  # studies that are drawn
COUNTED = 2  # of them at least beyond a figure, or its p-value is that of a gamma law with the same moments
COHERENT = 0.05  # by how much draws' squared distances may differ from those claimed, however sure it is
INCOHERENT_P = 0.001  # p-value below which they do not differ by chance
SUM_ROUNDING = 1e-9  # of a figure: sums of the same numbers in another order differ by less
LARGE_FACTOR = 1.5  # ANEES / n beyond it, or its inverse, is no longer "a little"; intervals must tell it
FAR = 5.0  # claimed deviations from the estimate, beyond which errors are far
RAREST = 0.002  # share of a far mode that verdicts reckon with
SEEN = 2100  # draws, or runs, among which it occurs but for 1.5 %: ln(0.015) / ln(1 - RAREST)


class Scatter(NamedTuple):
    """Where a figure would lie if truths were draws from the beliefs.

    Attributes:
        below, above: How probable a figure as small, as large is.
        scores: How far the figure of each of 39 studies, whose truths are draws, and at last that of the
            truths themselves, lies from the mean of all 40, in their standard deviations.
    """

    below: float
    above: float
    scores: Array

    @property
    def p_value(self) -> float:
        """Two-sided."""
        return min(1.0, 2 * min(self.below, self.above))


class FarErrors(NamedTuple):
    """What beliefs hold more than `FAR` claimed deviations from their means.

    Attributes:
        share: Of the squared distances that they claim.
        expected, found: How many truths lie there by the beliefs, and how many do.
    """

    share: float
    expected: float
    found: int


@dataclass(frozen=True)
class NullDistribution:
    """What draws from the beliefs of all runs say of the figures of a row.

    Attributes:
        draws: How many there are in all.
        claimed: NEES / n of the draws themselves, with its 95 % interval: 1 where beliefs have the
            covariance that is claimed.
        claimed_p: p-value of "it is 1".
        scatter: Figure -> where it would lie: "anees", "ratio_NAME", "bias_NAME".
        least, most: Between which ANEES / n would lie in 95 % of studies: of all such ranges that with the
            least ratio, for a rare far mode can make ANEES many times larger, but not as much smaller.
        near: Whether errors that count as no more than `FAR` deviations tell that claims are not off by
            `LARGE_FACTOR`, either way: draws whose squared distances are multiplied, or divided, by it would
            give as much, or as little, in less than 2.5 % of studies.
        far: What lies beyond.
        ranks: How often the truth has each rank among the draws, in ten equal bins; a row for each component
            and one for the distance from the estimate, (n + 1, 10).
    """

    draws: int
    claimed: Interval
    claimed_p: float
    scatter: Mapping[str, Scatter]
    least: float
    most: float
    near: bool
    far: FarErrors
    ranks: Array

    @property
    def coherent(self) -> bool:
        """Whether the draws have the covariance that is claimed, as far as they tell.

        Too small a one is no evidence unless a rare far mode would have been drawn.
        """
        value = self.claimed.value
        apart = abs(value - 1) > COHERENT and self.claimed_p < INCOHERENT_P
        return not (apart and (value > 1 or self.draws >= SEEN))

    def range_of(self, anees: float) -> Interval:
        """ANEES / n, and by which factors all claims may be off for it to be what it is, at 95 %."""
        low = anees / self.most if self.most else 0.0
        return Interval(anees, low, anees / self.least if self.least else math.inf)

    @property
    def rank_p_values(self) -> list[float]:
        """p-values of even ranks, for each component and the distance; NaN with fewer than 50 runs."""
        return [uniform_p_value(counts) for counts in self.ranks]


class NullSums:
    """Adds up, block by block, what each draw would give in the truth's place."""

    def __init__(self, names: tuple[str, ...]) -> None:
        size = len(names)
        self.names, self.runs = names, 0
        self.sums = np.zeros((GROUPS, KEPT_DRAWS, 3 + 2 * size))
        self.near, self.found, self.far = 0.0, 0, np.zeros(3)
        self.ranks = np.zeros((size + 1, 10))
        self.claimed = Moments()
        self.rounding = np.zeros(1 + 2 * size)  # what truths rounded as draws would add to the sums
        self._lots = np.random.default_rng(0)  # the same in every process

    def add(self, block: RunBlock) -> None:
        """Add the runs of a block that have draws."""
        if block.draws is None:
            return
        drawn: BoolArray = np.asarray(np.isfinite(block.draws).all((1, 2)))
        for first in range(0, len(drawn), SLAB):
            runs = np.flatnonzero(drawn[first : first + SLAB]) + first
            self._add(block, runs)

    def _add(self, block: RunBlock, runs: IntArray) -> None:
        assert block.draws is not None
        size, errors, whitening = len(self.names), block.errors[runs], Whitening.of(block.covariance[runs])
        truths = whitening.keep(errors[:, None])
        kept = np.concatenate([block.draws[runs], truths], axis=1)
        placed = whitening.placed(kept)  # the draws, and at last the truth, rounded as they are
        squared = block.correlation_axes.take(runs).nees(placed) / size
        offsets, rounded = placed[:, :-1], placed[:, -1]
        squares = np.where(np.isfinite(squared), squared, 0.0)[:, :-1]  # a claim of certainty, judged as such
        limit = FAR**2 / size
        bounded = [np.minimum(squares * by, limit) for by in (LARGE_FACTOR, 1 / LARGE_FACTOR)]
        columns = np.moveaxis(offsets, -1, 0)
        figures = np.stack([squares, *bounded, *columns, *columns**2])
        whole = len(runs) - len(runs) % GROUPS
        totals = figures[:, :whole].reshape(len(figures), -1, GROUPS, KEPT_DRAWS).sum(1)
        totals[:, : len(runs) - whole] += figures[:, whole:]
        self.sums[(self.runs + np.arange(GROUPS)) % GROUPS] += np.moveaxis(totals, 0, -1)
        self.runs += len(runs)
        self.claimed.add(squares.mean(1))
        true = block.nees[runs] / size
        beyond = squares > limit
        self.far += beyond.sum() / KEPT_DRAWS, squares[beyond].sum(), squares.sum()
        self.near += float(np.minimum(true, limit).sum())
        self.found += int((true > limit).sum())
        self._rank(kept, placed, certain=~np.isfinite(true))
        sound = (np.abs(truths) < FARTHEST).all((1, 2)) & np.isfinite(true)
        off = np.column_stack([squared[:, -1] - true, rounded - errors, rounded**2 - errors**2])
        self.rounding += off[sound].sum(0)

    def _rank(self, kept: HalfArray, offsets: Array, certain: BoolArray) -> None:
        """Count ranks of truths, the last of the draws as they are kept and placed, (k, S + 1, n).

        Truths are rounded as draws are, and where they are equal then their places are drawn: beside draws
        that rounding has spread, modes narrower than its steps would have them in their middle too often.
        Of a claim of certainty that errs, (k,), the truth is farther than any draw.
        """
        distances = sum_terms(column.astype(float) ** 2 for column in np.moveaxis(kept, -1, 0))
        distances[certain, -1] = np.inf
        lots = self._lots.random((len(kept), len(self.ranks))).T  # run by run, whatever the blocks
        for place, values in enumerate((*np.moveaxis(offsets, -1, 0), distances)):
            below = (values[:, :-1] < values[:, -1:]).sum(1)
            equal = (values[:, :-1] == values[:, -1:]).sum(1)
            ranks = np.floor(below + lots[place] * (equal + 1))
            self.ranks[place] += rank_histogram(ranks, KEPT_DRAWS)

    def distribution(self, figures: Mapping[str, Interval], claims: Array) -> NullDistribution | None:
        """What the sums say of the figures of a row; None without draws.

        Args:
            figures: Figure -> its interval.
            claims: Mean claimed variance of each component, (n,).
        """
        if not self.runs:
            return None
        groups = self.sums[: min(GROUPS, self.runs)]
        studies = np.zeros((REPEATS, groups.shape[-1]))
        for drawn, chosen in zip(groups, _choices(len(groups)), strict=True):
            studies += drawn.take(chosen, axis=0)
        studies, few = studies / self.runs, groups.sum(0) / self.runs
        middle = studies.mean(0)
        studies = middle + np.sqrt(1 + 1 / KEPT_DRAWS) * (studies - middle)  # the middle is one of 39 draws
        size = len(self.names)
        rounding = self.rounding / self.runs
        for sums in (studies, few):
            sums[:, 3 + size :] /= np.where(claims > 0, claims, 1.0)
        rounding[1 + size :] /= np.where(claims > 0, claims, 1.0)
        names = ["anees", *(f"bias_{name}" for name in self.names), *(f"ratio_{name}" for name in self.names)]
        places = [0, *range(3, 3 + 2 * size)]
        scatter = {
            name: _scatter(studies[:, place], few[:, place], figures[name].value + off)
            for name, place, off in zip(names, places, rounding, strict=True)
        }
        p = self.claimed.p_value_of_mean(1.0)
        least, most = _narrowest(np.maximum(studies[:, 0], 0.0))
        tail = 100 * (1 - LEVEL) / 2
        too_much, too_little = np.percentile(studies[:, 1], tail), np.percentile(studies[:, 2], 100 - tail)
        expected, far, whole = map(float, self.far)
        return NullDistribution(
            draws=self.runs * KEPT_DRAWS,
            claimed=self.claimed.interval(),
            claimed_p=p,
            scatter=scatter,
            least=least,
            most=most,
            near=bool(too_little < self.near / self.runs < too_much),
            far=FarErrors(far / whole if whole else 0.0, expected, self.found),
            ranks=self.ranks,
        )


@lru_cache(maxsize=GROUPS)
def _choices(groups: int) -> IntArray:
    """Which draw each group has in each of the repeats, (groups, REPEATS); the same in every process."""
    chosen = np.random.default_rng(0).integers(KEPT_DRAWS, size=(REPEATS, groups))
    return np.ascontiguousarray(chosen.T)


def _narrowest(drawn: Array) -> tuple[float, float]:
    """The range that holds 95 % of some numbers, none negative, and whose ends have the least ratio."""
    ordered = np.sort(drawn)
    count = math.ceil(LEVEL * len(ordered))
    lows, highs = ordered[: len(ordered) - count + 1], ordered[count - 1 :]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.where(lows > 0, highs / lows, np.inf)
    first = int(ratios.argmin())
    return float(lows[first]), float(highs[first])


def _scatter(drawn: Array, few: Array, value: float) -> Scatter:
    """Where a figure lies among those of studies that are drawn, and of few that share no draw."""
    if not math.isfinite(value):
        scores = np.append(np.zeros(len(few)), value)
    else:
        every = np.append(few, value)
        spread = float(every.std())
        scores = (every - every.mean()) / (spread or 1.0)
    return Scatter(_tail(-drawn, -value), _tail(drawn, value), scores)


def _tail(drawn: Array, value: float) -> float:
    """Probability of a value as large, from draws; beyond most of them by the gamma law of their moments."""
    from scipy.special import gammainc, gammaincc, ndtr

    if value != value:
        return float("nan")
    beyond = int((drawn >= value - SUM_ROUNDING * abs(value)).sum())
    counted = (1 + beyond) / (1 + len(drawn))
    if beyond >= COUNTED or (spread := float(drawn.std())) == 0.0:
        return counted
    if value == np.inf:
        return 0.0
    middle = float(drawn.mean())
    away, scores = (value - middle) / spread, (drawn - middle) / spread
    skewness = float((scores * scores * scores).mean())  # as a power it takes ten times as long
    if abs(skewness) < 0.02:
        return min(counted, float(ndtr(-away)))
    shape = 4 / skewness**2
    place = max(shape + np.sign(skewness) * away * np.sqrt(shape), 0.0)
    return min(counted, float((gammaincc if skewness > 0 else gammainc)(shape, place)))
