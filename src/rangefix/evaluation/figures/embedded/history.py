"""How figures of estimators went from one folder of results to the next."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullLocator

from ...consistency.formatting import factor, scaled, unit
from ...consistency.intervals import UNKNOWN, Interval
from ...consistency.row import Row
from ..style import symbol
from .places import Places, colour_of, marker_of

PANEL_HEIGHT = 1.9  # inches high
LEFT, RIM, GAP, ABOVE = 0.75, 0.15, 0.42, 0.3  # inches
NARROWEST, WIDEST = 6.8, 13.0  # inches
LABEL_ACROSS = 0.78  # inches that the label of a folder takes across; turned it takes LABEL_TURNED
LABEL_TURNED = 0.42
LINES, UPRIGHT = 0.55, 1.0  # inches below for the labels, across and turned
SPREAD = 0.5  # of the step from folder to folder: how far the estimators of one stand apart
TICK_MULTIPLES = (1.0, 2.0, 5.0)  # ticks of a logarithmic axis, times powers of ten
MOST_TICKS = 7


def history_figure(
    ticks: Sequence[str], rows: Mapping[str, Sequence[Row | None]]
) -> tuple[Figure, list[Places]]:
    """ANEES / n and the true standard deviation of each component, folder by folder.

    Args:
        ticks: A label for each folder.
        rows: Estimator -> its row in each folder, all of one set of beams and step; None where there is none.
            What is not finite or not positive is not drawn.

    Returns:
        The figure, and where data stand in each panel: ANEES / n, then the components.
    """
    names = next(row for each in rows.values() for row in each if row is not None).names
    turned = len(ticks) * LABEL_ACROSS > NARROWEST - LEFT - RIM
    width = min(max(NARROWEST, LEFT + RIM + len(ticks) * LABEL_TURNED), WIDEST)
    panels, below = 1 + len(names), UPRIGHT if turned else LINES
    height = below + panels * (PANEL_HEIGHT + GAP) - GAP + ABOVE
    figure, places = Figure(figsize=(width, height)), []
    for panel in range(panels):
        bottom = below + (panels - 1 - panel) * (PANEL_HEIGHT + GAP)
        axes = figure.add_axes(
            (LEFT / width, bottom / height, 1 - (LEFT + RIM) / width, PANEL_HEIGHT / height)
        )
        name = names[panel - 1]
        std = f"true standard deviation of {symbol(name)}, {unit(name)}"
        axes.set_title(std if panel else "ANEES / n: 1 is honest")
        _lines(axes, rows, panel)
        _folder_axis(axes, ticks if panel == panels - 1 else [""] * len(ticks), turned)
        places.append(Places(figure, axes))
    return figure, places


def shown(row: Row | None, panel: int) -> Interval:
    """What a panel shows of a row: ANEES / n in the first, else the root of G of its component."""
    if row is None:
        return UNKNOWN
    if panel == 0:
        return row.anees
    return scaled(row.g[panel - 1].sqrt(), factor(row.names[panel - 1]))


def is_drawn(interval: Interval) -> bool:
    """Whether a logarithmic axis has a place for it."""
    return 0 < interval.value < math.inf


def place_of(folder: int, estimator: int, estimators: int) -> float:
    """Where the mark of an estimator stands across: beside the tick of its folder, apart from the others."""
    return folder + SPREAD * ((estimator + 0.5) / estimators - 0.5)


def _lines(axes: Axes, rows: Mapping[str, Sequence[Row | None]], panel: int) -> None:
    """A line for each estimator, with intervals."""
    ends = [1.0] if panel == 0 else []
    axes.set_yscale("log")
    for number, own in enumerate(rows.values()):
        found = {
            place_of(folder, number, len(rows)): shown(row, panel)
            for folder, row in enumerate(own)
            if is_drawn(shown(row, panel))
        }
        if not found:
            continue
        value, low, high = np.array(list(found.values())).T
        low, high = np.where(low > 0, low, value), np.where(np.isfinite(high), high, value)
        reach = np.maximum([value - low, high - value], 0.0)
        axes.errorbar(
            list(found), value, yerr=reach, fmt=f"-{marker_of(number)}", color=colour_of(number),
            markersize=4.5, linewidth=0.9, elinewidth=0.9, capsize=2,
        )  # fmt: skip
        ends += [*low, *high]
    if panel == 0:
        axes.axhline(1.0, color="black", linewidth=0.9, linestyle="--", zorder=1)
    _value_axis(axes, ends or [1.0])


def _value_axis(axes: Axes, ends: Sequence[float]) -> None:
    """A logarithmic axis with a few plain numbers."""
    low, high = math.log10(min(ends)), math.log10(max(ends))
    rim = max(0.06 * (high - low), 0.05)
    low, high = low - rim, high + rim
    axes.set_ylim(10**low, 10**high)
    axes.yaxis.set_major_locator(FixedLocator(round_ticks(low, high)))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.6g}"))
    axes.grid(axis="y")


def round_ticks(low: float, high: float) -> list[float]:
    """A few round numbers from 10**low to 10**high; powers of ten where there is no room for more."""
    decades = range(math.floor(low), math.ceil(high) + 1)
    fine = [by * 10.0**decade for decade in decades for by in TICK_MULTIPLES]
    fine = [tick for tick in fine if low <= math.log10(tick) <= high]
    if len(fine) < 3:
        even = MaxNLocator(MOST_TICKS - 3, steps=[1, 2, 2.5, 5, 10]).tick_values(10**low, 10**high)
        return [float(tick) for tick in even if 10**low <= tick <= 10**high]
    if len(fine) <= MOST_TICKS:
        return fine
    every = math.ceil((high - low) / MOST_TICKS)
    return [10.0**decade for decade in decades if decade % every == 0 and low <= decade <= high]


def _folder_axis(axes: Axes, labels: Sequence[str], turned: bool) -> None:
    """A tick for each folder; as many labels as there is room for."""
    count = len(labels)
    every = math.ceil(count * LABEL_TURNED / (WIDEST - LEFT - RIM))
    axes.set_xlim(-0.5, count - 0.5)
    axes.set_xticks(range(0, count, every), labels[::every], rotation=90 if turned else 0)
    axes.spines["bottom"].set_visible(any(labels))
