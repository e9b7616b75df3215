"""The options of the particle filter: what they may be, and which would do nothing."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...arrays import keep_whole
from ..models.motion import Stationary
from .resampling import SCHEMES

DEFAULT_RESAMPLING, DEFAULT_MOVES = "systematic", 3
MOST_RANGES_IN_STAGES = 1e7  # particles times beams


def check_options(options: Any) -> None:  # a ParticleFilter, whose module needs this one
    """Refuse options that are out of range, that do nothing beside others, or that would take minutes.

    Whole numbers that were given as others are kept as such.

    Raises:
        ValueError: If there is one.
    """
    keep_whole(options, "particles", 2)
    if not 0 <= options.resample_below <= 1:
        raise ValueError(f"resample_below must be in [0, 1], got {options.resample_below}")
    if options.resampling not in SCHEMES:
        raise ValueError(f"no resampling {options.resampling!r}; there are {', '.join(SCHEMES)}")
    if options.bandwidth is not None and not 0 < options.bandwidth < np.inf:
        raise ValueError(f"bandwidth must be positive and finite, got {options.bandwidth}")
    keep_whole(options, "moves", 1)
    if options.temper not in (None, False, True) or options.regularise not in (False, True):
        raise ValueError(
            f"regularise and temper must be true or false, got {options.regularise!r}, {options.temper!r}"
        )
    if options.least_particles is not None:
        keep_whole(options, "least_particles", 2)
        if options.least_particles > options.particles:
            raise ValueError(
                f"least_particles must be from 2 to particles = {options.particles}, "
                f"got {options.least_particles}"
            )
    _check_effect(options)
    _check_size(options)


def _check_effect(options: Any) -> None:
    """Refuse options that would do nothing beside the others.

    Raises:
        ValueError: If there is one.
    """
    given = {
        "bandwidth": options.bandwidth is not None,
        "moves": options.moves != DEFAULT_MOVES,
        "temper": bool(options.temper),
        "resampling": options.resampling != DEFAULT_RESAMPLING,
    }
    idle: dict[str, tuple[str, ...]] = {
        "resample_below = 0, which never resamples": tuple(given) if not options.resample_below else (),
        "regularise = false": ("bandwidth", "moves", "temper") if not options.regularise else (),
        "a bandwidth, whose kernel takes the place of Metropolis steps": ("moves", "temper")
        if options.bandwidth is not None
        else (),
    }
    if options.least_particles is not None and isinstance(options.problem.motion, Stationary):
        raise ValueError("least_particles does nothing for an object that does not move: leave it out")
    for beside, names in idle.items():
        for name in names:
            if given[name]:
                raise ValueError(f"{name} does nothing beside {beside}: leave one of the two out")


def _check_size(options: Any) -> None:
    """Refuse stages over so many ranges that one measurement would take minutes.

    Raises:
        ValueError: If there are more.
    """
    beams = len(options.problem.sensor.bearings)
    ranges = options.particles * beams
    moved = options.regularise and options.bandwidth is None and options.resample_below > 0
    if moved and options.temper is not False and ranges > MOST_RANGES_IN_STAGES:
        raise ValueError(
            f"{options.particles} particles with {beams} beams are {ranges:.2g} "
            f"ranges in each of many stages, more than {MOST_RANGES_IN_STAGES:.0e}: take fewer beams or "
            "particles, or temper = false"
        )
