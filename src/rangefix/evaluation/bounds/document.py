"""What `rangefix bounds` found as one document: for programs, and to be saved beside results."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..experiment import Experiment
from .catalogue import LOCAL, NOT_BELOW, OPTIMUM, Row

SCHEMA = 1
ERRORS = 4.0  # standard errors that are taken off where a bound is an average and has not lost them yet
AVERAGED = frozenset({"known-walls"})  # whose error is not subtracted yet


def row_as_json(row: Row, components: Sequence[str]) -> dict[str, Any]:
    """One entry as plain values; m^2 and rad^2."""
    told: dict[str, Any] = {"beams": row.beams, "name": row.name}
    if row.bound is None:
        return told | {"refused": row.refused}
    variances = {name: float(row.bound.matrix[i, i]) for i, name in enumerate(components)}
    return told | {
        "variances": variances,
        "matrix": row.bound.matrix.tolist(),
        "error": row.bound.error.tolist(),
        "share_of_optimum": None
        if row.of_optimum is None
        else dict(zip(components, row.of_optimum.tolist(), strict=True)),
        "conditions": list(row.bound.conditions),
    }


def document_of(rows: Sequence[Row], experiment: Experiment, world: str) -> dict[str, Any]:
    """All entries, and for each set of beams what tables of estimators show beside G.

    Bounds are averages over the prior: where all truths of a study are one state, none of them is about its
    G, and no set is in the document.

    Args:
        rows: All that was computed for the experiment.
        experiment: The experiment.
        world: The key of its truths.
    """
    names = experiment.truth.space.names
    labels = experiment.beam_labels if experiment.start is None else ()
    return {
        "schema": SCHEMA,
        "world": world,
        "names": list(names),
        "sets": {label: _set([row for row in rows if row.beams == label], len(names)) for label in labels},
        "rows": [row_as_json(row, names) for row in rows],
    }


def _set(rows: Sequence[Row], size: int) -> dict[str, Any]:
    """The optimum and the largest bound of each component; None where there is none."""
    optimum: list[float] | None = None
    bound: list[float | None] = [None] * size
    bound_names = [""] * size
    for row in rows:
        if row.bound is None or row.name in LOCAL:
            continue
        variances = np.diagonal(row.bound.matrix)
        if row.name == OPTIMUM:
            optimum = [max(float(variance), 0.0) for variance in variances]
        if row.name in NOT_BELOW:
            continue
        lost = ERRORS * np.diagonal(row.bound.error) if row.name in AVERAGED else np.zeros(size)
        for place, variance in enumerate(variances - lost):
            if variance > (bound[place] or 0.0):  # a bound of 0 says nothing
                bound[place], bound_names[place] = float(variance), row.name
    return {"optimum": optimum, "bound": bound, "bound_names": bound_names}
