"""Arrays in files: without pickle, checked by their headers before anything is allocated, and sealed."""

from __future__ import annotations

import io
import warnings
from collections.abc import Mapping
from functools import lru_cache
from hashlib import sha256
from math import prod
from pathlib import Path
from typing import IO, Any, NamedTuple
from zipfile import ZIP_STORED, ZipFile

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from .files import ResultsError, open_regular, write_bytes

Arrays = Mapping[str, NDArray[Any]]
MAX_BYTES = 1 << 26  # of a file of arrays whose shapes are not known beforehand
MAX_RANK = 8
SEALED = ("key", "sha256")
NO_COMMENT, LENGTH_OF_COMMENT = b"\x00\x00", b"\x40\x00"  # at the end of an archive: none, or 64 letters
CHUNK = 1 << 20  # bytes that are hashed at once


class Form(NamedTuple):
    """What an array of a file must be.

    Attributes:
        shape: Its shape; None for any length.
        dtype: Its dtype, as numpy writes it; "U" for texts of any length.
        optional: Whether it may be missing.
    """

    shape: tuple[int | None, ...]
    dtype: str = "<f8"
    optional: bool = False

    def fault(self, shape: tuple[int, ...], dtype: np.dtype[Any]) -> str:
        """What is wrong with an array of that shape and dtype, or ""."""
        if (dtype.kind if self.dtype == "U" else dtype.str) != self.dtype:
            return f"has dtype {dtype.str}, not {self.dtype}"
        fits = len(shape) == len(self.shape) and all(
            wanted in (None, length) for wanted, length in zip(self.shape, shape, strict=True)
        )
        return "" if fits else f"has shape {shape}, not {self.shape}".replace("None", "any")


Forms = Mapping[str, Form]


def write_npz(path: Path, arrays: Arrays) -> None:
    """Write arrays as .npz; the same arrays give the same bytes.

    The comment at the end of the archive is a hash of all bytes before it.

    Raises:
        ResultsError: If it cannot be written, or an array would need pickle.
    """
    if objects := [name for name, array in arrays.items() if np.asarray(array).dtype.hasobject]:
        raise ResultsError(f"cannot save {', '.join(objects)} in {path}: arrays of Python objects")
    content = io.BytesIO()
    np.savez(content, **arrays)  # type: ignore[arg-type]
    whole = content.getvalue()[: -len(NO_COMMENT)] + LENGTH_OF_COMMENT
    write_bytes(path, whole + sha256(whole).hexdigest().encode())


def read_npz(path: Path, forms: Forms | None = None, most: int = MAX_BYTES) -> dict[str, NDArray[Any]]:
    """The arrays of a .npz as `write_npz` writes it: not packed, so that it takes no more memory than disk.

    Args:
        path: The file.
        forms: Name -> what the array must be; no other may be there. None: any numbers and texts.
        most: Bytes that the file may have.

    Raises:
        ResultsError: If the file is missing, cut short, damaged, too large, or holds something else.
    """
    try:
        with open_regular(path, most) as file, warnings.catch_warnings():
            warnings.simplefilter("error")  # numpy and zipfile doubt it
            return _arrays(file, forms)
    except FileNotFoundError:
        raise ResultsError(f"{path} is missing: run the study again with the same --out to make it") from None
    except ResultsError:
        raise
    except Exception as error:  # zipfile, zlib, struct and numpy raise whatever they like on damaged files
        cause = " ".join(str(error).split())[:200] or type(error).__name__
        raise ResultsError(f"{path} is damaged ({cause}): delete it and run the study again") from None


def _arrays(file: IO[bytes], forms: Forms | None) -> dict[str, NDArray[Any]]:
    size = file.seek(0, io.SEEK_END)
    if not _is_sealed(file, size):
        raise ValueError("wrong checksum")
    with ZipFile(file) as archive:
        members = {member.filename.removesuffix(".npy"): member for member in archive.infolist()}
        if len(members) < len(archive.infolist()):
            raise ValueError("a name stands twice in it")
        if any(member.compress_type != ZIP_STORED for member in members.values()):
            raise ValueError("it is packed, which rangefix never does")
        if sum(member.file_size for member in members.values()) > size:
            raise ValueError("it says that it holds more than the file is long")
        if forms is not None:
            missing = [name for name, form in forms.items() if not form.optional and name not in members]
            unknown = [name for name in members if name not in forms]
            if missing or unknown:
                what = f"no {missing[0]!r}" if missing else f"{unknown[0]!r}, which is none of ours,"
                raise ValueError(f"there is {what} in it")
        arrays = {}
        for name, member in members.items():
            with archive.open(member) as content:
                form = None if forms is None else forms[name]
                arrays[name] = _array(name, content, member.file_size, form)
    return arrays


