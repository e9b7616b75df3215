"""Find how many runs of an estimator fit into memory at once."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ...arrays import Array
from ...filters import Estimator
from ...filters.estimator import filtered
from ...filters.memory import MAX_BELIEF_BYTES
from ..seeds import Streams
from .trial import Trial

MAX_DEPTH = 4  # how deep a belief is searched for arrays


def batch_size(trial: Trial, estimator: Estimator[Any], measurement: Array) -> int:
    """How many runs' beliefs fit the memory budget, from what a second run adds to a first one's belief.

    Args:
        trial: The trial.
        estimator: The estimator.
        measurement: Of runs 0 and 1, (2, T, B).
    """
    sizes = []
    try:
        for count in (1, 2):
            rngs = Streams(trial.seed, "estimator", range(count))
            readings = [measurement[:count, 0].copy()]
            beliefs = filtered(estimator, trial.problem.prior, trial.moves[:0], readings, rngs)
            sizes.append(max(nbytes(belief) for _, _, belief in beliefs))
    except (Exception, SystemExit):  # its trials will say what is wrong
        return 1_000_000
    return max(1, int(MAX_BELIEF_BYTES / max(1, sizes[1] - sizes[0])))


def nbytes(belief: object, depth: int = MAX_DEPTH) -> int:
    """Bytes of the arrays in a record, sequence, mapping or object."""
    if isinstance(belief, np.ndarray):
        return belief.nbytes
    if depth == 0 or isinstance(belief, str | bytes | type):
        return 0
    parts: Iterable[object]
    if isinstance(belief, Mapping):
        parts = belief.values()
    elif isinstance(belief, tuple | list):
        parts = belief
    elif dataclasses.is_dataclass(belief):
        parts = [getattr(belief, field.name) for field in dataclasses.fields(belief)]
    else:
        parts = getattr(belief, "__dict__", {}).values()
    return sum(nbytes(part, depth - 1) for part in parts)
