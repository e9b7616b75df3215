"""Files that are whole or absent, and leave nothing behind when their writer is killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from rangefix.evaluation.results import write_bytes

KILLED = """
import os, signal, sys
from pathlib import Path
from rangefix.evaluation.results import write_bytes
def stop(*arguments, **options): os.kill(os.getpid(), signal.SIGKILL)
os.link = Path.replace = stop
write_bytes(Path(sys.argv[1]), b"new" * 100_000)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no files without a name")
@pytest.mark.parametrize("older", [None, b"older"])
def test_a_writer_that_is_killed_leaves_nothing(older: bytes | None, tmp_path: Path) -> None:
    path = tmp_path / "figures" / "a.png"
    path.parent.mkdir()
    if older is not None:
        path.write_bytes(older)
    done = subprocess.run([sys.executable, "-c", KILLED, str(path)])
    assert done.returncode == -signal.SIGKILL
    assert [file.read_bytes() for file in path.parent.iterdir()] == ([] if older is None else [older])


@pytest.mark.parametrize("nameless", [True, False])
def test_a_file_takes_the_place_of_an_older_one(
    nameless: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the permissions of any new file, and also where the system has no files without a name."""
    path, mask = tmp_path / "a", os.umask(0o022)
    os.umask(mask)
    if not nameless:

        def refuse(*arguments: object) -> int:
            raise OSError("operation not supported")

        monkeypatch.setattr(os, "open", refuse)
    for content in (b"one", b"", b"three" * 1000):
        write_bytes(path, content)
        assert path.read_bytes() == content
        assert path.stat().st_mode & 0o777 == 0o666 & ~mask
        assert [file.name for file in tmp_path.iterdir()] == ["a"]
