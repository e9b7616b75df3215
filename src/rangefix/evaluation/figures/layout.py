"""How wide figures are, how large their letters, and how texts are broken to fit."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, cast

from matplotlib import rcParams
from matplotlib.artist import Artist
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import text_to_path

FONT_SIZE = 9.0  # points, of the labels of axes where no width is asked for
FONT_SIZE_IN_PRINT = 8.0  # points, where one is
FONT_SIZES = 5.0, 20.0  # points
WIDTHS = 70.0, 400.0  # mm
LEAST_WIDTH = 8.5  # mm for each point of the letters
INCH = 25.4  # mm
NATURAL: dict[str, float] = {  # letters at that size, points
    "font.size": 9.0, "axes.labelsize": 9.0, "axes.titlesize": 9.5, "figure.titlesize": 10.5,
    "legend.fontsize": 8.0, "legend.title_fontsize": 8.0, "xtick.labelsize": 8.0, "ytick.labelsize": 8.0,
}  # fmt: skip
# Spaces that are no places to break a line.
TOGETHER = r" (?=[+=%] )|(?<= [+=]) |(?<=\d) (?=m\b)"
MAX_BESIDE = 6  # estimators side by side
LARGEST = 9.0 / 8.0  # of letters in a figure of a given width, times those of the labels


@dataclass(frozen=True)
class Layout:
    """How figures are laid out.

    Attributes:
        width: Of every figure, inches; None: as wide as its panels need.
        font_size: Of the labels of axes, points; those of ticks and legends are a ninth smaller.
        titles: Whether the title of the figure stands above it.

    Raises:
        ValueError: If there cannot be such a figure: too narrow for its letters, or too large.
    """

    width: float | None = None
    font_size: float = FONT_SIZE
    titles: bool = True

    def __post_init__(self) -> None:
        if not FONT_SIZES[0] <= self.font_size <= FONT_SIZES[1]:
            raise ValueError(
                f"letters have {FONT_SIZES[0]:g} to {FONT_SIZES[1]:g} points, not {self.font_size:g}"
            )
        if self.width is None:
            return
        width, least = INCH * self.width, max(WIDTHS[0], LEAST_WIDTH * self.font_size)
        if not WIDTHS[0] - 1e-9 <= width <= WIDTHS[1] + 1e-9:
            raise ValueError(f"a figure is {WIDTHS[0]:g} to {WIDTHS[1]:g} mm wide, not {width:g}")
        if width < least - 1e-9:
            raise ValueError(
                f"letters of {self.font_size:g} points need a figure of {least:g} mm or more, not {width:g}"
            )

    @classmethod
    def in_mm(cls, width: float | None, font_size: float | None = None, *, titles: bool = True) -> Layout:
        """A layout by its width in mm; letters of a figure with a width have 8 points unless given.

        Raises:
            ValueError: If there cannot be such a figure.
        """
        usual = FONT_SIZE if width is None else FONT_SIZE_IN_PRINT
        inches = None if width is None else width / INCH
        return cls(inches, usual if font_size is None else font_size, titles)

    @classmethod
    def like_that_of(cls, width: float) -> Layout:
        """The layout of what is drawn into a part of a figure that somebody has styled.

        Args:
            width: Of the part, inches; what is narrower than a figure may be is laid out as such a figure.
        """
        font_size = min(max(_points("axes.labelsize"), FONT_SIZES[0]), FONT_SIZES[1])
        least = max(WIDTHS[0], LEAST_WIDTH * font_size) / INCH
        return cls(min(max(width, least), WIDTHS[1] / INCH), font_size)

    @property
    def scale(self) -> float:
        """How large letters are beside those of a figure without a given width."""
        return self.font_size / FONT_SIZE

    @property
    def letters(self) -> dict[str, float]:
        """Settings of matplotlib: sizes of letters, points."""
        most = float("inf") if self.width is None else LARGEST * self.font_size
        return {name: min(points * self.scale, most) for name, points in NATURAL.items()}

    def columns(self, count: int, most: int, least: float, beside: float = 0.0) -> int:
        """How many panels stand side by side, so that as few lines as need be are about equally long.

        Args:
            count: How many there are.
            most: As many at most.
            least: Width that each needs, inches, at the natural size of letters.
            beside: Width that the labels beside them need, inches.
        """
        room = most if self.width is None else int((self.width - beside) / (least * self.scale))
        lines = -(-count // max(1, min(count, most, room)))
        return -(-count // lines)


def small() -> float:
    """Size of the smallest letters, points: those of ticks and of numbers within panels."""
    return _points("xtick.labelsize")


def _points(setting: str) -> float:
    """A size of letters in matplotlib's settings, which may be a word, points."""
    return float(FontProperties(size=cast("dict[str, Any]", rcParams)[setting]).get_size_in_points())


def text_width(text: str, setting: str, *, bold: bool = False) -> float:
    """Width of the longest line of a text in inches, in the size of letters that a setting gives."""
    family = tuple(rcParams["font.family"])
    lines = text.replace(r"\$", "$").split("\n")
    return max(_line_width(line, _points(setting), "bold" if bold else "normal", family) for line in lines)


@lru_cache(maxsize=5000)
def _line_width(line: str, points: float, weight: str, family: tuple[str, ...]) -> float:
    """Width of a line, inches."""
    font = FontProperties(family=list(family), size=points, weight=weight)
    return float(text_to_path.get_text_width_height_descent(line, font, ismath=False)[0]) / 72


def line_height(setting: str) -> float:
    """Height of a line of text, inches."""
    return 1.25 * _points(setting) / 72


def wrapped(text: str, width: float, setting: str, **font: Any) -> str:
    """The text, broken into lines that are not wider: at spaces and hyphens; longer words, anywhere.

    Sums, such as 1 + 2, and figures with their units stay together if they can.

    Args:
        text: Some text; its own ends of lines are kept.
        width: Inches.
        setting: matplotlib's setting that gives the size of its letters, such as "legend.fontsize".
        **font: See `text_width`.
    """

    def fits(line: str) -> bool:
        return text_width(line.rstrip(), setting, **font) <= width

    if all(fits(line) for line in text.split("\n")):
        return text
    lines: list[str] = []
    for paragraph in re.sub(TOGETHER, "\u00a0", text).split("\n"):
        line = ""
        for word in re.findall(r"[^ -]*[ -]?", paragraph):
            if line and not fits(line + word):
                lines.append(line.rstrip())
                line = ""
            for letter in [word] if fits(word) else re.findall(r"\\\$|.", word):
                if line and not fits(line + letter):
                    lines.append(line)
                    line = ""
                line += letter
        lines.append(line.rstrip())
    return "\n".join(lines)


def dpi_of(artist: Artist) -> float:
    """Dots per inch of the figure that an artist is in."""
    figure = artist.get_figure(root=True)
    assert figure is not None
    return float(figure.dpi)
