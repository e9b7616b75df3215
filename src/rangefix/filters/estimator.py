"""What an estimator is: four verbs over beliefs that are passed in, left untouched and returned anew."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, Generic, NamedTuple, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.random import Generator

from ..arrays import Array, real_floats
from .measurement import readings_of_shape
from .problem import Prior, Problem

Belief = TypeVar("Belief")
Asked = TypeVar("Asked", contravariant=True)


class Estimate(NamedTuple):
    """What a belief comes down to; a single run has the same three without the axis M.

    Attributes:
        mean: Posterior mean, (M, n); angles as circular means.
        covariance: Conditional covariance P, (M, n, n), symmetric; angles in the tangent space at the mean.
        log_evidence: Log density of all measurements since `init` under the estimator's own model, (M,), in
            nats. -inf marks a run whose last measurements no hypothesis allows: mean and covariance are then
            those from before them. NaN for an estimator that does not compute it.
    """

    mean: Array
    covariance: Array
    log_evidence: Array | float = np.nan


class BriefRepr:
    """A dataclass whose `repr` fits a few lines: arrays by their shapes, a problem by its state and beams."""

    def __repr__(self) -> str:
        return brief(self)


def brief(record: Any, estimate: Estimate | None = None) -> str:
    """A dataclass in a few lines.

    Args:
        record: The record.
        estimate: What it comes down to, if that is known: that of the first run is written out.
    """
    parts = [f"{field.name}={_in_short(getattr(record, field.name))}" for field in fields(record)]
    if estimate is not None:
        parts.insert(0, _in_short(estimate))
    return f"{type(record).__name__}({', '.join(parts)})"


def _in_short(value: object) -> str:
    """A field of a record in a few words."""
    if isinstance(value, Estimate):
        size = value.mean.shape[-1]
        mean, covariance = value.mean.reshape(-1, size)[0], value.covariance.reshape(-1, size, size)[0]
        pairs = zip(mean, np.sqrt(np.diagonal(covariance)), strict=True)
        return "run 0 at " + " ".join(f"{centre:.4g}±{std:.2g}" for centre, std in pairs)
    if isinstance(value, np.ndarray) and value.size > 1:
        return f"<{' x '.join(map(str, value.shape))}>"
    if isinstance(value, Problem):
        return f"<{', '.join(value.space.names)} by {len(value.sensor.bearings)} beams>"
    if type(value) is tuple:
        return f"<{len(value)} of them>"
    return f"<{type(value).__name__}>" if is_dataclass(value) or isinstance(value, tuple) else str(value)


class Estimator(Protocol[Belief]):
    """Fixed parameters and four verbs over M independent runs; run m draws from rngs[m] alone."""

    def init(self, prior: Prior, rngs: Sequence[Generator]) -> Belief:
        """The belief before any measurement, for M = len(rngs) runs."""

    def predict(self, belief: Belief, control: Array, rngs: Sequence[Generator]) -> Belief:
        """The belief after a move; control (k,) shared by the runs, or (M, k)."""

    def update(self, belief: Belief, measurement: Array, rngs: Sequence[Generator]) -> Belief:
        """The belief after a measurement (M, B) in metres; NaN = beam not measured, inf = no return."""

    def estimate(self, belief: Belief) -> Estimate:
        """Mean (M, n), conditional covariance (M, n, n) and log evidence (M,)."""


class SingleRunEstimator(Protocol[Belief]):
    """The same four verbs for one run: no run axis, one random generator."""

    def init(self, prior: Prior, rng: Generator) -> Belief:
        """The belief before any measurement."""

    def predict(self, belief: Belief, control: Array, rng: Generator) -> Belief:
        """The belief after a move; control (k,)."""

    def update(self, belief: Belief, measurement: Array, rng: Generator) -> Belief:
        """The belief after a measurement (B,) in metres; NaN = beam not measured, inf = no return."""

    def estimate(self, belief: Belief) -> Estimate:
        """Mean (n,), conditional covariance (n, n) and log evidence."""


@dataclass(frozen=True)
class EachRun(Generic[Belief]):
    """A single-run estimator lifted to a batch of independent runs, one after the other."""

    single: SingleRunEstimator[Belief]

    def init(self, prior: Prior, rngs: Sequence[Generator]) -> tuple[Belief, ...]:
        """One belief for each run."""
        return tuple(self.single.init(prior, rng) for rng in rngs)

    def predict(
        self, belief: tuple[Belief, ...], control: Array, rngs: Sequence[Generator]
    ) -> tuple[Belief, ...]:
        """Each run's belief after its move; control (k,) shared, or (M, k)."""
        control = np.asarray(control, dtype=float)
        controls = np.broadcast_to(control, (len(belief), control.shape[-1]))
        return tuple(self.single.predict(*run) for run in zip(belief, controls, rngs, strict=True))

    def update(
        self, belief: tuple[Belief, ...], measurement: Array, rngs: Sequence[Generator]
    ) -> tuple[Belief, ...]:
        """Each run's belief after its measurement (M, B).

        Raises:
            ValueError: If the measurement is not of shape (M, B) or not of real numbers.
        """
        measurement = readings_of_shape(measurement, (len(belief), None), "(runs, beams)")
        return tuple(self.single.update(*run) for run in zip(belief, measurement, rngs, strict=True))

    def estimate(self, belief: tuple[Belief, ...]) -> Estimate:
        """The runs' estimates, stacked along the first axis."""
        means, covariances, evidences = zip(*map(self.single.estimate, belief), strict=True)
        return Estimate(np.stack(means), np.stack(covariances), np.array(evidences, dtype=float))

    def sample(self, belief: tuple[Belief, ...], size: int, rngs: Sequence[Generator]) -> Array:
        """Each run's draws, (M, size, n).

        Raises:
            NotImplementedError: If the single-run estimator cannot sample.
        """
        if not isinstance(self.single, CanSampleOne):
            raise NotImplementedError(f"a {type(self.single).__name__} cannot sample")
        pairs = zip(belief, rngs, strict=True)
        return np.stack([np.asarray(self.single.sample(run, size, rng), float) for run, rng in pairs])

    def density(self, belief: tuple[Belief, ...], run: int) -> Image:
        """What the belief of a run looks like.

        Raises:
            NotImplementedError: If the single-run estimator cannot show it.
        """
        if not isinstance(self.single, CanShowOne):
            raise NotImplementedError(f"a {type(self.single).__name__} cannot show its belief")
        return self.single.density(belief[run])

    def error(self, belief: tuple[Belief, ...]) -> Array:
        """The runs' numerical errors, (M,).

        Raises:
            NotImplementedError: If the single-run estimator cannot tell.
        """
        if not isinstance(self.single, CanEstimateErrorOne):
            raise NotImplementedError(f"a {type(self.single).__name__} does not know its numerical error")
        return np.array([float(self.single.error(run)) for run in belief])


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


