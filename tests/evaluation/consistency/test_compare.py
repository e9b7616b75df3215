"""The harness on filters whose G and P are known: it must acquit the honest and catch the others."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from rangefix.evaluation import Experiment, load_study, run, summarise
from rangefix.evaluation.trials.built_estimator import BuiltEstimator
from rangefix.evaluation.trials.evidence_floor import evidence_floor
from rangefix.evaluation.trials.trial import Trial

from ..conftest import PriorOnly, make_problem


@pytest.fixture(scope="module")
def rows():
    estimators = {
        "honest": PriorOnly,
        "overconfident": partial(PriorOnly, scale=0.5),
        "cautious": partial(PriorOnly, scale=2.0),
        "biased": partial(PriorOnly, shift=0.5),
        "noisy": partial(PriorOnly, jitter=1.0),
    }
    results = run(Experiment(make_problem(), estimators, runs=3000, seed=1), timing=False)
    return {row.estimator: row for row in summarise(results)}


def test_the_honest_filter_is_acquitted(rows):
    """G is diag(16, 36) / 12: four 95 % intervals hold it; false alarms for fewer than 1 seed in 5."""
    honest = rows["honest"]
    for interval, variance in zip(honest.g, (16 / 12, 36 / 12), strict=True):
        assert interval.low <= variance <= interval.high
    assert all(ratio.low <= 1 <= ratio.high for ratio in honest.ratio)
    assert honest.anees.low <= 1 <= honest.anees.high


@pytest.mark.parametrize(
    ("name", "ratio"), [("overconfident", 2.0), ("cautious", 0.5), ("noisy", 1 + 1 / (16 / 12))]
)
def test_planted_faults_are_caught(rows, name, ratio):
    """The ratio of x1 is as planted within 8 %, four standard errors, and its interval leaves out 1."""
    found = rows[name].ratio[0]
    assert found.value == pytest.approx(ratio, rel=0.08)
    assert not found.low <= 1 <= found.high


def test_bias_is_caught(rows):
    for bias in rows["biased"].bias:
        assert bias.low <= -0.5 <= bias.high
        assert bias.high < 0


@pytest.fixture(scope="module")
def paper():
    study = load_study("paper", runs=600)
    some = [each for each in study.estimators if each.name in ("point-mass", "ekf")]
    made = study.model_copy(update={"estimators": some}).experiment()
    return {(row.estimator, row.beams): row for row in summarise(run(made, timing=False))}


@pytest.mark.parametrize("beams", ["1", "1+2", "1+3", "1+2+3"])
def test_the_point_mass_filter_of_the_paper_is_honest(paper, beams):
    """G over mean P, and ANEES / n, are 1 within four half widths of their 95 % intervals.

    The half width is two standard errors, so a correct filter fails for fewer than 1 seed in 10^10.
    """
    row = paper["point-mass", beams]
    for figure in (*row.ratio, row.anees):
        assert abs(figure.value - 1) < 4 * max(figure.high - figure.value, figure.value - figure.low)
    assert row.improbable.value == 0


def test_the_paper_s_unconditional_covariance(paper):
    """G for all three beams is about diag(0.19, 0.0013) m^2, within 25 %, some four standard errors."""
    row = paper["point-mass", "1+2+3"]
    assert np.diag(row.G) == pytest.approx([0.19, 0.0013], rel=0.25)


def test_the_extended_kalman_filter_must_not_be_trusted(paper):
    row = paper["ekf", "1+2+3"]
    assert row.anees.low > 100
    assert row.inclination.low > 10
    assert row.coverage[0.9].high < 0.5


def test_an_impossible_reading_is_flagged():
    """Straight ahead 2.5 m too short, against what the other two beams say of the room.

    All estimators stay finite; those that hold the whole posterior say how improbable it was. A Kalman filter
    does not: its linear model of the room finds the reading likely elsewhere.
    """
    made = load_study("paper").experiment()
    problem = made.assumed_problem
    measurement = problem.sensor.expected(np.array([[2.0, 3.0]]))[:, None]
    measurement[..., 1] -= 2.5
    floor = evidence_floor(problem.sensor, measurement)[0, 0]
    for label, build in made.estimators.items():
        outcome = BuiltEstimator(Trial(problem, made.control_sequence, seed=1), build(problem)).run(
            measurement, 0
        )
        assert outcome.status.tolist() == [0], label
        assert np.isfinite(outcome.log_evidence[0, 0])
        if label in ("point-mass", "particle"):
            assert outcome.log_evidence[0, 0] < floor - 500
