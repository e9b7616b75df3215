"""Directions as they are typed, in degrees."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..arrays import Array

MOST_DIRECTIONS = 100_000


def read_directions(text: str, option: str, else_: str = "") -> Array:
    """Directions as they are written, deg, -> rad, (D,).

    Args:
        text: -90,0,90 or -90:90:15 (from:to:step).
        option: The option that they were given by.
        else_: What else it may be, for the mistake.

    Raises:
        ValueError: As `read_degrees`; or if one stands twice.
    """
    import numpy as np

    degrees = read_degrees(text, option, else_)
    if len(np.unique(np.round(degrees % 360, 9))) < len(degrees):
        raise ValueError(f"{option} {text}: a direction stands twice")
    return np.deg2rad(degrees)


def refuse_turns(name: str, *degrees: float) -> None:
    """Refuse angles beyond ten turns, as studies do: they have lost their digits, or are no angles.

    Raises:
        ValueError: If there is one; NaN, too.
    """
    from ..arrays import TEN_TURNS_DEG  # with numpy, which --help need not wait for

    for angle in degrees:
        if not abs(angle) <= TEN_TURNS_DEG:
            limits = f"from -{TEN_TURNS_DEG} to {TEN_TURNS_DEG} deg"
            raise ValueError(f"{name}: an angle must be {limits}, got {angle:g}")


def read_degrees(text: str, option: str, else_: str = "") -> Array:
    """Directions as they are written, (D,), deg.

    Args:
        text: -90,0,90 or -90:90:15 (from:to:step).
        option: The option that they were given by.
        else_: What else it may be, for the mistake.

    Raises:
        ValueError: If they are no numbers, none, too many, not finite or beyond ten turns.
    """
    import numpy as np

    try:
        if ":" in text:
            low, high, step = map(float, text.split(":"))
            count = np.floor((high - low) / step * (1 + 1e-12)) + 1
            degrees = low + step * np.arange(count if count <= MOST_DIRECTIONS else 0)
        else:
            degrees = np.array([float(part) for part in text.replace(",", " ").split()])
    except ZeroDivisionError:
        raise ValueError(f"{option} {text}: the step must not be 0") from None
    except ValueError:
        raise ValueError(
            f"{option} needs numbers such as -90,0,90 or -90:90:15{else_}, got {text!r}"
        ) from None
    if not len(degrees) or not np.isfinite(degrees).all() or len(degrees) > MOST_DIRECTIONS:
        raise ValueError(f"{option} {text}: name 1 to {MOST_DIRECTIONS} finite directions")
    refuse_turns(option, *degrees)
    return degrees
