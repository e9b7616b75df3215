"""Run the checks of an estimator, alone or by pytest, and say what came of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal
from unittest import SkipTest

from ..plugin_line import plugin_line
from ..registry import resolve
from . import answers, beliefs, contract
from .claims import CheckFailure, Claim, Factory, Subject

if TYPE_CHECKING:
    import pytest

Outcome = Literal["passed", "failed", "expected_failure", "unexpected_pass", "skipped"]
RAISED = "Look at the line where it is raised."
BAD: tuple[Outcome, ...] = ("failed", "unexpected_pass")
CLAIMS: tuple[Claim, ...] = (
    contract.can_be_built,
    contract.shapes_and_dtypes,
    contract.moments_are_sound,
    contract.same_seed_same_answer,
    contract.global_random_state_is_left_alone,
    contract.runs_are_independent,
    beliefs.inputs_are_left_alone,
    beliefs.beliefs_can_be_used_again,
    beliefs.nothing_is_remembered,
    beliefs.nothing_measured_changes_nothing,
    beliefs.standing_still_changes_nothing,
    beliefs.can_be_sent_to_a_worker,
    answers.missing_beams_say_nothing,
    answers.order_of_beams_does_not_matter,
    answers.headings_are_angles,
    answers.impossible_measurement_is_flagged,
    answers.readings_mean_what_they_mean_to_all,
    answers.agrees_with_the_kalman_filter,
    answers.moves_like_the_kalman_filter,
    answers.claims_what_is_true,
    answers.claims_what_is_true_with_a_heading,
    beliefs.samples_what_it_claims,
)


@dataclass(frozen=True)
class CheckResult:
    """What came of one check.

    Attributes:
        name: The check's name.
        outcome: "passed", "failed", "expected_failure", "unexpected_pass" (a failure was expected, with a
            reason, and did not come: the reason is out of date) or "skipped" (does not apply).
        meaning: What the check claims of every estimator.
        fix: What to look at when it fails.
        detail: What was seen, or the reason of a skip or an expected failure; empty for a pass.
    """

    name: str
    outcome: Outcome
    meaning: str
    fix: str
    detail: str = ""


@dataclass(frozen=True)
class Check:
    """One check of one estimator: call it to have it raise (as pytest wants), or ask for its result.

    Attributes:
        subject: The estimator under test.
        claim: What is claimed of it.
        expected: Why it is known to fail, or empty.
    """

    subject: Subject
    claim: Claim
    expected: str = ""

    @property
    def name(self) -> str:
        """The check's name."""
        return self.claim.name

    def __call__(self) -> None:
        """Run it.

        Raises:
            CheckFailure: If the estimator does not do what is claimed; with what was seen and how to fix it.
            unittest.SkipTest: If the check does not apply to this estimator (pytest takes that for a skip).
            Exception: Whatever the estimator raises.
        """
        try:
            self.claim.test(self.subject)
        except CheckFailure as failure:
            text = f"{self.subject.name}: {failure}\nmeaning: {self.claim.meaning}\nfix: {self.claim.fix}"
            raise CheckFailure(text) from failure.__cause__

    def result(self) -> CheckResult:
        """Run it; no failure of the estimator gets out."""
        outcome: Outcome = "expected_failure" if self.expected else "failed"
        fix = self.claim.fix
        try:
            self.claim.test(self.subject)
            outcome = "unexpected_pass" if self.expected else "passed"
            detail = f"it passes now, take this reason away: {self.expected}" if self.expected else ""
        except SkipTest as skip:
            outcome, detail = "skipped", str(skip)
        except CheckFailure as failure:
            detail = str(failure)
        except (Exception, SystemExit) as error:
            message = " ".join(str(error).split())
            detail = f"{type(error).__name__}: {message}{plugin_line(error.__traceback__)}"
            fix = RAISED
        if outcome == "expected_failure":
            detail = f"{self.expected} ({detail})"
        return CheckResult(self.name, outcome, self.claim.meaning, fix, detail)


