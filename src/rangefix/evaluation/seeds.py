"""Random streams by purpose and run, so that all estimators meet the same truths and the same noise."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import overload
from zlib import crc32

import numpy as np
from numpy.random import PCG64, Generator, SeedSequence

WORD = 1 << 32


def stream(seed: int, purpose: str, run: int) -> Generator:
    """The stream of one run for one purpose: `default_rng([seed, crc32(purpose), run])`.

    A stream depends on nothing else, so that adding runs, estimators or workers changes no number.

    Args:
        seed: Seed of the study, not negative.
        purpose: "truth", "measurement", "motion", "estimator" or another word.
        run: Number of the run, from 0.
    """
    words = (seed, crc32(purpose.encode()), run)
    if max(seed, run) < WORD:  # the same stream, sooner: numpy need not cut the numbers into words
        return Generator(PCG64(SeedSequence(np.array(words, dtype=np.uint32))))
    return np.random.default_rng(words)


def streams(seed: int, purpose: str, runs: Iterable[int]) -> list[Generator]:
    """One stream for each run."""
    return [stream(seed, purpose, run) for run in runs]


class Streams(Sequence[Generator]):
    """The same, each made when it is first asked for: an estimator that draws nothing pays for none."""

    def __init__(self, seed: int, purpose: str, runs: Iterable[int]) -> None:
        self._seed, self._purpose, self._runs = seed, purpose, tuple(runs)
        self._made: dict[int, Generator] = {}

    def __len__(self) -> int:
        return len(self._runs)

    @overload
    def __getitem__(self, place: int) -> Generator: ...
    @overload
    def __getitem__(self, place: slice) -> list[Generator]: ...
    def __getitem__(self, place: int | slice) -> Generator | list[Generator]:
        """The stream of the run at a place; always the same object, so that draws go on."""
        if isinstance(place, slice):
            return [self[i] for i in range(len(self))[place]]
        run = self._runs[place]
        if run not in self._made:
            self._made[run] = stream(self._seed, self._purpose, run)
        return self._made[run]
