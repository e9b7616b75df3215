"""Input files that are changed at random: exit code 0, or 2 with a line for each mistake; no hang.

`make fuzz` changes thousands, `make test` some. What is found says its kind and number, which are the seed:
`change(kind, number, folder, whole)` makes the same file again.
"""

from __future__ import annotations

import os
import random
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from rangefix.evaluation import load_study, run
from rangefix.evaluation.results import FILE, read_npz, read_part, write_npz, write_part

from .command_line import BAD_INPUT, FINE, CommandLine, Outcome
from .corpus import BINARY_MESHES, MESHES, PLANS, SHOWN, STUDIES, TEXT_MESHES
from .mutations import change_arrays, change_bytes, change_text

FEW = {"studies": 60, "runs": 3, "plans": 40, "meshes": 4, "results": 6}  # about half a minute of CPU
MANY = {"studies": 1000, "runs": 300, "plans": 400, "meshes": 400, "results": 800}
SLICE = 100  # files to a test of `make fuzz`
BEAMS = ("--bearings-deg", "0", "90", "200")
DAMAGED_S, DAMAGED_MB = (
    2.0,
    100.0,
)  # more, for results that are refused, than it takes to load what reads them
Commands = list[tuple[str, ...]]


class Kind(NamedTuple):
    """A kind of input.

    Attributes:
        change: Makes a file or folder of that kind in a folder, from sound results and draws; its path.
        commands: The commands that read it.
    """

    change: Callable[[Path, Path, random.Random], Path]
    commands: Callable[[Path, Path, random.Random], Commands]


def change_study(whole: Path, folder: Path, draws: random.Random) -> Path:
    path = folder / draws.choice(sorted(STUDIES))
    (folder / "room.off").write_bytes(MESHES["room.off"])
    path.write_bytes(change_text(STUDIES[path.name], draws))
    return path


def change_plan(whole: Path, folder: Path, draws: random.Random) -> Path:
    path = folder / draws.choice(sorted(PLANS))
    path.write_bytes(change_text(PLANS[path.name], draws))
    return path


def change_mesh(whole: Path, folder: Path, draws: random.Random) -> Path:
    path = folder / draws.choice(sorted(MESHES))
    if path.name in TEXT_MESHES:
        path.write_bytes(change_text(TEXT_MESHES[path.name], draws))
    else:
        path.write_bytes(change_bytes(BINARY_MESHES[path.name], draws))
    return path


def change_results(whole: Path, folder: Path, draws: random.Random) -> Path:
    path = shutil.copytree(whole, folder / "out")
    arrays = sorted(path.rglob("*.npz"))
    documents = [path / "manifest.json", path / "timing.json"]
    every = [*documents, *arrays]
    what = draws.randrange(8)
    if what <= 2:
        file = draws.choice(documents)
        file.write_bytes(change_text(file.read_text(), draws))
    elif what <= 4:
        _change_sealed(draws.choice([*arrays, path / "scene.npz", path / FILE]), draws)  # these more often
    elif what == 5:
        file = draws.choice(every)
        file.write_bytes(change_bytes(file.read_bytes(), draws))
    elif what == 6:
        one, other = draws.sample(every, 2)
        one.write_bytes(other.read_bytes())
    else:
        _put_something_else(draws.choice(every), draws)
    return path


def _change_sealed(path: Path, draws: random.Random) -> None:
    """Other arrays under the right key and checksum, as somebody makes them who knows how."""
    if path.name == "scene.npz":
        write_npz(path, change_arrays(read_npz(path), draws))
        return
    key = str(read_npz(path)["key"])
    write_part(path, change_arrays(read_part(path), draws), key)


def _put_something_else(path: Path, draws: random.Random) -> None:
    path.unlink()
    what = draws.randrange(6)
    if what == 0:
        path.mkdir()
    elif what == 1:
        os.mkfifo(path)
    elif what == 2:
        path.symlink_to(draws.choice(("/dev/zero", "/nowhere", str(path), "/dev/stdin", "..")))
    elif what == 3:
        path.touch()
    elif what == 4:
        path.touch(mode=0o000)


def read_results(path: Path, whole: Path, draws: random.Random) -> Commands:
    commands: Commands = [("report", str(path)), ("plot", str(path)), ("compare", str(path), str(whole))]
    return [draws.choice(commands)]


KINDS = {
    "studies": Kind(change_study, lambda path, whole, draws: [("validate", str(path))]),
    "runs": Kind(
        change_study,
        lambda path, whole, draws: [("run", str(path), "--runs", "3", "--out", str(path.with_name("out")))],
    ),
    "plans": Kind(change_plan, lambda path, whole, draws: [("ranges", str(path), "--at", "2", "3", *BEAMS)]),
    "meshes": Kind(
        change_mesh,
        lambda path, whole, draws: [
            ("ranges", str(path), "--at", "2", "3", *BEAMS, "--sensor-height", "0.9")
        ],
    ),
    "results": Kind(change_results, read_results),
}


