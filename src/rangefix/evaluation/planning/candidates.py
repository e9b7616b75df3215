"""Which of many candidates are looked at: some evenly among all, and all about the best of these."""

from __future__ import annotations

import numpy as np

from ...arrays import Array, IntArray

COARSE_CANDIDATES = 130  # that are compared at first, where there are more


def coarse_candidates(count: int) -> IntArray:
    """Places of the candidates that are compared at first, evenly among so many."""
    stride = max(1, count // COARSE_CANDIDATES)
    return np.arange(count)[stride // 2 :: stride]


def candidates_near(coarse: IntArray, found: Array, places: int, count: int) -> IntArray:
    """All candidates about the best of the coarse ones, but for these."""
    stride = int(coarse[1] - coarse[0])
    best = coarse[np.argsort(found)[:places], None]
    near = np.unique(np.clip(best + np.arange(1 - stride, stride), 0, count - 1))
    return np.setdiff1d(near, coarse)
