"""Ticks whose labels do not run into each other, whatever the length of the axis."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np
from matplotlib.axis import Axis
from matplotlib.ticker import (
    FixedLocator,
    FuncFormatter,
    Locator,
    LogLocator,
    MaxNLocator,
    NullFormatter,
    SymmetricalLogLocator,
)

from ...arrays import Array
from .layout import dpi_of, line_height, text_width

GAP = 0.06  # between labels side by side, inches


class FittingLocator(Locator):
    """The first of several locators, from many ticks to few, whose labels have room and are two or more.

    Where none has two that have room, the last whose labels have room; or else the last.
    """

    def __init__(self, choices: Sequence[Locator]) -> None:
        self.choices = choices
        self._found: tuple[object, Array] = (None, np.array([]))

    def set_axis(self, axis: Axis) -> None:  # type: ignore[override]
        super().set_axis(axis)
        for choice in self.choices:
            choice.set_axis(axis)

    def __call__(self) -> Array:  # type: ignore[override]
        axis = self._real_axis
        asked = (*axis.get_view_interval(), *axis.axes.bbox.size, dpi_of(axis.axes))
        if self._found[0] != asked:
            self._found = asked, self._choose()
        return self._found[1]

    @property
    def _real_axis(self) -> Axis:
        return cast(Axis, self.axis)

    def _choose(self) -> Array:
        fitting = self.choices[-1]
        for choice in self.choices:
            shown = self._shown(choice)
            if self._have_room(shown):
                fitting = choice
                if len(shown) > 1:
                    break
        return np.asarray(fitting(), dtype=float)

    def tick_values(self, vmin: float, vmax: float) -> Array:  # type: ignore[override]
        return np.asarray(self.choices[0].tick_values(vmin, vmax), dtype=float)

    def nonsingular(self, v0: float, v1: float) -> tuple[float, float]:
        return self.choices[0].nonsingular(v0, v1)

    def view_limits(self, vmin: float, vmax: float) -> tuple[float, float]:
        return self.choices[0].view_limits(vmin, vmax)

    def _shown(self, choice: Locator) -> Array:
        """The ticks of a locator that lie within the view."""
        low, high = sorted(self._real_axis.get_view_interval())
        ticks = np.asarray(choice(), dtype=float)
        return np.sort(ticks[(ticks >= low) & (ticks <= high)])

    def _have_room(self, ticks: Array) -> bool:
        """Whether the labels of these ticks stand clear of each other."""
        axis = self._real_axis
        across = axis is axis.axes.xaxis
        setting = f"{'x' if across else 'y'}tick.labelsize"
        labels = axis.get_major_formatter().format_ticks(list(ticks))
        places = axis.get_transform().transform(ticks)
        low, high = axis.get_transform().transform(np.asarray(axis.get_view_interval(), dtype=float))
        size = axis.axes.bbox.width if across else axis.axes.bbox.height
        inches = (places - low) / (high - low) * size / dpi_of(axis.axes)
        if across:
            widths = np.array([text_width(label, setting) for label in labels])
            needed = (widths[1:] + widths[:-1]) / 2 + GAP
        else:
            needed = np.full(max(len(ticks) - 1, 0), 0.9 * line_height(setting))
        return bool((np.abs(np.diff(inches)) >= needed).all())


def plain_numbers(axis: Axis, subdivisions: Sequence[float] = (1.0,)) -> None:
    """Ticks of a logarithmic axis as 0.01, 0.1, 1, 10 and multiples of those where there is room for them.

    Args:
        axis: The axis.
        subdivisions: Multiples that are tried first.
    """
    tried = (tuple(subdivisions), (1.0, 2.0, 5.0), (1.0, 3.0), (1.0,)) if len(subdivisions) > 1 else (
        (1.0,), (1.0, 3.0), (1.0, 2.0, 5.0)
    )  # fmt: skip
    logarithmic = [LogLocator(subs=subs) for subs in tried]
    sparse = [LogLocator(subs=(1.0,), numticks=count) for count in (4, 3)]
    few = [MaxNLocator(count, steps=[1, 2, 5, 10]) for count in (4, 3, 2, 1)]
    axis.set_major_locator(FittingLocator([*logarithmic, *sparse, *few]))
    axis.set_major_formatter(FuncFormatter(lambda value, _: _plain(value)))
    axis.set_minor_formatter(NullFormatter())


def _plain(value: float) -> str:
    """Without an exponent from 1e-6 to 1e7, so that decades beside each other look alike."""
    return f"{value:.10f}".rstrip("0").rstrip(".") if 1e-6 <= abs(value) < 1e8 else f"{value:g}"


def even_numbers(axis: Axis, most: int = 5, whole: bool = False) -> None:
    """At most so many ticks, and one more, on a linear axis; fewer where they have no room.

    Args:
        axis: The axis.
        most: How many.
        whole: Whether only at whole numbers, as of what is counted.
    """
    choices = [
        MaxNLocator(count, integer=whole, min_n_ticks=1 if whole else 2) for count in range(most, 0, -1)
    ]
    axis.set_major_locator(FittingLocator(choices))


class _SignedDecades(SymmetricalLogLocator):
    """Powers of ten on both sides; even steps where the view does not go beyond the part that is linear."""

    def __init__(self, linear: float) -> None:
        super().__init__(base=10, linthresh=linear)
        self.linear = linear

    def tick_values(self, vmin: float, vmax: float) -> Array:  # type: ignore[override]
        if max(abs(vmin), abs(vmax)) <= self.linear:
            return np.asarray(MaxNLocator(4).tick_values(vmin, vmax), dtype=float)
        return np.asarray(super().tick_values(vmin, vmax), dtype=float)


class _LargestDecades(SymmetricalLogLocator):
    """The largest power of ten on each side, and 0."""

    def tick_values(self, vmin: float, vmax: float) -> Array:  # type: ignore[override]
        low, high = sorted((vmin, vmax))
        ends = [sign * 10.0 ** np.floor(np.log10(end)) for sign, end in ((-1, -low), (1, high)) if end > 0]
        return np.array(sorted([*ends, 0.0]))


def signed_decades(axis: Axis, linear: float) -> None:
    """Ticks at 0 and at powers of ten on both sides of a linear part; fewer where they have no room."""
    choices = [_SignedDecades(linear) for _ in range(5)]
    for choice, count in zip(choices[1:], (7, 5, 4, 3), strict=True):
        choice.set_params(numticks=count)
    few = [_LargestDecades(base=10, linthresh=linear), FixedLocator([0])]
    axis.set_major_locator(FittingLocator([*choices, *few]))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
