"""What a process is at, in a file that it shares with the one that watches it: telling it costs nothing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

STAGES = ("", "importing it", "building it", "init", "predict", "update", "estimate", "sample")
Note = Callable[[int, int], None]
At = Callable[[str, int], None]


def silent(*what: object) -> None:
    """Tell nobody."""


def during(stage: str, step: int) -> str:
    """A stage in words: "update() at measurement 3"; `step` counts from 0."""
    if stage not in STAGES[3:]:
        return stage
    return f"{stage}()" if stage == "init" else f"{stage}() at measurement {step + 1}"


@dataclass(frozen=True)
class Mark:
    """The `number`-th piece of work: `count` runs at once from `place` on, at a stage of a step."""

    number: int
    place: int
    count: int
    stage: int
    step: int

    @property
    def words(self) -> str:
        """The stage in words, or empty."""
        return during(STAGES[self.stage], self.step)


class Marks:
    """The file. One process writes, the other reads."""

    def __init__(self, path: Path | str, *, new: bool) -> None:
        mode: Any = "w+" if new else "r+"
        self._numbers = np.memmap(path, dtype=np.int64, mode=mode, shape=(len(fields(Mark)),))

    def note(self, place: int, count: int) -> None:
        """Begin a piece of work."""
        self._numbers[1:] = place, count, 0, 0
        self._numbers[0] += 1

    def at(self, stage: str, step: int = 0) -> None:
        """Go on to a stage of it."""
        self._numbers[3:] = STAGES.index(stage), step

    def read(self) -> Mark:
        """What was written last."""
        return Mark(*map(int, self._numbers))
