"""The adaptive point-mass filter over random problems: what it is off by, against what it says of itself.

`RANGEFIX_RANDOM=400` in the environment asks for so many problems of each family in the study, and prints
how errors, stated errors and times are spread.
"""

from __future__ import annotations

import os
import time
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from rangefix.arrays import Array
from rangefix.filters import EachRun, Gaussian, Problem, Rangefinder, Stationary, Uniform, build, pose_space
from rangefix.filters.adaptive import AdaptivePointMassFilter
from rangefix.filters.adaptive.range_table import TABLE_RAYS
from rangefix.filters.adaptive.target import STATE_COST, WORK, TooManyCells, Work
from rangefix.filters.exact import ExactPositionFilter
from rangefix.filters.optional_methods import numerical_error
from rangefix.filters.space import LEAST_RESULTANT, deviations_apart
from rangefix.maps import FloorPlan

from ..families import FINE, HEADING, POSITION, Drawn, draw
from .heading_oracle import known, off_by

FINER_TABLE_RAYS = 30_000_000  # of the reference, whose cells are others than the default's
COUNT = int(os.environ.get("RANGEFIX_RANDOM", "400"))
MEAN, COVARIANCE = 0.05, 0.1  # deviations, variances: beyond them an answer is a miss
EXCEEDED_SHARE, EXCEEDED_FACTOR = (
    0.005,
    3.0,
)  # of the problems, and by how much, a stated error may be exceeded


class Found(NamedTuple):
    """Error of the mean in deviations and of the covariance in variances, what is stated, and seconds.

    And what the reference states of itself.
    """

    mean: float
    covariance: float
    stated: float
    seconds: float
    sure: float


def answer(
    problem: Drawn, accuracy: float, limit: float, table_rays: int = TABLE_RAYS
) -> tuple[Array, Array, float, float, float]:
    """Mean, covariance, stated error, resultant and seconds of a fix on lattices that may cost so much."""
    before = Work.__init__.__defaults__
    Work.__init__.__defaults__ = (limit, 0.0)
    try:
        estimator = AdaptivePointMassFilter(
            problem.problem, accuracy, table_rays=table_rays, most_cells=3_000_000
        )
        rng, begin = np.random.default_rng(0), time.process_time()
        belief = estimator.update(estimator.init(problem.problem.prior, rng), problem.readings[0], rng)
        seconds = time.process_time() - begin
    finally:
        Work.__init__.__defaults__ = before
    mean, covariance, _ = estimator.estimate(belief)
    resultant = 1.0 if problem.problem.space.heading is not None else estimator.resultant(belief)
    return mean, covariance, estimator.error(belief), resultant, seconds


def compared(family: str, number: int) -> Found | None:
    """The filter at its defaults against itself, ten times as accurate; None where there is no mean heading.

    The finer one shares no lattice with it, nor the table by which modes are looked for. Its own stated error
    bounds what it is off by, and counts. Where it finds no mean heading, the first must not be sure of one.
    """
    problem = draw(family, number)
    mean, covariance, stated, resultant, seconds = answer(problem, 0.02, WORK)
    if resultant < 2 * LEAST_RESULTANT:
        return None
    finer, spread, sure, direction, _ = answer(problem, 0.002, 50 * WORK, FINER_TABLE_RAYS)
    if direction < LEAST_RESULTANT:
        return Found(np.inf, np.inf, stated, seconds, 0.0)
    std = np.sqrt(np.diag(spread))
    off = np.abs(problem.problem.space.difference(mean, finer)) / std
    wrong = np.abs(covariance - spread) / np.outer(std, std)
    return Found(float(off.max()), float(wrong.max()), stated, seconds, sure)


def judged(family: str, numbers: range) -> None:
    """No unflagged miss, and stated errors exceeded as rarely and by as little as is promised."""
    found = [each for number in numbers if (each := compared(family, number)) is not None]
    stated, sure = np.array([each.stated for each in found]), np.array([each.sure for each in found])
    errors = np.maximum(np.array([max(each[:2]) for each in found]) - sure, 0.0)
    seconds = np.array([each.seconds for each in found])
    print(f"\n{family}: {len(found)} of {len(numbers)} have a mean heading; error {np.median(errors):.2g} to "
          f"{errors.max():.2g}, stated {np.median(stated):.2g} to {stated.max():.2g}, exceeded in "
          f"{(errors > stated).sum()}, {np.median(seconds):.2g} to {seconds.max():.2g} s")  # fmt: skip
    missed = np.array(
        [each.mean > MEAN + each.sure or each.covariance > COVARIANCE + each.sure for each in found]
    )
    assert not (missed & (stated < MEAN)).any()
    assert (errors > stated).sum() <= EXCEEDED_SHARE * len(found)
    assert (errors <= EXCEEDED_FACTOR * stated).all()


