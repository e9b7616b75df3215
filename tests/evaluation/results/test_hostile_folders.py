"""Folders of results that others made, or that bits and hands have changed: one line, or made again."""

from __future__ import annotations

import io
import json
import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rangefix.evaluation import Experiment, NamedEstimator, ResultsError, load, run, write_report
from rangefix.evaluation.drawing import draw
from rangefix.evaluation.results import FILE, load_pictures, read_part, write_npz, write_part
from rangefix.evaluation.results import files as result_files

from ..conftest import make_problem

Change = Callable[[Any], object]


def experiment(**changes: Any) -> Experiment:
    """Two Gaussian filters on two sets of beams."""
    estimators = {"ekf": NamedEstimator("ekf"), "ukf": NamedEstimator("ukf")}
    usual: dict[str, Any] = {"estimators": estimators, "runs": 12, "beam_sets": [[1], [1, 2, 3]], "block": 4}
    return Experiment(make_problem(0.3), **(usual | changes))


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sound results."""
    folder = tmp_path_factory.mktemp("whole") / "out"
    run(experiment(), folder)
    return folder


@pytest.fixture
def folder(whole: Path, tmp_path: Path) -> Path:
    """A copy to be spoilt."""
    return Path(shutil.copytree(whole, tmp_path / "out"))


def refused(folder: Path, words: str) -> str:
    """What load says of a folder, on one line."""
    with pytest.raises(ResultsError, match=words) as caught:
        load(folder)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def parts(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("parts/**/*.npz")}


TRIALS = "parts/ekf/1+2+3"
BLOCKS = ("00000000-00000004.npz", "00000004-00000008.npz")


@pytest.mark.parametrize(
    "pair",
    [
        (f"{TRIALS}/{BLOCKS[0]}", f"{TRIALS}/{BLOCKS[1]}"),
        (f"{TRIALS}/{BLOCKS[0]}", f"parts/ukf/1+2+3/{BLOCKS[0]}"),
        (f"{TRIALS}/{BLOCKS[0]}", f"parts/ekf/1/{BLOCKS[0]}"),
        (f"parts/world/{BLOCKS[0]}", f"parts/world/{BLOCKS[1]}"),
    ],
)
def test_a_part_knows_what_it_holds(folder: Path, whole: Path, pair: tuple[str, str]) -> None:
    """A part in the place of another is refused, and made again by the next run."""
    one, other = (folder / name for name in pair)
    content = one.read_bytes()
    one.write_bytes(other.read_bytes())
    other.write_bytes(content)
    refused(folder, r"belong elsewhere|made by another")
    run(experiment(), folder)
    assert parts(folder) == parts(whole)


@pytest.mark.parametrize("name", [f"{TRIALS}/{BLOCKS[0]}", f"parts/world/{BLOCKS[1]}"])
def test_every_changed_byte_is_refused(folder: Path, name: str) -> None:
    """One bit of every 7th byte, and each of the last hundred, where the archive's directory ends."""
    path = folder / name
    content = path.read_bytes()
    places = [*range(0, len(content), 7), *range(len(content) - 100, len(content))]
    for place in places:
        spoilt = bytearray(content)
        spoilt[place] ^= 1 << place % 8
        path.write_bytes(spoilt)
        with pytest.raises(ResultsError):
            read_part(path)


def resealed(path: Path, **changes: Any) -> None:
    """Write a part with some arrays changed and the seal of a sound one."""
    with np.load(path) as arrays:
        held = {name: arrays[name] for name in arrays.files if name != "sha256"}
    key = str(held.pop("key"))
    write_part(path, held | changes, key)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"mean": np.zeros((3, 1, 2))}, "mean has shape"),
        ({"mean": np.zeros((4, 1, 2), dtype=np.float32)}, "mean has dtype"),
        ({"covariance": np.tile(-np.eye(2), (4, 1, 1, 1))}, "covariance"),
        ({"covariance": np.full((4, 1, 2, 2), np.nan)}, "covariance"),
        ({"mean": np.full((4, 1, 2), np.inf)}, "mean"),
        ({"mean": np.full((4, 1, 2), 1e101)}, "mean"),
        ({"log_evidence": np.full((4, 1), np.inf)}, "log_evidence"),
        ({"log_evidence": np.full((4, 1), -1e300)}, r"log_evidence: beyond 1e\+100"),
        ({"status": np.full(4, 99, dtype=np.int8)}, "status"),
        ({"status": np.full(4, 4, dtype=np.int8)}, "failed"),
        ({"failed": np.array([10**9])}, "failed"),
        ({"more": np.zeros(3)}, "'more', which is none of ours"),
    ],
)
def test_parts_with_a_seal_that_cannot_be(folder: Path, whole: Path, changes: Any, words: str) -> None:
    resealed(folder / TRIALS / BLOCKS[0], **changes)
    assert BLOCKS[0] in refused(folder, words)
    run(experiment(), folder)
    assert parts(folder) == parts(whole)


