"""Commands killed at random moments: nothing is left behind, and what is resumed has the same bytes."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from ..evaluation.monte_carlo.clusters import cluster, wait_for_workers
from .victims import Victim, environment, files, moments

pytestmark = [
    pytest.mark.chaos,
    pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="there is no /proc"),
]
KILLS = 20  # of each signal
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
PLUGIN = """
import time
import numpy as np
from rangefix.filters import Estimate

class Slow:
    def __init__(self, problem): pass
    def init(self, prior, rng): return rng.standard_normal(2)
    def predict(self, belief, control, rng): return belief
    def update(self, belief, measurement, rng):
        time.sleep(0.0005)
        return belief
    def estimate(self, belief): return Estimate(belief, np.eye(2), 0.0)
"""
STUDY = """
name = "kills"
runs = 1400
timeout_s = 20.0
[map]
kind = "rectangle"
width_m = 4.0
length_m = 6.0
[sensor]
bearings_deg = [326.3, 0.0, 33.7]
std_m = 0.05
[[estimators]]
name = "ekf"
[[estimators]]
name = "point-mass"
options.cell_m = 0.2
[[estimators]]
name = "slow.py:Slow"
"""


NOT_BEGUN = "Could not import runpy module"


@dataclass
class Tally:
    """What came of kills.

    Attributes:
        killed: How often the command was killed before its end.
        whole: How often it came to its end, so that the next began anew.
        codes: Exit code -> how often.
    """

    killed: int = 0
    whole: int = 0
    codes: dict[int, int] = field(default_factory=dict)

    def note(self, code: int, said: str, how: signal.Signals) -> bool:
        """Whether the command was killed; a traceback or another code than that of the signal is a fault.

        Python ends by SIGINT, which a shell shows as 130, where it was interrupted within `exec`, as when it
        imports; and by the signal itself before the command has begun to handle it. Until it has come to our
        first line, Python shows where it was, and ends with 1 if it could not even load what runs modules.
        """
        assert "Traceback" not in said or "rangefix" not in said, said
        assert code in (0, 130, -signal.SIGINT, -how) or said.startswith(NOT_BEGUN), said
        self.codes[code] = self.codes.get(code, 0) + 1
        self.killed += code != 0
        self.whole += code == 0
        return code != 0


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study with a plug-in."""
    folder = tmp_path_factory.mktemp("kills")
    (folder / "slow.py").write_text(PLUGIN)
    (folder / "study.toml").write_text(STUDY)
    return folder / "study.toml"


@pytest.fixture(scope="module")
def undisturbed(study: Path) -> tuple[Path, float]:
    """Results that nobody disturbed, with figures and a report, and how long the run took."""
    folder = study.with_name("undisturbed")
    seconds = victim(study, folder, "run", str(study), "--out", str(folder)).finish()
    for command in ("plot", "report"):
        victim(study, folder, command, str(folder)).finish()
    return folder, seconds


def victim(study: Path, folder: Path, *arguments: str) -> Victim:
    """A command about a folder."""
    return Victim(arguments, study.with_name("temporary"), folder)


def kill_and_resume(command: Victim, how: signal.Signals, seed: str, longest: float, whole: Path) -> Tally:
    """Kill a run, go on with it, kill it again; whenever it comes to its end, compare, and begin anew."""
    tally = Tally()
    for after in moments(f"{seed} {how.name}", longest):
        killed = tally.note(*command.kill(how, after), how)
        assert not command.left()
        if not killed or tally.killed == KILLS:
            if killed:
                command.finish()
            assert files(command.results, "parts/**/*.npz") == files(whole, "parts/**/*.npz")
            subprocess.run(["rm", "-r", str(command.results)], check=True)
        if tally.killed == KILLS:
            break
    return tally


@pytest.mark.parametrize("how", SIGNALS, ids=lambda how: how.name)
@pytest.mark.parametrize("workers", [1, 2])
def test_runs(
    how: signal.Signals, workers: int, study: Path, undisturbed: tuple[Path, float], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    command = victim(study, out, "run", str(study), "--out", str(out), "--workers", str(workers))
    print(workers, how, kill_and_resume(command, how, f"run {workers}", undisturbed[1], undisturbed[0]))


@pytest.fixture
def dask(tmp_path: Path) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """A scheduler and two workers, whose children are known by their folder of temporary files."""
    (tmp_path / "workers").mkdir()
    variables = environment(tmp_path / "workers" / "temporary")
    with cluster(tmp_path / "workers", [variables, variables]) as (address, workers):
        wait_for_workers(address, 2)
        yield address, workers


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning")
@pytest.mark.parametrize("how", SIGNALS, ids=lambda how: how.name)
def test_clients_of_a_cluster(
    how: signal.Signals,
    study: Path,
    undisturbed: tuple[Path, float],
    dask: tuple[str, list[subprocess.Popen[bytes]]],
    tmp_path: Path,
) -> None:
    """The workers go on to wait for others; the processes that they have started for plug-ins end."""
    address, workers = dask
    out = tmp_path / "out"
    command = victim(study, out, "run", str(study), "--out", str(out), "--cluster", address)
    print("client", how, kill_and_resume(command, how, "client", undisturbed[1], undisturbed[0]))
    assert all(worker.poll() is None for worker in workers)


@pytest.mark.parametrize("how", SIGNALS, ids=lambda how: how.name)
@pytest.mark.parametrize("name", ["plot", "report", "compare"])
def test_what_shows_results(
    how: signal.Signals, name: str, study: Path, undisturbed: tuple[Path, float], tmp_path: Path
) -> None:
    """Figures and page are as without the kills, and nothing else in the folder has changed."""
    whole = undisturbed[0]
    out = tmp_path / "out"
    subprocess.run(["cp", "-r", str(whole), str(out)], check=True)
    command = victim(study, out, name, str(out), *([str(whole)] if name == "compare" else []))
    longest, tally = command.finish(), Tally()
    for after in moments(f"{name} {how.name}", longest):
        tally.note(*command.kill(how, after), how)
        assert not command.left()
        if tally.killed == KILLS:
            break
    command.finish()
    assert files(out, "*") == files(whole, "*")
    print(name, how, tally)
