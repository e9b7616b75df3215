"""Pages on one and on three folders in a browser: three widths, light and dark, with and without scripts."""

from __future__ import annotations

import base64
from pathlib import Path

import pytest

from rangefix.evaluation import write_comparison

from .browser import (
    LOW_CONTRAST,
    OUT_OF_LINE,
    OVERFLOWING,
    OVERLAPPING,
    OVERLAPPING_IN_FIGURES,
    Browser,
)

pytestmark = pytest.mark.study
OPEN_ALL = "document.querySelectorAll('details').forEach(each => { each.open = true })"
TOO_WIDE = "const page = document.documentElement; return page.scrollWidth - page.clientWidth"
TABLE_WIDTH = 740  # px; narrower, a line of a table is a card


@pytest.fixture(scope="module")
def files(page: str, study: Path, three: list[Path], tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """The page on one folder, and that on three."""
    out = tmp_path_factory.mktemp("pages")
    (out / "one.html").write_text(page, encoding="utf-8")
    return [out / "one.html", write_comparison(three, out / "three.html")]


@pytest.mark.parametrize("folders", [1, 3])
@pytest.mark.parametrize("width", [375, 768, 1280])
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("scripts", [True, False], ids=["scripts", "no scripts"])
def test_a_page_in_a_browser(
    files: list[Path], window: Browser, folders: int, width: int, dark: bool, scripts: bool
) -> None:
    """No word on the console, no request, nothing too wide, pale or overlapping, heads over their columns."""
    file = files[folders // 2]
    window.open(file, width, dark, scripts)
    window.run(OPEN_ALL)
    assert (
        window.run("return document.documentElement.scrollWidth - document.documentElement.clientWidth") <= 0
    )
    assert window.run(OVERFLOWING, width) == []
    assert window.run(OVERLAPPING) == []
    assert window.run(LOW_CONTRAST) == []
    assert width < TABLE_WIDTH or window.run(OUT_OF_LINE) == []
    assert (window.run("return document.querySelectorAll('thead button').length") > 0) == scripts
    assert window.console() == []
    asked = [each for each in window.requests() if not each.startswith("data:")]
    assert asked == [file.resolve().as_uri()]


@pytest.mark.parametrize("folders", [1, 3])
def test_letters_in_figures_never_overlap(files: list[Path], window: Browser, folders: int) -> None:
    window.open(files[folders // 2])
    assert window.run(OVERLAPPING_IN_FIGURES) == []


SORT = """
const table = document.querySelector('#worst table'), column = arguments[0];
const button = table.tHead.rows[0].cells[column].querySelector('button');
const shown = () => [...table.tBodies[0].rows].map(row => row.cells[column].textContent);
const found = [shown()];
for (let k = 0; k < 3; k++) {
  button.click();
  found.push(shown(), button.parentElement.getAttribute('aria-sort'));
}
return found;
"""


def test_a_click_on_a_head_sorts(files: list[Path], window: Browser) -> None:
    """Up, down, and as it was: numbers as numbers, words as words."""
    window.open(files[0])
    for column in (0, 3):
        before, up, named, down, other, again, none = window.run(SORT, column)
        expected = sorted(before) if column == 0 else sorted(before, key=float)
        assert (up, named) == (expected, "ascending")
        assert (down, other) == (expected[::-1], "descending")
        assert (again, none) == (before, None)


POINT = """
const line = [...document.querySelectorAll('#worst details tr[data-at]')][arguments[0]];
line.dispatchEvent(new PointerEvent('pointerenter'));
const [x, y] = line.dataset.at.split(' ').map(Number);
const frame = document.getElementById('worst-map').getBoundingClientRect();
const ring = document.querySelector('#worst-map .ring').getBoundingClientRect();
return [line.className, line.dataset.tip, document.querySelector('#worst .tip').textContent,
  line.dataset.run, document.getElementById('repeated').textContent,
  Math.hypot(frame.left + x / 100 * frame.width - (ring.left + ring.right) / 2,
             frame.top + y / 100 * frame.height - (ring.top + ring.bottom) / 2)];
"""


def test_pointing_at_a_line_marks_the_map_and_names_the_command(files: list[Path], window: Browser) -> None:
    window.open(files[0])
    window.run(OPEN_ALL)
    for number in (0, 7, 29):
        looks, tip, told, run, repeated, apart = window.run(POINT, number)
        assert looks == "on"
        assert told == tip
        assert tip.split(", run ")[1].startswith(f"{run}: NEES / n ")
        assert repeated == run
        assert apart < 1.0


def test_a_foreign_script_does_not_run(files: list[Path], window: Browser, tmp_path: Path) -> None:
    """Negative control: the page's policy stops a script and a handler that somebody has put into it."""
    text = files[0].read_text(encoding="utf-8")
    foreign = "<script>document.title = 'mine'</script><p id=p onclick=\"document.title = 'mine'\">x</p>"
    (tmp_path / "foreign.html").write_text(text.replace("<main>", f"<main>{foreign}"), encoding="utf-8")
    window.open(tmp_path / "foreign.html")
    window.run("document.getElementById('p').click()")
    assert window.run("return document.title") != "mine"
    assert len([line for line in window.console() if "Content Security Policy" in line]) == 2
    assert window.run("return document.querySelectorAll('thead button').length") > 0


def test_bad_pages_would_be_seen(window: Browser, tmp_path: Path) -> None:
    """Negative control: words on words, a head beside its column, letters of a figure on each other."""
    squares = "".join(f"<g id='text_{k}'><path d='M{4 * k} {4 * k}h9v9h-9z'/></g>" for k in (0, 1))
    drawing = base64.b64encode(f"<svg xmlns='http://www.w3.org/2000/svg'>{squares}</svg>".encode()).decode()
    (tmp_path / "bad.html").write_text(
        "<p style='margin:0'>under</p><p style='margin:-20px 0 0'>over</p>"
        "<table class=rows style='width:400px'><thead><tr><th style='text-align:left'>n</th></tr></thead>"
        "<tbody><tr><td style='text-align:right'>1</td></tr></tbody></table>"
        f"<img alt=drawn src='data:image/svg+xml;base64,{drawing}'>",
        encoding="utf-8",
    )
    window.open(tmp_path / "bad.html")
    assert window.run(OVERLAPPING) == ["over | under"]
    assert len(window.run(OUT_OF_LINE)) == 1
    assert window.run(OVERLAPPING_IN_FIGURES) == ["drawn: text_0 | text_1"]