@pytest.mark.parametrize(
    ("name", "value"), [("truth", np.inf), ("truth", np.nan), ("truth", 1e200), ("measurement", -1e300)]
)
def test_worlds_with_a_seal_that_cannot_be(folder: Path, whole: Path, name: str, value: float) -> None:
    """Readings may be inf or NaN, which say something; truths may not."""
    path = folder / "parts/world" / BLOCKS[1]
    with np.load(path) as arrays:
        changed = arrays[name].copy()
    changed[2] = value
    resealed(path, **{name: changed})
    assert BLOCKS[1] in refused(folder, name)
    run(experiment(), folder)
    assert parts(folder) == parts(whole)


def set_in(document: Any, key: str, value: Any) -> None:
    """Set a key such as plan.runs."""
    *around, last = key.split(".")
    for name in around:
        document = document[name]
    document[last] = value


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("format", "2"),
        ("format", 1),
        ("name", 3),
        ("title", ["x"]),
        ("runs", "12"),
        ("runs", 10**15),
        ("seed", -1),
        ("config", {}),
        ("state", "done"),
        ("space", []),
        ("space.names", "x1"),
        ("space.names", ["x1", "x1"]),
        ("space.heading", "north"),
        ("beam_sets", [1]),
        ("beam_sets", {"1": [0], "1+2+3": [1, 2, 3]}),
        ("beam_sets", {"1": [1], "1+2+3": [1, 2, 4]}),
        ("estimators", ["ekf", "ukf"]),
        ("estimators.ekf", 7),
        ("versions", [1, 2]),
        ("machine", 5),
        ("git", "x"),
        ("threads", "x"),
        ("command_line", "rangefix run"),
        ("plan", None),
        ("plan.estimators", "ekf"),
        ("plan.estimators", [1, 2]),
        ("plan.beams", {}),
        ("plan.runs", 10**15),
        ("plan.runs", True),
        ("plan.block", 0),
        ("plan.block", 1e3),
        ("plan.shape", [1, 2]),
        ("plan.shape", [10**9, 2, 3]),
        ("plan.shape", "abc"),
        ("plan.shape", [1, 3, 3]),
        ("plan.world", 7),
        ("plan.trials", {"ekf": "x"}),
        ("plan.more", 1),
    ],
)
def test_manifests_of_strangers(folder: Path, key: str, value: Any) -> None:
    """One line that names the file and the key."""
    path = folder / "manifest.json"
    document = json.loads(path.read_text())
    set_in(document, key, value)
    path.write_text(json.dumps(document))
    line = refused(folder, "manifest.json")
    assert key.split(".")[-1] in line or key.split(".")[0] in line


@pytest.mark.parametrize("runs", [10_000, 10**9])
def test_a_plan_far_beyond_what_is_there(folder: Path, runs: int) -> None:
    path = folder / "manifest.json"
    document = json.loads(path.read_text())
    document |= {"runs": runs, "plan": document["plan"] | {"runs": runs, "shape": [1000, 2, 3]}}
    path.write_text(json.dumps(document | {"state": "running"}))
    refused(folder, "manifest.json: plan: .* GB, but the folder has")


NOT_JSON = [
    b"",
    b"{",
    b"[" * 10_000 + b"]" * 10_000,
    b'{"a":' * 10_000,
    b"\xff\xfe",
    b"[1e999",
    b"7" * 10_000,
]


@pytest.mark.parametrize("name", ["manifest.json", "timing.json"])
@pytest.mark.parametrize("content", [*NOT_JSON, b"[]", b"3", b'{"a": {"estimator": 1}}', b"null"])
def test_documents_that_are_none(folder: Path, name: str, content: bytes) -> None:
    (folder / name).write_bytes(content)
    refused(folder, name)


def test_a_document_that_is_too_large(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(result_files, "MAX_JSON", 100)
    refused(folder, "manifest.json has .* bytes, more than the 100")


def archive(name: str, header: str, data: bytes = b"", packed: bool = False) -> bytes:
    """An archive with one array whose header says what it likes."""
    text = header.encode()
    array = b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + data
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED if packed else zipfile.ZIP_STORED) as made:
        made.writestr(f"{name}.npy", array)
    return content.getvalue()


HUGE = "{'descr': '<f8', 'fortran_order': False, 'shape': (962072674304, 4), }\n"
SMALL = "{'descr': '<f8', 'fortran_order': False, 'shape': (4000000,), }\n"


