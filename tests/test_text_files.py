"""Text of users: what is UTF-8, and what is said of anything else."""

from __future__ import annotations

from pathlib import Path

import pytest

from rangefix.text_files import NotText, decoded, line_in_utf8, read_text


def test_text_is_left_as_it_is(tmp_path: Path) -> None:
    """But for a mark at its beginning, and for ends of lines."""
    assert decoded("Büro, ½ m\n".encode()) == decoded("\ufeffBüro, ½ m\n".encode()) == "Büro, ½ m\n"
    assert decoded(b"") == ""
    (tmp_path / "a").write_bytes(b"one\r\ntwo\rthree\n")
    assert read_text(tmp_path / "a") == "one\ntwo\nthree\n"
    assert line_in_utf8("Büro \U0001f600\n", 1) == "Büro \U0001f600\n"


@pytest.mark.parametrize("code", ["utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-32-le", "utf-32-be"])
@pytest.mark.parametrize("text", ["ab", "runs = 20\n" * 20])
def test_other_encodings_are_named(code: str, text: str) -> None:
    with pytest.raises(NotText, match=f"^it is text in {code[:6].upper()}: save it as UTF-8$"):
        decoded(text.encode(code))


def test_other_bytes_are_told_by_their_line() -> None:
    with pytest.raises(NotText, match="line 2 holds a byte that is no UTF-8 \\(0xfc\\)"):
        decoded(b"one\nB\xfcro\n")
    with pytest.raises(NotText, match="line 3 holds a byte of zero"):
        decoded(b"one\ntwo\n\0three\n")
    with pytest.raises(NotText, match="line 7 holds a byte that is no UTF-8 \\(0xfc\\)"):
        line_in_utf8(b"B\xfcro".decode(errors="surrogateescape"), 7)
