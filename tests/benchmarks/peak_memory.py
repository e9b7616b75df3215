"""Run as a script: the memory that benchmark (b) takes, MB, as one JSON object.

`python peak_memory.py` gives the resident set just before the 1000 runs (all imported and compiled, ranges
cached), the peak during them, and the peak of the whole process, compilation included. With `--traced`, what
Python and numpy hold at the peak of the 1000 runs, as tracemalloc counts it; work space inside compiled code
is not in that. Linux only.
"""

import json
import sys
import tracemalloc
from pathlib import Path

import numpy as np

from rangefix.filters import Gaussian, Problem, Rangefinder, Stationary, Uniform, build, position_space
from rangefix.maps import RectangularRoom


def status(name):
    """A line of /proc/self/status, MB."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith(name))


def main(traced):
    room, space, rng = RectangularRoom(width=4.0, length=6.0), position_space(), np.random.default_rng(0)
    sensor = Rangefinder(room, np.deg2rad([326.3, 0.0, 33.7]), Gaussian(0.05), space)
    problem = Problem(space, Stationary(space), sensor, Uniform(room, space))
    estimator = build("point-mass", problem, cell=0.04)
    readings = sensor.sample(problem.prior.sample(1000, rng), rng)
    few = estimator.init(problem.prior, [rng] * 2)
    estimator.update(few, readings[:2], [rng] * 2)
    figures = {"before": status("VmRSS"), "whole": status("VmHWM")}
    if traced:
        tracemalloc.start()
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # forgets the peak so far
    belief = estimator.init(problem.prior, [rng] * 1000)
    mean, covariance, _ = estimator.estimate(estimator.update(belief, readings, [rng] * 1000))
    assert mean.shape == (1000, 2)
    assert covariance.dtype == np.float64
    if traced:
        return {"traced": tracemalloc.get_traced_memory()[1] / 2**20}
    figures["during"] = status("VmHWM")
    figures["whole"] = max(figures["whole"], figures["during"])
    return figures


if __name__ == "__main__":
    print(json.dumps(main("--traced" in sys.argv)))
