"""Drives: how errors grow and shrink from measurement to measurement, and the ways that were taken."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from ..consistency.formatting import factor, unit
from .data import FigureData
from .errors import ellipse
from .room import draw_walls
from .style import CLAIMED, COLOURS, MARKERS, finish, label_positions, panel_title, plain_numbers, symbol

MAX_DRIVES_SHOWN = 6  # estimators side by side
ELLIPSES = 6  # along a way
STEEP = 1e3  # ANEES / n beyond which the axis ends


def steps_figure(data: FigureData) -> Figure:
    """True (root G) and claimed (root mean P) standard deviations, and ANEES / n, after each measurement."""
    rows = [row for row in data.rows if row.beams == data.beams]
    names = rows[0].names
    estimators = list(dict.fromkeys(row.estimator for row in rows))
    figure = Figure(figsize=(7.6, 1.2 + 1.75 * (len(names) + 1)), layout="constrained")
    panels = figure.subplots(len(names) + 1, 1, sharex=True)
    for k, estimator in enumerate(estimators):
        course = sorted((row for row in rows if row.estimator == estimator), key=lambda row: row.step)
        colour, marker = COLOURS[k % len(COLOURS)], MARKERS[k % len(MARKERS)]
        place = np.array([row.step for row in course], dtype=float)
        style = {"color": colour, "marker": marker, "markersize": 3.5, "markevery": max(1, len(place) // 10)}
        for i, name in enumerate(names):
            true, claimed = (
                [factor(name) * variances[i].sqrt().value for variances in steps]
                for steps in ([row.g for row in course], [row.p for row in course])
            )
            panels[i].plot(place, true, **style, label=f"{estimator}: true")
            panels[i].plot(place, claimed, linestyle="--", linewidth=1.1, **style, markerfacecolor="white",
                           label=f"{estimator}: claimed")  # fmt: skip
        value, low, high = np.array([row.anees for row in course], dtype=float).T
        panels[-1].fill_between(place, low, high, facecolor=colour, alpha=0.25, linewidth=0)
        panels[-1].plot(place, value, **style)
    for axes, name in zip(panels, names, strict=False):
        axes.set_yscale("log")
        axes.set_ylabel(f"std of {symbol(name)}, {unit(name)}")
    panels[-1].set_yscale("log")
    panels[-1].axhline(1.0, color="black", linewidth=1.0, linestyle="--")
    low, high = panels[-1].get_ylim()
    panels[-1].set_ylim(max(low, 0.1), min(max(high, 2.0), STEEP))
    panels[-1].set_ylabel("ANEES / n, 95 %\n(1: honest)")
    panels[-1].set_xlabel("moves before the measurement")
    for axes in panels:
        axes.grid(axis="y", which="major")
        plain_numbers(axes.yaxis)
    title = data.heading("True and claimed errors along the way", with_beams=True)
    return finish(figure, title, panels[:1], columns=min(4, len(estimators)))


def ways_figure(data: FigureData) -> Figure:
    """The true way of the first run beside the way that each estimator believes, with ellipses along it."""
    results, scene = data.results, data.results.scene
    estimators = results.estimators[:MAX_DRIVES_SHOWN]
    left, right, lower, upper = scene["extent"]
    columns = min(3, len(estimators))
    count = -(-len(estimators) // columns)
    wide = 3.4
    height = wide * (upper - lower) / (right - left)
    figure = Figure(figsize=(0.6 + wide * columns, 0.9 + (height + 0.6) * count), layout="constrained")
    panels = figure.subplots(count, columns, squeeze=False)
    where = results.space.position_indices
    truth = results.truth[0][:, where]
    for axes, estimator in zip(panels.flat, estimators, strict=False):
        trials = results.get(estimator, data.beams)
        mean, covariance = trials.mean[0][:, where], trials.covariance[0][:, where][:, :, where]
        draw_walls(axes, scene)
        axes.plot(*truth.T, color="black", linewidth=2.2, label="true way of the first run", zorder=3)
        axes.plot(*truth[0], "*", markersize=10, markerfacecolor="white", markeredgecolor="black",
                  linestyle="none", label="its start", zorder=6)  # fmt: skip
        axes.plot(*mean.T, color=CLAIMED, linewidth=1.2, marker="o", markersize=2.5, zorder=5,
                  label="what the estimator believes, with 95 % ellipses")  # fmt: skip
        for step in np.unique(np.linspace(0, len(truth) - 1, ELLIPSES).astype(int)):
            if np.isfinite(mean[step]).all() and np.isfinite(covariance[step]).all():
                axes.add_patch(ellipse(covariance[step], tuple(mean[step]), edgecolor=CLAIMED, zorder=4))
        panel_title(axes, data.labels[estimator])
        label_positions(axes)
        margin = 0.03 * max(right - left, upper - lower)
        axes.set_xlim(left - margin, right + margin)
        axes.set_ylim(lower - margin, upper + margin)
        axes.spines[:].set_visible(False)
    for axes in panels.flat[len(estimators) :]:
        axes.set_visible(False)
    return finish(figure, data.heading("The way of the first run", with_beams=True), panels[:1, 0], columns=3)
