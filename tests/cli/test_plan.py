"""`rangefix plan` and `rangefix map-accuracy`: what they print, write and refuse."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from rangefix.cli import main
from rangefix.cli.screen import as_lines, new_table


def call(*arguments: str) -> int:
    with pytest.raises(SystemExit) as ended:
        main([*arguments])
    return int(ended.value.code or 0)


FEW = ("--candidates-deg", "-90:90:45", "--truths", "4")


def test_a_plan_in_words_and_as_json(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """One beam is exact; the document says the same as the table, and the picture is there."""
    picture = tmp_path / "plan.svg"
    assert call("plan", "paper", "--beams", "1", *FEW, "--json", "--out", str(picture)) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["beams"][0]["direction_deg"] == 0
    assert told["beams"][0]["value"] == pytest.approx(1.3358, abs=1e-4)
    assert told["beams"][0]["standard_error"] == 0
    assert told["figures"] == [str(picture)]
    assert b"beam 1: 0" in picture.read_bytes()
    assert call("plan", "paper", "--beams", "1", *FEW) == 0
    text = capsys.readouterr().out
    assert "1.336" in text
    assert "none" in text
    assert "--truths has no effect on one beam" in text
    assert call("plan", "paper", "--beams", "1", "--seed", "3", "--method", "greedy", *FEW[:2]) == 0
    text = capsys.readouterr().out
    assert "1.336" in text
    assert "--method, --seed have no effect on one beam" in text
    assert call("plan", "paper", "--beams", "1", *FEW[:2]) == 0
    assert "no effect" not in capsys.readouterr().out


def test_what_a_plan_may_have_missed_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    """Of 200 000 truths those that look like other places are among 1000: 3 in 200 000 may be missed."""
    assert call("plan", "paper", "--beams", "2", *FEW) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "for a heading that is known to be 0 deg; by exchange, of 5 directions." in text
    assert (
        "over 1000 truths, chosen from 200000 so that those that are easily mistaken for other places" in text
    )
    assert "Wrong places that fewer than 1 truth in 66667 leaves open may be missed, by ± too" in text
    assert "run the study with bearings_deg = [0, -90]." in text
    assert call("plan", "paper", "--beams", "2", *FEW, "--adaptive", "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["known_heading_deg"] == 0
    assert [beam["truths"] for beam in told["beams"]] == [0, 4]
    assert [beam["truths_looked_at"] for beam in told["beams"]] == [0, 4]
    assert call("map-accuracy", "paper", "--step-m", "1") == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "3 beams at heading 0 deg." in told
    assert "other headings" not in told


def test_beams_with_noise_of_their_own_are_told_by_number(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """A direction alone does not tell which of two beams is meant, nor what the study is to be run with."""
    study = tmp_path / "own.toml"
    study.write_text(
        'map = "room:4x6"\n[sensor]\nbearings_deg = [0, 0, 270]\nstd_m = [0.2, 0.02, 0.05]\n'
        '[[estimators]]\nname = "ekf"\n'
    )
    assert call("plan", str(study), "--beams", "2", "--json") == 0
    beams = json.loads(capsys.readouterr().out)["beams"]
    assert [beam["beam_of_study"] for beam in beams] == [2, 3]
    assert call("plan", str(study), "--beams", "2") == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "0.00 (beam 2)" in text
    assert "run the study with beam_sets = [[2, 3]]." in text
    assert call("plan", str(study), "--beams", "1", "--candidates-deg", "0,-90") == 2
    assert "2 beams of this sensor look along 0 deg" in capsys.readouterr().err


def test_a_map_of_accuracy_says_that_one_heading_stands_for_all(capsys: pytest.CaptureFixture[str]) -> None:
    """Where the study does not know the heading: places that look alike at two headings are not counted."""
    assert call("map-accuracy", "two_modes", "--step-m", "1") == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "The study does not know the heading, and other headings are not looked at" in told
    for study, known in (("two_modes", False), ("paper", True)):
        assert call("map-accuracy", study, "--step-m", "1", "--json") == 0
        document = json.loads(capsys.readouterr().out)
        assert (document["heading_deg"], document["heading_is_known"]) == (0.0, known)


@pytest.mark.parametrize("width", [60, 80])
def test_narrow_screens(
    width: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """No line is wider than the screen."""
    monkeypatch.setenv("COLUMNS", str(width))
    assert call("plan", "paper", "--beams", "1", *FEW) == 0
    assert call("map-accuracy", "paper", "--step-m", "0.5") == 0
    assert max(map(len, capsys.readouterr().out.splitlines())) <= width


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--criterion", "traec"), "trace"),
        (("--method", "best"), "exchange"),
        (("--candidates-deg", "north"), "--candidates-deg needs numbers"),
        (("--candidates-deg", "0:90:0"), "--candidates-deg 0:90:0: the step must not be 0"),
        (("--candidates-deg", "0,360"), "stands twice"),
        (("--candidates-deg", "180"), "blind sector"),
        (("--candidates-deg", "0,10", "--beams", "3"), "--beams 3: there are 2 directions"),
        (("--method", "exhaustive"), "choose by exchange"),
        (("--method", "exhaustive", "--adaptive"), "--method has no effect with --adaptive"),
    ],
)
def test_mistakes_are_one_line(
    arguments: tuple[str, ...], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 2, one line, in the words that were typed."""
    assert call("plan", "paper", *arguments) == 2
    told = capsys.readouterr().err
    assert words in told
    assert told.count("\n") == 1


