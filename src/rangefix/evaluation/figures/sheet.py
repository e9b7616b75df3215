"""Where a figure is drawn: on its own, in the place of one axes, or in axes that a caller has."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from numpy.typing import NDArray

from .layout import Layout, dpi_of, line_height, text_width, wrapped

MARGIN = 0.15  # inches, at the edges of a figure
LINES_OF_NOTE, LINES_OF_LEGEND = 2, 6.5  # for which the natural size of a figure has room, with margins
HANDLE = 3.4  # widths of an m that an entry of a legend needs beside its text
Panels = NDArray[np.object_]


class Sheet:
    """What a figure is drawn on.

    Attributes:
        layout: How wide it is, and how large its letters are.
        given: The axes of the caller; none where the figure is drawn on its own.
        figure: What holds the panels: a figure of its own, or a part of the caller's; set by `panels`.
        width: Of the whole, inches; set by `panels`.
        panel_width: Of each panel, inches; None where panels are as wide as they need.
        title_width: Of the titles of panels that are as wide as they need, inches; set by `panels`.
        drawn: The panels, axes; set by `panels`.
    """

    def __init__(self, layout: Layout, ax: Axes | Sequence[Axes] | None = None) -> None:
        self.given: list[Axes] = [] if ax is None else [ax] if isinstance(ax, Axes) else list(np.ravel(ax))  # type: ignore[arg-type]
        self.layout = Layout.like_that_of(_inches(self.given[0])) if len(self.given) == 1 else layout
        self.figure: Figure | SubFigure | None = None
        self.width = 0.0
        self.panel_width: float | None = None
        self.title_width = 0.0
        self.drawn: list[Axes] = []
        self._before: set[Artist] = set()
        self._own = not self.given
        self._lines = self._broken_lines = 0

    def panels(
        self,
        count: int,
        deep: int = 1,
        *,
        columns: int,
        natural: tuple[float, float],
        beside: float = 0.0,
        inset: float = 0.0,
        height: Callable[[float], float] = float,
        **options: Any,
    ) -> Panels:
        """The panels of the figure: blocks side by side, in as many lines as they need.

        Args:
            count: Number of blocks.
            deep: Panels under each other in a block.
            columns: Blocks side by side.
            natural: Size of a figure whose layout gives no width, inches.
            beside: Width of the labels beside the panels, inches.
            inset: Width of the ticks' labels that each panel has, inches.
            height: Height of a block with its labels for the width of a panel, inches.
            **options: For `Figure.subplots`.

        Returns:
            Axes, (count, deep).

        Raises:
            ValueError: If axes were given, and not as many as there are panels.
        """
        lines = self._lines = -(-count // columns)
        size = natural
        self.title_width = (natural[0] - 0.3) / columns - 0.7
        if self.layout.width is not None and not self.given:
            self.panel_width = (self.layout.width - beside - MARGIN) / columns - inset - 0.08
            size = (self.layout.width, MARGIN + lines * height(self.panel_width))
        if self.given and len(self.given) == count * deep:
            return self._take(count, deep)
        if not self.given:
            self.figure, self.width = Figure(figsize=size, layout="constrained"), size[0]
        elif len(self.given) == 1:
            self._share(self.given[0], columns, beside, inset)
        else:
            raise ValueError(
                f"this figure has {count * deep} panels, and {len(self.given)} axes were given: give as "
                "many, or one whose place they share"
            )
        grid = self.figure.subplots(lines * deep, columns, squeeze=False, **options)  # type: ignore[union-attr]
        blocks = [grid[line * deep : (line + 1) * deep, i] for line in range(lines) for i in range(columns)]
        for block in blocks[count:]:
            for axes in block:
                axes.set_visible(False)
        self.drawn = [axes for block in blocks[:count] for axes in block]
        return np.array([list(block) for block in blocks[:count]], dtype=object).reshape(count, deep)

    def _take(self, count: int, deep: int) -> Panels:
        """The caller's axes, one for each panel."""
        self.drawn = self.given
        self._before = {artist for axes in self.given for artist in axes.get_children()}
        first = self.given[0]
        self.figure = first.get_figure(root=False)
        self.panel_width = min(_inches(axes) for axes in self.given)
        self.width = self.panel_width
        return np.array([*self.given, None], dtype=object)[:-1].reshape(count, deep)

    def _share(self, ax: Axes, columns: int, beside: float, inset: float) -> None:
        """A part of the caller's figure in the place of one axes, which is hidden."""
        spec = ax.get_subplotspec()
        if spec is None:
            raise ValueError(
                "this figure has several panels: give an axes that `subplots` made, or one for each"
            )
        ax.set_axis_off()
        self.width = _inches(ax)
        self.panel_width = max((self.width - beside) / columns - inset, 0.3)
        self.figure = ax.get_figure(root=False).add_subfigure(spec)  # type: ignore[union-attr]

    @property
    def root(self) -> Figure:
        """The whole figure."""
        if self.figure is None:
            raise ValueError("nothing is drawn yet")
        return self.figure.get_figure(root=True)

    def artists(self) -> list[Artist]:
        """What was drawn in the panels: data, not their axes, titles and labels."""
        return [
            artist
            for axes in self.drawn
            for artist in (*axes.images, *axes.collections, *axes.patches, *axes.lines, *axes.texts)
            if artist not in self._before
        ]

    def title(self, axes: Axes, label: str, *more: str, width: float | None = None) -> None:
        """A label above a panel, on as many lines as it, or a width in inches, needs, and further lines."""
        lines = self.broken(label, "axes.titlesize", width or self.panel_width or self.title_width)
        rest = [self.broken(text, "axes.titlesize") for text in more]
        title = "\n".join([lines, *rest])
        self._broken_lines = max(self._broken_lines, title.count("\n") - len(more))
        axes.set_title(title)

    def broken(self, text: str, setting: str, width: float | None = None) -> str:
        """A text on as many lines as a panel, or a width in inches, needs."""
        width = width or self.panel_width
        return text if width is None else wrapped(text, width, setting)

    def finish(
        self,
        title: str,
        legend_of: Iterable[Axes] = (),
        *,
        columns: int,
        more: Mapping[str, Artist] | None = None,
        note: str = "",
    ) -> None:
        """Write the title above and one legend below; axes of the caller are left to the caller.

        Args:
            title: Above the figure.
            legend_of: What is labelled in these panels stands in the legend, each label once.
            columns: Of the legend, at most; fewer where the figure is narrow.
            more: Label -> what else stands in it.
            note: A line above the legend.
        """
        if self.figure is None or (self.given and self.drawn is self.given):
            return
        entries: dict[str, Artist] = {}
        for axes in legend_of:
            handles, labels = axes.get_legend_handles_labels()
            entries |= dict(zip(labels, handles, strict=True))
        entries |= more or {}
        added = legend = self._legend(entries, columns, note)
        if self._own and self.layout.titles:
            title = wrapped(title, self.width - MARGIN, "figure.titlesize")
            self.figure.suptitle(title)
            added += (title.count("\n") + 1) * line_height("figure.titlesize") + 0.1
        if self._own and self.layout.width is not None:
            added += self._lines * self._broken_lines * line_height("axes.titlesize")
            self.root.set_figheight(self.root.get_figheight() + added)
        elif self._own:  # a long note, or a long legend, would leave no room for the panels
            line = 1.2 * line_height("legend.fontsize")
            noted = wrapped(note, self.width - MARGIN, "legend.fontsize").count("\n") + 1 if note else 0
            beyond = max(0, noted - LINES_OF_NOTE) + max(0.0, legend / line - noted - LINES_OF_LEGEND)
            self.root.set_figheight(self.root.get_figheight() + beyond * line)

    def _legend(self, entries: Mapping[str, Artist], columns: int, note: str) -> float:
        """One legend below; returns its height, inches."""
        if self.figure is None:
            return 0.0
        return legend_below(self.figure, entries, self.width - MARGIN, columns, note)


