"""The conformance suite: sound estimators pass, planted faults are caught by the checks meant for them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.random import Generator

from rangefix.arrays import TWO_PI, Array
from rangefix.filters import Estimate, Problem, available
from rangefix.filters.checks import (
    Check,
    CheckFailure,
    check_names,
    checks_for,
    conforms,
    parametrize_with_checks,
    problems,
    render,
    run_checks,
)
from rangefix.filters.checks.problems import Hall, kalman, position_problem, readings
from rangefix.maps import RectangularRoom

pytest_plugins = ["pytester"]


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
        runs = range(len(rngs))
        parts = [
            self.one(belief.mean[m], belief.covariance[m], belief.log_evidence[m], measurement[m])
            for m in runs
        ]
        mean, covariance, log_evidence = zip(*parts, strict=True)
        return Moments(np.array(mean), np.array(covariance), np.array(log_evidence))

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


class WritesIntoTheBelief(Kalman):
    def update(self, belief: Any, measurement: Array, rngs: Sequence[Generator]) -> Any:
        after = super().update(belief, measurement, rngs)
        belief.mean[:], belief.covariance[:] = after.mean, after.covariance
        return belief


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


@parametrize_with_checks([Kalman, Particles])
def test_sound_estimators_pass(check: Check) -> None:
    """A Kalman filter and a particle filter of the simplest kind: what is sound is not blamed."""
    check()


@parametrize_with_checks(available())
def test_built_in_estimators_pass(check: Check) -> None:
    """Every estimator that `available` lists, with its defaults and without exceptions."""
    check()


@pytest.mark.parametrize(("fault", "name"), FAULTS, ids=lambda value: getattr(value, "__name__", None))
def test_fault_is_caught(fault: Callable[..., Any], name: str) -> None:
    """Each planted fault fails the check meant for it, and the message names the estimator and the mend."""
    (check,) = [check for check in checks_for(fault) if check.name == name]
    result = check.result()
    assert result.outcome == "failed"
    assert result.detail
    assert "\n" not in result.detail
    assert result.meaning
    assert result.mend


def test_every_check_catches_something() -> None:
    """No check is there that no planted fault fails."""
    assert {name for _, name in FAULTS} == set(check_names())


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("sound", [Kalman, Particles])
def test_no_false_alarms(monkeypatch: pytest.MonkeyPatch, sound: type, seed: int) -> None:
    """Other seeds pass as well; at less than 1 false alarm in 10 000 this test fails for 1 in 100 at most."""
    monkeypatch.setattr(problems, "SEED", seed)
    results = [check.result() for check in checks_for(sound) if "claims" in check.name or "kal" in check.name]
    assert [result.detail for result in results if result.outcome != "passed"] == []
    assert len(results) == 5


def test_the_hall_is_a_rectangular_room() -> None:
    """Ranges and gradients of the suite's own map equal those of `RectangularRoom`, for 1000 poses."""
    rng = np.random.default_rng(0)
    poses = np.column_stack([rng.uniform(-4.4, 4.4, (1000, 2)), rng.uniform(-7, 7, 1000)])
    room, moved = RectangularRoom(12.5, 10.5), poses + np.array([7.0, 4.5, 0.0])
    np.testing.assert_allclose(
        Hall().ranges(poses, problems.BEARINGS), room.ranges(moved, problems.BEARINGS), atol=1e-10
    )
    np.testing.assert_allclose(
        Hall().gradients(poses, problems.BEARINGS), room.gradients(moved, problems.BEARINGS), atol=1e-8
    )


