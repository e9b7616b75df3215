"""Keys of parts: what numbers depend on."""

from __future__ import annotations

import datetime
import importlib.util
import inspect
from collections.abc import Callable
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from ...filters.registry import module_of
from ..experiment import Builder, Experiment, NamedEstimator
from ..isolation import to_pickle
from ..results import hash_of
from .environment import LIBRARIES, PACKAGE, version_of

NUMERIC = (
    "maps",
    "filters",
    "errors.py",
    "evaluation/experiment.py",
    "evaluation/seeds.py",
    "evaluation/isolation",
    "evaluation/study",
    "evaluation/results",
    "evaluation/consistency",
    "evaluation/monte_carlo",
)


def source_digest(root: Path, inside: tuple[str, ...] = ("",)) -> str:
    """SHA-256 of the Python files of a package, or of the named folders and files of it."""
    files = [
        file
        for name in inside
        for file in ([root / name] if name.endswith(".py") else (root / name).rglob("*.py"))
    ]
    hashed = sha256()
    for file in sorted(files):
        hashed.update(f"{file.relative_to(root).as_posix()}\n".encode() + file.read_bytes())
    return hashed.hexdigest()


def _identity(thing: object) -> str:
    try:
        return sha256(to_pickle(thing, cached=False)).hexdigest()
    except Exception:  # what cannot be pickled is never the same again
        return f"unpicklable {id(thing)} {datetime.datetime.now().isoformat()}"


def plugin_source(builder: Builder, of_module: Callable[[str], str] | None = None) -> str:
    """SHA-256 of the source behind a builder that is not ours: its package, module or file; "" for ours.

    `of_module` digests the package of a module; several builders of one package may share one that remembers.
    """
    of_module = of_module or _module_source
    target: Any = builder
    if isinstance(builder, NamedEstimator):
        where = builder.name.rpartition(":")[0]
        if where.endswith(".py"):
            path = Path(where)
            return sha256(path.read_bytes()).hexdigest() if path.is_file() else ""
        return of_module(module_of(builder.name))
    module = inspect.getmodule(target)
    file = getattr(module, "__file__", None)
    if module is None or file is None:
        return ""
    if module.__name__ == "__main__":
        return sha256(Path(file).read_bytes()).hexdigest()
    return of_module(module.__name__)


def _module_source(module: str) -> str:
    """SHA-256 of the source of the package or file that holds a module, which is not imported."""
    top = module.partition(".")[0]
    if top == PACKAGE.name:
        return ""
    spec = importlib.util.find_spec(top)
    if spec is None:
        return "not found"
    if folders := list(spec.submodule_search_locations or ()):
        return source_digest(Path(folders[0]))
    return sha256(Path(spec.origin or "").read_bytes()).hexdigest()


def part_keys(experiment: Experiment) -> tuple[str, dict[str, str]]:
    """The key of the simulated runs, and the key of each estimator's trials by label.

    They hold the config, the seed, the source of this package and of the plug-in, and the versions of the
    libraries that compute. The number of runs and the other estimators are not in them: more runs or more
    estimators reuse what there is.
    """
    problem = experiment.identity or _identity((experiment.truth, experiment.assumed))
    world = hash_of(
        problem,
        experiment.seed,
        experiment.block,
        experiment.control_sequence.tolist(),
        None if experiment.start is None else np.asarray(experiment.start, dtype=float).tolist(),
        source_digest(PACKAGE, NUMERIC),
        {name: version_of(name) for name in LIBRARIES},
    )
    trials, of_module = {}, cache(_module_source)
    for label, builder in experiment.estimators.items():
        who = (
            [builder.name, dict(builder.options)]
            if isinstance(builder, NamedEstimator)
            else _identity(builder)
        )
        try:
            source = plugin_source(builder, of_module)
        except Exception:  # its trials will say what is wrong
            source = "not found"
        trials[label] = hash_of(world, who, source, experiment.timeout_of(label), experiment.beliefs)
    return world, trials


def code_fingerprint(experiment: Experiment) -> dict[str, str | None]:
    """What must be the same on all machines that compute: our source, the libraries and the plug-ins."""
    prints: dict[str, str | None] = {"rangefix": source_digest(PACKAGE, NUMERIC)}
    prints |= {name: version_of(name) for name in LIBRARIES}
    for label, builder in experiment.estimators.items():
        try:
            prints[f"estimator {label!r}"] = plugin_source(builder)
        except Exception:  # it is not there
            prints[f"estimator {label!r}"] = None
    return prints
