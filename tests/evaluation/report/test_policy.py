"""What a page may do: run one script, the same on every page, and nothing else; it loads nothing."""

from __future__ import annotations

import base64
import hashlib
from pathlib import Path

import pytest

from rangefix.evaluation import write_comparison
from rangefix.evaluation.report.page import SCRIPT, SCRIPT_HASH, environment

from .conftest import LABEL, read

FORBIDDEN = (
    "innerHTML", "outerHTML", "insertAdjacent", "document.write", "eval", "Function(", "setTimeout", "fetch",
    "XMLHttp", "import", "WebSocket", "sendBeacon", "location", "cookie", "Storage", "http", ".src", ".href",
    'setAttribute("on',
)  # fmt: skip


@pytest.fixture(scope="module")
def pages(page: str, three: list[Path], tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """A page on one folder and one on three, both full of hostile text."""
    out = tmp_path_factory.mktemp("pages") / "three.html"
    return [page, write_comparison(three, out).read_text(encoding="utf-8")]


def policy_of(page: str) -> dict[str, list[str]]:
    """The directives of the one policy of a page."""
    found = [
        each for name, each in read(page).elements
        if name == "meta" and each.get("http-equiv") == "Content-Security-Policy"
    ]  # fmt: skip
    assert len(found) == 1
    parts = [part.split() for part in (found[0]["content"] or "").split(";")]
    return {name: values for name, *values in parts}


def scripts_of(page: str) -> list[str]:
    """The texts of the scripts of a page; each begins with no attribute, so none comes from elsewhere."""
    assert all(not each for name, each in read(page).elements if name == "script")
    return [part.partition("</script>")[0] for part in page.split("<script>")[1:]]


def test_nothing_is_allowed_but_the_script_our_looks_and_embedded_images(pages: list[str]) -> None:
    """The whole policy, directive by directive; it stands before anything that it could forbid."""
    for page in pages:
        assert policy_of(page) == {
            "default-src": ["'none'"],
            "script-src": [f"'{SCRIPT_HASH}'"],
            "style-src": ["'unsafe-inline'"],
            "img-src": ["data:"],
            "base-uri": ["'none'"],
            "form-action": ["'none'"],
        }
        head = page.partition("Content-Security-Policy")[0]
        assert not {"<style", "<link", "<script", "<body"} & set(head.replace(">", " ").split())


def test_the_hash_is_that_of_the_script(pages: list[str]) -> None:
    """A browser runs what has this SHA-256 and nothing else."""
    for page in pages:
        (script,) = scripts_of(page)
        digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        assert f"sha256-{digest}" == SCRIPT_HASH


def test_the_script_is_the_same_on_every_page(pages: list[str]) -> None:
    """Nothing that a user wrote enters it: it is the file, whatever the results hold."""
    for page in pages:
        assert scripts_of(page) == [SCRIPT]
        assert LABEL not in SCRIPT
    assert "{{" not in SCRIPT
    assert "</" not in SCRIPT
    assert "<!--" not in SCRIPT


def test_the_script_makes_no_markup_no_code_and_no_request() -> None:
    """What it shows it sets as text."""
    for word in FORBIDDEN:
        assert word not in SCRIPT


def test_no_element_runs_anything_else(pages: list[str]) -> None:
    """No handler, no address that is code, no element that loads; the labels of users are text."""
    for page in pages:
        reader = read(page)
        assert not {name for name, _ in reader.elements} & {"iframe", "object", "embed", "form", "base"}
        for _, attributes in reader.elements:
            assert not [key for key in attributes if key.startswith("on")]
            for key in ("src", "href"):
                assert (attributes.get(key) or "#").startswith(("data:", "#"))
        assert LABEL in "".join(reader.data)


def test_what_the_script_makes_is_not_needed(pages: list[str]) -> None:
    """Without it there is no control that does nothing: buttons, choices and hints are made by it alone."""
    for page in pages:
        names = {name for name, _ in read(page).elements}
        assert not names & {"button", "select", "input", "noscript"}
        assert "Point at" not in page.partition("<script>")[0]


def test_a_changed_script_would_be_seen() -> None:
    """Negative control: one letter more gives another hash."""
    changed = environment().from_string("<script>{{ SCRIPT }} </script>").render()
    (script,) = scripts_of(changed)
    assert f"sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}" != SCRIPT_HASH
