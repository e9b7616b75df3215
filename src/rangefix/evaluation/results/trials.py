"""The trials of a study and where their arrays come from: a folder of parts, or memory."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array, BoolArray
from ...errors import printable
from .draws import HalfArray
from .folder import FolderLayout, trials_path, world_path
from .outcome import STATUSES, BeliefScores, Status, belief_of, diagnostics_of, failures_of
from .parts import WHITENED, Part, read_trials, read_world

MOST_KEPT = 1 << 23  # bytes of parts that are kept in memory when they were read


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
        status: Codes of `Status`, (M,).
        reasons: Run -> why it failed.
        beliefs: What draws from the beliefs come to, by the names in `BeliefScores`, (M, T, ...) each; empty
            where none were drawn.
        diagnostics: What the estimator says of its own computation, by the names in `DIAGNOSTICS`, (M, T)
            each; those that it has.
        draws: Some draws from the beliefs as `draws.py` keeps them, (M, T, S, n); NaN where the trial failed.
            None where none were drawn.
    """

    estimator: str
    beams: str
    mean: Array
    covariance: Array
    log_evidence: Array
    log_evidence_floor: Array
    status: NDArray[np.int8]
    reasons: Mapping[int, str] = field(default_factory=dict)
    beliefs: Mapping[str, Array] = field(default_factory=dict)
    diagnostics: Mapping[str, Array] = field(default_factory=dict)
    draws: HalfArray | None = None

    @classmethod
    def of_part(cls, estimator: str, beams: str, part: Mapping[str, NDArray[Any]]) -> Trials:
        """The trials of the runs of one part."""
        reasons = zip(part["failed"].tolist(), part["reasons"].tolist(), strict=True)
        return cls(
            estimator,
            beams,
            part["mean"],
            part["covariance"],
            part["log_evidence"],
            part["log_evidence_floor"],
            part["status"],
            reasons=dict(reasons),
            beliefs=belief_of(part),
            diagnostics=diagnostics_of(part),
            draws=part.get(WHITENED),
        )

    def part(self, first: int, end: int) -> Trials:
        """Runs first to end - 1."""
        runs = slice(first, end)
        return replace(
            self,
            mean=self.mean[runs],
            covariance=self.covariance[runs],
            log_evidence=self.log_evidence[runs],
            log_evidence_floor=self.log_evidence_floor[runs],
            status=self.status[runs],
            reasons={run: text for run, text in self.reasons.items() if first <= run < end},
            beliefs={name: array[runs] for name, array in self.beliefs.items()},
            diagnostics={name: array[runs] for name, array in self.diagnostics.items()},
            draws=None if self.draws is None else self.draws[runs],
        )

    def __repr__(self) -> str:
        """What they are of and how they went, on one line."""
        runs, steps, components = self.mean.shape
        size = f"{runs} x {steps} x {components} runs, steps and components"
        counts = {"ok": self.ok.sum()} | self.failures
        told = ", ".join(f"{count} {status}" for status, count in counts.items())
        told += f", {self.pending} not run yet" if self.pending else ""
        return printable(f"Trials of {self.estimator} on beams {self.beams}: {size}; {told}")

    def belief(self, step: int, runs: BoolArray | None = None) -> BeliefScores | None:
        """What draws from the beliefs of some runs, else of those ok, came to after a step; NaN without."""
        some = self.ok if runs is None else runs
        return BeliefScores(**{k: v[some, step] for k, v in self.beliefs.items()}) if self.beliefs else None

    @property
    def ok(self) -> BoolArray:
        """Which runs went well, (M,)."""
        return np.asarray(self.status == Status.OK.code)

    @property
    def improbable(self) -> BoolArray:
        """Which ok runs met measurements that the estimator's model all but excludes, (M, T)."""
        return np.asarray(self.ok[:, None] & (self.log_evidence < self.log_evidence_floor))

    @property
    def failures(self) -> dict[str, int]:
        """Runs that failed by status; statuses that did not occur are left out."""
        return failures_of(np.bincount(self.status, minlength=len(STATUSES)))

    @property
    def pending(self) -> int:
        """How many runs were not made yet, as the study was interrupted."""
        return int((self.status == Status.PENDING.code).sum())


class Source(Protocol):
    """Where the arrays of runs come from: a folder, or memory."""

    def world(self, first: int, end: int) -> tuple[Array, Array]:
        """True states (M, T, n) and measurements (M, T, B) of runs first to end - 1."""
        ...

    def trials(self, estimator: str, beams: str, first: int, end: int) -> Trials:
        """Trials of runs first to end - 1; the keys of `reasons` count from run 0 of the study."""
        ...


