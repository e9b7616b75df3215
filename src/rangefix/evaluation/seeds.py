"""Random streams by purpose and run, so that all estimators meet the same truths and the same noise."""

from __future__ import annotations

from collections.abc import Iterable
from zlib import crc32

import numpy as np
from numpy.random import Generator


def stream(seed: int, purpose: str, run: int) -> Generator:
    """The stream of one run for one purpose: `default_rng([seed, crc32(purpose), run])`.

    A stream depends on nothing else, so that adding runs, estimators or workers changes no number.

    Args:
        seed: Seed of the study, not negative.
        purpose: "truth", "measurement", "motion", "estimator" or another word.
        run: Number of the run, from 0.
    """
    return np.random.default_rng([seed, crc32(purpose.encode()), run])


def streams(seed: int, purpose: str, runs: Iterable[int]) -> list[Generator]:
    """One stream for each run."""
    return [stream(seed, purpose, run) for run in runs]
