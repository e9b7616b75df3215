"""An estimator that was built, and what is asked of it: how many runs at once, trials, and its time."""

from __future__ import annotations

from time import perf_counter
from typing import Any, NamedTuple

from ...arrays import Array
from ...filters import Estimator
from ..experiment import Builder, NamedEstimator
from ..isolation import Announce, Note, say_nothing
from ..results import Outcome, concatenate
from .batch_size import batch_size
from .timing import one_thread, seconds_per_update
from .trial import Trial


class Probe(NamedTuple):
    """What two runs show: how many runs fit the memory at once, and seconds for a run."""

    size: int
    seconds: float


class BuiltEstimator(NamedTuple):
    """An estimator that was built, and the trials it is put to."""

    trial: Trial
    estimator: Estimator[Any]

    @classmethod
    def build(cls, trial: Trial, builder: Builder, announce: Announce = say_nothing) -> BuiltEstimator:
        """Build it; whatever the builder raises comes out.

        Args:
            trial: What it will be put to.
            builder: What makes it.
            announce: Told whether it is being imported or built.
        """
        if isinstance(builder, NamedEstimator):
            factory = builder.factory()
            announce("building it", 0)
            return cls(trial, builder.build_with(factory, trial.problem))
        announce("building it", 0)
        return cls(trial, builder(trial.problem))

    def probe(self, measurement: Array) -> Probe:
        """Of runs 0 and 1, (2, T, B), so that all processes and resumed runs agree on the size."""
        size = batch_size(self.trial, self.estimator, measurement)
        start = perf_counter()
        self.trial.run(self.estimator, measurement, 0)
        return Probe(size, perf_counter() - start)

    def run(
        self,
        measurement: Array,
        first: int,
        size: int,
        truth: Array | None = None,
        note: Note = say_nothing,
        announce: Announce = say_nothing,
    ) -> Outcome:
        """Trials of runs first, first + 1, ... in batches of a size; with truths, beliefs are judged too.

        `note` and `announce` are told what is about to be done: see `Trial.run`.
        """
        outcomes = []
        for start in range(0, len(measurement), size):

            def noted(place: int, count: int, start: int = start) -> None:
                note(start + place, count)

            here = slice(start, start + size)
            true = None if truth is None else truth[here]
            some = measurement[here]
            outcomes.append(self.trial.run(self.estimator, some, first + start, noted, true, announce))
        return concatenate(outcomes) if len(outcomes) != 1 else outcomes[0]

    def time(self, measurement: Array) -> dict[str, Any]:
        """Seconds per update and run with one thread, None if it fails; and whose threads could be held."""
        with one_thread() as held:
            seconds = seconds_per_update(self.trial, self.estimator, measurement)
        return {"seconds": seconds if seconds == seconds else None, "one_thread": held}
