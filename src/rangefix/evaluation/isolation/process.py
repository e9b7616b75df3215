"""A separate process that may hang or crash, both sides of it: one asks, the other answers.

Questions and answers are pickles over pipes and carry the number of the question, so that what is left over
from an earlier one, or comes from a copy of the process, is never taken for an answer. Before each piece of
work the child notes which it is, in a file without a name that both have open: that wakes nobody up. It lets
`faulthandler` end it, and write where it was, when a piece takes too long; the parent keeps a deadline of its
own, and watches the memory. The child ends as soon as its standard input does, and that ends with the parent.
"""

from __future__ import annotations

import faulthandler
import os
import pickle
import re
import signal
import subprocess
import sys
import tempfile
import weakref
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, SimpleQueue
from threading import Thread
from time import monotonic
from typing import IO, Any, NamedTuple

from ...errors import cut, one_line, printable
from ...filters.plugin_line import innermost, plugin_line
from .memory import default_memory_gb, limit_in_words, resident_gb

CHILD_CODE = """
import sys
sys.path[:] = sys.argv[3:]
from rangefix.evaluation.isolation.process import answer_questions
answer_questions(int(sys.argv[1]), float(sys.argv[2]))
"""
IMPORT_TIMEOUT_S = 60.0  # for a process to begin at all, on a machine however busy
TIMER_SLACK = 0.25  # of a limit: how much later faulthandler may end it, which takes 0.1 ms to set anew
GRACE_S = 2.0  # beyond that, until a child is killed that does not end by itself
LOOK_EVERY_S = 0.1  # at whether it lives, and at its memory
MAX_PRINTED_BYTES = 2000  # of what a process prints; the rest is dropped
NOTE_BYTES = 512  # at the head of the file; what faulthandler writes comes after
MAX_DUMP_BYTES = 1 << 20
HEADROOM_GB = 2.0  # of data, used or not, beyond the limit of resident memory


class Limit(NamedTuple):
    """How long a piece of work may take, s: `seconds`, or `each` for each of its runs if that is longer."""

    seconds: float
    each: float = 0.0

    def over(self, runs: int) -> float:
        """Seconds for a piece of so many runs at once."""
        return max(self.seconds, runs * self.each)


class Stage(NamedTuple):
    """What a process is doing.

    Attributes:
        place: The first of the runs that it does, counted from the first in the batch.
        at_once: How many runs it does at once; 0 for other work.
        verb: The method that is running, or other work in words.
        step: Its measurement, from 0.
    """

    place: int = 0
    at_once: int = 0
    verb: str = ""
    step: int | None = None

    @property
    def words(self) -> str:
        """The stage in words, "update() at measurement 3"."""
        if self.step is None:
            return self.verb
        return f"{self.verb}()" + (f" at measurement {self.step + 1}" if self.verb != "init" else "")


Watch = Callable[[Stage], None]  # is told what is being done


def counted_from(start: int, watch: Watch | None) -> Watch | None:
    """What is told the same, with runs counted from one that is `start` earlier."""
    if watch is None:
        return None
    return lambda stage: watch(stage._replace(place=start + stage.place))


class Lost(Exception):
    """The process was killed, or ended, at a stage; `ended` if by itself, or by somebody else."""

    def __init__(self, status: str, reason: str, stage: Stage, *, ended: bool = False) -> None:
        super().__init__(reason)
        self.status, self.reason, self.stage, self.ended = status, reason, stage, ended


class Raised(Exception):
    """What was raised there, as one line; `kind` is the name of its type."""

    def __init__(self, kind: str, text: str) -> None:
        super().__init__(f"{kind}: {text}" if kind else text)
        self.kind, self.text = kind, text


