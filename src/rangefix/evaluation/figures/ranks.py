"""Where the truth ranks among samples of what is believed: flat for the honest, whatever they believe."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from ..consistency.calibration import uniform_band
from .data import FigureData
from .style import CLAIMED, symbol

MAX_ESTIMATORS_SHOWN = 8  # estimators under each other
OUTSIDE = "#D55E00"


def ranks_figure(data: FigureData) -> Figure:
    """A row of rank histograms for each estimator that was sampled, after the last measurement.

    A histogram for each component, and one for the distance from the middle of the belief. The band holds all
    ten bars of an honest one in 95 % of studies; bars outside it are coloured.
    """
    rows = [row for row in data.last_rows if row.beams == data.beams]
    sampled = [(row, row.beliefs.ranks) for row in rows if row.beliefs][:MAX_ESTIMATORS_SHOWN]
    names = sampled[0][0].names
    columns = [*(f"rank of {symbol(name)}" for name in names), "rank of the distance"]
    size = (1.0 + 1.9 * len(columns), 1.2 + 1.25 * len(sampled))
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(len(sampled), len(columns), squeeze=False, sharex=True)
    for line, (row, histograms) in zip(panels, sampled, strict=True):
        for axes, counts in zip(line, histograms, strict=True):
            total, bins = counts.sum(), len(counts)
            band = [100 * end / total for end in uniform_band(int(total), bins)]
            shares = 100 * counts / total
            wrong = (shares < band[0]) | (shares > band[1])
            places = (np.arange(bins) + 0.5) * 100 / bins
            colours = [OUTSIDE if is_wrong else CLAIMED for is_wrong in wrong]
            axes.bar(places, shares, width=88 / bins, color=colours)
            axes.axhspan(*band, color="0.5", alpha=0.25, linewidth=0, zorder=3)
            axes.set_xlim(0, 100)
            axes.set_ylim(0, 1.1 * max(shares.max(), band[1]))
            axes.set_xticks([0, 50, 100])
        line[0].set_title(row.estimator)
        line[0].set_ylabel("runs, %")
    for axes, name in zip(panels[-1], columns, strict=True):
        axes.set_xlabel(f"{name}, %")
    title = data.heading("Ranks of the truth among samples of the belief", with_beams=True)
    figure.suptitle(title, fontsize=10.5)
    return figure
