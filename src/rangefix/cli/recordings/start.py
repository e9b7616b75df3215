"""Where a replay begins, as the command line says it."""

from __future__ import annotations

import numpy as np

from ...arrays import TEN_TURNS_DEG, Array
from ...evaluation.recordings.setting import Start
from ...filters import RangeMap, pose_space
from ...filters.models.noise import LARGEST_SPREAD, LEAST_SPREAD
from ..directions import refuse_turns

STD_M, STD_DEG = 0.2, 6.0  # of a start, unless given
LEAST_STD_DEG = 1e-6


def read_start(text: str, std_m: float | None, std_deg: float | None) -> Start:
    """The start as it is written, with how sure it is: deviations in m and deg; None = as is usual.

    Raises:
        ValueError: If it is no start, a deviation is not positive or of no use, or has no effect.
    """
    for name, value, unit in (("--start-std-m", std_m, "m"), ("--start-std-deg", std_deg, "deg")):
        if value is None:
            continue
        if text == "global":
            raise ValueError(f"{name} has no effect on a start anywhere on the map (--start global)")
        if not 0 < value < np.inf:
            raise ValueError(f"{name} must be positive, got {value:g} {unit}")
        low, high = (LEAST_SPREAD, LARGEST_SPREAD) if unit == "m" else (LEAST_STD_DEG, TEN_TURNS_DEG)
        if not low <= value <= high:
            raise ValueError(f"{name} must be from {low:g} to {high:g} {unit}, got {value:g}")
    stds = STD_M if std_m is None else std_m, float(np.deg2rad(STD_DEG if std_deg is None else std_deg))
    if text in ("truth", "odometry"):
        return Start(None, *stds)
    return Start(None) if text == "global" else Start(read_pose(text, "truth, odometry or global"), *stds)


def read_pose(text: str, others: str = "") -> Array:
    """A pose as it is written: x1,x2,heading in m, m and deg clockwise from +x2; in rad, (3,).

    Args:
        text: What is written.
        others: What else a start may be, for messages.

    Raises:
        ValueError: If it is none.
    """
    try:
        x1, x2, heading = (float(part) for part in text.replace(",", " ").split())
    except ValueError:
        expected = "x1,x2,heading (m, m, deg)" + (f", {others}" if others else "")
        raise ValueError(f"a start is {expected}, got {text!r}") from None
    pose: Array = np.array([x1, x2, np.deg2rad(heading)])
    if not np.isfinite(pose).all():
        raise ValueError(f"a start must be finite, got {text!r}")
    refuse_turns("--start", heading)
    return pose


def refuse_outside(start: Start, room: RangeMap, text: str, map_name: str) -> None:
    """Refuse a start that leaves no free space.

    Args:
        start: The start.
        room: The map.
        text: How it was given.
        map_name: What the map is called.

    Raises:
        ValueError: If the robot cannot be there.
    """
    if start.pose is None:
        return
    try:
        start.prior(room, pose_space())
    except ValueError:
        place = f"odometry, which is {start.pose[0]:.2f},{start.pose[1]:.2f}," if text == "odometry" else ""
        place = place or ",".join(text.replace(",", " ").split()[:2])
        raise ValueError(f"--start {place} is not in the free space of {map_name}") from None
