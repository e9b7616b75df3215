"""Clocks of recordings that repeat, go back or jump: counted, and handled by one rule.

The rule: scans are taken in the order in which they stand in the file, whatever their times say, since
estimators need to know only how the robot moved in between, which odometry tells. A time that is not later
than one before it is of no use to find the true pose in another file: such a scan is filtered, and not
compared with the truth. Nor is any scan after a clock that was set back by more than a second: times have
become others than those of the other file.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ..log import Scan

REPEATED = "scans with the time of the one before"
BACK = "scans whose time goes back"
JUMPS = "gaps of more than ten times the usual time between scans"
TWICE = "scans that stand in the file twice in a row (left out)"
SET_BACK = "scans after the clock was set back (not compared with poses that are found by time)"
RESET_S = 1.0  # a clock that goes back by more has been set
LONG_GAP = 10.0  # times the usual time between scans
LEAST_GAP_S = 1.0


class Clock:
    """A clock that is read again and again: whether it was set back.

    Times that go back for a while, and then on as if they had not, were stamped wrongly; so was one alone
    that is ahead of those about it.

    Attributes:
        is_set_back: Whether it came by itself to times that it had shown before, and went on from there.
    """

    def __init__(self) -> None:
        self.is_set_back = False
        self._latest = self._second = self._last = -np.inf
        self._depth = 0.0  # s, by how much times have gone back since the latest

    def went_back(self, time_s: float) -> bool:
        """Read it once more: whether it was set back, or goes back by more than a second now."""
        step, self._last = time_s - self._last, time_s
        if time_s > self._latest:
            self.is_set_back |= self._depth > RESET_S and step < self._depth
            self._second, self._latest, self._depth = self._latest, time_s, 0.0
        elif time_s <= self._second:
            self._depth = max(self._depth, self._latest - time_s)
        return self.is_set_back or self._depth > RESET_S


def checked_times(scans: Iterator[Scan], tally: Counter[str]) -> Iterator[Scan]:
    """The same scans, with odd times counted and exact repetitions left out."""
    before: Scan | None = None
    usual, clock = 0.0, Clock()
    for scan in scans:
        if before is not None:
            step = scan.time_s - before.time_s
            if step == 0 and _same(scan, before):
                tally[TWICE] += 1
                continue
            tally[REPEATED] += step == 0
            tally[BACK] += step < 0
            tally[JUMPS] += bool(usual) and step > max(LONG_GAP * usual, LEAST_GAP_S)
            if step > 0:
                usual = step if not usual else usual + 0.05 * (min(step, LONG_GAP * usual) - usual)
        before = scan
        went_back = clock.went_back(scan.time_s)
        tally[SET_BACK] += clock.is_set_back
        yield replace(scan, clock_went_back=True) if went_back else scan
    for kind in [kind for kind, count in tally.items() if not count]:
        del tally[kind]


def _same(scan: Scan, before: Scan) -> bool:
    at, was = scan.odometry, before.odometry
    where = at is was if at is None or was is None else at.tobytes() == was.tobytes()
    return where and scan.ranges_m.tobytes() == before.ranges_m.tobytes()