def test_the_exact_answer_is_the_posterior() -> None:
    """The oracle equals a sum over a fine grid: mean, covariance and log evidence to 1e-6."""
    problem = position_problem()
    _, measurements = readings(problem, 1, 2)
    lower, upper = problem.prior.support
    axes = [np.linspace(low, high, 401) for low, high in zip(lower, upper, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2)
    expected = problem.sensor.expected(points)
    logs = problem.prior.log_density(points)
    logs += sum(problem.sensor.log_density(measurement, expected) for measurement in measurements)
    total = np.logaddexp.reduce(logs)
    mean, covariance = problem.space.moments(points, np.exp(logs - total))
    exact = kalman(problem, [measurement[0] for measurement in measurements])
    np.testing.assert_allclose(exact.mean, mean, atol=1e-6)
    np.testing.assert_allclose(exact.covariance, covariance, atol=1e-6)
    cell = np.prod((upper - lower) / 400)
    assert exact.log_evidence == pytest.approx(total + np.log(cell), abs=1e-5)


def test_results_and_their_lines() -> None:
    """A failure is told with what was seen, what it means and how to mend it; the last line counts."""
    results = run_checks(ClaimsTooLittle)
    assert not conforms(results)
    assert [result.name for result in results] == list(check_names())
    text = "\n".join(render(results))
    assert "FAILED           claims_what_is_true\n" in text
    assert "ANEES / n is 3" in text
    assert "mend:" in text
    assert text.splitlines()[-1].startswith("21 of 21 checks ran: ")
    assert conforms(run_checks(Kalman))


def test_an_estimator_that_cannot_be_built_fails_once() -> None:
    """The first check says why, the others are skipped."""
    results = run_checks(LacksAVerb)
    assert results[0].outcome == "failed"
    assert "predict" in results[0].detail
    assert {result.outcome for result in results[1:]} == {"skipped"}
    assert render(results)[-1] == "1 of 21 checks ran: 1 failed, 20 skipped"


def test_an_unknown_name_is_no_result(tmp_path: Path) -> None:
    """A name that is not there raises; a file that does not import is an estimator that is not built."""
    with pytest.raises(KeyError, match="no estimator 'kalmann'"):
        run_checks("kalmann")
    (tmp_path / "broken.py").write_text("1 / 0\n")
    first, *_ = run_checks(f"{tmp_path / 'broken.py'}:Filter")
    assert first.outcome == "failed"
    assert "division by zero" in first.detail


def test_an_error_is_told_in_one_line_with_its_place() -> None:
    """What an estimator raises becomes the detail: type, message, file, line and function."""
    detail = run_checks(Raises)[1].detail
    assert detail.startswith("RuntimeError: no licence (test_checks.py, line ")
    assert detail.endswith("in update)")


def test_a_refused_problem_is_skipped() -> None:
    """An estimator that is not made for a heading says so by ValueError, and is not blamed."""

    def flat_only(problem: Problem) -> Kalman:
        if problem.space.is_angle.any():
            raise ValueError("made for known headings")
        return Kalman(problem)

    skipped = {result.name: result.detail for result in run_checks(flat_only) if result.outcome == "skipped"}
    need_heading = {"headings_are_angles", "claims_what_is_true_with_a_heading", "samples_what_it_claims"}
    assert set(skipped) == need_heading
    assert set(skipped.values()) == {"refuses this problem: made for known headings"}


def test_sampling_is_optional() -> None:
    """Without the method the check is skipped, and says so."""

    class Mute(Kalman):
        sample = None  # type: ignore[assignment]

    (result,) = [result for result in run_checks(Mute) if result.outcome == "skipped"]
    assert result.name == "samples_what_it_claims"
    assert "optional" in result.detail


def test_no_log_evidence_is_allowed() -> None:
    """NaN, meaning not computed, passes; only the flag for impossible measurements is skipped."""

    class Mute(Kalman):
        def estimate(self, belief: Any) -> Any:
            return Estimate(belief.mean, belief.covariance)

    outcomes = {result.name: result.outcome for result in run_checks(Mute)}
    assert outcomes.pop("impossible_measurement_is_flagged") == "skipped"
    assert set(outcomes.values()) == {"passed"}


def test_options_reach_the_estimator() -> None:
    """Twelve particles by option are as bad as twelve by default."""
    (check,) = [check for check in checks_for(Particles, size=12) if check.name.startswith("agrees")]
    assert check.result().outcome == "failed"
    assert run_checks(Particles, sizes=12)[0].detail.startswith("TypeError: ")


def test_an_expected_failure_must_fail() -> None:
    """With a reason a failure is expected; when it passes all the same, that is an error."""
    expected = {"claims_what_is_true": "made so on purpose", "can_be_built": "wrong"}
    results = {result.name: result for result in run_checks(ClaimsTooLittle, expected_failures=expected)}
    assert results["claims_what_is_true"].outcome == "expected_failure"
    assert results["claims_what_is_true"].detail.startswith("made so on purpose (ANEES")
    assert results["can_be_built"].outcome == "unexpected_pass"
    assert not conforms([results["can_be_built"]])
    assert conforms([results["claims_what_is_true"]])


def test_an_expected_failure_needs_a_reason_and_a_check() -> None:
    """Neither an empty reason nor a name that is no check is taken."""
    with pytest.raises(ValueError, match="needs a reason: can_be_built"):
        checks_for(Kalman, expected_failures={"can_be_built": " "})
    with pytest.raises(ValueError, match="no check can_fly; there are can_be_built, "):
        checks_for(Kalman, expected_failures={"can_fly": "it has no wings"})


def test_a_failure_under_pytest_says_what_to_do() -> None:
    """The message holds the estimator, what was seen, the meaning and the mend."""
    (check,) = [check for check in checks_for(ClaimsTooLittle) if check.name == "claims_what_is_true"]
    with pytest.raises(CheckFailure, match=r"(?s)ClaimsTooLittle: ANEES.*meaning: .*mend: "):
        check()


def test_as_pytest_sees_it(pytester: pytest.Pytester) -> None:
    """Passes, strict expected failures, skips and failures come out as such; names are readable."""
    pytester.makepyfile(
        """
        from rangefix.filters.checks import parametrize_with_checks

        def refuses(problem):
            raise ValueError("made for nothing")

        @parametrize_with_checks(["ekf"], expected_failures={"can_be_built": "out of date"})
        def test_one(check):
            check()

        @parametrize_with_checks([refuses], expected_failures={"can_be_built": "it refuses all"})
        def test_two(check):
            check()
        """
    )
    result = pytester.runpytest_inprocess("-p", "no:dash", "-k", "can_be_built or headings")
    result.assert_outcomes(passed=1, failed=1, xfailed=1, skipped=1)
    result.stdout.fnmatch_lines(["*FAILED*test_one?ekf-can_be_built?*"])
