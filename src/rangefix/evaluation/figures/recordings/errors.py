"""How far estimates of a recording are off in the bands that they claim, and how readings fit the map."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ....arrays import Array, wrap
from ...recordings.trace import Trace
from ..sheet import legend_below
from ..style import COLOURS, colour_and_line, symbol

WIDTH, PANEL = 9.0, 1.7  # inches
BAND = 1.96  # deviations
LEGEND_COLUMNS = 4


def draw_errors(name: str, trace: Trace) -> Figure:
    """Errors of the three components over time, with the band that is claimed to hold 95 % of them.

    An error is truth minus estimate, as in studies.

    Args:
        name: Of the estimator.
        trace: Its replay; some true poses must be known.
    """
    times = trace.times - trace.times[0]
    errors = trace.truths - trace.means
    errors[:, 2] = wrap(errors[:, 2])
    stds = np.sqrt(np.diagonal(trace.covariances, axis1=1, axis2=2))
    figure = Figure(figsize=(WIDTH, 3 * PANEL + 0.8), layout="constrained")
    panels = figure.subplots(3, 1, sharex=True)
    degrees = 180 / np.pi
    scales = ((symbol("x1") + ", m", 1.0), (symbol("x2") + ", m", 1.0), ("heading, deg", degrees))
    for place, (label, factor) in enumerate(scales):
        axes: Axes = panels[place]
        band = factor * BAND * stds[:, place]
        axes.fill_between(
            times, -band, band, color=COLOURS[6], alpha=0.45, linewidth=0, label="claimed, 95 %"
        )
        axes.plot(
            times, factor * errors[:, place], color="black", linewidth=0.9, label="error: truth - estimate"
        )
        axes.axhline(0.0, color="0.5", linewidth=0.6)
        axes.set_ylabel(label)
    panels[-1].set_xlabel("time, s")
    _legend_below(figure, panels[0])
    inside = (np.abs(errors) <= BAND * stds)[np.isfinite(errors).all(axis=1)]
    figure.suptitle(f"Errors of {name}: {100 * inside.mean():.0f} % of them in the bands, of 95 % claimed")
    return figure


def draw_fit(traces: Mapping[str, Trace]) -> Figure:
    """Innovations: readings against the map at the estimates, evidence of each scan, and whether one is lost.

    Without the evidence where nobody tells one, as of poses that were recorded.

    Args:
        traces: By the name of the estimator.
    """
    told = any(np.isfinite(step.log_evidence) for trace in traces.values() for step in trace.kept)
    figure = Figure(figsize=(WIDTH, (2 + told) * (PANEL + 0.6)), layout="constrained")
    panels = figure.subplots(2 + told, 1, sharex=True)
    upper, last = panels[0], panels[-1]
    for place, (name, trace) in enumerate(traces.items()):
        colour, line = colour_and_line(place)
        times = trace.times - trace.times[0]
        low, middle, high = _quartiles(trace.residuals)
        upper.fill_between(times, low, high, color=colour, alpha=0.2, linewidth=0)
        upper.plot(times, middle, line, color=colour, linewidth=0.9, label=name)
        if told:
            evidence = np.array([step.log_evidence for step in trace.kept])
            beams = np.array([max(int((~np.isnan(step.step.measurement)).sum()), 1) for step in trace.kept])
            gained = np.diff(evidence, prepend=0.0) / trace.every / beams
            panels[1].plot(times, gained, line, color=colour, linewidth=0.8)
        excess = trace.misfits[:, 0] / trace.misfits[:, 1]
        last.plot(times, excess, line, color=colour, linewidth=0.8)
        last.plot(times[excess > 1], excess[excess > 1], ".", color=colour, markersize=3)
    upper.axhline(0.0, color="0.5", linewidth=0.6)
    upper.set_ylabel("reading - map, m")
    upper.set_title("Readings less the map's ranges at the estimate: median of a scan, and middle half")
    if told:
        panels[1].set_ylabel("nats per beam")
        panels[1].set_title("Log evidence that each scan adds")
    last.axhline(1.0, color="0.5", linewidth=0.6)
    last.set_ylim(bottom=0.0)
    last.set_ylabel("misfit / threshold")
    last.set_title("Lost: above 1 the last scans do not fit the map where the robot was believed to be")
    last.set_xlabel("time, s")
    _legend_below(figure, upper)
    return figure


def _legend_below(figure: Figure, axes: Axes) -> None:
    """What the lines and bands of a panel are, below all panels, where it covers none of them."""
    artists, labels = axes.get_legend_handles_labels()
    entries = dict(zip(labels, artists, strict=True))
    height = legend_below(figure, entries, WIDTH - 0.2, LEGEND_COLUMNS)
    figure.set_figheight(float(figure.get_figheight()) + height)


def _quartiles(residuals: Array) -> Array:
    """Quartiles of each scan, (3, K); NaN of a scan without residuals."""
    result = np.full((3, len(residuals)), np.nan)
    some = np.isfinite(residuals).any(axis=1)
    result[:, some] = np.nanquantile(residuals[some], [0.25, 0.5, 0.75], axis=1)
    return result
