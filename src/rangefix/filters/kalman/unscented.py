"""Unscented and cubature Kalman filters over all runs at once; `filterpy_adapters` is their oracle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from ...arrays import LOG_TWO_PI, Array, BoolArray, sum_terms
from ..measurement import check_control
from ..models.wrapped_noise import reading_bias
from ..problem import Problem, Sensor
from ..space import lower_roots
from .batch import GaussianFilter, accept_definite, condition, refuse_impossible
from .belief import GaussianBelief, SigmaPointOptions
from .no_returns import log_besides_innovation


@dataclass(frozen=True, repr=False)
class UnscentedKalmanFilter(GaussianFilter, SigmaPointOptions):
    """The unscented Kalman filter (Julier and Uhlmann, 1997; scaling of van der Merwe, 2004).

    Sigma points lie alpha sqrt(n + kappa) standard deviations from the mean: sqrt(2) by default, for any n,
    which is well inside the support of a uniform prior (its edge is at sqrt(3)), yet as wide as the belief.
    The alpha = 1e-3 often quoted puts them so close to the mean that the filter sees second differences of
    the ranges there: where the prior is a whole room, a picture of one spot, multiplied by 10^6.

    While beta >= alpha^2 no update can leave a covariance that is not positive definite, for the spread of
    the expected ranges z_k is sum_k>0 w_k d_k d_k' + (beta - alpha^2) c c' with d_k = z_k - z_0, c = sum w d.

    Args:
        problem: What may be known.
        alpha: Spread of the sigma points, > 0.
        beta: Weight added to the centre's deviation; 2 suits a Gaussian.
        kappa: Second spread; n + kappa must be positive; 2 - n unless given, n components.

    Raises:
        ValueError: If an option is out of its range.
    """

    def predict(self, belief: GaussianBelief, control: Array, rngs: Sequence[Generator]) -> GaussianBelief:
        """Sigma points through the motion; control (k,) shared, or (M, k).

        Raises:
            ValueError: If the control is of another shape, or not of real numbers.
        """
        motion, space = self.problem.motion, self.problem.space
        control = check_control(control, len(belief.mean))
        points = _sigma_points(belief.mean, self._arms(belief))
        moved = points + space.difference(motion.mean(points, control), points)
        shift, spread = self._moments(np.moveaxis(moved[1:] - moved[0], 1, -1))
        covariance = np.moveaxis(spread, -1, 0) + motion.noise_covariance(belief.mean, control)
        return accept_definite(belief, space.wrap(moved[0] + shift.T), covariance, np.zeros(len(covariance)))

    def _update(self, sensor: Sensor, belief: GaussianBelief, measurement: Array) -> GaussianBelief:
        """The state is its mean and the arms of the sigma points, each times a random share c_k.

        A beam is also left out of a run where any of its sigma points expects no return.

        Shares have the covariance K = w I + (beta - alpha^2) w^2 1 1', which gives states the belief's
        covariance, and ranges, linear in the shares with slopes d_k, the spread above. So shares can be
        conditioned on one beam after the other, and no matrix is as large as there are beams.
        """
        space, arms = self.problem.space, self._arms(belief)
        expected = sensor.expected(_sigma_points(belief.mean, arms))
        used, readings = np.isfinite(measurement) & np.isfinite(expected).all(0), measurement
        if not used.all():
            expected, readings = np.where(used, expected, 0.0), np.where(used, readings, 0.0)
        slopes = np.ascontiguousarray((expected[1:] - expected[0]).transpose(2, 0, 1))  # (B, 2 n, M)
        centre = expected[0] + (self._weight * sum_terms(slopes.swapaxes(0, 1))).T
        innovation = readings - reading_bias(sensor.noise) - centre
        noise, prior = sensor.noise.variance(centre).T, np.moveaxis(belief.covariance, 0, -1)
        if len(slopes) == 1:
            moved, spread, log_density = self._by_one(
                prior, arms, slopes[0], innovation[:, 0], noise[0], used[:, 0]
            )
        else:
            moved, spread, log_density = self._by_many(arms, slopes, innovation.T, noise, used.T)
        log_density = log_density + log_besides_innovation(sensor.noise, centre, used)
        log_density = refuse_impossible(sensor, measurement, log_density)
        mean, spread = space.wrap(belief.mean + moved.T), np.moveaxis(spread, -1, 0)
        informed = np.asarray(used.any(axis=1))
        if not informed.all():  # the others keep what they have to the last bit
            mean = np.where(informed[:, None], mean, belief.mean)
            spread = np.where(informed[:, None, None], spread, belief.covariance)
        return accept_definite(belief, mean, spread, log_density)

    def _by_one(
        self, prior: Array, arms: Array, slopes: Array, innovation: Array, noise: Array, used: BoolArray
    ) -> tuple[Array, Array, Array]:
        """What one beam says, of slopes (2 n, M), with the rest as for `_by_many`: without shares.

        Args:
            prior: The covariance, (n, n, M).
        """
        both = (slopes[: len(arms)] - slopes[len(arms) :]) * self._weight
        cross = sum_terms(part * arm for part, arm in zip(both, arms, strict=True))
        bend = self._weight * sum_terms(slopes)
        spread = self._weight * sum_terms(slopes * slopes) + (self.beta - self.alpha**2) * bend * bend + noise
        gain, level = 1.0 / spread, np.log(spread) + LOG_TWO_PI
        if not used.all():
            gain, level = np.where(used, gain, 0.0), np.where(used, level, 0.0)
        pull = gain * innovation
        return cross * pull, prior - cross[:, None] * (cross * gain), -0.5 * (innovation * pull + level)

    def _by_many(
        self, arms: Array, slopes: Array, innovation: Array, noise: Array, used: BoolArray
    ) -> tuple[Array, Array, Array]:
        """What beams say, one after the other.

        Args:
            arms: What `_arms` gives, (n, n, M).
            slopes: Of the expected ranges along them, (B, 2 n, M).
            innovation, noise, used: (B, M) each.

        Returns:
            The step of the mean (n, M), the covariance (n, n, M) and the log density (M,).
        """
        size = len(arms)
        shares = np.full((2 * size, 2 * size), (self.beta - self.alpha**2) * self._weight**2)
        shares[np.diag_indices(2 * size)] += self._weight
        prior = np.broadcast_to(shares[:, :, None], (*shares.shape, slopes.shape[2]))
        step, covariance, log_density = condition(prior, slopes, innovation, noise, used)
        moved = sum_terms(share * arm for share, arm in zip(step[:size] - step[size:], arms, strict=True))
        rows = covariance[:size] - covariance[size:]
        inner = rows[:, :size] - rows[:, size:]
        turned = [
            sum_terms(share * arm for share, arm in zip(row, arms, strict=True))
            for row in inner.swapaxes(0, 1)
        ]
        spread = sum_terms(arm[:, None] * row for arm, row in zip(arms, turned, strict=True))
        return moved, spread, log_density

    @property
    def _reach(self) -> float:
        """Squared distance of the sigma points from the mean, in variances."""
        size = self.problem.space.size
        return self.alpha**2 * (2.0 if self.kappa is None else size + self.kappa)

    @property
    def _weight(self) -> float:
        """Weight of each sigma point but the central one."""
        return 0.5 / self._reach

    def _arms(self, belief: GaussianBelief) -> Array:
        """Half of the sigma points, as seen from the mean, (n, n, M): the others are opposite."""
        root = lower_roots(np.moveaxis(belief.covariance, 0, -1))
        return np.asarray(np.sqrt(self._reach) * root.swapaxes(0, 1))

    def _moments(self, off: Array) -> tuple[Array, Array]:
        """Mean (b, M) and covariance (b, b, M) of values given as seen from the central one, (2 n, b, M)."""
        mean = self._weight * sum_terms(off)
        spread = self._weight * sum_terms(z[:, None] * z for z in off)
        return mean, spread + (self.beta - self.alpha**2) * mean[:, None] * mean


def _sigma_points(mean: Array, arms: Array) -> Array:
    """The mean (M, n), and what lies from it along arms (n, n, M) to either side: (2 n + 1, M, n).

    Component by component in memory: numpy is slow on short rows.
    """
    size, middle, sides = len(arms), mean.T[:, None], arms.swapaxes(0, 1)
    points = np.empty((size, 2 * size + 1, len(mean)))
    points[:, :1], points[:, 1 : size + 1], points[:, size + 1 :] = middle, middle + sides, middle - sides
    return np.moveaxis(points, 0, -1)


def cubature(problem: Problem) -> UnscentedKalmanFilter:
    """The cubature Kalman filter (Arasaratnam and Haykin, 2009): sigma points, none at the centre."""
    return UnscentedKalmanFilter(problem, alpha=1.0, beta=0.0, kappa=0.0)
