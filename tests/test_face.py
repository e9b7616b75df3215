"""`import rangefix` offers the names of daily use, and loads nothing before they are asked for."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

import rangefix
from rangefix import evaluation, filters, maps


@pytest.mark.parametrize("name", rangefix.__all__)
def test_a_name_is_that_of_its_room(name: str) -> None:
    """Each name is the object of that name in one of the rooms; `load` is that of results, not of maps."""
    value = getattr(rangefix, name)
    room = evaluation if name == "load" else next(r for r in (maps, filters, evaluation) if name in r.__all__)
    assert value is getattr(room, name)


def test_completion_shows_names_and_rooms() -> None:
    """What tab completion asks for holds every public name and the three rooms."""
    assert {*rangefix.__all__, "maps", "filters", "evaluation"} <= set(dir(rangefix))
    assert not [name for name in dir(rangefix) if name.startswith("_") and name != "__version__"]


def test_an_unknown_name_is_an_attribute_error() -> None:
    """As in any module."""
    with pytest.raises(AttributeError, match="no attribute 'Loud'"):
        rangefix.Loud  # noqa: B018


def test_nothing_is_loaded_before_it_is_asked_for() -> None:
    """`import rangefix` loads no array library; a map alone loads no study, no joblib and no matplotlib."""
    code = (
        "import sys, rangefix; assert 'numpy' not in sys.modules; rangefix.RectangularRoom; "
        "assert 'numpy' in sys.modules; heavy = 'pydantic', 'joblib', 'matplotlib'; "
        "print([name for name in heavy if name in sys.modules])"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert shown.stdout.strip() == "[]"


def test_the_first_lines_a_user_writes() -> None:
    """A room, a sensor, an estimator and a fix, from the one face."""
    room, space = rangefix.RectangularRoom(width=4.0, length=6.0), rangefix.position_space(heading=0.0)
    sensor = rangefix.Rangefinder(room, [0.0, 1.0], rangefix.Gaussian(std=0.05), space)
    prior, motion = rangefix.Uniform(room, space), rangefix.Stationary(space)
    estimator = rangefix.build("ekf", rangefix.Problem(space, motion, sensor, prior))
    belief = estimator.init(prior, [np.random.default_rng(0)])
    np.testing.assert_allclose(estimator.estimate(belief).mean, [[2.0, 3.0]], atol=1e-9)  # a room's middle
