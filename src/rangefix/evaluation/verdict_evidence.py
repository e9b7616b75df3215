"""How strongly runs speak against an honest estimator: the p-values behind a verdict.

They invert the intervals of `intervals.py` (Student's t corrected for skewness; Hall, 1992), so a figure has
p < 0.05 exactly where its 95 % interval leaves out the honest value. An exact Bayesian filter has expected
ANEES / n = 1, expected squared errors equal to its mean covariance, and no bias, whatever the shape of its
posterior, if truths are drawn from its prior.
"""

from __future__ import annotations

from ..filters.space import Array
from .intervals import Moments


def p_value(value: float, deviations: Array, honest: float) -> float:
    """Two-sided p-value of "the true figure is `honest`", for a value that varies as a mean of deviations.

    Args:
        value: The figure.
        deviations: What each run adds to it, about zero, (M,).
        honest: What an honest estimator has.

    Returns:
        NaN with fewer than two runs; where all runs agree, 1 if they agree with `honest`, else 0.
    """
    moments = Moments()
    moments.add(deviations)
    return moments.p_value(value, honest)
