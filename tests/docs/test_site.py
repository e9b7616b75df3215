"""The site builds without a warning, has every page and public name, and loads nothing from elsewhere."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

from rangefix.filters.registry import BUILT_IN

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
if not DOCS.is_dir():  # a source distribution has it, an installed package has not
    pytest.skip("the pages are not there", allow_module_level=True)
pytest.importorskip("furo", reason="needs the extra docs")
pytest.importorskip("myst_parser", reason="needs the extra docs")
inventory = pytest.importorskip("sphinx.util.inventory", reason="needs the extra docs")

PUBLIC = ("rangefix.maps", "rangefix.filters", "rangefix.filters.checks", "rangefix.evaluation")
STRICT = ("--fail-on-warning", "--keep-going", "--nitpicky", "-q")


def build(source: Path, out: Path, *options: str) -> subprocess.CompletedProcess[str]:
    """Build pages with the project's settings."""
    command = [sys.executable, "-m", "sphinx", *STRICT, "-d", f"{out}.doctrees", *options, source, out]
    return subprocess.run([str(each) for each in command], capture_output=True, text=True, cwd=ROOT)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site as `make docs` builds it; the gallery is in it only if that has made one."""
    out = tmp_path_factory.mktemp("site") / "html"
    done = build(DOCS, out)
    assert done.returncode == 0, done.stderr
    assert not done.stderr.strip()
    return out


def test_every_page_is_there(site: Path) -> None:
    """Each source is a page, and each is reached from the contents on the front page."""
    pages = [path for path in DOCS.rglob("*.md") if "_build" not in path.parts]
    pages += DOCS.rglob("api/*.rst")
    front = (site / "index.html").read_text(encoding="utf-8")
    assert len(pages) > 25
    for page in pages:
        name = page.relative_to(DOCS).with_suffix(".html").as_posix()
        assert (site / name).is_file()
        assert f'href="{name}"' in front or name == "index.html"


def test_every_public_name_is_there(site: Path) -> None:
    """All that the packages export, and all built-in estimators, have an entry in the reference."""
    data = inventory.InventoryFile.loads((site / "objects.inv").read_bytes(), uri="").data
    known = {name for kind, names in data.items() if kind.startswith("py:") for name in names}
    for package in PUBLIC:
        names = importlib.import_module(package).__all__
        assert {f"{package}.{name}" for name in names} <= known
    assert {target.replace(":", ".") for target in BUILT_IN.values()} <= known
    headings = re.findall(r"^(\S+)\n-+$", (DOCS / "api" / "estimators.rst").read_text(), re.MULTILINE)
    assert set(BUILT_IN) <= set(headings)


def test_nothing_is_loaded_from_elsewhere(site: Path) -> None:
    """No script, style, font or picture has an address on the network."""
    loaded = re.compile(
        r"""<(?:script|img|link|iframe)[^>]+(?:src|href)=["'](?:https?:)?//[^"']*|url\(https?:"""
    )
    for page in site.rglob("*.html"):
        assert not loaded.findall(page.read_text(encoding="utf-8")), page
    for style in site.rglob("*.css"):
        assert "url(http" not in style.read_text(encoding="utf-8"), style


def test_equations_are_drawn(site: Path) -> None:
    """Formulas are MathML elements, not the text that they were written in."""
    theory = (site / "theory.html").read_text(encoding="utf-8")
    assert theory.count("<mfrac>") > 10
    assert "\\frac" not in theory


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[there](nowhere.md)", "nowhere"),
        ("$\\undefined{x}$", "cannot draw the formula"),
        ("{py:class}`rangefix.filters.Nothing`", "reference target not found"),
    ],
)
def test_a_mistake_fails_the_build(tmp_path: Path, text: str, told: str) -> None:
    """Negative control: a dead link, a formula and a name that are not there."""
    source = tmp_path / "source"
    (source / "_static").mkdir(parents=True)
    (source / "_static" / "site.css").touch()
    (source / "index.md").write_text(f"# Page\n\n{text}\n", encoding="utf-8")
    done = build(source, tmp_path / "html", "-c", str(DOCS))
    assert done.returncode != 0
    assert told in done.stderr
