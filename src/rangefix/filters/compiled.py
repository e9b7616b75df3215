"""numba as rangefix uses it: OpenMP threads first.

Open3D's dependencies bring a TBB that numba refuses with a warning; asked last, it is never tried.
"""

import numba
from numba import njit, prange

setattr(numba.config, "THREADING_LAYER_PRIORITY", ["omp", "workqueue", "tbb"])  # noqa: B010 (it has no stub)

__all__ = ["njit", "prange"]
