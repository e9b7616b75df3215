"""The threads that BLAS and OpenMP may take, in the whole process; they are given back as they were."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache, wraps
from threading import Lock
from typing import Any, ParamSpec, TypeVar

Arguments = ParamSpec("Arguments")
Answer = TypeVar("Answer")


def thread_pools() -> list[Any]:
    """The thread pools of BLAS and OpenMP that are loaded; none without threadpoolctl."""
    return _thread_pools(len(sys.modules))


@lru_cache(maxsize=1)
def _thread_pools(modules: int) -> list[Any]:
    """The same, looked for when so many modules are loaded: to look takes half a millisecond."""
    try:
        return list(importlib.import_module("threadpoolctl").ThreadpoolController().lib_controllers)
    except ModuleNotFoundError:
        return []


class _Holders:
    """How many hold BLAS to one thread, in threads or within each other, and what each library had before."""

    def __init__(self) -> None:
        self.lock, self.count, self.before = Lock(), 0, dict[str, tuple[Any, int]]()

    def begin(self) -> None:
        with self.lock:
            self.count += 1
            for pool in thread_pools():
                if pool.user_api == "blas" and pool.filepath not in self.before:
                    self.before[pool.filepath] = pool, pool.get_num_threads()
            self._set_to_one()

    def end(self) -> None:
        with self.lock:
            self.count -= 1
            if self.count:
                self._set_to_one()  # whatever was set meanwhile
                return
            for pool, threads in self.before.values():
                pool.set_num_threads(threads)
            self.before.clear()

    def _set_to_one(self) -> None:
        for pool, _ in self.before.values():
            pool.set_num_threads(1)


_holders = _Holders()


@contextmanager
def blas_on_one_thread() -> Iterator[None]:
    """Hold BLAS to one thread, for all threads of this process.

    What it makes of matrices of a hundred rows has other last bits with two. And its threads go on for a
    while after each product, waiting for the next one, in the way of the threads that our own loops take.

    A library that is first loaded meanwhile is held from the next time on.
    """
    _holders.begin()
    try:
        yield
    finally:
        _holders.end()


def with_blas_on_one_thread(work: Callable[Arguments, Answer]) -> Callable[Arguments, Answer]:
    """A function that holds BLAS to one thread while it works; in a traceback its frame is one of ours."""

    @wraps(work)
    def held(*arguments: Arguments.args, **named: Arguments.kwargs) -> Answer:
        with blas_on_one_thread():
            return work(*arguments, **named)

    return held
