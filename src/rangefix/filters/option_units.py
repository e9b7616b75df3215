"""Units of options: SI in Python; in studies and commands a suffix of the name, so that none is mistaken."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any, Protocol, TypeVar, runtime_checkable

T = TypeVar("T", bound=Callable[..., Any])
SUFFIXES = {"m": "_m", "rad": "_deg"}  # of a unit in Python -> how a study and a command name such an option
KINDS_OF_UNIT = {"m": "a length", "rad": "an angle"}


@runtime_checkable
class HasOptionUnits(Protocol):
    """A class or function of an estimator whose options have declared units."""

    option_units: Mapping[str, str]


def option_units(**units: str) -> Callable[[T], T]:
    """Declare which options of an estimator are lengths and which are angles.

    Python passes them in metres and radians. A study and `--option` must then write `reach_m`, or `turn_deg`
    in degrees; options that are not named here have no unit, and are written as they are called.

        @option_units(reach="m", turn="rad")
        @dataclass(frozen=True)
        class MyFilter:
            problem: Problem
            reach: float = 0.5
            turn: float = 0.1

    Args:
        **units: Option -> "m" or "rad".

    Raises:
        ValueError: If a unit is another.
    """
    for name, unit in units.items():
        if unit not in SUFFIXES:
            raise ValueError(f"option_units: {name}={unit!r}: the units are {', '.join(SUFFIXES)}")

    def declare(factory: T) -> T:
        factory.option_units = units  # type: ignore[attr-defined]
        return factory

    return declare


def units_of(factory: Callable[..., Any]) -> Mapping[str, str] | None:
    """The declared units of the options of an estimator's class or function; None if it declares none.

    Raises:
        TypeError: If a unit is declared for something that is no option.
    """
    if not isinstance(factory, HasOptionUnits):
        return None
    options = list(inspect.signature(factory).parameters.values())[1:]
    names = {option.name for option in options}
    takes_any = any(option.kind is option.VAR_KEYWORD for option in options)
    if not takes_any and (unknown := sorted(factory.option_units.keys() - names)):
        there = ", ".join(sorted(names)) or "none"
        raise TypeError(f"option_units names {', '.join(unknown)}, no option of it; there are {there}")
    return factory.option_units


def written_name(name: str, units: Mapping[str, str] | None) -> str:
    """How a study and a command name an option: with the suffix of its unit."""
    return name + SUFFIXES.get((units or {}).get(name, ""), "")


def bare_name(written: str) -> str:
    """What an option is called in Python: without the suffix of its unit."""
    for suffix in SUFFIXES.values():
        if written.endswith(suffix):
            return written.removesuffix(suffix)
    return written