@pytest.mark.parametrize(
    "family",
    [pytest.param(name, marks=[pytest.mark.study] if name == "circle" else []) for name in HEADING + FINE],
)
def test_says_how_far_off_it_is(family: str) -> None:
    """Two problems of any heading: nothing missed, and no stated error exceeded."""
    judged(family, range(6, 8))


@pytest.mark.parametrize(("family", "number"), [("arc", 1381), ("fine", 1137)])
def test_modes_that_lie_between_middles_of_boxes_are_found(family: str, number: int) -> None:
    """Modes narrower than the boxes of the search, whose middles all fit as badly as those of others.

    Arc 1381 was off by 0.12 where 0.019 was stated, fine 1137 by 0.020 where 0.012 was.
    """
    judged(family, range(number, number + 1))


def test_a_lattice_that_passes_by_a_mode_in_its_cells_gives_way() -> None:
    """A lattice about a low peak, with steps wider than a mode in one of its cells, kept others from that.

    Half of the posterior was lost, and 44 deviations stated; it is two mirrored modes 0.86 m apart.
    """
    drawn, rng = draw("fine", 10_002), np.random.default_rng([12, 10_002])
    reading = drawn.problem.sensor.sample(drawn.problem.prior.sample(4, rng), rng)[2]
    found = []
    for accuracy in (0.02, 0.004):
        estimator = AdaptivePointMassFilter(drawn.problem, accuracy)
        belief = estimator.update(estimator.init(drawn.problem.prior, rng), reading, rng)
        assert estimator.error(belief) < accuracy
        found.append(estimator.estimate(belief))
    assert abs(found[0].mean - found[1].mean).max() < 1e-5
    assert found[0].log_evidence == pytest.approx(found[1].log_evidence, abs=1e-3)
    assert np.sqrt(found[0].covariance[1, 1]) == pytest.approx(0.86 / 2, abs=0.01)


def test_a_covariance_that_hangs_on_where_the_mean_heading_lies_is_in_the_error() -> None:
    """Modes of a tenth half a turn from the mean, less than one of their deviations from the cut.

    The mean is off by 0.0005 deviations; the covariance by 0.029, for the modes are then cut elsewhere: more
    than the 0.02 to which lattices are made finer. By last bits, so by processors, what is stated may move
    them wholly to the other side, where they were looked at only if they were cut: 0.023 was stated.
    """
    *_, stated, _, _ = answer(draw("fine", 1397), 0.02, WORK)
    assert 0.029 < stated < 1


def test_lattices_are_made_finer_until_the_mean_heading_is_known_well_enough() -> None:
    """Headings all round an L-shaped plan: sums good to 0.020, but half a turn from the mean lie modes.

    0.19 was stated, for a covariance about a mean heading that is off by all of the sums' error; finer
    lattices say 0.036. At an accuracy of 0.005 the answer is no further off than that.
    """
    space, corners = pose_space(), [[0, 0], [5, 0], [5, 3], [2, 3], [2, 5], [0, 5]]
    plan = FloorPlan(corners)
    sensor = Rangefinder(plan, np.deg2rad([0.0, 120.0, 240.0]), Gaussian(0.05), space)
    problem = Problem(space, Stationary(space), sensor, Uniform(plan, space))
    reading, rngs = (
        np.array([[1.239014808708931, 1.6031027360780516, 4.401625184366266]]),
        [np.random.default_rng(0)],
    )
    found, stated = [], []
    for accuracy in (0.02, 0.005):
        estimator = build("adaptive-point-mass", problem, accuracy=accuracy)
        belief = estimator.update(estimator.init(problem.prior, rngs), reading, rngs)
        found.append(estimator.estimate(belief))
        stated.append(estimator.error(belief)[0])
    assert deviations_apart(space, found[1], found[0])[0] < stated[0] < 0.05


def test_a_mode_too_wide_for_the_usual_steps_is_answered_and_flagged() -> None:
    """A ridge through a whole plan, which takes more cells at twice the usual steps than the work allows.

    It was refused. Now its steps are doubled further. The mean resultant vector of its headings is 1e-4 long
    on lattices of fifty times the work, which is no mean direction; here 0.12, less than what that is off by.
    """
    mean, _, stated, resultant, _ = answer(draw("circle", 1007), 0.02, WORK)
    assert np.isfinite(mean).all()
    assert resultant < 0.2
    assert stated == np.inf


