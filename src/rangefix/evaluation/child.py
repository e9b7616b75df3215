"""A process that answers questions about one estimator, and is killed when an answer takes too long."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import tempfile
import weakref
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from time import monotonic
from typing import IO, Any

import numpy as np

from .guarded import receive, send

START = """
import sys
sys.path[:] = sys.argv[2:]
from rangefix.evaluation.guarded import main
main(sys.argv[1])
"""
DOING = {"run": "the trial", "build": "building it"}


class Stopped(Exception):
    """The process was killed or ended while it did `count` runs from `place` on; 0 for other work."""

    def __init__(self, status: str, reason: str, place: int, count: int) -> None:
        super().__init__(reason)
        self.status, self.reason, self.place, self.count = status, reason, place, count


class Refused(Exception):
    """What an estimator raised, as one line."""


class Child:
    """One process. What it is at is read from a file that both map, so that telling it costs nothing."""

    def __init__(self) -> None:
        folder = tempfile.mkdtemp(prefix="rangefix-")
        marks = Path(folder) / "marks"
        self._marks = np.memmap(marks, dtype=np.int64, mode="w+", shape=(3,))
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", START, str(marks), *sys.path],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C is for us alone
        )
        self._answers: SimpleQueue[Any] = SimpleQueue()
        assert self._process.stdout is not None
        Thread(target=_listen, args=(self._process.stdout, self._answers), daemon=True).start()
        self.kill = weakref.finalize(self, _kill, self._process, folder)

    def ask(self, verb: str, arguments: tuple[Any, ...], allowed: Callable[[int], float]) -> Any:
        """The answer; `allowed` says how long the process may be at a number of runs at once, s.

        Raises:
            Stopped: If it took longer, or ended; there is no process then.
            Refused: If the estimator raised.
        """
        assert self._process.stdin is not None
        seen, since = self._seen(), monotonic()
        with suppress(OSError):  # if it has ended, the answer will say so
            send(self._process.stdin, (verb, arguments))
        while True:
            limit = allowed(seen[2])
            try:
                answer = self._answers.get(timeout=min(0.2, limit / 5))
            except Empty:
                now, latest = monotonic(), self._seen()
                if latest != seen:
                    seen, since = latest, now
                elif now - since > limit:
                    self.kill()
                    reason = f"{DOING.get(verb, 'it')} took longer than {limit:g} s"
                    raise Stopped("timeout", reason, *seen[1:]) from None
                continue
            if answer is None:
                self.kill()
                reason = f"{DOING.get(verb, 'it')} ended the process ({_end(self._process.returncode)})"
                raise Stopped("error", reason, *self._seen()[1:])
            fine, value = answer
            if not fine:
                raise Refused(value)
            return value

    def _seen(self) -> tuple[int, int, int]:
        number, place, count = map(int, self._marks)
        return number, place, count


def _listen(pipe: IO[bytes], answers: SimpleQueue[Any]) -> None:
    with pipe, suppress(EOFError, OSError, ValueError):
        while True:
            answers.put(receive(pipe))
    answers.put(None)


def _kill(process: subprocess.Popen[bytes], folder: str) -> None:
    process.kill()
    process.wait()
    shutil.rmtree(folder, ignore_errors=True)
    if process.stdin is not None:
        with suppress(OSError):
            process.stdin.close()


def _end(code: int) -> str:
    with suppress(ValueError):
        return signal.Signals(-code).name if code < 0 else f"exit code {code}"
    return f"signal {-code}"
