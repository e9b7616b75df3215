"""Types of arrays, angles, and how arrays are shown: what every room uses."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import fields
from functools import reduce
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
Scalar = TypeVar("Scalar", bound=np.generic)
TWO_PI = 2.0 * math.pi
TEN_TURNS_DEG = 3600  # angles beyond have lost their digits
TEN_TURNS = 20.0 * math.pi * (1.0 + 1e-12)  # rad: what is beyond may be in degrees, too
LOG_TWO_PI = math.log(TWO_PI)
LARGEST = 2**63 - 1  # whole number that arrays can count
LONGEST_SHOWN = 8  # numbers of an array
KEPT_BYTES = 24 << 20
np.empty(KEPT_BYTES, np.uint8)  # and freed: glibc then keeps what is freed later, and need not clear it


def wrap(angle: Array) -> Array:
    """The same angle in [-pi, pi), rad."""
    return (angle + np.pi) % TWO_PI - np.pi


def within(points: Array, lower: Array, upper: Array) -> BoolArray:
    """Whether points lie in a box or on its sides, (..., n), (n,), (n,) -> (...); not if one is NaN.

    Component by component, for numpy is slow on short rows.
    """
    inside = np.ones(points.shape[:-1], dtype=np.bool_)
    for column, (low, high) in enumerate(zip(lower.tolist(), upper.tolist(), strict=True)):
        inside &= points[..., column] >= low
        inside &= points[..., column] <= high
    return inside


def counted_from(first: IntArray, counts: IntArray) -> IntArray:
    """Of each group first, first + 1, ..., so many, one group after the other: (G,), (G,) -> (N,)."""
    return np.asarray(np.arange(counts.sum()) + np.repeat(first - (np.cumsum(counts) - counts), counts))


def in_groups(counts: IntArray, most: int) -> list[IntArray]:
    """Places of counts, in order, in groups whose counts sum to about `most` or are one alone: (N,)."""
    return np.split(np.arange(len(counts)), np.flatnonzero(np.diff(np.cumsum(counts) // most)) + 1)


def sum_terms(terms: Iterable[Array]) -> Array:
    """Sum over the first axis term by term, for numpy's order depends on the shape."""
    return reduce(np.add, terms)


def read_only(array: NDArray[Scalar]) -> NDArray[Scalar]:
    """The same array, which nobody can write into any more."""
    array.setflags(write=False)
    return array


def for_loops(values: Array) -> Array:
    """The same numbers in C's order, read-only: compiled loops are compiled anew for each kind of array."""
    return read_only(np.ascontiguousarray(values, dtype=np.float64).view())


def keep_copies(record: Any) -> None:
    """Put copies that nobody can change in place of the arrays and lists of a frozen dataclass.

    For its `__post_init__`, where others gave them and may write into theirs. Arrays become read-only arrays,
    lists tuples.
    """
    for field in fields(record):
        value = getattr(record, field.name)
        if isinstance(value, list):
            object.__setattr__(record, field.name, tuple(value))
        elif hasattr(value, "__array__") and not isinstance(value, np.generic):
            object.__setattr__(record, field.name, read_only(np.array(value)))


def whole_number(name: str, value: Any, least: int) -> int:
    """An option that counts something: 1000 for the 1e3 of a TOML file.

    Raises:
        ValueError: If it is no whole number, less than it may be, or too large for 64 bits.
    """
    number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    if not (number and least <= value < np.inf and value == int(value)):
        raise ValueError(f"{name} must be a whole number from {least} on, got {value!r}")
    if int(value) > LARGEST:
        raise ValueError(f"{name} must be a whole number from {least} to {LARGEST}, got a larger one")
    return int(value)


def keep_whole(record: Any, name: str, least: int) -> None:
    """Put a whole number in place of a frozen dataclass's field: see `whole_number`.

    Raises:
        ValueError: If it is none.
    """
    object.__setattr__(record, name, whole_number(name, getattr(record, name), least))


def real_floats(name: str, value: Any) -> Array:
    """What an estimator gives, as float64.

    Raises:
        ValueError: If it is masked, or its numbers are no real ones; the message begins with the name.
    """
    if isinstance(value, np.ma.MaskedArray):
        raise ValueError(f"{name} is a masked array, not one of real floats")
    array = np.asarray(value)
    if array.dtype.kind not in "fiu":
        raise ValueError(f"{name} is of type {array.dtype}, not of real floats")
    return np.asarray(array, dtype=float)


def short_repr(record: Any, separator: str = ", ") -> str:
    """What a dataclass is, for people: its fields, long arrays by their size and range."""
    shown = [(field.name, getattr(record, field.name)) for field in fields(record) if field.repr]
    return f"{type(record).__name__}({separator.join(f'{name}={_short(value)}' for name, value in shown)})"


def _short(value: Any) -> str:
    if not isinstance(value, np.ndarray) or value.size <= LONGEST_SHOWN:
        return repr(value)
    ends = f"{value.min():.4g} to {value.max():.4g}"
    return f"<{' x '.join(map(str, value.shape))} numbers from {ends}>"
