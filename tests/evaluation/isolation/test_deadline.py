"""Work that takes too long in this process is ended."""

from __future__ import annotations

import signal
import threading
import time

import pytest

from rangefix.evaluation.isolation.deadline import TookTooLong, deadline


def work_for(seconds):
    start = time.monotonic()
    while time.monotonic() < start + seconds:
        pass


def test_work_is_ended_when_its_time_is_over():
    start = time.monotonic()
    with pytest.raises(TookTooLong, match=r"more than 0\.05 s"), deadline(0.05):
        work_for(5)
    assert time.monotonic() < start + 5


def test_work_in_time_is_left_alone_and_nothing_remains():
    before = signal.getsignal(signal.SIGALRM)
    with deadline(0.05):
        pass
    time.sleep(0.1)
    assert signal.getsignal(signal.SIGALRM) is before
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


def test_an_alarm_of_somebody_else_stays():
    rung = []
    before = signal.signal(signal.SIGALRM, lambda *_: rung.append(1))
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.05)
        with deadline(0.01):
            time.sleep(0.1)
    finally:
        signal.signal(signal.SIGALRM, before)
    assert rung == [1]


def test_in_another_thread_there_is_no_limit():
    done = []

    def work():
        with deadline(0.01):
            time.sleep(0.05)
            done.append(1)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert done == [1]
