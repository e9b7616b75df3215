"""One row of the comparison table, and its CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from ...arrays import Array
from ..results import FAILURES
from .intervals import Interval, uniform_p_value


class ClaimScores(NamedTuple):
    """Mean scores of what is claimed, N(mean, P); lower is better, but for the evidence. See `scores.py`.

    log: Minus log density of the Gaussian claim at the truth, nats.
    energy: Energy score of the Gaussian claim of the position, m; NaN where x1 or x2 is not estimated.
    crps: Continuous ranked probability score of the Gaussian claim of each component, m or rad.
    evidence: Mean log evidence of the measurements up to this step, nats: HIGHER is better. It judges the
        estimator's prediction of measurements, not of the state; NaN where the estimator gives none.
    """

    log: Interval
    energy: Interval
    crps: tuple[Interval, ...]
    evidence: Interval


class BeliefSummary(NamedTuple):
    """What draws from the beliefs themselves come to, whatever their shape. See `belief_scores.py`.

    energy: Mean energy score of the position, m.
    crps: Mean continuous ranked probability score of each component, m or rad.
    whole: Mean variance of the whole belief in each component, m^2 or rad^2.
    mode: Mean variance of its main mode alone.
    share: Mean share of the main mode.
    ranks: How often the truth has each rank among the draws, in equal bins; a row for each component and one
        for the distance from the middle of the belief, (n + 1, bins).
    """

    energy: Interval
    crps: tuple[Interval, ...]
    whole: tuple[Interval, ...]
    mode: tuple[Interval, ...]
    share: Interval
    ranks: Array


@dataclass(frozen=True)
class Row:
    """One estimator on one set of beams at one step: what it claims against what is true.

    Averages are over the `ok` of the `planned` runs; lengths in metres, angles in rad, variances in m^2 or
    rad^2. Tuples hold one interval (value, low, high; 95 %) for each component of the state.

    Attributes:
        estimator, beams: Labels.
        step: Number of the measurement, from 0.
        names: Names of the components.
        planned, ok: Runs planned, and runs that went well.
        failures: Runs by status other than "ok": diverged, nan, timeout, error, skipped.
        G: Unconditional covariance E[(x - x^)(x - x^)'], (n, n).
        P: Mean of the claimed (conditional) covariances, (n, n).
        g, p: Diagonals of G and P.
        ratio: G_ii / P_ii, paired: 1 = honest, above 1 = overconfident.
        bias: Mean error x - x^.
        anees: Average normalised estimation error squared over n: 1 = honest; inf if a P is not positive.
        anees_band: Reference only: where it would lie for Gaussian posteriors (chi-square).
        nci, inclination: Noncredibility and inclination index of Li and Zhao, dB.
        coverage: Level of ellipse -> share of runs inside it.
        indefinite: Share of ok runs whose P is not positive definite.
        diverged: Share of planned runs in which no hypothesis explained the measurement.
        improbable: Share of ok runs whose evidence lies below the floor.
        scores: Of the Gaussian claims.
        seconds: Per update and run, from a serial pass; NaN if not timed.
        p_values: Figure -> p-value against an honest estimator: see `intervals.py`.
        one_truth: Whether all runs have the same true state: an exact Bayesian filter is honest on average
            over its prior, and need not be at one place of it.
        beliefs: What draws from the beliefs come to; None where they were not sampled.
    """

    estimator: str
    beams: str
    step: int
    names: tuple[str, ...]
    planned: int
    ok: int
    failures: dict[str, int]
    G: Array
    P: Array
    g: tuple[Interval, ...]
    p: tuple[Interval, ...]
    ratio: tuple[Interval, ...]
    bias: tuple[Interval, ...]
    anees: Interval
    anees_band: tuple[float, float]
    nci: Interval
    inclination: Interval
    coverage: dict[float, Interval]
    indefinite: Interval
    diverged: Interval
    improbable: Interval
    scores: ClaimScores
    seconds: float
    p_values: dict[str, float] = field(default_factory=dict)
    one_truth: bool = False
    beliefs: BeliefSummary | None = None

    @property
    def rmse(self) -> tuple[Interval, ...]:
        """Root mean square error of each component, sqrt G_ii, with its interval."""
        return tuple(interval.sqrt() for interval in self.g)

    def flat(self) -> dict[str, str | int | float]:
        """The row as columns: name -> value, with `_low` and `_high` beside each figure that has them."""
        row: dict[str, str | int | float] = {
            "estimator": self.estimator,
            "beams": self.beams,
            "step": self.step,
            "planned": self.planned,
            "ok": self.ok,
        }
        row.update({status: self.failures.get(status, 0) for status in FAILURES})
        for name, interval in self._figures():
            row |= {name: interval.value, f"{name}_low": interval.low, f"{name}_high": interval.high}
        row |= {"anees_gauss_low": self.anees_band[0], "anees_gauss_high": self.anees_band[1]}
        for i, one in enumerate(self.names):
            for j, other in enumerate(self.names[:i]):
                row |= {f"G_{other}_{one}": float(self.G[j, i]), f"P_{other}_{one}": float(self.P[j, i])}
        row |= {"seconds_per_update": self.seconds}
        if self.beliefs is not None:
            names = [f"belief_rank_p_{name}" for name in (*self.names, "distance")]
            row |= dict(zip(names, map(uniform_p_value, self.beliefs.ranks), strict=True))
        return row

    def _figures(self) -> Iterator[tuple[str, Interval]]:
        by_component = {"G": self.g, "P": self.p, "ratio": self.ratio, "rmse": self.rmse, "bias": self.bias}
        for what, intervals in by_component.items():
            yield from self._named(what, intervals)
        yield from (("anees", self.anees), ("nci_db", self.nci), ("inclination_db", self.inclination))
        yield from ((f"coverage_{level * 100:g}", interval) for level, interval in self.coverage.items())
        yield "share_indefinite", self.indefinite
        yield "share_diverged", self.diverged
        yield "share_improbable", self.improbable
        yield from (("log_score", self.scores.log), ("energy_score", self.scores.energy))
        yield from self._named("crps", self.scores.crps)
        yield "log_evidence", self.scores.evidence
        if self.beliefs is not None:
            yield "belief_energy_score", self.beliefs.energy
            yield from self._named("belief_crps", self.beliefs.crps)
            yield from self._named("belief_P", self.beliefs.whole)
            yield from self._named("belief_main_mode_P", self.beliefs.mode)
            yield "belief_main_mode_share", self.beliefs.share

    def _named(self, what: str, intervals: Sequence[Interval]) -> Iterator[tuple[str, Interval]]:
        return ((f"{what}_{name}", each) for name, each in zip(self.names, intervals, strict=True))


def to_csv(rows: Sequence[Row]) -> str:
    """The rows as CSV text with a header; floats in full. A figure that a row does not have is nan."""
    lines = [row.flat() for row in rows]
    text = io.StringIO()
    columns = dict.fromkeys(name for line in lines for name in line)
    writer = csv.DictWriter(text, list(columns), restval="nan", lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    return text.getvalue()
