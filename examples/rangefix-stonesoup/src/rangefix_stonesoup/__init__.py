"""The particle filter of Stone Soup (https://stonesoup.readthedocs.io) as an estimator of rangefix."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from stonesoup.base import Property
from stonesoup.models.measurement.base import MeasurementModel
from stonesoup.resampler import Resampler
from stonesoup.resampler.particle import ESSResampler
from stonesoup.types.array import StateVector, StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import ParticleState
from stonesoup.updater.particle import ParticleUpdater

from rangefix.filters import Estimate, Prior, Problem, Sensor, check_reading

Array = NDArray[np.float64]

__all__ = ["StoneSoupBelief", "StoneSoupParticle"]


class RangeModel(MeasurementModel):  # type: ignore[misc]
    """A rangefinder as a measurement model of Stone Soup, which keeps states in columns."""

    sensor: Sensor = Property(doc="The rangefinder")

    @property
    def ndim_meas(self) -> int:
        """The number of beams."""
        return len(self.sensor.bearings)

    def function(self, state: Any, noise: bool = False, **kwargs: Any) -> StateVectors:
        """Expected ranges in columns; noise is not added."""
        return StateVectors(self.sensor.expected(np.asarray(state.state_vector, dtype=float).T).T)

    def logpdf(self, state1: Any, state2: Any, **kwargs: Any) -> Array:
        """Log density of a detection at each particle, (N,); NaN readings say nothing."""
        reading = np.asarray(state1.state_vector, dtype=float)[:, 0]
        return self.sensor.log_density(reading, np.asarray(self.function(state2)).T)

    def pdf(self, state1: Any, state2: Any, **kwargs: Any) -> Array:
        """The density itself."""
        return np.asarray(np.exp(self.logpdf(state1, state2)))

    def rvs(self, num_samples: int = 1, **kwargs: Any) -> Any:
        """Not needed for filtering."""
        raise NotImplementedError


class SystematicResampler(Resampler):  # type: ignore[misc]
    """Systematic resampling from a generator of one's own; Stone Soup's draws from numpy's global state."""

    rng: Generator = Property(doc="The generator of the run")

    def resample(self, particles: ParticleState, nparts: int | None = None) -> ParticleState:
        """As many particles as there are (or as asked), equally weighted."""
        size = nparts or len(particles)
        sums = np.cumsum(np.exp(particles.log_weight))
        points = (np.arange(size) + self.rng.random()) / size * sums[-1]
        chosen = np.minimum(np.searchsorted(sums, points, side="right"), len(particles) - 1)
        return ParticleState(particles.state_vector[:, chosen], log_weight=np.full(size, -np.log(size)))


@dataclass(frozen=True)
class StoneSoupBelief:
    """Particles of Stone Soup, and the log density of what was measured."""

    particles: ParticleState
    log_evidence: float


@dataclass(frozen=True)
class StoneSoupParticle:
    """Stone Soup's `ParticleUpdater`, one run at a time.

    Its `ParticlePredictor` is not used: it caches what it has drawn, so a second future of the same belief
    would be the first one again. Particles move by the problem's own motion.

    Args:
        problem: What may be known.
        particles: How many.
        threshold: Resample when the effective sample size falls below this share of them.

    Raises:
        ValueError: If there are not at least two particles, or the threshold is not in [0, 1].
    """

    problem: Problem
    particles: int = 5000
    threshold: float = 0.5

    def __post_init__(self) -> None:
        if self.particles < 2:
            raise ValueError(f"need at least two particles, got {self.particles}")
        if not 0 <= self.threshold <= 1:
            raise ValueError(f"the threshold must be in [0, 1], got {self.threshold}")

    def init(self, prior: Prior, rng: Generator) -> StoneSoupBelief:
        """Draws from the prior."""
        return StoneSoupBelief(_state(prior.sample(self.particles, rng)), 0.0)

    def predict(self, belief: StoneSoupBelief, control: Array, rng: Generator) -> StoneSoupBelief:
        """Every particle moves; control (k,)."""
        states = np.asarray(belief.particles.state_vector, dtype=float).T
        moved = self.problem.motion.sample(states, control, rng)
        return StoneSoupBelief(_state(moved, belief.particles.log_weight), belief.log_evidence)

    def update(self, belief: StoneSoupBelief, measurement: Array, rng: Generator) -> StoneSoupBelief:
        """Weigh by a measurement (B,); if no particle allows it the particles stay, flagged by -inf."""
        measurement = check_reading(self.problem.sensor, measurement)
        if np.isnan(measurement).all():
            return belief
        before = belief.particles
        model = RangeModel(before.ndim, range(before.ndim), self.problem.sensor)
        detection = Detection(StateVector(measurement), measurement_model=model)
        with np.errstate(invalid="ignore"):  # no particle allows it: inf - inf
            after = ParticleUpdater(None).update(SingleHypothesis(before, detection))
        if np.isnan(after.log_weight).any():
            return StoneSoupBelief(before, -np.inf)
        best = int(np.argmax(after.log_weight))  # Stone Soup drops what it divides by; one particle tells it
        one = model.logpdf(detection, before[best : best + 1])[0]
        gained = float(before.log_weight[best] + one - after.log_weight[best])
        resampler = ESSResampler(self.threshold * self.particles, SystematicResampler(rng))
        chosen = resampler.resample(after)
        kept = ParticleState(chosen.state_vector, log_weight=chosen.log_weight)  # without its history
        return StoneSoupBelief(kept, belief.log_evidence + gained)

    def estimate(self, belief: StoneSoupBelief) -> Estimate:
        """Weighted mean (n,) and covariance (n, n), headings as angles."""
        states = np.asarray(belief.particles.state_vector, dtype=float).T
        weights = np.exp(belief.particles.log_weight)
        mean, covariance = self.problem.space.moments(states, weights / weights.sum())
        return Estimate(mean, covariance, belief.log_evidence)


def _state(states: Array, log_weights: Array | None = None) -> ParticleState:
    """States (N, n) as Stone Soup's columns; equal weights unless given."""
    if log_weights is None:
        log_weights = np.full(len(states), -np.log(len(states)))
    return ParticleState(StateVectors(states.T), log_weight=log_weights)
