"""Every code block of README and docs runs as printed, or says why it does not."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from rangefix.filters.checks import check_names

from .blocks import DIRECTIVES, SCRIPT, Page, blocks

ROOT = Path(__file__).parents[2]
if not (ROOT / "docs").is_dir():  # a source distribution has them, an installed package has not
    pytest.skip("the pages are not there", allow_module_level=True)
PAGES = [
    path.relative_to(ROOT).as_posix()
    for path in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
    if not {"_build", "gallery"} & set(path.parts)
]


def read(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


TUTORIALS = ("docs/your_filter.md", "docs/plugins.md")  # that have tests of their own
WITH_CODE = [name for name in PAGES if blocks(read(name))]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty folder to read a page in, with the files of a checkout that pages speak of."""
    shutil.copytree(ROOT / "docs" / "demo", tmp_path / "docs" / "demo")
    (tmp_path / "examples").mkdir()
    shutil.copy(ROOT / "examples" / "dead_reckoning.py", tmp_path / "examples")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path.copy())
    yield tmp_path
    for name in (SCRIPT, "my_filter"):
        sys.modules.pop(name, None)


def run(name: str) -> None:
    """All blocks of a page, in order; each is run or has its reason."""
    page = Page(name, read(name))
    page.run()
    assert len(page.ran) + len(page.skipped) == len(blocks(page.text))
    assert all(len(reason.split()) > 2 for reason in page.skipped)


@pytest.mark.parametrize("name", [name for name in WITH_CODE if name not in TUTORIALS])
def test_page_runs(name: str, folder: Path) -> None:
    run(name)


@pytest.mark.parametrize("name", PAGES)
def test_no_block_is_missed(name: str) -> None:
    """As many blocks as there are pairs of fences, counted in another way; none is indented."""
    fences = re.findall(r"^\s*```(.*)$", read(name), re.MULTILINE)
    directives = sum(fence.startswith(DIRECTIVES) for fence in fences)
    assert len(fences) % 2 == 0
    assert len(blocks(read(name))) == len(fences) // 2 - directives
    assert "~~~" not in read(name)


def test_pages_with_code_are_known() -> None:
    """There are pages with code, most blocks run, and few are left out."""
    assert {"README.md", "docs/first_run.md", "docs/your_filter.md", "docs/your_map.md"} <= set(WITH_CODE)
    found = [block for name in WITH_CODE for block in blocks(read(name))]
    assert len(found) >= 50
    assert sum(bool(block.reason) for block in found) <= 8


def test_three_commands_make_a_report(folder: Path) -> None:
    """A filter in one file, three commands, and a page that compares it with the point-mass filter."""
    name = "docs/your_filter.md"
    section, _, _ = read(name).partition("\n## Does it do")
    commands = [line for block in blocks(section) for line in block.text.splitlines() if line[:2] == "$ "]
    assert [line.split()[2] for line in commands] == ["new", "run", "report"]
    run(name)
    report = (folder / "results" / "mine" / "report.html").read_text(encoding="utf-8")
    for told in ("mine", "point-mass", "DO NOT TRUST"):
        assert told in report


def test_estimators_of_your_own(folder: Path) -> None:
    """The page on plug-ins: its test file is one for pytest, and its table names every check."""
    name = "docs/plugins.md"
    run(name)
    assert all(f"| `{check}` |" in read(name) for check in check_names())
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:dash", "-p", "no:cacheprovider", "."]
    told = subprocess.run([*command, "-k", "built or shapes"], capture_output=True, text=True, cwd=folder)
    assert f"2 passed, {len(check_names()) - 2} deselected" in told.stdout


BAD = {
    "code that fails": "```python\nassert 1 == 2\n```\n",
    "a name from another page": "```python\nroom.ranges\n```\n",
    "output that is not printed": "```console\n$ rangefix --version\nrangefix 0.0.0\n```\n",
    "a command that fails": "```console\n$ rangefix run nothing.toml\n```\n",
    "an unknown command": "```console\n$ make\n```\n",
    "no reason": "```text\nhm\n```\n",
    "indented code": "Text\n\n    x = 1\n",
    "a study with a mistake": "<!-- part of a study -->\n```toml\nruns = -1\n```\n",
    "a part that is not marked": "```toml\nruns = 5\n```\n",
    "a mark further up": "<!-- not run: no -->\n\nText\n\n```text\nhm\n```\n",
}


@pytest.mark.parametrize("text", BAD.values(), ids=BAD)
def test_a_bad_page_is_seen(text: str, folder: Path) -> None:
    """Negative control: none of these passes."""
    with pytest.raises((AssertionError, NameError, ValueError)):
        Page("bad.md", text).run()
