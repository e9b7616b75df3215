"""No reading leads a built-in estimator to numbers that are none, to an exception, or to no answer."""

from __future__ import annotations

import pytest

from rangefix.filters.registry import BUILT_IN

from .hostile import RUNS, UPDATES, Attack, suffer

IN_TESTS, IN_STUDIES = 2000, 100_000  # updates of a run, of each estimator
CASES = range(IN_TESTS // (RUNS * UPDATES))
IN_CHANGES = CASES[::2]  # tried for every change; the others in studies
# runs of those that take milliseconds for each
FEW = {"adaptive-point-mass": 5, "exact": 5, "particle": 5, "point-mass": 2}
CELLS = "rangefix.filters.point_mass:PointMassFilter"  # of a given size: what `point-mass` is with `cell`
LATTICES = "rangefix.filters.adaptive:AdaptivePointMassFilter"


@pytest.mark.parametrize(
    ("name", "number"),
    [
        pytest.param(name, number, marks=[] if number in IN_CHANGES else pytest.mark.study)
        for name in (*BUILT_IN, CELLS)
        for number in CASES
    ],
)
def test_hostile_updates(name: str, number: int) -> None:
    """Moments are finite, covariances positive definite, and a usual run is the same among hostile ones."""
    suffer(name, Attack.of(number, FEW.get(name, RUNS)))


@pytest.mark.parametrize(
    "number",
    [
        *CASES[::16],
        1037,  # a beam without a return, and then too close
        *(pytest.param(number, marks=pytest.mark.study) for number in CASES[2::2] if number % 16),
    ],
)
def test_hostile_updates_of_lattices(number: int) -> None:
    """The same of the lattices that the adaptive filter takes where no exact pieces are to be had."""
    suffer(LATTICES, Attack.of(number, 2))


@pytest.mark.study
@pytest.mark.parametrize("name", [*BUILT_IN, CELLS])
def test_many_hostile_updates(name: str) -> None:
    """The same fifty times over, by other seeds."""
    for number in range(1000, 1000 + IN_STUDIES // (RUNS * UPDATES)):
        suffer(name, Attack.of(number))
