"""Who is more accurate on the same truths: the estimators of one study, compared run by run."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...arrays import Array
from ...errors import counted
from ..consistency.intervals import Interval, Moments
from ..consistency.summarise import summarise
from ..results import Results, Trials
from .compare import LEVEL


@dataclass(frozen=True)
class PairedComparison:
    """An estimator beside the most accurate one, on one set of beams, after the last measurement.

    Attributes:
        beams: Label of the set.
        best: The estimator with the smallest mean squared error of the position, over the runs that all
            answered of those that answered in half as many as any.
        estimator: The other.
        runs: Runs in which both gave an answer.
        best_rmse, rmse: Root mean squared error of the position of each over these runs, m.
        change: Mean squared error of the other minus that of the best, with its 95 % interval, m^2.
        closer: Share of these runs in which the other was the closer one.
        p: Two-sided p-value of "both are equally accurate", by the mean of the differences run by run; after
            Bonferroni's correction for all pairs on this set, for the best was chosen by the same runs. NaN
            where the runs do not say.
    """

    beams: str
    best: str
    estimator: str
    runs: int
    best_rmse: float
    rmse: float
    change: Interval
    closer: float
    p: float

    @property
    def significant(self) -> bool:
        """Whether the difference is more than chance."""
        return self.p < LEVEL

    @property
    def words(self) -> str:
        """What it comes to, in plain words."""
        if not self.runs:
            return "no run in which both answered"
        if not self.significant:
            return f"no difference from {self.best} seen in {counted(self.runs, 'run')}"
        than = f"{'more' if self.change.value < 0 else 'less'} accurate than {self.best}"
        if not 0 < self.best_rmse < np.inf or not np.isfinite(self.rmse):
            return than
        return f"{than}: its error is {self.rmse / self.best_rmse:.3g} times as large"


def compare_estimators(results: Results) -> list[PairedComparison]:
    """Each estimator beside the most accurate one on the same truths and noise, by sets of beams.

    Only the position counts. A run in which one of the two gave no answer is in neither figure: see the
    share of runs that failed beside it.
    """
    return [pair for beams in results.beam_sets for pair in _pairs(results, beams)]


def _pairs(results: Results, beams: str) -> Iterator[PairedComparison]:
    best = _most_accurate(results, beams)
    pairs = len(results.estimators) * (len(results.estimators) - 1) / 2
    for other in results.estimators:
        if best is not None and other != best:
            yield _pair(results, beams, best, other, pairs)


def _most_accurate(results: Results, beams: str) -> str | None:
    """See `PairedComparison.best`; by its own runs, if none is answered by all these. None if none is at all.

    One that fails where it is hard would seem the best by its own runs.
    """
    rows, where = summarise(results), results.space.position_indices
    end = max(row.step for row in rows)
    rows = [row for row in rows if row.beams == beams and row.step == end and row.ok]
    most = max((row.ok for row in rows), default=0)
    labels = [row.estimator for row in rows if 2 * row.ok >= most]
    sums, count = np.zeros(len(labels)), 0
    for first, last in results.blocks() if labels else ():
        truth = results.source.world(first, last)[0]
        trials = [results.source.trials(label, beams, first, last) for label in labels]
        answered = np.logical_and.reduce([each.ok for each in trials])
        count += int(answered.sum())
        sums += [_squared_errors(results, truth, each)[answered].sum() for each in trials]
    if not count:
        sums = np.array([row.G[where, where].sum() for row in rows if row.estimator in labels])
    return labels[int(sums.argmin())] if labels else None


def _pair(results: Results, beams: str, best: str, other: str, pairs: float) -> PairedComparison:
    apart, count, closer = Moments(), 0, 0
    sums = np.zeros(2)
    for first, end in results.blocks():
        truth = results.source.world(first, end)[0]
        trials = [results.source.trials(label, beams, first, end) for label in (best, other)]
        both = trials[0].ok & trials[1].ok
        squares = np.stack([_squared_errors(results, truth, each)[both] for each in trials])
        count += int(both.sum())
        closer += int((squares[1] < squares[0]).sum())
        sums += squares.sum(1)
        if both.any():
            apart.add(squares[1] - squares[0])
    if not count:
        nothing = Interval(np.nan, np.nan, np.nan)
        return PairedComparison(beams, best, other, 0, np.nan, np.nan, nothing, np.nan, np.nan)
    rmse, other_rmse = np.sqrt(sums / count)
    change = apart.interval(signed=True)
    p = float(np.minimum(1.0, apart.p_value_of_no_difference() * pairs))
    figures = (float(rmse), float(other_rmse), change, closer / count, p)
    return PairedComparison(beams, best, other, count, *figures)


def _squared_errors(results: Results, truth: Array, trials: Trials) -> Array:
    """Squared distance of the estimated position from the true one after the last measurement, m^2, (M,)."""
    error = results.space.difference(truth[:, -1], trials.mean[:, -1])
    return np.asarray((error[:, results.space.position_indices] ** 2).sum(1))
