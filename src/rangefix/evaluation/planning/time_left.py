"""How long a search for beams goes on, told while it runs: by how long its parts have taken."""

from __future__ import annotations

from dataclasses import dataclass
from time import monotonic

WHOLE_CHOICE = 4.0  # times what the first truths of a choice take: more follow, for the best candidates
BRIEF_S = 10.0  # what is left is told from here on


@dataclass
class TimeLeft:
    """How many choices of a beam are to be made, and since when.

    Attributes:
        least, most: How many are left, as far as is known; a search ends where nothing is bettered.
        done: How many took time; others were known.
        each: Seconds that one takes.
        began: When the first began, s.
    """

    least: int = 0
    most: int = 0
    done: int = 0
    each: float | None = None
    began: float = 0.0

    def begin(self, least: int, most: int) -> None:
        """A search begins, of so many choices."""
        self.least, self.most, self.done, self.each, self.began = least, most, 0, None, monotonic()

    def expect(self, least: int, most: int) -> None:
        """So many choices are left, as is known now."""
        self.least, self.most = least, most

    def guess(self) -> bool:
        """Take the first truths of the first choice for a measure; False if there is a better one already."""
        if self.done or self.each is not None:
            return False
        self.each = WHOLE_CHOICE * (monotonic() - self.began)
        return True

    def made(self, searched: bool = True) -> None:
        """A choice has been made, or was known."""
        self.least, self.most = max(self.least - 1, 0), max(self.most - 1, 0)
        if searched:
            self.done += 1
            self.each = (monotonic() - self.began) / self.done

    def told(self, text: str) -> str:
        """What is being done, with the time that has passed and what may be left, where that is long."""
        if self.each is None or self.each * self.most < BRIEF_S:
            return text
        left, more = in_words(self.each * max(self.least, 1)), in_words(self.each * self.most)
        span = left if left == more else f"{left} to {more}"
        return f"{text}; {in_words(monotonic() - self.began)} so far, some {span} left"


def in_words(seconds: float) -> str:
    """A time, roughly: "5 s", "40 s", "3 min", "2 h"."""
    if seconds < 95:
        return f"{seconds:.0f} s" if seconds < 10 else f"{10 * round(seconds / 10)} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.0f} h"
