"""Extended and unscented Kalman filters of the library filterpy, one run at a time.

They are the named baselines, and the oracle for `extended` and `unscented`, which do the same for all runs.
A Gaussian filter cannot use a beam without a return, nor one that expects none: such a beam is left out, as
is one that was not measured.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.random import Generator

from ...arrays import LOG_TWO_PI, Array
from ..estimate import Estimate
from ..measurement import check_reading, impossible_runs
from ..models.wrapped_noise import reading_bias
from ..problem import Prior, Problem
from ..sampling import gaussian_draws
from .belief import GaussianBelief, LinearisedOptions, SigmaPointOptions, check_joint_beams
from .no_returns import log_besides_innovation, with_missing_returns


class OneRunFilter:
    """What the Gaussian filters of one run share: where they begin, and what they say."""

    problem: Problem

    def init(self, prior: Prior, rng: Generator) -> GaussianBelief:
        """The prior's mean and covariance."""
        return GaussianBelief(prior.mean, prior.covariance, np.zeros(()))

    def estimate(self, belief: GaussianBelief) -> Estimate:
        """Mean (n,), covariance (n, n) and log evidence."""
        return Estimate(belief.mean, belief.covariance, belief.log_evidence)

    def sample(self, belief: GaussianBelief, size: int, rng: Generator) -> Array:
        """Draws from the Gaussian, angles wrapped, (size, n)."""
        moments = belief.mean[None], belief.covariance[None]
        return np.asarray(gaussian_draws(*moments, size, self.problem.space, [rng])[0])


@dataclass(frozen=True, repr=False)
class FilterpyExtendedKalmanFilter(OneRunFilter, LinearisedOptions):
    """The extended Kalman filter (filterpy), linearised at the mean, or iterated (Bell and Cathey, 1993).

    Args:
        problem: What may be known.
        iterations: How often the measurement is linearised: 1 is the plain filter.

    Raises:
        ValueError: If an option is out of its range, or there are more than 4000 beams.
    """

    def __post_init__(self) -> None:
        LinearisedOptions.__post_init__(self)
        check_joint_beams(self.problem)

    def predict(self, belief: GaussianBelief, control: Array, rng: Generator) -> GaussianBelief:
        """Mean through the motion, covariance through its Jacobian; control (k,)."""
        motion = self.problem.motion
        ekf = _extended(belief, 1)
        ekf.F = motion.jacobian(belief.mean, control)
        ekf.Q = motion.noise_covariance(belief.mean, control)
        ekf.predict()  # its own mean is F x, which is right for linear motion only
        mean = self.problem.space.wrap(motion.mean(belief.mean, control))
        return _checked(belief, mean, ekf.P)

    def update(self, belief: GaussianBelief, measurement: Array, rng: Generator) -> GaussianBelief:
        """Condition on a measurement (B,) in metres; what is not finite adds to the evidence at most.

        Raises:
            ValueError: If the measurement is not of shape (B,) or not of real numbers.
        """
        measurement = check_reading(self.problem.sensor, measurement)
        if impossible_runs(self.problem.sensor, measurement[None]).any():
            return _flagged(belief)
        with np.errstate(over="ignore", invalid="ignore"):  # readings so far off that squares overflow
            return _with_missing_returns(self.problem, self._update(belief, measurement), measurement)

    def _update(self, belief: GaussianBelief, measurement: Array) -> GaussianBelief:
        sensor, space = self.problem.sensor, self.problem.space
        measurement = measurement - reading_bias(sensor.noise)
        point, result = belief.mean, belief
        for _ in range(self.iterations):
            expected = sensor.expected(point)
            used = np.isfinite(measurement) & np.isfinite(expected)
            if not used.any():
                point, result = belief.mean, belief
                continue
            slope = sensor.jacobian(point)[used]
            ahead = expected[used] + slope @ space.difference(belief.mean, point)
            ekf = _extended(belief, int(used.sum()))
            ekf.R = np.diag(sensor.noise.variance(np.where(used, expected, 0.0))[used])
            ekf.update(
                measurement[used],
                HJacobian=lambda _, slope=slope: slope,
                Hx=lambda _, ahead=ahead: ahead,
            )
            point = space.wrap(ekf.x)
            returned = log_besides_innovation(sensor.noise, np.where(used, expected, 0.0), used)
            result = _checked(belief, point, ekf.P, ekf.y, ekf.S, float(returned))
            if not np.isfinite(point).all():
                point = belief.mean
        return result


