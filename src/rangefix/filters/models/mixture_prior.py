"""A prior made of priors: one of several."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from ...arrays import TWO_PI, Array, compared_by, keep_copies, read_only
from ...thread_pools import with_blas_on_one_thread
from ..problem import SpacedPrior
from ..space import StateSpace

MAX_SHOWN = 4  # parts that are printed
SHARE_DRAWS = 1 << 16  # for the moments of mixtures with a heading
LEAST_SHARE = 1e-12  # of variances along which a heading is said to follow: what is less is rounding


@compared_by()
@dataclass(frozen=True)
class Mixture:
    """One of several priors, by chance: a room or the next, one way round or the other.

    The moments of components on a line are exact, as far as those of the parts are. Those with the heading
    are found from 65 536 draws from a fixed stream (standard error 0.4 % of a standard deviation), since the
    mean direction of a mixture does not follow from the moments of its parts.

    Args:
        priors: The priors, all over the same space.
        weights: Their probabilities, positive; divided by their sum. Equal unless given.

    Raises:
        ValueError: If there is no prior, they differ in space, or the weights do not fit.
    """

    priors: Sequence[SpacedPrior]
    weights: ArrayLike | None = None

    def __repr__(self) -> str:
        parts = [f"{share:.3g} of {prior!r}" for share, prior in zip(self.shares, self.priors, strict=True)]
        more = [f"and {len(parts) - MAX_SHOWN} more"] if len(parts) > MAX_SHOWN else []
        return "Mixture(" + ",\n    ".join(parts[:MAX_SHOWN] + more) + ")"

    def __post_init__(self) -> None:
        keep_copies(self)
        priors = self.priors
        if not priors or any(prior.space != priors[0].space for prior in priors):
            raise ValueError("a mixture needs priors, one or more, all over the same space")
        weights = np.ones(len(priors)) if self.weights is None else np.array(self.weights, dtype=float)
        if weights.shape != (len(priors),) or not (np.isfinite(weights).all() and (weights > 0).all()):
            raise ValueError(f"{len(priors)} priors need as many positive weights, got {self.weights!r}")

    @cached_property
    def shares(self) -> Array:
        """The weights divided by their sum."""
        weights = np.ones(len(self.priors)) if self.weights is None else np.array(self.weights, dtype=float)
        return read_only(np.asarray(weights / weights.sum()))

    @property
    def mean(self) -> Array:
        """Mean over the parts, (n,)."""
        return self._moments[0]

    @property
    def covariance(self) -> Array:
        """Covariance over the parts and within them, (n, n)."""
        return self._moments[1]

    @property
    def space(self) -> StateSpace:
        """The state space of all parts."""
        return self.priors[0].space

    def sample(self, size: int, rng: Generator) -> Array:
        """Independent draws, each from a part drawn for it, (size, n)."""
        chosen = rng.choice(len(self.priors), size=size, p=self.shares)
        states = np.empty((size, self.space.size))
        for place, prior in enumerate(self.priors):
            drawn = chosen == place
            if drawn.any():
                states[drawn] = prior.sample(int(drawn.sum()), rng)
        return states

    def log_density(self, states: Array) -> Array:
        """Log of the weighted sum of the parts' densities: (..., n) -> (...)."""
        parts = zip(self.shares, self.priors, strict=True)
        return np.asarray(
            np.logaddexp.reduce([np.log(share) + prior.log_density(states) for share, prior in parts], axis=0)
        )

    @cached_property
    @with_blas_on_one_thread
    def _moments(self) -> tuple[Array, Array]:
        means = np.stack([prior.mean for prior in self.priors])
        mean = self.shares @ means
        away = means - mean
        within = np.tensordot(self.shares, np.stack([prior.covariance for prior in self.priors]), 1)
        covariance = within + (away * self.shares[:, None]).T @ away
        if self.space.is_angle.any():
            mean, covariance = self._with_heading(mean, covariance)
        return read_only(mean), read_only(covariance)

    def _with_heading(self, exact_mean: Array, exact: Array) -> tuple[Array, Array]:
        """Moments that are exact but for the heading's, which come from draws.

        The heading follows the others by linear regression of the draws, so that the covariance stays one:
        with the block of the others put in by itself, parts that lie on a line could leave less than zero.

        Args:
            exact_mean, exact: (n,) and (n, n), of which those of the heading are wrong.
        """
        angle = self.space.is_angle
        states = self.sample(SHARE_DRAWS, np.random.default_rng(0))
        mean, drawn = self.space.moments(states, np.full(SHARE_DRAWS, 1 / SHARE_DRAWS))
        block = drawn[np.ix_(~angle, ~angle)]
        stds = np.sqrt(np.diagonal(block))
        scale = np.outer(stds, stds)
        scale[scale == 0] = 1.0
        inverse = np.linalg.pinv(block / scale, rcond=LEAST_SHARE, hermitian=True) / scale
        slope = drawn[np.ix_(angle, ~angle)] @ inverse
        left = drawn[np.ix_(angle, angle)] - slope @ drawn[np.ix_(~angle, angle)]
        gain = np.eye(self.space.size)[:, ~angle]
        gain[angle] = slope
        covariance = gain @ exact[np.ix_(~angle, ~angle)] @ gain.T
        covariance[np.ix_(angle, angle)] += np.maximum(left, 0.0)
        return np.where(angle, mean, exact_mean), 0.5 * (covariance + covariance.T)

    @cached_property
    def support(self) -> tuple[Array, Array]:
        """Corners of the box around all boxes, each (n,); along a circle no longer than the circle."""
        lowers, uppers = (np.stack(ends) for ends in zip(*(p.support for p in self.priors), strict=True))
        angle = self.space.is_angle
        middles = 0.5 * (lowers + uppers)
        shift = np.where(angle, self.space.difference(middles, middles[0]) - (middles - middles[0]), 0.0)
        lower, upper = (lowers + shift).min(0), (uppers + shift).max(0)
        upper = np.where(angle, np.minimum(upper, lower + TWO_PI), upper)
        return read_only(lower), read_only(upper)
