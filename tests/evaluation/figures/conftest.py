"""Small results from which every figure of the catalogue can be drawn."""

from __future__ import annotations

from pathlib import Path

import pytest

from rangefix.evaluation import Results, load, parse_study, run
from rangefix.evaluation.results import BOUNDS, MANIFEST, read_json, write_json

NEVER = '''
class Never:
    """Fails in every run."""

    def __init__(self, problem): pass
    def init(self, prior, rng): raise RuntimeError("no")
    def predict(self, belief, control, rng): return belief
    def update(self, belief, measurement, rng): return belief
    def estimate(self, belief): return belief
'''
ESTIMATORS = """
[[estimators]]
name = "particle"
options = { particles = 200 }
[[estimators]]
name = "ekf"
label = "an extended Kalman filter by another name"
[[estimators]]
name = "ukf"
label = "a_label_without_any_place_to_break_it"
[[estimators]]
name = "never.py:Never"
label = "never"
"""
STANDING = """
title = "Some rather long title of a study of several estimators in a corner of a room"
runs = 8
beliefs = true
[map]
kind = "rectangle"
width_m = 14.0
length_m = 10.0
[sensor]
bearings_deg = [0, 45, 90, 135, 180, 225, 270, 315]
std_m = 0.2
[state]
heading = "unknown"
[truth]
at_m = [0.4, 0.3]
heading_deg = 10.0
"""
MOVING = """
runs = 4
[map]
kind = "floor-plan"
outer_m = [[0, 0], [6, 0], [6, 4], [0, 4]]
walls_m = [[3, 0, 3, 2.5]]
[sensor]
bearings_deg = [0, 90, 180, 270]
std_m = 0.1
[state]
heading = "unknown"
[motion]
kind = "odometry"
steps = 5
floor_m = 0.02
[prior]
kind = "gaussian"
std_m = 0.1
heading_std_deg = 5
"""


@pytest.fixture(scope="session")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Folders of results: objects that stand still, and that move; of four estimators one fails."""
    root = tmp_path_factory.mktemp("figures")
    (root / "never.py").write_text(NEVER, encoding="utf-8")
    for name, text in (("standing", STANDING), ("moving", MOVING)):
        run(parse_study(text + ESTIMATORS, source=name, folder=root), root / name)
    world = read_json(root / "standing" / MANIFEST)["plan"]["world"]
    best = {"optimum": [0.01, 0.02, 0.001], "bound": [0.004, None, 0.001], "bound_names": ["a", "", "a"]}
    document = {"schema": 1, "world": world, "names": [], "sets": {"all": best}, "rows": []}
    write_json(root / "standing" / BOUNDS, document)
    return {name: root / name for name in ("standing", "moving")}


@pytest.fixture(scope="session")
def standing(folders: dict[str, Path]) -> Results:
    """Results of objects that stand still, sampled and timed."""
    return load(folders["standing"])


@pytest.fixture(scope="session")
def moving(folders: dict[str, Path]) -> Results:
    """Results of objects that move."""
    return load(folders["moving"])
