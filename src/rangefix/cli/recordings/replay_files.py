"""What a replay leaves in a folder beside poses: figures, animations, and its table for programs."""

from __future__ import annotations

import json
import math
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...evaluation.figures.files import write_figure
from ...evaluation.figures.recordings.errors import draw_errors, draw_fit
from ...evaluation.figures.recordings.paths import draw_beliefs, draw_paths
from ...evaluation.figures.style import styled
from ...evaluation.recordings.replays import Contestant
from ...evaluation.recordings.trace import Trace
from ...filters import Problem
from ..app import doing


def finish(
    folder: Path,
    traces: dict[str, Trace],
    contestants: list[Contestant],
    problem: Problem,
    animation: str | None,
    told: dict[str, Any],
) -> None:
    """Figures, animations and the table, beside the poses."""
    if traces:
        doing("drawing")
        room = problem.sensor.room
        figures = {"paths": partial(draw_paths, traces, room), "fit": partial(draw_fit, traces)}
        for contestant in contestants:
            trace = traces.get(contestant.label)
            if trace is None:
                continue
            name = contestant.file_name
            if np.isfinite(trace.truths).any():
                figures[f"{name}_errors"] = partial(draw_errors, contestant.label, trace)
            if trace.images:
                figures[f"{name}_beliefs"] = partial(draw_beliefs, contestant.label, trace, room)
        for name, draw in figures.items():
            write_figure(draw, folder / f"{name}.png", folder / f"{name}.svg")
        if animation is not None:
            from ...evaluation.figures.recordings.animation import animate

            for contestant in contestants:
                if contestant.label in traces:
                    doing(f"animating {contestant.label}")
                    path = folder / f"{contestant.file_name}.{animation}"
                    with styled():
                        animate(contestant.label, traces[contestant.label], problem, path)
    (folder / "replay.json").write_text(json.dumps(_plain(told), indent=2) + "\n", encoding="utf-8")


def _plain(value: Any) -> Any:
    """What JSON can hold: numbers that are not finite become null."""
    if isinstance(value, dict):
        return {name: _plain(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
