"""Figures for print: letters that can be read, no text over another or cut off, text that stays text."""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterator
from xml.etree import ElementTree

import pytest
from matplotlib.figure import Figure

from rangefix.evaluation import Results
from rangefix.evaluation.figures import FigureData, Layout
from rangefix.evaluation.figures.catalogue import FIGURES, figure_kinds, study_figures
from rangefix.evaluation.figures.files import encoded
from rangefix.evaluation.figures.layout import text_width, wrapped
from rangefix.evaluation.figures.style import styled

from .drawn_text import cut_off, drawn_lines, overlaps

COLUMN, PAGE = 88.0, 180.0  # mm
ONLY_MOVING = ("steps", "ways", "map")


def in_print(
    results: Results, width: float | None, names: tuple[str, ...] = ()
) -> Iterator[tuple[str, Figure]]:
    """The figures of results at a width in mm, or some of them, within our style."""
    layout = Layout.in_mm(width)
    data = FigureData.of(results, layout)
    with styled(layout):
        for kind in FIGURES:
            if kind.needs(data) and (not names or kind.name in names):
                yield kind.name, kind.draw(data)


@pytest.mark.parametrize("width", [COLUMN, pytest.param(PAGE, marks=pytest.mark.study)])
def test_every_figure_can_be_read_in_print(standing: Results, moving: Results, width: float) -> None:
    """Letters of 7 to 9 points, no line of text over another, none beyond the edges, at the width asked for.

    An estimator of which no run went well is told of below, and is drawn nowhere.
    """
    seen = set()
    for results, names in ((standing, ()), (moving, ONLY_MOVING)):
        for name, figure in in_print(results, width, names):
            lines = drawn_lines(figure)
            assert min(line.points for line in lines) >= 7.0, name
            assert max(line.points for line in lines) <= 9.0 + 1e-9, name
            assert not overlaps(lines), name
            assert not cut_off(lines, figure), name
            assert figure.get_figwidth() * 25.4 == pytest.approx(width)
            told = [line.text for line in lines if "never" in line.text]
            assert told == ([] if name == "map" else ["Not drawn, as no run went well: never."]), name
            seen.add(name)
    assert seen == {kind.name for kind in FIGURES}


def test_no_label_overlaps_where_no_width_is_given(standing: Results, moving: Results) -> None:
    """The figures of `rangefix plot DIR`: building map, time and steps, which have the most labels."""
    for results, names in ((standing, ("map", "time", "errors")), (moving, ("steps",))):
        for name, figure in in_print(results, None, names):
            lines = drawn_lines(figure)
            assert not overlaps(lines), name
            assert not cut_off(lines, figure), name


def test_overlaps_and_cuts_are_seen() -> None:
    """Negative control: of three texts two overlap, and one reaches beyond the edge."""
    figure = Figure(figsize=(3, 2))
    for x, text in ((0.1, "first"), (0.15, "second"), (0.95, "third")):
        figure.text(x, 0.5, text)
    lines = drawn_lines(figure)
    assert overlaps(lines) == [("first", "second")]
    assert cut_off(lines, figure) == ["third"]


def test_text_stays_text_and_its_size_is_in_the_files(standing: Results) -> None:
    """SVG and PDF hold letters, at the sizes asked for; read from the files, not from what drew them."""
    layout = Layout.in_mm(COLUMN)
    with styled(layout):
        figure = dict(in_print(standing, COLUMN, ("anees",)))["anees"]
        files = encoded(figure, ["svg", "pdf"])
    texts = ElementTree.fromstring(files["svg"]).findall(".//{http://www.w3.org/2000/svg}text")
    assert {"particle", "all beams"} <= {text.text for text in texts}
    sizes = [float(size) for size in re.findall(rb"font(?:-size)?: (?:bold )?([\d.]+)px", files["svg"])]
    assert len(sizes) == len(texts)
    assert 7.0 <= min(sizes) <= max(sizes) <= 9.0
    streams = re.findall(rb"stream\r?\n(.*?)\r?\nendstream", files["pdf"], re.DOTALL)
    page = zlib.decompress(streams[0])
    sizes = [float(size) for size in re.findall(rb"/F\S+ ([\d.]+) Tf", page)]
    assert len(sizes) >= len(texts)  # once more where letters come from another part of the font
    assert 7.0 <= min(sizes) <= max(sizes) <= 9.0
    assert b"/FontFile2" in files["pdf"]  # whole letters of a TrueType font, as publishers ask for
    box = re.search(rb"/MediaBox \[ 0 0 ([\d.]+) ", files["pdf"])
    assert box is not None
    assert float(box[1]) == pytest.approx(COLUMN / 25.4 * 72, abs=0.01)


def test_titles_can_be_left_out(standing: Results) -> None:
    with_title, without = (
        next(figure for _, figure in study_figures(standing, Layout.in_mm(COLUMN, titles=titles)))
        for titles in (True, False)
    )
    assert with_title.get_suptitle()
    assert not without.get_suptitle()
    assert without.get_figheight() < with_title.get_figheight()


@pytest.mark.parametrize(
    ("width", "size", "told"),
    [
        (5.0, 8.0, "70 to 400 mm wide, not 5"),
        (float("nan"), 8.0, "70 to 400 mm wide, not nan"),
        (1e9, 8.0, "not 1e+09"),
        (88.0, 0.0, "5 to 20 points, not 0"),
        (88.0, float("inf"), "5 to 20 points, not inf"),
        (88.0, 12.0, "letters of 12 points need a figure of 102 mm or more, not 88"),
    ],
)
def test_impossible_layouts_are_refused(width: float, size: float, told: str) -> None:
    with pytest.raises(ValueError, match=re.escape(told)):
        Layout.in_mm(width, size)


@pytest.mark.parametrize(
    "text", ["ANEES / n, no unit: left of 1 too much", "averylongwordwithoutspaces" * 3, "a\nb c"]
)
def test_wrapped_lines_fit_and_hold_all_letters(text: str) -> None:
    """No line is wider than asked for, and no letter is lost or added."""
    with styled():
        for width in (0.4, 0.9, 2.0):
            lines = wrapped(text, width, "axes.labelsize")
            assert text_width(lines, "axes.labelsize") <= width + 1e-9
            assert "".join(lines.split()) == "".join(text.split())


def test_sums_are_not_broken() -> None:
    with styled():
        lines = wrapped(
            "with beams 1 + 2 + 3", text_width("with beams 1 + 2", "axes.labelsize"), "axes.labelsize"
        )
    assert lines.split("\n")[0] == "with beams"


def test_the_help_names_every_figure() -> None:
    """`rangefix plot --help` tells all names of the catalogue, without loading it."""
    from rangefix.cli.results import FIGURE_NAMES

    told = re.findall(r"\w+", FIGURE_NAMES)
    assert sorted(told) == sorted(name for kind in figure_kinds() for name in (kind.name, *kind.other_names))
