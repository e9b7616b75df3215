"""A dask cluster of this machine: a scheduler on loopback, and its workers."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager

import pytest


@contextmanager
def cluster(folder, workers, *options):
    """A scheduler on loopback: its address, and its workers, each with variables of its environment."""
    pytest.importorskip("distributed", reason="dask is not installed: pip install 'rangefix[dask]'")
    with ExitStack() as running:

        def start(*arguments, **variables):
            command = [sys.executable, "-m", *arguments, *options]
            process = subprocess.Popen(
                command,
                stderr=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                env=os.environ | variables,
            )
            running.callback(process.wait)
            running.callback(process.kill)
            return process

        where = folder / "scheduler.json"
        local = ("--host", "127.0.0.1", "--no-dashboard", "--scheduler-file", str(where))
        start("distributed.cli.dask_scheduler", "--port", "0", *local)
        deadline = time.monotonic() + 30
        address = ""
        while not address and time.monotonic() < deadline:
            time.sleep(0.1)
            try:
                address = json.loads(where.read_text())["address"]
            except (OSError, ValueError):
                continue
        alone = ("--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", str(folder))
        yield address, [start("distributed.cli.dask_worker", address, *alone, **each) for each in workers]


def wait_for_workers(address, count, **options):
    """Until so many are there."""
    import distributed

    with distributed.Client(address, set_as_default=False, **options) as client:
        client.wait_for_workers(count, timeout=60)
