"""The runs of each estimator whose errors are largest against what was claimed: where to look first."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from ...arrays import Array, whole_number
from ..consistency.row import csv_cell
from ..consistency.scores import nees
from ..results import Results

MOST_RUNS_KEPT = 10  # runs of an estimator on a set of beams


@dataclass(frozen=True)
class WorstRun:
    """A run with a large error, at the step where it is largest.

    Attributes:
        estimator, beams: Whose.
        run: Its number; `rangefix run STUDY --only-run NUMBER` repeats it.
        step: Measurement after which the error is largest against the claim, from 0.
        names: Components of the state.
        truth, estimate, std: True and estimated state and claimed standard deviations, (n,); m and rad.
        error: Truth minus estimate, angles the short way round, (n,).
        readings: Of the beams of the set at that step, m, (B,); inf = met no wall, NaN = not measured.
        nees: Normalised estimation error squared over n, 1 on average if the claim is right; inf where the
            claim is not positive definite.
    """

    estimator: str
    beams: str
    run: int
    step: int
    names: tuple[str, ...]
    truth: Array
    estimate: Array
    std: Array
    error: Array
    readings: Array
    nees: float

    def flat(self) -> dict[str, object]:
        """Its values by column."""
        line: dict[str, object] = {
            "estimator": self.estimator, "beams": self.beams, "run": self.run, "step": self.step,
            "nees_over_n": self.nees,
        }  # fmt: skip
        for i, name in enumerate(self.names):
            values = {"true": self.truth[i], "estimated": self.estimate[i], "claimed_std": self.std[i]}
            line |= {f"{name}_{what}": float(value) for what, value in values.items()}
        return line


def worst_runs(results: Results, most: int = MOST_RUNS_KEPT) -> list[WorstRun]:
    """The runs with the largest NEES, of those that went well; the worst first, by estimator and beams.

    Args:
        results: Of a study. Large ones are gone through block by block.
        most: How many of each estimator on each set of beams.

    Raises:
        ValueError: If that is no whole number.
    """
    most = whole_number("most", most, 0)
    return [
        found
        for estimator, beams in product(results.estimators, results.beam_sets)
        for found in _worst(results, estimator, beams, most)
    ]


def _worst(results: Results, estimator: str, beams: str, most: int) -> list[WorstRun]:
    kept: list[WorstRun] = []
    numbers = results.manifest.get("beam_sets", {}).get(beams)  # from 1; all beams unless told
    used = slice(None) if numbers is None else np.array(numbers, dtype=int) - 1
    for first, end in results.blocks():
        trials = results.source.trials(estimator, beams, first, end)
        truth, measurement = results.source.world(first, end)
        places = np.flatnonzero(trials.ok)
        if not places.size:
            continue
        errors, size = results.space.difference(truth, trials.mean), truth.shape[-1]
        squares = nees(errors[places].reshape(-1, size), trials.covariance[places].reshape(-1, size, size))
        ratios = np.nan_to_num(squares / size, nan=np.inf, posinf=np.inf).reshape(len(places), -1)
        steps = ratios.argmax(1)
        largest = ratios[np.arange(len(places)), steps]
        for place in np.argsort(-largest, kind="stable")[:most]:
            run, step = int(places[place]), int(steps[place])
            std = np.sqrt(np.maximum(trials.covariance[run, step].diagonal(), 0.0))
            state = (truth[run, step], trials.mean[run, step], std, errors[run, step])
            seen = measurement[run, step, used], float(largest[place])
            kept.append(WorstRun(estimator, beams, first + run, step, results.space.names, *state, *seen))
        kept = sorted(kept, key=lambda worst: -worst.nees)[:most]
    return kept


def worst_runs_csv(runs: Sequence[WorstRun]) -> str:
    """The runs as CSV text with a header; floats in full, m and rad; labels as in `to_csv`."""
    text = io.StringIO()
    lines = [run.flat() for run in runs]
    writer = csv.DictWriter(text, list(lines[0]) if lines else ["estimator"], lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: csv_cell(value) for name, value in line.items()} for line in lines)
    return text.getvalue()