@pytest.mark.parametrize("name", ["scene.npz", f"{TRIALS}/{BLOCKS[0]}", f"parts/world/{BLOCKS[0]}"])
@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"PK\x05\x06" + bytes(18),
        archive("segments", HUGE),
        archive("segments", SMALL, bytes(32_000_000), packed=True),
        archive("segments", "{'descr': '|O', 'fortran_order': False, 'shape': (1,), }\n", b"cos\nsystem\n"),
        archive("segments", "(" * 5000 + "\n"),
    ],
    ids=["empty", "no files", "7 TiB", "bomb", "pickle", "deep header"],
)
def test_arrays_that_are_none(folder: Path, name: str, content: bytes) -> None:
    (folder / name).write_bytes(content)
    refused(folder, Path(name).name)


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("segments", np.zeros((3, 5))),
        ("free", np.zeros(4)),
        ("extent", np.full(4, np.nan)),
        ("extent", np.full(4, 1e300)),
        ("extent", np.zeros(4)),
        ("prior_upper", np.full(2, -1e3)),
        ("laser", np.array([1.0, 1e9, 0.0])),
        ("bearings", np.zeros(7)),
        ("ranges", np.array(["a", "b", "c"])),
    ],
)
def test_scenes_that_are_none(folder: Path, name: str, array: Any) -> None:
    with np.load(folder / "scene.npz") as arrays:
        held = {each: arrays[each] for each in arrays.files}
    write_npz(folder / "scene.npz", held | {name: array})
    assert name in refused(folder, "scene.npz")


PICTURE: dict[str, Any] = {
    "0_estimator": np.array("ekf"),
    "0_density": np.ones((2, 2)),
    "0_extent": np.array([0.0, 4.0, 0.0, 6.0]),
    "0_headings": np.zeros(0),
    "0_heading_density": np.zeros(0),
}


@pytest.mark.parametrize(
    "change",
    [
        {"0_density": np.ones(4)},
        {"0_density": np.full((2, 2), -1.0)},
        {"0_density": np.array([["a"]])},
        {"0_extent": np.zeros(3)},
        {"0_headings": np.zeros(7)},
        {"0_headings": np.zeros(3), "0_heading_density": np.array(["a", "b"])},
        {"0_headings": np.zeros(3), "0_heading_density": np.array([1.0, np.inf])},
        {"0_density": np.full((2, 2), 1e300)},
        {"1_estimator": np.array("ukf")},
    ],
)
def test_pictures_that_are_none(folder: Path, change: dict[str, Any]) -> None:
    write_part(folder / FILE, PICTURE, "key")
    assert [picture.estimator for picture in load_pictures(folder)] == ["ekf"]
    write_part(folder / FILE, PICTURE | change, "key")
    refused(folder, "no pictures of beliefs")


@pytest.mark.parametrize("name", ["manifest.json", "timing.json", "scene.npz", f"{TRIALS}/{BLOCKS[0]}"])
@pytest.mark.parametrize("kind", ["fifo", "device", "folder"])
def test_what_is_no_file(folder: Path, name: str, kind: str) -> None:
    """A pipe would wait for ever, a device never end."""
    path = folder / name
    path.unlink()
    if kind == "fifo":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    else:
        path.mkdir()
    refused(folder, "is not a regular file")


def test_a_hostile_folder_takes_little_time_and_memory(folder: Path) -> None:
    """The command ends with 2, one line, and no more memory than reading sound results takes."""
    (folder / "scene.npz").write_bytes(archive("segments", HUGE))
    script = (
        "import sys\n"
        "from rangefix.cli.main import main\n"
        "try:\n    main(sys.argv[1:])\n"
        "finally:\n    print(open('/proc/self/status').read().partition('VmHWM:')[2].split()[0])\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, "report", str(folder)], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert int(done.stdout) < 300_000  # kB


def test_figures_are_all_or_none(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A disk that is full at the third figure leaves none; what is not ours stays."""
    draw(folder)
    mine = folder / "figures" / "mine.png"
    mine.write_bytes(b"x")
    write, count = result_files.write_bytes, 0

    def full(path: Path, content: bytes) -> None:
        nonlocal count
        count += 1
        if count == 3:
            raise ResultsError("cannot write: disk full")
        write(path, content)

    monkeypatch.setattr("rangefix.evaluation.drawing.write_bytes", full)
    with pytest.raises(ResultsError, match="disk full"):
        draw(folder)
    assert [file.name for file in (folder / "figures").iterdir()] == ["mine.png"]
    (folder / TRIALS / BLOCKS[0]).write_bytes(b"")
    with pytest.raises(ResultsError):
        write_report(folder)
    assert not (folder / "report.html").exists()
