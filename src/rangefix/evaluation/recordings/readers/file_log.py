"""What readers of files share: a path, what the file does not say, and scans whose times are checked."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ..log import Scan
from ..options import SAYS_ALL, ReadingOptions
from .clock import checked_times

EMPTY = "scans without beams, or whose angles are not those of beams (left out)"


@dataclass(frozen=True)
class FileLog(ABC):
    """A recording in a file; with a laser and notes it is a `Log`.

    Attributes:
        path: The file, or a folder.
        options: What it does not say.
    """

    path: Path
    options: ReadingOptions = SAYS_ALL

    def scans(self, tally: Counter[str] | None = None) -> Iterator[Scan]:
        """The scans, in the order of the file; see `Log`."""
        counts: Counter[str] = Counter() if tally is None else tally
        yield from checked_times(self._scans(counts), counts)

    @abstractmethod
    def _scans(self, tally: Counter[str]) -> Iterator[Scan]:
        """The scans as the file has them, with what is odd counted."""
