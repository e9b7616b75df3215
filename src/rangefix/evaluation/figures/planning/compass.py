"""A plan of beams on the floor plan: how good each direction is, round the compass, before each beam."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ....arrays import Array
from ...planning.plans import Plan, Step
from ...planning.scene import FloorPlan
from ..layout import wrapped
from ..sheet import MARGIN, legend_below
from ..style import COLOURS, label_positions

PANEL = 3.1  # inches
MOST_PANELS = 8
INNER, OUTER = 0.12, 0.45  # of the map's shorter side: the worst and the best direction
GAP = 3.0  # times the usual angle between candidates, at which the curve is broken
MOST_POINTS = 12  # candidates that are drawn as points, not as a curve
CHOSEN, EARLIER, DASHES = COLOURS[5], "0.55", (0, (5, 2))  # beams
TITLE = "How good each direction is as the next beam"


def draw_plan(plan: Plan, floor: FloorPlan) -> Figure:
    """One panel for each beam; the curve is further out where a direction is better.

    A legend says what each mark and line is.

    Args:
        plan: What was chosen.
        floor: Walls, and the place about which the compass is drawn.
    """
    steps = plan.steps[:MOST_PANELS]
    columns = min(len(steps), 4)
    lines = -(-len(steps) // columns)
    width = columns * PANEL + 0.3
    figure = Figure(figsize=(width, PANEL), layout="constrained")
    panels = figure.subplots(lines, columns, squeeze=False).ravel()
    for axes in panels[len(steps) :]:
        axes.set_visible(False)
    before: list[float] = []
    for number, (axes, step) in enumerate(zip(panels, steps, strict=False), start=1):
        _draw_floor(axes, floor)
        _draw_curve(axes, floor, plan.candidates, step.objective)
        for bearing in before:
            _draw_beam(axes, floor, bearing, EARLIER, 1.0)
        if step.bearing is not None:
            _draw_beam(axes, floor, step.bearing, CHOSEN, 1.8)
            before.append(step.bearing)
        after = f"then the position errs by {step.position_std:.3g} m (rms)"
        axes.set_title(f"beam {number}: {_direction(step.bearing)}\n{after}")
    low, high = _show_all(list(panels[: len(steps)]), floor)
    shape = float(np.clip((high - low)[1] / (high - low)[0], 0.4, 2.0))
    figure.set_figheight(lines * (PANEL * shape + 0.9))
    room = width - 2 * MARGIN
    added = legend_below(figure, _legend(plan, steps), room, 2, _note(plan, len(steps)))
    title = wrapped(TITLE, room, "figure.titlesize")
    figure.suptitle(title)
    figure.set_figheight(figure.get_figheight() + added + 0.2 * title.count("\n"))
    return figure


def _legend(plan: Plan, steps: Sequence[Step]) -> dict[str, Artist]:
    """Label -> what it says of the panels of some steps."""
    named = {"trace": "trace", "det": "determinant", "largest": "largest eigenvalue"}
    what = f"smaller expected {named.get(plan.criterion, '')} of the position's covariance"
    if plan.criterion == "information":
        what = "more expected information"
    entries: dict[str, Artist] = {"walls": Line2D([], [], color="black", linewidth=1.4)}
    entries["free place nearest to the prior's mean: directions are drawn about it"] = Line2D(
        [], [], marker="+", color="black", markersize=6, linestyle="none"
    )
    if any(np.isfinite(step.objective).any() for step in steps):
        few = len(plan.candidates) <= MOST_POINTS
        entries[f"each direction as the next beam: further out = {what}"] = Line2D(
            [], [], color=COLOURS[0], linewidth=1.1, markersize=3, marker="o" if few else "",
            linestyle="none" if few else "-",
        )  # fmt: skip
    if any(step.bearing is not None for step in steps):
        entries["the beam of the plan"] = Line2D([], [], color=CHOSEN, linewidth=1.8, linestyle=DASHES)
    if len(steps) > 1 and steps[0].bearing is not None:
        entries["beams before it"] = Line2D([], [], color=EARLIER, linewidth=1.0, linestyle=DASHES)
    return entries


def _note(plan: Plan, shown: int) -> str:
    """What a reader would ask: why a beam is not the best direction, and where the others are."""
    notes = []
    if not plan.adaptive and plan.method != "greedy" and len(plan.steps) > 1:
        notes.append("The beams are chosen together: one of them need not be the best as the next.")
    if shown < len(plan.steps):
        notes.append(f"The first {shown} of {len(plan.steps)} beams.")
    return " ".join(notes)


def _direction(bearing: float | None) -> str:
    return (
        "by the readings" if bearing is None else f"{np.rad2deg(bearing):.2f}".rstrip("0").rstrip(".") + "°"
    )


def _draw_floor(axes: Axes, floor: FloorPlan) -> None:
    walls = list(floor.segments.reshape(-1, 2, 2))
    axes.add_collection(LineCollection(walls, colors="black", linewidths=1.4, capstyle="projecting"))
    axes.plot(*floor.place, marker="+", color="black", markersize=6)
    label_positions(axes)


def _show_all(panels: Sequence[Axes], floor: FloorPlan) -> tuple[Array, Array]:
    """Have all panels show the map, and what reaches beyond it of the compass; the corners of both, m."""
    boxes = [np.asarray(floor.bounds), *(axes.dataLim.get_points() for axes in panels)]
    low, high = np.min(boxes, axis=(0, 1)), np.max(boxes, axis=(0, 1))
    edge = 0.04 * float((high - low).max())
    for axes in panels:
        axes.set_xlim(low[0] - edge, high[0] + edge)
        axes.set_ylim(low[1] - edge, high[1] + edge)
    return low, high


def _draw_curve(axes: Axes, floor: FloorPlan, bearings: Array, objective: Array) -> None:
    """The objective: the best direction outermost; on a log scale where all values are positive."""
    if not np.isfinite(objective).any():
        return
    values = np.log(objective) if (objective[np.isfinite(objective)] > 0).all() else objective
    best, worst = float(np.nanmin(values)), float(np.nanmax(values))
    share = (worst - values) / (worst - best) if worst > best else np.ones_like(values)
    short = float((floor.bounds[1] - floor.bounds[0]).min())
    order = np.argsort(bearings)
    angle, radius = bearings[order], (short * (INNER + (OUTER - INNER) * share))[order]
    steps = np.diff(angle)
    if len(steps) and steps.max() > GAP * np.median(steps):
        places = np.flatnonzero(steps > GAP * np.median(steps)) + 1
        angle, radius = np.insert(angle, places, np.nan), np.insert(radius, places, np.nan)
    points = floor.place + radius[:, None] * _unit(angle + floor.heading)
    style = "-" if len(bearings) > MOST_POINTS else "o"
    axes.plot(*points.T, style, color=COLOURS[0], linewidth=1.1, markersize=3)


def _draw_beam(axes: Axes, floor: FloorPlan, bearing: float, colour: str, width: float) -> None:
    short = float((floor.bounds[1] - floor.bounds[0]).min())
    line = np.stack(
        [floor.place, floor.place + 1.1 * OUTER * short * _unit(np.array(bearing + floor.heading))]
    )
    axes.plot(*line.T, color=colour, linewidth=width, linestyle=DASHES)


def _unit(angle: Array) -> Array:
    return np.stack([np.sin(angle), np.cos(angle)], axis=-1)