def legend_below(
    figure: Figure | SubFigure, entries: Mapping[str, Artist], room: float, columns: int, note: str = ""
) -> float:
    """One legend below the panels of a figure that is laid out by constraints.

    Args:
        figure: The figure.
        entries: Label -> what it says.
        room: How wide it may be, inches; longer labels are broken.
        columns: At most; fewer where there is no room for them.
        note: A line above it.

    Returns:
        Its height, inches; 0 where there is nothing to say.
    """
    if not (entries or note):
        return 0.0
    setting = "legend.fontsize"
    m = line_height(setting) / 1.25
    widest = max((text_width(label, setting) + HANDLE * m for label in entries), default=0.0)
    columns = max(1, min(columns, len(entries), int((room + 2 * m) / (widest + 2 * m)) if widest else 1))
    labels = [wrapped(label, room - HANDLE * m, setting) for label in entries]
    note = wrapped(note, room, setting)
    titled: dict[str, Any] = {"title": note, "alignment": "left"} if note else {}
    figure.legend([*entries.values()], labels, loc="outside lower center", ncols=columns, **titled)
    lines = sum(label.count("\n") + 1 for label in labels) / columns + 0.5
    return (lines + (note.count("\n") + 1 if note else 0)) * line_height(setting) * 1.2 + 0.1


def _inches(axes: Axes) -> float:
    """Width of an axes in its figure as it is laid out so far."""
    return float(axes.get_window_extent().width / dpi_of(axes))
