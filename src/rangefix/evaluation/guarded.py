"""The process that a guard keeps: it does trials of one estimator, and may be killed at any moment.

It takes pickled questions from standard input and writes pickled answers to what was standard output; what a
plug-in prints goes to standard error. It marks in a file what it is about to do. It ends as soon as standard
input does, however busy it is.
"""

from __future__ import annotations

import os
import pickle
from queue import SimpleQueue
from threading import Thread
from typing import IO, Any

import numpy as np

from .contestant import Contestant
from .mistakes import one_line


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


def main(marks_file: str) -> None:
    """Answer questions until there are no more."""
    answers = os.fdopen(os.dup(1), "wb")
    questions = os.fdopen(os.dup(0), "rb")
    os.dup2(2, 1)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    marks = np.memmap(marks_file, dtype=np.int64, mode="r+", shape=(3,))
    asked: SimpleQueue[Any] = SimpleQueue()

    def listen() -> None:
        try:
            while True:
                asked.put(receive(questions))
        except (EOFError, OSError):
            os._exit(0)  # the guard is gone, or has let go of us

    Thread(target=listen, daemon=True).start()

    def note(place: int, count: int) -> None:
        marks[1], marks[2] = place, count
        marks[0] += 1

    contestant: Contestant | None = None
    while True:
        verb, arguments = asked.get()
        note(0, 0)
        try:
            if verb == "build":
                contestant, answer = Contestant.of(*pickle.loads(*arguments)), None
            else:
                more = (note,) if verb == "run" else ()
                answer = getattr(contestant, verb)(*arguments, *more)
            send(answers, (True, answer))
        except BaseException as error:  # a plug-in may raise anything, SystemExit too
            send(answers, (False, f"{type(error).__name__}: {one_line(error)}"))