def check_names() -> tuple[str, ...]:
    """Names of all checks, in the order in which they run."""
    return tuple(claim.name for claim in CLAIMS)


def checks_for(
    target: str | Factory, *, expected_failures: Mapping[str, str] | None = None, **options: Any
) -> list[Check]:
    """The checks of one estimator, not yet run.

    Args:
        target: What `build` takes (a name, "module:function", "file.py:function"), or the function itself.
        expected_failures: Check name -> why it fails. Such a check must fail: a pass is an error, too.
        options: The estimator's options.

    Raises:
        ValueError: If an expected failure names no check or gives no reason.
    """
    expected = dict(expected_failures or {})
    if unknown := sorted(set(expected) - set(check_names())):
        raise ValueError(f"no check {', '.join(unknown)}; there are {', '.join(check_names())}")
    if bare := sorted(name for name, reason in expected.items() if not str(reason).strip()):
        raise ValueError(f"an expected failure needs a reason: {', '.join(bare)}")
    subject = Subject(target, options)
    return [Check(subject, claim, expected.get(claim.name, "")) for claim in CLAIMS]


def run_checks(
    target: str | Factory, *, expected_failures: Mapping[str, str] | None = None, **options: Any
) -> list[CheckResult]:
    """Run the checks of one estimator; arguments as for `checks_for`.

    Where the estimator cannot be imported or built, the first check says why and the others are skipped.

    Raises:
        KeyError: If there is no such estimator.
        ValueError: If an expected failure names no check or gives no reason.
    """
    if isinstance(target, str):
        with suppress(ImportError):  # that is for the first check to tell
            resolve(target)
    first, *others = checks_for(target, expected_failures=expected_failures, **options)
    results = [first.result()]
    for check in others:
        if results[0].outcome == "failed":
            claim = check.claim
            results.append(CheckResult(claim.name, "skipped", claim.meaning, claim.fix, "it was not built"))
        else:
            results.append(check.result())
    return results


def conforms(results: Iterable[CheckResult]) -> bool:
    """Whether nothing failed and nothing passed that was expected to fail."""
    return not any(result.outcome in BAD for result in results)


def render(results: Sequence[CheckResult]) -> list[str]:
    """Lines to print: each check; what was seen, what it means and how to fix it where it failed; a sum."""
    return [*(line for result in results for line in lines_of(result)), sum_up(results)]


def lines_of(result: CheckResult) -> list[str]:
    """Lines about one check, as `render` prints them."""
    bad = result.outcome in BAD
    word = result.outcome.replace("_", " ")
    lines = [f"{word.upper() if bad else word:17}{result.name}"]
    if result.detail:
        lines.append(f"{'':17}{'seen:  ' if bad else ''}{result.detail}")
    if result.outcome == "failed":
        lines += [f"{'':17}means: {result.meaning}", f"{'':17}fix:   {result.fix}"]
    return lines


def sum_up(results: Sequence[CheckResult]) -> str:
    """How many checks ran, and what came of them."""
    counts = Counter(result.outcome for result in results)
    ran = len(results) - counts["skipped"]
    parts = [f"{count} {outcome.replace('_', ' ')}" for outcome, count in counts.items()]
    return f"{ran} of {len(results)} checks ran: {', '.join(parts)}"


def parametrize_with_checks(
    targets: Iterable[str | Factory], *, expected_failures: Mapping[str, str] | None = None, **options: Any
) -> pytest.MarkDecorator:
    """A pytest decorator that runs a test function once for every check of every target, as `check`.

    Expected failures become strict xfail marks with their reason. Arguments as for `checks_for`; they hold
    for all targets.
    """
    import pytest

    cases = []
    for target in targets:
        for check in checks_for(target, expected_failures=expected_failures, **options):
            marks = [pytest.mark.xfail(reason=check.expected, strict=True)] if check.expected else []
            cases.append(pytest.param(check, marks=marks, id=f"{check.subject.name}-{check.name}"))
    return pytest.mark.parametrize("check", cases)
