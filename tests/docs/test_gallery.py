"""The gallery shows every published study, by figures that there are; its script makes a section."""

from __future__ import annotations

import re
import runpy
import tomllib
from pathlib import Path
from typing import Any

import pytest

from rangefix.evaluation import load_study, study_names

DOCS = Path(__file__).parents[2] / "docs"
if not DOCS.is_dir():  # a source distribution has it, an installed package has not
    pytest.skip("the pages are not there", allow_module_level=True)
SECTIONS = tomllib.loads((DOCS / "gallery.toml").read_text(encoding="utf-8"))["sections"]
NEEDS_A_MESH = {"mesh"}  # of the reader; docs/demo/building.toml stands for it


def test_every_published_study_is_shown() -> None:
    shown = {section["study"] for section in SECTIONS}
    assert shown >= set(study_names()) - NEEDS_A_MESH
    for name in shown - set(study_names()):
        assert (DOCS.parent / name).is_file()


def test_the_table_of_the_paper_has_every_estimator() -> None:
    """Those of the study, in its order and by its labels; the picture on the first page says as many."""
    labels = list(load_study("paper").experiment().estimators)
    table = (DOCS / "paper.md").read_text(encoding="utf-8").partition("| estimator |")[2].partition("\n\n")[0]
    assert [line.split("|")[1].strip() for line in table.splitlines()[2:]] == labels
    assert len(labels) == 7
    for page in (DOCS / "index.md", DOCS.parent / "README.md"):
        assert "standard deviations of seven estimators" in page.read_text(encoding="utf-8")


@pytest.mark.parametrize("section", SECTIONS, ids=lambda section: section["study"])
def test_its_figures_are_told_of(section: dict[str, Any]) -> None:
    """Each picture is a figure that docs/figures.md names."""
    known = re.findall(r"^\| ([\w, ]+) \|", (DOCS / "figures.md").read_text(encoding="utf-8"), re.MULTILINE)
    names = {name for each in known for name in each.split(", ")}
    assert section["pictures"]
    assert set(section["pictures"]) <= names
    assert all(caption.endswith(".") for caption in section["pictures"].values())


def test_a_section_is_made(tmp_path: Path) -> None:
    """A study of two runs becomes a heading, its commands, and a picture that is there."""
    (section,) = [each for each in SECTIONS if each["study"] == "heavy_tails"]
    lines = runpy.run_path(str(DOCS / "make_gallery.py"))["a_study"](section, tmp_path, 2)
    assert lines[0] == f"## {section['title']}"
    assert "$ rangefix run heavy_tails --runs 2 --out results/heavy_tails" in lines
    pictures = re.findall(r"\]\((.*)\)", "\n".join(lines))
    assert pictures == ["heavy_tails_anees.png"]
    assert (tmp_path / pictures[0]).read_bytes().startswith(b"\x89PNG")
