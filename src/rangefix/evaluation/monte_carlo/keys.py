"""Keys of parts: what numbers depend on."""

from __future__ import annotations

import datetime
import importlib.util
import inspect
import io
import os
import pickle
import sys
from collections.abc import Collection
from contextlib import suppress
from hashlib import sha256
from modulefinder import ModuleFinder
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np

from ...filters.registry import file_of, folders_of, module_of
from ..experiment import Builder, Experiment, NamedEstimator
from ..isolation import to_pickle
from ..results import hash_of
from .environment import LIBRARIES, PACKAGE, version_of

# All of this package is in a key but these, which only show numbers: a new module is in it unless named here.
EXEMPT = ("cli", "evaluation/report", "evaluation/figures", "evaluation/paper", "evaluation/drawing.py")


def source_digest(root: Path, exempt: Collection[str] = ()) -> str:
    """SHA-256 of the Python files of a package, but for some folders and files of it."""
    hashed = sha256()
    for file in sorted(root.rglob("*.py")):
        name = file.relative_to(root)
        if not any(name.is_relative_to(other) for other in exempt):
            hashed.update(f"{name.as_posix()}\n".encode() + file.read_bytes())
    return hashed.hexdigest()


def _identity(thing: object) -> str:
    try:
        return sha256(to_pickle(thing, cached=False)).hexdigest()
    except Exception:  # what cannot be pickled is never the same again
        return f"unpicklable {id(thing)} {datetime.datetime.now().isoformat()}"


class _Modules(pickle.Pickler):
    """Notes the modules of the classes and functions of all that it pickles."""

    def __init__(self) -> None:
        super().__init__(io.BytesIO())
        self.names: set[str] = set()

    def reducer_override(self, thing: object) -> Any:
        """Pickle as usual."""
        self.names.add((thing if isinstance(thing, type | FunctionType) else type(thing)).__module__)
        return NotImplemented


def _world_source(experiment: Experiment) -> dict[str, str]:
    """The source of other packages that the world is made of: maps, motions, sensors and their sections."""
    modules = _Modules()
    with suppress(Exception):  # what cannot be pickled has no identity either
        modules.dump((experiment.truth, experiment.assumed))
    known = {PACKAGE.name, *LIBRARIES, *sys.stdlib_module_names}
    names = {name.partition(".")[0] for name in (*modules.names, *experiment.sources)}
    return {name: _module_source(name) for name in sorted(names - known)}


def plugin_source(builder: Builder) -> str:
    """SHA-256 of the source behind a builder that is not ours: its package, module or files; "" for ours."""
    if not isinstance(builder, NamedEstimator):
        module = inspect.getmodule(builder)
        return "" if module is None else _module_source(module.__name__)
    with suppress(KeyError, ValueError):  # its trials will say that there is no such estimator
        file = file_of(builder.name, builder.folder)
        if file is not None:
            folders = folders_of(builder.name, builder.folder) or (file.parent,)
            return _file_source(file, folders)
        return _module_source(module_of(builder.name))
    return "not found"


def _file_source(file: Path, folders: tuple[Path, ...]) -> str:
    """SHA-256 of a plug-in's file, and of the modules of folders that it imports; nothing is run."""
    folder, finder = folders[0], ModuleFinder([str(each) for each in folders])
    package = file.name == "__init__.py"
    used = set(file.parent.rglob("*.py")) if package else {file}
    for script in used:
        with suppress(Exception):  # what is no Python is itself alone
            if package:
                finder.import_hook(".".join(script.relative_to(folder).with_suffix("").parts))
            else:
                finder.run_script(str(script))
    found: list[Any] = list(finder.modules.values())
    used |= {Path(module.__file__) for module in found if module.__file__}
    hashed = sha256(file.read_bytes())
    for other in sorted(used - {file}):
        where = Path(os.path.relpath(other, folder)).as_posix()
        hashed.update(f"\n{where}\n".encode() + other.read_bytes())
    return hashed.hexdigest()


def _module_source(module: str) -> str:
    """SHA-256 of the source of the package or file that holds a module, which is not imported."""
    top = module.partition(".")[0]
    loaded = sys.modules.get(top)
    if top == PACKAGE.name:
        return ""
    if loaded is not None and loaded.__spec__ is None:  # a script, a notebook, or made in memory
        file = getattr(loaded, "__file__", None)
        return sha256(Path(file).read_bytes()).hexdigest() if file else ""
    spec = importlib.util.find_spec(top)
    if spec and spec.submodule_search_locations:
        return source_digest(Path(next(iter(spec.submodule_search_locations))))
    with suppress(OSError):  # it may lie in an archive
        return sha256(Path(spec.origin or "").read_bytes()).hexdigest() if spec else "not found"
    return "not found"


def own_code() -> str:
    """What stands in a manifest for the source of this package that numbers depend on."""
    return source_digest(PACKAGE, EXEMPT)


def part_keys(experiment: Experiment, code: str | None = None) -> tuple[str, dict[str, str]]:
    """The key of the simulated runs, and the key of each estimator's trials by label.

    They hold the config, the seed, the source of this package and of the plug-in, and the versions of the
    libraries that compute. The number of runs and the other estimators are not in them: more runs or more
    estimators reuse what there is.

    Args:
        experiment: The experiment.
        code: What `own_code` says, if it was asked already.
    """
    problem = experiment.identity or _identity((experiment.truth, experiment.assumed))
    world = hash_of(
        problem,
        experiment.seed,
        experiment.block,
        experiment.control_sequence.tolist(),
        None if experiment.start is None else np.asarray(experiment.start, dtype=float).tolist(),
        own_code() if code is None else code,
        _world_source(experiment),
        {name: version_of(name) for name in LIBRARIES},
    )
    trials = {}
    for label, builder in experiment.estimators.items():
        who = (
            [builder.name, dict(builder.options)]
            if isinstance(builder, NamedEstimator)
            else _identity(builder)
        )
        timeout = experiment.timeout_of(label)
        limits = [timeout, experiment.plugin_memory_gb] if timeout else str(experiment.limit_here(label))
        trials[label] = hash_of(world, who, plugin_source(builder), limits, experiment.beliefs)
    return world, trials


def code_fingerprint(experiment: Experiment) -> dict[str, str | None]:
    """What must be the same on all machines that compute: our source, the libraries and the plug-ins."""
    prints: dict[str, str | None] = {"rangefix": own_code()}
    prints |= {name: version_of(name) for name in LIBRARIES} | _world_source(experiment)
    builders = experiment.estimators.items()
    return prints | {f"estimator {label!r}": plugin_source(builder) for label, builder in builders}
