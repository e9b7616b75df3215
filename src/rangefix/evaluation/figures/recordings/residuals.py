"""Residuals on the map against the noise that was fitted to them: their law, and how they hang together."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...recordings.calibrate import Calibration
from ..style import CLAIMED, COLOURS, TRUE
from ..ticks import plain_numbers

SIZE = (10.0, 4.0)  # inches
REACH = 6.0  # deviations of hits that are shown to each side
BINS = 81
CURVE_POINTS = 400  # points of a curve


def draw_residuals(calibration: Calibration) -> Figure:
    """Two panels: the density of residuals, and the correlation of their scores by distance."""
    figure = Figure(figsize=SIZE, layout="constrained")
    law, together = figure.subplots(1, 2)
    _draw_law(law, calibration)
    _draw_correlation(together, calibration)
    return figure


def _draw_law(axes: Axes, calibration: Calibration) -> None:
    fitted, expected, readings = calibration.fitted, calibration.expected, calibration.residuals.readings
    good = np.isfinite(readings) & np.isfinite(expected)
    found = readings[good] - expected[good]
    low, high = (fitted.bias + side * REACH * fitted.mixture.std for side in (-1, 1))
    edges = np.linspace(low, high, BINS)
    counts, _ = np.histogram(found, edges)
    density = counts / (len(found) * np.diff(edges))
    where = "" if calibration.residuals.from_truth else ", scans at their best poses"
    axes.stairs(density, edges, color=TRUE, label=f"residuals{where}")
    places = np.linspace(low, high, CURVE_POINTS)
    middle = float(np.median(expected[good]))
    model = np.exp(fitted.law.noise.log_density(middle + places, np.full(CURVE_POINTS, middle)))
    axes.plot(places, model, color=CLAIMED, label="fitted")
    axes.set_yscale("log")
    plain_numbers(axes.yaxis)
    axes.set_ylim(max(1e-3, 0.3 * float(density[density > 0].min())), 2 * float(model.max()))
    axes.set_xlabel("reading minus range of the map, m")
    axes.set_ylabel("density, 1/m")
    axes.legend()


def _draw_correlation(axes: Axes, calibration: Calibration) -> None:
    fitted = calibration.fitted
    curve, correlated = fitted.curve, fitted.correlated
    axes.plot(curve.distance_m, curve.within, "o", color=COLOURS[0], label="beams of one scan")
    axes.plot(curve.distance_m, curve.across, "s", color=COLOURS[1], label="beams of two scans")
    distance = np.geomspace(curve.distance_m[0], curve.distance_m[-1], CURVE_POINTS)
    model = correlated.from_places(distance)
    axes.plot(distance, model, color=TRUE, label="fitted error of the map")
    if correlated.scan:
        axes.plot(distance, model + correlated.scan, "--", color=TRUE, label="with that of a scan")
    axes.axhline(0.0, color="grey", linewidth=0.8)
    axes.set_xscale("log")
    plain_numbers(axes.xaxis)
    axes.set_xlabel("distance of the places that two beams meet, m")
    axes.set_ylabel("correlation of errors")
    axes.legend()
