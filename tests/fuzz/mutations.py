"""Changes to files, drawn at random: those of disks and transfers, and those of people who try things out."""

from __future__ import annotations

import random
import re
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

TOKEN = re.compile(
    r'"[^"\n]*"|\b(?:true|false|null|nan|inf)\b|-?\b\d+(?:\.\d*)?(?:[eE][+-]?\d+)?|[A-Za-z_][A-Za-z_0-9]*'
)
NUMBERS = (
    "0", "-1", "1", "2", "-0.0", "nan", "inf", "-inf", "NaN", "Infinity", "1e300", "-1e300", "1e-300",
    "5e-324", "1e9", "1e-9", "1e6", "1e-6", "0.5", "100", "361", "1000000000000", "2147483647", "4294967296",
    "-2147483648", "18446744073709551616", "9" * 400, "1e999", "0x10", "1_000", "007",
)  # fmt: skip
OTHERS = (
    "true", "false", "null", '""', '"x"', '"1"', '" "', "[]", "{}", "[[]]", "[1]", "[[1, 2], [3]]",
    '"' + "long" * 3000 + '"', '"\\u0000"', '"\\u001b[31m"', '"\\n"', '"é\u202e"', '"../.."', '"/dev/zero"',
    '["a", 1]', '"/dev/stdin"', '"/"', '"%s%n"', '"=1+1"', "[" * 300 + "]" * 300, "[" * 5000, "{a = " * 50,
    "1979-05-27",
)  # fmt: skip
INTEGERS = (0, 1, 2, 3, 127, 128, 255, 256, 32767, 65535, 2**31 - 1, 2**31, 2**32 - 1)
FLOATS = (0.0, -1.0, 1e-300, 1e300, 1e9, float("nan"), float("inf"), -float("inf"))
Arrays = dict[str, NDArray[np.generic]]


def change_text(text: str, draws: random.Random) -> bytes:
    """A text file with one change, or a few: of a token, of lines, or of bytes."""
    for _ in range(draws.choice((1, 1, 1, 1, 2, 3))):
        text = draws.choice((*[_other_token] * 5, _other_lines))(text, draws)
    content = text.encode()
    return change_bytes(content, draws) if draws.random() < 0.1 else content


def _other_token(text: str, draws: random.Random) -> str:
    found = list(TOKEN.finditer(text))
    if not found:
        return text
    old = draws.choice(found)
    if draws.random() < 0.25:  # of the same file: a key for a key, a number for a number, or not
        new = draws.choice(found)[0]
    elif old[0][0].isalpha() and old[0] not in ("true", "false"):
        new = draws.choice((old[0] + "x", old[0][:-1], old[0].upper(), "a", f'"{old[0]}"', f"{old[0]}.b"))
    elif old[0][-1].isdigit() and draws.random() < 0.5:  # what may well be meant
        number = float(old[0]) * draws.choice((-1.0, 0.1, 0.5, 0.99, 1.01, 2.0, 3.0, 10.0, 360.0))
        new = repr(round(number)) if abs(number) < 1e15 and number == round(number) else repr(number)
    else:
        new = draws.choice(NUMBERS if draws.random() < 0.6 else OTHERS)
    return text[: old.start()] + new + text[old.end() :]


def _other_lines(text: str, draws: random.Random) -> str:
    lines = text.splitlines(keepends=True) or [""]
    one, other = draws.randrange(len(lines)), draws.randrange(len(lines))
    what = draws.randrange(5)
    if what == 0:
        del lines[one]
    elif what == 1:
        lines.insert(other, lines[one])
    elif what == 2:
        lines[one], lines[other] = lines[other], lines[one]
    elif what == 3:
        lines = lines[:one]
    else:
        lines[one:one] = lines[one:other] * draws.choice((1, 50))
    return "".join(lines)


def change_bytes(content: bytes, draws: random.Random) -> bytes:
    """A file with some bytes changed, left out, put in, cut off or said to be other numbers."""
    changed = bytearray(content)
    for _ in range(draws.choice((1, 1, 1, 2, 5))):
        if not changed:
            break
        first = draws.randrange(len(changed))
        length = min(draws.choice((1, 2, 4, 16, 200)), len(changed) - first)
        what = draws.randrange(6)
        if what == 0:
            changed[first] ^= 1 << draws.randrange(8)
        elif what == 1:
            del changed[first : first + length]
        elif what == 2:
            changed[first:first] = draws.randbytes(length)
        elif what == 3:
            changed[first : first + length] = changed[: min(first, length)] * draws.choice((1, 1, 1000))
        elif what == 4:
            del changed[first:]
        else:
            size = draws.choice((1, 2, 4, 8))
            value = draws.choice(INTEGERS) % 256**size
            changed[first : first + size] = value.to_bytes(size, draws.choice(("little", "little", "big")))
    return bytes(changed)


def change_arrays(arrays: Mapping[str, NDArray[np.generic]], draws: random.Random) -> Arrays:
    """Arrays with one of them changed: an entry, its shape, its dtype, its name, or left out."""
    changed = dict(arrays)
    name = draws.choice(sorted(changed))
    array = changed[name]
    changes: Sequence[Callable[[], object]] = (
        lambda: changed.pop(name),
        lambda: changed.update({f"{name}_": array}),
        lambda: changed.update({name: array[..., None]}),
        lambda: changed.update({name: array.ravel()[: array.size // 2]}),
        lambda: changed.update(
            {name: np.asarray(array).astype(draws.choice(("<f4", "<i8", ">f8", "<U9", "?")))}
        ),
        lambda: changed.update({name: _other_entry(array, draws)}),
        lambda: changed.update({name: _other_entry(array, draws)}),
        lambda: changed.update({name: changed[draws.choice(sorted(changed))]}),
    )
    try:
        draws.choice(changes)()
    except ValueError:  # letters that are no number
        changed.pop(name, None)
    return changed


def _other_entry(array: NDArray[np.generic], draws: random.Random) -> NDArray[np.generic]:
    changed = np.array(array)
    if changed.size and changed.dtype.kind in "fiu":
        value = draws.choice(FLOATS if changed.dtype.kind == "f" else INTEGERS)
        with np.errstate(all="ignore"):
            new = np.array(value).astype(changed.dtype)
        place: object = draws.randrange(changed.size) if draws.random() < 0.7 else slice(None)
        changed.reshape(-1)[place] = new  # type: ignore[index]
    elif changed.dtype.kind == "U":
        changed = np.array(draws.choice(("", "x", "x" * 5000, "\x1b[31m", "1e9")))
    return changed
