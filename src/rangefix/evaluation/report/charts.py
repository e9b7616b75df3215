"""The charts that belong to the text of a report: SVG in its own colours, light and dark, at any width.

Pictures of rooms and clouds of errors come from `figures`; these here are a few lines and dots each, whose
letters must keep their size on a telephone. Lanes place what they show by percentages, panels by a view box.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...arrays import Array
from ..consistency import CERTAIN, LARGE_FACTOR, Curve, Interval, Reliability, format_number, uniform_band
from .html import Html, tag

INSET = 2.0  # per cent at each end of a lane, so that dots are not cut
SIDE, LEFT, TOP, PLOT = 200, 36, 8, 150  # of a panel's view box


class Scale(NamedTuple):
    """A logarithmic axis."""

    low: float
    high: float

    @classmethod
    def over(cls, values: Sequence[float], least: float, most: float) -> Scale:
        """Wide enough for the values that are positive and finite, and for `least` and `most`."""
        some = [value for value in values if 0 < value < math.inf]
        return cls(min([least, *some]) / 1.15, max([most, *some]) * 1.15)

    def share(self, value: float) -> float:
        """Where a value lies, 0 to 1; held at the ends."""
        if not value > 0:
            return 0.0
        place = math.log(value / self.low) / math.log(self.high / self.low)
        return min(max(place, 0.0), 1.0)

    def ticks(self, most: int = 7) -> list[float]:
        """Round numbers on it: 1, 2, 5 and their tenfolds, or more or fewer."""
        first, last = math.floor(math.log10(self.low)), math.ceil(math.log10(self.high))
        for steps in ((1, 2, 3, 4, 6, 8), (1, 2, 5), (1, 3), (1,)):
            ticks = [
                step * 10.0**power
                for power in range(first, last + 1)
                for step in steps
                if self.low <= step * 10.0**power <= self.high
            ]
            if len(ticks) <= most:
                return ticks
        return ticks[:: -(-len(ticks) // most)]


def _percent(share: float) -> str:
    return f"{INSET + (100 - 2 * INSET) * share:.2f}%"


class Mark(NamedTuple):
    """A value with its interval in a lane, and the class that colours it."""

    interval: Interval
    kind: str


class Lane(NamedTuple):
    """One line of a chart of lanes: a name, its marks, and the figure beside it."""

    name: str
    marks: Sequence[Mark]
    figure: str


def lanes(
    groups: Sequence[tuple[str, Sequence[Lane]]], scale: Scale, unit: str, honest: bool = False
) -> Html:
    """Intervals under each other on one logarithmic axis, in groups with a heading.

    Args:
        groups: Heading and lanes.
        scale: The axis.
        unit: What stands under the axis.
        honest: Whether to mark 1, and what is within `LARGE_FACTOR` of it.
    """
    return tag(
        "div",
        [
            [tag("div", heading, class_="lane-head"), [_lane(each, scale, honest) for each in some]]
            for heading, some in groups
        ],
        _axis(scale, unit),
        class_="lanes",
    )


def _lane(lane: Lane, scale: Scale, honest: bool) -> Html:
    drawn = []
    if honest:
        left, right = scale.share(1 / LARGE_FACTOR), scale.share(LARGE_FACTOR)
        width = f"{(100 - 2 * INSET) * (right - left):.2f}%"
        drawn.append(tag("rect", x=_percent(left), y=0, width=width, height="100%", class_="zone"))
        one = _percent(scale.share(1.0))
        drawn.append(tag("line", x1=one, x2=one, y1=0, y2="100%", class_="one"))
    for tick in scale.ticks():
        x = _percent(scale.share(tick))
        drawn.append(tag("line", x1=x, x2=x, y1=0, y2="100%", class_="grid"))
    drawn.append(tag("line", x1=_percent(0), x2=_percent(1), y1="50%", y2="50%", class_="rail"))
    finite = [mark.interval.value for mark in lane.marks if math.isfinite(mark.interval.value)]
    if len(finite) > 1:
        ends = [_percent(scale.share(each)) for each in (min(finite), max(finite))]
        drawn.append(tag("line", x1=ends[0], x2=ends[1], y1="50%", y2="50%", class_="gap"))
    for mark in lane.marks:
        drawn += _mark(mark, scale)
    name = tag("span", lane.name, class_="lane-name")
    drawing = tag("svg", drawn, class_="lane-plot", aria_hidden="true", focusable="false")
    return tag("div", name, drawing, tag("span", lane.figure, class_="lane-figure"), class_="lane")


def _mark(mark: Mark, scale: Scale) -> list[Html]:
    value, low, high = mark.interval
    if math.isnan(value):
        return []
    if math.isinf(value):
        return [tag("text", "\u2192 \u221e", x=_percent(1), y="50%", class_="beyond")]
    drawn = []
    if math.isfinite(low) and math.isfinite(high):
        ends = _percent(scale.share(low)), _percent(scale.share(high))
        drawn.append(tag("line", x1=ends[0], x2=ends[1], y1="50%", y2="50%", class_=f"bar {mark.kind}"))
    drawn.append(tag("circle", cx=_percent(scale.share(value)), cy="50%", r=4.5, class_=f"dot {mark.kind}"))
    return drawn


def _axis(scale: Scale, unit: str) -> Html:
    drawn = []
    for tick in scale.ticks():
        x = _percent(scale.share(tick))
        drawn.append(tag("line", x1=x, x2=x, y1=0, y2=5, class_="tick"))
        drawn.append(tag("text", format_number(tick), x=x, y=17, class_="tick-label"))
    plot = tag("svg", drawn, class_="lane-plot axis", aria_hidden="true", focusable="false")
    return tag(
        "div", tag("span", class_="lane-name"), plot, tag("span", unit, class_="lane-unit"), class_="lane"
    )


def _x(share: float) -> float:
    return round(LEFT + PLOT * min(max(share, 0.0), 1.0), 2)


def _y(share: float) -> float:
    return round(TOP + PLOT * (1 - min(max(share, 0.0), 1.0)), 2)


def _panel(
    title: str, label: str, across: str, drawn: Sequence[Html], x_ticks: Sequence[tuple[float, str]],
    y_ticks: Sequence[tuple[float, str]],
) -> Html:  # fmt: skip
    """A square chart with its title above; ticks are (share, label)."""
    frame = [
        tag("rect", x=LEFT, y=TOP, width=PLOT, height=PLOT, class_="frame"),
        *(tag("text", name, x=_x(share), y=TOP + PLOT + 14, class_="tick-label") for share, name in x_ticks),
        *(tag("text", name, x=LEFT - 5, y=_y(share) + 4, class_="tick-label end") for share, name in y_ticks),
        tag("text", across, x=LEFT + PLOT / 2, y=SIDE - 7, class_="across"),
    ]
    svg = tag(
        "svg", frame[:1], drawn, frame[1:], viewBox=f"0 0 {SIDE} {SIDE}", class_="panel", role="img",
        aria_label=label,
    )  # fmt: skip
    return tag("figure", tag("figcaption", title), svg, class_="small")


def _path(points: Sequence[tuple[float, float]], kind: str) -> Html:
    ends = " ".join(f"{_x(x)},{_y(y)}" for x, y in points)
    return tag("polyline", points=ends, class_=kind)


def _shares() -> list[tuple[float, str]]:
    return [(0.0, "0"), (0.5, "50"), (1.0, "100")]


def coverage_panel(title: str, curves: Sequence[tuple[Curve, str]]) -> Html:
    """Share of truths inside the ellipses of each level; (curve, class) each, the first one's band drawn."""
    margin = curves[0][0].margin
    corners = [(0.0, margin), (1 - margin, 1.0), (1.0, 1.0), (1.0, 1 - margin), (margin, 0.0), (0.0, 0.0)]
    band = " ".join(f"{_x(x)},{_y(y)}" for x, y in corners)
    drawn = [tag("polygon", points=band, class_="zone"), _path([(0, 0), (1, 1)], "one")]
    for each, kind in curves:
        points = zip([0.0, *each.levels, 1.0], [0.0, *each.shares, 1.0], strict=True)
        drawn.append(_path(list(points), f"curve {kind}"))
    first = curves[0][0]
    middle = int(np.abs(first.levels - 0.5).argmin())
    share, level = 100 * first.shares[middle], 100 * first.levels[middle]
    label = f"{title}: {share:.0f} % of truths inside the {level:.0f} % ellipses"
    return _panel(title, label, "level, %", drawn, _shares(), _shares())