@pytest.mark.parametrize(
    ("degrees", "words"),
    [
        ("foo", "--beams-deg needs numbers such as -90,0,90 or -90:90:15, got 'foo'"),
        ("beams", "--beams-deg needs numbers such as -90,0,90 or -90:90:15, got 'beams'"),
        ("0:90:0", "--beams-deg 0:90:0: the step must not be 0"),
        ("0,360", "--beams-deg 0,360: a direction stands twice"),
        ("nan", "--beams-deg nan: name 1 to 100000 finite directions"),
    ],
)
def test_mistaken_beams_of_a_map_of_accuracy(
    degrees: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """They are told by the option that was typed."""
    assert call("map-accuracy", "paper", "--beams-deg", degrees) == 2
    assert capsys.readouterr().err == f"rangefix: {words}\n"


def test_a_map_of_accuracy(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """Amid the room two squarely met walls leave the noise, r and r; the worst direction is told."""
    assert call("map-accuracy", "paper", "--step-m", "0.5", "--beams-deg", "0,90,10", "--json") == 0
    assert call(
        "map-accuracy", "paper", "--step-m", "0.5", "--beams-deg", "0,90", "--out", str(tmp_path)
    ) == 0  # fmt: skip
    capsys.readouterr()
    with np.load(tmp_path / "accuracy.npz") as grid:
        assert grid["schema"] == 1
        assert grid["position_std_m"].shape == (12, 8)
        assert grid["position_std_m"][6, 4] == pytest.approx(0.05 * np.sqrt(2), rel=2e-3)
        assert grid["beams_seen"][6, 4] == 2
    assert (tmp_path / "accuracy.png").stat().st_size > 10_000
    assert call("map-accuracy", "paper", "--step-m", "0.5", "--beams-deg", "0", "--out", str(tmp_path)) == 0
    with np.load(tmp_path / "accuracy.npz") as grid:
        assert np.sin(grid["worst_direction_rad"][6, 4]) ** 2 == pytest.approx(1.0)  # along x1
        assert grid["worst_std_m"][6, 4] == pytest.approx(4 / np.sqrt(12), rel=1e-3)


def test_a_folder_may_have_the_name_of_a_picture(tmp_path: Path) -> None:
    """If it is there: nothing is made that looks like a file."""
    folder = tmp_path / "plan.png"
    folder.mkdir()
    assert call("plan", "paper", "--beams", "1", *FEW, "--out", str(folder)) == 0
    assert sorted(path.name for path in folder.iterdir()) == ["plan.png", "plan.svg"]
    assert call("map-accuracy", "paper", "--step-m", "1", "--out", str(folder)) == 0
    assert (folder / "accuracy.npz").exists()


@pytest.mark.parametrize("step", ["0", "nan", "-1", "1e-6"])
def test_steps_that_cannot_be(step: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 2 and one line."""
    assert call("map-accuracy", "paper", "--step-m", step) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_cells_of_two_lines_are_one_on_a_narrow_screen() -> None:
    """Such as the share and the first of the scans at which a filter is lost."""
    table = new_table("Replay", ["estimator", "lost"])
    table.add_row("ekf", "89 %,\nfrom 1")
    assert [text for text, _ in as_lines(table)] == ["Replay", "ekf", "      lost: 89 %, from 1"]
