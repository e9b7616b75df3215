"""Maps, motions, metrics and figures that other packages offer by entry points."""

from __future__ import annotations

import warnings
from functools import cache
from importlib.metadata import entry_points

from .errors import one_line


@cache
def extensions(group: str) -> dict[str, object]:
    """What installed packages offer in an entry-point group, by name, in the order of the names.

    Args:
        group: "rangefix.maps", "rangefix.motions", "rangefix.metrics" or "rangefix.figures".

    Returns:
        The loaded objects. One that cannot be loaded, or takes the name of one before it, is left out with a
        warning that says why.
    """
    loaded: dict[str, object] = {}
    for entry in sorted(entry_points(group=group), key=lambda entry: (entry.name, entry.value)):
        if entry.name in loaded:
            text = (
                f"{group}: {entry.name!r} ({entry.value}) is left out: another package has one of that name"
            )
            warnings.warn(text, RuntimeWarning, stacklevel=2)
            continue
        try:
            loaded[entry.name] = entry.load()
        except Exception as error:  # whatever a stranger's module raises
            text = f"{group}: {entry.name!r} ({entry.value}) cannot be loaded: {one_line(error)}"
            warnings.warn(text, RuntimeWarning, stacklevel=2)
    return loaded
