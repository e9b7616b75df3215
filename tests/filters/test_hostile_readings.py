"""No reading leads a built-in estimator to numbers that are none, to an exception, or to no answer."""

from __future__ import annotations

import pytest

from rangefix.filters.registry import BUILT_IN

from .hostile import RUNS, UPDATES, Attack, suffer

IN_TESTS, IN_STUDIES = 2000, 100_000  # updates of a run, of each estimator


@pytest.mark.parametrize("number", range(IN_TESTS // (RUNS * UPDATES)))
@pytest.mark.parametrize("name", BUILT_IN)
def test_hostile_updates(name: str, number: int) -> None:
    """Moments are finite, covariances positive definite, and a usual run is the same among hostile ones."""
    suffer(name, Attack.of(number))


@pytest.mark.study
@pytest.mark.parametrize("name", BUILT_IN)
def test_many_hostile_updates(name: str) -> None:
    """The same fifty times over, by other seeds."""
    for number in range(1000, 1000 + IN_STUDIES // (RUNS * UPDATES)):
        suffer(name, Attack.of(number))
