"""Drives: how errors grow and shrink from measurement to measurement, and the ways that were taken."""

from __future__ import annotations

import numpy as np
from matplotlib.artist import Artist
from matplotlib.lines import Line2D

from ..consistency.formatting import factor, unit
from .data import FigureData
from .errors import ellipse
from .room import draw_walls
from .sheet import Sheet
from .style import CLAIMED, colour_and_marker, label_positions, symbol
from .ticks import even_numbers, plain_numbers

WAYS_BESIDE = 3  # estimators side by side
ELLIPSES, DOTS = 6, 50  # along a way, about


def draw_steps(data: FigureData, sheet: Sheet) -> None:
    """True (root G) and claimed (root mean P) standard deviations, and ANEES / n, after each measurement."""
    rows = [row for row in data.rows if row.beams == data.beams]
    names = rows[0].names
    estimators = [data.labels[each] for each in data.answering]
    scale = sheet.layout.scale
    panels = sheet.panels(
        1,
        len(names) + 1,
        columns=1,
        natural=(7.6, 1.2 + 1.75 * (len(names) + 1)),
        beside=0.6 * scale,
        height=lambda width: scale * (0.5 + 1.25 * (len(names) + 1)),
        sharex=True,
    )[0]
    for k, estimator in enumerate(estimators):
        course = sorted((row for row in rows if row.estimator == estimator), key=lambda row: row.step)
        colour, marker = colour_and_marker(k)
        place = np.array([row.step for row in course], dtype=float)
        style = {"color": colour, "marker": marker, "markersize": 3.5, "markevery": max(1, len(place) // 10)}
        for i, name in enumerate(names):
            true, claimed = (
                [factor(name) * variances[i].sqrt().value for variances in steps]
                for steps in ([row.g for row in course], [row.p for row in course])
            )
            panels[i].plot(place, true, **style, label=estimator)
            panels[i].plot(place, claimed, linestyle="--", linewidth=1.1, **style, markerfacecolor="white")
        value, low, high = np.array([row.anees for row in course], dtype=float).T
        panels[-1].fill_between(place, low, high, facecolor=colour, alpha=0.25, linewidth=0)
        panels[-1].plot(place, value, **style)
    room = sheet.layout.width and 1.15 * scale  # for a label beside a panel
    for axes, name in zip(panels, names, strict=False):
        axes.set_ylabel(sheet.broken(f"std of {symbol(name)}, {unit(name)}", "axes.labelsize", room))
    panels[-1].axhline(1.0, color="black", linewidth=1.0, linestyle="--")
    for axes in panels:
        axes.set_yscale("log")
        axes.grid(axis="y", which="major")
        plain_numbers(axes.yaxis)
    low, high = panels[-1].get_ylim()
    panels[-1].set_ylim(min(low, 0.5), max(high, 2.0))
    panels[-1].set_ylabel(sheet.broken("ANEES / n, 95 %\n(1: honest)", "axes.labelsize", room))
    panels[-1].set_xlabel(sheet.broken("moves before the measurement", "axes.labelsize"))
    even_numbers(panels[-1].xaxis, 8, whole=True)
    more: dict[str, Artist] = {
        "true": Line2D([], [], color="0.3", marker="o", markersize=3.5),
        "claimed": Line2D([], [], color="0.3", marker="o", markersize=3.5, linestyle="--", linewidth=1.1,
                          markerfacecolor="white"),
    }  # fmt: skip
    title = data.heading("True and claimed errors along the way", with_beams=True)
    sheet.finish(title, panels[:1], columns=4, more=more, note=data.silent)


def draw_ways(data: FigureData, sheet: Sheet) -> None:
    """The true way of the first run beside the way that each estimator believes, with ellipses along it."""
    results, scene = data.results, data.results.scene
    estimators = data.answering
    left, right, lower, upper = scene["extent"]
    columns = sheet.layout.columns(len(estimators), WAYS_BESIDE, 1.5, beside=0.4)
    lines = -(-len(estimators) // columns)
    wide, ratio = 3.4, (upper - lower) / (right - left)
    panels = sheet.panels(
        len(estimators),
        columns=columns,
        natural=(0.6 + wide * columns, 0.9 + (wide * ratio + 0.6) * lines),
        beside=0.25,
        inset=0.25 * sheet.layout.scale,
        height=lambda width: min(1.5, ratio) * width + 0.7 * sheet.layout.scale,
    )[:, 0]
    where = results.space.position_indices
    truth = results.truth[0][:, where]
    for axes, estimator in zip(panels, estimators, strict=True):
        trials = results.get(estimator, data.beams)
        mean, covariance = trials.mean[0][:, where], trials.covariance[0][:, where][:, :, where]
        draw_walls(axes, scene)
        axes.plot(*truth.T, color="black", linewidth=2.2, label="true way of the first run", zorder=3)
        axes.plot(*truth[0], "*", markersize=10, markerfacecolor="white", markeredgecolor="black",
                  linestyle="none", label="its start", zorder=6)  # fmt: skip
        axes.plot(*mean.T, color=CLAIMED, linewidth=1.2, marker="o", markersize=2.5, zorder=5,
                  markevery=max(1, len(mean) // DOTS),  # of a long way they would hide the true one
                  label="what the estimator believes, with 95 % ellipses")  # fmt: skip
        for step in np.unique(np.linspace(0, len(truth) - 1, ELLIPSES).astype(int)):
            if np.isfinite(mean[step]).all() and np.isfinite(covariance[step]).all():
                axes.add_patch(ellipse(covariance[step], tuple(mean[step]), edgecolor=CLAIMED, zorder=4))
        sheet.title(axes, data.labels[estimator], *data.silence(estimator))
        label_positions(axes)
        margin = 0.03 * max(right - left, upper - lower)
        axes.set_xlim(left - margin, right + margin)
        axes.set_ylim(lower - margin, upper + margin)
        axes.spines[:].set_visible(False)
    title = data.heading("The way of the first run", with_beams=True)
    sheet.finish(title, panels[:1], columns=3, note=data.silent)
