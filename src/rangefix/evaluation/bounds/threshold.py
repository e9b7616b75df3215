"""How optimum and bounds grow with the noise: where they leave the line of small noise is the threshold."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import Array
from ...filters.models.noise import Gaussian
from ...filters.models.rangefinder import Rangefinder
from ...filters.problem import Problem
from .bound import NoBoundError, require_gaussian, without_weight
from .known_walls import known_walls
from .optimum import optimum
from .weiss_weinstein import weiss_weinstein
from .ziv_zakai import ziv_zakai

STDS_M = tuple(np.geomspace(0.01, 5.0, 10).round(4).tolist())  # of the noise
CURVES = (
    ("optimum", optimum),
    ("known-walls", known_walls),
    ("ziv-zakai", ziv_zakai),
    ("weiss-weinstein", weiss_weinstein),
)
PRIOR = "prior"


@dataclass(frozen=True)
class ThresholdCurve:
    """Variances over the noise.

    Attributes:
        names: Components of the state.
        stds: Standard deviations of the noise, m, (R,).
        variances: Entry -> variance of each component, m^2 and rad^2, (R, n); NaN where there is none.
        refused: Entry -> why it was nowhere computed.
    """

    names: tuple[str, ...]
    stds: Array
    variances: dict[str, Array]
    refused: dict[str, str]


def threshold_curve(
    problem: Problem, stds: Sequence[float] = STDS_M, tell: Callable[[str], None] = lambda text: None
) -> ThresholdCurve:
    """Optimum, known walls, Ziv-Zakai, Weiss-Weinstein and prior for a problem with other noise.

    Args:
        problem: Of Gaussian noise.
        stds: Of all beams, m.
        tell: Called with what is computed next, in words.

    Raises:
        NoBoundError: If the noise of the problem is not Gaussian, or none of them applies.
    """
    problem = without_weight(problem)
    require_gaussian(problem)
    sensor = problem.sensor
    if not isinstance(sensor, Rangefinder):
        raise NoBoundError(f"computed here for a Rangefinder, not {sensor!r}")
    size = problem.space.size
    variances = {name: np.full((len(stds), size), np.nan) for name, _ in CURVES}
    refused: dict[str, str] = {}
    for place, std in enumerate(stds):
        noisy = replace(problem, sensor=replace(sensor, noise=Gaussian(float(std))))
        for name, compute in CURVES:
            tell(f"noise of {std:g} m: {name}")
            try:
                found = np.diagonal(compute(noisy).matrix)
            except NoBoundError as error:
                refused[name] = " ".join(str(error).split())
            else:
                variances[name][place] = np.where(found > 0, found, np.nan)
    kept = {name: values for name, values in variances.items() if np.isfinite(values).any()}
    if not kept:
        raise NoBoundError("; ".join(f"{name}: {reason}" for name, reason in refused.items()))
    prior = np.diagonal(np.asarray(problem.prior.covariance))
    kept[PRIOR] = np.broadcast_to(prior, (len(stds), size))
    nowhere = {name: reason for name, reason in refused.items() if name not in kept}
    return ThresholdCurve(problem.space.names, np.asarray(stds, dtype=float), kept, nowhere)
