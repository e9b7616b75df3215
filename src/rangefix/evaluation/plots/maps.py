"""The map of a study: walls, free space, the prior's box, the true positions and the beams of one run."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ..results import Results
from ..scene import Scene
from .posterior import draw_beams, draw_truth, draw_walls, ellipse
from .style import label_positions

FREE = ListedColormap(["#c9c9c9", "#ffffff"])
MOST_TRUTHS = 1000  # drawn
NORMAL_95 = 2.4477  # sqrt of the chi-square quantile: the ellipse that holds 95 % of a Gaussian in the plane


def _free_space(axes: Axes, scene: Scene) -> None:
    axes.imshow(scene["free"], origin="lower", extent=tuple(scene["extent"]), cmap=FREE, vmin=0, vmax=1,
                interpolation="nearest", zorder=0)  # fmt: skip


def _box(axes: Axes, scene: Scene) -> None:
    """The prior's box, where it is not the whole map."""
    lower, upper = scene["prior_lower"], scene["prior_upper"]
    if np.allclose(np.array([lower, upper]).T.ravel(), scene["extent"], atol=0.02):
        return
    axes.add_patch(Rectangle(tuple(lower), *(upper - lower), fill=False, edgecolor="#0072B2", linewidth=1.8,
                             linestyle="--", zorder=4, label="box of the prior"))  # fmt: skip


def map_figure(results: Results, title: str) -> Figure:
    """The whole map and, where the prior covers a part of it only, that part beside it."""
    scene = results.scene
    left, right, lower, upper = scene["extent"]
    part = np.prod(scene["prior_upper"] - scene["prior_lower"]) < 0.6 * (right - left) * (upper - lower)
    aspect = (upper - lower) / (right - left)
    figure = Figure(
        figsize=(4.4 + (5.6 if part else 0.8), min(7.5, max(4.2, 4.4 * aspect))), layout="constrained"
    )
    panels = figure.subplots(1, 2 if part else 1, squeeze=False, width_ratios=(1, 1.35) if part else None)[0]
    for axes in panels:
        _free_space(axes, scene)
        label_positions(axes)
        axes.spines[:].set_visible(False)
    whole, near = panels[0], panels[-1]
    for axes, width in zip(panels, (0.7, 1.5) if part else (1.6,), strict=True):
        draw_walls(axes, scene, width)
        _box(axes, scene)
    margin = 0.02 * max(right - left, upper - lower)
    whole.set_xlim(left - margin, right + margin)
    whole.set_ylim(lower - margin, upper + margin)
    truth = results.truth[:MOST_TRUTHS, 0][:, results.space.position_indices]
    near.plot(
        *truth.T, ".", markersize=2.5, color="#7F7F7F", zorder=2, label=f"true positions, {len(truth)} runs"
    )
    draw_beams(near, scene, range(1, len(scene["bearings"]) + 1), named=len(scene["bearings"]) <= 12)
    draw_truth(near, scene, label="true position and beams of the first run")
    if part:
        whole.set_title("The map: white is free space")
        room = 0.15 * (scene["prior_upper"] - scene["prior_lower"])
        near.set_xlim(scene["prior_lower"][0] - room[0], scene["prior_upper"][0] + room[0])
        near.set_ylim(scene["prior_lower"][1] - room[1], scene["prior_upper"][1] + room[1])
        near.set_title("Where the object may be, and the beams of the first run")
    figure.legend(*near.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    figure.suptitle(title, fontsize=10.5)
    return figure


def ellipses_figure(results: Results, beams: str, title: str) -> Figure:
    """Errors in the plane, with the ellipses of what is true (G) and of what is claimed on average (P)."""
    estimators = results.estimators
    where = results.space.position_indices
    columns = min(len(estimators), 4)
    rows = -(-len(estimators) // columns)
    figure = Figure(figsize=(0.8 + 2.5 * columns, 1.0 + 2.7 * rows), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    reach = []
    for axes, estimator in zip(panels.flat, estimators, strict=False):
        trials = results.get(estimator, beams)
        errors = results.errors(trials)[trials.ok, -1][:, where]
        claims = trials.covariance[trials.ok, -1][:, where][:, :, where]
        axes.set_title(f"{estimator}: {len(errors)} of {len(trials.ok)} ok")
        if not len(errors):
            continue
        true, claimed = errors.T @ errors / len(errors), claims.mean(0)
        axes.plot(*errors[:MOST_TRUTHS].T, ".", markersize=2, color="0.6", zorder=1, label="error of one run")
        for matrix, label, style in (
            (
                claimed,
                "claimed: 95 % ellipse of a Gaussian with mean P",
                {"edgecolor": "#56B4E9", "linewidth": 3.2},
            ),
            (true, "true: the same with G", {"edgecolor": "black", "linewidth": 1.3, "linestyle": "--"}),
        ):
            axes.add_patch(ellipse((0.0, 0.0), matrix, NORMAL_95, fill=False, zorder=3, label=label, **style))
            reach.append(1.3 * NORMAL_95 * np.sqrt(np.diagonal(matrix)))
        axes.set_xlabel("error of $x_1$, m")
    for axes in panels[:, 0]:
        axes.set_ylabel("error of $x_2$, m")
    for axes in panels.flat[len(estimators) :]:
        axes.set_visible(False)
    if reach:
        limits = np.max(reach, axis=0)
        panels[0, 0].set_xlim(-limits[0], limits[0])
        panels[0, 0].set_ylim(-limits[1], limits[1])
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    figure.suptitle(title, fontsize=10.5)
    return figure
