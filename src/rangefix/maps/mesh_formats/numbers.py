"""Numbers in text, many at a time."""

from __future__ import annotations

import warnings

import numpy as np

from ...arrays import Array


def numbers_in(text: bytes, what: str) -> Array:
    """All numbers of a text that holds nothing else.

    Raises:
        ValueError: If there is anything else in it.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return np.fromstring(text, dtype=np.float64, sep=" ") if text.strip() else np.empty(0)
        except (DeprecationWarning, ValueError):
            raise ValueError(f"{what} that is no number") from None


def refuse_half_number(text: bytes, vertices: int) -> None:
    """Refuse a text that ends within a line, if its last number may be the first half of a vertex.

    Raises:
        ValueError: If it is.
    """
    last = (text[text.rfind(b"\n") + 1 :].split() or [b""])[-1]
    if last == text[-len(last) :] and last.isdigit() and 10 * int(last) < vertices:
        raise ValueError(
            f"its last line ends with {int(last)} and no newline: cut short? If it is whole, end it with one"
        )


def whole(values: Array, what: str) -> np.ndarray:
    """Numbers as integers.

    Raises:
        ValueError: If one is not whole, or not finite.
    """
    with np.errstate(invalid="ignore"):
        rounded = np.where(np.abs(values) < 2**53, values, -1).astype(np.int64)
    if not (rounded == values).all():
        raise ValueError(f"{what} that is no whole number")
    return rounded
