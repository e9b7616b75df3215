"""What was finished of a part is saved every few seconds: stopping loses little, and no bit depends on it."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rangefix.evaluation import Experiment, NamedEstimator, run
from rangefix.evaluation.monte_carlo.unfinished import Unfinished
from rangefix.evaluation.results import Status
from rangefix.evaluation.seeds import Streams
from rangefix.evaluation.trials import guard, saving
from rangefix.filters import Estimate, Problem

from ..conftest import make_problem

BLOCK = 40
PLUGIN = """
import os
import time
import numpy as np
from pathlib import Path
from rangefix.filters import Estimate

HERE = Path(__file__).parent
LOST = {LOST}

class Slow:
    def __init__(self, problem): pass
    def init(self, prior, rng): return rng.random()
    def predict(self, belief, control, rng): return belief
    def update(self, belief, measurement, rng):
        with open(HERE / "log", "a") as log:
            log.write(f"{float(belief)!r}\\n")
        if belief in LOST:
            os._exit(3)
        time.sleep({SECONDS})
        return measurement[:2]
    def estimate(self, belief): return Estimate(belief, np.eye(2), 0.0)
"""

STUDY = """
name = "slow"
runs = 150
beliefs = false
[map]
kind = "rectangle"
width_m = 4.0
length_m = 6.0
[sensor]
bearings_deg = [0.0, 90.0]
std_m = 0.3
[[estimators]]
name = "slow.py:Slow"
[[estimators]]
name = "ekf"
"""


@dataclass
class Stops:
    """An estimator that is stopped at its n-th update."""

    left: int
    updates: int = 0

    def __call__(self, problem: Problem) -> Stops:
        return self

    def init(self, prior: Any, rngs: Sequence[np.random.Generator]) -> Any:
        return np.stack([rng.standard_normal(2) for rng in rngs])

    def predict(self, belief: Any, control: Any, rngs: Any) -> Any:
        return belief

    def update(self, belief: Any, measurement: Any, rngs: Any) -> Any:
        self.updates += len(belief)
        if self.updates > self.left:
            raise KeyboardInterrupt
        return belief + measurement[:, :2]

    def estimate(self, belief: Any) -> Estimate:
        return Estimate(belief, np.broadcast_to(np.eye(2), (len(belief), 2, 2)), np.zeros(len(belief)))

    def __reduce__(self) -> Any:  # the same whatever is left
        return Stops, (0,)


@pytest.fixture(autouse=True)
def often(monkeypatch: pytest.MonkeyPatch) -> None:
    """Batches of four runs, saved one by one."""
    monkeypatch.setattr(saving, "SAVE_INTERVAL_S", 0.0)
    monkeypatch.setattr(saving.Pace, "batch", lambda pace, most: min(4, most))


def experiment(estimators: dict[str, Any], **changes: Any) -> Experiment:
    usual: dict[str, Any] = {"runs": BLOCK + 7, "block": BLOCK, "name": "mine", "beliefs": False}
    return Experiment(make_problem(0.3), estimators, **(usual | changes))


def parts(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("parts/*/*/*"))}


def first_draws(runs: Sequence[int]) -> list[float]:
    """What the plug-in draws first in some runs, by which it knows them."""
    return [float(rng.random()) for rng in Streams(1, "estimator", runs)]


@contextmanager
def stopped() -> Iterator[None]:
    with pytest.raises(KeyboardInterrupt):
        yield


def test_what_was_finished_is_taken_up(tmp_path: Path) -> None:
    """Stopped twice within a block; all that was saved is kept, and the parts have the same bytes."""
    whole = experiment({"stops": Stops(10_000)})
    run(whole, tmp_path / "whole", timing=False)
    there = tmp_path / "there"
    tried = []
    for left in (22, 13, 1000):
        estimator = Stops(left)
        stopping = experiment({"stops": estimator})
        if left < 1000:
            with stopped():
                run(stopping, there, timing=False)
            (begun,) = parts(there)
            tried.append(begun.rpartition("-")[2])
        else:
            run(stopping, there, timing=False)
            probed = 2 + 1  # whose beliefs are weighed, once
            assert estimator.updates == BLOCK + 7 - 24 + probed
    assert tried == ["00000016.npz", "00000024.npz"]
    assert parts(there) == parts(tmp_path / "whole")


def test_built_in_estimators_give_the_same_bytes_in_small_batches(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All of one block against four runs at a time, with beliefs that are judged."""
    names = {name: NamedEstimator(name) for name in ("ekf", "enkf", "point-mass", "particle", "exact")}
    several = experiment(names, runs=10, beliefs=True)
    run(several, tmp_path / "small", timing=False)
    monkeypatch.setattr(saving.Pace, "batch", lambda pace, most: most)
    run(several, tmp_path / "large", timing=False)
    assert parts(tmp_path / "small") == parts(tmp_path / "large")


