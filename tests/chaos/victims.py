"""Commands to be killed, and what they leave: processes, temporary files, shared memory, partial files."""

from __future__ import annotations

import os
import random
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).parents[2]
SHARED = Path("/dev/shm")
LEFT_S = 10.0  # until then all that a killed command has begun is gone
END_S = 60.0  # for a command that was told to end, on a machine that others use, too


@dataclass(frozen=True)
class Victim:
    """A command of rangefix with a folder for temporary files of its own, which its children inherit.

    Attributes:
        arguments: Of the command.
        temporary: The folder, empty or not there yet.
        results: A folder where no partial file may stay.
        begun: Numbers of the processes that it was, every time that it was begun.
    """

    arguments: tuple[str, ...]
    temporary: Path
    results: Path
    begun: list[int] = field(default_factory=list)

    def start(self) -> subprocess.Popen[str]:
        """Begin it, in a session of its own, as a terminal would."""
        process = subprocess.Popen(
            [sys.executable, "-m", "rangefix", *self.arguments],
            env=environment(self.temporary),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        self.begun.append(process.pid)
        return process

    def finish(self) -> float:
        """Let it come to its end undisturbed; the seconds that it takes."""
        begun = time.monotonic()
        with self.start() as process:
            assert process.stderr is not None
            said = process.stderr.read()
        assert process.returncode == 0, said
        assert not self.left()
        return time.monotonic() - begun

    def kill(self, how: signal.Signals, after: float) -> tuple[int, str]:
        """Begin it, send a signal after so many seconds, and wait; its exit code and what it said.

        Ctrl-C in a terminal reaches all processes of the group, the other signals this one alone.
        """
        with self.start() as process:
            try:
                process.wait(after)
            except subprocess.TimeoutExpired:
                self.begun.extend(processes_of(self.temporary))
                if how == signal.SIGINT:
                    os.killpg(process.pid, how)
                else:
                    process.send_signal(how)
            try:
                _, said = process.communicate(timeout=END_S)
            except subprocess.TimeoutExpired:
                process.kill()
                raise
        return process.returncode, said

    def left(self) -> list[str]:
        """What is left of it, at once if nothing is, else after ten seconds."""
        deadline = time.monotonic() + LEFT_S
        while (found := self._left()) and time.monotonic() < deadline:
            time.sleep(0.1)
        return found

    def _left(self) -> list[str]:
        return [
            *(f"process {number}: {command}" for number, command in processes_of(self.temporary).items()),
            *(f"file {file}" for file in self.temporary.rglob("*")),
            *(f"file {file}" for file in self.results.rglob("*.tmp")),
            *(f"shared memory {name}" for name in in_shared_memory(self.begun)),
        ]


def environment(temporary: Path) -> dict[str, str]:
    """Variables for a process that finds this package, with a folder of its own for temporary files."""
    temporary.mkdir(exist_ok=True)
    paths = os.pathsep.join([*filter(None, sys.path), str(ROOT)])
    return os.environ | {"PYTHONPATH": paths, "TMPDIR": str(temporary)}


def processes_of(temporary: Path) -> dict[int, str]:
    """Processes whose temporary files are in a folder, and what they run; but for zombies."""
    found = {}
    for process in Path("/proc").glob("[0-9]*"):
        try:
            named = f"TMPDIR={temporary}\0".encode() in (process / "environ").read_bytes()
            if named and "zombie" not in (process / "status").read_text():
                found[int(process.name)] = (process / "cmdline").read_text().replace("\0", " ")[:200]
        except OSError:
            continue
    return found


def in_shared_memory(processes: Iterable[int]) -> list[str]:
    """Names in /dev/shm that hold the number of one of the processes: others use it, too."""
    numbers = set(map(str, processes))
    names = [file.name for file in SHARED.iterdir()] if SHARED.is_dir() else []
    return [name for name in names if numbers & set(re.split(r"\D+", name))]


def moments(seed: str, longest: float) -> Iterable[float]:
    """When to send signals, s after the beginning: anywhere before the end of an undisturbed run."""
    draws = random.Random(seed)
    while True:
        yield draws.uniform(0.0, longest)


def files(folder: Path, pattern: str) -> dict[str, bytes]:
    """Names and contents of files in a folder."""
    return {
        str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob(pattern) if file.is_file()
    }
