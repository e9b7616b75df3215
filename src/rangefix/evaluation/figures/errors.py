"""Errors run by run, in the bands and ellipses that estimators claim."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse

from ...arrays import Array
from ...errors import counted
from ..consistency.formatting import beams_in_words, factor, unit
from .data import FigureData
from .layout import MAX_BESIDE
from .sheet import Sheet
from .style import CLAIMED, symbol
from .ticks import even_numbers, signed_decades

SHOWN_RUNS = 200  # in the picture of errors run by run
SHOWN_ERRORS = 1000  # in the picture of errors in the plane
BAND_95 = 1.96  # standard deviations of the band that holds 95 % of a Gaussian
ELLIPSE_95 = 2.4477  # the same for an ellipse in the plane: the root of the chi-square quantile


def draw_runs(data: FigureData, sheet: Sheet) -> None:
    """Errors of single runs in the band that their estimator claims, runs in the order of that claim."""
    results, names, estimators = data.results, data.results.space.names, data.answering
    scale = sheet.layout.scale
    columns = sheet.layout.columns(len(estimators), MAX_BESIDE, 1.35, beside=0.75)
    lines = -(-len(estimators) // columns)
    panels = sheet.panels(
        len(estimators),
        len(names),
        columns=columns,
        natural=(0.9 + 2.35 * columns, 0.9 + 2.2 * len(names) * lines),
        beside=0.75 * scale,
        inset=0.05,
        height=lambda width: scale * (0.5 + (0.3 + min(1.6, max(0.75 * width, 1.05))) * len(names)),
        sharey="row",
        sharex=True,
    )
    for k, (block, estimator) in enumerate(zip(panels, estimators, strict=True)):
        trials = results.get(estimator, data.beams)
        errors = results.errors(trials)[trials.ok, -1]
        stds = np.sqrt(np.maximum(np.diagonal(trials.covariance[trials.ok, -1], axis1=-2, axis2=-1), 0.0))
        for i, (axes, name) in enumerate(zip(block, names, strict=True)):
            times = factor(name)
            share = _runs_panel(axes, times * errors[:, i], times * stds[:, i], _linear(name))
            sheet.title(axes, *([data.labels[estimator]] if i == 0 else []), share)
            if k % columns == 0:
                of = f"error of {symbol(name)}, {unit(name)}\n(linear to {_linear(name):g}, then log)"
                axes.set_ylabel(sheet.broken(of, "axes.labelsize", sheet.layout.width and scale * 1.15))
        block[-1].set_xlabel(sheet.broken("runs, by claimed std", "axes.labelsize"))
        if lines > 1:
            block[-1].tick_params(labelbottom=True)
    for of_component in panels.T if lines > 1 else ():  # one scale for all lines of panels
        limits = np.array([axes.get_ylim() for axes in of_component])
        for axes in of_component:
            axes.set_ylim(limits[:, 0].min(), limits[:, 1].max())
    title = data.heading(
        f"Errors of {counted(min(SHOWN_RUNS, results.runs), 'run')} in their claimed bands", with_beams=True
    )
    sheet.finish(title, panels[0, :1], columns=3, note=data.silent)


def _linear(name: str) -> float:
    """Up to where the scale of an error is linear, in its unit."""
    return 1.0 if name == "heading" else 0.1


def _runs_panel(axes: Axes, errors: Array, stds: Array, linear: float) -> str:
    """Draw the first runs; returns what share of all runs lies inside the band, in words."""
    inside = np.abs(errors) <= BAND_95 * stds
    shown = np.argsort(stds[:SHOWN_RUNS], kind="stable")
    band, error, held = BAND_95 * stds[shown], errors[shown], inside[shown]
    place = np.arange(len(shown))
    label = "claimed 95 % band, \u00b11.96 std"
    style: dict[str, Any] = {"step": "mid", "facecolor": "#9CC7E4", "edgecolor": CLAIMED, "linewidth": 0.6}
    axes.fill_between(place, -band, band, label=label, **style)
    axes.plot(place[held], error[held], ".", markersize=3, color="black", label="error inside")
    axes.plot(place[~held], error[~held], "x", markersize=4, color="#D55E00", label="error outside")
    axes.set_yscale("symlog", linthresh=linear)
    signed_decades(axes.yaxis, linear)
    even_numbers(axes.xaxis, 6, whole=True)
    axes.axhline(0.0, color="0.5", linewidth=0.6)
    return f"{100 * inside.mean():.0f} % inside the band"


def draw_errors(data: FigureData, sheet: Sheet) -> None:
    """Errors in the plane, with the ellipses of what is true (G) and of what is claimed on average (P)."""
    estimators = data.answering
    widest = len(estimators) if len(estimators) <= 4 else min(-(-len(estimators) // 2), MAX_BESIDE)
    columns = sheet.layout.columns(len(estimators), widest, 1.4, beside=0.25)
    lines = -(-len(estimators) // columns)
    panels = sheet.panels(
        len(estimators),
        columns=columns,
        natural=(0.6 + 2.7 * columns, 1.1 + 2.7 * lines),
        beside=0.25,
        inset=0.4 * sheet.layout.scale,
        height=lambda width: min(2.0, width) + 0.85 * sheet.layout.scale,
    )[:, 0]
    for axes, estimator in zip(panels, estimators, strict=True):
        _ellipses_panel(axes, data, estimator, sheet)
    for axes in panels[::columns]:
        axes.set_ylabel(f"error of {symbol('x2')}, m")
    title = f"Errors with ellipses of G and P, {beams_in_words(data.beams)}; scales differ"
    sheet.finish(data.heading(title), panels[:1], columns=3, note=data.silent)


def _ellipses_panel(axes: Axes, data: FigureData, estimator: str, sheet: Sheet) -> None:
    """One estimator; the scale is that of its own errors and claims."""
    results, where = data.results, data.results.space.position_indices
    trials = results.get(estimator, data.beams)
    errors = results.errors(trials)[trials.ok, -1][:, where]
    claims = trials.covariance[trials.ok, -1][:, where][:, :, where]
    axes.set_xlabel(f"error of {symbol('x1')}, m")
    for axis in (axes.xaxis, axes.yaxis):
        even_numbers(axis)
    axes.axhline(0.0, color="0.85", linewidth=0.6)
    axes.axvline(0.0, color="0.85", linewidth=0.6)
    true, claimed = errors.T @ errors / len(errors), claims.mean(0)
    shown = errors[:SHOWN_ERRORS]
    axes.plot(*shown.T, ".", markersize=2, color="0.7", zorder=1, label="error of one run")
    label = "claimed: 95 % ellipse of a Gaussian with mean P"
    axes.add_patch(ellipse(claimed, edgecolor=CLAIMED, linewidth=2.8, zorder=3, label=label))
    axes.add_patch(ellipse(true, edgecolor="black", linestyle="--", zorder=4, label="true: the same with G"))
    told = [data.labels[estimator], f"{len(errors)} of {len(trials.ok)} ok"]
    reach = 1.3 * ELLIPSE_95 * np.sqrt(np.maximum(np.diagonal(true), np.diagonal(claimed)))
    if (reach > 0).all():
        axes.set_xlim(-reach[0], reach[0])
        axes.set_ylim(-reach[1], reach[1])
        if beyond := int((np.abs(shown) > reach).any(-1).sum()):
            told.append(f"{beyond} beyond the edges")
    sheet.title(axes, *told)


def ellipse(covariance: Array, centre: tuple[float, ...] = (0.0, 0.0), **style: Any) -> Ellipse:
    """The curve e' P^-1 e = chi-square quantile (95 %) about a centre."""
    values, vectors = np.linalg.eigh(covariance)
    width, height = 2 * ELLIPSE_95 * np.sqrt(np.maximum(values, 0.0))
    angle = float(np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0])))
    return Ellipse((centre[0], centre[1]), width, height, angle=angle, fill=False, **style)
