"""What a bound is: a matrix that no covariance can lie below, with its numerical error and its conditions."""

from __future__ import annotations

from dataclasses import dataclass

from ...arrays import Array


class NoBoundError(ValueError):
    """A bound does not apply to a problem; the message says why, in one line."""


@dataclass(frozen=True)
class Bound:
    """A covariance, or what it cannot lie below.

    Attributes:
        name: Such as "ziv-zakai".
        matrix: (n, n), m^2 and rad^2.
        error: What each entry may be off by, (n, n): of a bound already subtracted, so that `matrix` is safe.
        conditions: What was checked, in words, one line each.
    """

    name: str
    matrix: Array
    error: Array
    conditions: tuple[str, ...]