def histogram_panel(title: str, counts: Array, kind: str) -> Html:
    """A histogram that is flat for the honest, with the band that holds all its bars if so."""
    total, bins = float(counts.sum()), len(counts)
    if not total:
        return _panel(title, f"{title}: no runs", "", [], [], [])
    low, high = uniform_band(int(total), bins)
    top = max(float(counts.max()), high) * 1.08
    drawn = [
        tag(
            "rect", x=round(LEFT + PLOT * (i + 0.06) / bins, 2), y=_y(count / top),
            width=round(PLOT * 0.88 / bins, 2), height=round(_y(0) - _y(count / top), 2),
            class_=f"column {kind}" + ("" if low <= count <= high else " outside"),
        )
        for i, count in enumerate(counts)
    ]  # fmt: skip
    drawn.append(
        tag(
            "rect",
            x=LEFT,
            y=_y(high / top),
            width=PLOT,
            height=_y(low / top) - _y(high / top),
            class_="zone over",
        )
    )
    outside = int(((counts < low) | (counts > high)).sum())
    label = f"{title}: {outside} of {bins} bars outside the band"
    heights = [(0.0, "0"), (total / bins / top, f"{100 / bins:.0f} %")]
    return _panel(title, label, "quantile of the claim, %", drawn, _shares(), heights)


