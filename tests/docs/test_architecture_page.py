"""The page of the architecture names every folder and module, with a line about each, and nothing else."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "architecture.md"
SOURCE = ROOT / "src" / "rangefix"
if not PAGE.is_file():  # a source distribution has it, an installed package has not
    pytest.skip("the pages are not there", allow_module_level=True)
LINE = re.compile(r"^(?P<pad> *)(?P<name>[\w.]+/?) +(?P<words>\S.*)$")


def described(text: str) -> dict[str, str]:
    """Path -> words, from the tree on the page."""
    tree = text.partition("## The tree")[2].partition("```text\n")[2].partition("```")[0]
    folders: list[str] = []
    lines = {}
    for line in filter(None, tree.splitlines()):
        parts = LINE.match(line)
        assert parts, f"not a line of the tree: {line!r}"
        del folders[len(parts["pad"]) // 2 :]
        lines["/".join([*folders, parts["name"].rstrip("/")])] = parts["words"]
        if parts["name"].endswith("/"):
            folders.append(parts["name"].rstrip("/"))
    return lines


def test_the_tree_is_that_of_the_source() -> None:
    """Every module and every folder with a face stands in the tree, and nothing that is not there."""
    paths = [path.relative_to(SOURCE) for path in SOURCE.rglob("*.py")]
    modules = {path.as_posix() for path in paths if path.name != "__init__.py"}
    folders = {path.parent.as_posix() for path in paths if path.name == "__init__.py"} - {"."}
    assert set(described(PAGE.read_text(encoding="utf-8"))) == modules | folders


def test_a_missing_module_would_be_seen() -> None:
    """Negative control: without one line of the tree the sets differ."""
    text = PAGE.read_text(encoding="utf-8")
    shorter = re.sub(r"^ *registry\.py .*\n", "", text, flags=re.M)
    assert set(described(text)) - set(described(shorter)) == {"filters/registry.py"}
