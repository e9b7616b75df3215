"""What an estimator may tell of a belief beyond mean and covariance: draws, a picture, its own accuracy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.random import Generator

from ..arrays import Array, real_floats

Asked = TypeVar("Asked", contravariant=True)


class Image(NamedTuple):
    """What the belief of one run looks like: its density over the room, and over an unknown heading.

    Attributes:
        density: Over the room, (R, C), 1/m^2, x2 upwards along R.
        extent: Edges of its pixels, x1 left, x1 right, x2 lower, x2 upper, m, (4,).
        headings: Edges of the bins of an unknown heading, rad, (H + 1,); empty where it is known.
        heading_density: Over the heading, 1/rad, (H,).
    """

    density: Array
    extent: Array
    headings: Array
    heading_density: Array


@runtime_checkable
class CanSample(Protocol[Asked]):
    """The optional method `sample` of an estimator."""

    def sample(self, belief: Asked, size: int, rngs: Sequence[Generator]) -> Array:
        """Independent draws from the belief, (M, size, n); run m draws from rngs[m] alone."""


@runtime_checkable
class CanShow(Protocol[Asked]):
    """The optional method `density` of an estimator whose belief is more than a mean and a covariance."""

    def density(self, belief: Asked, run: int) -> Image:
        """What the belief of a run looks like."""


@runtime_checkable
class HasParticles(Protocol[Asked]):
    """The optional method `effective_particles` of an estimator whose belief is weighted points."""

    def effective_particles(self, belief: Asked) -> Array:
        """Effective number of particles, 1 / sum w^2 for weights that sum to one, (M,).

        Copies that nothing has moved apart are best counted as one: they tell no more than one does. Below
        50 a run is called collapsed, in tables and by the verdict.
        """


@runtime_checkable
class HasParticlesOne(Protocol[Asked]):
    """`HasParticles` of an estimator for single runs."""

    def effective_particles(self, belief: Asked) -> float:
        """Effective number of particles."""


@runtime_checkable
class CanEstimateError(Protocol[Asked]):
    """The optional method `error` of an estimator that integrates, and knows how accurately."""

    def error(self, belief: Asked) -> Array:
        """Estimated numerical error of mean and covariance, in standard deviations of the posterior, (M,).

        With m, P what `estimate` gives, m*, P* the exact moments under the estimator's own model and s the
        standard deviations: the greatest of |m_i - m*_i| / s_i and |P_ij - P*_ij| / (s_i s_j), angles
        wrapped. It comes from points that did not make the answer (an embedded rule, a second lattice
        shifted against the first). 0 where no state is possible (log evidence -inf); inf where nothing is
        known of it.
        """


@runtime_checkable
class CanEstimateErrorOne(Protocol[Asked]):
    """`CanEstimateError` of an estimator for single runs."""

    def error(self, belief: Asked) -> float:
        """Estimated numerical error of mean and covariance, in standard deviations of the posterior."""


@runtime_checkable
class CanTellDirection(Protocol[Asked]):
    """The optional method `resultant` of an estimator whose belief of the heading is more than a Gaussian."""

    def resultant(self, belief: Asked) -> Array:
        """Length of the mean resultant vector |E exp(i heading)|, 0 to 1, (M,).

        Below `rangefix.filters.space.LEAST_RESULTANT` the heading has no circular mean: what `estimate` gives
        for it is one direction among many, and mean and covariance of the heading mean nothing.
        """


@runtime_checkable
class CanTellDirectionOne(Protocol[Asked]):
    """`CanTellDirection` of an estimator for single runs."""

    def resultant(self, belief: Asked) -> float:
        """Length of the mean resultant vector |E exp(i heading)|, 0 to 1."""


@runtime_checkable
class CanSampleOne(Protocol[Asked]):
    """`CanSample` of an estimator for single runs."""

    def sample(self, belief: Asked, size: int, rng: Generator) -> Array:
        """Independent draws from the belief, (size, n)."""


@runtime_checkable
class CanShowOne(Protocol[Asked]):
    """`CanShow` of an estimator for single runs."""

    def density(self, belief: Asked) -> Image:
        """What the belief looks like."""
        ...


def sample_belief(estimator: object, belief: object, size: int, rngs: Sequence[Generator]) -> Array | None:
    """Draws from the beliefs of M runs, (M, size, n); None where the estimator cannot sample.

    Raises:
        ValueError: If the draws have another shape, or are not finite and real.
    """
    if not isinstance(estimator, CanSample):
        return None
    try:
        draws = real_floats("what sample() gives", estimator.sample(belief, size, rngs))
    except NotImplementedError:
        return None
    if draws.ndim != 3 or draws.shape[:2] != (len(rngs), size):
        raise ValueError(f"sample() gave shape {draws.shape}, not ({len(rngs)}, {size}, n)")
    if not np.isfinite(draws).all():
        raise ValueError("sample() gave numbers that are not finite")
    return draws


def show_belief(estimator: object, belief: object, run: int) -> Image | None:
    """What the belief of a run looks like; None where the estimator cannot show it."""
    if not isinstance(estimator, CanShow):
        return None
    try:
        return estimator.density(belief, run)
    except NotImplementedError:
        return None


def effective_particles(estimator: object, belief: object, runs: int) -> Array | None:
    """Effective numbers of particles in the beliefs of M runs, (M,); None for an estimator without particles.

    Raises:
        ValueError: If there is not one positive, finite number for each run.
    """
    if not isinstance(estimator, HasParticles):
        return None
    try:
        numbers = real_floats("what effective_particles() gives", estimator.effective_particles(belief))
    except NotImplementedError:
        return None
    if numbers.shape != (runs,):
        raise ValueError(f"effective_particles() gave shape {numbers.shape}, not ({runs},)")
    if not (np.isfinite(numbers) & (numbers > 0)).all():
        raise ValueError("effective_particles() gave numbers that are not positive and finite")
    return numbers


def numerical_error(estimator: object, belief: object, runs: int) -> Array | None:
    """Numerical errors that an estimator states of M runs, (M,); None where it cannot tell.

    Raises:
        ValueError: If there is not one real number, not negative, for each run; inf is allowed.
    """
    return _told(estimator.error, belief, runs) if isinstance(estimator, CanEstimateError) else None


def mean_resultant(estimator: object, belief: object, runs: int) -> Array | None:
    """Lengths of the mean resultant vectors of the heading, (M,); None where an estimator cannot tell.

    Raises:
        ValueError: If there is not one real number, not negative, for each run.
    """
    return _told(estimator.resultant, belief, runs) if isinstance(estimator, CanTellDirection) else None


def _told(method: Callable[[Any], Array], belief: object, runs: int) -> Array | None:
    """What an optional method says of M runs, (M,); None where it is not implemented.

    Raises:
        ValueError: If there is not one real number, not negative, for each run.
    """
    name = method.__name__
    try:
        numbers = real_floats(f"what {name}() gives", method(belief))
    except NotImplementedError:
        return None
    if numbers.shape != (runs,):
        raise ValueError(f"{name}() gave shape {numbers.shape}, not ({runs},)")
    if not (numbers >= 0).all():
        raise ValueError(f"{name}() gave numbers that are negative or NaN")
    return numbers


def diagnostics_of(estimator: object, belief: object, runs: int) -> dict[str, Array]:
    """What an estimator says of its own computation, for M runs: name -> (M,), of what it can tell.

    Raises:
        ValueError: If it says what cannot be.
    """
    told = {
        "effective_particles": effective_particles(estimator, belief, runs),
        "numerical_error": numerical_error(estimator, belief, runs),
        "mean_resultant": mean_resultant(estimator, belief, runs),
    }
    return {name: numbers for name, numbers in told.items() if numbers is not None}
