"""The Bayesian Cramer-Rao bound (Van Trees, 1968)."""

from __future__ import annotations

import numpy as np

from ...filters.problem import Problem
from .bound import Bound, require_gaussian
from .continuity import require_continuous
from .information import mean_information, prior_information
from .optimum import check_static


def van_trees(problem: Problem) -> Bound:
    """The inverse of the mean information of readings plus that of the prior: G is at least that.

    The inequality is integrated by parts. That needs a prior that ends in nothing and readings whose density
    is continuous in the state, so that it holds in hardly any real building: where a beam can jump from one
    wall to another it is refused.

    Args:
        problem: The problem; one measurement.

    Raises:
        NoBoundError: If the prior does not end in nothing, or a range may jump on its support.
    """
    check_static(problem)
    require_gaussian(problem)
    own = prior_information(problem.prior, problem.space, problem.sensor.room)
    require_continuous(problem)
    measured, error = mean_information(problem, own)
    matrix = np.linalg.inv(own + measured)
    off = np.abs(np.linalg.inv(own + measured - error) - matrix)
    return Bound(
        "van-trees",
        0.5 * (matrix + matrix.T),
        off,
        ("the prior ends in nothing", "no range jumps on its support"),
    )