@dataclass(frozen=True)
class InMemory:
    """Arrays in memory."""

    truth: Array
    measurement: Array
    all_trials: tuple[Trials, ...]

    def world(self, first: int, end: int) -> tuple[Array, Array]:
        """Some runs of the arrays."""
        return self.truth[first:end], self.measurement[first:end]

    def trials(self, estimator: str, beams: str, first: int, end: int) -> Trials:
        """Some runs of the trials."""
        found = next(each for each in self.all_trials if (each.estimator, each.beams) == (estimator, beams))
        return found if end - first == len(found.status) else found.part(first, end)


@dataclass(frozen=True)
class InFolder:
    """A folder of parts; those missing from an interrupted study are "pending".

    A part that was missing once stays so, though the study may be running: several passes see the same runs.

    The first parts that are read, up to `MOST_KEPT` bytes, are kept: summaries go through all of them again
    and again, and opening a part takes longer than adding up what is in it.
    """

    folder: Path
    plan: FolderLayout
    complete: bool
    kept: dict[Path, Part] = field(default_factory=dict, repr=False, compare=False)
    missing: set[Path] = field(default_factory=set, repr=False, compare=False)

    def world(self, first: int, end: int) -> tuple[Array, Array]:
        """True states and measurements, read part by part into arrays of their full size."""
        steps, size, beams = self.plan.shape
        truth = np.full((end - first, steps, size), np.nan)
        measurement = np.full((end - first, steps, beams), np.nan)
        for low, high in self.plan.blocks(first, end):
            path = world_path(self.folder, low, high)
            if self._is_there(path):
                part = self._part(path, read_world, low, high)
                mine, its = _overlap(low, high, first, end)
                truth[mine], measurement[mine] = part["truth"][its], part["measurement"][its]
        return truth, measurement

    def trials(self, estimator: str, beams: str, first: int, end: int) -> Trials:
        """Trials, read part by part into arrays of their full size."""
        runs, (steps, size, _) = end - first, self.plan.shape
        arrays: dict[str, NDArray[Any]] = {
            "mean": np.full((runs, steps, size), np.nan),
            "covariance": np.full((runs, steps, size, size), np.nan),
            "log_evidence": np.full((runs, steps), np.nan),
            "log_evidence_floor": np.full((runs, steps), np.nan),
            "status": np.full(runs, Status.PENDING.code, dtype=np.int8),
        }
        reasons: dict[int, str] = {}
        beliefs: dict[str, Array] = {}
        diagnostics: dict[str, Array] = {}
        draws: HalfArray | None = None
        for low, high in self.plan.blocks(first, end):
            path = trials_path(self.folder, estimator, beams, low, high)
            if not self._is_there(path):
                continue
            part = self._part(path, read_trials, estimator, beams, low, high)
            mine, its = _overlap(low, high, first, end)
            for name, array in arrays.items():
                array[mine] = part[name][its]
            for name, found in belief_of(part).items():
                beliefs.setdefault(name, np.full((runs, *found.shape[1:]), np.nan))[mine] = found[its]
            for name, found in diagnostics_of(part).items():
                diagnostics.setdefault(name, np.full((runs, steps), np.nan))[mine] = found[its]
            if (kept := part.get(WHITENED)) is not None:
                if draws is None:
                    draws = np.full((runs, *kept.shape[1:]), np.nan, dtype=np.float16)
                draws[mine] = kept[its]
            for place, reason in zip(part["failed"], part["reasons"], strict=True):
                if first <= low + int(place) < end:
                    reasons[low + int(place)] = str(reason)
        return Trials(
            estimator, beams, reasons=reasons, beliefs=beliefs, diagnostics=diagnostics, draws=draws, **arrays
        )

    def _is_there(self, path: Path) -> bool:
        if not self.complete and (path in self.missing or not path.exists()):
            self.missing.add(path)
            return False
        return True

    def _part(self, path: Path, read: Callable[..., Part], *told: Any) -> Part:
        if path in self.kept:
            return self.kept[path]
        part = read(self.folder, self.plan, *told)
        parts = (part, *self.kept.values())
        if sum(array.nbytes for each in parts for array in each.values()) <= MOST_KEPT:
            self.kept[path] = part
        return part


def _overlap(low: int, high: int, first: int, end: int) -> tuple[slice, slice]:
    """Where runs low to high - 1 go among runs first to end - 1, and which of them."""
    start, stop = max(low, first), min(high, end)
    return slice(start - first, stop - first), slice(start - low, stop - low)
