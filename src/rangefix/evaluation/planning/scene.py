"""The floor plan that plans and maps of accuracy are drawn on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...arrays import Array
from ...filters import Problem


@dataclass(frozen=True)
class FloorPlan:
    """Walls, and a place in free space.

    Attributes:
        segments: Walls as x1a, x2a, x1b, x2b, m, (S, 4).
        bounds: Lower and upper corner, m, (2,) each.
        place: Where the compass is drawn, m, (2,): the free place nearest to the prior's mean.
        heading: What bearings count from, rad: where the laser looks at the known heading, or at
            the prior's mean.
    """

    segments: Array
    bounds: tuple[Array, Array]
    place: Array
    heading: float

    @staticmethod
    def of(problem: Problem, free: Array) -> FloorPlan:
        """The floor plan of a problem.

        Args:
            problem: The problem.
            free: Places in free space, m, (K, 2).
        """
        room, pose = problem.sensor.room, problem.space.poses(np.asarray(problem.prior.mean))
        nearest = free[np.argmin(np.hypot(*(free - pose[:2]).T))]
        lower, upper = room.bounds
        ahead = float(problem.sensor.mount.laser_poses(pose)[2])
        return FloorPlan(np.asarray(room.segments), (lower, upper), nearest, ahead)
