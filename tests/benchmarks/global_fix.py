"""Benchmark (f): where in a real building, and facing where, from one scan of 360 beams.

As a script it prints, as one JSON object, what memory that takes, MB: the peak of the whole process.
"""

import json
import os
import time
from pathlib import Path

import numpy as np

from rangefix.filters import Gaussian, Problem, Rangefinder, Stationary, Uniform, pose_space
from rangefix.filters.adaptive import AdaptivePointMassFilter
from rangefix.maps import MeshRoom

DATA = Path(os.environ.get("RANGEFIX_DATA", Path(__file__).parents[3] / "shared" / "data"))
BUILDING = DATA / "avz" / "avz.ply"
NEAR = np.array([0.3, 0.3, np.deg2rad(5.0)])  # of the truth: in its mode


def make_problem():
    """An office floor of 28 x 48 m, any free place and heading, 360 beams of 5 cm."""
    room, space = MeshRoom.load(BUILDING, sensor_height=0.9), pose_space()
    sensor = Rangefinder(room, np.deg2rad(np.arange(360.0)), Gaussian(0.05), space)
    return Problem(space, Stationary(space), sensor, Uniform(room, space))


def fixes(problem, estimator, count, seed=5):
    """For each of so many poses: seconds, probability near the truth, and NEES / n."""
    rng, found = np.random.default_rng(seed), []
    empty = estimator.init(problem.prior, rng)
    estimator.update(empty, problem.sensor.sample(problem.prior.sample(1, rng)[0], rng), rng)  # compiles
    for _ in range(count):
        truth = problem.prior.sample(1, rng)[0]
        reading = problem.sensor.sample(truth, rng)
        start = time.perf_counter()
        belief = estimator.update(empty, reading, rng)
        mean, covariance, _ = estimator.estimate(belief)
        seconds = time.perf_counter() - start
        near = (np.abs(problem.space.difference(belief.posterior.states, truth)) < NEAR).all(axis=1)
        error = problem.space.difference(truth, mean)
        nees = error @ np.linalg.solve(covariance, error) / 3
        found.append((seconds, np.exp(belief.posterior.log_mass[near]).sum(), nees))
    return np.array(found)


def main():
    from peak_memory import status

    problem = make_problem()
    fixes(problem, AdaptivePointMassFilter(problem), 5)
    return {"peak": status("VmHWM")}


if __name__ == "__main__":
    print(json.dumps(main()))
