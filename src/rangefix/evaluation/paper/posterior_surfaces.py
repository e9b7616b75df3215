"""Posterior densities of the paper's Figs. 2 and 3 as surfaces over the room."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ...arrays import Array, IntArray
from ..consistency.formatting import beams_in_words
from ..figures import Layout
from ..figures.layout import line_height, wrapped
from ..figures.style import INK, STAR, symbol
from .table1 import Paper

COARSE = 10  # cells between the lines of a surface where it is flat
AZIMUTH = -58.0  # deg, from where the surfaces are seen
BESIDE = 0.6  # inches
CLOSE_UP = 0.3  # m
TICKS, FEW_TICKS = (4, 6, 5), (2, 3, 3)  # of x1, x2 and the density, less one
SURFACE: dict[str, Any] = {
    "cmap": INK, "linewidth": 0, "antialiased": False, "rasterized": True, "shade": False, "zorder": 2,
}  # fmt: skip


def _lines(density: Array, axis: int) -> IntArray:
    """Which rows (axis 0) or columns (1) carry the surface: all where it changes, else every COARSE-th."""
    change = np.abs(np.diff(density, axis=axis)).max(axis=1 - axis) > 0.004 * density.max()
    wanted = np.arange(density.shape[axis]) % COARSE == 0
    wanted[-1] = True
    wanted[:-1] |= change
    wanted[1:] |= change
    return np.flatnonzero(wanted)


def _closed(centres: Array) -> Array:
    """The cell centres with the outer edges of the first and last cell, where the surface goes down to 0."""
    half = (centres[1] - centres[0]) / 2
    return np.concatenate([[centres[0] - half], centres, [centres[-1] + half]])


def _surface(axes: Any, paper: Paper, beams: str, half_width: float, ticks: tuple[int, int, int]) -> None:
    """The density over the room, or over the square of that half width about the true position.

    Args:
        axes: Three-dimensional.
        paper: The posteriors.
        beams: The set of beams.
        half_width: Metres; inf for the whole room.
        ticks: At most so many and one more on each axis.
    """
    density, scene = paper.densities[beams], paper.scene
    truth = scene["truth"][:2]
    near = [np.abs(centres - value) <= half_width for centres, value in zip(paper.axes, truth, strict=True)]
    x1, x2 = (centres[part] for centres, part in zip(paper.axes, near, strict=True))
    density = density[np.ix_(near[1], near[0])]
    peak = float(density.max())
    foot = density[np.abs(x2 - truth[1]).argmin(), np.abs(x1 - truth[0]).argmin()]
    x1, x2, density = _closed(x1), _closed(x2), np.pad(density, 1)
    rows, columns = _lines(density, 0), _lines(density, 1)
    axes.plot_surface(
        *np.meshgrid(x1[columns], x2[rows]),
        density[np.ix_(rows, columns)],
        norm=PowerNorm(0.6, -0.06 * peak, peak),
        rcount=len(rows),
        ccount=len(columns),
        **SURFACE,
    )
    towards = np.array([np.cos(np.radians(AZIMUTH)), np.sin(np.radians(AZIMUTH))])
    for x1a, x2a, x1b, x2b in scene["segments"] if np.isinf(half_width) else ():
        front = towards @ (np.array([x1a + x1b, x2a + x2b]) / 2 - truth) > 0
        axes.plot([x1a, x1b], [x2a, x2b], [0, 0], color="black", linewidth=1.4, zorder=3 if front else 1)
    top = 1.15 * peak
    axes.plot(
        [truth[0]] * 2, [truth[1]] * 2, [foot, top], color="black", linewidth=0.9, linestyle=":", zorder=4
    )
    axes.plot(*truth, top, **STAR, markersize=10, zorder=5, label="true position")
    width, length = np.ptp(x1), np.ptp(x2)
    axes.set_xlim(x1[0], x1[-1])
    axes.set_ylim(x2[0], x2[-1])
    axes.set_zlim(0, top)
    axes.set_box_aspect((width, length, 0.55 * max(width, length)), zoom=1.04)
    axes.view_init(elev=30, azim=AZIMUTH)
    axes.set_xlabel(f"{symbol('x1')}, m", labelpad=-3)
    axes.set_ylabel(f"{symbol('x2')}, m", labelpad=-2)
    axes.set_zlabel("density, 1/m\u00b2", labelpad=-2)
    for axis, most in zip((axes.xaxis, axes.yaxis, axes.zaxis), ticks, strict=True):
        axis.set_major_locator(MaxNLocator(most, steps=[1, 2, 5, 10]))
    axes.tick_params(pad=-2)


def posterior_surfaces(paper: Paper, beam_sets: Sequence[str], title: str, layout: Layout) -> Figure:
    """Posterior densities as surfaces over the room; a single one with a close-up beside it."""
    panels = [(beams, np.inf, beams_in_words(beams).capitalize()) for beams in beam_sets]
    if len(panels) == 1:
        panels.append((beam_sets[0], CLOSE_UP, f"The same, within {CLOSE_UP:g} m of the true position"))
    columns = layout.columns(len(panels), 3, 1.65)
    rows = -(-len(panels) // columns)
    size = (3.5 * columns, 3.1 * rows + 0.4) if rows > 1 else (8.6, 4.2)
    ticks, margins = TICKS, {"left": 0.01, "right": 0.91, "bottom": 0.09, "top": 0.94, "wspace": 0.2}
    if layout.width is not None:
        title = wrapped(title, layout.width - 0.15, "figure.titlesize")
        wide = layout.width / columns
        above = (title.count("\n") + 1) * line_height("figure.titlesize") * layout.titles + 0.3
        below = 2.5 * line_height("legend.fontsize") + 0.2
        size = (layout.width, above + below + rows * (0.85 * wide + 0.15))
        beside = BESIDE * layout.scale  # of each panel, for the labels of the density
        width = (layout.width - 0.1 - columns * beside) / columns
        margins = {"left": 0.1 / size[0], "right": 1 - beside / size[0], "wspace": beside / width}
        margins |= {"bottom": below / size[1], "top": 1 - above / size[1]}
        ticks = TICKS if wide > 2.6 * layout.scale else FEW_TICKS
    figure = Figure(figsize=size)
    for i, (beams, half_width, name) in enumerate(panels):
        axes: Any = figure.add_subplot(rows, columns, i + 1, projection="3d", computed_zorder=False)
        _surface(axes, paper, beams, half_width, ticks)
        if layout.width is not None:
            name = wrapped(name, 0.8 * layout.width / columns, "axes.titlesize")
        axes.set_title(name, y=0.96, loc="center")
    figure.subplots_adjust(hspace=0.14, **margins)
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="lower center")
    if layout.titles:
        figure.suptitle(title)
    return figure
