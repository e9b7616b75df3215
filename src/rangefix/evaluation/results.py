"""What a study yields: truths, measurements and trials; parts of arrays, a manifest and a summary."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..filters.space import Array, BoolArray, StateSpace
from .covariance import judge
from .parts import FORMAT, MANIFEST, TIMING, Plan, read_timing, trials_path, world_path
from .store import ResultsError, read_json, read_npz, read_part
from .store import write_json as write_json  # also for those who save beside our results
from .store import write_npz as write_npz
from .summary import STATUSES, Row


@dataclass(frozen=True)
class Trials:
    """One estimator on one set of beams: M planned runs, T steps, n components.

    Attributes:
        estimator: Label of the estimator, unique in the study.
        beams: Label of the beams, "1+2+3", or "all".
        mean: Estimates, (M, T, n); NaN where the trial failed.
        covariance: Claimed covariances, (M, T, n, n).
        log_evidence: Log density of the measurements so far, nats, (M, T).
        log_evidence_floor: Below it they were improbable, (M, T).
        status: Codes, places in STATUSES, (M,).
        reasons: Run -> why it is not ok.
    """

    estimator: str
    beams: str
    mean: Array
    covariance: Array
    log_evidence: Array
    log_evidence_floor: Array
    status: NDArray[np.int8]
    reasons: Mapping[int, str] = field(default_factory=dict)

    @property
    def ok(self) -> BoolArray:
        """Which runs went well, (M,)."""
        return np.asarray(self.status == 0)

    @property
    def improbable(self) -> BoolArray:
        """Which ok runs met measurements that the estimator's model all but excludes, (M, T)."""
        return np.asarray(self.ok[:, None] & (self.log_evidence < self.log_evidence_floor))

    @property
    def failures(self) -> dict[str, int]:
        """Runs by status other than "ok"; statuses that did not occur are left out."""
        counts = np.bincount(self.status, minlength=len(STATUSES))
        return {name: int(n) for name, n in zip(STATUSES, counts, strict=True) if n and name != "ok"}


@dataclass(frozen=True)
class Results:
    """All trials of a study.

    Attributes:
        manifest: Name, title, seed, runs, config, versions, machine: see `manifest.json`.
        space: State space of truths and estimates.
        truth: True states, (M, T, n).
        measurement: Readings of all beams, m, (M, T, B); each trial sees those of its set of beams.
        trials: By estimator, then by beams.
        timing: (estimator, beams) -> seconds per update and run.
        scene: Walls, free space, prior, beams to draw: see `scene.py`; empty if it was not saved.
        folder: Where they are saved, if anywhere.
    """

    manifest: dict[str, Any]
    space: StateSpace
    truth: Array
    measurement: Array
    trials: tuple[Trials, ...]
    timing: Mapping[tuple[str, str], float] = field(default_factory=dict)
    scene: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    folder: Path | None = None

    @property
    def estimators(self) -> tuple[str, ...]:
        """Labels of the estimators, in the study's order."""
        return tuple(dict.fromkeys(trials.estimator for trials in self.trials))

    @property
    def beam_sets(self) -> tuple[str, ...]:
        """Labels of the sets of beams, in the study's order."""
        return tuple(dict.fromkeys(trials.beams for trials in self.trials))

    def get(self, estimator: str, beams: str | None = None) -> Trials:
        """The trials of one estimator on one set of beams; the last set (usually all beams) unless named.

        Raises:
            KeyError: If there is no such estimator or set; it lists those there are.
        """
        beams = self.beam_sets[-1] if beams is None else beams
        for trials in self.trials:
            if (trials.estimator, trials.beams) == (estimator, beams):
                return trials
        raise KeyError(
            f"no trials of {estimator!r} on beams {beams!r}; there are estimators "
            f"{', '.join(self.estimators)} and beams {', '.join(self.beam_sets)}"
        )

    def errors(self, trials: Trials) -> Array:
        """Truth minus estimate, angles the short way round, (M, T, n); NaN where the trial failed."""
        return self.space.difference(self.truth, trials.mean)


