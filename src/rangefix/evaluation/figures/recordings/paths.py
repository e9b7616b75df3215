"""Where estimators put a robot: its ways on the map with ellipses, and what is believed at some times."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from ....arrays import Array
from ....filters import RangeMap
from ....filters.optional_methods import Image
from ...recordings.replay import Believed
from ...recordings.trace import Trace
from ..layout import wrapped
from ..sheet import legend_below
from ..style import COLOURS, INK, colour_and_line, label_positions

HEIGHT, WIDEST = 5.5, 11.0  # inches
MOST_DRAWN = 1000  # walls that stay lines in files of lines; more are made pixels
MARGIN_M = 1.0  # about the ways that were taken
ELLIPSES = 40  # along a way
ROOM_BESIDE = 4.0  # of an ellipse, in its half axes
LEAST_SHOWN_M = 1.0  # to each side of a belief
WORTH_ENLARGING = 0.5  # share of a map: less of it is shown alone
LEVEL = 2.4477  # radius of an ellipse that holds a position in 95 % of Gaussian beliefs, in deviations
TITLE = "Estimated paths, with ellipses claimed to hold the position in 95 %"
TITLE_MARGIN = 0.1  # inches, beside a title
LEGEND_COLUMNS = 4  # at most
GAP_M = 3.0  # between neighbours of a way, beyond which it is broken
WALL, CLAIM, DENSITY = "0.25", COLOURS[5], "#4f94c4"
POSE: dict[str, Any] = {
    "marker": "o", "markersize": 4.0, "markerfacecolor": "white", "color": CLAIM, "linestyle": "none",
}  # fmt: skip
TRUTH: dict[str, Any] = {"marker": "+", "markersize": 8.0, "color": "black", "linestyle": "none"}


def draw_paths(traces: Mapping[str, Trace], room: RangeMap) -> Figure:
    """The ways that estimators find, on the map, with what they claim: ellipses of 95 %.

    Args:
        traces: By the name of the estimator.
        room: The map.
    """
    points = np.concatenate([trace.means[:, :2] for trace in traces.values()])
    truths = [trace.truths[:, :2] for trace in traces.values()]
    lower, upper = view(room, np.concatenate([points, *truths]))
    figure = Figure(figsize=size_of(lower, upper), layout="constrained")
    axes = figure.subplots()
    draw_map(axes, room, lower, upper)
    truth = max(truths, key=lambda way: int(np.isfinite(way).all(axis=1).sum()))
    if np.isfinite(truth).any():
        axes.plot(*_broken(truth).T, color="black", linewidth=2.6, alpha=0.35, label="true path")
    for place, (name, trace) in enumerate(traces.items()):
        colour, line = colour_and_line(place)
        axes.plot(*_broken(trace.means[:, :2]).T, line, color=colour, linewidth=1.1, label=name)
        chosen = np.unique(np.linspace(0, len(trace.kept) - 1, ELLIPSES).round().astype(int))
        draw_ellipses(axes, trace.means[chosen, :2], trace.covariances[chosen, :2, :2], colour)
    width, height = figure.get_size_inches()
    handles, labels = axes.get_legend_handles_labels()  # below: within it would hide a part of the map
    entries = dict(zip(labels, handles, strict=True))
    figure.set_figheight(height + legend_below(figure, entries, width - 2 * TITLE_MARGIN, LEGEND_COLUMNS))
    figure.suptitle(wrapped(TITLE, width - 2 * TITLE_MARGIN, "figure.titlesize"))
    return figure


def draw_beliefs(name: str, trace: Trace, room: RangeMap) -> Figure:
    """What an estimator believes at some times: the ellipse that it claims, and its density if it has one.

    A legend says what each mark, line and colour is. A belief that would be a dot on the map is enlarged:
    scales differ.

    Args:
        name: Of the estimator.
        trace: Its replay.
        room: The map.
    """
    images = trace.images
    lower, upper = room.bounds
    columns = min(len(images), 2)
    lines = -(-len(images) // columns)
    width, height = size_of(lower, upper)
    scale = min(1.0, 6.0 / width)
    size = columns * scale * width + 0.5, lines * scale * height + 0.6
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(lines, columns, squeeze=False).ravel()
    for axes in panels[len(images) :]:
        axes.set_visible(False)
    for axes, (believed, image) in zip(panels, images, strict=False):
        if _is_told(believed, image):
            assert image is not None
            axes.imshow(
                np.sqrt(image.density), extent=image.extent, origin="lower", cmap=INK, interpolation="nearest"
            )
        draw_map(axes, room, *_about(believed, lower, upper))
        draw_estimate(axes, believed)
        axes.set_title(f"scan {believed.step.scan}, {_spread(believed)}")
    entries = belief_legend([believed for believed, _ in images])
    if any(_is_told(believed, image) for believed, image in images):
        entries["density of the belief: darker = denser, on a square-root scale"] = Patch(facecolor=DENSITY)
    room_beside = size[0] - 2 * TITLE_MARGIN
    figure.suptitle(
        wrapped(f"What {name} believes after some scans; scales differ", room_beside, "figure.titlesize")
    )
    figure.set_figheight(size[1] + legend_below(figure, entries, room_beside, 2))
    return figure


def _about(believed: Believed, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Corners of the part of a map about a belief that would be a dot on all of it; else those of the map."""
    half, place = 0.5 * (upper - lower), believed.mean[:2]
    needed = ROOM_BESIDE * LEVEL * np.sqrt(np.diagonal(believed.covariance)[:2])
    if believed.truth is not None:
        needed = np.maximum(needed, 1.2 * np.abs(believed.truth[:2] - place))
    share = float(np.max(np.maximum(needed, LEAST_SHOWN_M) / half))
    if not share < WORTH_ENLARGING:
        return lower, upper
    return place - share * half, place + share * half


