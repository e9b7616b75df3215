"""How far a run has come: what is told of it, and bars on a terminal or in a notebook."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from io import StringIO
from time import monotonic
from typing import TYPE_CHECKING, Any, NamedTuple

from ...errors import printable
from ..experiment import Experiment
from ..isolation import Stage

if TYPE_CHECKING:
    from rich.progress import Progress as Bars
    from rich.progress import TaskID

TRIALS_STAGE = "trials"
NOTEBOOK_INTERVAL_S = 0.5  # between two pictures of the bars in a notebook
NOTEBOOK_WIDTH = 100  # letters
NAME_WIDTH = 22  # letters of what a bar is of


class Progress(NamedTuple):
    """How much of a pass is done.

    Attributes:
        estimator: Whose trials, over all its sets of beams; "" in the other passes.
        done: Trials, or pieces of another pass, that are done; of a batch at work by its measurements.
        total: How many there are.
        failed: Trials that failed.
        stage: The pass: "trials", or what is done before and after them in words.
        now: What is being done, such as "measurement 3 of 51"; "" where that is not known.
    """

    estimator: str
    done: int
    total: int
    failed: int
    stage: str = TRIALS_STAGE
    now: str = ""


Tell = Callable[[Progress], None]


class TrialCounts:
    """Counts the trials of each estimator over all its sets of beams, and tells how far it has come.

    Args:
        experiment: Whose trials.
        tell: Told; None to tell nobody.
    """

    def __init__(self, experiment: Experiment, tell: Tell | None) -> None:
        self._steps, self._tell = experiment.steps, tell
        self._total = experiment.runs * len(experiment.beam_sets)
        self._done, self._failed = Counter[str](), Counter[str]()

    def add(self, label: str, trials: int, failed: int, begun: int = 0, now: str = "") -> None:
        """Count trials of an estimator that are done, and tell of them, and of others that are begun."""
        self._done[label] += trials
        self._failed[label] += failed
        if self._tell is not None:
            done = self._done[label] + begun
            self._tell(Progress(label, done, self._total, self._failed[label], now=now))

    def watch(self, label: str, stage: Stage) -> None:
        """Tell what an estimator is doing."""
        step = stage.step or 0
        begun = stage.place + stage.at_once * step // self._steps
        now = f"measurement {step + 1} of {self._steps}" if self._steps > 1 else stage.verb
        self.add(label, 0, 0, begun, now)


@contextmanager
def passing(tell: Tell | None, stage: str, total: int = 1) -> Iterator[Callable[[], None]]:
    """A pass beside the trials; gives what is to be called when one of its pieces is done."""
    done = 0

    def advance() -> None:
        nonlocal done
        done += 1
        if tell is not None:
            tell(Progress("", min(done, total), total, 0, stage))

    if tell is not None:
        tell(Progress("", 0, total, 0, stage))
    yield advance
    if done < total:
        done = total - 1
        advance()


def in_notebook() -> bool:
    """Whether this is a notebook, or another front end of an IPython kernel."""
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    return getattr(shell, "kernel", None) is not None


@contextmanager
def shown(progress: Tell | bool | None) -> Iterator[Tell | None]:
    """What is to be told of progress.

    Args:
        progress: What is called; True: bars, on a terminal or in a notebook; False: nothing; None: bars in a
            notebook.
    """
    if callable(progress):
        yield progress
    elif in_notebook() and progress is not False:
        with notebook_bars() as tell:
            yield tell
    elif progress and sys.stderr.isatty():
        with terminal_bars() as tell:
            yield tell
    else:
        yield None


@contextmanager
def terminal_bars() -> Iterator[Tell]:
    """Bars on standard error, which are gone when all is done."""
    from rich.console import Console

    with _bars(console=Console(stderr=True), transient=True) as bars:
        yield _teller(bars)


@contextmanager
def notebook_bars() -> Iterator[Tell]:
    """Bars below the cell that runs, drawn by IPython alone; they stay."""
    from rich.console import Console

    ipython: Any = import_module("IPython.display")

    screen = Console(file=StringIO(), record=True, width=NOTEBOOK_WIDTH, force_jupyter=False)
    bars = _bars(console=screen, auto_refresh=False)
    handle = ipython.display(ipython.HTML(""), display_id=True)
    tell, last = _teller(bars), 0.0

    def draw() -> None:
        screen.print(bars.get_renderable())
        page = screen.export_html(inline_styles=True, code_format="<pre>{code}</pre>")
        handle.update(ipython.HTML(page))

    def tell_and_draw(progress: Progress) -> None:
        nonlocal last
        tell(progress)
        if monotonic() - last > NOTEBOOK_INTERVAL_S:
            last = monotonic()
            draw()

    try:
        yield tell_and_draw
    finally:
        draw()


def _bars(**options: Any) -> Bars:
    """Bars with what is done, the time that has passed and that is left, and what is being done."""
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )
    from rich.progress import Progress as Bars
    from rich.table import Column

    return Bars(
        TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True)),
        BarColumn(bar_width=None, table_column=Column(ratio=1)),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}", markup=False, table_column=Column(no_wrap=True, ratio=2)),
        expand=True,
        **options,
    )


def _teller(bars: Bars) -> Tell:
    """What moves the bars: one for each estimator and each pass, made when it is first told of."""
    tasks: dict[str, TaskID] = {}

    def tell(progress: Progress) -> None:
        name = progress.estimator or progress.stage
        if name not in tasks:
            shown = printable(name)
            shown = shown if len(shown) <= NAME_WIDTH else f"{shown[: NAME_WIDTH - 3]}..."
            tasks[name] = bars.add_task(shown, total=progress.total, start=False, note="")
        if progress.stage != TRIALS_STAGE or progress.done or progress.now:  # else it waits for its turn
            bars.start_task(tasks[name])
        failed = f"{progress.failed} failed" if progress.failed else ""
        note = ", ".join(filter(None, (failed, progress.now)))
        bars.update(tasks[name], completed=progress.done, note=note)

    return tell
