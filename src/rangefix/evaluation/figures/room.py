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
from .layout import dpi_of, small
from .style import INK, STAR

BEAM = "#B03A00"
NUMBER = 2.0  # heights of a letter from the number of one beam to that of another
DISC = {"boxstyle": "circle,pad=0.12", "facecolor": "white", "edgecolor": "none"}  # behind a number


def draw_walls(axes: Axes, scene: Scene, width: float = 1.6) -> None:
    """The walls at sensor height, black."""
    ends = scene["segments"].reshape(-1, 2, 2)
    axes.add_collection(LineCollection(list(ends), colors="black", linewidths=width, capstyle="projecting"))


def draw_beams(axes: Axes, scene: Scene, numbers: Iterable[int], named: bool = True) -> None:
    """Beams (from 1) from the true position to the walls that they meet, dashed, with their numbers.

    Set the limits of the axes first: numbers keep inside them, and clear of each other.
    """
    laser = scene.get("laser", scene["truth"])  # older results do not tell it
    heading, start = laser[2], laser[:2]
    taken = [start]
    for number in numbers:
        angle, reach = heading + scene["bearings"][number - 1], scene["ranges"][number - 1]
        if not np.isfinite(reach):
            continue
        step = np.array([np.sin(angle), np.cos(angle)])
        line = np.stack([start, start + reach * step])
        axes.plot(*line.T, color=BEAM, linewidth=1.1, linestyle=(0, (5, 2)))
        place = _label_place(axes, start, step, reach, taken) if named else None
        if place is not None:
            taken.append(place)
            axes.text(
                place[0],
                place[1],
                str(number),
                color=BEAM,
                fontsize=small(),
                ha="center",
                va="center",
                bbox=DISC,
            )


def _label_place(axes: Axes, start: Array, step: Array, reach: float, taken: list[Array]) -> Array | None:
    """Where the number of a beam stands: on it, clear of others, within the view; None if there is no room.

    Where a beam is too short for it, beyond the wall that it meets.
    """
    limits = np.array([axes.get_xlim(), axes.get_ylim()])
    ahead = np.where(step > 0, limits[:, 1], limits[:, 0]) - start
    border = np.min(ahead / np.where(step == 0, 1.0, step), where=step != 0, initial=np.inf)
    view = np.ptp(limits, axis=1)
    inches = axes.get_window_extent()
    dpi = dpi_of(axes)
    scale = float(np.max(view / [inches.width, inches.height]) * dpi)  # metres to the inch, before the layout
    apart = NUMBER * small() / 72 * scale
    least, most = 0.055 * float(view.min()), border - 0.03 * float(view.min())
    first = float(np.clip(0.62 * reach, least, max(most, least)))
    for distance in [first, *np.linspace(first, least, 12), *np.linspace(first, max(most, first), 24)]:
        place = start + distance * step
        if all(np.hypot(*(place - other)) >= apart for other in taken[1:]):
            return np.asarray(place)
    return None


def draw_truth(axes: Axes, scene: Scene, size: float = 11.0, label: str = "true position") -> None:
    """The true position: a white star with a black edge."""
    axes.plot(*scene["truth"][:2], **STAR, markersize=size, zorder=7, label=label)


def draw_density(axes: Axes, density: Array, extent: Array) -> AxesImage:
    """A density over the room, (R, C), darkest at its peak."""
    return axes.imshow(
        density / density.max(), origin="lower", extent=tuple(extent), interpolation="nearest", cmap=INK,
        norm=PowerNorm(0.5, 0.0, 1.0),
    )  # fmt: skip
