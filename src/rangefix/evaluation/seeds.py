"""Random streams by purpose and run, so that all estimators meet the same truths and the same noise."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, overload
from zlib import crc32

import numpy as np
from numpy.random import PCG64, Generator, SeedSequence
from numpy.random.bit_generator import ISpawnableSeedSequence
from numpy.typing import NDArray

from ..arrays import whole_number

WORD = 1 << 32
POOL = 4  # words that numpy's SeedSequence mixes its entropy into


def natural(name: str, value: int) -> int:
    """A seed, or a run, as an int of any size.

    Raises:
        ValueError: If it is no whole number, or negative.
    """
    return value if type(value) is int and value >= 0 else whole_number(name, value, 0)


def stream(seed: int, purpose: str, run: int) -> Generator:
    """The stream of one run for one purpose: `default_rng([seed, crc32(purpose), run])`.

    A stream depends on nothing else, so that adding runs, estimators or workers changes no number.

    Args:
        seed: Seed of the study, not negative.
        purpose: "truth", "measurement", "motion", "estimator" or another word.
        run: Number of the run, from 0.

    Raises:
        ValueError: If seed or run is no whole number, or negative.
    """
    words = natural("seed", seed), crc32(purpose.encode()), natural("run", run)
    if max(seed, run) < WORD:  # the same stream, sooner: numpy need not cut the numbers into words
        return Generator(PCG64(SeedSequence(np.array(words, dtype=np.uint32))))
    return np.random.default_rng(words)


def streams(seed: int, purpose: str, runs: Iterable[int]) -> list[Generator]:
    """One stream for each run, the same as by `stream`; their seeds are worked out together.

    Raises:
        ValueError: If seed or a run is no whole number, or negative.
    """
    seed, runs = natural("seed", seed), [natural("run", run) for run in runs]
    if not runs or max(seed, max(runs)) >= WORD:
        return [stream(seed, purpose, run) for run in runs]
    entropy = np.empty((len(runs), 3), dtype=np.uint32)
    entropy[:] = seed, crc32(purpose.encode()), 0
    entropy[:, 2] = runs
    seeds: list[Any] = [_Seed(*each) for each in zip(entropy, seed_words(entropy), strict=True)]
    return [Generator(PCG64(seed)) for seed in seeds]


class _Seed(ISpawnableSeedSequence):
    """A SeedSequence whose words for PCG64 are known already; it makes a real one when asked for more."""

    __slots__ = ("_entropy", "_made", "_words")  # one of these for each run and purpose

    def __init__(self, entropy: NDArray[np.uint32], words: NDArray[np.uint64]) -> None:
        self._entropy, self._words = entropy, words
        self._made: SeedSequence | None = None

    def _real(self) -> SeedSequence:
        self._made = SeedSequence(self._entropy) if self._made is None else self._made
        return self._made

    def generate_state(self, n_words: int, dtype: Any = np.uint32) -> Any:
        """As of `SeedSequence`."""
        if n_words == len(self._words) and dtype is np.uint64:
            return self._words
        return self._real().generate_state(n_words, dtype)

    def spawn(self, n_children: int) -> Any:
        """As of `SeedSequence`."""
        return self._real().spawn(n_children)


def seed_words(entropy: NDArray[np.uint32]) -> NDArray[np.uint64]:
    """What `SeedSequence(row).generate_state(4, uint64)` gives for each row, (M, 3) -> (M, 4).

    The mixing of numpy's SeedSequence (O'Neill's seed_seq), which numpy promises not to change, for all rows
    at once: numpy's own takes most of the time that a run of a quick estimator costs.
    """
    constant = 0x43B0D7E5

    def hashed(value: NDArray[np.uint32], factor: int = 0x931E8875) -> NDArray[np.uint32]:
        nonlocal constant
        value = value ^ np.uint32(constant)
        constant = constant * factor % WORD
        value = value * np.uint32(constant)
        return np.asarray(value ^ (value >> np.uint32(16)))

    def mixed(one: NDArray[np.uint32], other: NDArray[np.uint32]) -> NDArray[np.uint32]:
        value = one * np.uint32(0xCA01F9DD) - other * np.uint32(0x4973F715)
        return np.asarray(value ^ (value >> np.uint32(16)))

    rest = np.zeros((len(entropy), POOL - entropy.shape[1]), dtype=np.uint32)
    pool = [hashed(column) for column in np.concatenate([entropy, rest], axis=1).T]
    for source in range(POOL):
        for target in range(POOL):
            if source != target:
                pool[target] = mixed(pool[target], hashed(pool[source]))
    constant = 0x8B51F9DD
    state = np.stack([hashed(pool[place % POOL], 0x58F38DED) for place in range(2 * POOL)], axis=1)
    return state.astype("<u4").view("<u8").astype(np.uint64)


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
