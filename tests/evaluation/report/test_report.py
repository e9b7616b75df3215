"""The report: one page, whatever stands in the results; looked at by a real browser where there is one."""

from __future__ import annotations

import base64
import re
import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from jinja2 import UndefinedError
from matplotlib.figure import Figure

from rangefix.evaluation import ResultsError, load, parse_gates, write_report
from rangefix.evaluation.consistency.metrics import RunBlock
from rangefix.evaluation.figures import FigureData, FigureKind
from rangefix.evaluation.figures.catalogue import figure_kinds
from rangefix.evaluation.report.calibration import calibration_of
from rangefix.evaluation.report.data import collect
from rangefix.evaluation.report.page import environment
from rangefix.evaluation.report.report import render
from rangefix.evaluation.results import InMemory, Results, Trials, write_json
from rangefix.evaluation.results.files import read_json
from rangefix.filters import position_space

from .browser import LOW_CONTRAST, OVERFLOWING, SIZES, Browser
from .conftest import LABEL, NASTY, read


def test_hostile_text_stays_text(page: str) -> None:
    """No script, no handler, no element and no address comes from what users wrote; all of it is there."""
    reader = read(page)
    names = Counter(name for name, _ in reader.elements)
    assert names["script"] == 1  # ours: see test_policy.py
    assert not names.keys() & {"iframe", "object", "embed", "form", "base"}
    for name, attributes in reader.elements:
        assert not [key for key in attributes if key.startswith("on")]
        for key in ("src", "href"):
            value = attributes.get(key)
            assert value is None or value.startswith(("data:", "#")), (name, value)
    shown = "".join(reader.data)
    assert "<script>document.body.remove()</script>" in shown
    assert LABEL in shown
    assert NASTY in shown
    assert "\u202e" not in page
    assert "\x00" not in page


def test_the_order_of_the_sections(page: str) -> None:
    ids = [attributes["id"] for name, attributes in read(page).elements if name == "section"]
    assert ids == [
        "verdict",
        "worst",
        "table",
        "scores",
        "accuracy",
        "figures",
        "estimators",
        "failures",
        "provenance",
    ]
    links = [attributes["href"] for name, attributes in read(page).elements if name == "a"]
    assert links == [f"#{name}" for name in ids]


def test_it_says_what_the_figures_say(page: str) -> None:
    shown = " ".join("".join(read(page).data).split())
    assert "Honest: exact." in shown
    assert "Do not trust: sure" in shown
    assert "DO NOT TRUST: overconfident by a factor of" in shown
    assert "Too cautious by a factor of" in shown
    assert "Gates: 2 of 4 failed" in shown
    assert "240 × init() failed: RuntimeError: </pre>" in shown
    assert "720 of 960 trials went well" in shown


def test_every_figure_is_in_it_once(study: Path, page: str) -> None:
    """The figures that `rangefix plot` draws, each drawn once, with the words of the catalogue."""
    above, _, below = page.partition('<section id="figures">')
    assert above.count("<img") == 1  # the map of the worst runs
    section = below.partition("</section>")[0]
    images = [attributes for name, attributes in read(section).elements if name == "img"]
    kinds = [kind for kind in figure_kinds() if kind.needs(FigureData(load(study)))]
    assert len(kinds) >= 6
    assert {image["alt"] for image in images} == {f"{kind.title}: {kind.caption}" for kind in kinds}
    assert len(images) == len(kinds)
    for image in images:
        content = base64.b64decode((image["src"] or "").partition("data:image/svg+xml;base64,")[2])
        assert content.startswith(b"<?xml")
        assert b"</svg>" in content


