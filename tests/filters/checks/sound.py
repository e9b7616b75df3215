"""Estimators without any fault, each step open to one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.random import Generator

from rangefix.arrays import TWO_PI, Array
from rangefix.filters import Estimate, Problem, check_measurement


@dataclass(frozen=True)
class Moments:
    """A Gaussian belief over all runs, (M, n), (M, n, n) and (M,)."""

    mean: Array
    covariance: Array
    log_evidence: Array


@dataclass(frozen=True)
class Kalman:
    """An extended Kalman filter without any fault, each step open to one."""

    problem: Problem

    def init(self, prior: Any, rngs: Sequence[Generator]) -> Any:
        runs = len(rngs)
        return Moments(
            np.tile(prior.mean, (runs, 1)), np.tile(prior.covariance, (runs, 1, 1)), np.zeros(runs)
        )

    def predict(self, belief: Any, control: Array, rngs: Sequence[Generator]) -> Any:
        motion = self.problem.motion
        slope = motion.jacobian(belief.mean, control)
        spread = slope @ belief.covariance @ np.swapaxes(slope, 1, 2)
        noise = motion.noise_covariance(belief.mean, control)
        return replace(belief, mean=motion.mean(belief.mean, control), covariance=spread + noise)

    def update(self, belief: Any, measurement: Array, rngs: Sequence[Generator]) -> Any:
        measurement = self.checked(measurement, len(rngs))
        runs = range(len(rngs))
        parts = [
            self.one(belief.mean[m], belief.covariance[m], belief.log_evidence[m], measurement[m])
            for m in runs
        ]
        mean, covariance, log_evidence = zip(*parts, strict=True)
        return Moments(np.array(mean), np.array(covariance), np.array(log_evidence))

    def checked(self, measurement: Array, runs: int) -> Array:
        return check_measurement(self.problem.sensor, measurement, runs)

    def one(self, mean: Array, covariance: Array, evidence: float, reading: Array) -> tuple[Any, ...]:
        sensor = self.problem.sensor
        seen = np.isfinite(reading)
        if not seen.any():
            return mean, covariance, evidence
        slope = self.slope(mean)[seen]
        misfit = self.misfit((reading - sensor.expected(mean))[seen])
        spread = slope @ covariance @ slope.T + np.diag(sensor.noise.variance(reading)[seen])
        gain = np.linalg.solve(spread, slope @ covariance).T
        after = covariance - gain @ spread @ gain.T
        evidence = evidence - 0.5 * (
            misfit @ np.linalg.solve(spread, misfit) + np.linalg.slogdet(TWO_PI * spread)[1]
        )
        return self.problem.space.wrap(mean + gain @ misfit), 0.5 * (after + after.T), evidence

    def slope(self, mean: Array) -> Array:
        return self.problem.sensor.jacobian(mean)

    def misfit(self, misfit: Array) -> Array:
        return misfit

    def estimate(self, belief: Any) -> Any:
        return Estimate(belief.mean, belief.covariance, belief.log_evidence)

    def sample(self, belief: Any, size: int, rngs: Sequence[Generator]) -> Any:
        pairs = zip(belief.mean, belief.covariance, rngs, strict=True)
        drawn = [rng.multivariate_normal(mean, covariance, size) for mean, covariance, rng in pairs]
        return self.problem.space.wrap(np.array(drawn))


@dataclass(frozen=True)
class Particles:
    """A bootstrap particle filter without any fault, one run at a time: states, log weights, log evidence."""

    problem: Problem
    size: int = 2000

    def init(self, prior: Any, rng: Generator) -> Any:
        return prior.sample(self.size, rng), np.full(self.size, -np.log(self.size)), 0.0

    def predict(self, belief: Any, control: Array, rng: Generator) -> Any:
        return self.problem.motion.sample(belief[0], control, rng), *belief[1:]

    def update(self, belief: Any, measurement: Array, rng: Generator) -> Any:
        states, log_weights, evidence = belief
        sensor = self.problem.sensor
        weighted = log_weights + sensor.log_density(measurement, sensor.expected(states))
        total = np.logaddexp.reduce(weighted)
        if total == -np.inf:
            return states, log_weights, -np.inf
        weights = np.exp(weighted - total)
        if 1 / (weights**2).sum() < self.size / 2:
            chosen = self.draw(weights, rng)
            return states[chosen], np.full(self.size, -np.log(self.size)), evidence + total
        return states, weighted - total, evidence + total

    def draw(self, weights: Array, rng: Generator) -> Any:
        points = (np.arange(self.size) + rng.random()) / self.size
        return np.minimum(np.searchsorted(np.cumsum(weights), points), self.size - 1)

    def estimate(self, belief: Any) -> Any:
        return Estimate(*self.problem.space.moments(belief[0], np.exp(belief[1])), belief[2])

    def sample(self, belief: Any, size: int, rng: Generator) -> Any:
        return belief[0][rng.choice(self.size, size, p=np.exp(belief[1]))]
