"""What a replay leaves in a folder beside poses: figures, animations, and its table for programs."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...evaluation.figures.data import drawable_labels
from ...evaluation.figures.files import write_figure
from ...evaluation.figures.recordings.errors import draw_errors, draw_fit
from ...evaluation.figures.recordings.paths import draw_beliefs, draw_paths
from ...evaluation.figures.style import styled
from ...evaluation.recordings.replays import Contestant
from ...evaluation.recordings.trace import Trace
from ...filters import Problem
from ..app import doing, plain_json
from .replay_folder import TABLE


def finish(
    folder: Path,
    traces: dict[str, Trace],
    contestants: list[Contestant],
    problem: Problem,
    animation: str | None,
    told: dict[str, Any],
) -> None:
    """Figures, animations and the table, which names all files, beside the poses."""
    if traces:
        doing("drawing")
        room = problem.sensor.room
        labels = drawable_labels(contestant.label for contestant in contestants)
        drawn = {labels[label]: trace for label, trace in traces.items()}
        figures = {"paths": partial(draw_paths, drawn, room), "fit": partial(draw_fit, drawn)}
        for contestant in contestants:
            trace = traces.get(contestant.label)
            if trace is None:
                continue
            name, label = contestant.file_name, labels[contestant.label]
            if np.isfinite(trace.truths).any():
                figures[f"{name}_errors"] = partial(draw_errors, label, trace)
            if trace.images:
                figures[f"{name}_beliefs"] = partial(draw_beliefs, label, trace, room)
        for name, draw in figures.items():
            write_figure(draw, folder / f"{name}.png", folder / f"{name}.svg")
        if animation is not None:
            from ...evaluation.figures.recordings.animation import animate

            for contestant in contestants:
                if contestant.label in traces:
                    doing(f"animating {contestant.label}")
                    path = folder / f"{contestant.file_name}.{animation}"
                    with styled():
                        animate(labels[contestant.label], traces[contestant.label], problem, path)
    told = told | {"files": sorted(path.name for path in folder.iterdir())}
    (folder / TABLE).write_text(json.dumps(plain_json(told), indent=2) + "\n", encoding="utf-8")
