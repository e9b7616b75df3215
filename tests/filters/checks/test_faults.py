"""The conformance suite: sound estimators pass, planted faults are caught by the checks meant for them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from rangefix.filters import Estimator, Problem, available, build
from rangefix.filters.checks import Check, check_names, checks_for, parametrize_with_checks, problems

from .faults import FAULTS
from .sound import Kalman, Particles

LATTICES = ["adaptive-point-mass", "point-mass"]  # both of them at an unknown heading
SLOW = {"headings_are_angles", "claims_what_is_true_with_a_heading", "samples_what_it_claims"}


@parametrize_with_checks([Kalman, Particles])
def test_sound_estimators_pass(check: Check) -> None:
    """A Kalman filter and a particle filter of the simplest kind: what is sound is not blamed."""
    check()


@parametrize_with_checks(available())
def test_built_in_estimators_pass(check: Check) -> None:
    """Every estimator that `available` lists, with its defaults and without exceptions."""
    if check.subject.name in LATTICES and check.name in SLOW:
        pytest.skip("takes up to two minutes: make study")
    check()


@pytest.mark.study
@parametrize_with_checks(LATTICES)
def test_adaptive_lattices_pass(check: Check) -> None:
    """The checks in which lattices are built for each of many runs."""
    if check.name in SLOW:
        check()


def given_cells(problem: Problem) -> Estimator[Any]:
    """The point-mass filter with cells of 5 cm and 0.05 rad."""
    turns = {"heading_cell": 0.05} if problem.space.is_angle.any() else {}
    return build("point-mass", problem, cell=0.05, **turns)


@parametrize_with_checks([given_cells])
def test_given_cells_pass(check: Check) -> None:
    """The point-mass filter as the paper has it."""
    check()


@pytest.mark.parametrize(("fault", "name"), FAULTS, ids=lambda value: getattr(value, "__name__", None))
def test_fault_is_caught(fault: Callable[..., Any], name: str) -> None:
    """Each planted fault fails the check meant for it, and the message names the estimator and the fix."""
    (check,) = [check for check in checks_for(fault) if check.name == name]
    result = check.result()
    assert result.outcome == "failed"
    assert result.detail
    assert "\n" not in result.detail
    assert result.meaning
    assert result.fix


class TakesNaNForAReading(Kalman):
    """The first mistake of whoever plugs in an estimator that always had all readings."""

    def update(self, belief: Any, measurement: Any, rngs: Any) -> Any:
        after = super().update(belief, measurement, rngs)
        after.mean[np.isnan(measurement).any(axis=1)] = np.nan
        return after


@pytest.mark.parametrize(
    ("name", "words"),
    [
        (
            "nothing_measured_changes_nothing",
            "mean became NaN, or ceased to be, by an update without a reading",
        ),
        ("missing_beams_say_nothing", "not finite, compared with a sensor without these beams"),
    ],
)
def test_what_becomes_nan_is_called_so(name: str, words: str) -> None:
    """It was "changed by 0", and "off by up to nan standard deviations, changing by seed"."""
    (check,) = [check for check in checks_for(TakesNaNForAReading) if check.name == name]
    assert words in check.result().detail


def test_every_check_catches_something() -> None:
    """No check is there that no planted fault fails."""
    assert {name for _, name in FAULTS} == set(check_names())


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("sound", [Kalman, Particles])
def test_no_false_alarms(monkeypatch: pytest.MonkeyPatch, sound: type, seed: int) -> None:
    """Other seeds pass as well; at less than 1 false alarm in 10 000 this test fails for 1 in 100 at most."""
    monkeypatch.setattr(problems, "SEED", seed)
    results = [check.result() for check in checks_for(sound) if "claims" in check.name or "kal" in check.name]
    assert [result.detail for result in results if result.outcome != "passed"] == []
    assert len(results) == 5
