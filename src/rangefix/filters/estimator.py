"""What an estimator is: four verbs over beliefs that are passed in, left untouched and returned anew."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.random import Generator

from ..arrays import Array
from ..thread_pools import with_blas_on_one_thread
from .estimate import Estimate
from .measurement import controls_of_runs, count_runs, readings_of_shape
from .optional_methods import (
    CanEstimateErrorOne,
    CanSampleOne,
    CanShowOne,
    CanTellDirectionOne,
    HasParticlesOne,
    Image,
)
from .problem import Prior

Belief = TypeVar("Belief")


class Estimator(Protocol[Belief]):
    """Fixed parameters and four verbs over M independent runs; run m draws from rngs[m] alone."""

    def init(self, prior: Prior, rngs: Sequence[Generator]) -> Belief:
        """The belief before any measurement, for M = len(rngs) runs, one or more."""

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
    """An estimator of one run lifted to a batch of runs, one after the other, with BLAS on one thread."""

    single: SingleRunEstimator[Belief]

    def init(self, prior: Prior, rngs: Sequence[Generator]) -> tuple[Belief, ...]:
        """One belief for each run.

        Raises:
            ValueError: If there is no run.
        """
        count_runs(rngs)
        return tuple(self.single.init(prior, rng) for rng in rngs)

    @with_blas_on_one_thread
    def predict(
        self, belief: tuple[Belief, ...], control: Array, rngs: Sequence[Generator]
    ) -> tuple[Belief, ...]:
        """Each run's belief after its move; control (k,) shared, or (M, k).

        Raises:
            ValueError: If the control is of another shape, or not of real numbers.
        """
        controls = controls_of_runs(control, len(belief))
        return tuple(self.single.predict(*run) for run in zip(belief, controls, rngs, strict=True))

    @with_blas_on_one_thread
    def update(
        self, belief: tuple[Belief, ...], measurement: Array, rngs: Sequence[Generator]
    ) -> tuple[Belief, ...]:
        """Each run's belief after its measurement (M, B).

        Raises:
            ValueError: If the measurement is not of shape (M, B) or not of real numbers.
        """
        measurement = readings_of_shape(measurement, (len(belief), None), "(runs, beams)")
        return tuple(self.single.update(*run) for run in zip(belief, measurement, rngs, strict=True))

    @with_blas_on_one_thread
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

    def resultant(self, belief: tuple[Belief, ...]) -> Array:
        """The lengths of the runs' mean resultant vectors, (M,).

        Raises:
            NotImplementedError: If the single-run estimator cannot tell.
        """
        if not isinstance(self.single, CanTellDirectionOne):
            raise NotImplementedError(f"a {type(self.single).__name__} cannot tell its resultant")
        return np.array([float(self.single.resultant(run)) for run in belief])

    def effective_particles(self, belief: tuple[Belief, ...]) -> Array:
        """Each run's effective number of particles, (M,).

        Raises:
            NotImplementedError: If the single-run estimator has none.
        """
        if not isinstance(self.single, HasParticlesOne):
            raise NotImplementedError(f"a {type(self.single).__name__} has no particles")
        return np.array([float(self.single.effective_particles(run)) for run in belief])


def filtered(
    estimator: Estimator[Belief],
    prior: Prior,
    controls: Sequence[Array] | Array,
    measurements: Sequence[Array] | Array,
    rngs: Sequence[Generator],
    announce: Callable[[str, int], None] = lambda verb, step: None,
) -> Iterator[tuple[str, int, Belief]]:
    """Filter a recording whose length is known: see `filtered_stream`.

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
    moves = (None if step < lead else controls[step - lead] for step in range(len(measurements)))
    yield from filtered_stream(estimator, prior, zip(moves, measurements, strict=True), rngs, announce)


def filtered_stream(
    estimator: Estimator[Belief],
    prior: Prior,
    steps: Iterable[tuple[Array | None, Array]],
    rngs: Sequence[Generator],
    announce: Callable[[str, int], None] = lambda verb, step: None,
) -> Iterator[tuple[str, int, Belief]]:
    """Filter a recording that comes step by step: the one loop over the steps of a run.

    Args:
        estimator: The estimator.
        prior: Where the object may be at first.
        steps: The move before each measurement, (k,) or (M, k), None for none; and the measurement, (M, B),
            m.
        rngs: One generator for each of the M runs.
        announce: Told the verb and the step before each verb is called.

    Yields:
        The verb ("init", "predict" or "update"), the step from 0, and the belief after it.
    """
    announce("init", 0)
    belief = estimator.init(prior, rngs)
    yield "init", 0, belief
    for step, (control, measurement) in enumerate(steps):
        if control is not None:
            announce("predict", step)
            belief = estimator.predict(belief, control, rngs)
            yield "predict", step, belief
        announce("update", step)
        belief = estimator.update(belief, measurement, rngs)
        yield "update", step, belief
