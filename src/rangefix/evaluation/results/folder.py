"""The layout of a folder of results: which parts there are, under what names and keys."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array
from ..experiment import Experiment, NamedEstimator
from .files import ResultsError, hash_of, read_json, read_part
from .outcome import Outcome

FORMAT = 1
TIMING = "timing.json"
MANIFEST = "manifest.json"


@dataclass(frozen=True)
class FolderLayout:
    """What parts an experiment has.

    Attributes:
        estimators: Labels.
        beams: Labels of the sets of beams.
        runs: Runs planned.
        block: Runs to a part.
        shape: Steps T, components n, beams B.
        world: Key of the simulated runs.
        trials: Label of an estimator -> key of its trials.
    """

    estimators: tuple[str, ...]
    beams: tuple[str, ...]
    runs: int
    block: int
    shape: tuple[int, int, int]
    world: str
    trials: Mapping[str, str]

    @classmethod
    def of(cls, experiment: Experiment, world: str, trials: Mapping[str, str]) -> FolderLayout:
        """The plan of an experiment with the given keys."""
        shape = (experiment.steps, experiment.truth.space.size, len(experiment.truth.sensor.bearings))
        labels = tuple(experiment.estimators), experiment.beam_labels
        return cls(*labels, experiment.runs, experiment.block, shape, world, trials)

    @classmethod
    def read(cls, manifest: Mapping[str, Any]) -> FolderLayout:
        """The plan that a manifest holds."""
        plan: dict[str, Any] = dict(manifest["plan"])
        steps, size, beams = plan.pop("shape")
        labels = tuple(plan.pop("estimators")), tuple(plan.pop("beams"))
        return cls(*labels, shape=(steps, size, beams), **plan)

    def key(self, estimator: str, beams: str) -> str:
        """The key of one estimator's trials on one set of beams."""
        return hash_of(self.trials[estimator], beams)

    def blocks(self) -> list[tuple[int, int]]:
        """First run and end of each part."""
        return run_blocks(self.runs, self.block)

    def manifest(
        self, experiment: Experiment, around: Mapping[str, Any], command_line: Sequence[str]
    ) -> dict[str, Any]:
        """The manifest, but for its state."""
        space = experiment.truth.space
        return {
            "format": FORMAT,
            "name": experiment.name,
            "title": experiment.title,
            "runs": self.runs,
            "seed": experiment.seed,
            "space": {"names": list(space.names), "heading": space.heading},
            "beam_sets": dict(zip(self.beams, map(list, experiment.beam_sets), strict=True)),
            "estimators": {
                label: {"name": builder.name, "options": dict(builder.options)}
                if isinstance(builder, NamedEstimator)
                else {"builder": repr(builder)}
                for label, builder in experiment.estimators.items()
            },
            "command_line": list(command_line),
            "config": experiment.config,
            **around,
            "plan": {**vars(self), "trials": dict(self.trials)},
        }


def run_blocks(runs: int, size: int) -> list[tuple[int, int]]:
    """Cut runs into blocks of a size: first run and end of each."""
    return [(first, min(first + size, runs)) for first in range(0, runs, size)]


def world_path(folder: Path, first: int, end: int) -> Path:
    """Where the truths and measurements of a block are."""
    return folder / "parts" / "world" / f"{first:08d}-{end:08d}.npz"


def trials_path(folder: Path, estimator: str, beams: str, first: int, end: int) -> Path:
    """Where the trials of one estimator on one set of beams over a block are."""
    name = f"{first:08d}-{end:08d}.npz"
    return folder / "parts" / _file_name(estimator) / _file_name(beams) / name


def _file_name(label: str) -> str:
    """A label as a file name that every system takes; never "world"."""
    safe = re.sub(r"[^A-Za-z0-9+.-]+", "_", label)[:40].strip(".")
    return safe if safe == label and safe != "world" else f"{safe}_{crc32(label.encode()):08x}"


def part_arrays(outcome: Outcome, floor: Array) -> dict[str, NDArray[Any]]:
    """The arrays of a part of trials."""
    failed = sorted(outcome.reasons)
    return {
        "mean": outcome.mean,
        "covariance": outcome.covariance,
        "log_evidence": outcome.log_evidence,
        "log_evidence_floor": floor,
        "status": outcome.status,
        "failed": np.array(failed, dtype=np.int64),
        "reasons": np.array([outcome.reasons[place] for place in failed], dtype=str),
        **outcome.beliefs,
    }


def read_if_valid(path: Path, key: str) -> dict[str, NDArray[Any]] | None:
    """A part that is there, undamaged and made with the key; None if it must be made again."""
    try:
        return read_part(path, key)
    except ResultsError:
        return None


def read_timing(path: Path) -> dict[str, dict[str, Any]]:
    """Key -> what was timed; empty where nothing can be read."""
    try:
        rows = read_json(path)
    except ResultsError:
        return {}
    return rows if isinstance(rows, dict) else {}
