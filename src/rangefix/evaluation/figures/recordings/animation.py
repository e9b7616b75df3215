"""A replay as a moving picture: the map, the scan as the estimate sees it, and what is claimed."""

from __future__ import annotations

from pathlib import Path
from shutil import which
from typing import Any

import numpy as np
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ....filters import Problem
from ...recordings.log import RecordingError
from ...recordings.trace import Trace
from ..sheet import legend_below
from ..style import COLOURS
from .paths import TITLE_MARGIN, belief_legend, draw_estimate, draw_map, size_of, view

MOST_FRAMES = 200
FRAMES_PER_S = 10
DPI = 80
SCAN_MARGIN_M = 4.0  # about the path, where scans are seen
READING: dict[str, Any] = {"marker": ".", "markersize": 4.0, "color": COLOURS[1], "linestyle": "none"}


def animate(name: str, trace: Trace, problem: Problem, path: Path) -> None:
    """Write an animation; a legend below says what each mark and line is.

    Args:
        name: Of the estimator.
        trace: Its replay.
        problem: What it was told: the map and the beams.
        path: A .gif; or a .mp4, where ffmpeg is found.

    Raises:
        RecordingError: If the suffix is another, or there is no ffmpeg for an .mp4.
    """
    writer = _writer(path)
    room, sensor = problem.sensor.room, problem.sensor
    lower, upper = view(room, np.concatenate([trace.means[:, :2], trace.truths[:, :2]]), SCAN_MARGIN_M)
    width, height = (0.8 * side for side in size_of(lower, upper))
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    chosen = np.unique(np.linspace(0, len(trace.kept) - 1, MOST_FRAMES).round().astype(int))
    entries = belief_legend(trace.kept) | {
        "estimated path": Line2D([], [], color=COLOURS[0], linewidth=1.0),
        "readings of the scan, as seen from the estimate": Line2D([], [], **READING),
    }
    figure.set_figheight(height + legend_below(figure, entries, width - 2 * TITLE_MARGIN, 2))
    with writer.saving(figure, str(path), DPI):
        for number in chosen:
            believed = trace.kept[number]
            axes.clear()
            draw_map(axes, room, lower, upper)
            axes.plot(*trace.means[: number + 1, :2].T, color=COLOURS[0], linewidth=1.0)
            laser = sensor.mount.laser_poses(problem.space.poses(believed.mean))
            seen = np.isfinite(believed.step.measurement)
            angles = laser[2] + sensor.bearings[seen]
            ranges = believed.step.measurement[seen]
            axes.plot(laser[0] + ranges * np.sin(angles), laser[1] + ranges * np.cos(angles), **READING)
            draw_estimate(axes, believed)
            axes.set_title(f"{name}, scan {believed.step.scan}{', lost' * believed.is_lost}")
            if number == chosen[0]:
                figure.draw_without_rendering()
                figure.set_layout_engine("none")  # the panel stays where it is in all frames
            writer.grab_frame()


def _writer(path: Path) -> AbstractMovieWriter:
    if path.suffix == ".gif":
        return PillowWriter(fps=FRAMES_PER_S)
    if path.suffix != ".mp4":
        raise RecordingError(f"{path}: animations are .gif, or .mp4 where ffmpeg is found")
    if which("ffmpeg") is None:
        raise RecordingError(f"{path}: no ffmpeg is found, which an .mp4 needs: write a .gif")
    return FFMpegWriter(fps=FRAMES_PER_S)
