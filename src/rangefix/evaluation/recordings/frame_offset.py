"""By how much a map lies off the frame of the true poses: what every estimate on that map errs by."""

from __future__ import annotations

import numpy as np

from ...arrays import Array
from ...filters import Noise
from .residuals import Residuals

STEPS = (0.05, 0.05, 0.02)  # m, m, rad; of the first guesses
PRECISION = 1e-4  # m and rad


def frame_offset(residuals: Residuals, law: Noise) -> Array:
    """The move of all poses, x1, x2 (m) and heading (rad), at which the readings fit the map best, (3,).

    By maximum likelihood, readings taken to be independent. A place of the laser on the robot that is other
    than was told looks alike as far as the robot keeps its heading.

    Args:
        residuals: Readings at poses that do not come from them.
        law: Of each reading by itself.
    """
    from scipy.optimize import minimize

    sensor, readings = residuals.sensor, residuals.readings
    measured = np.isfinite(readings)
    read = np.where(measured, readings, 0.0)

    def cost(offset: Array) -> float:
        expected = sensor.expected(residuals.poses + offset)
        return -float(np.where(measured, law.log_density(read, expected), 0.0).sum() / measured.sum())

    simplex = np.vstack([np.zeros(3), np.diag(STEPS)])
    found = minimize(
        cost,
        np.zeros(3),
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "xatol": PRECISION, "fatol": 1e-7, "maxiter": 300},
    )
    return np.asarray(found.x)
