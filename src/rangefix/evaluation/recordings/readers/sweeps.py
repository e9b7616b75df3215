"""Ranges brought to other beams: of scans taken in motion, or whose beams are not those of the first scan."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from ....arrays import TWO_PI, Array, wrap
from ..log import LaserDescription, Scan
from .track import Track


def onto_beams(bearings: Array, ranges: Array, wanted: Array) -> Array:
    """Ranges of the nearest of some beams, within half the usual distance of the wanted ones; else NaN.

    Args:
        bearings: Of the beams that were measured, rad, (K,).
        ranges: What they read, (K,).
        wanted: Bearings for which ranges are wanted, rad, (B,).
    """
    angles = np.mod(bearings, TWO_PI)
    order = np.argsort(angles, kind="stable")
    angles, values = angles[order], ranges[order]
    spacing = float(np.median(np.abs(np.diff(wanted)))) if len(wanted) > 1 else TWO_PI
    asked = np.mod(wanted, TWO_PI)
    after = np.searchsorted(angles, asked) % len(angles)
    before = after - 1
    ahead = np.abs(wrap(angles[after] - asked))
    behind = np.abs(wrap(angles[before] - asked))
    nearest = np.where(ahead < behind, after, before)
    return np.where(np.minimum(ahead, behind) <= 0.5 * spacing * (1 + 1e-6), values[nearest], np.nan)


def with_ends(read: Callable[[], Iterator[Scan]], laser: LaserDescription) -> Iterator[Scan]:
    """Scans that take time, with the odometry at their last beam, by that of the scans about that time.

    Args:
        read: Reads the scans from the first, each with the odometry at its first beam.
        laser: The laser.
    """
    duration = laser.seconds_per_beam * (len(laser.bearings_rad) - 1)
    if not duration:
        yield from read()
        return
    track = Track((scan.time_s, scan.odometry) for scan in read() if scan.odometry is not None)
    for scan in read():
        yield (
            scan if scan.odometry is None else replace(scan, odometry_at_end=track.at(scan.time_s, duration))
        )


def without_motion(scan: Scan, laser: LaserDescription) -> Array:
    """The ranges as if all had been taken when the first was, by the odometry during the scan, (B,).

    The robot is taken to move evenly from the first beam to the last. What each beam met is brought to the
    pose of the first, where it is seen in another direction and at another distance; each beam then takes
    what is seen within half a beam of it, or reads NaN.
    """
    if scan.odometry is None or scan.odometry_at_end is None:
        return scan.ranges_m
    bearings, ranges = laser.bearings_rad, scan.ranges_m
    share = np.linspace(0.0, 1.0, len(bearings))
    step = scan.odometry_at_end - scan.odometry
    step[2] = wrap(step[2])
    robot = scan.odometry + share[:, None] * step
    places = robot[:, :2] + _offset(laser, robot[:, 2])
    axes = robot[:, 2] - laser.yaw_rad
    near = np.where(np.isfinite(ranges), ranges, 0.0)
    directions = np.stack([np.sin(axes + bearings), np.cos(axes + bearings)], axis=1)
    away = places + near[:, None] * directions - places[0]
    seen = np.where(np.isfinite(ranges), np.arctan2(away[:, 0], away[:, 1]), axes + bearings) - axes[0]
    distances = np.where(np.isfinite(ranges), np.hypot(away[:, 0], away[:, 1]), ranges)
    return onto_beams(seen, distances, bearings)


def _offset(laser: LaserDescription, heading: Array) -> Array:
    from ....filters import Mount

    return Mount(laser.forward_m, laser.left_m, laser.yaw_rad).offset(heading)
