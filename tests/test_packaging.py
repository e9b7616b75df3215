"""Wheel and sdist hold all that the package needs."""

from __future__ import annotations

import subprocess
import sys
import tarfile
from pathlib import Path
from zipfile import ZipFile

import pytest

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "rangefix"
NEEDED = {
    path.relative_to(ROOT / "src").as_posix()
    for path in SOURCE.rglob("*")
    if path.suffix in (".py", ".toml", ".typed") and "__pycache__" not in path.parts
}


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with wheel and sdist, built without network."""
    folder = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "hatchling", "build", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    return folder


def test_the_wheel_holds_every_module_and_study(built: Path) -> None:
    """No module, study or type marker of the source is missing, and nothing else lies beside the package."""
    (wheel,) = built.glob("*.whl")
    names = set(ZipFile(wheel).namelist())
    assert names >= NEEDED
    assert {name.split("/")[0] for name in names} == {"rangefix", wheel.name.split("-py3")[0] + ".dist-info"}
    assert any(name.endswith("entry_points.txt") for name in names)
    assert any(name.endswith("licenses/LICENSE") for name in names)


def test_the_sdist_holds_what_make_test_needs(built: Path) -> None:
    """Source, tests, docs and the files at the root, and no build products."""
    (sdist,) = built.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert names >= {f"src/{name}" for name in NEEDED}
    assert names >= {"README.md", "LICENSE", "CHANGELOG.md", "CONTRIBUTING.md", "Makefile", "pyproject.toml"}
    assert "tests/test_packaging.py" in names
    assert not any(".venv" in name or "__pycache__" in name for name in names)


def test_needed_is_not_empty() -> None:
    """Negative control: the list that wheel and sdist are held against names real files."""
    assert {"rangefix/py.typed", "rangefix/evaluation/studies/paper.toml", "rangefix/maps/mesh.py"} <= NEEDED