@pytest.mark.parametrize(
    ("family", "number", "most_cells"),
    [("arc", 1207, 8000), ("circle", 1055, 2000), ("circle", 1007, 20_000)],
)
def test_a_mode_that_halved_steps_would_fill_too_much_of_is_answered(
    family: str, number: int, most_cells: int
) -> None:
    """More than twice as many cells come of a halved step, and more than are allowed: it was refused."""
    problem, rng = draw(family, number), np.random.default_rng(0)
    estimator = AdaptivePointMassFilter(problem.problem, table_rays=1_000_000, most_cells=most_cells)
    belief = estimator.update(estimator.init(problem.problem.prior, rng), problem.readings[0], rng)
    mean, covariance, _ = estimator.estimate(belief)
    assert np.isfinite(mean).all()
    assert np.isfinite(covariance).all()
    assert estimator.error(belief) > MEAN


@pytest.mark.study
@pytest.mark.parametrize("family", HEADING + FINE)
def test_says_how_far_off_it_is_in_many_problems(family: str) -> None:
    """The same over 400 problems: exceeded in 0.5 % at most, by 3 times at most."""
    judged(family, range(1000, 1000 + COUNT))


@pytest.mark.study
@pytest.mark.parametrize("family", HEADING)
def test_agrees_with_exact_positions_at_each_heading(family: str) -> None:
    """20 problems against an integral over headings of exact positions: no miss, no error beyond 3 times.

    The reference is good to 1e-3; where no heading is the mean, only the filter's own word is asked for.
    """
    for number in range(2000, 2020):
        problem = draw(family, number)
        reference = known(problem)
        mean, covariance, stated, _ = off_by(problem, reference)
        if stated < np.inf:
            assert mean < MEAN or stated > MEAN, number
            assert covariance < COVARIANCE or stated > MEAN, number
            assert max(mean, covariance) < EXCEEDED_FACTOR * stated + 2e-3, number


@pytest.mark.parametrize("family", POSITION)
def test_positions_at_a_known_heading_are_exact(family: str) -> None:
    """The name stands for the exact filter there, which states errors below 1e-3 in five problems of each."""
    for number in range(5):
        problem = draw(family, number)
        estimator = build("adaptive-point-mass", problem.problem)
        assert isinstance(estimator, ExactPositionFilter)
        rngs = [np.random.default_rng(0)]
        belief = estimator.update(estimator.init(problem.problem.prior, rngs), problem.readings, rngs)
        stated = numerical_error(estimator, belief, 1)
        assert stated is not None
        assert 0 < stated[0] < 1e-3


def test_other_problems_get_lattices() -> None:
    """An unknown heading, and a moving object, with the options that were asked for."""
    for family in ("circle", "walk"):
        estimator = build("adaptive-point-mass", draw(family, 0).problem, accuracy=0.1, table_rays=10_000)
        assert isinstance(estimator, EachRun)
        assert isinstance(estimator.single, AdaptivePointMassFilter)
        assert estimator.single.accuracy == 0.1


def test_work_is_bounded() -> None:
    """One beam of three at any heading: the fix ends with what it may cost, and says that it is off."""
    problem = draw("circle", 3)
    reading = np.full(3, np.nan)
    reading[0] = problem.readings[0, 0]
    estimator = AdaptivePointMassFilter(problem.problem, table_rays=500_000)
    rng = np.random.default_rng(0)
    belief = estimator.update(estimator.init(problem.problem.prior, rng), reading, rng)
    assert belief.posterior is not None
    assert belief.posterior.cells < WORK / STATE_COST
    assert estimator.error(belief) > 0.02


def test_what_costs_too_much_is_refused() -> None:
    """Work has an end, which it names."""
    work = Work(limit=1e6)
    work.spend(9e5)
    assert work.has(1e5)
    assert not work.has(2e5)
    with pytest.raises(TooManyCells, match=r"more than 1e\+06 rays"):
        work.spend(2e5)


def test_what_finer_lattices_no_longer_hold_is_counted() -> None:
    """By the last lattices, not by the first coarse ones; a mode that is lost counts.

    Which slivers go as steps are halved hangs on last bits, so on the processor.
    """
    drawn, rng = draw("arc", 1024), np.random.default_rng(0)
    estimator = AdaptivePointMassFilter(drawn.problem)
    belief = estimator.update(estimator.init(drawn.problem.prior, rng), drawn.readings[0], rng)
    target = estimator._targets(drawn.problem.prior, None, drawn.readings[:1])[0]
    first, survey = estimator._search.fix(drawn.problem.prior, target)
    assert survey is not None
    assert belief.posterior is not None
    last = belief.posterior
    assert last.missed == survey.missed(last) != survey.missed(first)
    least = min(last.modes, key=lambda mode: mode.log_integral)
    share = np.exp(least.log_integral - last.log_integral)
    lost = replace(last, modes=tuple(mode for mode in last.modes if mode is not least), checks=())
    assert survey.missed(lost) > last.missed + 0.3 * share
