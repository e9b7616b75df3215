"""Run the conformance suite in a separate process, because a plug-in may hang or crash."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any

from ...filters.checks import Check, CheckResult, checks_for
from ...filters.registry import resolve
from .look import add_folders
from .process import IsolatedProcess, Limit, Lost, Raised, begin_stage

CHECK_TIMEOUT_S = 60.0
FIX = "Look at that line, or at what the check does; --timeout SECONDS gives it more time."
FIRST_CHECK = "can_be_built"
MAX_LOST_IN_A_ROW = 2  # checks; the rest is not tried


def run_checks_isolated(
    target: str,
    options: Mapping[str, Any],
    expected_failures: Mapping[str, str] | None = None,
    limit: float = CHECK_TIMEOUT_S,
    names: Collection[str] | None = None,
) -> Iterator[CheckResult]:
    """Check one estimator, and yield each result as it comes.

    Where it cannot be imported or built, the first check says why and the others are skipped. A check that
    takes too long, or ends the process, has failed; the others go on in a new one, but after
    MAX_LOST_IN_A_ROW of them they are skipped.

    Args:
        target: What `build` takes.
        options: The estimator's options.
        expected_failures: Check name -> why it fails.
        limit: Longest that importing it, and each check, may take, s.
        names: Names of the checks to run; all of them unless given.

    Raises:
        KeyError: If there is no such estimator.
        ValueError: If an expected failure names no check or gives no reason.
    """
    expected = dict(expected_failures or {})
    checks = checks_for(target, expected_failures=expected, **options)
    checks = [check for check in checks if names is None or check.name in names]
    child, lost, why = IsolatedProcess(), 0, ""
    try:
        try:
            child.ask(_find, (target,), Limit(limit), where=True)
        except Raised as refused:
            if refused.kind == "KeyError":
                raise KeyError(refused.text) from None
        except Lost as stopped:
            yield _lost(checks[0], str(stopped))
            why = "it was not imported"
        for check in checks[1 if why else 0 :]:
            if why:
                yield _skipped(check, why)
                continue
            question = (target, dict(options), expected, check.name)
            try:
                result: CheckResult = child.ask(_result, question, Limit(limit), where=True)
                lost = 0
            except Raised as refused:
                result = _lost(check, str(refused))
            except Lost as stopped:
                result, lost, child = _lost(check, str(stopped)), lost + 1, IsolatedProcess()
            yield result
            if check.name == FIRST_CHECK and result.outcome in ("failed", "expected_failure"):
                why = "it was not built"
            elif lost == MAX_LOST_IN_A_ROW:
                why = f"not tried: {MAX_LOST_IN_A_ROW} checks in a row were lost"
    finally:
        child.kill()


def _find(target: str) -> None:
    """Import it, in the separate process."""
    begin_stage("importing it")
    add_folders(target)
    resolve(target)


def _result(target: str, options: dict[str, Any], expected: dict[str, str], name: str) -> CheckResult:
    """Do one check, in the separate process, which may be a new one."""
    add_folders(target)
    checks = checks_for(target, expected_failures=expected, **options)
    if name == checks[0].name:
        begin_stage("building it")
    return next(check for check in checks if check.name == name).result()


def _lost(check: Check, detail: str) -> CheckResult:
    claim = check.claim
    if check.expected:
        text = f"{check.expected} ({detail})"
        return CheckResult(claim.name, "expected_failure", claim.meaning, FIX, text)
    return CheckResult(claim.name, "failed", claim.meaning, FIX, detail)


def _skipped(check: Check, detail: str) -> CheckResult:
    return CheckResult(check.name, "skipped", check.claim.meaning, check.claim.fix, detail)
