"""The map of a study: walls, free space, the prior's box, the true positions and the beams of one run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.patches import Rectangle

from ...arrays import Array
from ...errors import counted
from ..results import Scene
from .data import FigureData
from .room import draw_beams, draw_truth, draw_walls
from .sheet import Sheet
from .style import label_positions

SOLID = "#c9c9c9"
FREE = ListedColormap([SOLID, "#ffffff"])
MOST_TRUTHS = 1000  # drawn
WAYS = 30  # of moving objects


def _frame(axes: Axes, low: Array, high: Array) -> None:
    """Axes of a map from one corner to the other; what lies outside the map is grey."""
    label_positions(axes)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_facecolor(SOLID)
    axes.spines[:].set_visible(False)


def _box(axes: Axes, scene: Scene) -> None:
    """The prior's box, where it is not the whole map."""
    lower, upper = scene["prior_lower"], scene["prior_upper"]
    if np.allclose(np.array([lower, upper]).T.ravel(), scene["extent"], atol=0.02):
        return
    axes.add_patch(Rectangle(tuple(lower), *(upper - lower), fill=False, edgecolor="#0072B2", linewidth=1.8,
                             linestyle="--", zorder=4, label="box of the prior"))  # fmt: skip


def _ways(axes: Axes, ways: Array) -> None:
    """The ways of moving objects, (M, T, 2)."""
    for way in ways[1:WAYS]:
        axes.plot(*way.T, color="#7F7F7F", linewidth=0.5, alpha=0.7, zorder=2)
    label = f"true ways of {counted(len(ways[:WAYS]), 'run')}, dark: the first"
    axes.plot(*ways[0].T, color="black", linewidth=1.4, zorder=3, label=label)


def draw_map(data: FigureData, sheet: Sheet) -> None:
    """The whole map and, where the prior covers a part of it only, that part beside it."""
    results, scene = data.results, data.results.scene
    corners = scene["segments"].reshape(-1, 2)
    limits = np.array([scene["extent"][::2], scene["extent"][1::2]])
    low, high = np.min([limits[0], *corners], axis=0), np.max([limits[1], *corners], axis=0)
    size = high - low
    box = scene["prior_lower"], scene["prior_upper"]
    part = bool(np.prod(box[1] - box[0]) < 0.6 * size.prod())
    corner = 0.02 * size.max()
    views = [(low - corner, high + corner)]
    if part:
        margin = 0.15 * (box[1] - box[0])
        views.append((box[0] - margin, box[1] + margin))
    panels = _panels(sheet, size, views)
    whole, near = panels[0], panels[-1]
    for axes, view in zip(panels, views, strict=True):
        _frame(axes, *view)
    if part:
        sheet.title(whole, "The map: white is free space")
        sheet.title(near, "Where the object may be, and the beams of the first run")
    for axes, width in zip(panels, (0.7, 1.5) if part else (1.6,), strict=True):
        axes.imshow(scene["free"], origin="lower", extent=tuple(scene["extent"]), cmap=FREE, vmin=0, vmax=1,
                    interpolation="nearest", zorder=0)  # fmt: skip
        draw_walls(axes, scene, width)
        _box(axes, scene)
    ways = results.truth[:MOST_TRUTHS][..., results.space.position_indices]
    label = f"true positions, {counted(len(ways), 'run')}"
    near.plot(*ways[:, 0].T, ".", markersize=2.5, color="#7F7F7F", zorder=2, label=label)
    if (ways != ways[:, :1]).any():
        _ways(whole, ways)
    draw_beams(near, scene, range(1, len(scene["bearings"]) + 1), named=len(scene["bearings"]) <= 12)
    lost, beams = np.isinf(scene["ranges"]).sum(), len(scene["ranges"])
    which = f"beams of the first run ({lost} of {beams} do not return)" if lost else "beams of the first run"
    draw_truth(near, scene, label=f"true position and {which}")
    sheet.finish(data.study, panels, columns=3)


def _panels(sheet: Sheet, size: Array, views: Sequence[tuple[Array, Array]]) -> Sequence[Axes]:
    """A panel for each view, beside each other, or below each other where the figure is narrow."""
    count = len(views)
    columns = sheet.layout.columns(count, count, 2.2, beside=0.4)
    options: dict[str, Any] = {"width_ratios": (1, 1.35)} if columns > 1 else {}
    shapes = [float(ratio) for ratio in (np.divide(*(high - low)[::-1]) for low, high in views)]
    if columns < count:
        options["height_ratios"] = [min(1.4, shape) for shape in shapes]
    tallest = sum(min(1.4, shape) for shape in shapes) / count if columns < count else min(1.4, max(shapes))
    height = min(7.5, max(4.2, 4.4 * size[1] / size[0]))
    panels = sheet.panels(
        count,
        columns=columns,
        natural=(4.4 + (5.6 if count > 1 else 2.0), height),
        beside=0.4,
        height=lambda width: (
            tallest * min(width, 4.4) * (1.1 if columns > 1 else 1.0) + 0.6 * sheet.layout.scale
        ),
        **options,
    )
    return list(panels[:, 0])
