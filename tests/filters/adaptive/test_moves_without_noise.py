"""Beliefs of many cells before a move with hardly any noise: they are moved, and said to be blurred."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from rangefix.filters import pose_space
from rangefix.filters.adaptive.lattice import Lattice, _keys
from rangefix.filters.adaptive.mode_gaussians import COARSEST_TOGETHER, smoothed
from rangefix.filters.adaptive.moves import MAX_POINTS_MOVED, predict_modes
from rangefix.filters.adaptive.target import TooManyCells
from rangefix.filters.models.odometry import Odometry

STEP = np.diag([0.002, 0.003, 0.001])  # m, m, rad


def gaussian(deviation: float) -> Lattice:
    """A Gaussian of so many steps of a lattice along each axis, to 4.8 deviations."""
    reach = int(4.8 * deviation)
    index = np.array(list(product(range(-reach, reach + 1), repeat=3)))
    index = index[(index**2).sum(axis=1) <= (4.8 * deviation) ** 2]
    logs = -0.5 * (index**2).sum(axis=1) / deviation**2
    return Lattice(pose_space(), np.array([2.0, 3.0, 0.4]), STEP, index, _keys(index), logs)


def test_many_cells_are_moved_without_noise() -> None:
    """Half as many again as may be: moments are those of the motion, and a check is coarser still."""
    mode, motion, control = gaussian(4.6), Odometry(pose_space()), np.array([0.1, 0.3, -0.2])
    assert len(smoothed(mode, np.zeros((3, 3)), together=0.0).states) > 1.5 * MAX_POINTS_MOVED
    found = predict_modes((mode,), None, motion, control)
    assert found.together > COARSEST_TOGETHER
    assert len(found.parts[0].likely) < MAX_POINTS_MOVED
    jacobian = motion.jacobian(mode.mean, control)
    np.testing.assert_allclose(found.parts[0].mean, motion.mean(mode.mean, control), atol=1e-4)
    np.testing.assert_allclose(
        found.parts[0].covariance, jacobian @ mode.covariance @ jacobian.T, rtol=0.02, atol=1e-7
    )
    check = predict_modes((mode,), None, motion, control, found)
    assert check.together > found.together
    assert len(check.parts[0].likely) < len(found.parts[0].likely)


def test_few_cells_are_taken_together_as_before() -> None:
    """What blurs is for beliefs that are too many without it."""
    motion, control = Odometry(pose_space()), np.array([0.1, 0.3, -0.2])
    assert predict_modes((gaussian(2.0),), None, motion, control).together < COARSEST_TOGETHER


def test_more_cells_still_are_refused_with_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    """Noise is one of the ways out."""
    monkeypatch.setattr("rangefix.filters.adaptive.moves.MAX_POINTS_MOVED", 100)
    with pytest.raises(TooManyCells, match="give a motion noise that has next to none"):
        predict_modes((gaussian(4.6),), None, Odometry(pose_space()), np.array([0.1, 0.3, -0.2]))
