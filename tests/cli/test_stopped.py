"""Commands that are stopped before they begin, or where Python would not notice: one line, code 130."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest

AT_IMPORT = """
import os, signal, sys

class Stops:
    def find_spec(self, name, *more):
        if name == "typer":
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Stops())
from rangefix.cli import main
"""
WHILE_TYPER_READS_COMMANDS = """
import os, signal, sys
import typer.main
from rangefix.cli import main

typer.main.get_command = lambda app: os.kill(os.getpid(), signal.SIGINT)
main(["studies"])
"""
IN_A_DESTRUCTOR = """
import os, signal, sys, time
from rangefix.cli import main
from rangefix.cli.app import app

class Stops:
    def __del__(self):
        os.kill(os.getpid(), signal.{name})
        time.sleep(0)

@app.command()
def wait():
    Stops()
    time.sleep(3)

main(["wait"])
"""
IN_THE_BODY_OF_A_CLASS = """
import os, signal, time
from rangefix.cli import main
from rangefix.cli.app import app

class Stops:
    def __set_name__(self, owner, name):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(3)

@app.command()
def define():
    class Figure:
        part = Stops()

main(["define"])
"""

AN_ERROR_OF_COMPILED_CODE = """
import os, signal, time
from rangefix.cli import main
from rangefix.cli.app import app

@app.command()
def draw():
    try:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(3)
    except KeyboardInterrupt:
        raise ValueError("Invalid affine transformation matrix") from None

main(["draw"])
"""
BY_MODULE = """
import os, runpy, signal, sys

class Stops:
    def find_spec(self, name, *more):
        if name == "rangefix.cli":
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Stops())
runpy.run_module("rangefix", run_name="__main__")
"""


@pytest.mark.parametrize(
    "code",
    [
        AT_IMPORT,
        BY_MODULE,
        WHILE_TYPER_READS_COMMANDS,
        IN_THE_BODY_OF_A_CLASS,
        AN_ERROR_OF_COMPILED_CODE,
        *(IN_A_DESTRUCTOR.format(name=name) for name in ("SIGINT", "SIGTERM")),
    ],
)
def test_one_line(code: str) -> None:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stderr == "rangefix: stopped\n"
    assert done.returncode in (130, -signal.SIGINT)  # a shell shows both as 130


@pytest.mark.skipif(sys.platform == "win32", reason="pipes end otherwise there")
@pytest.mark.parametrize("arguments", [["studies"], ["studies", "--json"], ["--help"]])
def test_a_reader_that_goes_is_no_failed_trial(arguments: list[str]) -> None:
    """As in `rangefix studies | head -1` of a script with `pipefail`: nothing is said, and not code 1."""
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(
        [sys.executable, "-m", "rangefix", *arguments], stdout=write, stderr=subprocess.PIPE, timeout=60
    )
    os.close(write)
    assert (done.returncode, done.stderr) == (141, b"")
