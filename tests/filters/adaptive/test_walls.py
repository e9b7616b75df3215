"""The adaptive point-mass filter on objects driven against walls, against many particles by the exact law.

`RANGEFIX_RANDOM=400` in the environment asks for so many problems of each family in the study.
"""

from __future__ import annotations

import os

import numpy as np
import pytest

from rangefix.evaluation import parse_study, repeat_run
from rangefix.filters import Gaussian, Problem, Rangefinder, Stationary, Uniform, build, pose_space
from rangefix.maps import RectangularRoom

from ..families import MOVING, draw
from .particle_reference import judged, reference

COUNT = int(os.environ.get("RANGEFIX_RANDOM", "40"))
FLAGGED = 0.05  # deviations: an error stated above it is told by tables and verdicts
LOST = 0.5  # deviations of error that only a lost mode makes
EXCEEDED_FACTOR = 3.0


def test_a_ridge_that_guesses_miss_is_found_by_draws() -> None:
    """A posterior of 9 cm by 4 mm beside a pillar, after two steps: 5 % of its deviations.

    Guesses led to another mode alone, 159 deviations off, with an error of 0.017 stated. The reference
    scatters by 0.05 with 100 000 particles.
    """
    drawn = draw("walk", 31)
    found = judged(drawn, reference(drawn, 25_000, 4)[:3])[2]
    assert found.scatter < 0.15
    assert found.error < 0.05 + 3 * found.scatter
    assert found.stated < FLAGGED


DRIVE = """
runs = 10

[map]
kind = "rectangle"
width_m = 4.0
length_m = 6.0

[sensor]
bearings_deg = [0, 60, 120, 180, 240, 300]
std_m = 0.05

[state]
heading = "unknown"

[prior]
kind = "gaussian"
std_m = 0.3
heading_std_deg = 10

[motion]
kind = "odometry"
steps = 10

[[estimators]]
name = "adaptive-point-mass"
"""


def test_what_would_stay_within_walls_is_left_out() -> None:
    """A robot 5 mm from a wall turns to drive off, by odometry that is exact.

    All that might have stayed where it is lay in the wall: the belief had a part without weight, whose
    covariance was singular, and the run was an error.
    """
    run = repeat_run(parse_study(DRIVE), 9).results
    trials = run.trials[0]
    assert trials.ok.all()
    error = run.space.difference(run.truth, trials.mean)[0]
    assert (np.abs(error) < 4 * np.sqrt(np.diagonal(trials.covariance[0], axis1=1, axis2=2))).all()


@pytest.mark.study
def test_what_stays_beside_a_wall_says_that_it_is_blurred() -> None:
    """A robot driven against a wall, which 99 % of the posterior never left: off by 0.14, and told."""
    found = judged(draw("walls", 12), reference(draw("walls", 12), 25_000, 4))[3]
    assert found.error < 0.2
    assert found.stated > 0.1


def test_more_beams_than_a_fix_may_look_at_are_refused() -> None:
    """10 000 beams at an unknown heading: no fix would come to an end, which building it says at once."""
    room, space = RectangularRoom(width=4.0, length=6.0), pose_space()
    sensor = Rangefinder(room, np.linspace(-np.pi, np.pi, 10_000), Gaussian(0.05), space)
    problem = Problem(space, Stationary(space), sensor, Uniform(room, space))
    with pytest.raises(ValueError, match="take at most 1621 beams"):
        build("adaptive-point-mass", problem)
    with pytest.raises(ValueError, match=r"of two shifted grids .* need 24\.6 GB, more than 0\.6 GB"):
        build("point-mass", problem, cell=0.1, heading_cell=np.deg2rad(3.0))


@pytest.mark.study
@pytest.mark.parametrize("family", MOVING)
def test_no_mode_is_lost_and_stated_errors_hold(family: str) -> None:
    """Four measurements in each of 40 problems: no lost mode, and no stated error exceeded by 3 times.

    Allowance: 4 standard errors of the reference. A mode that few particles reach makes those too small:
    where an error seems exceeded, 8 times as many are asked (walls 37: 0.17 off by 800 000, 0.05 by 6.4e6).
    """
    steps = []
    for number in range(COUNT):
        found = judged(draw(family, number), reference(draw(family, number)))
        if any(step.error - 4 * step.scatter > step.stated for step in found):
            found = judged(draw(family, number), reference(draw(family, number), 400_000, 16))
        steps += found
    error, scatter, stated, seconds = np.array(steps).T
    beyond = np.maximum(error - 4 * scatter, 0.0)
    print(f"\n{family}: {len(steps)} measurements, error {np.median(error):.2g} to {error.max():.2g}, stated "
          f"{np.median(stated):.2g}, flagged {(stated > FLAGGED).mean():.1%}, exceeded for certain in "
          f"{(beyond > stated).sum()}, {np.median(seconds):.2g} to {seconds.max():.2g} s")  # fmt: skip
    assert not (beyond > LOST).any()
    assert (beyond <= EXCEEDED_FACTOR * stated).all()
