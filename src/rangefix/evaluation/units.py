"""Units in which people read the components of a state: headings in degrees, all else as computed."""

from __future__ import annotations

import math


def unit(name: str) -> str:
    """The unit in which a component is shown."""
    return {"heading": "deg", "v1": "m/s", "v2": "m/s"}.get(name, "m")


def factor(name: str) -> float:
    """By how much a figure of a component, in m, m/s or rad, is multiplied to be shown."""
    return math.degrees(1.0) if name == "heading" else 1.0
