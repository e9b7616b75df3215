"""What draws from the beliefs of all runs come to, chunk by chunk."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from .intervals import Interval, Moments
from .scores import BINS
from .scores_belief import BeliefScores, rank_histogram
from .summary import Beliefs


class BeliefTotals:
    """What the beliefs of all runs come to; chunk by chunk, in the same order, the same numbers."""

    def __init__(self, size: int) -> None:
        self.counts = np.zeros((size + 1, BINS))
        self.energy, self.share = Moments(), Moments()
        self.crps, self.whole, self.mode = ([Moments() for _ in range(size)] for _ in range(3))

    def add(self, found: BeliefScores) -> None:
        """Take in the runs of a chunk, but for those whose beliefs were not sampled."""
        known = np.isfinite(found.energy)
        ranks, distance, energy, crps, share, mode, whole = (array[known] for array in found)
        for counts, each in zip(self.counts, [*ranks.T, distance], strict=True):
            counts += rank_histogram(each)
        self.energy.add(energy)
        self.share.add(share)
        for i, (score, all_draws, main) in enumerate(zip(self.crps, self.whole, self.mode, strict=True)):
            score.add(crps[:, i])
            all_draws.add(whole[:, i, i])
            main.add(mode[:, i, i])

    def summary(self) -> Beliefs | None:
        """What they come to; None where no belief was sampled."""
        if not self.energy.count:
            return None
        return Beliefs(
            energy=self.energy.interval(),
            crps=_intervals(self.crps),
            whole=_intervals(self.whole),
            mode=_intervals(self.mode),
            share=self.share.interval(),
            ranks=self.counts,
        )


def _intervals(moments: Iterable[Moments]) -> tuple[Interval, ...]:
    return tuple(each.interval() for each in moments)
