"""Poses over time, read forward from a stream and asked at the times of scans: odometry, or the truth."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter, deque
from collections.abc import Iterator

import numpy as np

from ....arrays import Array, wrap
from .clock import RESET_S

KEPT_S = 5.0  # of poses before the last time that was asked for
SOON_S = 60.0  # of poses in which the stream's clock goes back, too, if it has
HELD_S = 0.2  # that the first and the last pose stand for more than themselves


class Track:
    """Poses at times that are asked for in about the order of the stream, interpolated between two of them.

    Where the clock of the stream goes back by more than a second it has begun anew; times that are asked for
    go on in the new part as soon as they have gone back likewise. Smaller steps back are left out. Times that
    go back although the stream does not, as by one wrong stamp, are looked for among the poses that are kept.

    Args:
        poses: Times (s) and poses x1, x2 (m), heading (rad), as they come.
        longest_gap_s: Between poses farther apart nothing is known, s.
        what: What these poses are, in words.
        tally: Where those that are left out are counted.
    """

    def __init__(
        self,
        poses: Iterator[tuple[float, Array]],
        longest_gap_s: float = np.inf,
        what: str = "poses by odometry",
        tally: Counter[str] | None = None,
    ) -> None:
        self._poses, self._gap = poses, longest_gap_s
        self._what, self._tally = what, Counter[str]() if tally is None else tally
        self._times: deque[float] = deque()
        self._known: deque[Array] = deque()
        self._next_part: tuple[float, Array] | None = None
        self._asked = -np.inf  # the last time that this part knew

    def at(self, time: float, ahead_s: float = 0.0) -> Array | None:
        """The pose at a time, (3,); None where there is none, or the poses about it are too far apart.

        Args:
            time: By the clock of the stream, s.
            ahead_s: How long after it; that the next time lies before this says nothing of the clock.
        """
        if time < self._asked - RESET_S:
            self._begin_anew(time)
        while (not self._times or self._times[-1] < time + ahead_s) and self._read():
            pass
        found = self._interpolated(time + ahead_s)
        if found is not None:
            self._asked = time
            while len(self._times) > 1 and self._times[1] < time - KEPT_S:
                self._times.popleft()
                self._known.popleft()
        return found

    def _read(self) -> bool:
        """Take the next pose; whether there is one in this part."""
        if self._next_part is not None:
            return False
        for time, pose in self._poses:
            if self._times and time < self._times[-1] - RESET_S:
                self._next_part = time, pose
                return False
            if not self._times or time > self._times[-1]:
                self._times.append(time)
                self._known.append(pose)
                return True
            if time < self._times[-1]:
                self._tally[f"{self._what} whose time goes back (left out)"] += 1
            elif not np.array_equal(pose, self._known[-1]):
                self._tally[f"{self._what} at the time of the one before, but elsewhere (left out)"] += 1
        return False

    def _begin_anew(self, time: float) -> None:
        """Go on in the next part; in this one if none comes, or none soon and this one knows the time."""
        known = bool(self._times) and time >= self._times[0]
        while not (known and self._times[-1] > self._asked + SOON_S) and self._read():
            pass
        if self._next_part is not None:
            self._times, self._known = deque([self._next_part[0]]), deque([self._next_part[1]])
            self._next_part, self._asked = None, -np.inf

    def _interpolated(self, time: float) -> Array | None:
        if not self._times:
            return None
        place = bisect_right(self._times, time)
        if place == 0:
            return self._known[0] if self._times[0] - time <= HELD_S else None
        before, start = self._times[place - 1], self._known[place - 1]
        if before == time:
            return start
        if place == len(self._times):
            return start if time - before <= HELD_S else None
        after, end = self._times[place], self._known[place]
        if after - before > self._gap:
            return None
        step = end - start
        step[2] = wrap(step[2])
        found = start + (time - before) / (after - before) * step
        found[2] = wrap(found[2])
        return np.asarray(found)
