"""What maps of a room show: walls, beams, the true position and densities, from a saved scene."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import PowerNorm
from matplotlib.image import AxesImage

from ...arrays import Array
from ..results import Scene
from .style import INK, STAR

BEAM = "#B03A00"
DISC = {"boxstyle": "circle,pad=0.12", "facecolor": "white", "edgecolor": "none"}  # behind a number


def draw_walls(axes: Axes, scene: Scene, width: float = 1.6) -> None:
    """The walls at sensor height, black."""
    ends = scene["segments"].reshape(-1, 2, 2)
    axes.add_collection(LineCollection(list(ends), colors="black", linewidths=width, capstyle="projecting"))


def draw_beams(axes: Axes, scene: Scene, numbers: Iterable[int], named: bool = True) -> None:
    """Beams (from 1) from the true position to the walls that they meet, dashed, with their numbers.

    Set the limits of the axes first: numbers keep inside them.
    """
    heading, start = scene["truth"][2], scene["truth"][:2]
    for number in numbers:
        angle, reach = heading + scene["bearings"][number - 1], scene["ranges"][number - 1]
        if not np.isfinite(reach):
            continue
        step = np.array([np.sin(angle), np.cos(angle)])
        line = np.stack([start, start + reach * step])
        axes.plot(*line.T, color=BEAM, linewidth=1.1, linestyle=(0, (5, 2)))
        if named:
            x1, x2 = start + _label_distance(axes, start, step, reach) * step
            axes.text(x1, x2, str(number), color=BEAM, fontsize=8, ha="center", va="center", bbox=DISC)


def _label_distance(axes: Axes, start: Array, step: Array, reach: float) -> float:
    """How far along a beam its number stands: clear of the start, within the view."""
    limits = np.array([axes.get_xlim(), axes.get_ylim()])
    ahead = np.where(step > 0, limits[:, 1], limits[:, 0]) - start
    border = np.min(ahead / np.where(step == 0, 1.0, step), where=step != 0, initial=np.inf)
    view = float(np.ptp(limits, axis=1).min())
    return float(np.clip(0.62 * reach, 0.055 * view, max(border - 0.03 * view, 0.055 * view)))


def draw_truth(axes: Axes, scene: Scene, size: float = 11.0, label: str = "true position") -> None:
    """The true position: a white star with a black edge."""
    axes.plot(*scene["truth"][:2], **STAR, markersize=size, zorder=7, label=label)


def draw_density(axes: Axes, density: Array, extent: Array) -> AxesImage:
    """A density over the room, (R, C), darkest at its peak."""
    return axes.imshow(
        density / density.max(), origin="lower", extent=tuple(extent), interpolation="nearest", cmap=INK,
        norm=PowerNorm(0.5, 0.0, 1.0),
    )  # fmt: skip
