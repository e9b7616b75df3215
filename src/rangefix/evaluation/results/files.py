"""Files that are whole or absent when written, and looked at before they are read."""

from __future__ import annotations

import json
import os
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from hashlib import sha256
from pathlib import Path
from typing import IO, Any

from ...errors import printable
from ...text_files import decoded

MAX_JSON = 5 << 20  # bytes
MAX_DEPTH = 60  # of tables and lists in one another


class ResultsError(ValueError):
    """Results that cannot be read or written: one clear line."""

    def __str__(self) -> str:
        return printable(super().__str__())


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file at once: it is there whole, or as it was before, even if this process is killed.

    Raises:
        ResultsError: If it cannot be written (disk full, no permission).
    """
    part = path.with_name(f"{path.name}.{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if not _write_nameless(path, part, content):
            part.write_bytes(content)
            part.replace(path)
    except OSError as error:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        raise ResultsError(
            f"cannot write {path}: {error.strerror or error}; what was finished is kept"
        ) from None


def _write_nameless(path: Path, part: Path, content: bytes) -> bool:
    """Write a file that gets its name when it is whole, so that nobody has to remove a part of it.

    Args:
        path: Its name.
        part: A name for the moment in which it takes the place of an older file.
        content: What it holds.

    Returns:
        Whether it is there; False where the system has no files without a name.
    """
    if sys.platform != "linux":
        return False
    try:
        with os.fdopen(os.open(path.parent, os.O_TMPFILE | os.O_WRONLY, 0o666), "wb") as file:
            file.write(content)
            file.flush()
            nameless = f"/proc/self/fd/{file.fileno()}"
            try:
                os.link(nameless, path, src_dir_fd=0)  # a folder, which does not count: links are followed
            except FileExistsError:
                os.link(nameless, part, src_dir_fd=0)
                part.replace(path)
        return True
    except OSError:  # not on this file system; or the disk is full, which shows once more
        return False


def remove_partial_files(folder: Path) -> None:
    """Remove files that were being written when a run was killed."""
    for left in folder.glob("**/*.tmp"):
        remove(left)


def remove(path: Path) -> None:
    """Remove a file, if it is there.

    Raises:
        ResultsError: If it cannot be removed.
    """
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise ResultsError(f"cannot remove {path}: {error.strerror or error}") from None


def write_json(path: Path, document: Any) -> None:
    """Write a JSON document, indented, in the order given."""
    write_bytes(path, (json.dumps(document, indent=2, ensure_ascii=False, default=str) + "\n").encode())


@contextmanager
def open_regular(path: Path, most: int) -> Iterator[IO[bytes]]:
    """A file to read that is a file, neither a pipe nor a device, and not too large.

    Raises:
        FileNotFoundError: If there is none.
        ResultsError: If it is something else, too large, or cannot be read.
    """
    try:
        found = path.stat()
        if not stat.S_ISREG(found.st_mode):
            raise ResultsError(f"{path} is not a regular file: run the study again")
        if found.st_size > most:
            raise ResultsError(f"{path} has {found.st_size} bytes, more than the {most} it may have")
        file = path.open("rb")
    except (FileNotFoundError, NotADirectoryError):
        raise FileNotFoundError(str(path)) from None
    except OSError as error:
        raise ResultsError(f"cannot read {path}: {error.strerror or error}") from None
    with file:
        yield file


def read_json(path: Path) -> Any:
    """A JSON document, not too large and not too deep.

    Raises:
        ResultsError: If the file is missing or not such a document.
    """
    try:
        with open_regular(path, MAX_JSON) as file:
            document = json.loads(decoded(file.read()))
    except FileNotFoundError:
        raise ResultsError(f"no {path.name} in {path.parent}: it is not a folder of results") from None
    except ResultsError:
        raise
    except RecursionError:
        raise ResultsError(f"{path} is damaged (nested too deeply): run the study again") from None
    except (OSError, ValueError) as error:
        raise ResultsError(f"{path} is damaged ({error}): run the study again") from None
    if too_deep(document):
        raise ResultsError(f"{path} is damaged (nested too deeply): run the study again")
    return document


def too_deep(document: Any, most: int = MAX_DEPTH) -> bool:
    """Whether tables and lists lie in one another more than so many times."""
    level = [document]
    for _ in range(most):
        level = [
            inner
            for each in level
            if isinstance(each, dict | list)
            for inner in (each.values() if isinstance(each, dict) else each)
        ]
        if not level:
            return False
    return True


def hash_of(*parts: object) -> str:
    """SHA-256 of a JSON list of the parts."""
    return sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()
