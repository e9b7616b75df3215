"""The script of the table of recordings: every recording has its own file of fitted noise."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
if not DOCS.is_dir():  # a source distribution has it, an installed package has not
    pytest.skip("the pages are not there", allow_module_level=True)


def test_each_calibration_is_a_file_of_its_own(tmp_path: Path) -> None:
    """`rangefix calibrate` refuses to write over a file: the second recording stopped the script."""
    script = runpy.run_path(str(DOCS / "make_recordings.py"))
    rows_of, written = script["rows_of"], []

    def called(*arguments: str | Path) -> str:
        assert arguments[0] == "calibrate"
        written.append(Path(arguments[-1]))
        return ""

    rows_of.__globals__["called"] = called
    for recording in script["RECORDINGS"]:
        assert [*rows_of(recording, Path("data"), (), tmp_path)] == []
    assert len(written) == sum(each.calibration is not None for each in script["RECORDINGS"]) > 1
    assert len(set(written)) == len(written)
    assert {path.suffix for path in written} == {".toml"}
