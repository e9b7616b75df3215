"""One run of a study once more: `rangefix run STUDY --only-run NUMBER`."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from ..evaluation import Study, nees, repeat_run
from ..evaluation.consistency.formatting import beams_in_words, factor, format_number, unit
from ..evaluation.drawing import draw_run
from ..evaluation.monte_carlo import OneRun
from ..evaluation.results import STATUSES, Trials
from .app import print_json
from .screen import console, new_table


def show_run(study: Study, number: int, folder: Path, as_json: bool) -> bool:
    """Repeat a run, print what became of it and draw its beliefs; whether all estimators gave an answer."""
    run = repeat_run(study, number)
    figures = [str(path) for path in draw_run(run, folder)]
    if as_json:
        print_json(_document(study.name, run) | {"figures": figures})
    else:
        screen = console()
        screen.print(_table(f"{study.title or study.name}: run {number}", run))
        for trials in run.results.trials:
            for reason in trials.reasons.values():
                where = f"{trials.estimator}, {beams_in_words(trials.beams)}"
                screen.say(f"{where}: {reason}")
        for line in figures or [f"no figure: {_why_none(run)}"]:
            screen.say(line)
    return all(bool(trials.ok.all()) for trials in run.results.trials)


def _why_none(run: OneRun) -> str:
    """Why `draw_run` has drawn nothing."""
    if not run.results.scene:
        return "the map does not tell its walls"
    return f"no estimator gave an answer with {beams_in_words(run.results.beam_sets[-1])}"


def _table(title: str, run: OneRun) -> Table:
    """Estimates after the last measurement beside the truth."""
    results = run.results
    headings = [f"{name}, {unit(name)}\nestimate ± std" for name in results.space.names]
    table = new_table(title, ["\nestimator", "\nstatus", *headings, "\nNEES/n"])
    truth = results.truth[0, -1]
    scale = [factor(name) for name in results.space.names]
    true = [format_number(by * value) for by, value in zip(scale, truth, strict=True)]
    table.add_row("truth", "", *true, "", style="bold", end_section=True)
    for beams in results.beam_sets:
        table.add_row(beams_in_words(beams), style="bold")
        for trials in (results.get(estimator, beams) for estimator in results.estimators):
            answer = _answer(run, trials) if trials.ok[0] else ["-"] * (len(headings) + 1)
            table.add_row(f"  {trials.estimator}", STATUSES[trials.status[0]], *answer)
        table.add_section()
    return table


def _answer(run: OneRun, trials: Trials) -> list[str]:
    """The estimate after the last measurement with its deviations, and NEES over n."""
    stds = np.sqrt(np.maximum(trials.covariance[0, -1].diagonal(), 0.0))
    scale = [factor(name) for name in run.results.space.names]
    cells = [
        f"{format_number(by * value)} ± {format_number(by * std)}"
        for by, value, std in zip(scale, trials.mean[0, -1], stds, strict=True)
    ]
    return [*cells, format_number(_ratios(run, trials)[-1])]


def _ratios(run: OneRun, trials: Trials) -> list[float]:
    """NEES over n after each measurement."""
    errors = run.results.errors(trials)[0]
    return [float(ratio) for ratio in nees(errors, trials.covariance[0]) / errors.shape[-1]]


def _document(name: str, run: OneRun) -> dict[str, Any]:
    """The run as plain values, all steps; m and rad."""
    return {
        "study": name,
        "run": run.number,
        "truth": run.results.truth[0].tolist(),
        "measurement": run.results.measurement[0].tolist(),
        "trials": list(_trials(run)),
    }


def _trials(run: OneRun) -> Iterator[dict[str, Any]]:
    for estimator, beams in product(run.results.estimators, run.results.beam_sets):
        trials = run.results.get(estimator, beams)
        yield {
            "estimator": estimator,
            "beams": beams,
            "status": STATUSES[trials.status[0]],
            "reason": next(iter(trials.reasons.values()), ""),
            "mean": trials.mean[0].tolist(),
            "covariance": trials.covariance[0].tolist(),
            "log_evidence": trials.log_evidence[0].tolist(),
            "nees_over_n": _ratios(run, trials),
        }
