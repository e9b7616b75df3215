"""An experiment: what the world is, what the estimators assume, and who is compared on what."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array, keep_whole
from ..errors import counted, printable
from ..filters import Estimator, Problem
from ..filters.registry import BUILT_IN, build_with, resolve
from .seeds import natural

Builder = Callable[[Problem], Estimator[Any]]
MAX_BEAMS_LISTED = 8  # sets of more are labelled by ranges
STEP_TIMEOUT_S = 60.0  # of our own, for each measurement of a run
TRIAL_TIMEOUT_S = 60.0  # of a plug-in, unless the study says otherwise


@dataclass(frozen=True)
class NamedEstimator:
    """A builder for an estimator known by name: `build(name, problem, **options)`.

    Attributes:
        name: As for `build`.
        options: The estimator's own.
        folder: Where a file counts from, and where modules are looked for that are not installed: that of the
            study which names it. Unless given, a file counts from the current folder.
    """

    name: str
    options: Mapping[str, Any] = field(default_factory=dict)
    folder: Path | None = None

    def __call__(self, problem: Problem) -> Estimator[Any]:
        """Build the estimator for a problem."""
        return self.build_with(self.factory(), problem)

    def factory(self) -> Any:
        """Import the function or class of that name; it may raise what `resolve` raises."""
        return resolve(self.name, self.folder)

    def build_with(self, factory: Any, problem: Problem) -> Estimator[Any]:
        """Build the estimator for a problem; whatever the factory raises comes out."""
        return build_with(self.name, factory, problem, self.options)

    @property
    def is_built_in(self) -> bool:
        """Whether it comes with this package."""
        return self.name in BUILT_IN


@dataclass(frozen=True)
class Experiment:
    """What a study file describes, in objects; a file is one way to make one.

    Attributes:
        truth: The world: states are drawn from its prior and motion, readings from its sensor.
        estimators: Label -> what builds the estimator from the assumed problem.
        runs: Monte Carlo runs, M.
        seed: Seed of all streams; not negative.
        assumed: The problem as the estimators know it; the truth unless given.
        beam_sets: Sets of beams, numbered from 1, each compared on its own; all beams unless given.
        start: A true first state (n,) for all runs instead of draws from the prior.
        controls: Moves between the measurements, (T - 1, k); none unless given, so T = 1.
        name: What it is called.
        title: The same in a few words.
        config: The text of its file.
        block: Runs to a part, the unit that is saved and resumed. Blocks start at its multiples.
        identity: What tells this experiment's problem from another's; by pickling the problems unless given.
        sources: Modules that made the problem, beyond those of its objects; their source is in the keys.
        timeout: Longest that a trial may take, s; then it is killed, which takes a process of its own. 0: no
            limit. None: TRIAL_TIMEOUT_S for plug-ins that are known by name; STEP_TIMEOUT_S for each
            measurement for our own estimators, in this process, where it has an alarm clock; none for
            builders that are Python objects.
        plugin_memory_gb: Memory that the process of an estimator with a time limit may take, GB; half of the
            machine's, at most 8, unless given.
        beliefs: What to do with the beliefs of estimators that can sample them. True: judge them by ranks of
            the truth, energy score, main mode (`belief_scores.py`), in about a millisecond a run and step.
            None: draw just what verdicts need (`null_distribution.py`). False: draw nothing.

    Raises:
        ValueError: If any of these does not fit.
    """

    truth: Problem
    estimators: Mapping[str, Builder]
    runs: int = 1000
    seed: int = 1
    assumed: Problem | None = None
    beam_sets: Sequence[Sequence[int]] = ()
    start: ArrayLike | None = None
    controls: ArrayLike | None = None
    name: str = "experiment"
    title: str = ""
    config: str = ""
    block: int = 500
    identity: str = ""
    sources: Sequence[str] = ()
    timeout: float | None = None
    plugin_memory_gb: float | None = None
    beliefs: bool | None = None

    def __post_init__(self) -> None:
        if not self.estimators:
            raise ValueError("an experiment needs at least one estimator")
        if not isinstance(self.estimators, Mapping) or not all(
            isinstance(label, str) for label in self.estimators
        ):
            raise ValueError(f"estimators are a dict, label -> what builds one, got {self.estimators!r}")
        for label, builder in self.estimators.items():
            if not callable(builder):
                wanted = "what builds it of a problem, such as NamedEstimator('ekf')"
                raise ValueError(f"estimator {label!r} is to be {wanted}, got {builder!r}")
        if not isinstance(self.name, str):
            raise ValueError(f"the name must be a text, got {self.name!r}")
        keep_whole(self, "runs", 1)
        keep_whole(self, "block", 1)
        object.__setattr__(self, "seed", natural("seed", self.seed))
        if not (isinstance(self.truth, Problem) and isinstance(self.assumed_problem, Problem)):
            raise ValueError(f"truth and assumed are each a Problem, got {self.truth!r} and {self.assumed!r}")
        if not all(isinstance(beam_set, Iterable) for beam_set in self.beam_sets):
            raise ValueError(f"beam_sets are lists of numbers, such as [[1], [1, 2]], got {self.beam_sets!r}")
        if self.timeout is not None and not 0 <= self.timeout < np.inf:
            raise ValueError(f"the timeout must be some seconds, or 0 for no limit, got {self.timeout}")
        if self.plugin_memory_gb is not None and not self.plugin_memory_gb > 0:
            raise ValueError(f"the memory of plug-ins must be positive, got {self.plugin_memory_gb} GB")
        if self.truth.space.names != self.assumed_problem.space.names:
            raise ValueError("the true and the assumed problem must have the same state components")
        beams = len(self.truth.sensor.bearings)
        if len(self.assumed_problem.sensor.bearings) != beams:
            raise ValueError("the true and the assumed sensor must have the same number of beams")
        sets = [tuple(beam_set) for beam_set in self.beam_sets] or [tuple(range(1, beams + 1))]
        for beam_set in sets:
            numbers = set(beam_set)
            if not numbers or len(numbers) < len(beam_set) or not numbers <= set(range(1, beams + 1)):
                text = f"a set of beams holds different numbers from 1 to {beams}, got {list(beam_set)}"
                raise ValueError(text)
        if len(set(map(frozenset, sets))) != len(sets):
            raise ValueError("a set of beams stands twice")
        object.__setattr__(self, "beam_sets", tuple(sets))
        size = self.truth.space.size
        if self.start is not None and np.shape(self.start) != (size,):
            raise ValueError(f"the true start must have shape ({size},), got {np.shape(self.start)}")

    def __repr__(self) -> str:
        names, sets = ", ".join(self.estimators), ", ".join(self.beam_labels)
        told = f"{names} on beams {sets}; {counted(self.runs, 'run')} of {counted(self.steps, 'step')}"
        return printable(f"<Experiment {self.name!r}: {told}>")

    @property
    def assumed_problem(self) -> Problem:
        """The problem as the estimators know it."""
        return self.truth if self.assumed is None else self.assumed

    @cached_property
    def control_sequence(self) -> Array:
        """The controls between measurements, (T - 1, k)."""
        return np.zeros((0, 0)) if self.controls is None else np.atleast_2d(np.asarray(self.controls, float))

    @property
    def steps(self) -> int:
        """Measurements in a run, T."""
        return 1 if self.controls is None else len(self.control_sequence) + 1

    @cached_property
    def beam_labels(self) -> tuple[str, ...]:
        """A label for each set of beams."""
        beams = len(self.truth.sensor.bearings)
        if len(self.beam_sets) == 1 and len(self.beam_sets[0]) == beams:
            return ("all",)
        return tuple(map(beam_label, self.beam_sets))

    def timeout_of(self, label: str) -> float | None:
        """Seconds that a trial of an estimator may take; None: as long as it likes."""
        builder = self.estimators[label]
        if self.timeout is not None:
            return self.timeout or None
        return TRIAL_TIMEOUT_S if isinstance(builder, NamedEstimator) and not builder.is_built_in else None

    def limit_here(self, label: str) -> float:
        """Seconds after which a run of an estimator is ended that has no process of its own; inf: never."""
        builder = self.estimators[label]
        ours = isinstance(builder, NamedEstimator) and builder.is_built_in
        return STEP_TIMEOUT_S * self.steps if ours and self.timeout is None else np.inf

    def masked(self, measurement: Array, beam_set: int) -> Array:
        """Measurements (..., B) as a set of beams, counted from 0, shows them: NaN for the others."""
        beams = np.arange(1, measurement.shape[-1] + 1)
        return np.where(np.isin(beams, self.beam_sets[beam_set]), measurement, np.nan)


def beam_label(beams: Sequence[int]) -> str:
    """Beams joined by plus signs: "1+2+3", or "1-40+60-99" where there are many."""
    numbers = sorted(beams)
    if len(numbers) <= MAX_BEAMS_LISTED:
        return "+".join(map(str, numbers))
    ends = [numbers[0], *(n for a, b in pairwise(numbers) if b - a > 1 for n in (a, b))]
    ends.append(numbers[-1])
    pairs = zip(ends[::2], ends[1::2], strict=True)
    return "+".join(f"{a}-{b}" if b > a else f"{a}" for a, b in pairs)