def reliability_panel(title: str, points: Sequence[Reliability], unit: str) -> Html:
    """Root mean squared error against claimed sigma, both logarithmic, with the diagonal of the honest."""
    values = [each for point in points for each in (point.claimed, point.true.value)]
    some = [value for value in values if 0 < value < math.inf]
    if not some:
        return _panel(title, f"{title}: no runs", "", [], [], [])
    scale = Scale.over(some, min(some) / 1.2, max(some) * 1.2)
    drawn = [_path([(0, 0), (1, 1)], "one")]
    for point in points:
        x, y = scale.share(point.claimed), scale.share(point.true.value)
        low, high = (scale.share(end) if end == end else y for end in (point.true.low, point.true.high))
        honest = not point.true.low > point.claimed and not point.true.high < point.claimed
        kind = "honest" if honest else "overconfident" if point.true.value > point.claimed else "cautious"
        drawn.append(tag("line", x1=_x(x), x2=_x(x), y1=_y(low), y2=_y(high), class_=f"whisker {kind}"))
        drawn.append(tag("circle", cx=_x(x), cy=_y(y), r=3.2, class_=f"dot {kind}"))
    ticks = [(scale.share(tick), f"{tick:g}") for tick in scale.ticks(4)]
    above = sum(point.true.low > point.claimed for point in points)
    label = f"{title}: in {above} of {len(points)} groups of runs the error is larger than claimed"
    return _panel(title, label, f"claimed, {unit}", drawn, ticks, ticks)


def steps_chart(values: Sequence[Interval], kinds: Sequence[str]) -> Html:
    """ANEES / n after each measurement, on a logarithmic axis."""
    ends = [min(end, CERTAIN) for interval in values for end in interval]
    scale = Scale.over(ends, 1 / LARGE_FACTOR / 1.2, LARGE_FACTOR * 1.2)

    def height(value: float) -> str:
        return f"{4 + 82 * (1 - scale.share(value)):.2f}%"

    drawn = []
    band = 82 * (scale.share(LARGE_FACTOR) - scale.share(1 / LARGE_FACTOR))
    drawn.append(
        tag("rect", x="8%", y=height(LARGE_FACTOR), width="90%", height=f"{band:.2f}%", class_="zone")
    )
    drawn.append(tag("line", x1="8%", x2="98%", y1=height(1.0), y2=height(1.0), class_="one"))
    for tick in scale.ticks(5):
        drawn.append(tag("text", format_number(tick), x="7%", y=height(tick), class_="tick-label end middle"))
    for step, (interval, kind) in enumerate(zip(values, kinds, strict=True)):
        x = f"{10 + 86 * (step / max(len(values) - 1, 1)):.2f}%"
        if math.isfinite(interval.low) and math.isfinite(interval.high):
            ends_y = height(interval.low), height(interval.high)
            drawn.append(tag("line", x1=x, x2=x, y1=ends_y[0], y2=ends_y[1], class_=f"whisker {kind}"))
        if math.isfinite(interval.value):
            drawn.append(tag("circle", cx=x, cy=height(interval.value), r=3.2, class_=f"dot {kind}"))
        if step in (0, len(values) - 1) or (len(values) <= 12):
            drawn.append(tag("text", step + 1, x=x, y="98%", class_="tick-label"))
    return tag("svg", drawn, class_="steps", role="img", aria_label="ANEES / n after each measurement")
