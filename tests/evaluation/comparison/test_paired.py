"""Who is more accurate on the same truths."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from rangefix.evaluation import Experiment, compare_estimators, run
from rangefix.evaluation.results import InMemory, Results, Trials

from ..conftest import PriorOnly, make_problem

SPACE = make_problem().space


def results_of(errors):
    """Results of one step with the given errors (E, M, 2) of estimators on the same truths."""
    count, runs, _ = errors.shape
    truth = np.zeros((runs, 1, 2))
    trials = tuple(
        Trials(
            f"e{number}", "all", mean=truth - errors[number][:, None],
            covariance=np.broadcast_to(np.eye(2), (runs, 1, 2, 2)).copy(),
            log_evidence=np.zeros((runs, 1)), log_evidence_floor=np.zeros((runs, 1)),
            status=np.isnan(errors[number]).any(1).astype(np.int8),
        )
        for number in range(count)
    )  # fmt: skip
    source = InMemory(truth, np.zeros((runs, 1, 1)), trials)
    labels = tuple(f"e{number}" for number in range(count))
    return Results({"name": "s", "seed": 0}, SPACE, labels, ("all",), runs, source)


def test_the_better_is_found_and_told():
    """Errors that the estimators share hide in the spread of each, not in the pairs."""
    rng = np.random.default_rng(1)
    shared, own = rng.normal(size=(200, 2)), rng.normal(size=(200, 2))
    (pair,) = compare_estimators(results_of(np.stack([shared, shared + 0.5 * own])))
    assert (pair.best, pair.estimator, pair.runs) == ("e0", "e1", 200)
    assert pair.significant
    assert pair.rmse**2 - pair.best_rmse**2 == pytest.approx(pair.change.value)
    assert pair.words.startswith("less accurate than e0: its error is 1.")
    assert 0.3 < pair.closer < 0.5


@pytest.mark.study
def test_equal_estimators_are_seldom_told_apart():
    """Five equally accurate ones: the best is chosen by the same runs, and yet at most 5 % are accused.

    300 studies; the bound is 5 % and three standard errors.
    """
    rng, accused = np.random.default_rng(2), 0
    for _ in range(300):
        shared = rng.normal(size=(40, 2))
        errors = np.stack([shared + rng.normal(size=(40, 2)) for _ in range(5)])
        accused += any(pair.significant for pair in compare_estimators(results_of(errors)))
    assert accused <= 300 * 0.05 + 3 * np.sqrt(300 * 0.05 * 0.95)


def test_equal_estimators_that_are_seldom_lost_are_seldom_told_apart():
    """Each is 30 m off in 1 % of 300 runs: two lost runs more than the other's were told as a difference.

    200 studies, of which 17 % were accused; the bound is 5 % and three standard errors.
    """
    rng, accused = np.random.default_rng(3), 0
    for _ in range(200):
        errors = rng.normal(size=(2, 300, 2)) * np.where(rng.random((2, 300, 1)) < 0.01, 30.0, 1.0)
        accused += any(pair.significant for pair in compare_estimators(results_of(errors)))
    assert accused <= 200 * 0.05 + 3 * np.sqrt(200 * 0.05 * 0.95)


def test_only_runs_in_which_both_answered_count():
    rng = np.random.default_rng(3)
    errors = rng.normal(size=(2, 50, 2))
    errors[1, :20] = np.nan
    (pair,) = compare_estimators(results_of(errors))
    both = (errors[:, 20:] ** 2).sum(2).mean(1) ** 0.5
    assert pair.runs == 30
    assert sorted([pair.rmse, pair.best_rmse]) == pytest.approx(sorted(both))


def test_one_that_fails_where_it_is_hard_is_not_the_best():
    """By its own runs e0 is better; where both answer e1 is, four times."""
    rng, hard = np.random.default_rng(4), np.arange(400) >= 200
    errors = rng.normal(size=(2, 400, 2)) * 0.2
    errors[0, hard] = np.nan
    errors[1] *= np.where(hard, 10.0, 0.25)[:, None]
    (pair,) = compare_estimators(results_of(errors))
    assert (pair.best, pair.estimator, pair.runs) == ("e1", "e0", 200)
    assert pair.rmse > 3 * pair.best_rmse
    assert pair.words.startswith("less accurate than e1: its error is")


def test_one_that_answers_seldom_is_not_the_best_but_may_be_more_accurate_where_it_does():
    rng = np.random.default_rng(5)
    errors = rng.normal(size=(3, 400, 2))
    errors[0, 100:] = np.nan
    errors[0] *= 0.1
    seldom, other = compare_estimators(results_of(errors))
    assert {seldom.best, other.best} < {"e1", "e2"}
    assert (seldom.estimator, seldom.runs) == ("e0", 100)
    assert seldom.words.startswith(f"more accurate than {seldom.best}: its error is 0.")


def test_one_that_never_answered_is_told_so():
    errors = np.stack([np.ones((9, 2)), np.full((9, 2), np.nan)])
    (pair,) = compare_estimators(results_of(errors))
    assert (pair.estimator, pair.runs, pair.words) == ("e1", 0, "no run in which both answered")
    assert not pair.significant


def test_the_same_estimator_twice():
    estimators = {"a": PriorOnly, "b": PriorOnly, "noisy": partial(PriorOnly, jitter=1.0)}
    pairs = compare_estimators(run(Experiment(make_problem(), estimators, runs=400), timing=False))
    told = {pair.estimator: pair for pair in pairs}
    assert told["b"].best == "a"
    assert told["b"].p == 1.0
    assert told["noisy"].significant
