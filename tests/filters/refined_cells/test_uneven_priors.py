"""Priors that a quadratic does not follow within a cell: the exact filter says what is right."""

from __future__ import annotations

import numpy as np
import pytest

from rangefix.filters import (
    Gaussian,
    GaussianPrior,
    Mixture,
    Prior,
    Problem,
    Rangefinder,
    Stationary,
    Uniform,
    position_space,
)
from rangefix.filters.exact import ExactPositionFilter
from rangefix.filters.refined_cells import RefinedPointMassFilter
from rangefix.filters.refined_cells.coarse_cells import cover
from rangefix.filters.space import deviations_apart
from rangefix.maps import FloorPlan, RectangularRoom

ROOM, SPACE = RectangularRoom(4.0, 6.0), position_space()


def near(place: tuple[float, float], std: float) -> GaussianPrior:
    return GaussianPrior(place, std**2 * np.eye(2), SPACE, ROOM)


BOX = Mixture([near((1.0, 2.0), 0.2), Uniform(ROOM, SPACE, lower=[2.0, 3.0], upper=[3.0, 5.0])], [0.2, 0.8])
PEAKS = Mixture([near((1.0, 2.0), 0.05), near((2.0, 3.0), 0.5)])
NEEDLE = Mixture([near((1.013, 2.021), 0.001), Uniform(ROOM, SPACE)])


def answers(prior: Prior, place: tuple[float, float]) -> tuple[float, float, float]:
    """Deviations from the exact filter, what is stated of them, and the difference of log evidences."""
    sensor = Rangefinder(ROOM, np.deg2rad([-100.0, 0.0, 80.0]), Gaussian(0.05), SPACE)
    problem, rngs = Problem(SPACE, Stationary(SPACE), sensor, prior), [np.random.default_rng(0)]
    estimator, exact = RefinedPointMassFilter(problem), ExactPositionFilter(problem)
    reading = sensor.expected(np.array([place]))
    belief = estimator.update(estimator.init(prior, rngs), reading, rngs)
    found = estimator.estimate(belief)
    right = exact.estimate(exact.update(exact.init(prior, rngs), reading, rngs))
    off = float(deviations_apart(SPACE, found, right)[0])
    return off, float(estimator.error(belief)[0]), abs(float(found[2][0] - right[2][0]))  # type: ignore[index]


@pytest.mark.parametrize(
    ("prior", "place"),
    [
        (BOX, (2.5, 3.2)),
        (BOX, (2.5, 3.02)),
        (BOX, (2.02, 3.02)),
        (BOX, (1.1, 1.9)),
        (PEAKS, (1.2, 2.0)),
        (PEAKS, (1.05, 2.0)),
    ],
)
def test_steps_within_cells(prior: Prior, place: tuple[float, float]) -> None:
    """Where a box begins 50 nats above the tail of another part, and where one part takes over from another.

    Cells that the edge of the box crossed held e^12 times as much as all: the mean was 4 deviations off.
    """
    off, stated, evidence = answers(prior, place)
    assert off <= stated <= 0.02
    assert evidence < 0.005


def test_a_part_narrower_than_cells_is_told() -> None:
    """A part of 1 mm between the corners of cells of 5 cm: an error of 0.002 was stated of what was 1 off."""
    off, stated, _ = answers(NEEDLE, (1.0, 2.0))
    assert off <= 1.01 * stated


def test_cells_that_are_free_in_a_chink_alone_are_covered_in_silence() -> None:
    """Neither middle, faces nor corners of such a cell are free, places in it are: numpy does not warn."""
    spikes = [
        [10 - (number + 0.3) / 4 - aside, height]
        for number in range(40)
        for aside, height in ((0.0, 4.0), (0.013, 5.03 + 0.01 * number), (0.03, 4.0))
    ]
    room, space = FloorPlan([[0, 0], [10, 0], [10, 4], *spikes, [0, 4]]), position_space(heading=0.0)
    sensor = Rangefinder(room, np.deg2rad([0.0, 90.0]), Gaussian(0.02), space)
    problem = Problem(space, Stationary(space), sensor, Uniform(room, space))
    cells = cover(problem, np.zeros(2), 0)
    assert (cells.prior.level == -np.inf).any()
    assert not np.isnan(cells.prior.off).any()
    assert np.exp(cells.log_integral) == pytest.approx(1.0, abs=0.01)
