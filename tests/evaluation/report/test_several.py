"""One page on several folders: verdicts side by side, paired differences, history."""

from __future__ import annotations

import json
import math
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rangefix.cli.tables.comparisons import differences
from rangefix.evaluation import Interval, ResultsError, load, summarise, write_comparison
from rangefix.evaluation.comparison.compare import Comparison, Difference, compare
from rangefix.evaluation.figures.embedded.history import MOST_TICKS, history_figure, round_ticks
from rangefix.evaluation.figures.style import styled
from rangefix.evaluation.report.changes import change
from rangefix.evaluation.report.folders import load_folders
from rangefix.evaluation.results import write_json
from rangefix.evaluation.results.files import read_json

from ...cli.conftest import rangefix  # noqa: F401
from .conftest import LABEL, read


@pytest.fixture(scope="module")
def shown(three: list[Path], tmp_path_factory: pytest.TempPathFactory) -> str:
    """The page."""
    out = tmp_path_factory.mktemp("page") / "c.html"
    return write_comparison(three, out).read_text(encoding="utf-8")


def section(page: str, name: str) -> str:
    return page.partition(f'<section id="{name}">')[2].partition("</section>")[0]


def words(part: str) -> str:
    return " ".join("".join(read(part).data).split())


def test_its_sections_and_folders(shown: str, three: list[Path]) -> None:
    ids = [each["id"] for name, each in read(shown).elements if name == "section"]
    assert ids == ["folders", "verdict", "changes", "history"]
    told = words(section(shown, "folders"))
    for letter, folder in zip("ABC", three, strict=True):
        date = load(folder).manifest["date"][:16].replace("T", " ")
        assert re.search(rf"{letter}\s*{re.escape(str(folder))}\s*{date}", told)


def test_verdicts_stand_side_by_side(shown: str) -> None:
    """Of an estimator that stays, of one that changes in the last folder, of one that is new there."""
    body = section(shown, "verdict").partition("<tbody>")[2].partition("</tbody>")[0]
    lines = {row.partition("</th>")[0].rpartition(">")[2]: row for row in body.split("<tr")[2:]}
    steady, changed = (re.findall(r'class="badge (\w+)"', lines[name]) for name in ("steady", "changed"))
    assert len(steady) == len(changed) == 3
    assert set(steady) <= {"honest", "unsure"}
    assert changed[:2] == steady[:2]
    assert changed[2] == "overconfident"
    (new,) = (row for name, row in lines.items() if name not in ("steady", "changed"))
    assert [cell.strip() for cell in re.findall(r'class="text ">([^<]*)', new)][:2] == ["-", "-"]


def test_differences_are_those_of_the_pairing(three: list[Path]) -> None:
    """Nothing differs between the first two; the claims of the changed estimator do in the last."""
    folders = load_folders(three)
    same, other = change(*folders[:2]), change(*folders[1:])
    assert same.significant.groups == []
    assert {cell for _, lines in same.last.groups for line in lines for cell in [line.cells[-1].value]} == {
        "the same"
    }
    differences = compare(folders[1].results, folders[2].results).differences
    found = [line for _, lines in other.significant.groups for line in lines]
    assert len(found) == sum(each.significant for each in differences) > 0
    assert all(heading.startswith("changed,") for heading, _ in other.significant.groups)
    claimed = next(line for line in found if line.name == "x1 claimed std, m")
    assert [cell.value for cell in claimed.cells][1:4] == ["1.15", "0.73", f"{0.4**0.5:.3g}"]
    assert claimed.cells[-1].value == "smaller"
    anees = next(line for line in found if line.name == "ANEES/n")
    assert float(anees.cells[3].value) == pytest.approx(1 / 0.4, rel=0.01)
    assert other.settings[-2:] == [f"only in C: {LABEL}, beam 1", f"only in C: {LABEL}, beams 1 + 2 + 3"]


def test_a_ratio_has_the_interval_of_the_difference() -> None:
    """Of variances the roots, as tables show them; unknown where A is nothing."""
    row = Difference("e", "1", 0, "mse_x1", 9, a=4.0, b=9.0, change=Interval(5.0, -4.0, 12.0), p=0.1)
    assert row.ratio == Interval(1.5, 0.0, 2.0)
    plain = Difference("e", "1", 0, "anees", 9, a=4.0, b=9.0, change=Interval(5.0, -5.0, 12.0), p=0.1)
    assert plain.ratio == Interval(2.25, 0.0, 4.0)
    nothing = Difference("e", "1", 0, "anees", 9, a=0.0, b=9.0, change=Interval(9.0, 1.0, 12.0), p=0.1)
    assert np.isnan(nothing.ratio.value)


def test_headings_are_compared_in_degrees_everywhere() -> None:
    """On the terminal they were in radians, and no figure had a unit; the report had both."""
    nothing = Interval(math.nan, math.nan, math.nan)
    squares = math.radians(3.0) ** 2, math.radians(6.0) ** 2
    heading = Difference("e", "all", 0, "mse_heading", 9, *squares, nothing, 1.0)
    assert heading.label_with_unit == "heading true std, deg"
    assert heading.shown == pytest.approx((3.0, 6.0))
    table = differences(Comparison((), {}, True, (), (), (heading,)))
    assert [list(column.cells)[1] for column in table.columns][2:5] == ["3", "6", "2"]


