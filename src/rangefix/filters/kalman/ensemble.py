"""The ensemble Kalman filter with perturbed readings (Evensen, 1994; Burgers, van Leeuwen and Evensen, 1998).

Own code and not filterpy's, which draws from numpy's global random state: no run could be repeated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from ...arrays import LOG_TWO_PI, Array, keep_whole
from ...thread_pools import with_blas_on_one_thread
from ..estimate import BriefRepr, Estimate
from ..images import IMAGE_DRAWS, image_of_points, image_rng
from ..measurement import check_measurement, controls_of_runs, count_runs, impossible_runs
from ..models.wrapped_noise import reading_bias
from ..optional_methods import Image
from ..problem import Prior, Problem
from ..sampling import weighted_draws
from ..space import is_definite
from .belief import check_joint_beams, refuse_noise
from .no_returns import is_counted, log_besides_innovation


@dataclass(frozen=True, repr=False)
class EnsembleBelief(BriefRepr):
    """Members of equal weight, and what the readings said.

    Attributes:
        members: (M, N, n).
        log_evidence: (M,).
    """

    members: Array
    log_evidence: Array


@dataclass(frozen=True, repr=False)
class EnsembleKalmanFilter(BriefRepr):
    """The Kalman gain from sample covariances, applied to every member with a perturbed reading of its own.

    A beam that was not measured, has no return, or has none for some member, is left out; a missing return
    counts in the evidence, with its mean probability over the members. A run whose new
    members would have no covariance (not finite, or all of them on one line) keeps the old ones, and is
    flagged by a log evidence of -inf.

    Args:
        problem: What may be known.
        members: How many, N; more than the state has components.

    Raises:
        ValueError: If there are too few members, more than 4000 beams, or noise without a variance.
    """

    problem: Problem
    members: int = 1000

    def __post_init__(self) -> None:
        size = self.problem.space.size
        keep_whole(self, "members", size + 1)
        refuse_noise(self.problem.sensor)
        check_joint_beams(self.problem)

    def init(self, prior: Prior, rngs: Sequence[Generator]) -> EnsembleBelief:
        """N draws from the prior for every run.

        Raises:
            ValueError: If there is no run.
        """
        runs = count_runs(rngs)
        return EnsembleBelief(np.stack([prior.sample(self.members, rng) for rng in rngs]), np.zeros(runs))

    def predict(self, belief: EnsembleBelief, control: Array, rngs: Sequence[Generator]) -> EnsembleBelief:
        """Every member moved with noise of its own; control (k,) shared, or (M, k).

        Raises:
            ValueError: If the control is of another shape, or not of real numbers.
        """
        controls = controls_of_runs(control, len(rngs))
        moved = map(self.problem.motion.sample, belief.members, controls, rngs)
        return EnsembleBelief(np.stack(list(moved)), belief.log_evidence)

    @with_blas_on_one_thread
    def update(self, belief: EnsembleBelief, measurement: Array, rngs: Sequence[Generator]) -> EnsembleBelief:
        """Condition on measurements (M, B) in metres; what is not finite adds to the evidence at most.

        Raises:
            ValueError: If the measurement is not of shape (M, B) or not of real numbers.
        """
        measurement = check_measurement(self.problem.sensor, measurement, len(belief.members))
        with np.errstate(over="ignore", invalid="ignore"):  # readings so far off that squares overflow
            moved, gains = zip(*map(self._update_run, belief.members, measurement, rngs), strict=True)
            after = EnsembleBelief(np.stack(moved), belief.log_evidence + np.array(gains))
            lost = ~np.isfinite(gains) | ~np.isfinite(after.members).all((1, 2))
            lost |= impossible_runs(self.problem.sensor, measurement)
            flat = ~is_definite(self.estimate(after).covariance)
            lost |= flat & is_definite(self.estimate(belief).covariance) if flat.any() else flat
        if not lost.any():
            return after
        members = np.where(lost[:, None, None], belief.members, after.members)
        return EnsembleBelief(members, np.where(lost, -np.inf, after.log_evidence))

    @with_blas_on_one_thread
    def estimate(self, belief: EnsembleBelief) -> Estimate:
        """Mean (M, n) and unbiased covariance (M, n, n) of the members, and log evidence (M,)."""
        weights = np.full(belief.members.shape[:2], 1.0 / self.members)
        mean, covariance = self.problem.space.moments(belief.members, weights)
        return Estimate(mean, covariance * (self.members / (self.members - 1)), belief.log_evidence)

    def sample(self, belief: EnsembleBelief, size: int, rngs: Sequence[Generator]) -> Array:
        """Members, drawn with equal probability and spread to the unbiased covariance, (M, size, n)."""
        space, weights = self.problem.space, np.full(belief.members.shape[:2], 1.0 / self.members)
        mean = space.moments(belief.members, weights)[0][:, None, :]
        drawn = weighted_draws(belief.members, weights, size, rngs)
        wider = np.sqrt(self.members / (self.members - 1))
        return space.wrap(mean + wider * space.difference(drawn, mean))

    def density(self, belief: EnsembleBelief, run: int) -> Image:
        """Draws from a run's belief counted in pixels, for pictures."""
        alone = EnsembleBelief(belief.members[[run]], belief.log_evidence[[run]])
        return image_of_points(self.sample(alone, IMAGE_DRAWS, [image_rng()])[0], self.problem)

    def _update_run(self, members: Array, reading: Array, rng: Generator) -> tuple[Array, float]:
        """One run's members (N, n) after its reading (B,), and log N(innovation; 0, S)."""
        sensor, space = self.problem.sensor, self.problem.space
        expected = sensor.expected(members)
        used = np.isfinite(reading) & np.isfinite(expected).all(0)
        if not used.any():
            return members, self._missing_returns(members, reading)
        centre = np.where(used, expected, 0.0).mean(0)
        noise = sensor.noise.variance(centre)[used]
        expected, freedom = expected[:, used], self.members - 1
        mean, _ = space.moments(members, np.full(self.members, 1.0 / self.members))
        off = expected - expected.mean(0)
        spread = off.T @ off / freedom + np.diag(noise)
        cross = space.difference(members, mean).T @ off / freedom
        unbiased = reading[used] - reading_bias(sensor.noise)
        perturbed = unbiased + np.sqrt(noise) * rng.standard_normal(expected.shape)
        innovation = unbiased - expected.mean(0)
        try:
            moved = space.wrap(members + np.linalg.solve(spread, (perturbed - expected).T).T @ cross.T)
            square = innovation @ np.linalg.solve(spread, innovation)
        except np.linalg.LinAlgError:
            return members, -np.inf
        log_determinant = np.linalg.slogdet(spread)[1]
        log_density = float(-0.5 * (square + log_determinant + len(innovation) * LOG_TWO_PI))
        log_density += float(np.sum(log_besides_innovation(sensor.noise, centre, used)))
        return moved, log_density + self._missing_returns(moved, reading)

    def _missing_returns(self, members: Array, reading: Array) -> float:
        """Log probability of readings (B,) that are inf or -inf, each by the mean over the members (N, n)."""
        sensor = self.problem.sensor
        counted = is_counted(sensor, reading)
        if not counted.any() or not np.isfinite(members).all():
            return 0.0
        logs = sensor.beam_log_density(reading, sensor.expected(members))[:, counted]
        return float((np.logaddexp.reduce(logs, axis=0) - np.log(self.members)).sum())
