"""How many particles a belief needs: KLD-sampling (Fox, International Journal of Robotics Research 22, 2003).

As many as keep the Kullback-Leibler distance between the particles' shares of bins and those of the belief
below a bound, with a stated probability: hardly more than the least for a belief in one place, and tens of
thousands for one that is spread over a building.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.random import Generator

from ...arrays import Array
from ..space import StateSpace
from .belief import ParticleBelief
from .resampling import comb
from .weights import equal, exp_of

DISTANCE, QUANTILE = 0.02, 2.326  # nats; of the normal law: kept in 99 % of the cases
BIN_M, BIN_RAD = 0.5, np.deg2rad(10.0)  # as in ROS' amcl; m/s for a velocity
SHRINK_BELOW = 0.8  # of the particles that there are: fewer are taken only where no more than that are needed


def resized(
    belief: ParticleBelief, space: StateSpace, least: int, most: int, rng: Generator
) -> ParticleBelief:
    """The belief of one run with as many particles as it needs, of equal weight if their number changes.

    Args:
        belief: What is believed.
        space: Of its states.
        least, most: The bounds of the number.
        rng: From which a number is drawn; another if the number of particles changes.
    """
    states, weights = belief.states[0], exp_of(belief.log_weights[0])
    needed = particles_needed(states[comb(weights, most, rng)], space)
    size = int(np.clip(needed, least, most))
    if SHRINK_BELOW * len(states) < size <= len(states):
        return belief
    states = states[comb(weights, size, rng)][None]
    log_weights = np.broadcast_to(equal(size), states.shape[:2])
    return replace(belief, states=states, log_weights=log_weights, starts=None, controls=None)


def particles_needed(states: Array, space: StateSpace) -> int:
    """Particles that a belief needs by its draws (K, n): for bins as many as these occupy."""
    sizes = np.where(space.is_angle, BIN_RAD, BIN_M)
    bins = len(np.unique(np.floor(states / sizes).astype(np.int64), axis=0))
    if bins == 1:
        return 1
    spread = 2.0 / (9.0 * (bins - 1))
    return int(np.ceil((bins - 1) / (2 * DISTANCE) * (1 - spread + np.sqrt(spread) * QUANTILE) ** 3))
