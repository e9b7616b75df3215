"""With --json there is one document on standard output and nothing else, whatever else is printed."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from .conftest import Said

STUDY = """runs = 2
timeout_s = 0
[map]
kind = "rectangle"
width_m = 4.0
length_m = 6.0
[sensor]
bearings_deg = [326.3, 0.0, 33.7]
std_m = 0.05
[[estimators]]
name = "loud.py:Loud"
"""
PLUGIN = """
import os
import numpy as np
from rangefix.filters import Estimate

class Loud:
    def __init__(self, problem): pass
    def init(self, prior, rng): return np.zeros(2)
    def predict(self, belief, control, rng): return belief
    def update(self, belief, measurement, rng):
        print("by Python")
        os.system("echo by a program")
        return belief
    def estimate(self, belief): return Estimate(belief, np.eye(2), 0.0)
"""


@pytest.mark.parametrize("more", [(), ("--workers", "2"), ("--only-run", "1")])
def test_what_a_plugin_prints_in_this_process(
    rangefix: Callable[..., Said], tmp_path: Path, more: tuple[str, ...]
) -> None:
    (tmp_path / "loud.toml").write_text(STUDY)
    (tmp_path / "loud.py").write_text(PLUGIN)
    said = rangefix("run", "loud.toml", "--json", *more)
    assert said.code == 0
    assert json.loads(said.out)["study"] == "loud"
    assert {"by Python", "by a program"} <= {*said.err.splitlines()}
