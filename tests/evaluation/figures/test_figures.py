"""Figures are functions of saved results: the same bytes every time, whatever the caller's settings."""

from __future__ import annotations

import re
import shutil
from hashlib import sha256
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from rangefix.evaluation import Experiment, NamedEstimator, ResultsError, run
from rangefix.evaluation.drawing import draw
from rangefix.evaluation.figures import FigureData, FigureKind, Layout
from rangefix.evaluation.figures.catalogue import FIGURES
from rangefix.evaluation.figures.style import COLOURS, INK, styled
from rangefix.evaluation.paper import table1

STUDY = {"map", "covariance", "anees", "errors", "runs", "time"}
PAPER = {"figure2_maps", "figure2_surfaces", "figure3_map", "figure3_surface"}


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of a small study of two estimators."""
    folder = tmp_path_factory.mktemp("study")
    estimators = {"point-mass": NamedEstimator("point-mass", {"cell": 0.1}), "ekf": NamedEstimator("ekf")}
    run(Experiment(table1.example(), estimators, runs=40, beam_sets=[[1], [1, 2, 3]]), folder)
    return folder


@pytest.fixture(scope="module")
def example(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The paper's example as saved."""
    folder = tmp_path_factory.mktemp("paper")
    table1.save(table1.solve(draws=20), folder)
    return folder


@pytest.fixture(scope="module")
def drawn(study: Path, example: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Path]]:
    """All figures of both, drawn once in folders that no test draws in again."""
    found = {}
    for kind, folder in (("study", study), ("example", example)):
        copy = tmp_path_factory.mktemp("drawn") / kind
        shutil.copytree(folder, copy, ignore=shutil.ignore_patterns("figures"))
        found[kind] = draw(copy)
    return found


def digests(paths: list[Path]) -> dict[str, str]:
    return {path.name: sha256(path.read_bytes()).hexdigest() for path in paths}


@pytest.mark.parametrize(("kind", "names"), [("study", STUDY), ("example", PAPER)])
def test_figures_are_reproducible(
    kind: str,
    names: set[str],
    drawn: dict[str, list[Path]],
    request: pytest.FixtureRequest,
    tmp_path: Path,
) -> None:
    """Every figure comes out byte for byte the same, from a moved folder and under altered settings."""
    folder, first = request.getfixturevalue(kind), drawn[kind]
    assert {path.name for path in first} == {f"{name}.{end}" for name in names for end in ("png", "svg")}
    moved = tmp_path / "elsewhere"
    shutil.copytree(folder, moved, ignore=shutil.ignore_patterns("figures"))
    with matplotlib.rc_context({"font.size": 20.0, "axes.facecolor": "red", "svg.hashsalt": "other"}):
        assert digests(draw(moved)) == digests(first)


def test_figures_for_print_are_reproducible(study: Path) -> None:
    """In all formats, at a width, with other pixels: the same bytes again."""
    wanted = {
        "only": ("claims", "time"),
        "formats": ("pdf", "svg", "png"),
        "layout": Layout.in_mm(88),
        "dpi": 300,
    }
    first = digests(draw(study, **wanted))
    assert first.keys() == {
        f"{name}.{end}" for name in ("covariance", "time") for end in ("pdf", "svg", "png")
    }
    assert digests(draw(study, **wanted)) == first
    with Image.open(study / "figures/time.png") as picture:
        assert picture.size[0] == pytest.approx(88 / 25.4 * 300, abs=1)


def test_a_part_of_the_figures_leaves_the_others(study: Path, tmp_path: Path) -> None:
    """What was not asked for stays as it was; what the results no longer hold goes."""
    folder = tmp_path / "copy"
    shutil.copytree(study, folder, ignore=shutil.ignore_patterns("figures"))
    (folder / "figures").mkdir()
    for name in ("map.png", "steps.png", "steps.pdf"):
        (folder / "figures" / name).write_bytes(b"before")
    draw(folder, ["anees"])
    assert (folder / "figures/map.png").read_bytes() == b"before"
    draw(folder, formats=["png"])
    assert (folder / "figures/map.png").read_bytes() != b"before"
    assert not (folder / "figures/steps.png").exists()
    assert (folder / "figures/steps.pdf").exists()


