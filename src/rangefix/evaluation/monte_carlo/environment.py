"""Code, libraries and machine: for manifests, and whether another process computes the same bits.

A product of matrices has other last bits where BLAS takes another kernel, and a belief rank that depends on
a comparison is then another number. Keys of parts hold versions, not processors.
"""

from __future__ import annotations

import datetime
import importlib
import os
import platform
import subprocess
from collections.abc import Mapping
from functools import cache
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from ...arrays import Array
from ...thread_pools import blas_on_one_thread

PACKAGE = Path(__file__).parents[2]
LIBRARIES = ("numpy", "scipy", "filterpy", "open3d", "numba")
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
RESULT = "last bits of a short computation"
EXPLAINS = ("processor", "processor features of numpy", "processor of numba")  # differ where bits may agree
SIZES = (5, 33, 100)  # of matrices: within one block of a BLAS kernel, beyond it, and many


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


def environment() -> dict[str, Any]:
    """What a manifest says of versions, machine and threads."""
    names = ("rangefix", *LIBRARIES, "joblib", "pydantic", "matplotlib")
    return {
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "versions": {"python": platform.python_version()} | {name: version_of(name) for name in names},
        "git": git_state(),
        "machine": {"cpu": cpu_name(), "cores": os.cpu_count(), "system": platform.platform()},
        "threads": {name: os.environ.get(name) for name in THREADS},
    }


@cache
def arithmetic() -> dict[str, str]:
    """What decides the last bits of numbers in this process: name -> what it is here."""
    version = ".".join(platform.python_version_tuple()[:2])
    found = {"python": version, "llvmlite": str(version_of("llvmlite"))}
    found |= {name: str(version_of(name)) for name in LIBRARIES}
    result = _short_computation()  # which loads what it needs
    return found | {
        "BLAS": _blas(),
        "processor": cpu_name(),
        "processor features of numpy": " ".join(_numpy_features()),
        "processor of numba": _numba_processor(),
        RESULT: result,
    }


def other_bits(there: Mapping[str, str], here: Mapping[str, str]) -> tuple[str, str]:
    """How the arithmetic of another process differs from ours.

    Returns:
        What makes other numbers there, in words, and what may explain it; both "" where nothing differs.
    """
    differing = {
        name: f"{name} {_brief(there.get(name, 'none'))}, here {_brief(value)}"
        for name, value in here.items()
        if there.get(name) != value
    }
    if differing.get(RESULT):
        differing[RESULT] = f"other {RESULT}"
    decisive = [text for name, text in differing.items() if name not in EXPLAINS]
    return "; ".join(decisive), "; ".join(text for name, text in differing.items() if name in EXPLAINS)


def _brief(value: str) -> str:
    return value if len(value) <= 60 else f"{value[:57]}..."


def _blas() -> str:
    """The BLAS libraries of numpy and scipy, with their versions and the kernels that they have chosen."""
    loaded: list[dict[str, Any]] = importlib.import_module("threadpoolctl").threadpool_info()
    blas = [each for each in loaded if each["user_api"] == "blas"]
    ours = [each for each in blas if Path(each["filepath"]).parent.name in ("numpy.libs", "scipy.libs")]
    keys = ("internal_api", "version", "architecture")
    return ", ".join(sorted({" ".join(str(each.get(key, "")) for key in keys) for each in ours or blas}))


def _numpy_features() -> list[str]:
    config: Any = np.show_config(mode="dicts")
    return list(config.get("SIMD Extensions", {}).get("found", []))


def _numba_processor() -> str:
    config: Any = importlib.import_module("numba").config
    return str(config.CPU_NAME or importlib.import_module("llvmlite.binding").get_host_cpu_name())


def _short_computation() -> str:
    """SHA-256 of what the libraries that we use make of fixed numbers, on one thread."""
    hashed = sha256()
    for library in ("scipy.linalg", "scipy.special"):  # only what is loaded can be held to one thread
        importlib.import_module(library)
    with blas_on_one_thread():
        for size in SIZES:
            for array in (*_of_matrices(size), *_of_numbers(size * size)):
                hashed.update(np.ascontiguousarray(array).tobytes())
    return hashed.hexdigest()


def _of_matrices(size: int) -> list[Array]:
    """Products and factors, by the BLAS of numpy and by that of scipy."""
    linalg: Any = importlib.import_module("scipy.linalg")
    matrix = _numbers(size * size).reshape(size, size)
    square = matrix @ matrix.T + np.eye(size)
    return [
        square,
        matrix @ matrix[0],
        np.einsum("ij,jk->ik", matrix, square),
        np.linalg.cholesky(square),
        np.linalg.inv(square),
        *np.linalg.eigh(square),
        linalg.cho_solve(linalg.cho_factor(square), matrix),
        linalg.solve_triangular(np.tril(square), matrix, lower=True),
    ]


def _of_numbers(count: int) -> list[Array]:
    """Elementary and special functions, sums and a Fourier transform."""
    special: Any = importlib.import_module("scipy.special")
    numbers = _numbers(count)
    functions = (np.exp, np.sin, np.cos, np.tanh, np.arctan, np.cbrt, np.sqrt, special.ndtr, special.gammaln)
    arrays = [function(np.abs(numbers)) for function in functions]
    arrays += [np.log(np.abs(numbers)), np.arctan2(numbers, numbers[::-1]), np.logaddexp(numbers, 0.5)]
    sums = [numbers.sum(), numbers.mean(), numbers.var(), np.logaddexp.reduce(numbers), numbers @ numbers]
    return [*arrays, np.array(sums), np.fft.rfft(numbers).view(float)]


def _numbers(count: int) -> Array:
    """Fixed numbers in (-3, 3), by integers alone: the same to the bit on every machine."""
    places = np.arange(1, count + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    return (places >> np.uint64(11)).astype(float) * (6.0 / 2.0**53) - 3.0
