"""Where the truth ranks among samples of what is believed: flat for the honest, whatever they believe."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.ticker import FixedLocator

from ..consistency.calibration import uniform_band
from .data import FigureData
from .sheet import Sheet
from .style import CLAIMED, symbol
from .ticks import FittingLocator, even_numbers

# Bars outside the band: in grey their colour is that of the others.
OUTSIDE: dict[str, Any] = {"facecolor": "#D55E00", "edgecolor": "white", "hatch": "/////", "linewidth": 0}


def draw_ranks(data: FigureData, sheet: Sheet) -> None:
    """A row of rank histograms for each estimator that was sampled, after the last measurement.

    A histogram for each component, and one for the distance from the middle of the belief. The band holds all
    ten bars of an honest one in 95 % of studies; bars outside it are coloured and hatched.
    """
    rows = [row for row in data.drawn_rows if row.beams == data.beams]
    sampled = [(row, row.beliefs.ranks) for row in rows if row.beliefs]
    names = sampled[0][0].names
    columns = [*(f"rank of {symbol(name)}, %" for name in names), "rank of the distance, %"]
    scale, narrow = sheet.layout.scale, sheet.layout.width is not None
    panels = sheet.panels(
        len(sampled) * len(columns),
        columns=len(columns),
        natural=(1.0 + 1.9 * len(columns), 1.2 + 1.25 * len(sampled)),
        beside=0.5 * scale,
        height=lambda width: scale * (0.85 + 0.4 / len(sampled)),
        sharex=True,
        sharey="row" if narrow else "none",
    ).reshape(len(sampled), len(columns))
    for line, (row, histograms) in zip(panels, sampled, strict=True):
        for axes, counts in zip(line, histograms, strict=True):
            total, bins = counts.sum(), len(counts)
            band = [100 * end / total for end in uniform_band(int(total), bins)]
            shares = 100 * counts / total
            wrong = (shares < band[0]) | (shares > band[1])
            places = (np.arange(bins) + 0.5) * 100 / bins
            for which, style in ((~wrong, {"color": CLAIMED}), (wrong, OUTSIDE)):
                axes.bar(places[which], shares[which], width=88 / bins, **style)
            axes.axhspan(*band, color="0.5", alpha=0.25, linewidth=0, zorder=3)
            axes.set_xlim(0, 100)
            top = 1.1 * max(shares.max(), band[1])
            axes.set_ylim(0, max(top, axes.get_ylim()[1]) if narrow and axes is not line[0] else top)
            axes.xaxis.set_major_locator(FittingLocator([FixedLocator([0, 50, 100]), FixedLocator([0, 100])]))
            even_numbers(axes.yaxis, 4)
        sheet.title(line[0], row.estimator, width=1.8 * (sheet.panel_width or sheet.title_width))
        line[0].set_ylabel("runs, %")
    for axes, name in zip(panels[-1], columns, strict=True):
        axes.set_xlabel(sheet.broken(name, "axes.labelsize"))
    sheet.finish(
        data.heading("Ranks of the truth among samples of the belief", with_beams=True),
        columns=1,
        note=data.silent,
    )
