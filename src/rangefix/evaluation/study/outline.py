"""What a study would run, in words and as JSON, without running code of plug-ins."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...errors import counted, listed
from ...filters.registry import file_of, module_of
from ..experiment import Experiment, NamedEstimator
from .study import Study

MAX_SHOWN = 40  # estimators, and sets of beams, that are listed in words
NEVER_RUN = "its code was not run, nor its options checked"


@dataclass(frozen=True)
class Outline:
    """What a study that is sound would run.

    Attributes:
        study: The study.
        experiment: What it describes.
        sources: Label -> where the code of a plug-in is; "" for an estimator of ours.
        files: Files that its sections read.
    """

    study: Study
    experiment: Experiment
    sources: dict[str, str]
    files: tuple[Path, ...]

    @property
    def plugins(self) -> dict[str, str]:
        """Label -> where the code is, of those that are not built in."""
        return {label: source for label, source in self.sources.items() if source}

    def lines(self) -> list[str]:
        """In words."""
        made, study = self.experiment, self.study
        labels, sets = list(made.estimators), list(made.beam_labels)
        steps = counted(made.steps, "measurement")
        told = [
            f"{study.name}: sound. Nothing was run or written.",
            f"would run: {counted(made.runs, 'run')} of {steps}, seed {made.seed}",
            f"beams: {listed(sets, MAX_SHOWN)}",
            f"estimators: {len(labels)}, each on {counted(len(sets), 'set')} of beams",
        ]
        for label in labels[:MAX_SHOWN]:
            source = self.sources[label]
            told.append(f"  {label}: plug-in, {source}; {NEVER_RUN}" if source else f"  {label}")
        told += [f"  ... and {len(labels) - MAX_SHOWN} more"] * (len(labels) > MAX_SHOWN)
        told += [f"reads: {file}" for file in self.files]
        if self.plugins:
            told.append("`rangefix run` executes the plug-ins: only if you trust who wrote them")
        return told

    def as_json(self) -> dict[str, Any]:
        """The same for programs; unlike in words, nothing is left out."""
        made = self.experiment
        builders = {
            label: each for label, each in made.estimators.items() if isinstance(each, NamedEstimator)
        }
        return {
            "study": self.study.name,
            "title": self.study.title,
            "sound": True,
            "runs": made.runs,
            "measurements": made.steps,
            "seed": made.seed,
            "beam_sets": [list(beams) for beams in made.beam_sets],
            "estimators": [
                {
                    "label": label,
                    "name": each.name,
                    "options": dict(each.options),
                    "plugin": self.sources[label] or None,
                }
                for label, each in builders.items()
            ],
            "files": [str(file) for file in self.files],
        }


def outline(study: Study) -> Outline:
    """What a study would run.

    Raises:
        StudyError: With every mistake, for a study that was made from objects.
    """
    made = study.experiment()
    sources = {
        variant.label: _source(variant.name, study.folder)
        for entry in study.estimators
        for variant in entry.variants()
    }
    files = [study.folder / file for section in study.sections() for file in section.files(study.folder)]
    return Outline(study, made, sources, tuple(dict.fromkeys(files)))


def _source(name: str, folder: Path) -> str:
    """Where the code behind an estimator's name is; "" for one of ours."""
    if NamedEstimator(name).is_built_in:
        return ""
    file = file_of(name, folder)
    return str(file) if file is not None else f"module {module_of(name)}"
