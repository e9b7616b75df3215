"""No reading leads a built-in estimator to numbers that are none, to an exception, or to no answer."""

from __future__ import annotations

import pytest

from rangefix.filters.registry import BUILT_IN

from .hostile import RUNS, UPDATES, Attack, suffer

IN_TESTS, IN_STUDIES = 2000, 100_000  # updates of a run, of each estimator
CASES = range(IN_TESTS // (RUNS * UPDATES))
# Posteriors like thin sheets take the adaptive filter minutes, and many readings the exact one seconds a run.
SOME_CASES = {"adaptive-point-mass": (3, 7, 18), "exact": (0,)}


@pytest.mark.parametrize(
    ("name", "number"), [(name, number) for name in BUILT_IN for number in SOME_CASES.get(name, CASES)]
)
def test_hostile_updates(name: str, number: int) -> None:
    """Moments are finite, covariances positive definite, and a usual run is the same among hostile ones."""
    suffer(name, Attack.of(number))


@pytest.mark.study
@pytest.mark.parametrize("name", BUILT_IN)
def test_many_hostile_updates(name: str) -> None:
    """The same fifty times over, by other seeds."""
    for number in range(1000, 1000 + IN_STUDIES // (RUNS * UPDATES)):
        suffer(name, Attack.of(number))