def test_a_figure_is_drawn_once_and_nothing_is_written_beside_the_page(
    study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A figure of another package is drawn once and shown with its caption."""
    calls = []

    def draw(data: FigureData) -> Figure:
        calls.append(data.labels)
        return Figure(figsize=(2.0, 2.0))

    kind = FigureKind("mine", "My own figure", "drawn elsewhere & <well>", draw)
    monkeypatch.setattr("rangefix.evaluation.figures.catalogue.FIGURES", ())
    monkeypatch.setattr("rangefix.evaluation.figures.catalogue.extensions", lambda group: {"mine": kind})
    before = sorted(study.rglob("*"))
    reader = read(write_report(study, tmp_path / "r.html").read_text(encoding="utf-8"))
    assert len(calls) == 1
    assert sorted(study.rglob("*")) == before
    assert "My own figure: drawn elsewhere & <well>." in "".join(reader.data)
    worst, mine = (each["alt"] for name, each in reader.elements if name == "img")
    assert mine == f"{kind.title}: {kind.caption}"
    assert (worst or "").startswith("The worst runs")


def test_the_same_results_give_the_same_page(study: Path, page: str, tmp_path: Path) -> None:
    moved = tmp_path / "moved"
    shutil.copytree(study, moved)
    again = write_report(moved, tmp_path / "r.html", parse_gates(["exact", "sure:anees=0.8:1.25"]))
    assert again.read_text(encoding="utf-8") == page


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leaves out the figures, which take a second or two."""
    monkeypatch.setattr("rangefix.evaluation.report.report.figures", lambda results: iter(()))


@pytest.mark.usefixtures("undrawn")
def test_an_interrupted_study_is_reported_as_such(study: Path, tmp_path: Path) -> None:
    folder = tmp_path / "half"
    shutil.copytree(study, folder)
    write_json(folder / "manifest.json", read_json(folder / "manifest.json") | {"state": "running"})
    shutil.rmtree(folder / "parts" / "sure")
    shown = " ".join("".join(read(write_report(folder).read_text(encoding="utf-8")).data).split())
    assert "This study was interrupted" in shown
    assert "Not run yet (interrupted after 0 of 120 runs)" in shown
    assert "This study was interrupted after 0 to 120 of 120 runs" in shown


def test_steps_and_sampled_beliefs(drive: Path) -> None:
    """A drive has its course of ANEES; ranks instead of PIT, and main mode beside the whole belief."""
    shown = " ".join("".join(read(render(load(drive))).data).split())
    assert "ANEES / n after each measurement" in shown
    assert "Ranks of x1" in shown
    assert "PIT of x1" not in shown
    assert "std of x1, m: whole belief / main mode" in shown
    assert "Coverage, % (of the sampled belief)" in shown
    assert "share of the main mode" in shown
    assert "ranks, p" in shown


def test_failures_of_many_runs_are_all_counted() -> None:
    """15 000 runs, every third failed for one reason: beyond those that are held at once, too."""
    runs, rng = 15_000, np.random.default_rng(0)
    failed = np.arange(runs) % 3 == 0
    mean = np.where(failed[:, None], np.nan, 0.1 * rng.standard_normal((runs, 2)))[:, None]
    covariance = np.tile(0.01 * np.eye(2), (runs, 1, 1, 1))
    evidence, reasons = np.zeros((runs, 1)), dict.fromkeys(np.flatnonzero(failed).tolist(), "no idea")
    status = np.where(failed, 4, 0).astype(np.int8)
    trials = Trials("A", "all", mean, covariance, evidence, evidence - 9, status, reasons)
    world = InMemory(np.zeros((runs, 1, 2)), np.zeros((runs, 1, 1)), (trials,))
    manifest = {"name": "x", "state": "complete", "runs": runs, "seed": 1}
    results = Results(manifest, position_space(), ("A",), ("all",), runs, world)
    (setting,) = collect(results).estimators[0].settings
    assert setting.failures == {"no idea": 5000}
    shown = " ".join("".join(read(render(results)).data).split())
    assert "reliability are of the first 10000 runs" in shown


def test_scores_of_claim_and_belief_stand_together(page: str) -> None:
    """The exact filter's belief is sampled, the others' are not: both kinds of row fill all columns."""
    table = page[page.index('<section id="scores">') :]
    rows = table[: table.index("</section>")].split("<tr>")[1:]
    columns = rows[0].count('scope="col"')
    assert columns == 9
    exact, sure = (next(row for row in rows if f">{name}</th>" in row) for name in ("exact", "sure"))
    assert [row.count("<td ") for row in (exact, sure)] == [columns - 1] * 2
    exact_cells, sure_cells = (re.findall(r"<td [^>]*>([^<]*)", row) for row in (exact, sure))
    assert sum(" / " in cell for cell in exact_cells) == 5
    assert not any("-" in cell.replace("e-", "") for cell in exact_cells[1:])
    assert sum(cell.endswith(" / -") for cell in sure_cells) == 3
    assert sure_cells[4:] == ["-"] * 4


def test_no_folder_of_results_is_one_clear_line(tmp_path: Path) -> None:
    with pytest.raises(ResultsError, match="not a folder of results"):
        write_report(tmp_path)


@pytest.mark.usefixtures("undrawn")
def test_a_page_that_cannot_be_written(study: Path) -> None:
    with pytest.raises(ResultsError, match="cannot write"):
        write_report(study, Path("/proc/nowhere/report.html"))


def test_the_template_escapes_all_but_itself() -> None:
    shown = (
        environment().from_string("<p title='{{ it }}'>{{ it }}</p>{{ 3 }}").render(it='<i b="c">&\x07\ud800')
    )
    assert shown == "<p title='{0}'>{0}</p>3".format("&lt;i b=&#34;c&#34;&gt;&amp;\ufffd\ufffd")


def test_what_a_template_names_must_be_there() -> None:
    """Negative control: a name that is not there is an error, not an empty place on the page."""
    with pytest.raises(UndefinedError, match="nowhere"):
        environment().from_string("{{ nowhere }}").render()


def test_histograms_and_coverage_say_what_lies_outside_the_band() -> None:
    """Errors ten times what is claimed: the ends of PIT are too full, every ellipse holds too few."""
    errors = 10 * np.random.default_rng(1).normal(size=(400, 1))
    coverage, ranks, reliability = calibration_of(RunBlock(("x1",), errors, np.ones((400, 1, 1))))
    assert [cell.kind for cell in coverage.cells] == ["outside"] * 9
    assert "10 of 10 outside" in ranks.note
    assert {cell.kind for cell in reliability.cells} == {"overconfident"}
    honest = calibration_of(RunBlock(("x1",), errors, np.full((400, 1, 1), 100.0)))
    assert [cell.kind for cell in honest[0].cells] == [""] * 9
    assert "0 of 10 outside" in honest[1].note
    assert sum(cell.kind == "honest" for cell in honest[2].cells) >= 7  # of 10, each by its 95 % interval


# In a browser


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("width", [1280, 375])
@pytest.mark.usefixtures("page")
def test_in_a_browser(study: Path, window: Browser, width: int, dark: bool) -> None:
    """Nothing on the console, no request beyond the file, nothing wider than the window, all opened."""
    window.open(study / "report.html", width, dark)
    window.run("document.querySelectorAll('details').forEach(each => { each.open = true })")
    assert window.run("return document.documentElement.scrollWidth") <= width
    assert window.run(OVERFLOWING, width) == []
    assert window.run("return document.querySelectorAll('h1').length") == 1
    assert window.run("return [...document.images].every(each => each.complete && each.naturalWidth > 0)")
    assert window.console() == []
    asked = [each for each in window.requests() if not each.startswith("data:")]
    assert asked == [(study / "report.html").resolve().as_uri()]
    paper = window.run("return getComputedStyle(document.body).backgroundColor")
    brightness = sum(int(each) for each in paper.strip("rgb()").split(","))
    assert (brightness < 200) == dark


@pytest.mark.usefixtures("page")
def test_letters_can_be_read(study: Path, window: Browser) -> None:
    """On a telephone no text is smaller than 8.5 px, and none has less contrast than 4.5 to its ground."""
    for dark in (False, True):
        window.open(study / "report.html", 375, dark)
        window.run("document.querySelectorAll('details').forEach(each => { each.open = true })")
        sizes = window.run(SIZES)
        assert min(sizes) >= 8.5
        assert window.run(LOW_CONTRAST) == []


def test_a_bad_page_would_be_seen(window: Browser, tmp_path: Path) -> None:
    """Negative control: a page too wide, too pale, with a script that fails and a request."""
    file = tmp_path / "bad.html"
    file.write_text(
        "<meta name=viewport content='width=device-width'><div class=wide style='width:900px'>wide</div>"
        "<p style='color:#ccc;font-size:6px'>pale</p>"
        "<script src=there-is-none.js></script><script>broken(</script>",
        encoding="utf-8",
    )
    window.open(file, 375)
    assert window.run(OVERFLOWING, 375) == ["DIV.wide"]
    assert len(window.run(LOW_CONTRAST)) == 1
    assert min(window.run(SIZES)) == 6
    assert len(window.console()) == 2
    assert any("there-is-none" in each for each in window.requests())
