"""Files that are whole or absent: arrays without pickle, sealed with a key and a checksum."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Mapping
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

Arrays = Mapping[str, NDArray[Any]]


class ResultsError(ValueError):
    """Results that cannot be read or written: one clear line."""


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file at once: it is there whole, or as it was before.

    Raises:
        ResultsError: If it cannot be written (disk full, no permission).
    """
    part = path.with_name(f"{path.name}.{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_bytes(content)
        part.replace(path)
    except OSError as error:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        raise ResultsError(
            f"cannot write {path}: {error.strerror or error}; what was finished is kept"
        ) from None


def remove_partial_files(folder: Path) -> None:
    """Remove files that were being written when a run was killed."""
    for left in folder.glob("**/*.tmp"):
        try:
            left.unlink(missing_ok=True)
        except OSError as error:
            raise ResultsError(f"cannot remove {left}: {error.strerror or error}") from None


def write_json(path: Path, document: Any) -> None:
    """Write a JSON document, indented, in the order given."""
    write_bytes(path, (json.dumps(document, indent=2, ensure_ascii=False, default=str) + "\n").encode())


def write_npz(path: Path, arrays: Arrays) -> None:
    """Write arrays as .npz; the same arrays give the same bytes.

    Raises:
        ResultsError: If it cannot be written, or an array would need pickle.
    """
    if objects := [name for name, array in arrays.items() if np.asarray(array).dtype.hasobject]:
        raise ResultsError(f"cannot save {', '.join(objects)} in {path}: arrays of Python objects")
    content = io.BytesIO()
    np.savez(content, **arrays)  # type: ignore[arg-type]
    write_bytes(path, content.getvalue())


def read_npz(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of a .npz, read without pickle.

    Raises:
        ResultsError: If the file is missing, cut short or damaged.
    """
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except FileNotFoundError:
        raise ResultsError(f"{path} is missing: run the study again with the same --out to make it") from None
    except (OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
        raise ResultsError(f"{path} is damaged ({error}): delete it and run the study again") from None


def read_json(path: Path) -> Any:
    """A JSON document.

    Raises:
        ResultsError: If the file is missing or not JSON.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ResultsError(f"no {path.name} in {path.parent}: it is not a folder of results") from None
    except (OSError, ValueError) as error:
        raise ResultsError(f"{path} is damaged ({error}): run the study again") from None


def checksum(arrays: Arrays) -> str:
    """SHA-256 over names, types, shapes and bytes of the arrays, in the order of their names."""
    digest = sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {np.shape(arrays[name])}\n".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def write_part(path: Path, arrays: Arrays, key: str) -> None:
    """Write a part: arrays, the key of what made them, and their checksum."""
    sealed = dict(arrays) | {"key": np.array(key)}
    write_npz(path, sealed | {"sha256": np.array(checksum(sealed))})


def read_part(path: Path, key: str | None = None) -> dict[str, NDArray[Any]]:
    """The arrays of a part whose checksum, and key if one is given, are right.

    Raises:
        ResultsError: If the part is missing or damaged, or something else made it.
    """
    sealed = read_npz(path)
    seal = str(sealed.pop("sha256", ""))
    if seal != checksum(sealed):
        raise ResultsError(f"{path} is damaged (wrong checksum): delete it and run the study again")
    if str(sealed.pop("key", "")) != key and key is not None:
        raise ResultsError(f"{path} was made by another study, seed or version: run the study again")
    return sealed


def hash_of(*parts: object) -> str:
    """SHA-256 of a JSON list of the parts."""
    return sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()
