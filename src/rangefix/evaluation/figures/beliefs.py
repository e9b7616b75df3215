"""What estimators believe of one run: densities over the room and over the heading, beside what is true."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FixedLocator

from ...arrays import Array
from ...filters.space import StateSpace
from ..results import Picture, Scene
from .data import FigureData
from .errors import ellipse
from .layout import MAX_BESIDE, small
from .room import BEAM, draw_density, draw_truth, draw_walls
from .sheet import Sheet
from .style import CLAIMED, label_positions, symbol
from .ticks import FittingLocator, even_numbers

TURNS = np.arange(-3, 4)  # over which a Gaussian heading is wrapped
SMALL, ENLARGED = 0.12, 0.4  # of the shorter side of a room: a belief that is shown enlarged, and how large
PAPER = {"facecolor": "white", "edgecolor": "none", "pad": 0.5}  # behind a text on a map
BELL = np.linspace(-4, 4, 81)  # standard deviations at which its bell is drawn besides


class _Shown(NamedTuple):
    """What one estimator believes, and what is true."""

    space: StateSpace
    scene: Scene
    picture: Picture | None
    mean: Array
    covariance: Array

    @property
    def place(self) -> Array:
        """Mean of x1 and x2, m, (2,)."""
        return self.mean[self.space.position_indices]

    @property
    def claim(self) -> Array:
        """Covariance of x1 and x2, m^2, (2, 2)."""
        where = self.space.position_indices
        return self.covariance[np.ix_(where, where)]

    def draw_below(self, axes: Axes) -> None:
        """Density and walls."""
        if self.picture is not None and self.picture.density.max() > 0:
            draw_density(axes, self.picture.density, self.picture.extent)
        draw_walls(axes, self.scene)

    def draw_claim(self, axes: Axes, size: float, label: str | None = None) -> None:
        """The ellipse that is claimed, and its mean as a circle of a size in points."""
        axes.add_patch(ellipse(self.claim, tuple(self.place), edgecolor=CLAIMED, linewidth=1.6, zorder=5))
        axes.plot(
            *self.place, "o", markersize=size, markerfacecolor="white", color=CLAIMED, zorder=6, label=label
        )


def draw_posterior(data: FigureData, sheet: Sheet) -> None:
    """A block for each estimator: the room, and the heading where it is estimated; run 0, last measurement.

    A density where the estimator has one to show; the 95 % ellipse and the Gaussian of what it claims.
    """
    results, pictures, estimators = data.results, data.pictures, data.answering
    turning = bool(results.space.is_angle.any())
    scene = dict(results.scene) | {"truth": results.space.poses(results.truth[0, -1])}
    left, right, lower, upper = scene["extent"]
    height, scale = min(4.6, max(1.6, 2.2 * (upper - lower) / (right - left))), sheet.layout.scale
    columns = sheet.layout.columns(len(estimators), MAX_BESIDE, 1.4, beside=0.3)
    lines = -(-len(estimators) // columns)
    means = [results.get(estimator, data.beams).mean[0, -1] for estimator in estimators]
    low, high = _view(scene, [mean[results.space.position_indices] for mean in means])
    ratio = (high[1] - low[1]) / (high[0] - low[0])

    def room(width: float) -> float:
        return float(min(height, ratio * width))

    tall, flat = height, 1.5
    if sheet.layout.width is not None:
        tall, flat = room((sheet.layout.width - 0.3) / columns - 0.5 * scale), 0.8 * scale
    panels = sheet.panels(
        len(estimators),
        1 + turning,
        columns=columns,
        natural=(0.7 + 2.25 * columns, 1.3 + (height + 1.9 * turning) * lines),
        beside=0.3,
        inset=0.4 * scale,
        height=lambda width: room(width) + scale * (0.7 + 1.4 * turning),
        height_ratios=[tall, *([flat] * turning)] * lines,
    )
    for k, (block, estimator) in enumerate(zip(panels, estimators, strict=True)):
        trials = results.get(estimator, data.beams)
        mean, covariance = trials.mean[0, -1], trials.covariance[0, -1]
        sheet.title(block[0], data.labels[estimator], *data.silence(estimator))
        shown = _Shown(results.space, scene, pictures.get(estimator), mean, covariance)
        _room(block[0], shown)
        if (corners := _small(shown, low, high)) is not None:
            _enlarged(block[0], corners, low, high, shown)
        if turning:
            place = int(np.flatnonzero(results.space.is_angle)[0])
            claim = mean[place], np.sqrt(max(covariance[place, place], 0.0))
            _heading(block[1], scene, pictures.get(estimator), *claim)
            block[1].set_xlabel(sheet.broken(block[1].get_xlabel(), "axes.labelsize"))
        if k % columns:
            for axes in block:
                axes.set_ylabel("")
    for axes in panels[:, 0]:
        axes.set_xlim(low[0], high[0])
        axes.set_ylim(low[1], high[1])
    more: dict[str, Artist] = {}
    if any(pictures.get(estimator) is not None for estimator in estimators):
        more["posterior density, darkest at its peak"] = Patch(facecolor="#4f94c4")
    if turning:
        more["true heading"] = Line2D([], [], color=BEAM, linewidth=1.2, linestyle="--")
    which = f"run {data.run}" if data.run else "the first run"
    title = data.heading(f"What is believed in {which}", with_beams=True)
    sheet.finish(title, panels[0], columns=2, more=more, note=data.silent)


def _room(axes: Axes, shown: _Shown) -> None:
    scene = shown.scene
    shown.draw_below(axes)
    if np.isfinite(shown.mean).all():
        of_heading = ", and the Gaussian of the heading" * bool(shown.space.is_angle.any())
        shown.draw_claim(axes, 4.5, label=f"claimed: mean, 95 % ellipse{of_heading}")
    axes.plot(*zip(scene["truth"][:2], _tip(scene), strict=True), color=BEAM, linewidth=1.6, zorder=6)
    draw_truth(axes, scene, label="true position, its heading beside it")
    label_positions(axes)
    axes.spines[:].set_visible(False)


def _small(shown: _Shown, low: Array, high: Array) -> tuple[Array, Array] | None:
    """Corners of a square about a belief that is too small to be seen in a room; None where it is not."""
    middle = shown.place
    half = 4 * float(np.sqrt(max(np.diagonal(shown.claim).max(), 0.0)))
    if not (np.isfinite(shown.mean).all() and 0 < half < SMALL * float((high - low).min())):
        return None
    if not ((middle > low) & (middle < high)).all():
        return None
    away = float(np.abs(shown.scene["truth"][:2] - middle).max())
    half = max(half, 1.2 * away) if away < 3 * half else half
    return middle - half, middle + half


def _enlarged(axes: Axes, corners: tuple[Array, Array], low: Array, high: Array, shown: _Shown) -> None:
    """What lies between two corners once more, larger, in the corner of the room that is furthest away.

    How wide it is stands on the side from which no line comes.
    """
    lower, upper = corners
    side, rim = ENLARGED * float((high - low).min()), 0.1 * float((high - low).min())
    places = [np.array([x, y]) for x in (low[0] + rim, high[0] - rim - side)
              for y in (low[1] + 2 * rim, high[1] - 2 * rim - side)]  # fmt: skip
    seen = np.stack([(lower + upper) / 2, shown.scene["truth"][:2]])
    best = max(places, key=lambda place: float(np.linalg.norm(place + side / 2 - seen, axis=1).min()))
    inset = axes.inset_axes((*best, side, side), transform=axes.transData, zorder=8)
    shown.draw_below(inset)
    shown.draw_claim(inset, 3.5)
    draw_truth(inset, shown.scene, 7.0, label="")
    inset.set_xlim(lower[0], upper[0])
    inset.set_ylim(lower[1], upper[1])
    inset.set_aspect("equal")
    inset.set_xticks([])
    inset.set_yticks([])
    inset.spines[:].set(visible=True, edgecolor="0.4", linewidth=0.8)
    is_left, is_above = best[0] < low[0] + 2 * rim, best[1] + side / 2 > (lower[1] + upper[1]) / 2
    inset.xaxis.set_label_position("top" if is_above else "bottom")
    width = f"{upper[0] - lower[0]:.2g} m wide"
    inset.set_xlabel(width, fontsize=small(), labelpad=1.5, loc="left" if is_left else "right", bbox=PAPER)
    axes.indicate_inset_zoom(inset, edgecolor="0.4", alpha=1.0, linewidth=0.8)


def _view(scene: Scene, means: Iterable[Array]) -> tuple[Array, Array]:
    """Lower and upper corner of what all rooms show: the map, the true heading, and means that are near."""
    left, right, lower, upper = scene["extent"]
    size = max(right - left, upper - lower)
    low, high = np.array([left, lower]), np.array([right, upper])
    seen = np.array([low, high, _tip(scene), *(mean for mean in means if np.isfinite(mean).all())])
    seen = np.clip(seen, low - 0.25 * size, high + 0.25 * size)  # a mean may be anywhere
    return seen.min(0) - 0.04 * size, seen.max(0) + 0.04 * size


def _tip(scene: Scene) -> Array:
    """Where the line that shows the true heading ends."""
    left, right, lower, upper = scene["extent"]
    heading = scene["truth"][2]
    away = 0.12 * max(right - left, upper - lower) * np.array([np.sin(heading), np.cos(heading)])
    return np.asarray(scene["truth"][:2] + away)


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
    axes.xaxis.set_major_locator(
        FittingLocator([FixedLocator(range(0, 361, step)) for step in (90, 180, 360)])
    )
    axes.set_xlabel(f"heading, deg from +{symbol('x2')}")
    axes.set_ylabel("density, 1/deg")
    even_numbers(axes.yaxis)
