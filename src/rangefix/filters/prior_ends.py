"""Where filters stop covering a Gaussian prior, which has no end, and which posteriors may lie beyond."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from ..arrays import TWO_PI, Array, BoolArray, wrap
from .models.gaussian_prior import REACH, GaussianPrior
from .models.mixture_prior import Mixture
from .models.product_prior import Product, WithHeading
from .models.wrapped_noise import perfect_fit
from .problem import Prior, Sensor
from .space import StateSpace

FAR_REACH = 40.0  # deviations of a Gaussian prior, to where readings that contradict it may lead
LEANING_STDS = 5.0  # of the posterior, to where a prior's box ends: nearer, some of it lies beyond
SPARE_NATS = 40.0  # less than what the prior loses within FAR_REACH: what lies beyond counts for nothing
BY_CHANCE = 1e-6  # how seldom readings fit so badly at the truth that they may fit elsewhere

Answers = tuple[Array, Array, ArrayLike]  # means (M, n), covariances (M, n, n) and log evidences (M,)
Ends = tuple[Array, Array]  # lower and upper ones, (n,) each


@dataclass(frozen=True)
class FarReaching:
    """A prior that says of itself, in `support`, that it goes as far as FAR_REACH; all else is as it was."""

    prior: Prior

    @property
    def mean(self) -> Array:
        """The prior's."""
        return self.prior.mean

    @property
    def covariance(self) -> Array:
        """The prior's."""
        return self.prior.covariance

    @cached_property
    def support(self) -> tuple[Array, Array]:
        """Corners of a box that holds FAR_REACH deviations of its Gaussian parts, (n,) each."""
        return box_of(self.prior, FAR_REACH)

    def sample(self, size: int, rng: Generator) -> Array:
        """Independent draws, (size, n)."""
        return self.prior.sample(size, rng)

    def log_density(self, states: Array) -> Array:
        """Log density: (..., n) -> (...)."""
        return self.prior.log_density(states)


def box_of(prior: Prior, reach: float = REACH) -> Ends:
    """A box that holds a prior, of a Gaussian one so many deviations, as far as its room goes, (n,) each."""
    lower, upper = prior.support
    if isinstance(prior, GaussianPrior) and reach > REACH:
        away = reach * np.sqrt(np.diagonal(prior.root @ prior.root.T))
        away = np.where(prior.space.is_angle, np.minimum(away, np.pi), away)
        lower, upper = prior.peak - away, prior.peak + away
        if prior.room is not None:
            where = prior.space.position_indices
            lower[where] = np.maximum(lower[where], prior.room.bounds[0])
            upper[where] = np.minimum(upper[where], prior.room.bounds[1])
    elif isinstance(prior, Product):
        where = [prior.space.names.index(name) for name in prior.prior.space.names]
        lower, upper = lower.copy(), upper.copy()
        lower[where], upper[where] = box_of(prior.prior, reach)
        if isinstance(prior, WithHeading) and prior.std is not None:
            heading = prior.space.names.index("heading")
            middle, away = 0.5 * (lower[heading] + upper[heading]), min(reach * prior.std, np.pi)
            lower[heading], upper[heading] = middle - away, middle + away
    elif isinstance(prior, Mixture):
        boxes = np.array([box_of(part, reach) for part in prior.priors])
        lower, upper = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
        upper = np.where(prior.space.is_angle, np.minimum(upper, lower + TWO_PI), upper)
    return lower, upper


def open_ends(prior: Prior, within: float = REACH) -> Ends | None:
    """Where so many deviations of a prior end though it does not; -inf and inf where both do.

    None where no Gaussian component of it has such an end.
    """
    parts = _components(prior)
    near, far = (np.array([box_of(part, reach) for part in parts]) for reach in (within, 2 * FAR_REACH))
    if (near == far).all():
        return None
    low, high = near[:, 0].min(axis=0), near[:, 1].max(axis=0)
    ends_low, ends_high = far[:, 0].min(axis=0) < low, far[:, 1].max(axis=0) > high
    if isinstance(parts[0], GaussianPrior | Product):
        round_about = parts[0].space.is_angle & (high - low >= TWO_PI)
        ends_low, ends_high = ends_low & ~round_about, ends_high & ~round_about
    return np.where(ends_low, low, -np.inf), np.where(ends_high, high, np.inf)


def leaning(space: StateSpace, ends: Ends, answers: Answers) -> BoolArray:
    """Which posteriors lie so near such an end that some of them lies beyond, (M,)."""
    (low, high), (mean, covariance, _) = ends, answers
    reach = LEANING_STDS * np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    angle = space.is_angle & np.isfinite(low) & np.isfinite(high)
    mean, middle = mean.copy(), 0.5 * (low[angle] + high[angle])
    mean[:, angle] = middle + wrap(mean[:, angle] - middle)
    return np.asarray(((mean - low < reach) | (high - mean < reach)).any(axis=1))


def may_lie_beyond(sensor: Sensor, prior: Prior, ends: Ends, readings: Array, answers: Answers) -> BoolArray:
    """Which runs may lie beyond such ends, (M,): those that lean on one, or fit too badly within.

    Args:
        sensor: The rangefinder.
        prior: The prior.
        ends: What `open_ends` says of it.
        readings: All of each run, (M, T, B), m.
        answers: Their posteriors within the prior's support.
    """
    from scipy.special import chdtri  # a tenth of a second

    possible = np.asarray(answers[2]) > -np.inf
    with np.errstate(divide="ignore", invalid="ignore"):  # a belief without width
        share = np.where(possible, _determinants(answers[1]) / _determinants(prior.covariance), 1.0)
        narrower = -0.5 * np.log(np.minimum(share, 1.0))
    told, kind = np.unique((~np.isnan(readings)).sum(axis=(1, 2)), return_inverse=True)
    with np.errstate(over="ignore"):
        short = perfect_fit(sensor, readings).sum(axis=1) - answers[2] - narrower
    return np.asarray(leaning(sensor.space, ends, answers) | (short > chdtri(told + 2, BY_CHANCE)[kind] / 2))


def out_of_reach(sensor: Sensor, prior: Prior, readings: Array, answers: Answers) -> BoolArray:
    """Which runs may lie beyond FAR_REACH, (M,), by their answers within; the arguments of `may_lie_beyond`.

    Those that may by what it asks, if they fall shorter of a perfect fit than the prior does there.
    """
    ends = open_ends(prior, FAR_REACH)
    if ends is None or not len(readings):
        return np.zeros(len(readings), dtype=np.bool_)
    with np.errstate(over="ignore"):
        short = perfect_fit(sensor, readings).sum(axis=1) - answers[2]
    lost = np.asarray(short > FAR_REACH**2 / 2 - SPARE_NATS)
    return np.asarray(may_lie_beyond(sensor, prior, ends, readings, answers) & lost)


def _components(prior: Prior) -> list[Prior]:
    """What a prior is a mixture of."""
    if isinstance(prior, Mixture):
        return [part for inner in prior.priors for part in _components(inner)]
    return [prior]


def _determinants(covariance: Array) -> Array:
    """Of covariances (..., n, n), (...); those of two components at once."""
    if covariance.shape[-1] == 2:
        return np.asarray(
            covariance[..., 0, 0] * covariance[..., 1, 1] - covariance[..., 0, 1] * covariance[..., 1, 0]
        )
    return np.asarray(np.linalg.det(covariance))
