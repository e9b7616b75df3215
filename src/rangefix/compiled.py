"""numba as rangefix uses it: OpenMP threads first, and threads that sleep while they wait.

Open3D's dependencies bring a TBB that numba refuses with a warning; asked last, it is never tried. OpenMP's
threads spin after each loop unless told otherwise, and then a call costs 5 ms where another process has the
second core, and 0.03 ms if they sleep; see docs/decisions/0001. A setting of your own is kept.
"""

from __future__ import annotations

import os

import numba
from numba import njit, prange

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # read when the OpenMP library is loaded
setattr(numba.config, "THREADING_LAYER_PRIORITY", ["omp", "workqueue", "tbb"])  # noqa: B010 (it has no stub)
__all__ = ["njit", "prange"]
