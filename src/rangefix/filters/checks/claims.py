"""What a conformance check is made of: the estimator under test, the claim, and how a failure reads."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any
from unittest import SkipTest

import numpy as np

from ...arrays import Array
from ..estimate import Estimate
from ..estimator import Estimator
from ..problem import Problem
from ..registry import build_with, resolve

Factory = Callable[..., Any]
SURE = 6.0  # standard errors
NOISY = 0.5  # the most that a mean may scatter between seeds, in standard deviations of the posterior


class CheckFailure(AssertionError):
    """An estimator does not do what a check claims; the message says what was seen."""


@dataclass(frozen=True)
class Subject:
    """An estimator under test: a name that `build` knows, or a function of a problem and options."""

    target: str | Factory
    options: dict[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The name to print."""
        return self.target if isinstance(self.target, str) else getattr(self.target, "__name__", "estimator")

    @property
    def factory(self) -> Factory:
        """The function or class that makes the estimator."""
        factory: Factory = resolve(self.target) if isinstance(self.target, str) else self.target
        return factory

    def build(self, problem: Problem) -> Estimator[Any]:
        """The estimator for a problem.

        Raises:
            TypeError: If it has no such option, or lacks one of the four verbs.
            ValueError: If it is not made for such a problem.
        """
        return build_with(self.name, self.factory, problem, self.options)

    def build_or_skip(self, problem: Problem) -> Estimator[Any]:
        """As `build`; skips the check if the estimator is not made for such a problem and says so."""
        try:
            return self.build(problem)
        except ValueError as refusal:
            raise SkipTest(f"refuses this problem: {refusal}") from None


@dataclass(frozen=True)
class Claim:
    """One thing that every estimator does: its name, what it means, how to fix it, and the test of it."""

    name: str
    meaning: str
    fix: str
    test: Callable[[Subject], None]


def claim(fix: str) -> Callable[[Callable[[Subject], None]], Claim]:
    """Make a claim of a test; the first paragraph of its docstring is what it means."""

    def make(test: Callable[[Subject], None]) -> Claim:
        meaning = " ".join((test.__doc__ or "").split("\n\n")[0].split())
        return Claim(test.__name__, meaning, fix, test)

    return make


def need(condition: bool | np.bool_, seen: str) -> None:
    """Fail the check unless the condition holds."""
    if not condition:
        raise CheckFailure(seen)


def need_same(first: Estimate, second: Estimate, when: str) -> None:
    """Fail the check unless two estimates are equal bit for bit."""
    for name, one, two in zip(Estimate._fields, first, second, strict=True):
        if not np.array_equal(one, two, equal_nan=True):
            gap = np.nanmax(np.abs(np.subtract(one, two))) if np.shape(one) == np.shape(two) else np.nan
            raise CheckFailure(f"{name} differs by up to {gap:.3g} {when}")


def deviations(estimate: Estimate, reference: Estimate, problem: Problem, turn: float = 0.0) -> Array:
    """How far estimates are from a reference, run by run, in units of the reference's own spread.

    With L L' the first reference covariance: L^-1 (mean - mean'), L^-1 (P - P') L'^-1 and the log evidences'
    difference, side by side, (M, n + n n + 1). The estimates' headings are turned back by `turn` first.
    """
    space = problem.space
    size = space.size
    scale = np.linalg.inv(np.linalg.cholesky(np.asarray(reference.covariance).reshape(-1, size, size)[0]))
    means = space.difference(estimate.mean - turn * space.is_angle, reference.mean) @ scale.T
    covariances = scale @ (estimate.covariance - reference.covariance) @ scale.T
    evidences = np.atleast_1d(np.subtract(estimate.log_evidence, reference.log_evidence))
    return np.concatenate([means, covariances.reshape(len(means), -1), evidences[:, None]], axis=1)


def need_agreement(differences: Array, allowed: Array | float, size: int, whom: str) -> None:
    """Fail the check unless deviations average to zero, but for what is allowed and SURE standard errors.

    An estimator that draws nothing gives the same in every run and is held to what is allowed; the band of
    one that draws comes from its own scatter between runs, which must not exceed NOISY for the mean. A NaN
    evidence, not computed, is passed over.

    Args:
        differences: From `deviations`, (M, n + n n + 1), of runs that differ by seed alone.
        allowed: What the average may be off by besides, one number or one for each column.
        size: The number n of components.
        whom: What was compared with, for the message.

    Raises:
        CheckFailure: If they do not, or one is not finite.
    """
    need(
        bool(np.isfinite(differences[:, :-1]).all()),
        f"mean or covariance is not finite, compared with {whom}",
    )
    scatter = differences.std(0, ddof=1)
    noise = scatter[:size].max()
    need(noise <= NOISY, f"the mean is off {whom} by up to {noise:.2g} standard deviations, changing by seed")
    average = differences.mean(0)
    band = allowed + SURE * scatter / np.sqrt(len(differences))
    checked = ~np.isnan(average)
    checked[:-1] = True
    wrong = checked & ~(np.abs(average) <= band)
    kinds = ["mean"] * size + ["covariance"] * size**2 + ["log evidence"]
    units = {"mean": " claimed standard deviations", "covariance": " times the variance", "log evidence": ""}
    if wrong.any():
        worst = int(np.argmax(np.where(wrong, np.nan_to_num(np.abs(average) / band, nan=np.inf), 0.0)))
        kind = kinds[worst]
        raise CheckFailure(
            f"the {kind} is off {whom} by {average[worst]:.3g}{units[kind]}; {band[worst]:.2g} is allowed"
        )