def _is_told(believed: Believed, image: Image | None) -> bool:
    """Whether there is a density whose cells tell more than the ellipse does."""
    if image is None or not image.density.max() > 0:
        return False
    left, right, _, _ = image.extent
    widest = LEVEL * float(np.sqrt(np.diagonal(believed.covariance)[:2].max()))
    return bool((right - left) / image.density.shape[1] < widest)


def belief_legend(believed: Iterable[Believed]) -> dict[str, Artist]:
    """Label -> what it says of the estimates that `draw_estimate` has drawn on a map."""
    entries: dict[str, Artist] = {
        "estimated position; the arrow points along the estimated heading": Line2D([], [], **POSE),
        "ellipse claimed to hold the position in 95 %": Line2D([], [], color=CLAIM, linewidth=0.7),
    }
    if any(each.truth is not None for each in believed):
        entries["true position"] = Line2D([], [], **TRUTH)
    return entries | {"walls of the map": Line2D([], [], color=WALL, linewidth=0.8)}


def draw_estimate(axes: Axes, believed: Believed) -> None:
    """The estimated pose with its ellipse, and the true position as a cross: see `belief_legend`."""
    place, heading = believed.mean[:2], believed.mean[2]
    draw_ellipses(axes, place[None], believed.covariance[None, :2, :2], CLAIM)
    reach = 0.04 * float(np.ptp(axes.get_xlim()))
    step = reach * np.array([np.sin(heading), np.cos(heading)])
    axes.annotate(
        "", xy=(place + step).tolist(), xytext=place.tolist(),
        arrowprops={"arrowstyle": "->", "color": CLAIM, "linewidth": 1.4, "shrinkA": 0.0},
    )  # fmt: skip
    axes.plot(*place, **POSE)
    if believed.truth is not None:
        axes.plot(*believed.truth[:2], **TRUTH)


def draw_map(axes: Axes, room: RangeMap, lower: Array, upper: Array) -> None:
    """The walls of a map, in a box."""
    walls = np.asarray(room.segments).reshape(-1, 2, 2)
    axes.add_collection(
        LineCollection(list(walls), colors=WALL, linewidths=0.8, rasterized=len(walls) > MOST_DRAWN)
    )
    axes.set_xlim(lower[0], upper[0])
    axes.set_ylim(lower[1], upper[1])
    label_positions(axes)


def draw_ellipses(axes: Axes, places: Array, covariances: Array, colour: str) -> None:
    """Ellipses that hold 95 % of Gaussian beliefs, (K, 2) and (K, 2, 2)."""
    values, vectors = np.linalg.eigh(covariances)
    widths = 2 * LEVEL * np.sqrt(np.maximum(values, 0.0))
    angles = np.rad2deg(np.arctan2(vectors[:, 1, 0], vectors[:, 0, 0]))
    axes.add_collection(
        EllipseCollection(
            widths[:, 0], widths[:, 1], angles, units="xy", offsets=places,
            transOffset=axes.transData, facecolors="none", edgecolors=colour, linewidths=0.7,
        )
    )  # fmt: skip


def view(room: RangeMap, points: Array, margin_m: float = MARGIN_M) -> tuple[Array, Array]:
    """Corners of the part of a map in which points (N, 2) lie, with a margin, (2,) each."""
    known = points[np.isfinite(points).all(axis=1)]
    lower, upper = room.bounds
    if not len(known):
        return lower, upper
    low, high = known.min(axis=0) - margin_m, known.max(axis=0) + margin_m
    return np.maximum(low, lower - MARGIN_M), np.minimum(high, upper + MARGIN_M)


def size_of(lower: Array, upper: Array) -> tuple[float, float]:
    """Width and height of a figure of a box, inches."""
    shape = float(np.clip((upper - lower)[0] / max((upper - lower)[1], 1e-9), 0.4, 8.0))
    width = min(HEIGHT * shape, WIDEST)
    return width + 0.9, width / shape + 0.9


def _broken(way: Array) -> Array:
    """A way with gaps where it jumps, (K, 2)."""
    way = np.array(way)
    far = np.flatnonzero(np.linalg.norm(np.diff(way, axis=0), axis=1) > GAP_M) + 1
    return np.insert(way, far, np.nan, axis=0)


def _spread(believed: Believed) -> str:
    return f"claimed error {np.sqrt(np.trace(believed.covariance[:2, :2])):.2g} m (rms)"
