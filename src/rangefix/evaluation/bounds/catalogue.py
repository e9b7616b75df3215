"""THE table of bounds: `rangefix bounds` reads it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ...arrays import Array
from ...filters.models.correlated import refuse_shared_errors
from ...filters.problem import Problem
from ..experiment import Experiment
from .beam_subset import with_beams
from .bound import Bound, NoBoundError, without_weight
from .cramer_rao import cramer_rao
from .known_walls import known_walls
from .optimum import optimum
from .posterior_cramer_rao import posterior_cramer_rao
from .symmetry import symmetry
from .van_trees import van_trees
from .weiss_weinstein import weiss_weinstein
from .ziv_zakai import ziv_zakai

BOUNDS: tuple[tuple[str, Callable[[Problem], Bound]], ...] = (
    ("optimum", optimum),
    ("known-walls", known_walls),
    ("ziv-zakai", ziv_zakai),
    ("weiss-weinstein", weiss_weinstein),
    ("van-trees", van_trees),
    ("symmetry", symmetry),
    ("cramer-rao", cramer_rao),
)
TRAJECTORY_BOUND = "posterior-cramer-rao"
NAMES = (*(name for name, _ in BOUNDS), TRAJECTORY_BOUND)
OPTIMUM = "optimum"
NOT_BELOW = frozenset({OPTIMUM})  # what estimators reach, and so no bound
LOCAL = frozenset({"cramer-rao"})  # of unbiased estimators at one state only


class Row(NamedTuple):
    """What one entry of the table says of a set of beams.

    Attributes:
        beams: The set's label, such as "1+2".
        name: The entry.
        bound: What was computed, or None.
        refused: Why nothing was; empty otherwise.
        of_optimum: Variance over that of the optimum, by component, (n,); None where there is no optimum, and
            of local bounds, which are about something else.
    """

    beams: str
    name: str
    bound: Bound | None
    refused: str
    of_optimum: Array | None


def bounds_of(
    experiment: Experiment, names: Sequence[str] = NAMES, tell: Callable[[str], None] | None = None
) -> Iterator[Row]:
    """How good anybody could be who knows what is true, for every set of beams of an experiment.

    Args:
        experiment: The experiment; its true problem, controls and sets of beams count.
        names: The entries that are asked for.
        tell: Called with what is computed next, in words.
    """
    for beams, beam_set in zip(experiment.beam_labels, experiment.beam_sets, strict=True):
        best: Array | None = None
        for name in (name for name in NAMES if name in names):
            if tell is not None:
                tell(f"beams {beams}: {name}")
            try:
                bound = _compute(name, experiment, beam_set)
            except NoBoundError as error:
                yield Row(beams, name, None, " ".join(str(error).split()), None)
                continue
            variances = np.diagonal(bound.matrix)
            best = variances if name == OPTIMUM else best
            yield Row(beams, name, bound, "", None if best is None or name in LOCAL else variances / best)


def _compute(name: str, experiment: Experiment, beam_set: Sequence[int]) -> Bound:
    try:
        refuse_shared_errors(experiment.truth.sensor, "a bound")
    except ValueError:
        raise NoBoundError(
            "the study's true readings share errors (correlation), whatever is assumed of them: computed "
            "here for readings with errors of their own each"
        ) from None
    weighed = with_beams(experiment.truth, beam_set)
    problem = without_weight(weighed)
    bound = _of_law(name, experiment, problem)
    if problem is not weighed:
        bound = replace(bound, conditions=(*bound.conditions, "readings by their law, without their weight"))
    return bound


def _of_law(name: str, experiment: Experiment, problem: Problem) -> Bound:
    """An entry for a problem whose readings weigh as they scatter."""
    if name == TRAJECTORY_BOUND:
        return posterior_cramer_rao(problem, experiment.control_sequence)
    if experiment.steps > 1:
        raise NoBoundError("computed here for one measurement")
    if name == "cramer-rao" and experiment.start is not None:
        return cramer_rao(problem, np.asarray(experiment.start, dtype=float))
    return dict(BOUNDS)[name](problem)
