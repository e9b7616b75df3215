"""Posterior densities of the paper's Figs. 2 and 3, as maps of the room and as surfaces over it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, PowerNorm
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from ..paper import Array, Paper, Row
from ..scene import Scene
from .style import label_positions

# White where nothing is likely, darker and darker towards the peak: in grey too.
INK = LinearSegmentedColormap.from_list("ink", ["#ffffff", "#b5d4ea", "#4f94c4", "#1b4f8a", "#08183a"])
COARSE = 10  # cells between the lines of a surface where it is flat
AZIMUTH = -58.0  # deg, from where the surfaces are seen
CLOSE_UP = 0.3  # m


def beam_title(beams: str) -> str:
    """A beam set as a title: "1+2" -> "Beams 1 + 2"."""
    return f"Beam{'s' if '+' in beams else ''} {beams.replace('+', ' + ')}"


def draw_walls(axes: Axes, scene: Scene, width: float = 1.6) -> None:
    """The walls at sensor height, black."""
    for x1a, x2a, x1b, x2b in scene["segments"]:
        axes.plot([x1a, x1b], [x2a, x2b], color="black", linewidth=width, solid_capstyle="projecting")


def draw_beams(axes: Axes, scene: Scene, numbers: Sequence[int], named: bool = True) -> None:
    """Beams (from 1) from the true position to the walls that they meet, dashed, with their numbers."""
    x1, x2, heading = scene["truth"]
    for number in numbers:
        angle, reach = heading + scene["bearings"][number - 1], scene["ranges"][number - 1]
        if not np.isfinite(reach):
            continue
        step = np.array([np.sin(angle), np.cos(angle)])
        end = np.array([x1, x2]) + reach * step
        axes.plot([x1, end[0]], [x2, end[1]], color="#B03A00", linewidth=1.1, linestyle=(0, (5, 2)))
        if named:
            where = np.array([x1, x2]) + 0.62 * reach * step
            axes.text(
                where[0],
                where[1],
                str(number),
                color="#B03A00",
                fontsize=8,
                ha="center",
                va="center",
                bbox={"boxstyle": "circle,pad=0.15", "facecolor": "white", "edgecolor": "none"},
            )


def draw_truth(axes: Axes, scene: Scene, size: float = 11.0, label: str = "true position") -> None:
    """The true position: a white star with a black edge."""
    axes.plot(
        *scene["truth"][:2],
        "*",
        markersize=size,
        markerfacecolor="white",
        markeredgecolor="black",
        linestyle="none",
        markeredgewidth=1.0,
        zorder=7,
        label=label,
    )


def ellipse(mean: Sequence[float], covariance: Array, deviations: float, **style: Any) -> Ellipse:
    """The curve (x - mean)' P^-1 (x - mean) = deviations^2 in the plane."""
    values, vectors = np.linalg.eigh(covariance)
    width, height = 2 * deviations * np.sqrt(np.maximum(values, 0.0))
    angle = float(np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0])))
    return Ellipse((float(mean[0]), float(mean[1])), width, height, angle=angle, **style)


def _numbers(beams: str) -> list[int]:
    return [int(number) for number in beams.split("+")]


def _density_image(axes: Axes, paper: Paper, row: Row, star: float = 11.0) -> Any:
    density = paper.densities[row.beams]
    image = axes.imshow(
        density / density.max(),
        origin="lower",
        extent=tuple(paper.scene["extent"]),
        cmap=INK,
        norm=PowerNorm(0.5, 0.0, 1.0),
        interpolation="nearest",
    )
    draw_truth(axes, paper.scene, size=star)
    bars = axes.errorbar(
        row.mean[0],
        row.mean[1],
        xerr=row.std[0],
        yerr=row.std[1],
        fmt="o",
        markersize=4.5,
        color="black",
        markerfacecolor="white",
        elinewidth=1.0,
        capsize=2.5,
        zorder=6,
        label=r"posterior mean $\pm$ 1 standard deviation",
    )
    for artist in bars.get_children()[1:]:
        artist.set_path_effects([withStroke(linewidth=2.6, foreground="white")])
    return image


def _map_panel(axes: Axes, paper: Paper, row: Row) -> Any:
    left, right, lower, upper = paper.scene["extent"]
    image = _density_image(axes, paper, row)
    draw_walls(axes, paper.scene)
    draw_beams(axes, paper.scene, _numbers(row.beams))
    axes.set_xlim(left - 0.12, right + 0.12)
    axes.set_ylim(lower - 0.12, upper + 0.12)
    label_positions(axes)
    axes.set_xticks(range(int(right) + 1))
    axes.set_yticks(range(int(upper) + 1))
    axes.spines[:].set_visible(False)
    stds = rf"$\sigma_1$ = {row.std[0]:.3f} m, $\sigma_2$ = {row.std[1]:.3f} m"
    axes.set_title(f"{beam_title(row.beams)}\n{stds}")
    return image


def _close_up(axes: Axes, paper: Paper, row: Row) -> None:
    """The surroundings of the true position once more, in the empty lower part of the room."""
    x1, x2 = paper.scene["truth"][:2]
    inset = axes.inset_axes((x1 - 1.15, 0.35, 2.3, 2.0), transform=axes.transData)
    _density_image(inset, paper, row, star=9.0)
    inset.set_xlim(x1 - 0.23, x1 + 0.23)
    inset.set_ylim(x2 - 0.2, x2 + 0.2)
    inset.tick_params(labelsize=7)
    inset.spines[:].set_visible(True)
    axes.indicate_inset_zoom(inset, edgecolor="0.3", alpha=1.0)