def _is_sealed(file: IO[bytes], size: int) -> bool:
    """Whether the comment of an archive is the hash of all before it."""
    digest, left = sha256(), size - sha256().digest_size * 2
    file.seek(0)
    while left > 0:
        chunk = file.read(min(CHUNK, left))
        digest.update(chunk)
        left -= len(chunk) or left
    return file.read() == digest.hexdigest().encode()


def _array(name: str, content: IO[bytes], size: int, form: Form | None) -> NDArray[Any]:
    """An array, read after its header was found to fit the file and the form."""
    version = npy.read_magic(content)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"{name}: format {version}")
    length = content.read(2 if version == (1, 0) else 4)
    header = length + content.read(int.from_bytes(length, "little"))
    shape, fortran, dtype = _read_header(version, header)
    if dtype.kind not in "fiubU" or dtype.itemsize == 0 or dtype.shape:
        raise ValueError(f"{name}: dtype {dtype}")
    if len(shape) > MAX_RANK or any(length < 0 for length in shape):
        raise ValueError(f"{name}: shape {shape}")
    if form is not None and (fault := form.fault(shape, dtype)):
        raise ValueError(f"{name} {fault}")
    count = prod(shape)
    if count * dtype.itemsize != size - content.tell():
        raise ValueError(
            f"{name}: {count * dtype.itemsize} bytes in its header, {size - content.tell()} there"
        )
    data = bytearray(content.read())
    return np.ndarray(shape, dtype, data, order="F" if fortran else "C")


@lru_cache(maxsize=512)  # parts of a study have the same ones: numpy compiles each as an expression of Python
def _read_header(version: tuple[int, int], header: bytes) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, whether columns come first, and type of an array, of its header and that one's length."""
    read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, fortran, dtype = read(io.BytesIO(header))
    return shape, fortran, dtype


def checksum(arrays: Arrays) -> str:
    """SHA-256 over names, types, shapes and bytes of the arrays, in the order of their names."""
    digest = sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {np.shape(arrays[name])}\n".encode())
        digest.update(array.reshape(-1).view(np.uint8).data)
    return digest.hexdigest()


def write_part(path: Path, arrays: Arrays, key: str) -> None:
    """Write a part: arrays, the key of what they hold and what made them, and their checksum."""
    sealed = dict(arrays) | {"key": np.array(key)}
    write_npz(path, sealed | {"sha256": np.array(checksum(sealed))})


def read_part(
    path: Path, key: str | None = None, forms: Forms | None = None, most: int = MAX_BYTES
) -> dict[str, NDArray[Any]]:
    """The arrays of a part whose checksum, and key if one is given, are right.

    Args:
        path: The file.
        key: What it must hold.
        forms, most: As for `read_npz`.

    Raises:
        ResultsError: If the part is missing or damaged, holds something else, or something else made it.
    """
    if forms is not None:
        forms = {**forms, **dict.fromkeys(SEALED, Form((), "U"))}
    sealed = read_npz(path, forms, most)
    seal = str(sealed.pop("sha256", ""))
    if seal != checksum(sealed):
        raise ResultsError(f"{path} is damaged (wrong checksum): delete it and run the study again")
    found = str(sealed.pop("key", ""))
    if key is not None and found != key:
        raise ResultsError(f"{path} {_told_apart(found, key)}: run the study again")
    return sealed


def part_key(made_by: str, estimator: str, beams: str, first: int, end: int) -> str:
    """The key of a part: what it holds, readable, and the hash of what made it."""
    return f"{made_by} runs {first} to {end - 1} of {estimator!r} on beams {beams!r}"


def _told_apart(found: str, key: str) -> str:
    """What a part is, that has another key than it should."""
    (made, _, held), (wanted, _, _) = found.partition(" "), key.partition(" ")
    if made == wanted and held:
        return f"holds {' '.join(held.split())[:200]}, which belong elsewhere"
    return "was made by another study, seed or version"
