"""Where estimators fail: their worst runs in tables and in the map, and the command that repeats one."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np

from ...arrays import Array
from ..comparison.worst_runs import MOST_RUNS_KEPT, WorstRun
from ..consistency.formatting import beams_in_words, factor, format_number, unit
from ..results import Results
from .embedding import Mark, ShownFigure, marks_of
from .tables import Cell, Line, Spot, Table

MAP_ID = "worst-map"  # the id of the figure
MAX_READINGS_SHOWN = 6  # of a scan with more only the ends are
RARE_SHARE = 0.05  # how rarely an honest estimator has a run beyond what the page names
Key = tuple[str, str, int]  # estimator, beams, run


class WhereItFails(NamedTuple):
    """What a page shows of the worst runs of a study.

    Attributes:
        first: The worst run of each estimator, the worst first.
        all: The worst runs of each estimator.
        figure: They in the map; None if there is no map.
        marks: Of the estimators in the map.
        command: Repeats a run, but for its number, which follows.
        is_command: Whether it is one for a terminal, else one of Python.
        run: The number of the worst run of all.
        rare: NEES / n that a run of an honest estimator with Gaussian errors exceeds in one study of 20.
    """

    first: Table
    all: Table
    figure: ShownFigure | None
    marks: Sequence[Mark]
    command: str
    is_command: bool
    run: int
    rare: float


def where_it_fails(results: Results, runs: Sequence[WorstRun], steps: int) -> WhereItFails | None:
    """What a page shows of the worst runs; None where no run went well.

    Args:
        results: The study.
        runs: Its worst runs, by estimator and beams.
        steps: Measurements in a run.
    """
    from scipy.special import chdtri

    if not runs:
        return None
    by_estimator = {
        label: sorted(own, key=lambda run: -run.nees)[:MOST_RUNS_KEPT]
        for label, own in groupby(runs, key=lambda run: run.estimator)
    }
    figure, marks, spots = _map(results, [run for own in by_estimator.values() for run in own])
    worst = sorted((own[0] for own in by_estimator.values()), key=lambda run: -run.nees)
    names, command = worst[0].names, repeat_command(results.manifest)
    moving = steps > 1
    columns = _columns(names, moving)
    texts = frozenset([0, len(columns) - 1])
    first = [
        Line(run.estimator, [Cell(str(run.run)), *_cells(run, moving)], spots.get(_key(run))) for run in worst
    ]
    every = [
        (label, [Line(f"run {run.run}", _cells(run, moving), spots.get(_key(run))) for run in own])
        for label, own in by_estimator.items()
    ]
    looked_at = results.runs * steps * len(results.beam_sets)  # of them the worst is chosen
    rare = chdtri(len(names), -np.expm1(np.log1p(-RARE_SHARE) / looked_at)) / len(names)
    return WhereItFails(
        first=Table(["run", *columns], [("", first)], frozenset(place + 1 for place in texts)),
        all=Table(columns, every, texts, head="run"),
        figure=figure,
        marks=marks,
        command=command or "repeat_run(experiment, ",
        is_command=command != "",
        run=worst[0].run,
        rare=float(rare),
    )


def _key(run: WorstRun) -> Key:
    return run.estimator, run.beams, run.run


def _map(
    results: Results, runs: Sequence[WorstRun]
) -> tuple[ShownFigure | None, list[Mark], dict[Key, Spot]]:
    """The runs in the map, the marks of estimators, and where each run stands: its truth and its estimate."""
    from ..figures.data import MAX_ESTIMATORS_DRAWN
    from ..figures.embedded.places import Drawing
    from ..figures.embedded.worst import worst_figure
    from ..figures.style import styled

    labels, where = results.estimators[:MAX_ESTIMATORS_DRAWN], list(results.space.position_indices)
    drawn = [run for run in runs if run.estimator in labels]
    if not results.scene or not drawn:
        return None, [], {}
    with styled():
        figure, places = worst_figure(replace(results, estimators=labels), drawn)
        caption = "true positions, and lines from there to the estimates"
        shown = ShownFigure.of(Drawing.of(figure), "The worst runs", caption)
    truths, estimates = (
        places.of([state[where] for state in states])
        for states in ([run.truth for run in drawn], [run.estimate for run in drawn])
    )
    spots = {
        _key(run): Spot.at_shares(MAP_ID, shares, _tip(run), run.run)
        for run, shares in zip(drawn, np.concatenate([truths, estimates], axis=1), strict=True)
    }
    return shown, marks_of(labels), spots


def _columns(names: Sequence[str], moving: bool) -> list[str]:
    states = [f"{name}, {unit(name)}: true \u2192 estimated" for name in names]
    return ["beams", *(["measurement"] if moving else []), "NEES / n", *states, "readings, m"]


def _cells(run: WorstRun, moving: bool) -> list[Cell]:
    """A run's cells in the order of the columns."""
    states = []
    for name, *state in zip(run.names, run.truth, run.estimate, run.error, run.std, strict=True):
        true, estimated, error, std = (format_number(factor(name) * value) for value in state)
        states.append(Cell(f"{true} \u2192 {estimated}", f"error {error}, std {std}"))
    step = [Cell(str(run.step + 1))] if moving else []
    return [
        Cell(beams_in_words(run.beams)),
        *step,
        Cell(_nees(run)),
        *states,
        Cell(_readings(run.readings), kind="readings"),
    ]


def _nees(run: WorstRun) -> str:
    return format_number(run.nees) if np.isfinite(run.nees) else "\u221e"


def _readings(readings: Array) -> str:
    """Readings in words: each of a few, the ends of many."""
    words = [
        "-" if np.isnan(each) else "no wall" if np.isinf(each) else format_number(each) for each in readings
    ]
    if len(words) <= MAX_READINGS_SHOWN:
        return ", ".join(words)
    met = readings[np.isfinite(readings)]
    ends = f", {format_number(met.min())} to {format_number(met.max())}" if met.size else ""
    missed, absent = int(np.isinf(readings).sum()), int(np.isnan(readings).sum())
    more = f"; {missed} met no wall" * (missed > 0) + f"; {absent} not measured" * (absent > 0)
    return f"{len(words)} beams{ends}{more}"


def _tip(run: WorstRun) -> str:
    """What is said of a run where the pointer is."""
    errors = []
    for name, error, std in zip(run.names, run.error, run.std, strict=True):
        off, claimed = (format_number(factor(name) * abs(value)) for value in (error, std))
        errors.append(f"{name} off by {off} {unit(name)}, claimed std {claimed}")
    where = f"{run.estimator}, {beams_in_words(run.beams)}, run {run.run}"
    return f"{where}: NEES / n {_nees(run)}; {', '.join(errors)}"


def repeat_command(manifest: Mapping[str, Any]) -> str:
    """The command line that repeats a run, but for the run's number; "" if the study was run from Python."""
    words = list(manifest.get("command_line") or ())
    if words[:2] != ["rangefix", "run"]:
        return ""
    runs = ["--runs", str(manifest["runs"]), "--seed", str(manifest["seed"])]
    return f"{shlex.join([*words, *runs])} --only-run"
