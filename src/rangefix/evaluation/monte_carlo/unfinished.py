"""Parts that are not whole: the first runs of a block, saved now and then, so that stopping loses little."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from ..results import (
    FolderLayout,
    Part,
    if_valid,
    read_trials,
    remove,
    runs_of_part,
    trials_path,
    write_part,
)


class Place(NamedTuple):
    """Where a part belongs.

    Attributes:
        estimator: Label.
        beams: Label of the set of beams.
        first: Its first run.
        end: The run after its last.
    """

    estimator: str
    beams: str
    first: int
    end: int


@dataclass(frozen=True)
class Unfinished:
    """The unfinished parts of a folder of results.

    One is a part like any other, of fewer runs than the block that it begins, with a key of its own. It goes
    when the part is whole.
    """

    folder: Path
    plan: FolderLayout

    def read(self, place: Place) -> Part | None:
        """What is there of a part, of as many runs as possible; None if there is nothing sound."""
        for end in self._ends(place):
            part = if_valid(read_trials, self.folder, self.plan, *place._replace(end=end))
            if part is not None:
                return part
        return None

    def write(self, place: Place, part: Part) -> None:
        """Save the first runs of a part in place of fewer.

        Raises:
            ResultsError: If that cannot be written.
        """
        now = place._replace(end=place.first + len(part["status"]))
        older = self._ends(place)
        write_part(trials_path(self.folder, *now), part, self.plan.key(*now))
        self._remove(place, [end for end in older if end != now.end])

    def remove(self, place: Place) -> None:
        """Remove what is there of a part that is whole now, or is to be made anew."""
        self._remove(place, self._ends(place))

    def _ends(self, place: Place) -> list[int]:
        """The ends of what is there of a part, the last first."""
        found = map(runs_of_part, trials_path(self.folder, *place).parent.glob("*.npz"))
        ends = (end for first, end in filter(None, found) if first == place.first and end < place.end)
        return sorted(ends, reverse=True)

    def _remove(self, place: Place, ends: list[int]) -> None:
        for end in ends:
            remove(trials_path(self.folder, *place._replace(end=end)))
