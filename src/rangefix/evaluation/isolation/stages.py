"""Say which stage a process is at, in a file shared with the one that watches it: that costs nothing."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

STAGES = ("", "importing it", "building it", "init", "predict", "update", "estimate", "sample")
Note = Callable[[int, int], None]
Announce = Callable[[str, int], None]


def say_nothing(*what: object) -> None:
    """Announce nothing to anybody."""


def in_words(verb: str, step: int) -> str:
    """A stage in words, "update() at measurement 3"; `step` counts from 0."""
    if verb not in STAGES[3:]:
        return verb
    return f"{verb}()" if verb == "init" else f"{verb}() at measurement {step + 1}"


class Stage(NamedTuple):
    """What a process is doing.

    Attributes:
        number: Of the piece of work, counted from when the process began.
        place: The first of the runs that it does, counted from the first in the batch.
        at_once: How many runs it does at once; 0 for other work.
        verb: Place in STAGES of the method that is running.
        step: Its measurement, from 0.
    """

    number: int
    place: int
    at_once: int
    verb: int
    step: int

    @property
    def words(self) -> str:
        """The stage in words, or empty."""
        return in_words(STAGES[self.verb], self.step)


class StageFile:
    """The file. One process writes, the other reads."""

    def __init__(self, path: Path | str, *, new: bool) -> None:
        mode: Any = "w+" if new else "r+"
        self._numbers = np.memmap(path, dtype=np.int64, mode=mode, shape=(len(Stage._fields),))

    def note(self, place: int, count: int) -> None:
        """Begin a piece of work."""
        self._numbers[1:] = place, count, 0, 0
        self._numbers[0] += 1

    def announce(self, verb: str, step: int = 0) -> None:
        """Go on to a stage of it."""
        self._numbers[3:] = STAGES.index(verb), step

    def read(self) -> Stage:
        """What was written last."""
        return Stage(*map(int, self._numbers))