def sample_belief(estimator: Any, belief: Any, size: int, rngs: Sequence[Generator]) -> Array | None:
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


def show_belief(estimator: Any, belief: Any, run: int) -> Image | None:
    """What the belief of a run looks like; None where the estimator cannot show it."""
    if not isinstance(estimator, CanShow):
        return None
    try:
        return estimator.density(belief, run)
    except NotImplementedError:
        return None


def numerical_error(estimator: Any, belief: Any, runs: int) -> Array | None:
    """Numerical errors that an estimator states of M runs, (M,); None where it cannot tell.

    Raises:
        ValueError: If there is not one real number, not negative, for each run; inf is allowed.
    """
    if not isinstance(estimator, CanEstimateError):
        return None
    try:
        errors = real_floats("what error() gives", estimator.error(belief))
    except NotImplementedError:
        return None
    if errors.shape != (runs,):
        raise ValueError(f"error() gave shape {errors.shape}, not ({runs},)")
    if not (errors >= 0).all():
        raise ValueError("error() gave numbers that are negative or NaN")
    return errors


def filtered(
    estimator: Estimator[Belief],
    prior: Prior,
    controls: Sequence[Array] | Array,
    measurements: Sequence[Array] | Array,
    rngs: Sequence[Generator],
    announce: Callable[[str, int], None] = lambda verb, step: None,
) -> Iterator[tuple[str, int, Belief]]:
    """Filter a recording: the one loop over the steps of a run.

    Args:
        estimator: The estimator.
        prior: Where the object may be at first.
        controls: The moves between the measurements, T - 1 of (k,) or (M, k); or T, from before the first.
        measurements: T measurements (M, B), m.
        rngs: One generator for each of the M runs.
        announce: Told the verb and the step before each verb is called.

    Yields:
        The verb ("init", "predict" or "update"), the step from 0, and the belief after it.
    """
    lead = len(measurements) - len(controls)
    announce("init", 0)
    belief = estimator.init(prior, rngs)
    yield "init", 0, belief
    for step, measurement in enumerate(measurements):
        if step >= lead:
            announce("predict", step)
            belief = estimator.predict(belief, controls[step - lead], rngs)
            yield "predict", step, belief
        announce("update", step)
        belief = estimator.update(belief, measurement, rngs)
        yield "update", step, belief