@dataclass(frozen=True, repr=False)
class FilterpyUnscentedKalmanFilter(OneRunFilter, SigmaPointOptions):
    """The unscented Kalman filter (filterpy; Julier and Uhlmann, 1997; scaling of van der Merwe, 2004).

    Args:
        problem: What may be known.
        alpha: Spread of the sigma points, > 0.
        beta: Weight added to the centre's deviation; 2 suits a Gaussian.
        kappa: Second spread; n + kappa must be positive; 2 - n unless given, n components.

    Raises:
        ValueError: If an option is out of its range, or there are more than 4000 beams.
    """

    def __post_init__(self) -> None:
        SigmaPointOptions.__post_init__(self)
        check_joint_beams(self.problem)

    def predict(self, belief: GaussianBelief, control: Array, rng: Generator) -> GaussianBelief:
        """Sigma points through the motion; control (k,)."""
        motion, space = self.problem.motion, self.problem.space
        ukf = self._unscented(belief, 1)
        ukf.fx = lambda state, _: state + space.difference(motion.mean(state, control), state)
        ukf.Q = motion.noise_covariance(belief.mean, control)
        ukf.predict()
        return _checked(belief, space.wrap(ukf.x), ukf.P)

    def update(self, belief: GaussianBelief, measurement: Array, rng: Generator) -> GaussianBelief:
        """Condition on a measurement (B,) in metres; what is not finite adds to the evidence at most.

        A beam is also left out where any sigma point expects no return.

        Raises:
            ValueError: If the measurement is not of shape (B,) or not of real numbers.
        """
        measurement = check_reading(self.problem.sensor, measurement)
        if impossible_runs(self.problem.sensor, measurement[None]).any():
            return _flagged(belief)
        with np.errstate(over="ignore", invalid="ignore"):  # readings so far off that squares overflow
            try:
                after = self._update(belief, measurement)
            except np.linalg.LinAlgError:
                return _flagged(belief)
            return _with_missing_returns(self.problem, after, measurement)

    def _update(self, belief: GaussianBelief, measurement: Array) -> GaussianBelief:
        sensor, space = self.problem.sensor, self.problem.space
        measurement = measurement - reading_bias(sensor.noise)
        ukf = self._unscented(belief, len(measurement))
        ukf.sigmas_f = ukf.points_fn.sigma_points(belief.mean, belief.covariance)
        expected = sensor.expected(ukf.sigmas_f)
        used = np.isfinite(measurement) & np.isfinite(expected).all(0)
        if not used.any():
            return belief
        rows = iter(expected[:, used])
        centre = _mean_about_first(np.where(used, expected, 0.0), ukf.Wm)
        ukf.update(measurement[used], np.diag(sensor.noise.variance(centre)[used]), hx=lambda _: next(rows))
        returned = float(log_besides_innovation(sensor.noise, centre, used))
        return _checked(belief, space.wrap(ukf.x), ukf.P, ukf.y, ukf.S, returned)

    def _unscented(self, belief: GaussianBelief, beams: int) -> Any:
        from filterpy.kalman import MerweScaledSigmaPoints
        from filterpy.kalman import UnscentedKalmanFilter as Unscented

        size = self.problem.space.size
        kappa = 2.0 - size if self.kappa is None else self.kappa
        points = MerweScaledSigmaPoints(size, self.alpha, self.beta, kappa)
        mean = _mean_about_first  # sigma points are not wrapped: angles need no more than that
        ukf = Unscented(size, beams, 1.0, None, None, points, x_mean_fn=mean, z_mean_fn=mean)
        ukf.x, ukf.P = belief.mean, belief.covariance
        return ukf


def _extended(belief: GaussianBelief, beams: int) -> Any:
    from filterpy.kalman import ExtendedKalmanFilter as Extended

    ekf = Extended(len(belief.mean), beams)
    ekf.x, ekf.P = belief.mean, belief.covariance
    return ekf


def _mean_about_first(sigmas: Array, weights: Array) -> Array:
    """Weighted mean as a step from the first point, so that no large weights cancel."""
    mean: Array = sigmas[0] + weights[1:] @ (sigmas[1:] - sigmas[0])
    return mean


def _with_missing_returns(problem: Problem, belief: GaussianBelief, reading: Array) -> GaussianBelief:
    """A run's belief whose evidence also counts readings that are inf or -inf: see `no_returns`."""
    alone = GaussianBelief(belief.mean[None], belief.covariance[None], np.atleast_1d(belief.log_evidence))
    evidence = with_missing_returns(problem.sensor, alone, reading[None]).log_evidence
    return replace(belief, log_evidence=evidence[0])


def _flagged(belief: GaussianBelief) -> GaussianBelief:
    """The belief from before a measurement that cannot be."""
    return replace(belief, log_evidence=np.array(-np.inf))


def _checked(
    belief: GaussianBelief,
    mean: Array,
    covariance: Array,
    innovation: Array | None = None,
    spread: Array | None = None,
    returned: float = 0.0,
) -> GaussianBelief:
    """The new belief, with log N(innovation; 0, spread) added to its evidence, or the old one flagged.

    And with the log probability that its beams returned.
    """
    covariance = 0.5 * (covariance + covariance.T)
    log_density = 0.0
    try:
        np.linalg.cholesky(covariance)
        if innovation is not None and spread is not None:
            root = np.linalg.cholesky(spread)
            white = np.linalg.solve(root, innovation)
            log_density = -0.5 * (white @ white + len(white) * LOG_TWO_PI) - np.log(np.diagonal(root)).sum()
    except np.linalg.LinAlgError:
        log_density = -np.inf
    if not (np.isfinite(mean).all() and np.isfinite(covariance).all() and np.isfinite(log_density)):
        return _flagged(belief)
    return GaussianBelief(mean, covariance, belief.log_evidence + log_density + returned)
