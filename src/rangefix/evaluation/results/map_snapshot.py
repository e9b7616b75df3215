"""What a picture of a problem needs, as plain arrays: walls, free space, the prior's box, beams."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from ...arrays import Array
from ...filters import Prior, Sensor
from ...raster import Raster

Scene = Mapping[str, Array]
PIXELS = 600  # along the longer side of the map


def scene(sensor: Sensor, prior: Prior, truth: ArrayLike) -> dict[str, Array]:
    """The scene of a problem as float64 arrays, ready to be saved.

    Args:
        sensor: The rangefinder in its map.
        prior: The prior.
        truth: The true state from which beams are drawn, (n,).

    Returns:
        segments: Walls at sensor height as x1a, x2a, x1b, x2b, (S, 4) m; no rows for a map that has none.
        free: 1 in free space, 0 elsewhere, at pixel centres, (R, C), x2 upwards along R.
        extent: Edges of those pixels, x1 left, x1 right, x2 lower, x2 upper, m.
        prior_lower, prior_upper: Corners of the prior's box, (2,) m.
        truth: x1, x2 (m) and heading (rad) of the true pose, (3,).
        bearings: Beam directions relative to the heading, rad, (B,).
        ranges: Noise-free ranges there, (B,) m; inf = no return: no wall, none in reach or a grazed one,
            or a beam that is never measured.
        laser: x1, x2 (m) of the laser there, (2,), and its own forward axis as a heading (rad): (3,).
    """
    room, space = sensor.room, sensor.space
    lower, upper = (np.asarray(corner, dtype=float) for corner in room.bounds)
    step = float((upper - lower).max()) / PIXELS
    counts = np.maximum(1, np.ceil((upper - lower) / step * (1 - 1e-9))).astype(int)
    raster = Raster(lower, step, tuple(counts.tolist()))
    truth = np.asarray(truth, dtype=float)
    pose = space.poses(truth)
    laser = sensor.mount.laser_poses(pose)
    expected = sensor.expected(truth)
    returns = (expected <= sensor.max_range) & ~sensor.blind
    corners = [corner[space.position_indices] for corner in prior.support]
    return {
        "segments": np.asarray(room.segments, dtype=float),
        "free": room.is_free(raster.centres).T.astype(float, order="C"),
        "extent": np.column_stack([lower, raster.upper]).ravel(),
        "prior_lower": corners[0],
        "prior_upper": corners[1],
        "truth": pose,
        "bearings": np.asarray(sensor.bearings, dtype=float),
        "ranges": np.where(returns, expected, np.inf),
        "laser": laser,
    }
