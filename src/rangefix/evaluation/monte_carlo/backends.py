"""Share out the tasks of a study: to this process, to others of this machine, or to a dask cluster."""

from __future__ import annotations

import gc
import importlib
import os
import pickle
import signal
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from multiprocessing import resource_tracker
from pathlib import Path
from threading import Lock, Thread
from time import monotonic, sleep
from typing import Any, NamedTuple

from ...errors import one_line
from ..experiment import Experiment
from ..isolation import Stage, to_pickle
from ..results import Part, ResultsError
from .environment import arithmetic, other_bits
from .keys import code_fingerprint
from .shares import Shares
from .simulate import Simulation
from .worker import Task, Worker

Done = tuple[Task, Part, float | None]  # and how long a run took, s, if that is known
MAX_BREAKS = 3  # pools that die one after the other without having finished a task
PROGRESS_INTERVAL_S = 0.1  # between two calls of `progress` within a part
TASKS_AHEAD = 3  # for each thread of the cluster, sent before one is back
WATCH_INTERVAL_S = 0.5  # between two looks of a worker whether its caller is there
SCHEDULER_TIMEOUT = "10s"  # for the scheduler to answer
ONE_AT_A_TIME = Lock()  # the threads of a worker take turns: our kernels use threads of their own

_here: list[Worker] = []  # in a process of a pool: what it works with


class Payload(NamedTuple):
    """What the workers of a cluster share: a pickled experiment, and what it is to be run with.

    Attributes:
        content: The experiment.
        code: The source and the versions that the caller has.
        arithmetic: What decides the last bits of the caller's numbers.
    """

    content: bytes
    code: tuple[tuple[str, str | None], ...]
    arithmetic: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class ClusterTls:
    """Files in the PEM format by which a dask cluster and its users know each other.

    Attributes:
        ca: Certificate of the authority that has signed all others.
        certificate: Ours.
        key: Its private key; None where that is in the file of the certificate.
    """

    ca: Path | str
    certificate: Path | str
    key: Path | str | None = None


class ProgressFailed(BaseException):
    """What is told of progress has raised, in the middle of a trial, which is not to blame for it."""

    def __init__(self, error: Exception) -> None:
        super().__init__(str(error))
        self.error = error


def in_process(
    worker: Worker,
    tasks: Sequence[Task],
    world: Callable[[Task], Simulation],
    watch: Callable[[Task, Stage], None],
) -> Iterator[tuple[Task, Part]]:
    """Do tasks here, one after the other; `watch` is told now and then what is about to be done of one."""
    last = monotonic()
    for task in tasks:

        def note(stage: Stage, task: Task = task) -> None:
            nonlocal last
            if monotonic() - last > PROGRESS_INTERVAL_S:
                last = monotonic()
                try:
                    watch(task, stage)
                except Exception as error:
                    raise ProgressFailed(error) from None

        try:
            part = worker.work(task, world(task), note)
        except ProgressFailed as failed:
            raise failed.error from None
        yield task, part


def on_workers(worker: Worker, shares: Shares, workers: int) -> Iterator[tuple[Task, Part]]:
    """Whole parts as a pool of processes, each with a worker like the one given, finishes them.

    Raises:
        ResultsError: If the workers keep dying.
    """
    from joblib import Parallel, delayed
    from joblib.externals.loky.process_executor import BrokenProcessPool

    breaks, left = 0, True
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "[0-9]+ tasks ")  # of those cut short
        start = {
            "initializer": _start_worker,
            "initargs": (to_pickle((worker.experiment, worker.unfinished)), os.getpid()),
        }
        while left:
            pool = Parallel(
                n_jobs=workers,
                batch_size=1,
                return_as="generator_unordered",
                max_nbytes=None,  # nothing in /dev/shm
                **start,
            )
            try:
                with _begun(pool, (delayed(_work_here)(*given) for given in shares.deal())) as done:
                    for task, part, seconds in done:
                        breaks = 0
                        yield from shares.take(task, part, seconds)
                left = False
            except BrokenProcessPool:  # one was killed: those unfinished are done again
                breaks += 1
                if breaks == MAX_BREAKS:
                    raise ResultsError(
                        f"workers died {MAX_BREAKS} times (out of memory?) at {shares.out[0].estimator!r}; "
                        "what was finished is kept: take fewer workers, or give the study a timeout_s, which "
                        "puts each estimator in a process of its own"
                    ) from None


@contextmanager
def _begun(pool: Any, calls: Iterator[Any]) -> Iterator[Iterator[Done]]:
    """The parts that a pool finishes, whose processes do not see Ctrl-C: a terminal sends it to all of them.

    Ours gets it when they have begun, and ends them. The process that watches over semaphores begins first:
    beginning it lets Ctrl-C through again.
    """
    if sys.platform != "win32":
        resource_tracker.ensure_running()
    held_back = (
        set() if sys.platform == "win32" else signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    )
    with ExitStack() as ending:
        try:
            parts = ending.enter_context(closing(pool(calls)))
        finally:
            if sys.platform != "win32":
                signal.pthread_sigmask(signal.SIG_SETMASK, held_back)
        yield parts


