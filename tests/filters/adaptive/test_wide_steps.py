"""Steps of metres and readings of millimetres: the posterior is where hardly a draw of the prediction is."""

from __future__ import annotations

import numpy as np

from rangefix.evaluation import parse_study
from rangefix.evaluation.monte_carlo.simulate import simulate
from rangefix.filters import RangeMap
from rangefix.filters.adaptive import AdaptivePointMassFilter
from rangefix.filters.adaptive.prediction.gaussian_sums import ALL_ROUND, Around, reached
from rangefix.filters.models.confined import in_line_of_sight
from rangefix.maps import FloorPlan, RectangularRoom

FOUR_ROOMS = """
runs = 3
seed = 3

[map]
kind = "floor-plan"
outer_m = [[0, 0], [10, 0], [10, 8], [0, 8]]
holes_m = [[[7.2, 1.2], [7.8, 1.2], [7.8, 1.8], [7.2, 1.8]]]
walls_m = [[5, 0, 5, 1.4], [5, 2.6, 5, 8], [0, 4, 2, 4], [3.2, 4, 6.4, 4], [7.6, 4, 10, 4]]

[sensor]
bearings_deg = [0, 45, 90, 135, 180, 225, 270, 315]
std_m = 0.002

[state]
heading_deg = 0.0

[motion]
kind = "random-walk"
steps = 5
std_m = 2.0

[prior]
kind = "gaussian"
mean_m = [3.0, 2.0]
std_m = 0.3

[truth]
from = "prior"

[[estimators]]
name = "adaptive-point-mass"
"""


def test_a_mode_between_draws_is_found() -> None:
    """A mode of millimetres among draws 5 cm apart, where another explains the readings 4 nats less well.

    The latter alone was found, 4900 deviations off, with an error of 0.02 stated. The log evidence of
    `particle` scatters by a nat.
    """
    squares, log_evidence = followed(FOUR_ROOMS, 2)
    assert max(squares[1:]) < 23  # chi-square of 2: 1 in 10^5
    assert abs(log_evidence - 141.2) < 3


def followed(study: str, run: int) -> tuple[list[float], float]:
    """Squared normalised errors after each measurement of a run, and the log evidence of all."""
    made = parse_study(study).experiment()
    drive, problem = simulate(made, run, run + 1), made.assumed_problem
    estimator, rng = AdaptivePointMassFilter(problem), np.random.default_rng(0)
    belief, squares = estimator.init(problem.prior, rng), []
    for step, (reading, truth) in enumerate(zip(drive.measurement[0], drive.truth[0], strict=True)):
        if step:
            belief = estimator.predict(belief, made.control_sequence[step - 1], rng)
        belief = estimator.update(belief, reading, rng)
        mean, covariance, _ = estimator.estimate(belief)
        error = problem.space.difference(truth, mean)
        squares.append(float(error @ np.linalg.solve(covariance, error)))
    return squares, float(estimator.estimate(belief).log_evidence)


def judged(room: RangeMap, corner: tuple[float, float]) -> tuple[float, float]:
    """Shares of steps of 2 m that fans take for stopped, and for free, and rays do not."""
    rng = np.random.default_rng(0)
    starts = rng.uniform(0, corner, size=(4000, 2))
    starts = starts[room.is_free(starts)]
    ends = starts[:, None] + 2.0 * rng.standard_normal((len(starts), 50, 2))
    exact = in_line_of_sight(room, starts[:, None], ends)
    fans = room.ranges(np.column_stack([starts, np.zeros(len(starts))]), ALL_ROUND)
    found = reached(ends, room.is_free(ends), Around.of(starts, fans))
    return float((exact & ~found).sum() / exact.sum()), float((found & ~exact).mean())


def test_what_can_be_seen_is_hardly_ever_taken_to_be_behind_a_wall() -> None:
    """Just past an edge, or in a corner: what is stopped falsely has no density at all, at the truth maybe.

    0.6 % of steps were, in four rooms, 0.07 % in one: truths a million nats below what was claimed. What is
    taken for free falsely, beside an edge by less than a sector of 3 degrees, has some density too much.
    """
    made = parse_study(FOUR_ROOMS).experiment()
    plan = made.assumed_problem.sensor.room
    stopped, free = judged(plan, (10.0, 8.0))
    assert stopped < 0.0005
    assert free < 0.01
    assert judged(RectangularRoom(4.0, 6.0), (4.0, 6.0)) == (0.0, 0.0)
    ell = FloorPlan(outer=[[0, 0], [6, 0], [6, 3], [3, 3], [3, 6], [0, 6]])
    stopped, free = judged(ell, (6.0, 6.0))
    assert stopped < 0.0001
    assert free < 0.004


UNEQUAL_BEAMS = """
runs = 30
seed = 1

[map]
kind = "floor-plan"
outer_m = [[0, 0], [6, 0], [6, 3], [3, 3], [3, 6], [0, 6]]

[sensor]
bearings_deg = [0, 45, 90, 135, 180, 225, 270, 315]
std_m = [0.014, 0.32, 0.15, 0.0005, 0.012, 0.18, 0.0003, 0.007]

[state]
heading = "unknown"

[motion]
kind = "random-walk"
steps = 1
std_m = 0.5
heading_std_deg = 40.0

[prior]
kind = "gaussian"
mean_m = [2.0, 2.0]
std_m = 0.05
heading_std_deg = 5.0

[truth]
from = "prior"

[[estimators]]
name = "adaptive-point-mass"
"""


def test_a_mode_that_fits_beams_of_very_unequal_noise_is_found() -> None:
    """Most beams may be left out of a step, those of least noise among them: 4 of 30 runs ended elsewhere.

    This one 13600 deviations off, with an error of 0.01 stated.
    """
    squares, _ = followed(UNEQUAL_BEAMS, 25)
    assert squares[1] < 26  # chi-square of 3: 1 in 10^5
