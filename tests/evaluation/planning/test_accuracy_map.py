"""The map of accuracy: mistaken places against closed forms and draws, deviations against a filter."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from scipy.special import ndtr

from rangefix.arrays import Array
from rangefix.evaluation import load_study
from rangefix.evaluation.planning import accuracy_map as module
from rangefix.evaluation.planning.accuracy_map import AccuracyMap, accuracy_map
from rangefix.filters import (
    BeamMixture,
    Biased,
    Gaussian,
    LostBeams,
    Quantised,
    Rangefinder,
    StudentT,
    Tempered,
    build,
    sweep,
)
from rangefix.filters.models.noise import CumulativeNoise
from rangefix.maps import FloorPlan, RectangularRoom

from ..bounds.problems import located

STD, SHORTER = 0.05, 0.1


def two_arms(shorter: float) -> FloorPlan:
    """Two arms side by side, 6 m long and a little less, one 1 m further ahead than the other."""
    top = 7 - shorter
    return FloorPlan([[0, 0], [2, 0], [2, 1], [4, 1], [4, top], [2, top], [2, 6], [0, 6]])


def judged(shorter: float, bearings_deg: list[float]) -> AccuracyMap:
    problem = located(two_arms(shorter), bearings_deg, STD)
    return accuracy_map(problem, problem.sensor, 0.25)


@pytest.mark.parametrize("shorter", [0.0, SHORTER, 0.2])
def test_two_arms_of_unlike_length_have_a_closed_form(shorter: float) -> None:
    """Ahead and back: the best spot of the other arm halves the difference, so d = difference / (sqrt(2) r).

    It is 1 m further ahead, which no ellipse covers. The spot lies within half a step of a place but at the
    far ends of the arms: exact below them.
    """
    found = judged(shorter, [0.0, 180.0])
    inside = np.isfinite(found.mistaken) & (found.x2[:, None] < 5)
    expected = ndtr(-0.5 * shorter / (np.sqrt(2) * STD))
    assert inside.sum() > 250
    np.testing.assert_allclose(found.mistaken[inside], expected, rtol=1e-6)


def test_a_beam_across_tells_the_arms_apart_but_at_their_ends() -> None:
    """To the right the near arm is open but for its first metre, as the far one is nowhere."""
    found = judged(0.0, [0.0, 180.0, 90.0])
    near, ahead = found.x1 < 1.5, found.x2
    np.testing.assert_allclose(found.mistaken[np.ix_(ahead < 1, near)], 0.5, atol=1e-6)
    amid = found.mistaken[np.ix_((ahead > 2.5) & (ahead < 5), near)]
    assert amid.max() < 1e-3
    assert (np.isnan(found.mistaken) == (found.beams_seen < 0)).all()  # walls


def test_what_is_mistaken_is_what_draws_mistake() -> None:
    """The arm that fits best, of 20 000 drawn scans from one place, on spots 2 mm apart: 4 deviations."""
    rng = np.random.default_rng(5)
    ahead = np.arange(-1, 1, 0.002)
    place = 3.0 + ahead  # of both arms, from the end behind
    readings = np.array([3.0, 3.0]) + STD * rng.normal(size=(20_000, 2))  # of the arm of 6 m, amid it
    fits = [
        ((readings[:, None, 0] - (length - place)) ** 2 + (readings[:, None, 1] - place) ** 2).min(axis=1)
        for length in (6.0, 6.0 - SHORTER)
    ]
    share = float((fits[1] < fits[0]).mean())
    expected = float(np.nanmean(judged(SHORTER, [0.0, 180.0]).mistaken))
    assert abs(share - expected) < 4 * np.sqrt(expected * (1 - expected) / len(readings))


def test_places_of_a_room_with_known_heading_are_mistaken_for_none() -> None:
    """Two walls that are met squarely leave one place."""
    problem = located(FloorPlan([[0, 0], [4, 0], [4, 6], [0, 6]]), [0.0, 90.0])
    found = accuracy_map(problem, problem.sensor, 0.25)
    assert np.nanmax(found.mistaken) == 0.0


def test_so_many_places_are_not_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    """Above a number of places the share is NaN everywhere, and deviations are there as before."""
    before = judged(0.0, [0.0, 180.0])
    monkeypatch.setattr(module, "MOST_JUDGED", 10)
    found = judged(0.0, [0.0, 180.0])
    assert np.isnan(found.mistaken).all()
    np.testing.assert_array_equal(found.covariance, before.covariance)


@pytest.mark.study
@pytest.mark.parametrize(("beams", "scans"), [(8, 10), (40, 2)])
def test_in_a_building_edges_of_near_objects_explain_where_posteriors_are_better(
    beams: int, scans: int, avz: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """200 places: the exact posterior's deviation, averaged over scans, against what gradients say.

    Where no range jumps and no wall stands within two deviations of a place they agree within some per cent:
    found 0.98 to 1.02 for 8 in 10 places, correlation of logs 0.99. Beside an edge the posterior knows on
    which side of it the beam passed: median 0.90 with 8 beams and 0.84 with 40, down to 0.3.
    """
    problem = load_study("mesh", map_path=avz).problem()
    assert isinstance(problem.sensor, Rangefinder)
    bearings = sweep(2 * np.pi / beams, 0.0)
    problem = replace(problem, sensor=replace(problem.sensor, bearings=bearings, noise=Gaussian(STD)))
    found = accuracy_map(problem, problem.sensor, 0.1)
    rng = np.random.default_rng(7)
    lower, upper = problem.prior.support
    rows, columns = np.nonzero(np.isfinite(found.position_std))
    places = np.stack([found.x1[columns], found.x2[rows]], axis=1)
    within = np.flatnonzero(((places > lower) & (places < upper)).all(axis=1))
    some = rng.choice(within, 200, replace=False)
    said = found.position_std[rows[some], columns[some]]
    truths = np.repeat(places[some], scans, axis=0)
    rngs = [np.random.default_rng(run) for run in range(len(truths))]
    filter_ = build("adaptive-point-mass", problem)
    belief = filter_.update(filter_.init(problem.prior, rngs), problem.sensor.sample(truths, rng), rngs)
    covariances = np.asarray(filter_.estimate(belief).covariance)
    true = np.sqrt(np.trace(covariances[:, :2, :2], axis1=1, axis2=2).reshape(200, scans).mean(axis=1))
    ratio = true / said
    jumps = np.array(
        [
            beside_an_edge(problem.sensor, places[place], found.covariance[rows[place], columns[place]])
            for place in some
        ]
    )
    smooth = float(np.corrcoef(np.log(true[~jumps]), np.log(said[~jumps]))[0, 1])
    low, middle, high = np.quantile(ratio[~jumps], [0.1, 0.5, 0.9])
    with capsys.disabled():
        print(
            f"\n{beams} beams, {(~jumps).sum()} places without an edge nearby: exact / map {low:.2f} to "
            f"{high:.2f}, correlation of logs {smooth:.3f}; {jumps.sum()} beside one: median "
            f"{np.median(ratio[jumps]):.2f}, least {ratio.min():.2f}"
        )
    assert low > 0.93
    assert abs(middle - 1) < 0.02
    assert high < 1.05
    assert smooth > 0.95
    assert np.median(ratio[jumps]) < 0.95
    assert (ratio < 0.8).sum() == (ratio[jumps] < 0.8).sum()  # every place that is much better has an edge


def beside_an_edge(sensor: Rangefinder, place: Array, covariance: Array) -> bool:
    """Whether within two deviations of a place a range jumps or bends, or a wall stands."""
    angles = np.arange(24) * 2 * np.pi / 24
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=1) @ np.linalg.cholesky(covariance).T
    away = np.concatenate([radius * ring for radius in (0.5, 1.0, 1.5, 2.0)])
    if not sensor.room.is_free(place + away).all():
        return True
    [here], [slopes] = sensor.look(place[None])
    ranges, _ = sensor.look(place + away)
    with np.errstate(invalid="ignore"):
        off = np.abs(ranges - here - away @ slopes.T)
    return bool(np.nan_to_num(off, nan=0.0).max() > STD)


def test_a_room_longer_than_a_mixture_reaches() -> None:
    """Where a wall is a metre off it makes no difference whether the laser measures 5 m or 8: to 2 %.

    In the room of 4 x 6 m walls at 6 m are beyond the reach of one of them.
    """
    near = np.zeros((2, 2))
    for place, reach in enumerate((5.0, 8.0)):
        noise = BeamMixture(0.8, 0.05, 0.05, 0.1, 0.1, 1.0, reach)
        problem = located(RectangularRoom(4.0, 6.0), [0.0, 90.0], STD)
        sensor = replace(problem.sensor, noise=noise, max_range=reach)  # type: ignore[type-var]
        found = accuracy_map(replace(problem, sensor=sensor), sensor, 0.25)
        row, column = np.abs(found.x2 - 5.0).argmin(), np.abs(found.x1 - 3.0).argmin()
        near[place] = np.diagonal(found.covariance[row, column])
    np.testing.assert_allclose(near[0], near[1], rtol=0.02)


@pytest.mark.parametrize("std", [0.05, 0.01, 0.002])
@pytest.mark.parametrize("lost", [0.0, 0.2])
def test_rounding_in_closed_form(std: float, lost: float) -> None:
    """Readings of a wall met squarely, rounded to 5 cm: a variance of std^2 + step^2 / 12 for any std.

    That is what a flat prior leaves on average over the places in a step: a Gaussian and an even law in sum.
    The width of noise is known to 3 %. A beam that is lost in a fifth of the scans tells four fifths.
    """
    step, problem = 0.05, located(RectangularRoom(4.0, 6.0), [0.0, 90.0])
    noise = LostBeams(Quantised(Gaussian(std), step), lost) if lost else Quantised(Gaussian(std), step)
    sensor = replace(problem.sensor, noise=noise)  # type: ignore[type-var]
    found = accuracy_map(problem, sensor, 0.5)
    expected = np.sqrt(2 * (std**2 + step**2 / 12) / (1 - lost))
    np.testing.assert_allclose(found.position_std, expected, rtol=0.03)


@pytest.mark.parametrize(
    ("noise", "bias"),
    [
        *product([Gaussian(0.05), Gaussian(0.01)], [-0.3, 0.05, 0.1, 1.0]),
        (StudentT(0.02, 3.0), -0.3),
        pytest.param(StudentT(0.02, 3.0), 0.1, marks=pytest.mark.study),
    ],
)
def test_a_bias_that_is_known_costs_nothing(noise: CumulativeNoise, bias: float) -> None:
    """Readings less the bias are those without one."""
    problem = located(two_arms(SHORTER), [0.0, 180.0])
    plain, biased = (
        accuracy_map(problem, replace(problem.sensor, noise=law), 0.5)  # type: ignore[type-var]
        for law in (noise, Biased(noise, bias))
    )
    np.testing.assert_allclose(biased.covariance, plain.covariance, rtol=1e-3, atol=1e-9)
    np.testing.assert_allclose(biased.mistaken, plain.mistaken, rtol=0.02, atol=1e-6)


def test_readings_that_weigh_less_tell_a_share_of_what_their_law_tells() -> None:
    """A fifth of the beams is lost by the law, 0.2; to the power of the weight that is 0.85."""
    problem = located(RectangularRoom(4.0, 6.0), [0.0, 90.0])
    noise = Tempered(LostBeams(Gaussian(0.02), 0.2), 0.1)
    found = accuracy_map(problem, replace(problem.sensor, noise=noise), 0.5)  # type: ignore[type-var]
    np.testing.assert_allclose(found.position_std, 0.02 * np.sqrt(2 / 0.8 / 0.1), rtol=0.01)
