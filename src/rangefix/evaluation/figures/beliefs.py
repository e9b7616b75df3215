"""What estimators believe of one run: densities over the room and over the heading, beside what is true."""

from __future__ import annotations

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from ...arrays import Array
from ..results import Picture, Results, Scene
from .data import FigureData
from .errors import ellipse
from .room import BEAM, draw_density, draw_truth, draw_walls
from .style import CLAIMED, finish, label_positions, panel_title

MAX_BELIEFS_SHOWN = 6  # estimators side by side
TURNS = np.arange(-3, 4)  # over which a Gaussian heading is wrapped
BELL = np.linspace(-4, 4, 81)  # standard deviations at which its bell is drawn besides


def beliefs_figure(data: FigureData) -> Figure:
    """A column for each estimator: the room, and the heading where it is estimated; run 0, last measurement.

    A density where the estimator has one to show; the 95 % ellipse and the Gaussian of what it claims.
    """
    results, pictures = data.results, data.pictures
    estimators = results.estimators[:MAX_BELIEFS_SHOWN]
    turning = bool(results.space.is_angle.any())
    scene = dict(results.scene) | {"truth": results.space.poses(results.truth[0, -1])}
    left, right, lower, upper = scene["extent"]
    height = min(4.6, max(1.6, 2.2 * (upper - lower) / (right - left)))
    size = (0.7 + 2.25 * len(estimators), 1.3 + height + 1.9 * turning)
    figure = Figure(figsize=size, layout="constrained")
    ratios = (height, 1.5) if turning else (height,)
    panels = figure.subplots(len(ratios), len(estimators), squeeze=False, height_ratios=ratios)
    for column, estimator in enumerate(estimators):
        trials = results.get(estimator, data.beams)
        mean, covariance = trials.mean[0, -1], trials.covariance[0, -1]
        panel_title(panels[0, column], data.labels[estimator])
        _room(panels[0, column], results, scene, pictures.get(estimator), mean, covariance)
        if turning:
            place = int(np.flatnonzero(results.space.is_angle)[0])
            claim = mean[place], np.sqrt(max(covariance[place, place], 0.0))
            _heading(panels[1, column], scene, pictures.get(estimator), *claim)
        for row in range(len(ratios)):
            if column:
                panels[row, column].set_ylabel("")
    limits = np.array([[axes.get_xlim(), axes.get_ylim()] for axes in panels[0]])
    for axes in panels[0]:
        axes.set_xlim(limits[:, 0, 0].min(), limits[:, 0, 1].max())
        axes.set_ylim(limits[:, 1, 0].min(), limits[:, 1, 1].max())
    more: dict[str, Artist] = {
        "posterior density, darkest at its peak": Patch(facecolor="#4f94c4"),
        "true heading": Line2D([], [], color=BEAM, linewidth=1.2, linestyle="--"),
    }
    which = f"run {data.run}" if data.run else "the first run"
    title = data.heading(f"What is believed in {which}", with_beams=True)
    return finish(figure, title, panels.flat, columns=2, more=more)


def _room(
    axes: Axes, results: Results, scene: Scene, picture: Picture | None, mean: Array, covariance: Array
) -> None:
    left, right, lower, upper = scene["extent"]
    if picture is not None and picture.density.max() > 0:
        draw_density(axes, picture.density, picture.extent)
    draw_walls(axes, scene)
    where = results.space.position_indices
    if np.isfinite(mean).all():
        claim = covariance[np.ix_(where, where)]
        label = "claimed: mean, 95 % ellipse, and the Gaussian of the heading"
        axes.add_patch(ellipse(claim, tuple(mean[where]), edgecolor=CLAIMED, linewidth=1.6, zorder=5))
        axes.plot(*mean[where], "o", markersize=4.5, markerfacecolor="white", color=CLAIMED, zorder=6,
                  label=label)  # fmt: skip
    size = max(right - left, upper - lower)
    heading = scene["truth"][2]
    tip = scene["truth"][:2] + 0.12 * size * np.array([np.sin(heading), np.cos(heading)])
    axes.plot(*zip(scene["truth"][:2], tip, strict=True), color=BEAM, linewidth=1.6, zorder=6)
    draw_truth(axes, scene, label="true position, its heading beside it")
    label_positions(axes)
    low, high = np.array([left, lower]), np.array([right, upper])
    seen = np.array([low, high, tip, *([mean[where]] if np.isfinite(mean).all() else [])])
    seen = np.clip(seen, low - 0.25 * size, high + 0.25 * size)  # a mean may be anywhere
    start, end = seen.min(0) - 0.04 * size, seen.max(0) + 0.04 * size
    axes.set_xlim(start[0], end[0])
    axes.set_ylim(start[1], end[1])
    axes.spines[:].set_visible(False)


def _heading(axes: Axes, scene: Scene, picture: Picture | None, mean: float, std: float) -> None:
    """Densities over the heading, 0 to 360 deg clockwise from +x2, per degree."""
    per_degree = np.pi / 180
    if picture is not None and picture.headings.size:
        edges = np.rad2deg(picture.headings)
        density = picture.heading_density * per_degree
        for turn in (-360.0, 0.0, 360.0):
            axes.stairs(
                density, edges + turn, fill=True, facecolor="#9CC7E4", edgecolor="#1b4f8a", linewidth=0.8
            )
        axes.set_ylim(0, 1.15 * density.max())
    if np.isfinite(mean) and std > 0:
        angles = np.unique(
            np.append(np.linspace(0, 360, 721), np.rad2deg(mean) % 360 + std / per_degree * BELL)
        )
        away = np.deg2rad(angles)[:, None] - mean - 2 * np.pi * TURNS
        bell = (np.exp(-0.5 * (away / std) ** 2).sum(1) / (std * np.sqrt(2 * np.pi))) * per_degree
        axes.plot(angles, bell, color=CLAIMED, linewidth=1.6)
        if picture is None:
            axes.set_ylim(0, 1.15 * bell.max())
    axes.axvline(np.rad2deg(scene["truth"][2]) % 360, color=BEAM, linewidth=1.2, linestyle="--")
    axes.set_xlim(0, 360)
    axes.set_xticks(range(0, 361, 90))
    axes.set_xlabel("heading, deg from $+x_2$")
    axes.set_ylabel("density, 1/deg")
    axes.tick_params(axis="y", labelsize=7)
