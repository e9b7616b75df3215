"""Wheel and sdist hold all that the package needs; the code in the documents runs."""

from __future__ import annotations

import re
import subprocess
import sys
import tarfile
from email import message_from_bytes
from email.message import Message
from pathlib import Path
from textwrap import dedent
from typing import Any
from zipfile import ZipFile

import numpy as np
import pytest

import rangefix
from rangefix.evaluation.paper.table1 import example
from rangefix.filters import build

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "rangefix"
NEEDED = {
    path.relative_to(ROOT / "src").as_posix()
    for path in SOURCE.rglob("*")
    if path.is_file() and "__pycache__" not in path.parts
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
    assert {
        "rangefix/py.typed",
        "rangefix/evaluation/report/page.html.j2",
        "rangefix/evaluation/report/style.css",
        "rangefix/evaluation/study/examples/paper.toml",
        "rangefix/maps/mesh.py",
    } <= NEEDED


def test_the_readme_code_runs() -> None:
    """The first lines of user code work as printed, and give the paper's noise-free values for 1+2+3."""
    code = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    assert len(code) == 1
    names: dict[str, Any] = {}
    exec(code[0], names)
    assert names["mean"].shape == (1, 2)
    assert names["covariance"].shape == (1, 2, 2)
    assert names["log_evidence"].shape == (1,)
    stds = np.sqrt(np.diagonal(names["covariance"][0]))
    np.testing.assert_allclose(stds, [0.0268, 0.0382], rtol=5e-3)


def test_the_contributed_estimator_runs(tmp_path: Path) -> None:
    """The estimator of CONTRIBUTING.md works from its file, and says what the prior says."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    (tmp_path / "dead_reckoning.py").write_text(dedent(code), encoding="utf-8")
    problem = example()
    estimator = build(f"{tmp_path}/dead_reckoning.py:DeadReckoning", problem)
    rngs = [np.random.default_rng(0)] * 3
    belief = estimator.predict(estimator.init(problem.prior, rngs), np.zeros(0), rngs)
    mean, covariance, _ = estimator.estimate(estimator.update(belief, np.ones((3, 3)), rngs))
    np.testing.assert_allclose(mean, [[2.0, 3.0]] * 3)
    np.testing.assert_allclose(covariance[0], problem.prior.covariance)


def metadata(built: Path) -> Message:
    """What the index will know of the package."""
    (wheel,) = built.glob("*.whl")
    archive = ZipFile(wheel)
    (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
    return message_from_bytes(archive.read(name))


def test_the_page_of_the_index_leads_somewhere(built: Path) -> None:
    """Every link and picture of the README is absolute there, and is a file of this repository."""
    text = metadata(built).get_payload()
    targets = re.findall(r"\]\(([^)]+)\)", text)
    assert len(targets) > 20
    for target in targets:
        address = re.fullmatch(
            r"https://(?:raw\.githubusercontent|github)\.com/rangefix/rangefix/(.*)", target
        )
        assert address, target
        assert (ROOT / address[1].removeprefix("blob/").removeprefix("main/")).is_file(), target


def test_one_version_everywhere(built: Path) -> None:
    """It stands in the package; metadata, citation and changelog follow."""
    about = metadata(built)
    assert about["Version"] == rangefix.__version__
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {rangefix.__version__}\n" in citation
    assert f"\n## {rangefix.__version__} " in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    kinds = about.get_all("Classifier", [])
    assert any(kind.startswith("Development Status ::") for kind in kinds)
    here = f"Programming Language :: Python :: {sys.version_info.major}.{sys.version_info.minor}"
    assert here in kinds


@pytest.mark.parametrize("name", ["README.md", "CONTRIBUTING.md", "docs/conventions.md", "docs/figures.md"])
def test_links_lead_somewhere(name: str) -> None:
    """Every relative link and picture of the documents exists."""
    page = ROOT / name
    for target in re.findall(r"\]\(([^)#]+)\)", page.read_text(encoding="utf-8")):
        assert "://" in target or (page.parent / target).exists(), target
