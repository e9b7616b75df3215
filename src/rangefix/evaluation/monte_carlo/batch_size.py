"""How many runs of an estimator fit into memory at once."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ...arrays import Array
from ...filters import Estimator
from ..seeds import Streams
from .trial import Trial

BUDGET = 128e6  # bytes of beliefs held at once
DEPTH = 4  # how deep a belief is searched for arrays


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
            before = estimator.init(trial.problem.prior, rngs)
            after = estimator.update(before, measurement[:count, 0].copy(), rngs)
            sizes.append(max(nbytes(before), nbytes(after)))
    except (Exception, SystemExit):  # its trials will say what is wrong
        return 1_000_000
    return max(1, int(BUDGET / max(1, sizes[1] - sizes[0])))


def nbytes(belief: object, depth: int = DEPTH) -> int:
    """Bytes of the arrays in a record, sequence, mapping or object."""
    if isinstance(belief, np.ndarray):
        return belief.nbytes
    if depth == 0 or isinstance(belief, (str, bytes, int, float, type(None))):
        return 0
    parts: Iterable[object]
    if dataclasses.is_dataclass(belief) and not isinstance(belief, type):
        parts = [getattr(belief, each.name, None) for each in dataclasses.fields(belief)]
    elif isinstance(belief, Mapping):
        parts = belief.values()
    elif isinstance(belief, (tuple, list)):
        parts = belief
    else:
        parts = vars(belief).values() if hasattr(belief, "__dict__") else ()
    return sum(nbytes(part, depth - 1) for part in parts)
