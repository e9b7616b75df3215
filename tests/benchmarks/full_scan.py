"""The fix of benchmark (d): 9600 places, 1000 headings and 667 beams in the paper's room.

As a script it prints, as one JSON object, what memory the fix takes, MB: the resident set before the filter
is built, its peak while it is built, and its peak from `init` on. Linux only.
"""

import json
from pathlib import Path

import numpy as np

from rangefix.filters import Gaussian, Problem, Rangefinder, Stationary, Uniform, build, pose_space, sweep
from rangefix.maps import RectangularRoom

CELL, STEP, STD = 0.05, np.deg2rad(0.36), 0.05


def make_problem():
    """The room of 4 x 6 m, any heading, beams 0.36 deg apart but for 120 deg astern."""
    room, space = RectangularRoom(width=4.0, length=6.0), pose_space()
    sensor = Rangefinder(room, sweep(STEP, np.deg2rad(120.0)), Gaussian(STD), space)
    return Problem(space, Stationary(space), sensor, Uniform(room, space))


def make_filter(problem):
    return build("point-mass", problem, cell=CELL, heading_cell=STEP)


def one_reading(problem):
    """A scan from a place drawn from the prior, a beam in 20 missing."""
    rng = np.random.default_rng(0)
    reading = problem.sensor.sample(problem.prior.sample(1, rng), rng)
    reading[:, ::20] = np.nan
    return reading


def main():
    from peak_memory import status

    def peak():
        figure = status("VmHWM")
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # forgets the peak so far
        return figure

    problem, rngs = make_problem(), [np.random.default_rng(0)]
    small = build("point-mass", problem, cell=1.0, heading_cell=STEP)  # compiles
    small.update(small.init(problem.prior, rngs), one_reading(problem), rngs)
    peak()
    figures = {"before": status("VmRSS")}
    estimator = make_filter(problem)
    figures["building"] = peak()
    belief = estimator.init(problem.prior, rngs)
    estimator.estimate(estimator.update(belief, one_reading(problem), rngs))
    figures["fix"] = peak()
    return figures


if __name__ == "__main__":
    print(json.dumps(main()))
