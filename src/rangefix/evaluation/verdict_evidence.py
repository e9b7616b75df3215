"""How strongly runs speak against an honest estimator: the p-values behind a verdict.

They invert the intervals of `intervals.py` (Student's t corrected for skewness; Hall, 1992), so a figure has
p < 0.05 exactly where its 95 % interval leaves out the honest value. An exact Bayesian filter has expected
ANEES / n = 1, expected squared errors equal to its mean covariance, and no bias, whatever the shape of its
posterior, if truths are drawn from its prior.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import stdtr

from ..filters.space import Array
from .intervals import HUGE


def p_value(value: float, deviations: Array, honest: float) -> float:
    """Two-sided p-value of "the true figure is `honest`", for a value that varies as a mean of deviations.

    Args:
        value: The figure.
        deviations: What each run adds to it, about zero, (M,).
        honest: What an honest estimator has.

    Returns:
        NaN with fewer than two runs; where all runs agree, 1 if they agree with `honest`, else 0.
    """
    count = deviations.size
    if count < 2 or not math.isfinite(value):
        return math.nan
    spread = float(np.sqrt((deviations**2).sum() / (count - 1)))
    if spread == 0.0:
        return float(value == honest)
    c = float(np.mean((deviations / spread) ** 3)) / np.sqrt(count)
    t = (value - honest) / (spread / np.sqrt(count))
    a = c / 3
    corrected = t + a * t**2 + a**2 * t**3 / 3 + c / 6
    return float(2 * stdtr(count - 1, -abs(corrected)))


def doubts(errors: Array, covariance: Array, normalised: Array, names: tuple[str, ...]) -> dict[str, float]:
    """The p-value of each figure that an honest estimator fixes: anees, ratio_NAME and bias_NAME.

    Args:
        errors: x - x^, (M, n).
        covariance: Claims, (M, n, n).
        normalised: NEES / n of each run, (M,).
        names: Of the components.

    Returns:
        Figure -> p-value; 0 where NEES is infinite, NaN where the runs do not suffice to say.
    """
    found = {"anees": _of_mean(normalised, 1.0)}
    for i, name in enumerate(names):
        squares, claims = errors[:, i] ** 2, covariance[:, i, i]
        mean = float(claims.mean()) if claims.size else 0.0
        if 0 < mean < HUGE:
            ratio = float(squares.mean()) / mean
            found[f"ratio_{name}"] = p_value(ratio, (squares - ratio * claims) / mean, 1.0)
        found[f"bias_{name}"] = _of_mean(errors[:, i], 0.0)
    return found


def _of_mean(samples: Array, honest: float) -> float:
    if np.isnan(samples).any() or not samples.size:
        return math.nan
    if (np.abs(samples) >= HUGE).any():
        return 0.0
    mean = float(samples.mean())
    return p_value(mean, samples - mean, honest)
