"""Where estimators fail: the true positions of their worst runs in the map, and how far estimates are off."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from ....arrays import Array
from ...comparison.worst_runs import WorstRun
from ...results import Results, Scene
from ..maps import FREE, SOLID
from ..room import draw_walls
from ..style import label_positions
from .places import Places, colour_of, marker_of

LONGEST, SHORTEST = 4.6, 1.5  # inches: the sides of the map
LEFT, BELOW, RIM = 0.62, 0.5, 0.12  # inches around it, for labels
MARGIN = 0.05  # around what is shown, of its longer side
LARGEST_PART = 0.4  # of the map's area; where more of it is needed, all of it is shown
LARGEST, SMALLEST = (
    7.5,
    3.5,
)  # points: marks of the first and the last estimator, which may stand on each other


def worst_figure(results: Results, runs: Sequence[WorstRun]) -> tuple[Figure, Places]:
    """The map with the worst runs: a mark at each true position, and a line from it to the estimate.

    Args:
        results: The study; its map was saved.
        runs: What is drawn, in the colours of their estimators. An estimate beyond the map is cut at its rim.

    Returns:
        The figure, and where positions stand in it.
    """
    where, scene = list(results.space.position_indices), results.scene
    ends = np.array([[run.truth[where], run.estimate[where]] for run in runs]).reshape(-1, 2, 2)
    low, high = _view(scene, ends[:, 0])
    width, height = np.maximum((high - low) * LONGEST / (high - low).max(), SHORTEST)
    wide, deep = width + LEFT + RIM, height + BELOW + RIM
    figure = Figure(figsize=(wide, deep))
    axes = figure.add_axes((LEFT / wide, BELOW / deep, width / wide, height / deep))
    label_positions(axes)
    axes.set_facecolor(SOLID)
    axes.spines[:].set_visible(False)
    axes.imshow(
        scene["free"], origin="lower", extent=tuple(scene["extent"]), cmap=FREE, vmin=0, vmax=1,
        interpolation="nearest", zorder=0,
    )  # fmt: skip
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.locator_params(nbins=5)
    draw_walls(axes, scene, 1.2)
    sizes = np.linspace(LARGEST, SMALLEST, len(results.estimators))
    for number, (estimator, size) in enumerate(zip(results.estimators, sizes, strict=True)):
        own = ends[[run.estimator == estimator for run in runs]]
        lines = LineCollection(list(own), colors=colour_of(number), linewidths=0.8, alpha=0.6, zorder=3)
        axes.add_collection(lines, autolim=False)
        axes.plot(
            *own[:, 0].T, marker_of(number), color=colour_of(number), markersize=size, zorder=4,
            markeredgecolor="white", markeredgewidth=0.4,
        )  # fmt: skip
    return figure, Places(figure, axes)


def _view(scene: Scene, truths: Array) -> tuple[Array, Array]:
    """Corners of what is shown: the prior's box and all true positions, or the whole map."""
    first, last = np.array([scene["extent"][::2], scene["extent"][1::2]])
    low = np.maximum(np.min([scene["prior_lower"], *truths], axis=0), first)
    high = np.minimum(np.max([scene["prior_upper"], *truths], axis=0), last)
    if np.prod(high - low) > LARGEST_PART * np.prod(last - first):
        low, high = first, last
    margin = max(MARGIN * float((high - low).max()), 1e-3)
    return low - margin, high + margin
