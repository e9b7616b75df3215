"""Where numbers come from: keys of parts, and what a manifest says of code, libraries and machine."""

from __future__ import annotations

import datetime
import importlib
import importlib.util
import inspect
import json
import os
import platform
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from ..filters.registry import module_of
from .experiment import Builder, Experiment, Named

PACKAGE = Path(__file__).parent.parent
NUMERIC = (
    "maps",
    "filters",
    *(
        f"evaluation/{name}.py"
        for name in (
            "experiment",
            "seeds",
            "simulate",
            "trial",
            "outcome",
            "contestant",
            "guard",
            "crew",
            "trajectories",
            "scores_belief",
            "scores_parts",
        )
    ),
)
LIBRARIES = ("numpy", "scipy", "filterpy", "open3d", "numba")
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def digest(*parts: object) -> str:
    """SHA-256 of a JSON list of the parts."""
    return sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()


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


def pickled(thing: object) -> bytes:
    """The thing by cloudpickle, which joblib brings: functions of a script or notebook included."""
    try:
        pickler = importlib.import_module("cloudpickle")
    except ModuleNotFoundError:
        pickler = importlib.import_module("joblib.externals.cloudpickle")
    content: bytes = pickler.dumps(thing)
    return content


def _identity(thing: object) -> str:
    try:
        return sha256(pickled(thing)).hexdigest()
    except Exception:  # what cannot be pickled is never the same again
        return f"unpicklable {id(thing)} {datetime.datetime.now().isoformat()}"


def plugin_source(builder: Builder, of_module: Callable[[str], str] | None = None) -> str:
    """SHA-256 of the source behind a builder that is not ours: its package, module or file; "" for ours.

    `of_module` digests the package of a module; several builders of one package may share one that remembers.
    """
    of_module = of_module or _module_source
    target: Any = builder
    if isinstance(builder, Named):
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


def keys(experiment: Experiment) -> tuple[str, dict[str, str]]:
    """The key of the simulated runs, and the key of each estimator's trials by label.

    They hold the config, the seed, the source of this package and of the plug-in, and the versions of the
    libraries that compute. The number of runs and the other estimators are not in them: more runs or more
    estimators reuse what there is.
    """
    problem = experiment.identity or _identity((experiment.truth, experiment.assumed))
    world = digest(
        problem,
        experiment.seed,
        experiment.block,
        experiment.moves.tolist(),
        None if experiment.start is None else np.asarray(experiment.start, dtype=float).tolist(),
        source_digest(PACKAGE, NUMERIC),
        {name: version_of(name) for name in LIBRARIES},
    )
    trials, of_module = {}, cache(_module_source)
    for label, builder in experiment.estimators.items():
        who = [builder.name, dict(builder.options)] if isinstance(builder, Named) else _identity(builder)
        try:
            source = plugin_source(builder, of_module)
        except Exception:  # its trials will say what is wrong
            source = "not found"
        trials[label] = digest(world, who, source, experiment.limit(label), experiment.beliefs)
    return world, trials


def fingerprint(experiment: Experiment) -> dict[str, str | None]:
    """What must be the same on all machines that compute: our source, the libraries and the plug-ins."""
    prints: dict[str, str | None] = {"rangefix": source_digest(PACKAGE, NUMERIC)}
    prints |= {name: version_of(name) for name in LIBRARIES}
    for label, builder in experiment.estimators.items():
        try:
            prints[f"estimator {label!r}"] = plugin_source(builder)
        except Exception:  # it is not there
            prints[f"estimator {label!r}"] = None
    return prints


def version_of(name: str) -> str | None:
    """Version of an installed distribution, or None."""
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def git_state() -> dict[str, Any] | None:
    """Commit and dirty flag of the checkout that this package runs from; None outside of one."""

    def git(*arguments: str) -> str:
        return subprocess.run(
            ["git", "-C", str(PACKAGE), *arguments], capture_output=True, text=True, check=True, timeout=10
        ).stdout.strip()

    try:
        git("ls-files", "--error-unmatch", "__init__.py")
        return {"commit": git("rev-parse", "HEAD"), "dirty": bool(git("status", "--porcelain"))}
    except (OSError, subprocess.SubprocessError):
        return None


def cpu_name() -> str:
    """Name of the processor, as well as the system tells."""
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def surroundings() -> dict[str, Any]:
    """What a manifest says of versions, machine and threads."""
    names = ("rangefix", *LIBRARIES, "joblib", "pydantic", "matplotlib")
    return {
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "versions": {"python": platform.python_version()} | {name: version_of(name) for name in names},
        "git": git_state(),
        "machine": {"cpu": cpu_name(), "cores": os.cpu_count(), "system": platform.platform()},
        "threads": {name: os.environ.get(name) for name in THREADS},
    }


@contextmanager
def one_thread() -> Iterator[list[str]]:
    """Hold the libraries' thread pools to one thread for timing; yields the names of those it could hold."""
    held = []
    numba = sys.modules.get("numba")
    with warnings.catch_warnings():  # numba says which of its threading layers it cannot take
        warnings.simplefilter("ignore")
        before = numba.get_num_threads() if numba else 0
    try:
        limits: Any = importlib.import_module("threadpoolctl").threadpool_limits(1)
        held += ["BLAS", "OpenMP"]
    except ModuleNotFoundError:
        limits = None
    try:
        if numba:
            numba.set_num_threads(1)
            held.append("numba")
        yield held
    finally:
        if numba:
            numba.set_num_threads(before)
        if limits is not None:
            limits.restore_original_limits()
