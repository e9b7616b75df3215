"""Beliefs saved to be drawn, and the figures of unknown headings and of drives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rangefix.cli.screen import console
from rangefix.cli.tables.study import comparison
from rangefix.evaluation import load, load_study, parse_study, run, summarise
from rangefix.evaluation.consistency.formatting import factor, unit
from rangefix.evaluation.drawing import draw
from rangefix.evaluation.results import FILE, load_pictures, read_if_valid
from rangefix.filters.optional_methods import sample_belief, show_belief
from rangefix.filters.particle import ParticleFilter

from ..figures.conftest import MOVING

TWO_MODES = """
runs = 6
[map]
kind = "rectangle"
width_m = 4.0
length_m = 6.0
[sensor]
bearings_deg = [0, 50, 110, 190, 260]
std_m = 0.2
[state]
heading = "unknown"
[truth]
at_m = [1.0, 2.0]
heading_deg = 40.0
[[estimators]]
name = "point-mass"
options = { cell_m = 0.25, heading_cell_deg = 6.0 }
[[estimators]]
name = "particle"
options = { particles = 500 }
[[estimators]]
name = "ekf"
"""
DRIVE = (
    MOVING
    + """
[[estimators]]
name = "particle"
options = { particles = 200 }
[[estimators]]
name = "ekf"
"""
)


@pytest.fixture(scope="module")
def two_modes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results with an unknown heading."""
    folder = tmp_path_factory.mktemp("two_modes")
    run(parse_study(TWO_MODES), folder)
    return folder


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of a drive."""
    folder = tmp_path_factory.mktemp("drive")
    run(parse_study(DRIVE), folder)
    return folder


def test_densities_hold_all_the_probability(two_modes: Path) -> None:
    """Over the room and over the heading, of cells and of particles; Gaussian filters have no picture."""
    pictures = load_pictures(two_modes)
    assert [picture.estimator for picture in pictures] == ["point-mass", "particle"]
    for each in pictures:
        left, right, lower, upper = each.extent
        pixel = (right - left) * (upper - lower) / each.density.size
        assert each.density.sum() * pixel == pytest.approx(1)
        assert (each.heading_density * np.diff(each.headings)).sum() == pytest.approx(1)
        assert each.headings[-1] - each.headings[0] == pytest.approx(2 * np.pi)


def test_a_rectangular_room_has_two_modes(two_modes: Path) -> None:
    """The exact belief is the same half a turn on, in the room and in the heading."""
    exact = load_pictures(two_modes)[0]
    np.testing.assert_allclose(exact.density, exact.density[::-1, ::-1], atol=1e-9 * exact.density.max())
    heading = exact.heading_density
    np.testing.assert_allclose(heading, np.roll(heading, len(heading) // 2), atol=1e-9 * heading.max())
    peak = np.rad2deg(exact.headings[np.argmax(heading)])
    assert min(abs(peak - 40), abs(peak - 220)) < 12


def test_pictures_are_kept_while_what_they_show_is_the_same(two_modes: Path) -> None:
    """A second run leaves the file; one of a damaged file writes the same bytes again."""
    path = two_modes / FILE
    before = path.read_bytes(), path.stat().st_mtime_ns
    run(parse_study(TWO_MODES), two_modes)
    assert (path.read_bytes(), path.stat().st_mtime_ns) == before
    path.write_bytes(before[0][:100])
    run(parse_study(TWO_MODES), two_modes)
    assert path.read_bytes() == before[0]
    assert read_if_valid(path, "another key") is None


def test_figures_of_headings_and_drives(two_modes: Path, drive: Path) -> None:
    """Both have their own figures, the same bytes each time."""
    for folder, names in ((two_modes, ["runs", "posterior"]), (drive, ["map", "steps", "ways"])):
        first = {path.name: path.read_bytes() for path in draw(folder, names)}
        assert first.keys() == {f"{name}.{suffix}" for name in names for suffix in ("png", "svg")}
        assert {path.name: path.read_bytes() for path in draw(folder, names)} == first
    assert not (drive / FILE).exists()  # they are of objects that stand still


def test_headings_are_shown_in_degrees(two_modes: Path, drive: Path) -> None:
    """The table of the last of many measurements alone, heading in degrees, the same number as in rad."""
    assert (unit("heading"), unit("x1"), unit("v2")) == ("deg", "m", "m/s")
    rows = summarise(load(two_modes))
    screen = console()
    with screen.capture() as shown:
        screen.print(*comparison(rows, "title"))
    exact = next(row for row in rows if row.estimator == "point-mass")
    std = factor("heading") * exact.p[2].sqrt().value
    assert "heading std, deg" in shown.get()
    assert f"/ {std:.3g}" in shown.get()
    with screen.capture() as shown:
        screen.print(*comparison(summarise(load(drive)), "title"))
    assert shown.get().count("ekf") == 1
    assert "after the last of 6 measurements" in " ".join(shown.get().split())


@pytest.mark.parametrize("name", ["two_modes", "drive", "heavy_tails", "heavy_tails_matched"])
def test_studies_that_come_along_are_sound(name: str) -> None:
    study = load_study(name, runs=3)
    made = study.experiment()
    assert made.name == name
    assert made.runs == 3
    assert (made.assumed is not None) == (name == "heavy_tails")


def test_the_harness_tells_heavy_tails() -> None:
    """200 runs: the exact filter that assumes Gaussian noise is overconfident, the one that knows is not.

    The intervals are at 95 %; the claims are tested against twice the distance, for seed 1.
    """
    rows = {}
    for name in ("heavy_tails", "heavy_tails_matched"):
        study = load_study(name, runs=200)
        study = study.model_copy(update={"estimators": study.estimators[:1]})
        (rows[name],) = summarise(run(study, timing=False))
    assert rows["heavy_tails"].anees.low > 1.5
    matched = rows["heavy_tails_matched"].anees
    assert abs(matched.value - 1) < matched.high - matched.low


def test_a_belief_that_cannot_be_shown_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A warning names the estimator and why; the pictures of the others are there."""

    def broken(self: ParticleFilter, belief: object, run: int) -> None:
        raise ZeroDivisionError("no pixels")

    monkeypatch.setattr(ParticleFilter, "density", broken)
    with pytest.warns(RuntimeWarning, match="'particle' believes: ZeroDivisionError: no pixels"):
        run(parse_study(TWO_MODES), tmp_path, timing=False)
    assert [picture.estimator for picture in load_pictures(tmp_path)] == ["point-mass"]


