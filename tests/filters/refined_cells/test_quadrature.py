"""Integrals over cells: the same bits however many threads share the runs, and boxes that hold their sums."""

from __future__ import annotations

import numpy as np
import pytest

from rangefix import compiled
from rangefix.arrays import Array
from rangefix.filters import Gaussian, Problem, Rangefinder, Stationary, Uniform, pose_space, position_space
from rangefix.filters.refined_cells import quadrature
from rangefix.filters.refined_cells.coarse_cells import cover
from rangefix.filters.refined_cells.likelihood import Likelihood
from rangefix.filters.refined_cells.refinement import Refined, Refinement
from rangefix.maps import RectangularRoom

ROOM = RectangularRoom(6.0, 4.0)
TRUTHS = np.array([[1.0, 1.5], [3.2, 0.7], [5.1, 3.3], [2.2, 2.9], [4.4, 1.1]])


def refinement(known_heading: bool) -> Refinement:
    space = position_space(heading=0.3) if known_heading else pose_space()
    sensor = Rangefinder(ROOM, np.array([0.0, 1.9]), Gaussian(0.02), space)
    problem = Problem(space, Stationary(space), sensor, Uniform(ROOM, space))
    return Refinement(problem, cover(problem, np.zeros(space.size), 1), 0.02, 200_000)


def measured(found: Refinement) -> Likelihood:
    states = TRUTHS if found.problem.space.size == 2 else np.column_stack([TRUTHS, np.full(len(TRUTHS), 0.3)])
    readings = np.asarray(found.problem.sensor.expected(states))[:, None] + 0.01
    return Likelihood(found.problem.sensor, readings, found.coarse.farthest)


def all_arrays(found: Refined) -> list[Array]:
    pool = found.pool
    return [
        found.mean,
        found.covariance,
        found.log_integral,
        found.error,
        pool.log_mass,
        pool.mean,
        pool.second,
    ]


@pytest.mark.parametrize("known_heading", [True, False])
def test_threads_that_share_the_runs_change_no_bit(
    monkeypatch: pytest.MonkeyPatch, known_heading: bool
) -> None:
    cells = refinement(known_heading)
    monkeypatch.setattr(compiled, "LEAST_WORK", 0)
    monkeypatch.setattr(compiled, "_threads", lambda: 1)
    alone = all_arrays(cells.answer(measured(cells)))
    monkeypatch.setattr(compiled, "_threads", lambda: 3)
    shared = all_arrays(cells.answer(measured(cells)))
    assert all(np.array_equal(one, other) for one, other in zip(alone, shared, strict=True))


def test_boxes_are_written_down_however_many_there_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where twice the cells are too few rows, too: the masses of all boxes come to the cells' evidence."""
    cells = refinement(known_heading=True)
    likelihood = measured(cells).rows(np.array([0]))
    found = cells.answer(likelihood)
    rows: list[int] = []
    room = quadrature._kept
    monkeypatch.setattr(quadrature, "_kept", lambda count, size: (rows.append(count), room(count, size))[1])
    before = [part.copy() for part in found.pool.sums]
    _, _, logs = cells.boxes(likelihood, found)
    assert len(rows) > 1, "this problem needs no more boxes than were made room for: take another"
    assert np.logaddexp.reduce(logs) == pytest.approx(found.log_integral[0], abs=2e-3)  # as rules err at most
    assert all(np.array_equal(one, other) for one, other in zip(before, found.pool.sums, strict=True))
