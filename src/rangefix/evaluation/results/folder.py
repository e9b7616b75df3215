"""The layout of a folder of results: which parts there are, under what names and keys."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zlib import crc32

from ..experiment import Experiment, NamedEstimator
from .files import hash_of
from .npz import part_key

FORMAT = 2
MANIFEST = "manifest.json"
LOCK = ".lock"  # held by the process that is at work on the folder
TIMING = "timing.json"
SCENE = "scene.npz"
BOUNDS = "bounds.json"
SUMMARY = "summary.csv"
WORST_RUNS = "worst_runs.csv"
REPORT = "report.html"
FIGURES = "figures"
PARTS = "parts"
PART_NAME = re.compile(r"(\d{8,})-(\d{8,})\.npz")


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

    def made_by(self, estimator: str, beams: str) -> str:
        """What one estimator's trials on one set of beams depend on, as a hash."""
        return hash_of(self.trials[estimator], beams)

    def key(self, estimator: str, beams: str, first: int, end: int) -> str:
        """The key of one estimator's trials on one set of beams over a block."""
        return part_key(self.made_by(estimator, beams), estimator, beams, first, end)

    def world_key(self, first: int, end: int) -> str:
        """The key of the truths and measurements of a block."""
        return part_key(self.world, "world", "", first, end)

    def blocks(self, first: int = 0, end: int | None = None) -> Iterator[tuple[int, int]]:
        """First run and end of each part; only of those with runs first to end - 1."""
        end = self.runs if end is None else min(end, self.runs)
        for low in range(first - first % self.block, end, self.block):
            yield low, min(low + self.block, self.runs)

    def as_json(self) -> dict[str, Any]:
        """The plan as a manifest holds it."""
        return {**vars(self), "trials": dict(self.trials)}

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
            "plan": self.as_json(),
        }


def run_blocks(runs: int, size: int) -> list[tuple[int, int]]:
    """Cut runs into blocks of a size: first run and end of each."""
    return [(first, min(first + size, runs)) for first in range(0, runs, size)]


def runs_of_part(path: Path) -> tuple[int, int] | None:
    """The first run of a part and the run after its last, by the name of its file; None for other names."""
    named = PART_NAME.fullmatch(path.name)
    return (int(named[1]), int(named[2])) if named else None


def world_path(folder: Path, first: int, end: int) -> Path:
    """Where the truths and measurements of a block are."""
    return folder / PARTS / "world" / f"{first:08d}-{end:08d}.npz"


def trials_path(folder: Path, estimator: str, beams: str, first: int, end: int) -> Path:
    """Where the trials of one estimator on one set of beams over a block are."""
    name = f"{first:08d}-{end:08d}.npz"
    return folder / PARTS / file_name(estimator) / file_name(beams) / name


def file_name(label: str, longest: int = 40) -> str:
    """A label as a file name that every system takes, another for every label; never "world".

    Args:
        label: The label.
        longest: Letters of it that are kept.
    """
    safe = re.sub(r"[^A-Za-z0-9+.-]+", "_", label)[:longest].strip(".")
    return safe if safe == label and safe != "world" else f"{safe}_{crc32(label.encode()):08x}"
