"""The threshold curve: how good anybody could be, over the noise of the beams."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from ....arrays import Array
from ...bounds.threshold import PRIOR, ThresholdCurve
from ...consistency.formatting import factor, unit
from ..style import colour_and_marker, symbol
from ..ticks import plain_numbers

PANEL = 4.2, 3.8  # inches
OPTIMUM = "optimum"


def draw_threshold(curve: ThresholdCurve, title: str) -> Figure:
    """Standard deviations over that of the noise, both on log scales, a panel for each component.

    Args:
        curve: What was computed.
        title: What it is of.
    """
    count = len(curve.names)
    figure = Figure(figsize=(PANEL[0] * count + 0.3, PANEL[1] + 0.8), layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, count))
    for place, (axes, name) in enumerate(zip(panels, curve.names, strict=True)):
        for number, (entry, variances) in enumerate(curve.variances.items()):
            stds: Array = factor(name) * np.sqrt(variances[:, place])
            if not np.isfinite(stds).any():
                continue
            if entry == PRIOR:
                axes.plot(curve.stds, stds, color="0.4", linestyle=":", label="prior: nothing measured")
            else:
                style = {"linewidth": 2.2} if entry == OPTIMUM else {"linewidth": 1.2, "linestyle": "--"}
                colour, marker = colour_and_marker(number)
                axes.plot(curve.stds, stds, color=colour, marker=marker, markersize=4, label=entry, **style)
        axes.set_xscale("log")
        axes.set_yscale("log")
        for axis in (axes.xaxis, axes.yaxis):
            plain_numbers(axis, (1.0,))
        axes.grid(which="major")
        axes.set_xlabel("standard deviation of the noise, m")
        axes.set_ylabel(f"standard deviation of {symbol(name)}, {unit(name)}")
    panels[0].legend(loc="lower right")
    figure.suptitle(title)
    return figure
