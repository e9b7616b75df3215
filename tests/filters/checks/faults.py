"""Estimators with a planted fault each, and the check that is meant to catch it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.random import Generator

from rangefix.arrays import TWO_PI, Array
from rangefix.filters import Estimate, Mount, Problem

from .sound import Kalman, Particles


class WritesIntoTheBelief(Kalman):
    def update(self, belief: Any, measurement: Array, rngs: Sequence[Generator]) -> Any:
        after = super().update(belief, measurement, rngs)
        belief.mean[:], belief.covariance[:] = after.mean, after.covariance
        return belief


class BelievesBlindBeams(Kalman):
    def checked(self, measurement: Array, runs: int) -> Array:
        return measurement


class DrawsFromTheGlobalState(Particles):
    def draw(self, weights: Array, rng: Generator) -> Any:
        return np.random.choice(self.size, self.size, p=weights)  # noqa: NPY002


class SeedsTheGlobalState(DrawsFromTheGlobalState):
    def init(self, prior: Any, rng: Generator) -> Any:
        np.random.seed(0)  # noqa: NPY002
        return super().init(prior, rng)


@dataclass(frozen=True)
class SharesOneGenerator:
    """Particles for all runs, all from the generator of the first."""

    problem: Problem

    def init(self, prior: Any, rngs: Sequence[Generator]) -> Any:
        return [Particles(self.problem).init(prior, rngs[0]) for _ in rngs]

    def predict(self, belief: Any, control: Array, rngs: Sequence[Generator]) -> Any:
        return belief

    def update(self, belief: Any, measurement: Array, rngs: Sequence[Generator]) -> Any:
        rows = zip(belief, measurement, strict=True)
        return [Particles(self.problem).update(one, row, rngs[0]) for one, row in rows]

    def estimate(self, belief: Any) -> Any:
        return Estimate(*map(np.array, zip(*map(Particles(self.problem).estimate, belief), strict=True)))


class MixesTheRuns(Kalman):
    def estimate(self, belief: Any) -> Any:
        pooled = np.broadcast_to(belief.covariance.mean(0), belief.covariance.shape)
        mean = belief.mean - 1e-12 * belief.mean.mean(0)
        return Estimate(mean, pooled.copy(), belief.log_evidence)


@dataclass(frozen=True)
class Scaled(Kalman):
    """Claims a covariance that is scaled."""

    scale: float = 1.0

    def estimate(self, belief: Any) -> Any:
        return Estimate(belief.mean, self.scale * belief.covariance, belief.log_evidence)


class ClaimsTooLittle(Scaled):
    def __init__(self, problem: Problem) -> None:
        super().__init__(problem, 0.3)


class ClaimsTooMuch(Scaled):
    def __init__(self, problem: Problem) -> None:
        super().__init__(problem, 3.0)


class Asymmetric(Kalman):
    def estimate(self, belief: Any) -> Any:
        return Estimate(
            belief.mean, belief.covariance * [[1, 1.001], [1, 1]] + [[0, 1e-4], [0, 0]], belief.log_evidence
        )


class NegativeVariance(Kalman):
    def estimate(self, belief: Any) -> Any:
        return Estimate(belief.mean, belief.covariance - 0.05 * np.eye(2), belief.log_evidence)


class SpreadsNaN(Kalman):
    def one(self, mean: Array, covariance: Array, evidence: float, reading: Array) -> tuple[Any, ...]:
        after, *rest = super().one(mean, covariance, evidence, reading)
        return after + 0 * reading.sum(), *rest


class TakesMissingForZero(Kalman):
    def one(self, mean: Array, covariance: Array, evidence: float, reading: Array) -> tuple[Any, ...]:
        return super().one(mean, covariance, evidence, np.nan_to_num(reading))


class DropsTheRunAxis(Kalman):
    def estimate(self, belief: Any) -> Any:
        return Estimate(belief.mean.squeeze(), belief.covariance.squeeze(), belief.log_evidence)


class SinglePrecision(Kalman):
    def estimate(self, belief: Any) -> Any:
        return Estimate(belief.mean.astype(np.float32), belief.covariance, belief.log_evidence)


class ColumnVector(Particles):
    def estimate(self, belief: Any) -> Any:
        mean, *rest = super().estimate(belief)
        return Estimate(mean[:, None], *rest)


class BareTuple(Kalman):
    def estimate(self, belief: Any) -> Any:
        return belief.mean, belief.covariance, belief.log_evidence


class SortsTheReadings(Kalman):
    def one(self, mean: Array, covariance: Array, evidence: float, reading: Array) -> tuple[Any, ...]:
        rank = np.argsort(self.problem.sensor.bearings)  # ascending bearings are taken for granted
        return super().one(mean, covariance, evidence, reading[rank])


class AveragesHeadings(Particles):
    def estimate(self, belief: Any) -> Any:
        _, covariance, evidence = super().estimate(belief)
        return Estimate(np.exp(belief[1]) @ belief[0], covariance, evidence)


class ForgetsToWrap(Particles):
    def estimate(self, belief: Any) -> Any:
        mean, _, evidence = super().estimate(belief)
        return Estimate(mean, np.cov(belief[0].T, aweights=np.exp(belief[1]), bias=True), evidence)


class ResetsSilently(Particles):
    def update(self, belief: Any, measurement: Array, rng: Generator) -> Any:
        after = super().update(belief, measurement, rng)
        return after if after[2] - belief[2] > -40 else (*self.init(self.problem.prior, rng)[:2], belief[2])


class Underflows(Particles):
    def update(self, belief: Any, measurement: Array, rng: Generator) -> Any:
        states, log_weights, evidence = belief
        sensor = self.problem.sensor
        density = np.exp(sensor.log_density(measurement, sensor.expected(states)))
        density[density < 1e-60] = 0.0  # as a product of many beams in single precision would
        with np.errstate(invalid="ignore", divide="ignore"):
            weights = np.exp(log_weights) * density
            return states, np.log(weights / weights.sum()), evidence + np.log(weights.sum())


@dataclass(frozen=True)
class HoldsALock(Kalman):
    lock: Any = field(default_factory=threading.Lock)


class HoldsAnIterator(Kalman):
    def init(self, prior: Any, rngs: Sequence[Generator]) -> Any:
        belief = super().init(prior, rngs)
        object.__setattr__(belief, "pending", (step for step in range(3)))
        return belief

    def update(self, belief: Any, measurement: Array, rngs: Sequence[Generator]) -> Any:
        after = super().update(belief, measurement, rngs)
        object.__setattr__(after, "pending", belief.pending)
        return after


class AgesWithoutReadings(Kalman):
    def one(self, mean: Array, covariance: Array, evidence: float, reading: Array) -> tuple[Any, ...]:
        return super().one(mean, covariance * 1.01, evidence, reading)


class ShakesTheParticles(Particles):
    def update(self, belief: Any, measurement: Array, rng: Generator) -> Any:
        states, *rest = super().update(belief, measurement, rng)
        return states + 0.01 * rng.standard_normal(states.shape), *rest


class FillsOneBuffer(Kalman):
    def estimate(self, belief: Any) -> Any:
        if not hasattr(self, "buffer") or self.buffer.shape != belief.mean.shape:
            object.__setattr__(self, "buffer", np.empty_like(belief.mean))
        self.buffer[:] = belief.mean
        return Estimate(self.buffer, belief.covariance, belief.log_evidence)


class KeepsTheBeliefInside(Kalman):
    def update(self, belief: Any, measurement: Array, rngs: Sequence[Generator]) -> Any:
        before = getattr(self, "state", belief)
        before = belief if len(before.mean) != len(belief.mean) else before
        object.__setattr__(self, "state", super().update(before, measurement, rngs))
        return self.state  # type: ignore[attr-defined]


class CleansTheMeasurement(Kalman):
    def update(self, belief: Any, measurement: Array, rngs: Sequence[Generator]) -> Any:
        measurement[np.isnan(measurement)] = np.inf
        return super().update(belief, measurement, rngs)


class MovesThePrior(Kalman):
    def init(self, prior: Any, rngs: Sequence[Generator]) -> Any:
        belief = super().init(prior, rngs)
        prior.mean[:] += 0.1
        return belief


class Biased(Kalman):
    def misfit(self, misfit: Array) -> Array:
        return misfit + 0.05


class OverconfidentByATenth(Scaled):
    def __init__(self, problem: Problem) -> None:
        super().__init__(problem, 0.9)


class EvidenceWithoutItsConstant(Kalman):
    def one(self, mean: Array, covariance: Array, evidence: float, reading: Array) -> tuple[Any, ...]:
        *moments, evidence = super().one(mean, covariance, evidence, reading)
        return *moments, evidence + 0.5 * np.isfinite(reading).sum() * np.log(TWO_PI)


class TooFewParticles(Particles):
    def __init__(self, problem: Problem) -> None:
        super().__init__(problem, 12)


class IgnoresTheControl(Kalman):
    def predict(self, belief: Any, control: Array, rngs: Sequence[Generator]) -> Any:
        return super().predict(belief, 0 * np.asarray(control), rngs)


class ForgetsTheNoiseOfMoves(Kalman):
    def predict(self, belief: Any, control: Array, rngs: Sequence[Generator]) -> Any:
        return replace(super().predict(belief, control, rngs), covariance=belief.covariance)


class ForgetsTheSlopeOfMoves(Kalman):
    def predict(self, belief: Any, control: Array, rngs: Sequence[Generator]) -> Any:
        noise = self.problem.motion.noise_covariance(belief.mean, control)
        return replace(super().predict(belief, control, rngs), covariance=belief.covariance + noise)


class LooksFromTheMiddle(Kalman):
    def update(self, belief: Any, measurement: Array, rngs: Sequence[Generator]) -> Any:
        sensor = replace(self.problem.sensor, mount=Mount())
        return Kalman(replace(self.problem, sensor=sensor)).update(belief, measurement, rngs)


class TakesNoReturnForARange(Kalman):
    def checked(self, measurement: Array, runs: int) -> Array:
        return np.where(super().checked(measurement, runs) == np.inf, 100.0, measurement)


class DriftsAtRest(Kalman):
    def predict(self, belief: Any, control: Array, rngs: Sequence[Generator]) -> Any:
        return replace(
            super().predict(belief, control, rngs), covariance=belief.covariance + 1e-4 * np.eye(2)
        )


class TurnsTheWrongWay(Kalman):
    def slope(self, mean: Array) -> Array:
        return super().slope(mean) * ([1, 1, -1] if len(mean) == 3 else [1, 1])


class LacksAVerb:
    def __init__(self, problem: Problem) -> None:
        self.init = Kalman(problem).init
        self.update = Kalman(problem).update
        self.estimate = Kalman(problem).estimate


class Raises(Kalman):
    def update(self, belief: Any, measurement: Array, rngs: Sequence[Generator]) -> Any:
        raise RuntimeError("no\nlicence")


class DrawsTooNarrowly(Kalman):
    def sample(self, belief: Any, size: int, rngs: Sequence[Generator]) -> Any:
        return super().sample(replace(belief, covariance=0.9 * belief.covariance), size, rngs)


class DrawsBesideTheMean(Kalman):
    def sample(self, belief: Any, size: int, rngs: Sequence[Generator]) -> Any:
        aside = 0.1 * np.sqrt(np.diagonal(belief.covariance, axis1=1, axis2=2))
        return super().sample(replace(belief, mean=belief.mean + aside), size, rngs)


class DrawsComponentsApart(Kalman):
    def sample(self, belief: Any, size: int, rngs: Sequence[Generator]) -> Any:
        apart = belief.covariance * np.eye(belief.covariance.shape[-1])
        return super().sample(replace(belief, covariance=apart), size, rngs)


class DrawsFromThePrior(Kalman):
    def sample(self, belief: Any, size: int, rngs: Sequence[Generator]) -> Any:
        return np.stack([self.problem.prior.sample(size, rng) for rng in rngs])


class DrawsWithOneGenerator(Kalman):
    def sample(self, belief: Any, size: int, rngs: Sequence[Generator]) -> Any:
        return super().sample(belief, size, [rngs[0]] * len(rngs))


class DrawsTheSameEachTime(Kalman):
    def sample(self, belief: Any, size: int, rngs: Sequence[Generator]) -> Any:
        return super().sample(belief, size, [np.random.default_rng(run) for run in range(len(rngs))])


class DrawsOnePoint(Kalman):
    def sample(self, belief: Any, size: int, rngs: Sequence[Generator]) -> Any:
        return np.repeat(super().sample(belief, 1, rngs), size, axis=1)


class DrawsAlongTheWrongAxis(Kalman):
    def sample(self, belief: Any, size: int, rngs: Sequence[Generator]) -> Any:
        return super().sample(belief, size, rngs).swapaxes(0, 1)


class DrawsUnwrapped(Kalman):
    def sample(self, belief: Any, size: int, rngs: Sequence[Generator]) -> Any:
        draws, mean = super().sample(belief, size, rngs), belief.mean[:, None]
        return mean + self.problem.space.difference(draws, mean)


class DrawsTheBeliefAway(Kalman):
    def sample(self, belief: Any, size: int, rngs: Sequence[Generator]) -> Any:
        draws = super().sample(belief, size, rngs)
        belief.mean[:] = draws[:, 0]
        return draws


FAULTS: list[tuple[Callable[..., Any], str]] = [
    (WritesIntoTheBelief, "beliefs_can_be_used_again"),
    (DrawsFromTheGlobalState, "same_seed_same_answer"),
    (SeedsTheGlobalState, "global_random_state_is_left_alone"),
    (SharesOneGenerator, "runs_are_independent"),
    (MixesTheRuns, "runs_are_independent"),
    (ClaimsTooLittle, "claims_what_is_true"),
    (ClaimsTooMuch, "claims_what_is_true"),
    (Asymmetric, "moments_are_sound"),
    (NegativeVariance, "moments_are_sound"),
    (SpreadsNaN, "moments_are_sound"),
    (TakesMissingForZero, "missing_beams_say_nothing"),
    (DropsTheRunAxis, "shapes_and_dtypes"),
    (SinglePrecision, "shapes_and_dtypes"),
    (ColumnVector, "shapes_and_dtypes"),
    (BareTuple, "shapes_and_dtypes"),
    (SortsTheReadings, "order_of_beams_does_not_matter"),
    (AveragesHeadings, "headings_are_angles"),
    (ForgetsToWrap, "headings_are_angles"),
    (ResetsSilently, "impossible_measurement_is_flagged"),
    (Underflows, "impossible_measurement_is_flagged"),
    (BelievesBlindBeams, "readings_mean_what_they_mean_to_all"),
    (HoldsALock, "can_be_sent_to_a_worker"),
    (HoldsAnIterator, "can_be_sent_to_a_worker"),
    (ShakesTheParticles, "nothing_measured_changes_nothing"),
    (FillsOneBuffer, "nothing_is_remembered"),
    (KeepsTheBeliefInside, "nothing_is_remembered"),
    (CleansTheMeasurement, "inputs_are_left_alone"),
    (MovesThePrior, "inputs_are_left_alone"),
    (Biased, "agrees_with_the_kalman_filter"),
    (OverconfidentByATenth, "agrees_with_the_kalman_filter"),
    (EvidenceWithoutItsConstant, "agrees_with_the_kalman_filter"),
    (TooFewParticles, "agrees_with_the_kalman_filter"),
    (IgnoresTheControl, "moves_like_the_kalman_filter"),
    (ForgetsTheNoiseOfMoves, "moves_like_the_kalman_filter"),
    (ForgetsTheSlopeOfMoves, "moves_like_the_kalman_filter"),
    (LooksFromTheMiddle, "moves_like_the_kalman_filter"),
    (TakesNoReturnForARange, "readings_mean_what_they_mean_to_all"),
    (DriftsAtRest, "standing_still_changes_nothing"),
    (TurnsTheWrongWay, "claims_what_is_true_with_a_heading"),
    (LacksAVerb, "can_be_built"),
    (Raises, "shapes_and_dtypes"),
    (DrawsTooNarrowly, "samples_what_it_claims"),
    (DrawsBesideTheMean, "samples_what_it_claims"),
    (DrawsComponentsApart, "samples_what_it_claims"),
    (DrawsFromThePrior, "samples_what_it_claims"),
    (DrawsWithOneGenerator, "samples_what_it_claims"),
    (DrawsTheSameEachTime, "samples_what_it_claims"),
    (DrawsOnePoint, "samples_what_it_claims"),
    (DrawsAlongTheWrongAxis, "samples_what_it_claims"),
    (DrawsUnwrapped, "samples_what_it_claims"),
    (DrawsTheBeliefAway, "samples_what_it_claims"),
]
