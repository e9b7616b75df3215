"""Fixtures of the benchmarks, and the table at their end."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from rangefix.filters import Gaussian, Problem, Rangefinder, Stationary, Uniform, position_space
from rangefix.maps import RectangularRoom

from .scoreboard import Scoreboard

BOARD = Scoreboard()


@pytest.fixture
def board():
    """Where comparisons are noted for the table."""
    return BOARD


@pytest.fixture(autouse=True)
def one_blas_thread():
    """BLAS on one thread: it gains nothing from two here, and its idle threads spin in the others' way."""
    with threadpool_limits(1, user_api="blas"):
        yield


@pytest.fixture(scope="session")
def problem():
    """The paper's room of 4 x 6 m and three beams, read to 0.05 m."""
    room, space = RectangularRoom(width=4.0, length=6.0), position_space()
    sensor = Rangefinder(room, bearings=np.deg2rad([326.3, 0.0, 33.7]), noise=Gaussian(std=0.05), space=space)
    return Problem(space, Stationary(space), sensor, Uniform(room, space))


def pytest_runtest_logreport(report):
    if report.skipped and isinstance(report.longrepr, tuple):
        BOARD.skipped[report.nodeid.rpartition("::")[2]] = report.longrepr[2].removeprefix("Skipped: ")


@pytest.hookimpl(trylast=True)
def pytest_terminal_summary(terminalreporter, config):
    if not BOARD.rows:
        return
    path = Path(os.environ.get("BENCH_JSON", "results/bench.json"))
    BOARD.save(path)
    terminalreporter.section("rangefix against others")
    for line in BOARD.lines():
        terminalreporter.write_line(line)
    terminalreporter.write_line(f"Written to {path}")
