"""What goes wrong in a run costs that run alone, and is named."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from rangefix.evaluation import STATUSES, stream
from rangefix.evaluation.trials.batch_size import batch_size, nbytes
from rangefix.evaluation.trials.built_estimator import BuiltEstimator
from rangefix.evaluation.trials.timing import runs_to_time, seconds_per_update, timed_pass
from rangefix.evaluation.trials.trial import Trial
from rangefix.filters import EachRun, Estimate

from ..conftest import PriorOnly, make_problem

RUNS = 12
MEASUREMENT = np.arange(float(RUNS))[:, None, None] * np.ones(3)


@dataclass(frozen=True)
class Faulty(PriorOnly):
    """Does something wrong in run 5 (the measurement tells it), whichever the batch."""

    fault: str = ""

    def update(self, belief, measurement, rngs):
        guilty = measurement[:, 0] == 5
        if self.fault == "raise" and guilty.any():
            raise ZeroDivisionError("five\nis too much")
        if self.fault == "hang" and guilty.any():
            while True:
                pass
        if self.fault == "write" and guilty.any():
            measurement[guilty] = 0
        if self.fault == "shape" and guilty.any():
            return belief[:, :1]
        if self.fault in ("nan", "inf", "1e101"):
            return np.where(guilty[:, None], float(self.fault), belief)
        return np.where(guilty[:, None], 100.0, belief) if self.fault == "diverge" else belief

    def estimate(self, belief):
        mean, covariance, evidence = super().estimate(belief)
        lost = belief[:, 0] == 100.0
        return Estimate(mean, covariance, np.where(lost, -np.inf, evidence))


def run(estimator, first=0, count=RUNS):
    trial = Trial(make_problem(), np.zeros((0, 0)), seed=3)
    return BuiltEstimator(trial, estimator).run(MEASUREMENT[first : first + count], first)


@pytest.mark.parametrize(
    ("fault", "status", "words"),
    [
        ("raise", "error", "update() at measurement 1 failed: ZeroDivisionError: five is too much (test"),
        ("write", "error", "assignment destination is read-only; copy what you write to (test"),
        ("shape", "error", "estimate() at measurement 1 failed: ValueError: mean has shape (1, 1)"),
        ("nan", "nan", "an estimate is not finite at measurement 1"),
        ("inf", "nan", "an estimate is not finite at measurement 1"),
        ("1e101", "nan", "an estimate is beyond 1e+100 at measurement 1"),
        ("diverge", "diverged", "-inf"),
    ],
)
def test_only_the_guilty_run_is_lost(fault, status, words):
    problem = make_problem()
    good = run(PriorOnly(problem, jitter=0.1))
    outcome = run(Faulty(problem, jitter=0.1, fault=fault))
    assert [STATUSES[code] for code in outcome.status] == ["ok"] * 5 + [status] + ["ok"] * 6
    assert list(outcome.reasons) == [5]
    assert words in outcome.reasons[5]
    others = np.arange(RUNS) != 5
    assert (outcome.mean[others] == good.mean[others]).all()
    assert (outcome.covariance[others] == good.covariance[others]).all()


def test_a_run_that_takes_too_long_costs_itself_alone():
    """Here, in this process: the batch is ended, and of its runs one by one the guilty one."""
    trial = Trial(make_problem(), np.zeros((0, 0)), seed=3)
    outcome = BuiltEstimator(trial, Faulty(make_problem(), fault="hang")).run(MEASUREMENT, 0, limit=0.2)
    assert [STATUSES[code] for code in outcome.status] == [
        "timeout" if run == 5 else "ok" for run in range(RUNS)
    ]
    assert outcome.reasons[5].startswith("update() at measurement 1: it took more than 0.2 s")


def test_each_run_draws_from_its_own_stream_whatever_the_batch():
    estimator = PriorOnly(make_problem(), jitter=0.1)
    whole = run(estimator)
    parts = np.concatenate([run(estimator, 0, 5).mean, run(estimator, 5, 7).mean])
    assert (whole.mean == parts).all()
    drawn = stream(3, "estimator", 4).standard_normal(2)
    assert whole.mean[4, 0] == pytest.approx(np.array([2.0, 3.0]) + 0.1 * drawn)


def test_wrong_number_of_things():
    class Two(PriorOnly):
        def estimate(self, belief):
            return super().estimate(belief)[:2]

    outcome = run(Two(make_problem()))
    assert (outcome.status == STATUSES.index("error")).all()
    assert "2 things" in outcome.reasons[0]


@pytest.mark.parametrize(
    ("field", "change", "words"),
    [
        ("mean", lambda value: value + 0j, "mean is of type complex128, not of real floats"),
        ("mean", lambda value: value.astype(object), "mean is of type object, not of real floats"),
        ("mean", lambda value: value.astype(str), "mean is of type <U32, not of real floats"),
        ("covariance", np.ma.masked_array, "covariance is a masked array, not one of real floats"),
        ("log_evidence", lambda value: value > 0, "log_evidence is of type bool, not of real floats"),
    ],
)
def test_what_is_no_array_of_real_floats_is_refused_by_name(field, change, words):
    class Odd(PriorOnly):
        def estimate(self, belief):
            estimate = super().estimate(belief)
            return estimate._replace(**{field: change(getattr(estimate, field))})

    outcome = run(Odd(make_problem()))
    assert (outcome.status == STATUSES.index("error")).all()
    assert outcome.reasons[0] == f"estimate() at measurement 1 failed: ValueError: {words}"


@pytest.mark.parametrize("kind", [np.float32, np.int64, list])
def test_other_real_numbers_become_float64(kind):
    class Short(PriorOnly):
        def estimate(self, belief):
            mean, covariance, evidence = super().estimate(belief)
            return Estimate(mean.tolist() if kind is list else mean.astype(kind), covariance, evidence)

    outcome = run(Short(make_problem()))
    assert not outcome.reasons
    assert outcome.mean.dtype == np.float64
    np.testing.assert_array_equal(outcome.mean[:, 0], np.tile([2.0, 3.0], (RUNS, 1)))


def test_draws_must_be_real():
    class Odd(PriorOnly):
        def sample(self, belief, size, rngs):
            return np.zeros((len(belief), size, 2), dtype=complex)

    trial = Trial(make_problem(), np.zeros((0, 0)), seed=3)
    truth = np.tile([2.0, 3.0], (RUNS, 1, 1))
    outcome = BuiltEstimator(trial, Odd(make_problem())).run(MEASUREMENT, 0, None, truth)
    assert "ValueError: what sample() gives is of type complex128, not of real floats" in outcome.reasons[0]


def test_reasons_are_cut():
    class Talks(PriorOnly):
        def update(self, belief, measurement, rngs):
            raise ValueError("x" * 5_000_000)

    outcome = run(Talks(make_problem()))
    assert len(outcome.reasons) == RUNS
    assert all(len(reason) < 2200 for reason in outcome.reasons.values())
    assert "(5000000 characters) (test_trial.py, line" in outcome.reasons[0]


def test_no_evidence_is_no_failure():
    class Silent(PriorOnly):
        def estimate(self, belief):
            return Estimate(*super().estimate(belief)[:2])

    outcome = run(Silent(make_problem()))
    assert not outcome.reasons
    assert np.isnan(outcome.log_evidence).all()


def test_several_steps():
    trial = Trial(make_problem(), np.zeros((2, 1)), seed=3)
    outcome = BuiltEstimator(trial, PriorOnly(make_problem())).run(np.ones((4, 3, 3)), 0)
    assert outcome.mean.shape == (4, 3, 2)
    assert outcome.covariance.shape == (4, 3, 2, 2)


def test_batches_fit_the_memory():
    class Big(PriorOnly):
        def init(self, prior, rngs):
            return [np.zeros((len(rngs), 125_000)), {"shared": np.zeros(5_000_000)}]

    trial = Trial(make_problem(), np.zeros((0, 0)), seed=3)
    assert batch_size(trial, Big(make_problem()), MEASUREMENT[:2]) == 16
    single = EachRun(PriorOnly(make_problem()))  # its verbs do not fit: its trials will say so
    assert batch_size(trial, single, MEASUREMENT[:2]) > 1000
    assert nbytes({"a": [np.zeros(3), (np.zeros(2), None)], "b": "text"}) == 40


def test_timing_is_per_update_and_run():
    """A clock of one second per reading of it: a batch of 8 over 2 steps takes 2 s, 1/8 s each."""
    ticks = iter(range(1000))
    trial, estimator = Trial(make_problem(), np.zeros((1, 1)), seed=3), PriorOnly(make_problem())
    clock = lambda: float(next(ticks))  # noqa: E731
    assert seconds_per_update(trial, estimator, np.ones((8, 2, 3)), clock=clock) == 1 / 8
    assert runs_to_time(trial, estimator, np.ones((8, 2, 3)), clock=clock) == 4
    assert runs_to_time(trial, estimator, np.ones((8, 2, 3)), budget=1e3, clock=clock) == 8
    faulty = Faulty(make_problem(), fault="raise")
    assert np.isnan(seconds_per_update(trial, faulty, np.full((4, 2, 3), 5.0)))
    assert runs_to_time(trial, faulty, np.full((4, 2, 3), 5.0)) == 0


def test_runs_that_take_much_longer_than_the_first_do_not_break_the_budget_of_timing():
    """The first four take 10 ms each, the others 1 s: after a look at what seemed to fit, four remain."""

    class Uneven(PriorOnly):
        def update(self, belief, measurement, rngs):
            nonlocal now
            now += float(np.where(measurement[:, 0] > 3, 1.0, 0.01).sum())
            return belief

    now = 0.0
    trial, estimator = Trial(make_problem(), np.zeros((0, 0)), seed=3), Uneven(make_problem())
    readings = np.tile(np.arange(40.0)[:, None, None], (1, 1, 3))
    assert runs_to_time(trial, estimator, readings, budget=0.6, clock=lambda: now) == 4
    few = np.zeros_like(readings)
    assert runs_to_time(trial, estimator, few, budget=0.6, clock=lambda: now) in (9, 10)  # rounding


def test_a_pass_that_takes_long_ends_and_tells_how_many_updates_it_is_of():
    """Updates of 3, 1, 3, 1, ... s: once ten seconds are over, after five of them, the rest is left."""

    class Slow(PriorOnly):
        def update(self, belief, measurement, rngs):
            nonlocal now
            now += float(measurement[0, 0])
            return belief

    now = 0.0
    trial, estimator = Trial(make_problem(), np.zeros((39, 1)), seed=3), Slow(make_problem())
    readings = np.tile(np.where(np.arange(40) % 2, 1.0, 3.0)[:, None], (1, 1, 3))
    assert timed_pass(trial, estimator, readings, clock=lambda: now)[:2] == (2.2, 5)
    assert timed_pass(trial, estimator, readings, longest=1e3, clock=lambda: now)[:2] == (2.0, 40)
    now = 0.0
    assert runs_to_time(trial, estimator, readings, clock=lambda: now) == 1
    assert now == 4.0  # its first two updates, once


@pytest.mark.parametrize(("seconds", "runs"), [(0.04, 1), (0.003, 4), (0.0001, 25)])
def test_a_pass_over_long_drives_holds_few_runs(seconds, runs):
    """Of 40 updates: one where four runs take longer than all passes may, else as many as fit."""

    class Slow(PriorOnly):
        def update(self, belief, measurement, rngs):
            nonlocal now, updates
            now, updates = now + seconds * len(measurement), updates + len(measurement)
            return belief

    now, updates = 0.0, 0
    trial, estimator = Trial(make_problem(), np.zeros((39, 1)), seed=3), Slow(make_problem())
    found = runs_to_time(trial, estimator, np.ones((128, 40, 3)), budget=0.6, clock=lambda: now)
    assert found == pytest.approx(runs, rel=0.05)  # rounding
    assert updates == 16 or seconds < 0.001  # four runs begun, twice
