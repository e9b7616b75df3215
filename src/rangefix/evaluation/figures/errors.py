"""Errors run by run, in the bands and ellipses that estimators claim."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from matplotlib.ticker import FuncFormatter, MaxNLocator, SymmetricalLogLocator

from ...arrays import Array
from ..consistency.formatting import beams_in_words, factor, unit
from .data import FigureData
from .style import CLAIMED, finish, panel_title, symbol

SHOWN_RUNS = 200  # in the picture of errors run by run
SHOWN_ERRORS = 1000  # in the picture of errors in the plane
BAND_95 = 1.96  # standard deviations of the band that holds 95 % of a Gaussian
ELLIPSE_95 = 2.4477  # the same for an ellipse in the plane: the root of the chi-square quantile


def runs_figure(data: FigureData) -> Figure:
    """Errors of single runs in the band that their estimator claims, runs in the order of that claim."""
    results, names, estimators = data.results, data.results.space.names, data.results.estimators
    figure = Figure(figsize=(0.9 + 2.35 * len(estimators), 0.9 + 2.2 * len(names)), layout="constrained")
    panels = figure.subplots(len(names), len(estimators), squeeze=False, sharey="row", sharex=True)
    for column, estimator in enumerate(estimators):
        trials = results.get(estimator, data.beams)
        errors = results.errors(trials)[trials.ok, -1]
        stds = np.sqrt(np.maximum(np.diagonal(trials.covariance[trials.ok, -1], axis1=-2, axis2=-1), 0.0))
        for i, name in enumerate(names):
            times = factor(name)
            share = _runs_panel(panels[i, column], times * errors[:, i], times * stds[:, i], _linear(name))
            panel_title(panels[i, column], *([data.labels[estimator]] if i == 0 else []), share)
        panels[-1, column].set_xlabel("runs, by claimed std")
    for i, name in enumerate(names):
        panels[i, 0].set_ylabel(
            f"error of {symbol(name)}, {unit(name)}\n(linear to {_linear(name):g}, then log)"
        )
    title = f"Errors of {min(SHOWN_RUNS, results.runs)} runs in their claimed bands"
    return finish(figure, data.heading(title, with_beams=True), panels[:1, 0], columns=3)


def _linear(name: str) -> float:
    """Up to where the scale of an error is linear, in its unit."""
    return 1.0 if name == "heading" else 0.1


def _runs_panel(axes: Axes, errors: Array, stds: Array, linear: float) -> str:
    """Draw the first runs; returns what share of all runs lies inside the band, in words."""
    inside = np.abs(errors) <= BAND_95 * stds
    shown = np.argsort(stds[:SHOWN_RUNS], kind="stable")
    band, error, held = BAND_95 * stds[shown], errors[shown], inside[shown]
    place = np.arange(len(shown))
    label = "claimed 95 % band, $\\pm$1.96 std"
    style: dict[str, Any] = {"step": "mid", "facecolor": "#9CC7E4", "edgecolor": CLAIMED, "linewidth": 0.6}
    axes.fill_between(place, -band, band, label=label, **style)
    axes.plot(place[held], error[held], ".", markersize=3, color="black", label="error inside")
    axes.plot(place[~held], error[~held], "x", markersize=4, color="#D55E00", label="error outside")
    axes.set_yscale("symlog", linthresh=linear)
    axes.yaxis.set_major_locator(SymmetricalLogLocator(base=10, linthresh=linear))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.axhline(0.0, color="0.5", linewidth=0.6)
    return f"{100 * inside.mean():.0f} % inside the band" if len(errors) else "no run went well"


def ellipses_figure(data: FigureData) -> Figure:
    """Errors in the plane, with the ellipses of what is true (G) and of what is claimed on average (P)."""
    estimators = data.results.estimators
    columns = len(estimators) if len(estimators) <= 4 else -(-len(estimators) // 2)
    rows = -(-len(estimators) // columns)
    figure = Figure(figsize=(0.6 + 2.7 * columns, 1.1 + 2.7 * rows), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False)
    for axes, estimator in zip(panels.flat, estimators, strict=False):
        _ellipses_panel(axes, data, estimator)
    for axes in panels.flat[len(estimators) :]:
        axes.set_visible(False)
    for axes in panels[:, 0]:
        axes.set_ylabel("error of $x_2$, m")
    title = f"Errors with ellipses of G and P, {beams_in_words(data.beams)}; scales differ"
    return finish(figure, data.heading(title), panels[:1, 0], columns=3)


def _ellipses_panel(axes: Axes, data: FigureData, estimator: str) -> None:
    """One estimator; the scale is that of its own errors and claims."""
    results, where = data.results, data.results.space.position_indices
    trials = results.get(estimator, data.beams)
    errors = results.errors(trials)[trials.ok, -1][:, where]
    claims = trials.covariance[trials.ok, -1][:, where][:, :, where]
    panel_title(axes, data.labels[estimator], f"{len(errors)} of {len(trials.ok)} ok")
    axes.set_xlabel("error of $x_1$, m")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(5))
    axes.axhline(0.0, color="0.85", linewidth=0.6)
    axes.axvline(0.0, color="0.85", linewidth=0.6)
    if not len(errors):
        return
    true, claimed = errors.T @ errors / len(errors), claims.mean(0)
    axes.plot(*errors[:SHOWN_ERRORS].T, ".", markersize=2, color="0.7", zorder=1, label="error of one run")
    label = "claimed: 95 % ellipse of a Gaussian with mean P"
    axes.add_patch(ellipse(claimed, edgecolor=CLAIMED, linewidth=2.8, zorder=3, label=label))
    axes.add_patch(ellipse(true, edgecolor="black", linestyle="--", zorder=4, label="true: the same with G"))
    reach = 1.3 * ELLIPSE_95 * np.sqrt(np.maximum(np.diagonal(true), np.diagonal(claimed)))
    if (reach > 0).all():
        axes.set_xlim(-reach[0], reach[0])
        axes.set_ylim(-reach[1], reach[1])


def ellipse(covariance: Array, centre: tuple[float, ...] = (0.0, 0.0), **style: Any) -> Ellipse:
    """The curve e' P^-1 e = chi-square quantile (95 %) about a centre."""
    values, vectors = np.linalg.eigh(covariance)
    width, height = 2 * ELLIPSE_95 * np.sqrt(np.maximum(values, 0.0))
    angle = float(np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0])))
    return Ellipse((centre[0], centre[1]), width, height, angle=angle, fill=False, **style)
