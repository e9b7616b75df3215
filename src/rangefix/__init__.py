"""rangefix: how far an indoor position estimate from a map and a rangefinder can be trusted.

The names of daily use are offered here and loaded when they are first asked for, so that `import rangefix`
costs nothing; everything else is in `rangefix.maps`, `rangefix.filters` and `rangefix.evaluation`.
"""

from __future__ import annotations

from importlib import import_module

TYPE_CHECKING = False  # as in `typing`, which takes time to load: Ctrl-C meanwhile would show a traceback
if TYPE_CHECKING:
    from typing import Any

    from .evaluation import credibility, load, load_study, run, summarise, write_report
    from .filters import Gaussian, Problem, Rangefinder, Stationary, Uniform, available, build
    from .filters.space import pose_space, position_space
    from .maps import FloorPlan, MeshRoom, RectangularRoom

__version__ = "0.1.0"
__all__ = [
    "FloorPlan",
    "Gaussian",
    "MeshRoom",
    "Problem",
    "Rangefinder",
    "RectangularRoom",
    "Stationary",
    "Uniform",
    "available",
    "build",
    "credibility",
    "load",
    "load_study",
    "pose_space",
    "position_space",
    "run",
    "summarise",
    "write_report",
]
_ROOMS = ("maps", "filters", "evaluation")


def __getattr__(name: str) -> Any:
    """Load a name of `__all__`, or one of the three rooms, when it is first asked for."""
    if name in _ROOMS:
        return import_module(f".{name}", __name__)
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    rooms = ("evaluation",) if name == "load" else _ROOMS  # results, not maps
    modules = (import_module(f".{room}", __name__) for room in rooms)
    value = globals()[name] = next(getattr(module, name) for module in modules if name in module.__all__)
    return value


def __dir__() -> list[str]:
    return sorted({*__all__, *_ROOMS, "__version__"})
