"""What estimators claim against what is true: covariances, normalised errors, accuracy against time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection

from ..consistency.formatting import beams_in_words, factor, format_number, scaled, unit
from ..consistency.intervals import Interval
from ..consistency.row import Row
from .data import FigureData
from .layout import small, text_width
from .sheet import Sheet
from .style import CLAIMED, TRUE, colour_and_marker, symbol
from .ticks import plain_numbers

CHI_SQUARE = "chi-square 95 % (reference only: holds for Gaussian posteriors)"
HATCHED: dict[str, Any] = {"facecolor": "#F0C060", "edgecolor": "0.35", "hatch": "////", "linewidth": 0.4}
HOLLOW: dict[str, Any] = {"fmt": "o", "markersize": 7.5, "markerfacecolor": "white", "markeredgewidth": 1.5}
BESIDE: dict[str, Any] = {"xytext": (5, 0), "textcoords": "offset points", "va": "center"}
DECADES = 1e3  # a longer logarithmic axis has no room to label more than its powers of ten
LABELS = 0.36  # of a figure's width that labels of estimators may take
PITCH = 0.24  # inches from one estimator to the next


class _List:
    """Estimators down the side of a figure, each set of beams under its heading.

    Attributes:
        rows: What stands in it.
        labels: Of the rows, broken into lines where the figure has a width.
        heights: Of the rows, from the top, one step apart, more where labels have several lines.
        heads: Heights and texts of the headings.
        beside: Width of the labels, inches.
    """

    def __init__(self, rows: Sequence[Row], sheet: Sheet) -> None:
        most = None if sheet.layout.width is None else LABELS * sheet.layout.width
        self.rows = rows
        self.labels = [sheet.broken(row.estimator, "ytick.labelsize", most) for row in rows]
        self.heights: list[float] = []
        self.heads: list[tuple[float, str]] = []
        y, beams = 0.0, None
        for row, label in zip(rows, self.labels, strict=True):
            if row.beams != beams:
                y -= 0.5 if beams is None else 0.9
                beams = row.beams
                self.heads.append((y, sheet.broken(beams_in_words(beams), "ytick.labelsize", most)))
                y -= 0.9
            more = 0.3 * label.count("\n")  # half of what its lines need beyond the first
            self.heights.append(y - more)
            y -= 1.0 + 2 * more
        self.end = y + 0.3
        texts = [*self.labels, *(text for _, text in self.heads)]
        self.beside = max(text_width(text, "ytick.labelsize", bold=True) for text in texts) + 0.15

    @property
    def height(self) -> float:
        """Of the rows, inches, at the natural size of letters."""
        return PITCH * (0.7 - self.end)

    def name_rows(self, axes: Axes) -> None:
        """Write the labels on the vertical axis of a panel."""
        labels = [*self.labels, *(text for _, text in self.heads)]
        axes.set_yticks([*self.heights, *(y for y, _ in self.heads)], labels)
        for label in axes.get_yticklabels()[len(self.heights) :]:
            label.set_fontweight("bold")
        for y, _ in self.heads[1:]:
            axes.axhline(y + 0.55, color="0.75", linewidth=0.6)
        axes.set_ylim(self.end, self.heads[0][0] + 0.5)
        axes.tick_params(axis="y", length=0)
        axes.grid(axis="x", which="major")
        plain_numbers(axes.xaxis)


def _bars(axes: Axes, intervals: Sequence[Interval], heights: Sequence[float], **style: Any) -> None:
    """Values with their intervals across, in one piece; an infinite one is told in words at the edge."""
    place: dict[str, Any] = {"xycoords": ("axes fraction", "data"), "ha": "right", "va": "center"}
    told = np.array([tuple(interval) for interval in intervals], dtype=float)  # value, low, high
    finite = np.isfinite(told[:, 0])
    for y in np.array(heights)[~finite]:
        axes.annotate("not finite", (0.98, y), fontsize=small(), **place)
    if not finite.any():
        return
    value, low, high = told[finite].T
    reach = np.maximum(np.nan_to_num([value - low, high - value], nan=0.0, posinf=0.0), 0.0)
    axes.errorbar(value, np.array(heights)[finite], xerr=reach, linestyle="none", capsize=2.5, **style)


def _panels_of_components(listed: _List, sheet: Sheet) -> list[Axes]:
    """Panels side by side, one for each component of the state, above the same list of estimators."""
    count, scale = len(listed.rows[0].names), sheet.layout.scale
    panels = sheet.panels(
        count,
        columns=sheet.layout.columns(count, count, 1.6, listed.beside),
        natural=(1.6 + 3.4 * count, 1.7 + PITCH * -listed.heights[-1]),
        beside=listed.beside,
        height=lambda width: scale * (listed.height + 0.5),
        sharey=True,
    )
    return list(panels[:, 0])


def draw_covariance(data: FigureData, sheet: Sheet) -> None:
    """Standard deviations: what each estimator claims (root mean P) beside what is true (root G)."""
    listed = _List(data.drawn_rows, sheet)
    names, panels = listed.rows[0].names, _panels_of_components(listed, sheet)
    for i, (axes, name) in enumerate(zip(panels, names, strict=True)):
        claimed, true = (
            [scaled(variance.sqrt(), factor(name)) for variance in of]
            for of in ([row.p[i] for row in listed.rows], [row.g[i] for row in listed.rows])
        )
        ends = [
            (one.value, other.value, y) for one, other, y in zip(claimed, true, listed.heights, strict=True)
        ]
        if known := [end for end in ends if np.isfinite(end).all()]:
            left, right, heights = zip(*known, strict=True)
            axes.hlines(heights, left, right, color="0.6", linewidth=2.5, zorder=1)
        _bars(axes, claimed, listed.heights, color=CLAIMED, label="claimed: root mean P", zorder=2, **HOLLOW)
        _bars(axes, true, listed.heights, fmt="D", markersize=3.8, color=TRUE, label="true: root G", zorder=3)
        axes.set_xscale("log")
        listed.name_rows(axes)
        label = f"standard deviation of {symbol(name)}, {unit(name)}"
        axes.set_xlabel(sheet.broken(label, "axes.labelsize"))
    title = data.heading("What is claimed against what is true")
    sheet.finish(title, panels[:1], columns=2, note=data.silent_rows)


def draw_anees(data: FigureData, sheet: Sheet) -> None:
    """ANEES / n with intervals; the band for Gaussian posteriors is a labelled reference and no more."""
    listed = _List(data.drawn_rows, sheet)
    rows, scale = listed.rows, sheet.layout.scale
    axes = sheet.panels(
        1,
        columns=1,
        natural=(7.2, 1.7 + PITCH * -listed.heights[-1]),
        beside=listed.beside,
        height=lambda width: scale * (listed.height + 0.6),
    )[0, 0]
    values = [end for row in rows for end in row.anees if np.isfinite(end) and end > 0]
    axes.set_xscale("log")
    axes.axvline(1.0, color="black", linewidth=1.0, linestyle="--", label="honest: 1")
    bands = [
        [(low, y - 0.42), (high, y - 0.42), (high, y + 0.42), (low, y + 0.42)]
        for (low, high), y in zip([row.anees_band for row in rows], listed.heights, strict=True)
    ]
    axes.add_collection(PolyCollection(bands, label=CHI_SQUARE, **HATCHED))
    label = "ANEES / n with 95 % interval"
    anees = [row.anees for row in rows]
    _bars(axes, anees, listed.heights, fmt="D", markersize=4.5, color=TRUE, label=label, zorder=3)
    for row, y in zip(rows, listed.heights, strict=True):
        if np.isfinite(row.anees.value):
            end = max(row.anees.value, np.nan_to_num(row.anees.high), row.anees_band[1])
            axes.annotate(format_number(row.anees.value), (end, y), fontsize=small(), **BESIDE)
    first, last = min([0.5, *values]) / 1.4, max([2.0, *values]) * 2.2
    if sheet.panel_width is not None:  # the number beside the last value needs its share of the axis
        share = min(0.5, (text_width("10000", "xtick.labelsize") + 0.1) / sheet.panel_width)
        last = first * (max([2.0, *values]) / first) ** (1 / (1 - share))
    axes.set_xlim(first, last)
    listed.name_rows(axes)
    label = "ANEES / n, no unit: left of 1 claims too much error, right of 1 too little"
    axes.set_xlabel(sheet.broken(label, "axes.labelsize"))
    title = data.heading("ANEES / n: squared error over claimed covariance")
    sheet.finish(title, [axes], columns=1, note=data.silent_rows)


EFFICIENCIES = (  # figures of a row, the first of which is shown that it has
    ("efficiency", "variance of the best estimate there is / G", "D"),
    ("efficiency_at_least", "at least: largest bound / G", ">"),
)


def draw_efficiency(data: FigureData, sheet: Sheet) -> None:
    """How near each estimator comes to the best that there is, by component."""
    listed = _List(data.bounded_rows, sheet)
    names, panels = listed.rows[0].names, _panels_of_components(listed, sheet)
    for axes, name in zip(panels, names, strict=True):
        axes.axvline(100.0, color="black", linewidth=1.0, linestyle="--", label="nobody is better: 100 %")
        for figure, label, marker in EFFICIENCIES:
            told = [
                (scaled(interval, 100.0), y)
                for row, y in zip(listed.rows, listed.heights, strict=True)
                if (interval := row.figures.get(f"{figure}_{name}")) is not None
                and np.isfinite(interval.value)
                and interval.value > 0
            ]
            if told:
                intervals, heights = zip(*told, strict=True)
                _bars(axes, intervals, heights, fmt=marker, markersize=4.5, color=TRUE, label=label)
        axes.set_xscale("log")
        listed.name_rows(axes)
        axes.set_xlabel(sheet.broken(f"efficiency in {symbol(name)}, %", "axes.labelsize"))
    title = data.heading("How near to the best that there is")
    sheet.finish(title, panels[:1], columns=2, note=data.silent_rows)


def draw_time(data: FigureData, sheet: Sheet) -> None:
    """Accuracy against time per update, of the estimators that were timed and answered."""
    timed = data.timed_rows
    panels = sheet.panels(
        1, columns=1, natural=(6.4, 4.3), beside=0.5, height=lambda width: min(3.6, 0.8 * width)
    )
    axes = panels[0, 0]
    bars = 0
    where = [i for i, name in enumerate(timed[0].names) if name in ("x1", "x2")]
    for k, row in enumerate(timed):
        true = np.sqrt(sum(row.g[i].value for i in where))
        claimed = np.sqrt(sum(row.p[i].value for i in where))
        milliseconds = 1e3 * row.seconds
        colour, marker = colour_and_marker(k)
        axes.plot([milliseconds] * 2, [claimed, true], color=colour, linewidth=1.0, linestyle=":")
        axes.plot(milliseconds, claimed, marker, markersize=7, markerfacecolor="white", color=colour,
                  markeredgewidth=1.4)  # fmt: skip
        axes.plot(milliseconds, true, marker, markersize=8, color=colour, label=row.estimator)
        if np.isfinite(row.seconds_range).all():
            bars += 1
            axes.plot([1e3 * end for end in row.seconds_range], [true] * 2, "|-", color=colour, linewidth=1.0)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.margins(0.12)
    for axis in (axes.xaxis, axes.yaxis):
        low, high = axis.get_view_interval()
        plain_numbers(axis, (1.0, 2.0, 5.0) if high < DECADES * low else (1.0,))
    axes.grid(which="major")
    axes.set_xlabel("time per update and run, ms")
    axes.set_ylabel("root mean square position error, m")
    passes = " Bars: least and greatest time of a pass." if bars else ""
    notes = [f"Filled: true; hollow: claimed.{passes}", data.untimed, data.silent]
    title = data.heading("Accuracy against time", with_beams=True)
    sheet.finish(title, [axes], columns=3, note="\n".join(filter(None, notes)))
