"""The figures of a row in words: whether an estimator's covariance may be trusted."""

from __future__ import annotations

import math

from .summary import Row

MUCH = 1.5  # ANEES / n beyond this, or its inverse, is no longer "a little"


def overconfident(row: Row) -> bool:
    """Whether the interval of ANEES / n lies above 1: the errors are larger than claimed."""
    return row.anees.value == math.inf or row.anees.low > 1


def verdict(row: Row) -> str:
    """One phrase on a row, for readers who do not know what ANEES is.

    The factor is ANEES / n: how many times larger the squared errors are than the covariance claims.
    """
    value = row.anees.value
    if not row.ok:
        return "no run went well"
    if math.isinf(value):
        return "DO NOT TRUST: claims certainty, and errs"
    if overconfident(row):
        times = f"claims {_times(value)} times too little"
        return f"DO NOT TRUST: {times}" if value > MUCH else f"a little overconfident: {times}"
    if row.anees.high < 1:
        times = f"claims {_times(1 / value)} times too much"
        return f"too cautious: {times}" if 1 / value > MUCH else f"a little cautious: {times}"
    return "honest: errs as it claims"


def _times(factor: float) -> str:
    """A factor to two digits, or to three from 100."""
    return f"{factor:.0f}" if factor >= 9.5 else f"{factor:.2g}"


def name_beams(label: str) -> str:
    """The label of a set of beams in words: "1" -> "beam 1", "1+2" -> "beams 1 + 2"."""
    if label == "all":
        return "all beams"
    several = "+" in label or "-" in label
    return f"beam{'s' * several} {label.replace('+', ' + ')}"


def short(value: float) -> str:
    """Three digits, and no powers of ten below a million."""
    return f"{value:.0f}" if 100 <= abs(value) < 1e6 else f"{value:.3g}"
