"""How good anybody could be on a study, as it is saved beside the results: `bounds.json`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...arrays import Array
from .files import ResultsError, read_json
from .folder import FolderLayout
from .schema import check_bounds


class SavedBounds(NamedTuple):
    """What is known of a set of beams before any estimator is run, of the error after the last measurement.

    Attributes:
        optimum: Variances of the best estimate that there is, m^2 and rad^2, (n,); None where they could not
            be computed.
        bound: Below which no estimator's variances lie, the largest that applies to each component, (n,); NaN
            where none does.
        names: Which bound that is, (n,); "" where there is none.
    """

    optimum: Array | None
    bound: Array
    names: tuple[str, ...]


def read_bounds(path: Path, plan: FolderLayout) -> Mapping[str, SavedBounds]:
    """The bounds of each set of beams of a folder; empty where none are saved.

    Args:
        path: The document.
        plan: Of the folder.

    Raises:
        ResultsError: If it is damaged, or about another problem than the folder.
    """
    if not path.exists():
        return {}
    document = read_json(path)
    check_bounds(path, document)
    if document["world"] != plan.world:
        raise ResultsError(f"{path} is about another problem: remove it, or run rangefix bounds again")
    found = {}
    for beams, saved in document["sets"].items():
        if beams not in plan.beams or len(saved["bound"]) != plan.shape[1]:
            raise ResultsError(f"{path} is damaged (beams {beams[:80]!r}): run rangefix bounds again")
        optimum = saved["optimum"]
        bound = np.array([np.nan if each is None else each for each in saved["bound"]], dtype=float)
        best = None if optimum is None else np.array(optimum, dtype=float)
        found[beams] = SavedBounds(best, bound, tuple(saved["bound_names"]))
    return found
