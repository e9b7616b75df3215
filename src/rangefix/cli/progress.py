"""Progress on the terminal; silent when standard error is none."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bars

from ..errors import printable
from ..evaluation import Progress


@contextmanager
def bars() -> Iterator[Callable[[Progress], None] | None]:
    """A bar for each estimator; gives what the runner calls, or None when standard error is no terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[failed]}"),
    )
    tasks: dict[str, TaskID] = {}
    with Bars(*columns, console=Console(stderr=True), transient=True) as display:

        def show(progress: Progress) -> None:
            if progress.estimator not in tasks:
                tasks[progress.estimator] = display.add_task(
                    printable(progress.estimator), total=progress.total, failed=""
                )
            failed = f"{progress.failed} failed" if progress.failed else ""
            display.update(tasks[progress.estimator], completed=progress.done, failed=failed)

        yield show
