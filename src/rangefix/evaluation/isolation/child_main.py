"""The program of a separate process: it does trials of one estimator, and may be killed at any moment.

It takes pickled questions from standard input and writes pickled answers to what was standard output; what a
plug-in prints goes to standard error. It writes into a file what it is about to do. It ends as soon as
standard input does, however busy it is. Questions: ("build", a function and its arguments, pickled); then
"probe", "run" or "time" with the arguments of what was built; ("call", a function and its arguments);
(WHERE, nothing), which is answered at once with the line that is being executed.
"""

from __future__ import annotations

import os
import pickle
import sys
from queue import SimpleQueue
from threading import Lock, Thread, main_thread
from typing import IO, Any

from ...errors import one_line
from ...filters.plugin_line import plugin_line
from .stages import StageFile

ANSWER, WHERE = "answer", "where"


def send(pipe: IO[bytes], thing: object) -> None:
    """Write a length and a pickle."""
    content = pickle.dumps(thing, protocol=pickle.HIGHEST_PROTOCOL)
    pipe.write(len(content).to_bytes(8, "little") + content)
    pipe.flush()


def receive(pipe: IO[bytes]) -> Any:
    """Read what `send` wrote.

    Raises:
        EOFError: If the other side is gone.
    """
    length = pipe.read(8)
    content = pipe.read(int.from_bytes(length, "little")) if len(length) == 8 else b""
    if not content:
        raise EOFError
    return pickle.loads(content)


def main(stage_file: str) -> None:
    """Answer questions until there are no more."""
    answers = os.fdopen(os.dup(1), "wb")
    questions = os.fdopen(os.dup(0), "rb")
    os.dup2(2, 1)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    stages = StageFile(stage_file, new=False)
    asked: SimpleQueue[Any] = SimpleQueue()
    turn = Lock()

    def answer(kind: str, thing: object) -> None:
        with turn:
            send(answers, (kind, thing))

    def listen() -> None:
        try:
            while True:
                question = receive(questions)
                if question[0] == WHERE:
                    answer(WHERE, _where())
                else:
                    asked.put(question)
        except (EOFError, OSError):
            os._exit(0)  # the guard is gone, or has let go of us

    Thread(target=listen, daemon=True).start()
    estimator: Any = None
    while True:
        verb, arguments = asked.get()
        stages.note(0, 0)
        try:
            value = None
            if verb == "build":
                stages.announce("importing it")
                build, content = arguments
                estimator = build(*pickle.loads(content), stages.announce)
            elif verb == "call":
                function, *rest = arguments
                value = function(*rest, stages.announce)
            else:
                more = (stages.note, stages.announce) if verb == "run" else ()
                value = getattr(estimator, verb)(*arguments, *more)
            answer(ANSWER, (True, value))
        except BaseException as error:  # a plug-in may raise anything, SystemExit too
            text = one_line(error) + plugin_line(error.__traceback__)
            answer(ANSWER, (False, (type(error).__name__, text)))


def _where() -> str:
    frame = sys._current_frames().get(main_thread().ident or 0)
    return plugin_line(frame) if frame else ""
