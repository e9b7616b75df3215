"""What a particle filter believes: weighted points, and what is needed to move them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...arrays import Array, BoolArray
from ..estimate import BriefRepr
from ..problem import Prior


@dataclass(frozen=True, repr=False)
class ParticleBelief(BriefRepr):
    """Weighted points.

    Attributes:
        states: (M, N, n).
        log_weights: Normalised, (M, N).
        log_evidence: Of all measurements, (M,); -inf where one was impossible for every particle, which then
            left that run's particles as they were.
        prior: Where the particles came from.
        standing: Which runs have not moved since then, (M,).
        readings: Measurements since then, or since the last move, (M, B) each; NaN where a run ignored one.
        starts: Where each particle was before the last move, (M, N, n); None before the first.
        controls: Of the last move, (M, k).
    """

    states: Array
    log_weights: Array
    log_evidence: Array
    prior: Prior
    standing: BoolArray
    readings: tuple[Array, ...] = ()
    starts: Array | None = None
    controls: Array | None = None


def collected(
    belief: ParticleBelief, clouds: Sequence[tuple[Array, Array]], **changes: object
) -> ParticleBelief:
    """The belief of all runs from each run's states and log weights; no copy where nothing moved."""
    same = all(states.base is belief.states for states, _ in clouds)
    states = belief.states if same else stacked([states for states, _ in clouds])
    log_weights = stacked([log_weights for _, log_weights in clouds])
    changed: ParticleBelief = replace(belief, states=states, log_weights=log_weights, **changes)  # type: ignore[arg-type]
    return changed


def stacked(arrays: Sequence[Array]) -> Array:
    return arrays[0][None] if len(arrays) == 1 else np.stack(arrays)
