"""A folder of results belongs to one study, and to one run at a time."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from itertools import product
from pathlib import Path
from time import sleep
from typing import Any, NamedTuple

from ...errors import counted
from ...file_lock import lock
from ..results import (
    BOUNDS,
    FIGURES,
    FILE,
    LOCK,
    MANIFEST,
    REPORT,
    SCENE,
    SUMMARY,
    TIMING,
    WORST_RUNS,
    FolderLayout,
    ResultsError,
    read_bounds,
    read_json,
    remove,
    runs_of_part,
    trials_path,
    world_path,
)
from .environment import LIBRARIES

SETTINGS = ("config", "seed", "runs", "beam_sets", "estimators")  # of a manifest
OURS = (TIMING, BOUNDS, SCENE, FILE, SUMMARY, WORST_RUNS, REPORT)
TRIES, PAUSE_S = 5, 0.02  # to lock a folder: who asks whether it is in use holds it for a moment
ONE_RUN = re.compile(r"run-\d+\.(png|svg|pdf)")  # the figure of a run that was repeated


class Older(NamedTuple):
    """What a folder holds that is older than the numbers to come.

    Attributes:
        line: What of it is removed or made anew; "" if nothing is.
        files: What to remove.
    """

    line: str = ""
    files: Sequence[Path] = ()


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a folder for this process; the system lets go of it when the process ends, however it ends.

    Folders that are made for it, and hold nothing in the end, are removed.

    Raises:
        ResultsError: If another process holds it, which is named, or it cannot be made.
    """
    made = [place for place in (folder, *folder.parents) if not place.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle = _hold(folder / LOCK)
    except BlockingIOError as error:
        raise ResultsError(
            f"{folder} is in use by process {error.args[0]}: wait for it, or choose another --out"
        ) from None
    except OSError as error:
        raise ResultsError(f"cannot write {folder}: {error.strerror or error}") from None
    try:
        yield
    finally:
        with suppress(OSError):
            (folder / LOCK).unlink(missing_ok=True)  # while it is held: nobody else's
        os.close(handle)
        with suppress(OSError):
            for place in made:
                place.rmdir()  # if it is empty


def _hold(path: Path) -> int:
    """The handle of a lock file with this process in it.

    Raises:
        BlockingIOError: With the process that holds it.
    """
    tries = 0
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NONBLOCK", 0), 0o644)
        try:
            lock(handle)
            if os.fstat(handle).st_ino == path.stat().st_ino:
                os.ftruncate(handle, 0)
                os.write(handle, f"{os.getpid()}\n".encode())
                return handle
        except BlockingIOError:
            holder = os.read(handle, 20).decode(errors="replace").strip()
            os.close(handle)
            tries += 1
            if tries < TRIES:
                sleep(PAUSE_S)
                continue
            raise BlockingIOError(holder if holder.isdigit() else "(unknown)") from None
        except FileNotFoundError:
            pass  # whoever held it has removed it: once more
        except OSError:
            os.close(handle)
            raise
        os.close(handle)


def what_is_older(
    folder: Path, plan: FolderLayout, manifest: Mapping[str, Any], force: bool = False
) -> Older:
    """What a folder holds that is older than the numbers of a study; what is not its own is refused.

    Args:
        folder: The folder of results.
        plan: What is to be there.
        manifest: Of the study, as it is to be.
        force: Whether to remove the results of another study, and to replace a manifest that is not ours.

    Returns:
        What to remove as soon as the manifest of the study is written.

    Raises:
        ResultsError: If the folder belongs to something else.
    """
    path, name = folder / MANIFEST, manifest["name"]
    if not os.path.lexists(path):
        return Older()
    before = _manifest(path)
    if before is None:
        if force:
            return Older(f"{path} is replaced; it was none of ours")
        raise ResultsError(f"{path} is no manifest of ours: choose another --out, or --force to replace it")
    owner = before["name"]
    if owner != name:
        if not force:
            raise ResultsError(
                f"{folder} has the results of another study, {owner[:80]!r}, not of {name!r}: choose another "
                "--out, or --force to remove them"
            )
        ours = [*_figures(folder), *_parts(folder), *(folder / each for each in OURS)]
        return Older(f"{folder}: the results of {owner[:80]!r} are removed", ours)
    return _other_settings(folder, plan, before, manifest)


def _other_settings(
    folder: Path, plan: FolderLayout, before: dict[str, Any], manifest: Mapping[str, Any]
) -> Older:
    """What other settings of the same study, or a part of its runs, have left in a folder."""
    now = json.loads(json.dumps(plan.as_json()))
    if before["plan"] == now and before.get("state") == "complete":
        return Older()
    old_keys = before["plan"].get("trials")
    shared = old_keys.keys() & now["trials"].keys() if isinstance(old_keys, dict) else ()
    anew = any(before["plan"].get(key) != now[key] for key in ("world", "block", "shape")) or any(
        old_keys[label] != now["trials"][label] for label in shared
    )
    shown = [*shown_files(folder)]
    orphans = _orphans(folder, plan)
    files = [*shown, *orphans, folder / SUMMARY, folder / WORST_RUNS, *([folder / TIMING] if anew else [])]
    if any(before["plan"].get(key) != now[key] for key in ("world", "beams")):
        files.append(folder / BOUNDS)
    parts = counted(len(orphans), "older part")
    removed = [text for text, found in (("the older figures and report", shown), (parts, orphans)) if found]
    verb = "is" if removed == ["1 older part"] else "are"
    lines = ["its numbers are made anew"] * anew + [f"{', '.join(removed)} {verb} removed"] * bool(removed)
    why = "is finished" if before["plan"] == now else _what_differs(before, manifest)
    return Older(f"{folder} {why}: {', '.join(lines)}" if lines else "", files)


def _what_differs(before: Mapping[str, Any], manifest: Mapping[str, Any]) -> str:
    """Whether other settings made a folder, or the same settings and other code."""
    plain = json.loads(json.dumps(manifest))
    same = all(before.get(key) == plain[key] for key in SETTINGS)
    if same and before.get("code") != plain["code"]:
        return "was made by another version of rangefix"
    versions, now = before.get("versions"), plain["versions"]
    if same and isinstance(versions, dict):
        others = [name for name in LIBRARIES if versions.get(name) != now[name]]
        if others:
            return f"was made with another version of {', '.join(others)}"
    return "has other settings than before"


def _manifest(path: Path) -> dict[str, Any] | None:
    """A manifest that rangefix wrote, of any version; None for anything else."""
    try:
        found = read_json(path)
    except ResultsError:
        return None
    ours = isinstance(found, dict) and isinstance(found.get("format"), int)
    ours = ours and isinstance(found.get("name"), str) and isinstance(found.get("plan"), dict)
    return found if ours else None


def shown_files(folder: Path) -> dict[Path, int]:
    """The figures and the report that rangefix has written, and when, ns."""
    paths = (*_figures(folder), folder / REPORT)
    return {path: path.stat().st_mtime_ns for path in paths if path.exists()}


def drawn_meanwhile(folder: Path, before: Mapping[Path, int]) -> list[Path]:
    """What `shown_files` are new since it was asked before, but for figures of runs that were repeated."""
    later = shown_files(folder).items()
    return [path for path, when in later if before.get(path) != when and not ONE_RUN.fullmatch(path.name)]


def remove_damaged_bounds(folder: Path, plan: FolderLayout) -> str:
    """Remove saved bounds that cannot be read, or are of another problem: a line that says so; "" if not."""
    try:
        read_bounds(folder / BOUNDS, plan)
    except ResultsError:
        remove(folder / BOUNDS)
        return f"{folder / BOUNDS} is damaged, or of another problem, and is removed"
    return ""


def _figures(folder: Path) -> list[Path]:
    """The figures that `draw` has written; the pictures of others in the same folder are not ours."""
    if not (folder / FIGURES).is_dir():
        return []
    from ..figures.catalogue import figure_kinds
    from ..figures.files import FORMATS

    names = [f"{kind.name}.{suffix}" for kind in figure_kinds() for suffix in FORMATS]
    paths = (folder / FIGURES).iterdir()
    return [path for path in paths if path.is_file() and (path.name in names or ONE_RUN.fullmatch(path.name))]


def _parts(folder: Path) -> list[Path]:
    """All files that are called like parts and lie in the folder itself, not behind a link."""
    root = folder.resolve()
    found = [*folder.glob("parts/world/*.npz"), *folder.glob("parts/*/*/*.npz")]
    return [path for path in found if runs_of_part(path) and path.parent.resolve().is_relative_to(root)]


def _orphans(folder: Path, plan: FolderLayout) -> list[Path]:
    """The parts that are not of a plan."""
    pairs = product(plan.estimators, plan.beams)
    trials = {trials_path(folder, *pair, 0, 1).parent for pair in pairs}
    places = {*trials, world_path(folder, 0, 1).parent}

    def belongs(part: Path) -> bool:
        first, end = runs_of_part(part) or (0, 0)
        whole = min(first + plan.block, plan.runs)
        begun = part.parent in trials and end < whole  # and it is unfinished: its whole part is not there
        begun = begun and not part.with_name(f"{first:08d}-{whole:08d}.npz").exists()
        return first % plan.block == 0 and (end == whole or begun) and part.parent in places

    return [part for part in _parts(folder) if not belongs(part)]


def remove_files(files: Sequence[Path], folder: Path) -> None:
    """Remove files, and folders within the folder that are empty then."""
    for path in files:
        remove(path)
    around = {parent for path in files for parent in path.parents if folder in parent.parents}
    for inner in sorted(around, key=lambda path: len(path.parts), reverse=True):
        with suppress(OSError):
            inner.rmdir()
