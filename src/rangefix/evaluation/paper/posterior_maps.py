"""Posterior densities of the paper's Figs. 2 and 3 as maps of the room."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patheffects import withStroke

from ..consistency.formatting import beams_in_words
from ..figures import Layout
from ..figures.room import draw_beams, draw_density, draw_truth, draw_walls
from ..figures.sheet import Sheet
from ..figures.style import label_positions
from .table1 import Paper, Table1Row

TALLEST = 6.0  # inches, of a room in a figure of a given width
BARS: dict[str, Any] = {  # of the posterior mean
    "fmt": "o", "markersize": 4.5, "color": "black", "markerfacecolor": "white", "elinewidth": 1.0,
    "capsize": 2.5,
}  # fmt: skip


def _density_image(axes: Axes, paper: Paper, row: Table1Row, star: float = 11.0) -> AxesImage:
    image = draw_density(axes, paper.densities[row.beams], paper.scene["extent"])
    draw_truth(axes, paper.scene, size=star)
    label = "posterior mean \u00b1 1 standard deviation"
    (x1, x2), (std1, std2) = row.mean, row.std
    bars = axes.errorbar(x1, x2, std2, std1, zorder=6, label=label, **BARS)
    for artist in bars.get_children()[1:]:
        artist.set_path_effects([withStroke(linewidth=2.6, foreground="white")])
    return image


def _map_panel(axes: Axes, paper: Paper, row: Table1Row, sheet: Sheet) -> AxesImage:
    left, right, lower, upper = paper.scene["extent"]
    image = _density_image(axes, paper, row)
    axes.set_xlim(left - 0.12, right + 0.12)
    axes.set_ylim(lower - 0.12, upper + 0.12)
    draw_walls(axes, paper.scene)
    draw_beams(axes, paper.scene, map(int, row.beams.split("+")))
    label_positions(axes)
    axes.set_xticks(range(int(right) + 1))
    axes.set_yticks(range(int(upper) + 1))
    axes.spines[:].set_visible(False)
    stds = f"\u03c3\u2081 = {row.std[0]:.3f} m, \u03c3\u2082 = {row.std[1]:.3f} m".replace(
        " = ", "\u00a0=\u00a0"
    )
    text = f"{beams_in_words(row.beams).capitalize()}\n{stds}".replace(" m", "\u00a0m")
    axes.set_title(sheet.broken(text, "axes.titlesize"))
    return image


def _close_up(axes: Axes, paper: Paper, row: Table1Row) -> None:
    """The surroundings of the true position once more, in the empty lower part of the room."""
    x1, x2 = paper.scene["truth"][:2]
    inset = axes.inset_axes((x1 - 1.15, 0.35, 2.3, 2.0), transform=axes.transData)
    _density_image(inset, paper, row, star=9.0)
    inset.set_xlim(x1 - 0.23, x1 + 0.23)
    inset.set_ylim(x2 - 0.2, x2 + 0.2)
    inset.spines[:].set_visible(True)
    axes.indicate_inset_zoom(inset, edgecolor="0.3", alpha=1.0)


def posterior_maps(paper: Paper, beam_sets: Sequence[str], title: str, layout: Layout) -> Figure:
    """Posterior densities in the room, one panel for each beam set, darkest at the peak of each."""
    sheet = Sheet(layout)
    columns = layout.columns(len(beam_sets), 3, 1.2, beside=1.0)
    lines = -(-len(beam_sets) // columns)
    left, right, lower, upper = paper.scene["extent"]
    ratio = (upper - lower) / (right - left)
    panels = sheet.panels(
        len(beam_sets),
        columns=columns,
        natural=(2.7 * columns + 0.9, 4.15 * lines + 0.8) if lines > 1 else (5.4, 6.4),
        beside=1.0,
        height=lambda width: min(ratio * width, TALLEST) + 0.9 * layout.scale,
    )[:, 0]
    for axes, beams in zip(panels, beam_sets, strict=True):
        image = _map_panel(axes, paper, paper.row(beams), sheet)
    if len(beam_sets) == 1:
        _close_up(panels[0], paper, paper.row(beam_sets[0]))
    bar = sheet.root.colorbar(image, ax=list(panels), shrink=0.7, aspect=35, pad=0.02)
    bar.set_label("posterior density / its peak")
    sheet.finish(title, panels[:1], columns=2)
    return sheet.root
