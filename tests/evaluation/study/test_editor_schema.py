"""Editors check studies by a schema: it lets through what is sound, and marks plain mistakes."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Any

import jsonschema
import pytest

import rangefix.evaluation.study as study_room
from rangefix.cli.main import main
from rangefix.evaluation.study.editor_schema import FILE, as_text

ROOM = Path(study_room.__file__).parent
STUDIES = [ROOM / "starter.toml", *sorted((ROOM / "examples").glob("*.toml"))]
SCHEMA: dict[str, Any] = json.loads(FILE.read_text(encoding="utf-8"))


def mistakes(text: str) -> list[str]:
    validator = jsonschema.Draft202012Validator(SCHEMA)
    return [error.message for error in validator.iter_errors(tomllib.loads(text))]


def test_the_file_is_as_the_sections_are() -> None:
    """If not: python -m rangefix.evaluation.study.editor_schema."""
    assert FILE.read_text(encoding="utf-8") == as_text()
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    assert not re.search('"(le|lt|ge|gt)":', as_text())  # what pydantic could not say: editors pass over it


@pytest.mark.parametrize("study", STUDIES, ids=lambda path: path.stem)
def test_studies_that_come_along_fit(study: Path) -> None:
    assert mistakes(study.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    ("wrong", "right"),
    [("width_m = 4.0", "width = 4.0"), ("std_m = 0.05", "std_m = true"), ("runs = 500", "runs = 0")],
)
def test_plain_mistakes_are_marked(wrong: str, right: str) -> None:
    text = (ROOM / "starter.toml").read_text(encoding="utf-8")
    assert wrong in text
    assert mistakes(text.replace(wrong, right, 1))


def test_what_is_assumed_may_be_told_in_part() -> None:
    text = (ROOM / "starter.toml").read_text(encoding="utf-8")
    assert mistakes(text + "\n[assumed.sensor]\nstd_m = 0.1\n") == []
    assert mistakes(text + "\n[assumed.sensor]\nstd = 0.1\n")


def test_a_new_study_names_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Editors that know TOML read the first line."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit):
        main(["new", "mine.toml"])
    first, _, rest = (tmp_path / "mine.toml").read_text(encoding="utf-8").partition("\n")
    assert first == f"#:schema {FILE.as_uri()}"
    assert mistakes(rest) == []
