"""The conformance suite: what every estimator does, as tests that ship with the package.

A plug-in's author runs `run_checks("my-filter")`, or lets pytest run each check by itself:

    from rangefix.filters.checks import parametrize_with_checks

    @parametrize_with_checks(["my-filter", "my_module:MyFilter"])
    def test_conforms(check):
        check()

The idea is scikit-learn's estimator checks. Problems are small, seeds fixed; the whole takes seconds.
"""

from .claims import CheckFailure
from .suite import (
    Check,
    CheckResult,
    check_names,
    checks_for,
    conforms,
    lines_of,
    parametrize_with_checks,
    render,
    run_checks,
    sum_up,
)

__all__ = [
    "Check",
    "CheckFailure",
    "CheckResult",
    "check_names",
    "checks_for",
    "conforms",
    "lines_of",
    "parametrize_with_checks",
    "render",
    "run_checks",
    "sum_up",
]
