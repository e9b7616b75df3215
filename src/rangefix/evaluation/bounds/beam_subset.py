"""The same problem with some of its beams only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import is_dataclass, replace

import numpy as np

from ...filters.models.noise_of_beams import noise_of_beams
from ...filters.models.rangefinder import Rangefinder
from ...filters.problem import Problem
from .bound import NoBoundError


def with_beams(problem: Problem, beams: Sequence[int]) -> Problem:
    """The problem of somebody who has some of the beams only.

    Studies leave the other beams unread (NaN); the two say the same.

    Args:
        problem: A problem.
        beams: Numbers of the beams, from 1 as in studies, without repeats.

    Raises:
        NoBoundError: If all of these beams lie in the blind sector, or the sensor or its noise is of a kind
            of which no beam can be left out here.
    """
    sensor = problem.sensor
    total = len(sensor.bearings)
    if list(beams) == list(range(1, total + 1)):
        return problem
    if not isinstance(sensor, Rangefinder):
        raise NoBoundError(f"some beams alone are computed for a Rangefinder only, not {sensor!r}")
    kept = np.asarray(beams, dtype=np.int64) - 1
    if sensor.blind[kept].all():
        raise NoBoundError("all of these beams lie in the blind sector: nothing is measured")
    if not is_dataclass(sensor.noise):
        raise NoBoundError(
            f"some beams alone are computed for noise models that are dataclasses, not {sensor.noise!r}"
        )
    noise = noise_of_beams(sensor.noise, kept, total)
    return replace(problem, sensor=replace(sensor, bearings=sensor.bearings[kept], noise=noise))