@pytest.mark.parametrize("name", ["adaptive-point-mass", "enkf"])
def test_beliefs_without_cells_are_shown_by_draws(name: str) -> None:
    """The density over the room is that of draws: as many of them, and their mean to a pixel."""
    experiment = parse_study(TWO_MODES.replace('"ekf"', f'"{name}"')).experiment()
    problem, estimator = experiment.assumed_problem, experiment.estimators[name](experiment.assumed_problem)
    rngs = [np.random.default_rng(1)]
    reading = problem.sensor.expected(np.array([[1.0, 2.0, 0.7]]))
    belief = estimator.update(estimator.init(problem.prior, rngs), reading, rngs)
    image, draws = show_belief(estimator, belief, 0), sample_belief(estimator, belief, 20_000, rngs)
    assert image is not None
    assert draws is not None
    places = draws[0, :, :2]
    inside = (places > 0).all(1) & (places < [4.0, 6.0]).all(1)
    pixel = 6.0 / 120
    share = image.density.sum() * pixel**2
    assert share == pytest.approx(inside.mean(), abs=0.02)  # of 20 000 draws each: 5 standard errors
    middles = [pixel * (np.arange(size) + 0.5) for size in image.density.shape[::-1]]
    mean = [image.density.sum(axis) @ middle * pixel**2 / share for axis, middle in enumerate(middles)]
    np.testing.assert_allclose(mean, places[inside].mean(0), atol=0.1)
