"""Benchmark (d): a fix with any heading from a full scan, against numpy and against other exact ways.

9600 places x 1000 headings x 667 beams: 9.6 million states. The plain loop goes over headings and beams and
takes all places at once, from a table of its own in the order that suits it. It is timed on some of the
headings, all of which cost the same, and scaled up; moments are not asked of it. Ours is `update` and
`estimate`: all moments and the log evidence. Answers agree to 1e-6 nats before anything is timed.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from rangefix.compiled import in_threads
from rangefix.filters.point_mass.turning_kernels import scan_misfits

from . import full_scan
from .race import race

pytestmark = pytest.mark.benchmark

SHARE = 20  # headings on which the loop is timed
WHAT = "d: fix, 9.6 M states, 667 beams"
TOLERANCE = 1e-6  # nats


class Case:
    """The filter, a scan, and the ways to its log likelihood."""

    def __init__(self):
        problem = full_scan.make_problem()
        start = time.perf_counter()
        self.estimator = full_scan.make_filter(problem)
        self.building = time.perf_counter() - start
        self.rngs = [np.random.default_rng(0)]
        self.belief = self.estimator.init(problem.prior, self.rngs)
        self.measurement = full_scan.one_reading(problem)
        self.reading = self.measurement[0]
        self.beams = np.flatnonzero(~np.isnan(self.reading))
        self.cells = self.estimator.cells
        precision = np.where(np.isnan(self.reading), 0.0, 1 / full_scan.STD**2)
        self.used = self.cells.measured(self.reading, precision)
        ranges = self.cells.ranges
        self.by_direction = np.ascontiguousarray(ranges.ranges[:, 0, : ranges.period].T)
        self.headings = np.arange(0, 1000, 1000 // SHARE)

    def ours(self):
        return self.estimator.estimate(self.estimator.update(self.belief, self.measurement, self.rngs))

    def loop(self):
        """Log likelihoods of all places at some headings, up to a constant: (SHARE, C)."""
        logs = np.zeros((len(self.headings), self.by_direction.shape[1]))
        work = np.empty(logs.shape[1])
        for row, heading in zip(logs, self.headings, strict=True):
            for beam in self.beams:
                column = (heading + self.cells.ranges.shift[beam]) % 1000
                np.subtract(self.by_direction[column], self.reading[beam], out=work)
                work *= work
                row -= work
        logs *= 0.5 / full_scan.STD**2
        return logs

    def transform(self):
        return self.cells._correlate(self.used)

    def every_cell(self):
        misfits = np.empty((9600, 1000))
        in_threads(
            scan_misfits, len(misfits), misfits.size * len(self.beams), self.used, self.cells.ranges, misfits
        )
        return misfits


@pytest.fixture(scope="module")
def case():
    return Case()


def test_a_full_scan_with_any_heading(case, board):
    """(d) At least 100 times as fast as the loop, with the same log likelihoods and evidence."""
    assert case.estimator.grid.shape == (80, 120, 1000)
    logs = -case.transform()
    np.testing.assert_allclose(logs[:, case.headings].T, case.loop(), rtol=0, atol=TOLERANCE)
    np.testing.assert_allclose(logs, -case.every_cell(), rtol=0, atol=TOLERANCE)
    evidence = np.logaddexp.reduce(case.estimator.grid.log_mass + logs.ravel())
    evidence -= len(case.beams) * np.log(full_scan.STD * np.sqrt(2 * np.pi))
    np.testing.assert_allclose(case.ours().log_evidence, evidence, rtol=0, atol=TOLERANCE)
    best = race(
        5,
        {"ours": case.ours, "loop": case.loop, "transform": case.transform, "every cell": case.every_cell},
    )
    loop = best["loop"] * 1000 / SHARE
    board.add(WHAT, best["ours"], f"numpy loop, {SHARE} headings scaled", loop, target=100)
    board.add(WHAT, best["ours"], "FFT, likelihoods alone", best["transform"])
    board.add(WHAT, best["ours"], "every cell, compiled, likelihoods alone", best["every cell"])
    board.add("d: table built", case.building, "aim", 10.0)


def test_memory_of_a_full_scan(board):
    """(d) Peak memory of the whole process below the 4 GB that the option allows the table alone."""
    if not Path("/proc/self/clear_refs").exists():
        pytest.skip("reads the resident set from Linux's /proc")
    script = [sys.executable, str(Path(__file__).with_name("full_scan.py"))]
    answer = subprocess.run(script, capture_output=True, text=True, check=True)
    figures = json.loads(answer.stdout)
    board.add("d: peak memory, building", figures["building"], "limit", 4000, unit="MB", target=1, slack=1)
    board.add("d: peak memory, fix", figures["fix"], "limit", 4000, unit="MB", target=1, slack=1)
    board.add("d: resident before", figures["before"], "limit", 4000, unit="MB")
