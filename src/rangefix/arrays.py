"""Types of arrays, angles, and how arrays are shown: what every room uses."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import fields
from functools import reduce
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
Scalar = TypeVar("Scalar", bound=np.generic)
Kind = TypeVar("Kind")
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

    Raises:
        ValueError: If an array is masked: what is under the mask would count.
    """
    for field in fields(record):
        value = getattr(record, field.name)
        if isinstance(value, np.ma.MaskedArray):
            raise ValueError(f"{field.name} is a masked array: give one without a mask")
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


def real_number(name: str, value: Any) -> float:
    """A number that a user gives, as a float: Python's, numpy's, or an array without axes.

    Raises:
        ValueError: If it is no real number; the message begins with the name.
    """
    fits = isinstance(value, float | int) or (np.ndim(value) == 0 and hasattr(value, "dtype"))
    array = np.asarray(value) if fits else np.empty(0)
    if array.ndim or array.dtype.kind not in "iuf":
        raise ValueError(f"{name} must be a number, got {value!r}")
    return float(array)


def keep_numbers(record: Any, *names: str) -> None:
    """Put floats in place of a frozen dataclass's fields: see `real_number`.

    Raises:
        ValueError: If one is no real number.
    """
    for name in names:
        object.__setattr__(record, name, real_number(name, getattr(record, name)))


def check_turns(name: str, angle: float) -> None:
    """Refuse an angle of more than ten turns, rad.

    Raises:
        ValueError: If it is: it may be in degrees.
    """
    if abs(angle) > TEN_TURNS:
        raise ValueError(f"{name} is in radians, within ten turns, got {angle:g}: is it in degrees?")


def real_array(name: str, value: Any) -> Array:
    """Numbers that a user gives, as float64: arrays of any layout, lists, tables of pandas.

    Raises:
        ValueError: If they are no real numbers, masked or rows of different lengths; the message begins with
            the name.
    """
    if type(value) is np.ndarray and value.dtype == np.float64:
        return value
    try:
        array = np.asanyarray(value)
    except ValueError:
        raise ValueError(f"{name} must be real numbers, got rows of different lengths") from None
    if isinstance(array, np.ma.MaskedArray):
        raise ValueError(f"{name} must be real numbers, got a masked array: write NaN for what is not known")
    try:
        if value is None or array.dtype.kind not in "biufO":
            raise TypeError
        return np.asarray(array, dtype=np.float64)
    except (TypeError, ValueError):
        got = "None" if value is None else array.dtype.name
        raise ValueError(f"{name} must be real numbers, got {got}") from None


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


def compared_by(*names: str) -> Callable[[type[Kind]], type[Kind]]:
    """Make a class equal, and hash, by attributes of which some may be arrays, as Python alone cannot.

    Args:
        names: The attributes; those of a dataclass that it compares unless given.
    """

    def key(record: Any) -> tuple[Any, ...]:
        these = names or [field.name for field in fields(record) if field.compare]
        return tuple(_nested(getattr(record, name)) for name in these)

    def equal(self: Any, other: object) -> Any:
        return key(self) == key(other) if type(self) is type(other) else NotImplemented

    def hashed(self: Any) -> int:
        return hash(key(self))

    def decorate(kind: type[Kind]) -> type[Kind]:
        setattr(kind, "__eq__", equal)  # noqa: B010
        setattr(kind, "__hash__", hashed)  # noqa: B010
        return kind

    return decorate


def _nested(value: Any) -> Any:
    """Arrays as tuples of tuples, which Python compares and hashes."""
    value = value.tolist() if isinstance(value, np.ndarray) else value
    return tuple(map(_nested, value)) if isinstance(value, list | tuple) else value


def short_repr(record: Any, separator: str = ", ") -> str:
    """What a dataclass is, for people: its fields, long arrays by their size and range."""
    shown = [(field.name, getattr(record, field.name)) for field in fields(record) if field.repr]
    return f"{type(record).__name__}({separator.join(f'{name}={_short(value)}' for name, value in shown)})"


def _short(value: Any) -> str:
    if not isinstance(value, np.ndarray) or value.size <= LONGEST_SHOWN:
        return repr(value)
    ends = f"{value.min():.4g} to {value.max():.4g}"
    return f"<{' x '.join(map(str, value.shape))} numbers from {ends}>"
