"""What a study yields: truths, measurements and trials; parts of arrays, a manifest and a summary."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..filters.space import Array, BoolArray, StateSpace
from .covariance import judge
from .store import ResultsError
from .store import write_json as write_json  # also for those who save beside our results
from .store import write_npz as write_npz
from .summary import FAILURES, Row

STATUSES = ("ok", *FAILURES)  # the code of a status is its place here


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
                )
            )
    return rows
