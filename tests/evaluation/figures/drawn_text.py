"""What letters a figure really has: every line of text that reaches the renderer, with its place and size."""

from __future__ import annotations

from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from matplotlib.backend_bases import RendererBase
from matplotlib.figure import Figure
from matplotlib.transforms import Affine2D, Bbox

from rangefix.evaluation.figures.files import lay_out

SLACK = 0.3  # points by which boxes may touch
SHRUNK = 0.7  # by which formulas make subscripts smaller


class DrawnLine(NamedTuple):
    """A line of text as it was drawn: what, at how many points, and its box in points."""

    text: str
    points: float
    box: Bbox


class _Recorder(RendererBase):
    """Draws nothing, and notes each line of text; a pixel is a point."""

    def __init__(self, size: tuple[float, float]) -> None:
        super().__init__()
        self.size = size
        self.lines: list[DrawnLine] = []

    def get_canvas_width_height(self) -> tuple[float, float]:
        return self.size

    def flipy(self) -> bool:
        return False

    def draw_path(self, *_: Any, **__: Any) -> None: ...

    def draw_markers(self, *_: Any, **__: Any) -> None: ...

    def draw_path_collection(self, *_: Any, **__: Any) -> None: ...

    def draw_image(self, *_: Any, **__: Any) -> None: ...

    def draw_text(
        self,
        gc: Any,
        x: float,
        y: float,
        s: str,
        prop: Any,
        angle: float,
        ismath: Any = False,
        mtext: Any = None,
    ) -> None:
        if not s.strip():
            return
        width, height, descent = self.get_text_width_height_descent(s, prop, ismath)
        turned = Affine2D().rotate_deg(angle).translate(x, y)
        box = Bbox([[0, -descent], [width, height - descent]]).transformed(turned)
        points = prop.get_size_in_points() * (SHRUNK if ismath and ("_" in s or "^" in s) else 1.0)
        self.lines.append(DrawnLine(s, points, Bbox([box.min, box.max])))


def drawn_lines(figure: Figure) -> list[DrawnLine]:
    """All lines of text of a figure, laid out as for its files."""
    lay_out(figure)
    figure.set_dpi(72)
    width, height = (72 * float(side) for side in figure.get_size_inches())
    recorder = _Recorder((width, height))
    figure.draw(recorder)
    return recorder.lines


def overlaps(lines: list[DrawnLine]) -> list[tuple[str, str]]:
    """Pairs of lines whose boxes overlap by more than the slack in both directions."""
    return [
        (one.text, other.text)
        for one, other in combinations(lines, 2)
        if (np.minimum(one.box.max, other.box.max) - np.maximum(one.box.min, other.box.min) > SLACK).all()
    ]


def cut_off(lines: list[DrawnLine], figure: Figure) -> list[str]:
    """Lines that reach beyond the edges of the figure."""
    size = 72 * figure.get_size_inches()
    outside = [(line.box.min < -SLACK).any() or (line.box.max > size + SLACK).any() for line in lines]
    return [line.text for line, is_outside in zip(lines, outside, strict=True) if is_outside]