class IsolatedProcess:
    """A separate process, started at once.

    Args:
        memory_gb: Resident memory that it may take, GB; half of the machine's, at most 8, unless given.
    """

    def __init__(self, memory_gb: float | None = None) -> None:
        self._memory_gb = default_memory_gb() if memory_gb is None else memory_gb
        file = tempfile.TemporaryFile()  # noqa: SIM115 (`_kill` closes it)
        file.seek(NOTE_BYTES)
        handle = self._file = file.fileno()
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", CHILD_CODE, str(handle), str(self._memory_gb), *sys.path],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            pass_fds=[handle],
            start_new_session=True,  # Ctrl-C is for us alone
        )
        assert self._process.stdout is not None
        assert self._process.stderr is not None
        self._number, self._answers = 0, SimpleQueue[Any]()
        self._listening = Thread(target=_listen, args=(self._process.stdout, self._answers), daemon=True)
        printing = Thread(target=_pass_on, args=(self._process.stderr,), daemon=True)
        self._listening.start()
        printing.start()
        self.kill = weakref.finalize(self, _kill, self._process, printing, file)

    def ask(
        self,
        function: Callable[..., Any],
        arguments: tuple[Any, ...],
        limit: Limit,
        where: bool = False,
        watch: Watch | None = None,
    ) -> Any:
        """What a function of this package returns there.

        Args:
            function, arguments: What to call.
            limit: How long each of its pieces of work may take.
            where: Whether to say at which line it was lost, which need not be the same every time.
            watch: Told now and then what it is doing.

        Raises:
            Lost: If it took too long or too much, or ended; there is no process then.
            Raised: If something was raised there.
        """
        self._number += 1
        content = pickle.dumps((self._number, function, arguments, limit))
        Thread(target=_write, args=(self._process.stdin, content), daemon=True).start()
        piece, since, ended = 0, monotonic(), False
        while True:
            with suppress(Empty):
                number, fine, value = self._answers.get(timeout=LOOK_EVERY_S)
                if number != self._number:
                    continue
                if not fine:
                    raise Raised(*value)
                return value
            if ended:
                raise self._lost(limit, where, "ended the process ({})", ended=True)
            latest, stage = self._note(os.pread(self._file, NOTE_BYTES, 0))
            if piece and watch is not None:
                watch(stage)
            if latest != piece:
                piece, since = latest, monotonic()
            longest = (1 + TIMER_SLACK) * limit.over(stage.at_once) if piece else IMPORT_TIMEOUT_S
            if self._process.poll() is not None:
                ended = True
                self._listening.join(1.0)  # its last words
            elif monotonic() - since > GRACE_S + longest:
                raise self._lost(limit, where)
            elif resident_gb(self._process.pid) > self._memory_gb:
                raise self._lost(limit, where, "took more than " + limit_in_words(self._memory_gb))

    def _note(self, content: bytes) -> tuple[int, Stage]:
        """Which piece of the work asked for last it is at; 0 if it is at none yet."""
        with suppress(Exception):  # nothing is there yet, or half of it
            number, piece, *stage = pickle.loads(content)
            return (piece, Stage(*stage)) if number == self._number else (0, Stage())
        return 0, Stage()

    def _lost(self, limit: Limit, where: bool, what: str = "", ended: bool = False) -> Lost:
        """Kill it, and say what it did at its stage; nothing said: it took too long."""
        content = self.kill() or b""
        stage, dump = self._note(content[:NOTE_BYTES])[1], content[NOTE_BYTES:].decode(errors="replace")
        line, did = _line_in(dump) if where else "", stage.words or "it"
        if what and not (ended and "Timeout (" in dump):
            reason = f"{did} {what.format(_end(self._process.returncode))}"
            return Lost("error", reason + line, stage, ended=ended)
        seconds = f"took longer than {limit.over(stage.at_once):g} s"
        reason = f"the trial {seconds} (timeout_s), in {stage.words or 'no method'}"
        return Lost("timeout", (reason if stage.at_once else f"{did} {seconds}") + line, stage)


def _listen(pipe: IO[bytes], answers: SimpleQueue[Any]) -> None:
    with pipe, suppress(Exception):  # what cannot be read is no answer: it has ended, or will be killed
        while True:
            answers.put(_read(pipe))


def _pass_on(pipe: IO[bytes]) -> None:
    """Show the first that a process prints, and swallow the rest, so that it goes on."""
    left = MAX_PRINTED_BYTES
    with pipe, suppress(OSError, ValueError):
        while content := pipe.read1(65536):  # type: ignore[attr-defined]
            if left > 0:
                text = printable(content[:left].decode(errors="replace").replace("\r", "\n"), keep="\n\t")
                more = "\n(and so on: the rest of what it prints is not shown)\n"
                print(text + (more if len(content) > left else ""), end="", file=sys.stderr, flush=True)
            left -= len(content)


def _kill(process: subprocess.Popen[bytes], printing: Thread, file: IO[bytes]) -> bytes:
    """End it, and give what it has noted and faulthandler has written."""
    with suppress(OSError):  # what it has started itself goes, too
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    printing.join(timeout=1.0)  # its last words
    if process.stdin is not None:
        with suppress(OSError):
            process.stdin.close()
    with file:
        return os.pread(file.fileno(), MAX_DUMP_BYTES, 0)


def _end(code: int) -> str:
    with suppress(ValueError):
        return signal.Signals(-code).name if code < 0 else f"exit code {code}"
    return f"signal {-code}"