@pytest.mark.parametrize(
    ("wanted", "told"),
    [
        ({"only": ["aness"]}, "there is no figure 'aness'; did you mean anees?"),
        ({"only": ["volume"]}, "there is no figure 'volume'; there are map, covariance, claims, anees"),
        ({"only": ["map", "steps"]}, "has no figure 'steps': each run has one measurement"),
        ({"formats": ["pgn"]}, "there is no format 'pgn'; did you mean png?"),
        ({"dpi": 0.0}, "50 to 1200 pixels per inch (dpi), not 0"),
        ({"dpi": float("nan")}, "not nan"),
        ({"layout": Layout(15.0), "dpi": 1200.0, "formats": ["png"], "only": ["covariance"], "most": 10_000},
         "would have 18000 x"),
    ],
)  # fmt: skip
def test_what_cannot_be_drawn_is_refused(
    wanted: dict[str, Any], told: str, study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each in one line, before anything is written."""
    if most := wanted.pop("most", None):
        monkeypatch.setattr("rangefix.evaluation.figures.files.MOST_PIXELS", most)
    folder = tmp_path / "copy"
    shutil.copytree(study, folder, ignore=shutil.ignore_patterns("figures"))
    with pytest.raises(ResultsError, match=re.escape(told)):
        draw(folder, **wanted)
    assert not (folder / "figures").exists()


def test_no_time_and_no_machine_in_the_files(study: Path) -> None:
    """A figure tells neither when nor where nor with which version it was drawn."""
    words = (b"matplotlib v", b"Matplotlib version", b"dc:date", b"CreationDate", b"/tmp/")
    for path in draw(study, formats=("png", "svg", "pdf"), only=("map", "anees")):
        content = path.read_bytes()
        assert not [word for word in words if word in content]


def test_pictures_show_something(drawn: dict[str, list[Path]]) -> None:
    """Every picture has more than its background: between 0.5 and 90 % of the pixels are not white."""
    for path in (path for paths in drawn.values() for path in paths if path.suffix == ".png"):
        grey = np.asarray(Image.open(path).convert("L"))
        assert 0.005 < (grey < 250).mean() < 0.9, path.name


def test_our_settings_are_given_back() -> None:
    """Drawing leaves matplotlib's settings as they were."""
    before = dict(matplotlib.rcParams)
    with styled():
        assert matplotlib.rcParams["svg.hashsalt"] == "rangefix"
    assert dict(matplotlib.rcParams) == before


def test_densities_get_darker_in_grey() -> None:
    """The colours of densities fall in luminance all the way, so a grey print keeps the order."""
    red, green, blue, _ = INK(np.linspace(0, 1, 64)).T
    assert (np.diff(0.2126 * red + 0.7152 * green + 0.0722 * blue) < 0).all()


def test_neighbouring_colours_differ_in_grey() -> None:
    """The first estimators' colours differ by at least 0.1 in luminance from their neighbours."""
    rgb = np.array([matplotlib.colors.to_rgb(colour) for colour in COLOURS[:4]])
    assert (np.abs(np.diff(rgb @ [0.2126, 0.7152, 0.0722])) > 0.1).all()


def test_a_folder_without_results_says_so(tmp_path: Path) -> None:
    with pytest.raises(ResultsError, match="holds no results"):
        draw(tmp_path)


def test_every_figure_is_told_of() -> None:
    """docs/figures.md has a line for each figure of the catalogue."""
    page = Path(__file__).parents[3] / "docs" / "figures.md"
    if not page.is_file():  # a source distribution has it, an installed package has not
        pytest.skip("the pages are not there")
    told = {line.split(" | ")[0].removeprefix("| ") for line in page.read_text(encoding="utf-8").splitlines()}
    assert {kind.name for kind in FIGURES} <= told


def test_another_package_adds_a_figure(study: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An entry point is drawn with ours; what is no figure, or has the name of one of ours, is left out."""

    def draw_labels(data: FigureData) -> Figure:
        figure = Figure()
        figure.add_subplot().set_title(" ".join(data.labels.values()))
        return figure

    mine = FigureKind("mine", "Mine", "labels", draw_labels)
    unfit = FigureKind("unfit", "Unfit", "never drawn", draw_labels, needs=FigureData.has_steps)
    offered = {"a": mine, "b": unfit, "c": FigureKind("map", "Map", "again", draw_labels), "d": "no figure"}
    monkeypatch.setattr("rangefix.evaluation.figures.catalogue.extensions", lambda group: offered)
    with pytest.warns(RuntimeWarning) as warned:
        names = {path.name for path in draw(study)}
    assert names == {f"{name}.{end}" for name in (*STUDY, "mine") for end in ("png", "svg")}
    assert [str(warning.message) for warning in warned] == [
        "rangefix.figures: 'c' is another 'map'",
        "rangefix.figures: 'd' is no FigureKind",
    ]
    assert len({kind.name for kind in FIGURES}) == len(FIGURES)


def test_runs_that_all_failed_are_drawn(study: Path, tmp_path: Path) -> None:
    """An estimator that never answers leaves its place empty and the figures whole."""
    source = tmp_path / "failing.py"
    source.write_text("def build(problem):\n    return Never()\n" + NEVER, encoding="utf-8")
    estimators = {"never": NamedEstimator(f"{source}:build"), "ekf": NamedEstimator("ekf")}
    run(Experiment(table1.example(), estimators, runs=10), tmp_path / "out")
    assert len(draw(tmp_path / "out")) >= 10


NEVER = """
class Never:
    def init(self, prior, rng): raise RuntimeError("no")
    def predict(self, belief, control, rng): return belief
    def update(self, belief, measurement, rng): return belief
    def estimate(self, belief): return belief
"""
