"""How wide the noise of a beam is: what a table of readings needs to know of any noise."""

from __future__ import annotations

import numpy as np

from ...arrays import Array
from ...filters.models.wrapped_noise import reading_bias
from ...filters.problem import Noise

PROBES = 33  # expected ranges at which the width is looked for
LADDER = np.geomspace(1e-7, 1e4, 1000)  # m; offsets at which it is looked for
SMALL = 0.1  # share of the expected ranges at which the noise may be finer
HALF_HEIGHT = np.sqrt(2 * np.log(2))  # standard deviations from a Gaussian's peak to half its height


def noise_width(noise: Noise, low: float, high: float) -> float:
    """The standard deviation that a Gaussian of the same width at half its height would have, m.

    Where it differs from range to range it is the one that a tenth of the ranges fall short of: just before a
    wall, short readings of a beam mixture have no room and no width. A bias widens nothing: the peak is
    looked for about the reading of a wall, which is its range and the bias.

    Args:
        noise: Of one beam.
        low, high: Expected ranges between which it is looked for, m; those that cannot be read, beyond the
            reach of a beam mixture, are left out.

    Raises:
        ValueError: If there is none.
    """
    expected, bias = np.linspace(low, high, PROBES)[:, None], reading_bias(noise)
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        peak = np.asarray(noise.log_density(expected + bias, expected))
        readable = expected[peak > -np.inf]
        if len(readable):
            expected = np.linspace(readable[0], readable[-1], PROBES)[:, None]
            peak = np.asarray(noise.log_density(expected + bias, expected))
        ahead = np.asarray(noise.log_density(expected + bias + LADDER, expected))
        behind = np.asarray(noise.log_density(expected + bias - LADDER, expected))
    top = np.maximum(peak, np.maximum(ahead, behind).max(axis=1, keepdims=True) - np.log(2))
    half = np.maximum(ahead, behind) < top - np.log(2)
    widths: Array = LADDER[half.argmax(axis=1)]
    widths = widths[half.any(axis=1)]
    if not len(widths):
        raise ValueError("a noise whose density does not fall off has no width: nothing can be planned")
    return float(np.quantile(widths, SMALL) / HALF_HEIGHT)
