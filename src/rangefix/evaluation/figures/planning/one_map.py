"""A map on its own: walls, free space in white, and what it is in words."""

from __future__ import annotations

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from ....arrays import Array
from ....maps.describe import Description
from ..maps import FREE, SOLID
from ..style import label_positions

LONGEST, SHORTEST = 7.5, 3.0  # inches


def draw_one_map(described: Description, segments: Array, title: str) -> Figure:
    """The walls of a map over its free space.

    Args:
        described: What the map is.
        segments: Its walls, m, (S, 4).
        title: Above the picture.
    """
    low, high = np.array(described.lower), np.array(described.upper)
    edge = 0.03 * float((high - low).max())
    shape = np.clip((high - low) / (high - low).max(), SHORTEST / LONGEST, 1.0)
    figure = Figure(figsize=tuple(LONGEST * shape + [0.4, 0.8]), layout="constrained")
    axes = figure.subplots()
    lower, upper = described.raster.lower, described.raster.upper
    extent = (lower[0], upper[0], lower[1], upper[1])
    axes.imshow(
        described.free.T, origin="lower", extent=extent, cmap=FREE, vmin=0, vmax=1, interpolation="nearest"
    )
    width = 1.6 if len(segments) < 500 else 0.6
    axes.add_collection(LineCollection(list(segments.reshape(-1, 2, 2)), colors="black", linewidths=width))
    axes.set_xlim(low[0] - edge, high[0] + edge)
    axes.set_ylim(low[1] - edge, high[1] + edge)
    axes.set_facecolor(SOLID)
    axes.set_aspect("equal")
    label_positions(axes)
    axes.set_title(f"{title}\n{described}", wrap=True)
    return figure
