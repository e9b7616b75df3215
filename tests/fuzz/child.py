"""A process that calls the function of the command line again and again, and tells what came of each call."""

from __future__ import annotations

import faulthandler
import io
import json
import os
import resource
import sys
import tempfile
import time
import traceback
from pathlib import Path

from rangefix.cli import main

MEMORY_LIMIT = 4 << 30  # bytes of data: what takes more fails here, and not the machine


def answer(arguments: list[str], said: io.BufferedRandom) -> dict[str, object]:
    """Exit code, what was said, traceback, CPU seconds, peak and growth of resident memory (MB) of one call.

    The seconds are those of the thread that calls and of the processes that it started and that have ended:
    other programs of the machine make no difference to them.
    """
    Path("/proc/self/clear_refs").write_text("5")  # the peak counts from here
    said.seek(0)
    said.truncate()
    begun, before, code, error = _seconds(), _own_peak_mb(), 0, ""
    try:
        main(arguments)
    except SystemExit as stopped:
        code = stopped.code if isinstance(stopped.code, int) else 99
    except BaseException:
        error = traceback.format_exc()
    sys.stdout.flush()
    sys.stderr.flush()
    seconds = _seconds() - begun
    said.seek(0)
    return {
        "code": code,
        "error": error,
        "said": said.read().decode(errors="replace")[:100_000],
        "seconds": seconds,
        "peak_mb": max(_own_peak_mb(), _peak_mb_of_children()),
        "grown_mb": _own_peak_mb() - before,
    }


def _seconds() -> float:
    of_children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.thread_time() + of_children.ru_utime + of_children.ru_stime


def _own_peak_mb() -> float:
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line for line in lines if "VmHWM" in line).split()[1]) / 1024


def _peak_mb_of_children() -> float:
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024  # of the largest so far


def answer_all() -> None:
    """Read lists of arguments, a line each, and write what came of them, until there are no more."""
    questions, answers = os.fdopen(os.dup(0), "r"), os.fdopen(os.dup(1), "w")
    said = tempfile.TemporaryFile()  # noqa: SIM115 (open until the process ends)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    os.dup2(said.fileno(), 2)
    faulthandler.enable(said)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_LIMIT, MEMORY_LIMIT))
    for line in questions:
        print(json.dumps(answer(json.loads(line), said)), file=answers, flush=True)


if __name__ == "__main__":
    answer_all()