def _line_in(dump: str) -> str:
    """The line of a plug-in in what faulthandler wrote, innermost first; the main thread comes last."""
    steps = re.findall(r'  File "(.*)", line (\d+) in (.*)', dump.split("most recent call first")[-1])
    return innermost([(file, int(line), name) for file, line, name in reversed(steps)])


def _write(pipe: IO[bytes], content: bytes) -> None:
    with suppress(OSError, ValueError):  # the other side is gone, which shows when it is listened to
        pipe.write(len(content).to_bytes(8, "little") + content)
        pipe.flush()


def _read(pipe: IO[bytes]) -> Any:
    length = pipe.read(8)
    content = pipe.read(int.from_bytes(length, "little")) if len(length) == 8 else b""
    if not content:
        raise EOFError
    return pickle.loads(content)


class ChildProgram:
    """The side that answers; what a plug-in prints goes to standard error.

    Args:
        file: Handle of the file for notes, and what faulthandler writes.
        memory_gb: Resident memory that it may take, GB.
    """

    current: ChildProgram | None = None  # the one of this process, if it is such a process

    def __init__(self, file: int, memory_gb: float) -> None:
        self._answers, self._questions = os.fdopen(os.dup(1), "wb"), os.fdopen(os.dup(0), "rb")
        os.dup2(2, 1)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        self._process, self._file, self.memory_gb = os.getpid(), file, memory_gb
        self._number, self._piece, self._limit, self.stage = 0, 0, Limit(0.0), Stage()
        self._armed, self._until = 0.0, 0.0  # for how long, s, and until when another piece may begin
        faulthandler.enable(file, all_threads=False)
        with suppress(ImportError, ValueError, OSError):
            import resource

            limit = int((memory_gb + HEADROOM_GB) * 1e9)
            resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))

    def answer_all(self) -> None:
        """Answer questions until the parent kills us, or is gone."""
        asked: SimpleQueue[Any] = SimpleQueue()
        Thread(target=self._listen, args=(asked,), daemon=True).start()
        while True:
            self._number, function, arguments, self._limit = asked.get()
            self.begin(Stage())
            try:
                answer = True, function(*arguments)
            except BaseException as error:  # a plug-in may raise anything, SystemExit too
                text = one_line(error) + plugin_line(error.__traceback__)
                answer = False, (cut(type(error).__name__), text + memory_hint(error))
            self._leave_if_copy()
            faulthandler.cancel_dump_traceback_later()
            self._armed = 0.0
            _write(self._answers, pickle.dumps((self._number, *answer), pickle.HIGHEST_PROTOCOL))

    def begin(self, stage: Stage) -> None:
        """Note what is done next; the limit counts from the beginning of a piece of work."""
        self._leave_if_copy()
        self.stage = stage
        self._piece += not stage.verb
        note = pickle.dumps((self._number, self._piece, *stage))
        os.pwrite(self._file, note.ljust(NOTE_BYTES, b"\0"), 0)
        if not stage.verb:
            limit = min(max(self._limit.over(stage.at_once), 1e-3), 1e8)
            if limit != self._armed or monotonic() > self._until:
                self._armed, self._until = limit, monotonic() + TIMER_SLACK * limit
                faulthandler.dump_traceback_later((1 + TIMER_SLACK) * limit, exit=True, file=self._file)

    def _leave_if_copy(self) -> None:
        if os.getpid() != self._process:  # a plug-in has forked, and let the copy run on
            os._exit(0)

    def _listen(self, asked: SimpleQueue[Any]) -> None:
        with suppress(Exception):
            while True:
                asked.put(_read(self._questions))
        os.killpg(0, signal.SIGKILL)  # the parent is gone: so are we, and what was started here


def answer_questions(file: int, memory_gb: float) -> None:
    """What a separate process does."""
    ChildProgram.current = ChildProgram(file, memory_gb)
    ChildProgram.current.answer_all()


def begin_piece(place: int, count: int) -> None:
    """Tell the parent, if there is one, that runs begin: the first, counted from that of the batch."""
    if ChildProgram.current is not None:
        ChildProgram.current.begin(Stage(place, count))


def begin_stage(verb: str, step: int | None = None) -> None:
    """Tell the parent, if there is one, which method is called next, or what else is done."""
    if ChildProgram.current is not None:
        ChildProgram.current.begin(ChildProgram.current.stage._replace(verb=verb, step=step))


def memory_hint(error: BaseException) -> str:
    """Which limit may be behind an error; empty if none is."""
    if ChildProgram.current is None or not isinstance(error, MemoryError):
        return ""
    return f"; a plug-in may take {limit_in_words(ChildProgram.current.memory_gb)}"