def test_history_has_every_number(shown: str, three: list[Path]) -> None:
    """ANEES / n and true standard deviations of each estimator with its interval, in the order given."""
    told = section(shown, "history")
    assert told.count("<img") == 2
    table = told.partition("<tbody>")[2].partition("</tbody>")[0]
    first = table.split("<tr")[2]
    for folder, cell in zip(three, first.split("<td")[1:], strict=True):
        row = next(row for row in summarise(load(folder)) if (row.estimator, row.beams) == ("steady", "1"))
        assert f"{row.anees.value:.3g}<small>[{row.anees.low:.3g}, {row.anees.high:.3g}]" in cell
        assert 'data-figure="history-1"' in cell


def test_the_same_folders_give_the_same_page(shown: str, three: list[Path], tmp_path: Path) -> None:
    again = write_comparison(three, tmp_path / "c.html").read_text(encoding="utf-8")
    assert again == shown
    turned = write_comparison(three[::-1], tmp_path / "d.html").read_text(encoding="utf-8")
    assert words(section(turned, "folders")).index(three[2].name) < words(section(turned, "folders")).index(
        three[0].name
    )


@pytest.mark.parametrize(
    ("change_of", "told"),
    [
        ({"name": "another"}, "holds results of another study: they are of 'another', and .* of 'history'$"),
        (
            {"space": {"names": ["x2", "x1"], "heading": 0.0}},
            "holds results of another study: its states are x2, x1, those of .* x1, x2$",
        ),
    ],
)
def test_another_study_is_refused(
    three: list[Path], tmp_path: Path, change_of: dict[str, object], told: str
) -> None:
    """In one line that names both folders and what tells them apart."""
    other = tmp_path / "other"
    shutil.copytree(three[1], other)
    write_json(other / "manifest.json", read_json(other / "manifest.json") | change_of)
    with pytest.raises(ResultsError, match=told) as refused:
        write_comparison([three[0], other], tmp_path / "c.html")
    assert "\n" not in str(refused.value)
    assert not (tmp_path / "c.html").exists()


def test_one_folder_twice_and_one_alone_are_refused(three: list[Path], tmp_path: Path) -> None:
    twice = three[0].parent / "." / three[0].name / ".." / three[0].name
    with pytest.raises(ValueError, match="is given twice"):
        write_comparison([three[0], three[1], twice], tmp_path / "c.html")
    with pytest.raises(ValueError, match="needs two folders"):
        write_comparison(three[:1], tmp_path / "c.html")


def test_from_the_command_line(rangefix: Callable[..., object], three: list[Path]) -> None:  # noqa: F811
    """Several folders make comparison.html here, or the file named; one makes its report as before."""
    said = rangefix("report", *three[:2])
    assert (said.code, said.out, said.err) == (0, "comparison.html\n", "")
    assert words(Path("comparison.html").read_text(encoding="utf-8")).count("2 folders of results") == 1
    said = rangefix("report", *three, "--out", "p.html", "--json")
    assert json.loads(said.out) == {"report": "p.html"}
    said = rangefix("report", three[0], three[0])
    assert (said.code, said.err.count("\n")) == (2, 1)
    said = rangefix("report", three[0], "nowhere")
    assert (said.code, said.err.count("\n")) == (2, 1)
    assert not [path for folder in three for path in folder.glob("*.html")]


@pytest.mark.parametrize("count", [2, 9, 60])
def test_tick_labels_of_history_never_overlap(three: list[Path], count: int) -> None:
    """Measured on the drawn figure: labels of folders, of values, and titles, with as many folders."""
    rows = [row for row in summarise(load(three[0])) if row.beams == "1"]
    with styled():
        labels = [f"{k}\n2026-11-26\n0.1.0" for k in range(count)]
        figure, _ = history_figure(labels, {row.estimator: [row] * count for row in rows})
        figure.draw_without_rendering()
        boxes = [
            text.get_window_extent()
            for axes in figure.axes
            for text in (axes.title, axes._left_title, *axes.get_xticklabels(), *axes.get_yticklabels())
            if text.get_text()
        ]
    assert len(boxes) > 6
    assert not [1 for i, a in enumerate(boxes) for b in boxes[:i] if a.overlaps(b)]
    width, height = figure.bbox.size
    assert all(box.x0 >= 0 and box.y0 >= 0 and box.x1 <= width and box.y1 <= height for box in boxes)


@pytest.mark.parametrize(
    ("low", "high", "ticks"),
    [
        (0.9, 1.6, [1.0, 1.2, 1.4, 1.6]),
        (1.0, 10.0, [1.0, 2.0, 5.0, 10.0]),
        (1.0, 1e6, [1.0, 10.0, 100.0, 1e3, 1e4, 1e5, 1e6]),
    ],
)
def test_ticks_are_round(low: float, high: float, ticks: list[float]) -> None:
    assert round_ticks(np.log10(low) - 1e-9, np.log10(high) + 1e-9) == pytest.approx(ticks)


def test_ticks_are_few() -> None:
    """From a thousandth of a decade to 300 decades, wherever the axis begins."""
    for decades in (0.001, 0.1, 0.5, 1.0, 3.0, 7.9, 20.0, 300.0):
        for low in np.linspace(-3.0, -2.0, 41):
            assert 2 <= len(round_ticks(low, low + decades)) <= MOST_TICKS + 1
