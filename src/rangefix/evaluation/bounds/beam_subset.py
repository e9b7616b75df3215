"""The same problem with some of its beams only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np

from ...filters.models.rangefinder import Rangefinder
from ...filters.problem import Noise, Problem
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
    noise = noise_of_beams(sensor.noise, kept.tolist(), total)
    return replace(problem, sensor=replace(sensor, bearings=sensor.bearings[kept], noise=noise))


def noise_of_beams(noise: Noise, kept: Sequence[int], total: int) -> Noise:
    """The noise of some beams, counted from 0: of parameters with one number for each beam, theirs.

    Raises:
        NoBoundError: If the noise is no dataclass, so that its parameters are not known.
    """
    if not is_dataclass(noise):
        raise NoBoundError(
            f"some beams alone are computed for noise models that are dataclasses, not {noise!r}"
        )
    changed: dict[str, Any] = {}
    for parameter in fields(noise):
        if not parameter.init:
            continue
        value = vars(noise)[parameter.name]
        if is_dataclass(value):
            changed[parameter.name] = noise_of_beams(value, kept, total)
        elif np.shape(value) == (total,):
            changed[parameter.name] = np.asarray(value)[list(kept)]
    return replace(noise, **changed)
