"""The page of the commands is what the commands themselves say."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
if not DOCS.is_dir():  # a source distribution has it, an installed package has not
    pytest.skip("the pages are not there", allow_module_level=True)


def test_the_page_is_up_to_date() -> None:
    """`python docs/make_commands.py` would write the same; every command has its heading."""
    made = runpy.run_path(str(DOCS / "make_commands.py"))
    page: str = made["page"]()
    assert (DOCS / "commands.md").read_text(encoding="utf-8") == page
    commands = [
        command.__name__.replace("_", "-") for commands in made["GROUPS"].values() for command in commands
    ]
    assert len(commands) >= 11
    assert all(f"\n### rangefix {name}\n" in page for name in commands)
