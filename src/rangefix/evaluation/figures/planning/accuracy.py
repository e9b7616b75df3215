"""A map of accuracy: expected deviations, ellipses that show the worst direction, and mistaken places."""

from __future__ import annotations

import numpy as np
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure

from ....arrays import Array
from ...planning.accuracy_map import AccuracyMap
from ..maps import SOLID
from ..style import INK, label_positions

HEIGHT = 6.5  # inches
ELLIPSES = 1.0  # m from one to the next
LARGE = 0.45  # of that: half the length of the ellipse of a place as uncertain as most get
ALIKE = 1.01  # the largest deviation over the least, where all count as one


def draw_accuracy(found: AccuracyMap, segments: Array) -> Figure:
    """The deviation of the position in colour, on a log scale, with the walls; beside it mistaken places.

    Args:
        found: What was worked out.
        segments: Walls as x1a, x2a, x1b, x2b, m, (S, 4).
    """
    std = found.position_std
    step = float(np.diff(found.x1[:2])[0]) if len(found.x1) > 1 else 1.0
    extent = (
        found.x1[0] - step / 2,
        found.x1[-1] + step / 2,
        found.x2[0] - step / 2,
        found.x2[-1] + step / 2,
    )
    shape = float(np.clip((extent[1] - extent[0]) / (extent[3] - extent[2]), 0.3, 2.5))
    judged = bool(np.isfinite(found.mistaken).any())
    figure = Figure(figsize=((HEIGHT * shape + 2.4) * (1 + judged), HEIGHT + 0.9), layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, 1 + judged))
    axes = panels[0]
    known = std[np.isfinite(std)]
    low, high = (float(np.quantile(known, share)) for share in (0.005, 0.995)) if len(known) else (0.1, 1.0)
    norm, ticks = _scale(low, high)
    image = axes.imshow(std, origin="lower", extent=extent, cmap=INK, norm=norm, interpolation="nearest")
    bar = figure.colorbar(image, ax=axes, label="expected deviation of the position, m", shrink=0.8)
    bar.minorticks_off()
    bar.set_ticks(list(ticks), labels=[f"{tick:.3g}" for tick in ticks])
    every = max(1, round(ELLIPSES / step))
    rows, columns = np.meshgrid(
        np.arange(every // 2, len(found.x2), every),
        np.arange(every // 2, len(found.x1), every),
        indexing="ij",
    )
    rows, columns = (index[np.isfinite(std[rows, columns])] for index in (rows, columns))
    scale = 0.0
    if len(rows):
        values, vectors = np.linalg.eigh(found.covariance[rows, columns])
        sizes = np.sqrt(np.maximum(values, 0.0))
        scale = LARGE * ELLIPSES / float(np.quantile(sizes[:, 1], 0.9))
        sizes = np.minimum(sizes * scale, LARGE * ELLIPSES)
        angles = np.rad2deg(np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1]))
        places = np.stack([found.x1[columns], found.x2[rows]], axis=1)
        axes.add_collection(
            EllipseCollection(
                2 * sizes[:, 1], 2 * sizes[:, 0], angles, units="xy", offsets=places,
                offset_transform=axes.transData, facecolors="none", edgecolors="#D55E00", linewidths=0.7,
            )
        )  # fmt: skip
    axes.set_title(
        f"information from gradients of {len(found.bearings)} beams, no bound near jumps\n"
        f"ellipses: standard deviations x {scale:.3g}, cut at {2 * LARGE * ELLIPSES:g} m"
    )
    if judged:
        share = panels[1].imshow(
            100 * found.mistaken, origin="lower", extent=extent, cmap=INK, vmin=0, vmax=50,
            interpolation="nearest",
        )  # fmt: skip
        figure.colorbar(share, ax=panels[1], label="scans that fit a place elsewhere better, %", shrink=0.8)
        panels[1].set_title("mistaken for the most similar place elsewhere:\nan estimate; 50 % is a toss-up")
    for panel in panels:
        panel.set_facecolor(SOLID)
        if len(segments):
            walls = list(segments.reshape(-1, 2, 2))
            panel.add_collection(LineCollection(walls, colors="black", linewidths=0.8))
        label_positions(panel)
        panel.set_xlim(extent[:2])
        panel.set_ylim(extent[2:])
    return figure


def _scale(low: float, high: float) -> tuple[Normalize, Array]:
    """The colours of deviations and ticks beside them, m: where all are alike from 0 on, with that one."""
    if high < ALIKE * low:
        middle = (low + high) / 2
        return Normalize(0.0, 2 * middle), np.array([0.0, middle])
    return LogNorm(low, high), np.geomspace(low, high, 5)
