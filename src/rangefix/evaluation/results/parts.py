"""The parts of a folder of results: what arrays they hold, and whether these can be what they say."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array
from ...errors import counted
from .draws import KEPT_DRAWS, whitened
from .files import ResultsError
from .folder import FolderLayout, trials_path, world_path
from .npz import Form, Forms, read_part
from .outcome import (
    DIAGNOSTICS,
    LARGEST,
    PREFIX,
    STATUSES,
    BeliefScores,
    Outcome,
    Status,
    diagnostics_of,
    is_covariance,
)

Part = dict[str, NDArray[Any]]
WHITENED, OF_COMPONENTS = "whitened_draws", "draws"  # the second in folders of older versions
LONGEST_REASON = 2000  # letters of why a trial is not ok that are kept
OVERHEAD = 1 << 16  # bytes of the headers of a part
PLAN_FLOOR = 1 << 26  # bytes: a plan of less is believed whatever is there
PLAN_RATIO = 1000  # of all arrays to the truths and measurements that are there
PAIR_BYTES = 1 << 10  # that an estimator on a set of beams takes, whatever it holds


def part_arrays(outcome: Outcome, floor: Array) -> Part:
    """The arrays of a part of trials; numbers larger than estimates may be count as infinite."""
    failed = sorted(outcome.reasons)
    arrays: Part = {
        "mean": np.asarray(outcome.mean, dtype=np.float64),
        "covariance": np.asarray(outcome.covariance, dtype=np.float64),
        "log_evidence": np.asarray(outcome.log_evidence, dtype=np.float64),
        "log_evidence_floor": floor,
        "status": outcome.status,
        "failed": np.array(failed, dtype=np.int64),
        "reasons": np.array([outcome.reasons[place][:LONGEST_REASON] for place in failed], dtype=str),
        **outcome.beliefs,
        **outcome.diagnostics,
        **({} if outcome.draws is None else {WHITENED: outcome.draws}),
    }
    return {name: _bounded(array) if array.dtype == np.float64 else array for name, array in arrays.items()}


def outcome_of(part: Part) -> Outcome:
    """What a part of trials came to: the inverse of `part_arrays`."""
    reasons = dict(zip(part["failed"].tolist(), part["reasons"].tolist(), strict=True))
    beliefs = {name: array for name, array in part.items() if name.startswith(PREFIX)}
    estimates = part["mean"], part["covariance"], part["log_evidence"], part["status"]
    return Outcome(*estimates, reasons, beliefs, diagnostics_of(part), part.get(WHITENED))


def read_world(folder: Path, plan: FolderLayout, first: int, end: int) -> Part:
    """The truths and measurements of a block.

    Raises:
        ResultsError: If they are missing, damaged or others.
    """
    steps, size, beams = plan.shape
    forms = {"truth": Form((end - first, steps, size)), "measurement": Form((end - first, steps, beams))}
    path = world_path(folder, first, end)
    part = read_part(path, plan.world_key(first, end), forms, _most(plan, first, end))
    for name in forms:
        if _is_beyond(part[name]) or (name == "truth" and not np.isfinite(part[name]).all()):
            raise ResultsError(
                f"{path} is damaged ({name}: not finite, or beyond {LARGEST:g}): "
                "delete it and run the study again"
            )
    return part


def read_trials(folder: Path, plan: FolderLayout, estimator: str, beams: str, first: int, end: int) -> Part:
    """The trials of one estimator on one set of beams over a block.

    Raises:
        ResultsError: If they are missing, damaged or others, or what they hold cannot be.
    """
    path, key = trials_path(folder, estimator, beams, first, end), plan.key(estimator, beams, first, end)
    part = read_part(path, key, _trial_forms(plan, end - first), _most(plan, first, end))
    if fault := _fault(part):
        raise ResultsError(f"{path} is damaged ({fault}): delete it and run the study again")
    if (draws := part.pop(OF_COMPONENTS, None)) is not None:
        part.setdefault(WHITENED, whitened(draws, part["covariance"]))
    return part


def if_valid(read: Callable[..., Part], *told: Any) -> Part | None:
    """What `read_world`, `read_trials` or `read_part` read; None where the part must be made again."""
    try:
        return read(*told)
    except ResultsError:
        return None


def read_if_valid(path: Path, key: str) -> Part | None:
    """A part that is there, undamaged and made with the key; None if it must be made again."""
    return if_valid(read_part, path, key)


def check_size(folder: Path, plan: FolderLayout, manifest: Path) -> None:
    """Refuse a plan that is far larger than what there is, before any memory is taken for it.

    Raises:
        ResultsError: If it is.
    """
    steps, size, beams = plan.shape
    pairs = len(plan.estimators) * len(plan.beams)
    planned = plan.runs * steps * (size + beams + pairs * (size * size + size + 2)) * 8 + pairs * PAIR_BYTES
    try:
        there = sum(file.stat().st_size for file in world_path(folder, 0, 1).parent.iterdir())
    except OSError:
        there = 0
    if planned > max(PLAN_FLOOR, PLAN_RATIO * there):
        raise ResultsError(
            f"{manifest}: plan: {counted(plan.runs, 'run')} of {counted(steps, 'step')}, "
            f"{counted(size, 'component')} and {counted(beams, 'beam')} by "
            f"{len(plan.estimators)} estimators are {planned / 1e9:.3g} GB, but the folder has "
            f"{there / 1e9:.3g} GB of truths and measurements: run the study again"
        )


def _most(plan: FolderLayout, first: int, end: int) -> int:
    """Bytes that a part may have."""
    steps, size, beams = plan.shape
    numbers = steps * (6 * size * size + 20 * size + beams + 20)
    drawn = steps * KEPT_DRAWS * size * 2
    return (end - first) * (8 * numbers + drawn + 4 * LONGEST_REASON) + OVERHEAD


def _trial_forms(plan: FolderLayout, runs: int) -> Forms:
    steps, size, _ = plan.shape
    each = (runs, steps)
    ends = {
        "ranks": (size,), "distance_rank": (), "energy": (), "crps": (size,), "mode_share": (),
        "mode_covariance": (size, size), "spread": (size, size),
    }  # fmt: skip
    return {
        "mean": Form((*each, size)),
        "covariance": Form((*each, size, size)),
        "log_evidence": Form(each),
        "log_evidence_floor": Form(each),
        "status": Form((runs,), "|i1"),
        "failed": Form((None,), "<i8"),
        "reasons": Form((None,), "U"),
        **{name: Form(each, optional=True) for name in DIAGNOSTICS},
        **{name: Form((*each, KEPT_DRAWS, size), "<f2", optional=True) for name in (WHITENED, OF_COMPONENTS)},
        **{PREFIX + name: Form((*each, *ends[name]), optional=True) for name in BeliefScores._fields},
    }


def _bounded(values: Array) -> Array:
    """The same, but infinite where `_is_beyond` finds a number too large."""
    return np.where(np.abs(values) > LARGEST, np.copysign(np.inf, values), values)


def _is_beyond(values: Array) -> bool:
    """Whether finite numbers are larger than estimates may be, so that sums of their squares overflow."""
    return bool((np.abs(values[np.isfinite(values)]) > LARGEST).any())


def _fault(part: Part) -> str:
    """What of a part of trials cannot be, or ""."""
    status, failed = part["status"], part["failed"]
    ok = status == Status.OK.code
    if ((status < 0) | (status >= len(STATUSES)) | (status == Status.PENDING.code)).any():
        return "status: no such status"
    if len(failed) != len(part["reasons"]) or not np.array_equal(failed, np.flatnonzero(~ok)):
        return "failed: they are not the runs that are not ok"
    for name, values in part.items():
        if values.dtype == np.float64 and _is_beyond(values):
            return f"{name}: beyond {LARGEST:g}"
    if not np.isfinite(part["mean"][ok]).all():
        return "mean: not finite, of a run that is ok"
    covariance = part["covariance"][ok]
    if not np.isfinite(covariance).all() or not is_covariance(covariance).all():
        return "covariance: not one, of a run that is ok"
    for name in DIAGNOSTICS:
        if name in part and not (part[name][ok] >= 0).all():
            return f"{name}: negative or NaN, of a run that is ok"
    if np.isinf(part["log_evidence"][ok]).any():  # NaN: the estimator tells none
        return "log_evidence: infinite, of a run that is ok"
    return ""
