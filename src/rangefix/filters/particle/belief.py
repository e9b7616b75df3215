"""What a particle filter believes: weighted points, and what is needed to move them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, zip_longest

import numpy as np

from ...arrays import Array, BoolArray, IntArray
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
        unread: Of each run the controls of its moves before any reading, (k,) each; None once there is one,
            or after too many moves to draw them anew.
        readings: Measurements since then, or since the last move, (M, B) each; NaN where a run ignored one.
        starts: Where each particle was before the last move, (M, N, n); None before the first.
        controls: Of the last move, (M, k).
        counts: Particles of each run, the first ones of N, (M,); None where each has N.
    """

    states: Array
    log_weights: Array
    log_evidence: Array
    prior: Prior
    standing: BoolArray
    unread: tuple[tuple[Array, ...] | None, ...]
    readings: tuple[Array, ...] = ()
    starts: Array | None = None
    controls: Array | None = None
    counts: IntArray | None = None

    def split(self) -> Iterator[ParticleBelief]:
        """The belief of each run alone."""
        for run in range(len(self.states)):
            one = slice(run, run + 1)
            count = slice(None if self.counts is None else int(self.counts[run]))
            yield ParticleBelief(
                self.states[one, count],
                self.log_weights[one, count],
                self.log_evidence[one],
                self.prior,
                self.standing[one],
                self.unread[one],
                tuple(reading[one] for reading in self.readings),
                None if self.starts is None else self.starts[one, count],
                None if self.controls is None else self.controls[one],
            )


def joined(beliefs: Sequence[ParticleBelief]) -> ParticleBelief:
    """One belief of runs that were worked on alone; what a run does not have, nothing of it reads."""
    counts = np.array([one.states.shape[1] for one in beliefs])
    moved = [one.controls for one in beliefs if one.controls is not None]
    starts = [one.states if one.starts is None else one.starts for one in beliefs]
    blank = next((np.full_like(one.readings[0], np.nan) for one in beliefs if one.readings), np.empty(0))
    readings = zip_longest(*(one.readings for one in beliefs), fillvalue=blank)
    return ParticleBelief(
        stacked([one.states[0] for one in beliefs]),
        stacked([one.log_weights[0] for one in beliefs], -np.inf),
        np.concatenate([one.log_evidence for one in beliefs]),
        beliefs[0].prior,
        np.concatenate([one.standing for one in beliefs]),
        tuple(chain.from_iterable(one.unread for one in beliefs)),
        tuple(map(np.concatenate, readings)),
        stacked([start[0] for start in starts]) if moved else None,
        np.concatenate([np.zeros_like(moved[0]) if one.controls is None else one.controls for one in beliefs])
        if moved
        else None,
        None if (counts == counts[0]).all() else counts,
    )


def collected(
    belief: ParticleBelief, clouds: Sequence[tuple[Array, Array]], **changes: object
) -> ParticleBelief:
    """The belief of all runs from each run's states and log weights; no copy where nothing moved."""
    same = all(states.base is belief.states for states, _ in clouds)
    states = belief.states if same else stacked([states for states, _ in clouds])
    log_weights = stacked([log_weights for _, log_weights in clouds])
    changed: ParticleBelief = replace(belief, states=states, log_weights=log_weights, **changes)  # type: ignore[arg-type]
    return changed


def stacked(arrays: Sequence[Array], filler: float = 0.0) -> Array:
    """Arrays (N, ...) as one, (M, N, ...); shorter ones are filled up at the end."""
    if len(arrays) == 1:
        return arrays[0][None]
    whole = np.full((len(arrays), max(map(len, arrays)), *arrays[0].shape[1:]), filler)
    for run, array in enumerate(arrays):
        whole[run, : len(array)] = array
    return whole