def summarise(results: Results) -> list[Row]:
    """One row for each estimator, set of beams and step, over the runs that went well."""
    rows = []
    starts = results.truth[:, 0]
    one_truth = len(starts) > 1 and bool((starts == starts[0]).all())
    for trials in results.trials:
        errors, ok = results.errors(trials), trials.ok
        for step in range(errors.shape[1]):
            rows.append(
                judge(
                    errors[ok, step],
                    trials.covariance[ok, step],
                    results.space.names,
                    planned=len(ok),
                    failures=trials.failures,
                    improbable=int(trials.improbable[:, step].sum()),
                    estimator=trials.estimator,
                    beams=trials.beams,
                    step=step,
                    seconds=results.timing.get((trials.estimator, trials.beams), np.nan),
                    one_truth=one_truth,
                )
            )
    return rows


def load(folder: Path | str) -> Results:
    """Read the results of a folder, finished or not, without pickle.

    Of an interrupted study the trials that are not there have status "skipped".

    Raises:
        ResultsError: If it is no folder of results, or a part of it is missing or damaged.
    """
    folder = Path(folder)
    manifest = read_json(folder / MANIFEST)
    try:
        if manifest["format"] != FORMAT:
            raise ResultsError(
                f"{folder} has results of format {manifest['format']}, this version reads {FORMAT}"
            )
        plan, complete = Plan.read(manifest), manifest["state"] == "complete"
        space = StateSpace(tuple(manifest["space"]["names"]), heading=manifest["space"]["heading"])
    except (KeyError, TypeError) as error:
        raise ResultsError(f"{folder / MANIFEST} lacks {error}: run the study again") from None
    steps, size, beams = plan.shape
    truth, measurement = np.full((plan.runs, steps, size), np.nan), np.full((plan.runs, steps, beams), np.nan)
    for first, end in plan.blocks():
        path = world_path(folder, first, end)
        if complete or path.exists():
            part = read_part(path, plan.world)
            truth[first:end], measurement[first:end] = part["truth"], part["measurement"]
    timing = {
        (row["estimator"], row["beams"]): np.nan if row["seconds"] is None else float(row["seconds"])
        for row in read_timing(folder / TIMING).values()
    }
    scene = folder / "scene.npz"
    return Results(
        manifest=manifest,
        space=space,
        truth=truth,
        measurement=measurement,
        trials=tuple(
            _load_trials(folder, plan, *pair, complete) for pair in product(plan.estimators, plan.beams)
        ),
        timing=timing,
        scene=read_npz(scene) if scene.exists() else {},
        folder=folder,
    )


def _load_trials(folder: Path, plan: Plan, estimator: str, beams: str, complete: bool) -> Trials:
    """One estimator's trials on one set of beams, part by part into arrays of their full size."""
    steps, size, _ = plan.shape
    arrays: dict[str, NDArray[Any]] = {
        "mean": np.full((plan.runs, steps, size), np.nan),
        "covariance": np.full((plan.runs, steps, size, size), np.nan),
        "log_evidence": np.full((plan.runs, steps), np.nan),
        "log_evidence_floor": np.full((plan.runs, steps), np.nan),
        "status": np.full(plan.runs, STATUSES.index("skipped"), dtype=np.int8),
    }
    reasons: dict[int, str] = {}
    for first, end in plan.blocks():
        path = trials_path(folder, estimator, beams, first, end)
        if not complete and not path.exists():
            reasons |= dict.fromkeys(range(first, end), "not run: the study was interrupted")
            continue
        part = read_part(path, plan.key(estimator, beams))
        for name, array in arrays.items():
            array[first:end] = part[name]
        for place, reason in zip(part["failed"], part["reasons"], strict=True):
            reasons[first + int(place)] = str(reason)
    return Trials(estimator, beams, reasons=reasons, **arrays)
