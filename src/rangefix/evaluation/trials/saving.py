"""Long work is done a few runs at a time, so that what is finished can be saved every few seconds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from time import monotonic

from ..results import Outcome

SAVE_INTERVAL_S = 8.0  # between two times that finished runs are saved
BATCH_S = 4.0  # that a batch should take; a single run may take longer
FIRST_RUNS = 16  # of a batch whose speed is not known


@dataclass
class Pace:
    """How long the runs of an estimator take.

    Attributes:
        seconds: For a run, in the last batch; None before the first.
    """

    seconds: float | None = None

    def batch(self, most: int) -> int:
        """Runs to the next batch, at least one."""
        if self.seconds is None:
            return min(most, FIRST_RUNS)
        return max(1, min(most, int(BATCH_S / max(self.seconds, 1e-9))))


@dataclass
class Saving:
    """Where finished runs of a part go before it is whole.

    Runs do not depend on each other (the conformance suite asks that of every estimator), so that it changes
    no number how many are done at once.

    Attributes:
        save: Takes what the runs from the first on have come to.
        pace: Of the estimator, on this set of beams.
    """

    save: Callable[[Outcome], None]
    pace: Pace
    _last: float = field(default_factory=monotonic)
    _begun: float = 0.0

    def begin(self, most: int) -> int:
        """Begin a batch: how many runs it should have, no more than `most`."""
        self._begun = monotonic()
        return self.pace.batch(most)

    def end(self, runs: int, so_far: Callable[[], Outcome | None]) -> None:
        """End a batch; what there is by now is saved if that has not been done for some seconds."""
        now = monotonic()
        self.pace.seconds = (now - self._begun) / runs
        if now - self._last < SAVE_INTERVAL_S:
            return
        outcome = so_far()
        if outcome is not None:
            self.save(outcome)
            self._last = monotonic()