def change(kind: str, number: int, folder: Path, whole: Path) -> tuple[Path, Commands]:
    """Make the changed input of that number in a folder; its path, and the commands that read it."""
    draws = random.Random(f"{kind} {number}")
    path = KINDS[kind].change(whole, folder, draws)
    return path, KINDS[kind].commands(path, whole, draws)


def fault(kind: str, outcome: Outcome) -> str:
    """What should not have come of a command."""
    if found := outcome.fault():
        return found
    small = outcome.seconds <= DAMAGED_S and outcome.grown_mb <= DAMAGED_MB
    if kind != "results" or outcome.code != BAD_INPUT or small:
        return ""
    return f"damaged results took {outcome.seconds:.1f} s, {outcome.grown_mb:.0f} MB more"


def attack(kind: str, numbers: range, folder: Path, whole: Path, command_line: CommandLine) -> None:
    """Change files and run commands on them; all that is wrong is told in the end, and its files are kept."""
    found, codes, seconds, peak = [], {FINE: 0, BAD_INPUT: 0}, 0.0, 0.0
    for number in numbers:
        place = folder / f"{kind}-{number}"
        place.mkdir()
        _, commands = change(kind, number, place, whole)
        faults = []
        for command in commands:
            outcome = command_line(*command)
            codes[outcome.code] = codes.get(outcome.code, 0) + 1
            seconds, peak = max(seconds, outcome.seconds), max(peak, outcome.peak_mb)
            if words := fault(kind, outcome):
                faults.append(f"{kind} {number}: {' '.join(command)}: {words}")
        found += faults
        if not faults:
            shutil.rmtree(place)
    print(f"{kind}: {len(numbers)} files, exit codes {codes}, at most {seconds:.1f} s and {peak:.0f} MB")
    assert not found, "\n\n".join(found)


@pytest.fixture(scope="module")
def command_line(tmp_path_factory: pytest.TempPathFactory) -> Iterator[CommandLine]:
    """The command line in a process of its own."""
    with CommandLine(tmp_path_factory.mktemp("fuzz")) as calls:
        yield calls


@pytest.fixture(scope="module")
def whole(command_line: CommandLine, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sound results, with pictures of what is believed; what reads and draws them is loaded."""
    folder = tmp_path_factory.mktemp("whole")
    (folder / "room.toml").write_text(SHOWN)
    run(load_study(folder / "room.toml"), folder / "out")
    for command in ("report", "plot", "compare"):
        assert command_line(command, str(folder / "out")).code == FINE
    return folder / "out"


@pytest.fixture
def sound(kind: str, request: pytest.FixtureRequest) -> Path:
    """Sound results for the kinds that need some; nothing for the others."""
    return Path(request.getfixturevalue("whole")) if kind == "results" else Path()


def test_sound_files_are_read(command_line: CommandLine, tmp_path: Path) -> None:
    """What is changed here is sound."""
    contents = STUDIES | PLANS | {f"mesh-{name}": content for name, content in MESHES.items()}
    (tmp_path / "room.off").write_bytes(MESHES["room.off"])
    for name, content in contents.items():
        path = tmp_path / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
    for name in STUDIES:
        outcome = command_line(
            "run", str(tmp_path / name), "--runs", "3", "--out", str(tmp_path / "out" / name)
        )
        assert (outcome.code, outcome.error) == (FINE, "")
        assert all(line.startswith("rangefix: map: ") for line in outcome.said.splitlines())
    for name in PLANS | MESHES:
        path = tmp_path / (f"mesh-{name}" if name in MESHES else name)
        more = ("--sensor-height", "0.9") if name in MESHES else ()
        outcome = command_line("ranges", str(path), "--at", "2", "3", *BEAMS, *more)
        assert (outcome.code, outcome.said, outcome.error) == (FINE, "", "")


@pytest.mark.parametrize("kind", KINDS)
def test_some_changed_files(kind: str, sound: Path, command_line: CommandLine, tmp_path: Path) -> None:
    attack(kind, range(FEW[kind]), tmp_path, sound, command_line)


@pytest.mark.fuzz
@pytest.mark.parametrize(
    ("kind", "first"), [(kind, first) for kind in KINDS for first in range(1000, 1000 + MANY[kind], SLICE)]
)
def test_many_changed_files(
    kind: str, first: int, sound: Path, command_line: CommandLine, tmp_path: Path
) -> None:
    attack(kind, range(first, min(first + SLICE, 1000 + MANY[kind])), tmp_path, sound, command_line)
