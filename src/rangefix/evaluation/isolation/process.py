"""A separate process that answers questions, and is killed when an answer takes too long."""

from __future__ import annotations

import importlib
import io
import os
import pickle
import shutil
import signal
import subprocess
import sys
import tempfile
import weakref
from collections.abc import Callable
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from time import monotonic
from typing import IO, Any

from .child_main import ANSWER, WHERE, receive, send
from .stages import StageFile

CHILD_CODE = """
import sys
sys.path[:] = sys.argv[2:]
from rangefix.evaluation.isolation.child_main import main
main(sys.argv[1])
"""
IMPORT_TIMEOUT_S = 60.0  # s for a process to begin at all, on a machine however busy
MAX_PRINTED_BYTES = 2000  # of what a process prints; the rest is dropped
WHEREABOUTS_TIMEOUT_S = 2.0  # s for a process that takes too long to say where it is


class Lost(Exception):
    """The process was killed, or ended, while it did `count` runs from `place` on; 0 for other work."""

    def __init__(self, status: str, reason: str, place: int = 0, count: int = 0) -> None:
        super().__init__(reason)
        self.status, self.reason, self.place, self.count = status, reason, place, count


class Raised(Exception):
    """What was raised there, as one line; `kind` is the name of its type."""

    def __init__(self, kind: str, text: str) -> None:
        super().__init__(f"{kind}: {text}" if kind else text)
        self.kind, self.text = kind, text


class IsolatedProcess:
    """A separate process. Which stage it is at is read from a file that both map."""

    def __init__(self) -> None:
        folder = tempfile.mkdtemp(prefix="rangefix-")
        stage_file = Path(folder) / "stage"
        self._stages = StageFile(stage_file, new=True)
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", CHILD_CODE, str(stage_file), *sys.path],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C is for us alone
        )
        self._answers: SimpleQueue[Any] = SimpleQueue()
        assert self._process.stdout is not None
        assert self._process.stderr is not None
        printing = Thread(target=_pass_on, args=(self._process.stderr,), daemon=True)
        printing.start()
        Thread(target=_listen, args=(self._process.stdout, self._answers), daemon=True).start()
        self.kill = weakref.finalize(self, _kill, self._process, folder, printing)

    def ask(
        self, verb: str, arguments: tuple[Any, ...], allowed: Callable[[int], float], where: bool = False
    ) -> Any:
        """The answer; `allowed` says how long the process may be at a number of runs at once, s.

        Args:
            verb, arguments: See `child_main.py`.
            allowed: Runs at once -> seconds.
            where: Whether to ask for the line at which it hangs, which need not be the same every time.

        Raises:
            Lost: If it took longer, or ended; there is no process then.
            Raised: If something was raised there.
        """
        assert self._process.stdin is not None
        stage, since, begun = self._stages.read(), monotonic(), False
        with suppress(OSError):  # if it has ended, the answer will say so
            send(self._process.stdin, (verb, arguments))
        while True:
            limit = allowed(stage.at_once) if begun else max(IMPORT_TIMEOUT_S, allowed(stage.at_once))
            try:
                kind, answer = self._answers.get(timeout=min(0.2, limit / 5))
            except Empty:
                now, latest = monotonic(), self._stages.read()
                if latest.number != stage.number:
                    stage, since, begun = latest, now, True
                elif now - since > limit:
                    raise self._too_long(limit, where) from None
                continue
            if kind != ANSWER:
                raise self._ended()
            fine, value = answer
            if not fine:
                raise Raised(*value)
            return value

    def _too_long(self, limit: float, where: bool) -> Lost:
        stage, line = self._stages.read(), ""
        if where:
            assert self._process.stdin is not None
            with suppress(OSError, Empty):
                send(self._process.stdin, (WHERE, ()))
                kind, answer = self._answers.get(timeout=WHEREABOUTS_TIMEOUT_S)
                line = answer if kind == WHERE else ""
        self.kill()
        if stage.at_once:
            reason = f"the trial took longer than {limit:g} s (timeout_s), in {stage.words or 'no method'}"
        else:
            reason = f"{stage.words or 'it'} took longer than {limit:g} s"
        return Lost("timeout", reason + line, stage.place, stage.at_once)

    def _ended(self) -> Lost:
        stage = self._stages.read()
        self.kill()
        reason = f"{stage.words or 'it'} ended the process ({_end(self._process.returncode)})"
        return Lost("error", reason, stage.place, stage.at_once)


def _listen(pipe: IO[bytes], answers: SimpleQueue[Any]) -> None:
    with pipe, suppress(EOFError, OSError, ValueError):
        while True:
            answers.put(receive(pipe))
    answers.put(("end", None))


def _pass_on(pipe: IO[bytes]) -> None:
    """Show the first that a process prints, and swallow the rest, so that it goes on."""
    left = MAX_PRINTED_BYTES
    with pipe, suppress(OSError, ValueError):
        while content := pipe.read1(65536):  # type: ignore[attr-defined]
            if left > 0:
                text = content[:left].decode(errors="replace")
                more = "\n(and so on: the rest of what it prints is not shown)\n"
                print(text + (more if len(content) > left else ""), end="", file=sys.stderr, flush=True)
            left -= len(content)


def _kill(process: subprocess.Popen[bytes], folder: str, printing: Thread) -> None:
    with suppress(OSError, AttributeError):  # what it has started itself goes, too
        os.killpg(process.pid, signal.SIGKILL)
    process.kill()
    process.wait()
    printing.join(timeout=1.0)  # its last words
    shutil.rmtree(folder, ignore_errors=True)
    if process.stdin is not None:
        with suppress(OSError):
            process.stdin.close()


def _end(code: int) -> str:
    with suppress(ValueError):
        return signal.Signals(-code).name if code < 0 else f"exit code {code}"
    return f"signal {-code}"


def to_pickle(thing: object, *, cached: bool = True) -> bytes:
    """The thing by cloudpickle, which joblib brings: functions of a script or notebook included.

    Args:
        thing: What is to be pickled.
        cached: Whether what cached properties hold goes along. Without it the bytes say what a thing is, and
            not what it has been asked before.
    """
    try:
        module = importlib.import_module("cloudpickle")
    except ModuleNotFoundError:
        module = importlib.import_module("joblib.externals.cloudpickle")
    if cached:
        content: bytes = module.dumps(thing)
        return content

    class Pickler(module.CloudPickler):  # type: ignore[misc, name-defined]
        def reducer_override(self, thing: Any) -> Any:
            parts = getattr(thing, "__dict__", {})
            held = [name for name in parts if isinstance(getattr(type(thing), name, None), cached_property)]
            if not held:
                return super().reducer_override(thing)
            how, arguments, state, *rest = thing.__reduce_ex__(pickle.DEFAULT_PROTOCOL)
            return how, arguments, {name: state[name] for name in state if name not in held}, *rest

    file = io.BytesIO()
    Pickler(file).dump(thing)
    return file.getvalue()
