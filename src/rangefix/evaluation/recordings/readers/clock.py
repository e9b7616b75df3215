"""Clocks of recordings that repeat, go back or jump: counted, and handled by one rule.

The rule: scans are taken in the order in which they stand in the file, whatever their times say, since
estimators need to know only how the robot moved in between, which odometry tells. A time that is not later
than one before it is of no use to find the true pose in another file: such a scan is filtered, and not
compared with the truth.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from ..log import Scan

REPEATED = "scans with the time of the one before"
BACK = "scans whose time goes back"
JUMPS = "gaps of more than ten times the usual time between scans"
TWICE = "scans that stand in the file twice in a row (left out)"
LONG_GAP = 10.0  # times the usual time between scans
LEAST_GAP_S = 1.0


def checked_times(scans: Iterator[Scan], tally: Counter[str]) -> Iterator[Scan]:
    """The same scans, with odd times counted and exact repetitions left out."""
    before: Scan | None = None
    usual = 0.0
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
        yield scan
    for kind in [kind for kind, count in tally.items() if not count]:
        del tally[kind]


def _same(scan: Scan, before: Scan) -> bool:
    at, was = scan.odometry, before.odometry
    where = at is was if at is None or was is None else at.tobytes() == was.tobytes()
    return where and scan.ranges_m.tobytes() == before.ranges_m.tobytes()
