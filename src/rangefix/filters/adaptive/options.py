"""The options of the adaptive point-mass filter, and the problems that it takes."""

from __future__ import annotations

import numpy as np

from ..problem import Problem, expects_map_ranges
from .target import STATE_COST, WORK

ACCURACIES = (1e-4, 0.5)  # that may be asked for
LEAST_RAYS, LEAST_CELLS = 1000, 1000  # of the table, and that a mode may be allowed
USUAL_STATES = 15_000  # that a fix looks at: guesses, climbs, a mode and its neighbour
CHECKED_STATES = 16  # at which a sensor is asked whether it expects what its map says


def unknown_to_lattices(problem: Problem) -> str:
    """What of a problem's sensor the adaptive point-mass filter cannot take; "" if it takes all."""
    if problem.sensor.max_incidence < np.pi / 2:
        return "knows no largest incidence: use a BeamMixture"
    beams, most = len(problem.sensor.bearings), int(WORK / USUAL_STATES - STATE_COST)
    if beams > most:
        return (
            f"asks some {USUAL_STATES} states for {beams} ranges each, more than {WORK:.2g} rays: take at "
            f"most {most} beams"
        )
    states = problem.prior.sample(CHECKED_STATES, np.random.default_rng(0))
    return (
        "" if expects_map_ranges(problem.sensor, states) else "needs a sensor that expects what its map says"
    )


def check_options(accuracy: float, drop: float) -> None:
    """Refuse options that are out of bounds.

    Raises:
        ValueError: If one is.
    """
    finest, coarsest = ACCURACIES
    if not finest <= accuracy <= coarsest:
        raise ValueError(f"the accuracy must be in [{finest}, {coarsest}], got {accuracy}")
    if not 0 < drop < 1e-2:
        raise ValueError(f"the dropped density must be in (0, 0.01), got {drop}")
