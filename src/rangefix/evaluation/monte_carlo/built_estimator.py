"""An estimator that was built, and what is asked of it: how many runs at once, trials, and its time."""

from __future__ import annotations

from time import perf_counter
from typing import Any, NamedTuple

from ...arrays import Array
from ...filters import Estimator
from ..experiment import Builder, NamedEstimator
from ..isolation import Announce, Note, say_nothing
from ..results import Outcome
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
        """Trials of runs first, first + 1, ...: see `Trial.run`."""
        return self.trial.run(self.estimator, measurement, first, size, truth, note, announce)

    def time(self, measurement: Array) -> dict[str, Any]:
        """Seconds per update and run with one thread, None if it fails; and whose threads could be held."""
        with one_thread() as held:
            seconds = seconds_per_update(self.trial, self.estimator, measurement)
        return {"seconds": seconds if seconds == seconds else None, "one_thread": held}
