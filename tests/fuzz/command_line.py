"""The command line in a child process that lives on from call to call, and what may come of a call."""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

MAX_SECONDS, MAX_MB = 10.0, 600.0
MAX_LINES, MAX_LINE = 21, 4000  # of mistakes, and letters of each
WAIT_S = 120.0  # for an answer, on a machine that others use too; what takes so long is a hang
FINE, BAD_INPUT = 0, 2


SAID = ("rangefix: ",)  # how a line of a mistake begins


@dataclass(frozen=True)
class Outcome:
    """What came of a call: see `child.answer`."""

    code: int
    error: str
    said: str
    seconds: float
    peak_mb: float
    grown_mb: float

    def fault(self, codes: tuple[int, ...] = (FINE, BAD_INPUT)) -> str:
        """What should not have come of it, or ""."""
        lines = self.said.splitlines()
        if self.error:
            return f"traceback: {self.error}"
        if self.code not in codes:
            return f"exit code {self.code}: {self.said[-2000:]}"
        if self.code == BAD_INPUT and not lines:
            return "exit code 2 without a word"
        if stray := [line for line in lines if line and not line.startswith(SAID)]:
            return f"said: {stray[:5]}"
        if self.code == BAD_INPUT and (len(lines) > MAX_LINES or max(map(len, lines)) > MAX_LINE):
            return f"{len(lines)} lines of up to {max(map(len, lines))} letters"
        if self.seconds > MAX_SECONDS:
            return f"{self.seconds:.1f} s of CPU"
        return f"{self.peak_mb:.0f} MB" if self.peak_mb > MAX_MB else ""


class CommandLine:
    """Calls in a child process; a child that ends or hangs is replaced."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._child = self._start()

    def __enter__(self) -> CommandLine:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: object, where: TracebackType | None) -> None:
        self._end()

    def __call__(self, *arguments: str) -> Outcome:
        """What comes of a command with the given arguments."""
        assert self._child.stdin is not None
        assert self._child.stdout is not None
        self._child.stdin.write(json.dumps(arguments) + "\n")
        self._child.stdin.flush()
        there, _, _ = select.select([self._child.stdout], [], [], WAIT_S)
        line = self._child.stdout.readline() if there else ""
        if line:
            return Outcome(**json.loads(line))
        code = self._child.poll() if there else None
        self._end()
        self._child = self._start()
        words = "no answer" if not there else f"the process ended with {code}"
        return Outcome(99, f"{words} after {' '.join(arguments)}", "", WAIT_S, 0.0, 0.0)

    def _start(self) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-m", "tests.fuzz.child"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=self._folder,
            env=os.environ | {"PYTHONPATH": os.pathsep.join([*filter(None, sys.path), str(_ROOT)])},
        )

    def _end(self) -> None:
        self._child.kill()
        for pipe in (self._child.stdin, self._child.stdout):
            if pipe is not None:
                pipe.close()
        self._child.wait()


_ROOT = Path(__file__).parents[2]
