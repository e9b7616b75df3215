"""Types of arrays, and angles: what every room uses."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
TWO_PI = 2.0 * math.pi
LOG_TWO_PI = math.log(TWO_PI)


def wrap(angle: Array) -> Array:
    """The same angle in [-pi, pi), rad."""
    return (angle + np.pi) % TWO_PI - np.pi