def posterior_maps(paper: Paper, beam_sets: Sequence[str], title: str) -> Figure:
    """Posterior densities in the room, one panel for each beam set, darkest at the peak of each."""
    columns = min(len(beam_sets), 3)
    rows = -(-len(beam_sets) // columns)
    size = (2.7 * columns + 0.9, 4.15 * rows + 0.8) if rows > 1 else (5.4, 6.4)
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False)
    for axes, beams in zip(panels.flat, beam_sets, strict=True):
        image = _map_panel(axes, paper, paper.row(beams))
    if len(beam_sets) == 1:
        _close_up(panels[0, 0], paper, paper.row(beam_sets[0]))
    bar = figure.colorbar(image, ax=panels, shrink=0.7, aspect=35, pad=0.02)
    bar.set_label("posterior density / its peak")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2)
    figure.suptitle(title, fontsize=10.5)
    return figure


def _lines(density: Array, axis: int) -> NDArray[np.int64]:
    """Which rows (axis 0) or columns (1) carry the surface: all where it changes, else every COARSE-th."""
    change = np.abs(np.diff(density, axis=axis)).max(axis=1 - axis) > 0.004 * density.max()
    wanted = np.arange(density.shape[axis]) % COARSE == 0
    wanted[-1] = True
    wanted[:-1] |= change
    wanted[1:] |= change
    return np.flatnonzero(wanted)


def _closed(centres: Array) -> Array:
    """The cell centres with the outer edges of the first and last cell, where the surface goes down to 0."""
    half = (centres[1] - centres[0]) / 2
    return np.concatenate([[centres[0] - half], centres, [centres[-1] + half]])


def _surface(axes: Any, paper: Paper, beams: str, half_width: float = np.inf) -> None:
    """The density over the room, or over the square of that half width about the true position."""
    density, scene = paper.densities[beams], paper.scene
    truth = scene["truth"][:2]
    near = [np.abs(centres - value) <= half_width for centres, value in zip(paper.axes, truth, strict=True)]
    x1, x2 = (centres[part] for centres, part in zip(paper.axes, near, strict=True))
    density = density[np.ix_(near[1], near[0])]
    peak = float(density.max())
    foot = density[np.abs(x2 - truth[1]).argmin(), np.abs(x1 - truth[0]).argmin()]
    x1, x2, density = _closed(x1), _closed(x2), np.pad(density, 1)
    rows, columns = _lines(density, 0), _lines(density, 1)
    axes.plot_surface(
        *np.meshgrid(x1[columns], x2[rows]),
        density[np.ix_(rows, columns)],
        cmap=INK,
        norm=PowerNorm(0.6, -0.06 * peak, peak),
        rcount=len(rows),
        ccount=len(columns),
        linewidth=0,
        antialiased=False,
        rasterized=True,
        shade=False,
        zorder=2,
    )
    towards = np.array([np.cos(np.radians(AZIMUTH)), np.sin(np.radians(AZIMUTH))])
    for x1a, x2a, x1b, x2b in scene["segments"] if np.isinf(half_width) else ():
        front = towards @ (np.array([x1a + x1b, x2a + x2b]) / 2 - truth) > 0
        axes.plot([x1a, x1b], [x2a, x2b], [0, 0], color="black", linewidth=1.4, zorder=3 if front else 1)
    top = 1.15 * peak
    axes.plot(
        [truth[0]] * 2, [truth[1]] * 2, [foot, top], color="black", linewidth=0.9, linestyle=":", zorder=4
    )
    axes.plot(
        *truth,
        top,
        "*",
        markersize=10,
        markerfacecolor="white",
        markeredgecolor="black",
        zorder=5,
        linestyle="none",
        label="true position",
    )
    width, length = np.ptp(x1), np.ptp(x2)
    axes.set_xlim(x1[0], x1[-1])
    axes.set_ylim(x2[0], x2[-1])
    axes.set_zlim(0, top)
    axes.set_box_aspect((width, length, 0.55 * max(width, length)), zoom=1.04)
    axes.view_init(elev=30, azim=AZIMUTH)
    axes.set_xlabel("$x_1$, m", labelpad=-3)
    axes.set_ylabel("$x_2$, m", labelpad=-2)
    axes.set_zlabel(r"density, 1/m$^2$", labelpad=-2)
    axes.xaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
    axes.yaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
    axes.zaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    axes.tick_params(pad=-2, labelsize=7)


def posterior_surfaces(paper: Paper, beam_sets: Sequence[str], title: str) -> Figure:
    """Posterior densities as surfaces over the room; a single one with a close-up beside it."""
    panels: list[tuple[str, float, str]] = [(beams, np.inf, beam_title(beams)) for beams in beam_sets]
    if len(panels) == 1:
        panels.append((beam_sets[0], CLOSE_UP, f"The same, within {CLOSE_UP:g} m of the true position"))
    columns = min(len(panels), 3)
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(3.5 * columns, 3.1 * rows + 0.4) if rows > 1 else (8.6, 4.2))
    for i, (beams, half_width, name) in enumerate(panels):
        axes: Any = figure.add_subplot(rows, columns, i + 1, projection="3d", computed_zorder=False)
        _surface(axes, paper, beams, half_width)
        axes.set_title(name, y=0.96, loc="center")
    figure.subplots_adjust(left=0.01, right=0.91, bottom=0.09, top=0.94, wspace=0.2, hspace=0.14)
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="lower center")
    figure.suptitle(title, fontsize=10.5)
    return figure
