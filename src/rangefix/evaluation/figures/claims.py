"""What estimators claim against what is true: covariances, normalised errors, errors run by run, time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..consistency.formatting import beams_in_words, factor, format_number, scaled, unit
from ..consistency.intervals import Interval
from ..consistency.row import Row
from .data import FigureData
from .style import CLAIMED, COLOURS, MARKERS, TRUE, finish, plain_numbers, symbol

CHI_SQUARE = "chi-square 95 % (reference only: holds for Gaussian posteriors)"
HATCHED: dict[str, Any] = {"facecolor": "#F0C060", "edgecolor": "0.35", "hatch": "////", "linewidth": 0.4}
HOLLOW: dict[str, Any] = {"fmt": "o", "markersize": 7.5, "markerfacecolor": "white", "markeredgewidth": 1.5}
BESIDE: dict[str, Any] = {"xytext": (5, 0), "textcoords": "offset points", "va": "center", "fontsize": 8}
DECADES = 1e3  # a longer logarithmic axis has no room to label more than its powers of ten


def _places(rows: Sequence[Row]) -> tuple[list[float], list[tuple[float, str]]]:
    """Heights of the rows in a list from the top, one step apart, and of the headings above each beam set."""
    heights, heads, y = [], [], 0.0
    beams = None
    for row in rows:
        if row.beams != beams:
            y -= 0.5 if beams is None else 0.9
            beams = row.beams
            heads.append((y, beams_in_words(beams)))
            y -= 0.9
        heights.append(y)
        y -= 1.0
    return heights, heads


def _list_axes(axes: Axes, rows: Sequence[Row]) -> None:
    """Estimators down the side, each beam set under its heading."""
    heights, heads = _places(rows)
    labels = [*(row.estimator for row in rows), *(text for _, text in heads)]
    axes.set_yticks([*heights, *(y for y, _ in heads)], labels)
    for label in axes.get_yticklabels()[len(heights) :]:
        label.set_fontweight("bold")
    for y, _ in heads[1:]:
        axes.axhline(y + 0.55, color="0.75", linewidth=0.6)
    axes.set_ylim(heights[-1] - 0.7, heads[0][0] + 0.5)
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x", which="major")
    plain_numbers(axes.xaxis)


def _bar(axes: Axes, interval: Interval, y: float, **style: object) -> None:
    """A value with its interval across; an infinite one stands at the edge as an arrow."""
    value, low, high = interval
    if not np.isfinite(value):
        text = "not finite" if np.isinf(value) else "none ok"
        axes.annotate(
            text, (0.98, y), xycoords=("axes fraction", "data"), ha="right", va="center", fontsize=8
        )
        return
    reach = np.nan_to_num([[value - low], [high - value]], nan=0.0, posinf=0.0)
    axes.errorbar([value], [y], xerr=np.maximum(reach, 0.0), linestyle="none", capsize=2.5, **style)  # type: ignore[arg-type]


def covariance_figure(data: FigureData) -> Figure:
    """Standard deviations: what each estimator claims (root mean P) beside what is true (root G)."""
    rows = data.last_rows
    names = rows[0].names
    heights, _ = _places(rows)
    figure = Figure(figsize=(1.6 + 3.4 * len(names), 1.7 + 0.24 * -heights[-1]), layout="constrained")
    panels = figure.subplots(1, len(names), squeeze=False, sharey=True)[0]
    for i, (axes, name) in enumerate(zip(panels, names, strict=True)):
        for row, y in zip(rows, heights, strict=True):
            claimed, true = (scaled(variance.sqrt(), factor(name)) for variance in (row.p[i], row.g[i]))
            axes.plot([claimed.value, true.value], [y, y], color="0.6", linewidth=2.5, zorder=1)
            _bar(axes, claimed, y, color=CLAIMED, label="claimed: root mean P", zorder=2, **HOLLOW)
            _bar(axes, true, y, fmt="D", markersize=3.8, color=TRUE, label="true: root G", zorder=3)
        axes.set_xscale("log")
        _list_axes(axes, rows)
        axes.set_xlabel(f"standard deviation of {symbol(name)}, {unit(name)}")
    return finish(figure, data.heading("What is claimed against what is true"), panels[:1], columns=2)


def anees_figure(data: FigureData) -> Figure:
    """ANEES / n with intervals; the band for Gaussian posteriors is a labelled reference and no more."""
    rows = data.last_rows
    heights, _ = _places(rows)
    figure = Figure(figsize=(7.2, 1.7 + 0.24 * -heights[-1]), layout="constrained")
    axes = figure.subplots()
    values = [end for row in rows for end in row.anees if np.isfinite(end) and end > 0]
    axes.set_xscale("log")
    axes.axvline(1.0, color="black", linewidth=1.0, linestyle="--", label="honest: 1")
    for row, y in zip(rows, heights, strict=True):
        low, high = row.anees_band
        axes.fill_betweenx([y - 0.42, y + 0.42], low, high, label=CHI_SQUARE, **HATCHED)
        label = "ANEES / n with 95 % interval"
        _bar(axes, row.anees, y, fmt="D", markersize=4.5, color=TRUE, label=label, zorder=3)
        if np.isfinite(row.anees.value):
            end = max(row.anees.value, np.nan_to_num(row.anees.high), high)
            axes.annotate(format_number(row.anees.value), (end, y), **BESIDE)
    axes.set_xlim(min(0.5, *values) / 1.4, max(2.0, *values) * 2.2)
    _list_axes(axes, rows)
    axes.set_xlabel(r"ANEES / n, no unit: left of 1 claims too much error, right of 1 too little")
    title = data.heading("ANEES / n: squared error over claimed covariance")
    return finish(figure, title, [axes], columns=1)


def time_figure(data: FigureData) -> Figure:
    """Accuracy against time per update, of the estimators that were timed and answered."""
    timed = [row for row in data.last_rows if np.isfinite(row.seconds) and np.isfinite(row.g[0].value)]
    last_set = timed[-1].beams
    figure = Figure(figsize=(6.4, 4.3), layout="constrained")
    axes = figure.subplots()
    where = [i for i, name in enumerate(timed[0].names) if name in ("x1", "x2")]
    for k, row in enumerate(row for row in timed if row.beams == last_set):
        true = np.sqrt(sum(row.g[i].value for i in where))
        claimed = np.sqrt(sum(row.p[i].value for i in where))
        milliseconds = 1e3 * row.seconds
        marker, colour = MARKERS[k % len(MARKERS)], COLOURS[k % len(COLOURS)]
        axes.plot([milliseconds] * 2, [claimed, true], color=colour, linewidth=1.0, linestyle=":")
        axes.plot(milliseconds, claimed, marker, markersize=7, markerfacecolor="white", color=colour,
                  markeredgewidth=1.4)  # fmt: skip
        axes.plot(milliseconds, true, marker, markersize=8, color=colour, label=row.estimator)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.margins(0.12)
    for axis in (axes.xaxis, axes.yaxis):
        low, high = axis.get_view_interval()
        plain_numbers(axis, (1.0, 2.0, 5.0) if high < DECADES * low else (1.0,))
    axes.grid(which="major")
    axes.set_xlabel("time per update and run, ms")
    axes.set_ylabel("root mean square position error, m")
    axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), title="filled: true\nhollow: claimed")
    figure.suptitle(data.heading("Accuracy against time", with_beams=True), fontsize=10.5)
    return figure
