"""A separate process answers the question asked, within its limits, and leaves nothing behind."""

from __future__ import annotations

import ctypes
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest

from rangefix.evaluation.isolation import IsolatedProcess, Limit, Lost, Raised, begin_piece, begin_stage
from rangefix.evaluation.isolation.memory import resident_gb

SOON = Limit(0.5)
LATER = Limit(20.0)


def answer(what):
    return what, os.getpid()


def fork_and_answer(what):
    os.fork()
    begin_stage("building it")
    return what, os.getpid()


def fork_by_c_and_answer(what):
    ctypes.CDLL(None).fork()
    return what, os.getpid()


def hang(stage):
    begin_piece(3, 2)
    begin_stage(stage, 4)
    time.sleep(1000)


def hang_with_faulthandler_off():
    import faulthandler

    faulthandler.cancel_dump_traceback_later()
    time.sleep(1000)


def hang_holding_the_lock_of_python():
    ctypes.PyDLL(None).sleep(1000)


def crash():
    begin_stage("update", 0)
    ctypes.string_at(0)


def say_what_cannot_be_said():
    class Mute(Exception):
        def __str__(self):
            raise ZeroDivisionError

    raise Mute


def fail_at_length():
    raise ValueError("x" * 5_000_000)


def eat():
    begin_stage("update", 1)
    held = []
    while True:
        held.append(np.ones(5_000_000))
        time.sleep(0.02)


def eat_at_once():
    return np.empty(int(4e9 / 8)).size


def start_a_helper():
    """A process that does what it likes for long, and its number."""
    helper = os.fork()
    if helper == 0:
        time.sleep(1000)
        os._exit(0)
    return helper


def where_it_is_at():
    return os.getpid()


@pytest.fixture
def child():
    child = IsolatedProcess(memory_gb=1.0)
    yield child
    child.kill()


def is_there(process):
    try:
        return "zombie" not in Path(f"/proc/{process}/status").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return False


def goes(process, seconds=5.0):
    deadline = time.monotonic() + seconds
    while is_there(process) and time.monotonic() < deadline:
        time.sleep(0.05)
    return not is_there(process)


@pytest.mark.parametrize("fork", [fork_and_answer, fork_by_c_and_answer])
def test_a_copy_of_the_process_answers_nothing(child, fork):
    """The next questions get their own answers, from the same process."""
    _, process = child.ask(answer, (0,), LATER)
    assert child.ask(fork, (1,), LATER) == (1, process)
    time.sleep(0.3)
    assert [child.ask(answer, (number,), LATER) for number in range(2, 6)] == [
        (number, process) for number in range(2, 6)
    ]


def test_an_answer_to_an_earlier_question_is_passed_over(child):
    child._answers.put((0, True, "of an earlier question"))
    child._answers.put((7, True, "of none at all"))
    assert child.ask(answer, ("mine",), LATER)[0] == "mine"


def test_a_hang_names_stage_runs_and_line(child):
    child.ask(answer, (0,), LATER)
    with pytest.raises(Lost) as lost:
        child.ask(hang, ("predict",), Limit(0.1, each=0.2), where=True)
    assert lost.value.status == "timeout"
    assert re.fullmatch(
        r"the trial took longer than 0.4 s \(timeout_s\), in predict\(\) at measurement 5 "
        r"\(test_process.py, line \d+, in hang\)",
        lost.value.reason,
    )
    assert lost.value.stage[:2] == (3, 2)


@pytest.mark.parametrize("how", [hang_with_faulthandler_off, hang_holding_the_lock_of_python])
def test_neither_a_silent_hang_nor_one_in_c_is_waited_for(child, how, monkeypatch):
    """By the deadline of the parent, or by faulthandler, which needs no turn in Python."""
    monkeypatch.setattr("rangefix.evaluation.isolation.process.GRACE_S", 0.5)
    child.ask(answer, (0,), LATER)
    start = time.monotonic()
    with pytest.raises(Lost, match=r"it took longer than 0.5 s"):
        child.ask(how, (), SOON)
    assert time.monotonic() - start < 10


def test_a_crash_names_signal_and_line(child):
    with pytest.raises(Lost) as lost:
        child.ask(crash, (), LATER, where=True)
    assert re.fullmatch(
        r"update\(\) at measurement 1 ended the process \(SIGSEGV\) \(test_process.py, line \d+, in crash\)",
        lost.value.reason,
    )
    assert lost.value.ended


def test_messages_are_short_and_always_there(child):
    with pytest.raises(Raised) as raised:
        child.ask(fail_at_length, (), LATER)
    assert re.search(r"x \.\.\. \(5000000 characters\) \(test_process.py", raised.value.text)
    assert len(raised.value.text) < 2200
    with pytest.raises(Raised, match="a message of Mute that cannot be shown"):
        child.ask(say_what_cannot_be_said, (), LATER)


@pytest.mark.skipif(not resident_gb(os.getpid()), reason="this system does not tell how much memory is used")
def test_memory_is_watched(child):
    with pytest.raises(Lost) as lost:
        child.ask(eat, (), LATER)
    assert lost.value.status == "error"
    assert lost.value.reason == "update() at measurement 2 took more than 1 GB of memory (plugin_memory_gb)"
    assert not lost.value.ended


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not count data so")
def test_what_is_asked_for_at_once_is_refused(child):
    """And the process goes on."""
    with pytest.raises(Raised, match=r"allocate .* a plug-in may take 1 GB of memory \(plugin_memory_gb\)"):
        child.ask(eat_at_once, (), LATER)
    assert child.ask(answer, (1,), LATER)[0] == 1


PARENT = """
import time
from rangefix.evaluation.isolation import IsolatedProcess, Limit
from tests.evaluation.isolation.test_process import hang, start_a_helper, where_it_is_at
from threading import Thread
child = IsolatedProcess()
print(child.ask(where_it_is_at, (), Limit(60.0)), child.ask(start_a_helper, (), Limit(60.0)), flush=True)
child.ask(hang, ("update",), Limit(60.0)) if {busy} else time.sleep(60)
"""


@pytest.mark.parametrize("busy", [True, False])
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
def test_children_end_with_their_parent(how, busy, tmp_path):
    """And what a plug-in has started with them; no file is left."""
    shared = set(os.listdir("/dev/shm")) if Path("/dev/shm").is_dir() else set()
    environment = os.environ | {"TMPDIR": str(tmp_path), "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen(
        [sys.executable, "-c", PARENT.format(busy=busy)],
        stdout=subprocess.PIPE,
        env=environment,
        cwd=Path(__file__).parents[3],
    ) as parent:
        assert parent.stdout is not None
        started = list(map(int, parent.stdout.readline().split()))
        assert len(started) == 2
        assert all(map(is_there, started))
        parent.send_signal(how)
        parent.wait(timeout=10)
    assert all(map(goes, started))
    assert not list(tmp_path.iterdir())
    if shared:
        assert not [name for name in set(os.listdir("/dev/shm")) - shared if "rangefix" in name]


def test_one_that_is_done_with_leaves_nothing(monkeypatch, tmp_path):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    child = IsolatedProcess()
    process, helper = child.ask(where_it_is_at, (), LATER), child.ask(start_a_helper, (), LATER)
    assert not list(tmp_path.iterdir())
    child.kill()
    assert goes(process)
    assert goes(helper)
    assert not list(tmp_path.iterdir())
