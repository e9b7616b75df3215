"""What the conformance suite says of an estimator, by itself and under pytest."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from numpy.random import Generator

from rangefix.arrays import Array
from rangefix.filters import Estimate, Prior, Problem
from rangefix.filters.checks import CheckFailure, check_names, checks_for, conforms, render, run_checks

from .faults import ClaimsTooLittle, LacksAVerb, Raises
from .sound import Kalman, Particles

pytest_plugins = ["pytester"]


def test_results_and_their_lines() -> None:
    """A failure is told with what was seen, what it means and how to fix it; the last line counts."""
    results = run_checks(ClaimsTooLittle)
    assert not conforms(results)
    assert [result.name for result in results] == list(check_names())
    text = "\n".join(render(results))
    assert "FAILED           claims_what_is_true\n" in text
    assert "ANEES / n is 3" in text
    assert "fix:" in text
    assert text.splitlines()[-1].startswith("22 of 22 checks ran: ")
    assert conforms(run_checks(Kalman))


def test_an_estimator_that_cannot_be_built_fails_once() -> None:
    """The first check says why, the others are skipped."""
    results = run_checks(LacksAVerb)
    assert results[0].outcome == "failed"
    assert "predict" in results[0].detail
    assert {result.outcome for result in results[1:]} == {"skipped"}
    assert render(results)[-1] == "1 of 22 checks ran: 1 failed, 21 skipped"


class HasTwoVerbs:
    """An estimator of one run that was not written to its end."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem

    def init(self, prior: Prior, rng: Generator) -> Estimate:
        return Estimate(prior.mean, prior.covariance)

    def predict(self, belief: Estimate, control: Array, rng: Generator) -> Estimate:
        return belief


class HasNone:
    def __init__(self, problem: Problem) -> None:
        self.problem = problem


@pytest.mark.parametrize(
    ("unfinished", "missing"),
    [(HasTwoVerbs, "update, estimate"), (HasNone, "init, predict, update, estimate")],
)
def test_missing_verbs_are_told_whatever_lifts_the_estimator(unfinished: type, missing: str) -> None:
    """Those of one run too, which `EachRun` gives all four verbs."""
    first, *others = run_checks(unfinished)
    assert first.outcome == "failed"
    assert f"lacks {missing}: it needs all four verbs" in first.detail
    assert {result.outcome for result in others} == {"skipped"}


def test_an_unknown_name_is_no_result(tmp_path: Path) -> None:
    """A name that is not there raises; a file that does not import is an estimator that is not built."""
    with pytest.raises(KeyError, match="no estimator 'kalmann'"):
        run_checks("kalmann")
    (tmp_path / "broken.py").write_text("1 / 0\n")
    first, *_ = run_checks(f"{tmp_path / 'broken.py'}:Filter")
    assert first.outcome == "failed"
    assert "division by zero" in first.detail


def test_an_error_is_told_in_one_line_with_its_place() -> None:
    """What an estimator raises becomes the detail: type, message, file, line and function."""
    detail = run_checks(Raises)[1].detail
    assert detail.startswith("RuntimeError: no licence (faults.py, line ")
    assert detail.endswith("in update)")


def test_a_refused_problem_is_skipped() -> None:
    """An estimator that is not made for a heading says so by ValueError, and is not blamed."""

    def flat_only(problem: Problem) -> Kalman:
        if problem.space.is_angle.any():
            raise ValueError("made for known headings")
        return Kalman(problem)

    skipped = {result.name: result.detail for result in run_checks(flat_only) if result.outcome == "skipped"}
    need_heading = {"headings_are_angles", "claims_what_is_true_with_a_heading", "samples_what_it_claims"}
    assert set(skipped) == need_heading
    assert set(skipped.values()) == {"refuses this problem: made for known headings"}


def test_sampling_is_optional() -> None:
    """Without the method the check is skipped, and says so."""

    class Mute(Kalman):
        sample = None  # type: ignore[assignment]

    (result,) = [result for result in run_checks(Mute) if result.outcome == "skipped"]
    assert result.name == "samples_what_it_claims"
    assert "optional" in result.detail


def test_no_log_evidence_is_allowed() -> None:
    """NaN, meaning not computed, passes; only the flag for impossible measurements is skipped."""

    class Mute(Kalman):
        def estimate(self, belief: Any) -> Any:
            return Estimate(belief.mean, belief.covariance)

    outcomes = {result.name: result.outcome for result in run_checks(Mute)}
    assert outcomes.pop("impossible_measurement_is_flagged") == "skipped"
    assert set(outcomes.values()) == {"passed"}


def test_options_reach_the_estimator() -> None:
    """Twelve particles by option are as bad as twelve by default."""
    (check,) = [check for check in checks_for(Particles, size=12) if check.name.startswith("agrees")]
    assert check.result().outcome == "failed"
    assert run_checks(Particles, sizes=12)[0].detail.startswith("TypeError: ")


def test_an_expected_failure_must_fail() -> None:
    """With a reason a failure is expected; when it passes all the same, that is an error."""
    expected = {"claims_what_is_true": "made so on purpose", "can_be_built": "wrong"}
    results = {result.name: result for result in run_checks(ClaimsTooLittle, expected_failures=expected)}
    assert results["claims_what_is_true"].outcome == "expected_failure"
    assert results["claims_what_is_true"].detail.startswith("made so on purpose (ANEES")
    assert results["can_be_built"].outcome == "unexpected_pass"
    assert not conforms([results["can_be_built"]])
    assert conforms([results["claims_what_is_true"]])


def test_an_expected_failure_needs_a_reason_and_a_check() -> None:
    """Neither an empty reason nor a name that is no check is taken."""
    with pytest.raises(ValueError, match="needs a reason: can_be_built"):
        checks_for(Kalman, expected_failures={"can_be_built": " "})
    with pytest.raises(ValueError, match="no check can_fly; there are can_be_built, "):
        checks_for(Kalman, expected_failures={"can_fly": "it has no wings"})


def test_a_failure_under_pytest_says_what_to_do() -> None:
    """The message holds the estimator, what was seen, the meaning and the fix."""
    (check,) = [check for check in checks_for(ClaimsTooLittle) if check.name == "claims_what_is_true"]
    with pytest.raises(CheckFailure, match=r"(?s)ClaimsTooLittle: ANEES.*meaning: .*fix: "):
        check()


def test_as_pytest_sees_it(pytester: pytest.Pytester) -> None:
    """Passes, strict expected failures, skips and failures come out as such; names are readable."""
    pytester.makepyfile(
        """
        from rangefix.filters.checks import parametrize_with_checks

        def refuses(problem):
            raise ValueError("made for nothing")

        @parametrize_with_checks(["ekf"], expected_failures={"can_be_built": "out of date"})
        def test_one(check):
            check()

        @parametrize_with_checks([refuses], expected_failures={"can_be_built": "it refuses all"})
        def test_two(check):
            check()
        """
    )
    result = pytester.runpytest_inprocess("-p", "no:dash", "-k", "can_be_built or headings")
    result.assert_outcomes(passed=1, failed=1, xfailed=1, skipped=1)
    result.stdout.fnmatch_lines(["*FAILED*test_one?ekf-can_be_built?*"])
