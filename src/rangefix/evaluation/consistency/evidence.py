"""What speaks against an estimator in a row: p-values that hold for beliefs of any shape.

With draws from the beliefs the p-values are those of the distribution that the beliefs themselves claim.

Without draws only means and covariances are known, and of these:

- Errors that are too LARGE show: Hall's interval holds, for what makes errors large is in the data. Where no
  interval tells because a single run makes the mean: it is k times what is claimed with probability 1 / k at
  most (Markov's inequality).
- Errors that are too SMALL may not be: a far mode that holds 1 % of each belief, 20 deviations off, makes the
  claim five times larger, and in 37 % of studies of 100 runs no truth lies there. But a mode lies in one
  direction. So caution is accused where errors are too small in all directions alike, by Mauchly's test of
  sphericity, or plainly so in each, and there are 20 runs at least: in fewer these tests see no mode. With
  one component, or in a component alone, only from as many runs as would show a mode of 0.2 %.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...arrays import Array
from .intervals import Interval
from .null_distribution import LARGE_FACTOR, SEEN, FarErrors
from .row import Row

ALIKE = 0.5  # p-value of Mauchly's test above which all directions count as alike
PLAIN = 3.0  # standard errors by which every direction must be too small
FEW_FOR_CAUTION = 20  # runs; without draws, of fewer tails of four degrees were called cautious in 9 %
COMPONENT_RUNS = 100  # without draws and with fewer, p-values as small as components need do not hold
SHAPE_OFF = 0.03  # share of truths that must lie elsewhere than believed for the shape to be named
ENOUGH_FAR = 10.0  # far errors to be expected, from which their number tells
FAR_P = 0.005  # one-sided p-value of that number, below which it is not as claimed
MARKOV = 20.0  # ANEES / n from which a single run is evidence


class ShapeFault(NamedTuple):
    """Where truths lie among the draws otherwise than a draw would.

    Attributes:
        name: The component; "" for the distance from the estimate.
        inner: Share of the truths among the lower, or nearer, half of the draws.
        p_value: Of even ranks.
    """

    name: str
    inner: float
    p_value: float


class Family(NamedTuple):
    """Rows of one estimator, among which false alarms are to be as rare as for one row alone.

    Draws of few runs do not show how rare a figure is of which one in a thousand is as large, as each of 30
    rows asks. So the truths must also stand out from 39 studies whose truths are draws: by the figure that
    lies farthest in any row, or by the sum over all rows. By chance each is so for one in 40, whatever the
    shape of the beliefs.

    Attributes:
        rows: How many.
        largest, smallest: Whether ANEES of the truths stands out as too large, as too small.
        component: Whether squared errors in a component do.
        bias: Whether mean errors do.
    """

    rows: int = 1
    largest: bool = True
    smallest: bool = True
    component: bool = True
    bias: bool = True

    @staticmethod
    def of(rows: Sequence[Row]) -> Family:
        """That of some rows; those without draws are held to their level alone."""
        drawn = [row.null.scatter for row in rows if row.null is not None and row.null.coherent]
        if len(rows) == 1 or not drawn:
            return Family(len(rows))
        scores = {name: np.array([scatter[name].scores for scatter in drawn]) for name in drawn[0]}
        components = [each for name, each in scores.items() if name.startswith("ratio_")]
        biases = [each for name, each in scores.items() if name.startswith("bias_")]
        return Family(
            len(rows),
            largest=_stands_out([scores["anees"]]),
            smallest=_stands_out([-scores["anees"]]),
            component=_stands_out([*components, *(-each for each in components)]),
            bias=_stands_out([*biases, *(-each for each in biases)]),
        )


def _stands_out(scores: Sequence[Array]) -> bool:
    """Whether the last of some studies has the greatest of any score, (R, 40), or of its sum over rows."""
    every = np.array(scores)
    return any(part[-1] > part[:-1].max() for part in (every.max(axis=(0, 1)), every.sum(axis=1).max(axis=0)))


@dataclass(frozen=True)
class Evidence:
    """What a row says for and against an estimator.

    Attributes:
        row: The row.
        family: The rows that it is one of.
    """

    row: Row
    family: Family = Family()  # noqa: RUF009 (a tuple)

    @property
    def drawn(self) -> bool:
        """Whether the p-values are those of draws from the beliefs, which have the covariance claimed."""
        return self.row.null is not None and self.row.null.coherent

    @property
    def anees(self) -> Interval:
        """ANEES / n with what the runs alone say of it at 95 %."""
        return self.row.anees if self.row.anees_of_runs is None else self.row.anees_of_runs

    @property
    def factor(self) -> Interval:
        """ANEES / n with what the runs say of it at 95 %, few runs that make most of it included."""
        value, low, high = self.anees
        return Interval(value, float(np.fmax(low, value / MARKOV)) if value > 1 else low, high)

    @property
    def tolerance(self) -> Interval:
        """ANEES / n, and by which factors all claims may be off for it to be what it is, at 95 %."""
        value = self.row.anees.value
        if self.row.null is None or not self.drawn or not math.isfinite(value):
            return self.factor
        return self.row.null.range_of(value)

    @property
    def far(self) -> FarErrors | None:
        """Far errors, where they alone keep the runs from telling and all else agrees; None otherwise.

        Near errors must tell, and far ones either be so small a part of the claims that these would not be
        too large by `LARGE_FACTOR` if there were none, or occur as often as they should.
        """
        from scipy.special import pdtr, pdtrc

        null = self.row.null
        if null is None or not self.drawn or not null.near:
            return None
        share, expected, found = null.far
        tail = min(float(pdtr(found, expected)), float(pdtrc(found - 1, expected)) if found else 1.0)
        occur = expected >= ENOUGH_FAR and tail > FAR_P
        return null.far if occur or share < 1 - 1 / LARGE_FACTOR else None

    @property
    def too_large(self) -> float:
        """One-sided p-value of squared errors as large as these, as a whole; 1 if they are not too large."""
        value, low, _ = self.anees
        if not value > 1:
            return 1.0
        if self.row.null is not None and self.drawn:
            return self.row.null.scatter["anees"].above if self.family.largest else 1.0
        p = self.row.p_values.get("anees", 0.0 if low > 1 else math.nan) / 2
        return float(np.fmin(p, 0.5 / value))

    @property
    def too_small(self) -> float:
        """One-sided p-value of squared errors as small as these, as a whole; 1 if they are not too small."""
        value, _, high = self.anees
        if not value < 1:
            return 1.0
        if self.row.null is not None and self.drawn:
            return self.row.null.scatter["anees"].below if self.family.smallest else 1.0
        return self.row.p_values.get("anees", 0.0 if high < 1 else math.nan) / 2

    @property
    def scatters_about_one(self) -> bool:
        """Whether ANEES / n agrees with 1 as far as its own scatter tells, whatever the beliefs say of it."""
        return self.anees.low <= 1 <= self.anees.high

    @property
    def shows_caution(self) -> bool:
        """Whether errors that are too small cannot be a far mode of the beliefs that did not occur."""
        from scipy.special import chdtr, chdtrc

        runs, found = self.row.ok, self.row.directions
        if self.drawn or runs >= SEEN:
            return True
        size = len(self.row.names)
        if found is None or size == 1 or found[0] <= 0 or runs < FEW_FOR_CAUTION:
            return False
        plain = float(chdtr(runs, runs / (1 + PLAIN * math.sqrt(2 / runs))))
        if chdtr(runs, runs * found[-1]) < plain / self.family.rows:
            return True
        statistic = -runs * float(np.log(found).sum() - size * math.log(found.mean()))
        return bool(chdtrc(size * (size + 1) / 2 - 1, statistic) > ALIKE)

    def ratios(self, level: float) -> dict[str, Interval]:
        """Components whose squared errors are too large or too small, with G over mean P: two-sided level."""
        bound = level / (2 * len(self.row.names))
        shows_caution = self.drawn or self.row.ok >= SEEN
        return {
            name: ratio
            for name, ratio in zip(self.row.names, self.row.ratio, strict=True)
            if self._p_value(f"ratio_{name}") < bound and (ratio.value > 1 or shows_caution)
        }

    def biases(self, level: float) -> dict[str, float]:
        """Components with a mean error; a circular mean may be biased by rights."""
        bound = level / (2 * len(self.row.names))
        return {
            name: bias.value
            for i, (name, bias) in enumerate(zip(self.row.names, self.row.bias, strict=True))
            if name != "heading"
            and max(self._p_value(f"bias_{name}"), self._p_of_bias(i)) < bound
            and not bias.low <= 0 <= bias.high  # errors that are too large have a larger mean by chance
        }

    def shape(self, level: float) -> ShapeFault | None:
        """The component, or distance, in which beliefs most plainly have another shape than the errors."""
        if self.row.null is None or not self.drawn:
            return None
        faults = []
        names = (*self.row.names, "")
        for name, counts, p in zip(names, self.row.null.ranks, self.row.null.rank_p_values, strict=True):
            shares = np.cumsum(counts) / counts.sum()
            off = np.abs(shares - np.arange(1, 11) / 10).max()
            if p < level / len(names) and off >= SHAPE_OFF:
                faults.append(ShapeFault(name, float(shares[4]), p))
        return min(faults, key=lambda fault: fault.p_value, default=None)

    def _p_value(self, figure: str) -> float:
        if self.row.null is not None and self.drawn:
            told = self.family.bias if figure.startswith("bias_") else self.family.component
            return self.row.null.scatter[figure].p_value if told else 1.0
        return self.row.p_values.get(figure, 1.0) if self.row.ok >= COMPONENT_RUNS else 1.0

    def _p_of_bias(self, component: int) -> float:
        """Of a mean error as large beside what is claimed: a far mode that did not occur is no bias."""
        from scipy.special import ndtr

        variance = float(self.row.P[component, component])
        if self.drawn or not variance > 0:
            return 0.0
        away = abs(self.row.bias[component].value) / math.sqrt(variance / self.row.ok)
        return float(2 * ndtr(-away))
