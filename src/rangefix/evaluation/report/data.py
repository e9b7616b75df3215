"""What a report shows, worked out from results: rows, verdicts, scores and beliefs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...arrays import Array
from ..consistency import (
    RANK_DRAWS,
    Curve,
    Gate,
    GateLine,
    Reliability,
    Row,
    Verdict,
    check_gates,
    coverage_curve,
    curve,
    decide,
    decide_overall,
    factor,
    histogram,
    nees,
    pit,
    rank_histogram,
    reliability,
)
from ..consistency.summarise import summarise
from ..results import MAX_RUNS_IN_MEMORY, BeliefScores, Results, Trials


@dataclass(frozen=True)
class Setting:
    """One estimator on one set of beams after the last measurement.

    Attributes:
        row: Its row.
        errors, covariance: Of those that went well of the first MOST runs, (M, n) and (M, n, n).
        belief: Measures of its sampled beliefs in those runs; None where it does not sample.
    """

    row: Row
    errors: Array
    covariance: Array
    belief: BeliefScores | None

    @property
    def verdict(self) -> Verdict:
        """The verdict on this setting alone."""
        return decide(self.row)

    @cached_property
    def stds(self) -> Array:
        """Claimed standard deviations, (M, n)."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance, axis1=-2, axis2=-1), 0.0))

    def coverage(self) -> list[tuple[Curve, str]]:
        """The curve of the Gaussian ellipses and, where beliefs were sampled, that of the beliefs."""
        curves = [(coverage_curve(nees(self.errors, self.covariance), self.errors.shape[1]), "claim")]
        if self.belief is not None and len(self.errors):
            levels = curves[0][0].levels
            ranks = self.belief.distance_rank
            curves.append((curve((ranks + 0.5) / (RANK_DRAWS + 1), levels, levels), "belief"))
        return curves

    def histogram(self, component: int) -> tuple[Array, bool]:
        """Counts, and whether they are ranks among samples rather than PIT values of the Gaussian claim."""
        if self.belief is not None:
            return rank_histogram(self.belief.ranks[:, component]), True
        return histogram(pit(self.errors[:, component], self.stds[:, component])), False

    def reliability(self, component: int) -> list[Reliability]:
        """Error against claimed sigma of one component, in the unit in which it is shown."""
        k = factor(self.row.names[component])
        return reliability(k * self.errors[:, component], k * self.stds[:, component])


@dataclass(frozen=True)
class Failures:
    """Why trials of one estimator on one set of beams failed: counts by status, and by reason."""

    estimator: str
    beams: str
    counts: dict[str, int]
    reasons: Counter[str]


@dataclass(frozen=True)
class ReportData:
    """All that a report shows of a study.

    Attributes:
        results: The results.
        rows: All rows: every estimator, set of beams and step.
        settings: After the last measurement, by estimator and set of beams.
        failures: Where there were any.
        lines: What gates made of the rows.
    """

    results: Results
    rows: Sequence[Row]
    settings: dict[tuple[str, str], Setting]
    failures: Sequence[Failures]
    lines: Sequence[GateLine]

    @property
    def steps(self) -> int:
        """Measurements in a run."""
        return 1 + max(row.step for row in self.rows)

    def rows_of(self, estimator: str) -> list[Row]:
        """The rows of an estimator."""
        return [row for row in self.rows if row.estimator == estimator]

    def overall(self, estimator: str) -> Verdict:
        """The verdict on an estimator in all its settings."""
        return decide_overall(self.rows_of(estimator))


def collect(results: Results, gates: Sequence[Gate] = ()) -> ReportData:
    """Work out what a report shows."""
    rows = summarise(results)
    settings, failures = {}, []
    for row in {(row.estimator, row.beams): row for row in rows}.values():  # the last step of each
        trials = results.source.trials(row.estimator, row.beams, 0, min(results.runs, MAX_RUNS_IN_MEMORY))
        settings[row.estimator, row.beams] = _setting(results, trials, row)
        if row.failures:
            failures.append(
                Failures(row.estimator, row.beams, row.failures, Counter(trials.reasons.values()))
            )
    return ReportData(results, rows, settings, failures, check_gates(gates, rows))


def _setting(results: Results, trials: Trials, row: Row) -> Setting:
    ok = trials.ok
    truth = results.source.world(0, len(ok))[0][:, -1]
    errors = results.space.difference(truth, trials.mean[:, -1])[ok]
    covariance = trials.covariance[ok, -1]
    belief = trials.belief(-1)
    if belief is not None and not np.isfinite(belief.energy).all():
        belief = None  # of a folder whose parts were made in part without samples
    return Setting(row, errors, covariance, belief)