@contextmanager
def connected(address: str, tls: ClusterTls | None, say: Callable[[str], None]) -> Iterator[Any]:
    """A client of a dask cluster, all of whose workers compute the same bits as this process.

    Whoever reaches a dask scheduler can run code on its workers, and in this process, which unpickles what
    arrives; TLS lets only those reach it who have a certificate.

    Args:
        address: Of the scheduler.
        tls: Unless given, dask's own configuration counts.
        say: Told of workers with another processor, and where there are none yet.

    Raises:
        ResultsError: If dask is not installed, no scheduler answers there, or the bits differ.
        ValueError: If the address is empty, or not one for TLS, or a file of the certificates is missing.
    """
    if not address.strip():
        raise ValueError("--cluster is empty: give the address of a dask scheduler, such as tcp://HOST:8786")
    if tls is not None and not address.startswith("tls://"):
        raise ValueError(f"--cluster {address}: certificates are for an address that begins with tls://")
    files = () if tls is None else (tls.ca, tls.certificate, tls.certificate if tls.key is None else tls.key)
    if missing := [str(file) for file in files if not os.path.isfile(file)]:
        raise ValueError(f"--cluster {address}: no file {missing[0]}")
    try:
        distributed: Any = importlib.import_module("distributed")
    except ModuleNotFoundError:
        raise ResultsError("--cluster needs dask: pip install 'rangefix[dask]'") from None
    names = ("tls_ca_file", "tls_client_cert", "tls_client_key")
    given = dict(zip(names, map(str, files), strict=False))
    client, refused = None, ""
    try:
        security = distributed.Security(require_encryption=True, **given) if given else None
        client = distributed.Client(
            address, timeout=SCHEDULER_TIMEOUT, set_as_default=False, security=security
        )
    except (OSError, ValueError, TypeError) as error:  # TimeoutError; TLS without certificates
        refused = one_line(error)
    if client is None:
        gc.collect()  # ends the half-made client; while another one starts it would wait for that for ever
        raise ResultsError(f"--cluster {address}: no dask scheduler answers: {refused}")
    with client:
        _check_bits(client, say)
        yield client


def _check_bits(client: Any, say: Callable[[str], None]) -> None:
    """Compare the arithmetic of all workers with ours.

    Raises:
        ResultsError: If one gives other bits, or cannot say.
    """
    found = client.run(arithmetic, on_error="return")
    if not found:
        say("the cluster has no workers yet: waiting for one")
    for worker, there in found.items():
        if not isinstance(there, dict):
            text = f"{type(there).__name__}: {one_line(there)}"
            raise ResultsError(f"worker {worker} cannot run rangefix: {text}")
        differs, why = other_bits(there, arithmetic())
        if differs:
            text = "; ".join(filter(None, (differs, why)))
            raise ResultsError(f"worker {worker} gives other numbers: {text}")
        if why:
            say(f"worker {worker} has another {why}; a short computation gives the same bits there")


def on_cluster(
    experiment: Experiment, tasks: Sequence[Task], world: Callable[[Task], Simulation], client: Any
) -> Iterator[tuple[Task, Part]]:
    """Tasks and their parts as the cluster finishes them; dask gives those of a lost worker to another.

    By dask's own client: joblib's dask backend waits for ever when a task keeps killing its workers.

    Raises:
        ResultsError: If the workers keep dying, or one of them computes with other code or to other bits.
    """
    distributed: Any = importlib.import_module("distributed")
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Sending large graph")
        code, bits = tuple(code_fingerprint(experiment).items()), tuple(arithmetic().items())
        shared = client.submit(Payload, to_pickle(experiment), code, bits, pure=False)  # done again if lost
        calls = (client.submit(_work, shared, task, world(task), pure=False) for task in tasks)
        first = islice(calls, TASKS_AHEAD * max(1, sum(client.nthreads().values())))
        going = distributed.as_completed(first, loop=client.loop)
        try:
            for future in going:
                yield future.result()
                future.release()
                going.update(islice(calls, 1))
        except distributed.KilledWorker:
            raise ResultsError(
                "workers of the cluster keep dying (out of memory?); what was finished is kept"
            ) from None


def _start_worker(content: bytes, caller: int) -> None:
    """Begin a process of a pool, which ends with its caller however that ends."""

    def watch() -> None:
        while os.getppid() == caller:
            sleep(WATCH_INTERVAL_S)
        os._exit(1)

    Thread(target=watch, daemon=True).start()
    _here[:] = [Worker(*pickle.loads(content))]


def _work_here(task: Task, world: Simulation) -> Done:
    return task, _here[0].work(task, world), _here[0].pace(task).seconds


def _work(payload: Payload, task: Task, world: Simulation) -> tuple[Task, Part]:
    with ONE_AT_A_TIME:
        return task, _worker(payload).work(task, world)


@lru_cache(maxsize=1)
def _worker(payload: Payload) -> Worker:
    """The worker of this process of a cluster.

    Raises:
        ResultsError: If it would compute with other code than the process that asks, or to other bits.
    """
    experiment: Experiment = pickle.loads(payload.content)
    here = code_fingerprint(experiment)
    if other := [name for name, value in payload.code if here.get(name) != value]:
        raise ResultsError(f"a worker of the cluster has another {', '.join(other)}: install the same there")
    if differs := other_bits(arithmetic(), dict(payload.arithmetic))[0]:
        raise ResultsError(f"a worker of the cluster gives other numbers: {differs}")
    return Worker(experiment)
