"""What a study yields: truths, measurements and trials; parts of arrays, a manifest and a summary."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array
from ...errors import counted, printable
from ...file_lock import is_locked
from ...filters import StateSpace
from .belief_images import load_pictures
from .dataframes import to_dataframe, to_xarray
from .files import ResultsError, read_json
from .folder import BOUNDS, LOCK, MANIFEST, SCENE, TIMING, FolderLayout, run_blocks
from .notebook import html_table
from .npz import read_npz
from .outcome import LARGEST
from .parts import check_size
from .saved_bounds import SavedBounds, read_bounds
from .schema import SCENE_FORMS, check_manifest, check_timing
from .trials import InFolder, InMemory, Source, Trials

MAX_RUNS_IN_MEMORY = 10_000  # whose trials are held at once; of more, nothing is read until asked for
FAR_OUTSIDE_M = 100.0  # from the middle of a map, or as far as it is wide: no pose of its scene lies further


@dataclass(frozen=True)
class Results:
    """All trials of a study. Those of a large one are read from its folder when they are asked for.

    Attributes:
        manifest: Name, title, seed, runs, config, versions, machine: see `manifest.json`.
        space: State space of truths and estimates.
        estimators: Labels of the estimators, in the study's order.
        beam_sets: Labels of the sets of beams, in the study's order.
        runs: Runs planned, M.
        source: Where the arrays come from.
        timing: (estimator, beams) -> seconds per update and run: the median of several passes.
        timing_range: (estimator, beams) -> the least and the greatest of the passes, s.
        timing_cut: (estimator, beams) -> how many updates of a run were timed, its first ones, where all of
            them take too long.
        scene: Walls, free space, prior, beams to draw: see `map_snapshot.py`; empty if it was not saved.
        bounds: Label of a set of beams -> how good anybody could be; empty unless `rangefix bounds` saved it.
        folder: Where they are saved, if anywhere.
        running: Whether a process was still making them when they were read.
    """

    manifest: dict[str, Any]
    space: StateSpace
    estimators: tuple[str, ...]
    beam_sets: tuple[str, ...]
    runs: int
    source: Source
    timing: Mapping[tuple[str, str], float] = field(default_factory=dict)
    timing_range: Mapping[tuple[str, str], tuple[float, float]] = field(default_factory=dict)
    timing_cut: Mapping[tuple[str, str], int] = field(default_factory=dict)
    scene: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    bounds: Mapping[str, SavedBounds] = field(default_factory=dict)
    folder: Path | None = None
    running: bool = False

    def __repr__(self) -> str:
        """What was run, on three lines; nothing is read for it."""
        where = f"in {self.folder}" if self.folder else "in memory"
        labels = f"  estimators: {', '.join(self.estimators)}\n  beams: {', '.join(self.beam_sets)}"
        return printable(f"Results of {self._title()}, {where}\n{labels}", keep="\n")

    def _repr_html_(self) -> str:
        """How the trials went, for notebooks; not of a large study, whose trials would have to be read."""
        trials = self.trials if self.runs <= MAX_RUNS_IN_MEMORY else ()
        lines = [(trial.estimator, trial.beams, trial.ok.sum(), trial.failures or "") for trial in trials]
        return html_table(self._title(), ("estimator", "beams", "ok", "failed"), lines)

    def _title(self) -> str:
        return f"{self.manifest.get('name')}: {counted(self.runs, 'run')}, seed {self.manifest.get('seed')}"

    @cached_property
    def truth(self) -> Array:
        """True states, (M, T, n)."""
        return self.source.world(0, self.runs)[0]

    @cached_property
    def measurement(self) -> Array:
        """Readings of all beams, m, (M, T, B); each trial sees those of its set of beams."""
        return self.source.world(0, self.runs)[1]

    @cached_property
    def trials(self) -> tuple[Trials, ...]:
        """All trials, by estimator, then by beams."""
        pairs = product(self.estimators, self.beam_sets)
        return tuple(self.source.trials(*pair, 0, self.runs) for pair in pairs)

    @cached_property
    def one_truth(self) -> bool:
        """Whether all runs have the same true first state."""
        starts = (self.source.world(*block)[0][:, 0] for block in self.blocks())
        first = self.source.world(0, 1)[0][0, 0]
        return self.runs > 1 and all(bool((start == first).all()) for start in starts)

    @cached_property
    def made(self) -> dict[tuple[str, str], int]:
        """(estimator, beams) -> runs that were made; fewer than planned where the study was interrupted."""
        pairs = list(product(self.estimators, self.beam_sets))
        if self.manifest.get("state") == "complete":
            return dict.fromkeys(pairs, self.runs)
        return {
            pair: self.runs - sum(self.source.trials(*pair, *block).pending for block in self.blocks())
            for pair in pairs
        }

    @property
    def interruption(self) -> str:
        """How far an unfinished study came, "interrupted after 0 of 400000 runs"; "" of a finished one.

        Of one that a process was at work on when it was read, "still running after 0 of 400000 runs".
        """
        if self.manifest.get("state") == "complete":
            return ""
        least, most = min(self.made.values()), max(self.made.values())
        made = least if least == most else f"{least} to {most}"
        how = "still running" if self.running else "interrupted"
        return f"{how} after {made} of {counted(self.runs, 'run')}"

    def blocks(self) -> list[tuple[int, int]]:
        """First run and end of the blocks in which a large study is gone through."""
        return run_blocks(self.runs, MAX_RUNS_IN_MEMORY)

    def get(self, estimator: str, beams: str | None = None) -> Trials:
        """The trials of one estimator on one set of beams; the last set (usually all beams) unless named.

        Raises:
            KeyError: If there is no such estimator or set; it lists those there are.
        """
        beams = self.beam_sets[-1] if beams is None else beams
        if estimator not in self.estimators or beams not in self.beam_sets:
            raise KeyError(
                f"no trials of {estimator!r} on beams {beams!r}; there are estimators "
                f"{', '.join(self.estimators)} and beams {', '.join(self.beam_sets)}"
            )
        if self.runs > MAX_RUNS_IN_MEMORY and "trials" not in vars(self):
            return self.source.trials(estimator, beams, 0, self.runs)
        place = self.estimators.index(estimator) * len(self.beam_sets) + self.beam_sets.index(beams)
        return self.trials[place]

    def errors(self, trials: Trials) -> Array:
        """Truth minus estimate, angles the short way round, (M, T, n); NaN where the trial failed."""
        return self.space.difference(self.truth, trials.mean)

    def in_memory(self) -> Results:
        """The same, with all arrays in memory and no folder."""
        return replace(self, source=InMemory(self.truth, self.measurement, self.trials), folder=None)

    def to_dataframe(self) -> Any:
        """A pandas.DataFrame with a row for each trial and step: see `dataframes.py`."""
        return to_dataframe(self.space, self.truth, self.trials)

    def to_xarray(self) -> Any:
        """An xarray.Dataset with labelled dimensions: see `dataframes.py`."""
        about = {key: self.manifest[key] for key in ("name", "seed")}
        return to_xarray(self.space, self.truth, self.measurement, self.trials, about)


def load(folder: Path | str) -> Results:
    """Read the results of a folder, finished or not, without pickle.

    Of an interrupted study the trials that are not there have status "pending". A study of no more than
    MAX_RUNS_IN_MEMORY runs is read and checked at once; the parts of a larger one when they are asked for.

    Raises:
        ResultsError: If it is no folder of results, or a part of it is missing or damaged.
    """
    folder = Path(folder)
    in_use = is_locked(folder / LOCK)  # before the manifest says that it is finished
    manifest = read_json(folder / MANIFEST)
    check_manifest(folder / MANIFEST, manifest)
    plan = FolderLayout.read(manifest)
    check_size(folder, plan, folder / MANIFEST)
    timed = {(row["estimator"], row["beams"]): row for row in read_timing(folder / TIMING).values()}
    load_pictures(folder)  # damaged ones are told before anything is drawn
    results = Results(
        manifest=manifest,
        space=StateSpace(tuple(manifest["space"]["names"]), heading=manifest["space"]["heading"]),
        estimators=plan.estimators,
        beam_sets=plan.beams,
        runs=plan.runs,
        source=InFolder(folder, plan, manifest["state"] == "complete"),
        timing={pair: _seconds(row["seconds"]) for pair, row in timed.items()},
        timing_range={
            pair: (_seconds(row.get("seconds_low")), _seconds(row.get("seconds_high")))
            for pair, row in timed.items()
        },
        timing_cut={
            pair: row["updates"]
            for pair, row in timed.items()
            if 0 < (row.get("updates") or 0) < (row.get("of_updates") or 0)
        },
        scene=_scene(folder / SCENE, plan.shape[2]),
        bounds=read_bounds(folder / BOUNDS, plan),
        folder=folder,
        running=in_use and manifest["state"] != "complete",
    )
    return replace(results, source=results.in_memory().source) if plan.runs <= MAX_RUNS_IN_MEMORY else results


def read_timing(path: Path) -> dict[str, dict[str, Any]]:
    """Key -> what was timed; empty where there is no such file.

    Raises:
        ResultsError: If it is damaged.
    """
    if not path.exists():
        return {}
    rows: dict[str, dict[str, Any]] = read_json(path)
    check_timing(path, rows)
    return rows


def _seconds(told: float | None) -> float:
    """Seconds as told; NaN where none could be."""
    return np.nan if told is None else float(told)


def _scene(path: Path, beams: int) -> dict[str, NDArray[Any]]:
    """The arrays of a map that was saved; none where none was."""
    if not path.exists():
        return {}
    arrays = read_npz(path, SCENE_FORMS)
    for name, array in arrays.items():
        possible = (np.abs(array) <= LARGEST) | (np.isinf(array) if name == "ranges" else False)
        if not possible.all() or (name in ("bearings", "ranges") and len(array) != beams):
            raise ResultsError(f"{path} is damaged ({name} holds what cannot be): run the study again")
    lower, upper = arrays["extent"][::2], arrays["extent"][1::2]
    boxes = {"extent": upper - lower, "prior_upper": arrays["prior_upper"] - arrays["prior_lower"]}
    empty = [name for name, sides in boxes.items() if not (sides > 0).all()]
    reach = np.maximum(upper - lower, FAR_OUTSIDE_M)
    away = [
        name
        for name in ("truth", "laser")
        if name in arrays and not (np.abs(arrays[name][:2] - 0.5 * (lower + upper)) <= reach).all()
    ]
    if wrong := empty + away:
        raise ResultsError(f"{path} is damaged ({wrong[0]} holds what cannot be): run the study again")
    return arrays