def test_what_is_unfinished_goes_when_it_is_to_be_made_anew(tmp_path: Path) -> None:
    """Without resuming, with another seed, or where it is damaged: nothing of it is taken."""
    for changes, how in (({}, {"resume": False}), ({"seed": 5}, {}), ({}, {})):
        with stopped():
            run(experiment({"stops": Stops(22)}), tmp_path / "a", timing=False)
        (begun,) = parts(tmp_path / "a")
        if not changes and not how:
            (tmp_path / "a" / begun).write_bytes(b"damaged")
        estimator = Stops(1000)
        run(experiment({"stops": estimator}, **changes), tmp_path / "a", timing=False, **how)
        assert estimator.updates >= BLOCK + 7
        assert {path.rpartition("/")[2] for path in parts(tmp_path / "a")} == {
            "00000000-00000040.npz",
            "00000040-00000047.npz",
        }
        for path in (tmp_path / "a").rglob("*.npz"):
            path.unlink()


def test_more_runs_go_on_where_fewer_ended(tmp_path: Path) -> None:
    run(experiment({"stops": Stops(1000)}, runs=30), tmp_path, timing=False)
    estimator = Stops(1000)
    run(experiment({"stops": estimator}, runs=40), tmp_path, timing=False)
    assert estimator.updates == 10 + 3
    assert {path.name for path in tmp_path.rglob("parts/**/*.npz")} == {"00000000-00000040.npz"}


def test_runs_lost_in_a_row_are_counted_alike(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is saved of a plug-in never ends with a run that was lost."""
    monkeypatch.setattr(guard, "MAX_LOST_IN_A_ROW", 3)
    lost = (5, 6, 11, 12, 13)
    (tmp_path / "slow.py").write_text(
        PLUGIN.replace("{LOST}", str(first_draws(lost))).replace("{SECONDS}", "0")
    )
    plugin = experiment({"slow": NamedEstimator(f"{tmp_path}/slow.py:Slow")}, runs=20, timeout=5.0)
    written: list[int] = []
    monkeypatch.setattr(
        Unfinished, "write", lambda unfinished, place, part: written.append(len(part["status"]))
    )
    results = run(plugin, tmp_path / "out", timing=False)
    (trials,) = results.trials
    wanted = ["ok" if k < 11 and k not in lost else "error" if k < 14 else "skipped" for k in range(20)]
    assert trials.status.tolist() == [Status(name).code for name in wanted]
    assert written
    assert not {count - 1 for count in written} & set(lost)


QUICK = "saving.SAVE_INTERVAL_S, saving.BATCH_S = 0.2, 0.1"
HERE, WORKERS = ("1", QUICK, "0.02", "80"), ("2", "", "0.2", "100")  # those do not see what is set here


@pytest.mark.parametrize(
    ("workers", "setting", "seconds", "runs"), [HERE, pytest.param(*WORKERS, marks=pytest.mark.study)]
)
def test_a_run_that_is_stopped_goes_on(
    tmp_path: Path, workers: str, setting: str, seconds: str, runs: str
) -> None:
    """Ctrl-C while a slow part is in hand: what was saved is not done again."""
    (tmp_path / "slow.py").write_text(PLUGIN.replace("{LOST}", "()").replace("{SECONDS}", seconds))
    (tmp_path / "study.toml").write_text(STUDY.replace("150", runs))
    program, out = tmp_path / "program.py", tmp_path / "out"
    program.write_text(
        f"import rangefix.evaluation.trials.saving as saving\n{setting}\n"
        "from rangefix.evaluation import load_study, run\n"
        'if __name__ == "__main__":\n'
        f"    study = load_study({str(tmp_path / 'study.toml')!r})\n"
        f"    run(study, {str(out)!r}, timing=False, workers={workers})\n"
    )
    begun = subprocess.Popen([sys.executable, str(program)], stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 100
    while not [*out.rglob("parts/slow*/*/*.npz")] and begun.poll() is None and time.monotonic() < deadline:
        time.sleep(0.05)
    begun.send_signal(signal.SIGINT)
    _, said = begun.communicate(timeout=60)
    saved = [*out.rglob("parts/slow*/*/*.npz")]
    assert len(saved) == 1, said
    done = int(saved[0].stem.rpartition("-")[2])
    assert 0 < done < int(runs)
    (tmp_path / "log").unlink()
    assert subprocess.run([sys.executable, str(program)], check=False, capture_output=True).returncode == 0
    again = {*map(float, (tmp_path / "log").read_text().split())}
    assert again == set(
        first_draws([0, 1, *range(done, int(runs))])
    )  # the first two are tried, to see how long they take
