"""Results in blocks and as tables, and folders that cannot be written."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from rangefix.evaluation import Experiment, NamedEstimator, ResultsError, load, mean_interval, run, summarise
from rangefix.evaluation.consistency.intervals import Moments
from rangefix.evaluation.results import dataframes, results
from rangefix.filters import Estimate

from ..conftest import PriorOnly, make_problem


@dataclass(frozen=True)
class Vast(PriorOnly):
    """Says a number beyond sense in the fourth of the runs that it is given."""

    name: str = ""
    size: float = 0.0

    def estimate(self, belief):
        estimate = super().estimate(belief)
        told = np.array(getattr(estimate, self.name))
        told[3] = self.size
        return estimate._replace(**{self.name: told})


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    folder = tmp_path_factory.mktemp("results") / "out"
    estimators = {
        "point-mass": NamedEstimator("point-mass", {"cell": 0.2}),
        "wild": lambda p: PriorOnly(p, 0.5, 0.1, 1.0),
    }
    made = Experiment(make_problem(), estimators, runs=95, beam_sets=[[1], [1, 2, 3]], block=10)
    run(made, folder, timing=False)
    return folder


@pytest.mark.parametrize("name", Estimate._fields)
@pytest.mark.parametrize("size", [1e101, -1e308])
def test_numbers_beyond_sense_are_a_failed_run_that_can_be_read(tmp_path, name, size):
    """An estimate beyond 1e100 in run 3 of 10 costs that run alone, in its own words; folders hold inf."""
    made = Experiment(make_problem(), {"wild": lambda p: Vast(p, 0.5, 0.1, 1.0, name, size)}, runs=10)
    run(made, tmp_path, timing=False)
    trials = load(tmp_path).get("wild")
    assert np.flatnonzero(trials.status).tolist() == [3]
    assert "an estimate is beyond 1e+100 at measurement 1" in trials.reasons[3]
    assert np.isinf(getattr(trials, name)[3]).any()


def test_moments_of_chunks_are_those_of_all():
    samples = np.exp(np.random.default_rng(1).normal(size=1000))
    moments = Moments()
    for chunk in np.split(samples, [1, 3, 400, 400, 999]):
        moments.add(chunk)
    assert moments.interval() == pytest.approx(mean_interval(samples), rel=1e-12)


def test_rows_in_blocks_are_those_in_memory(study, monkeypatch):
    """Read in blocks of 30 runs that do not fit the parts of 10, and in one piece: the same to 1e-9."""
    whole = [row.flat() for row in summarise(load(study))]
    monkeypatch.setattr(results, "MAX_RUNS_IN_MEMORY", 30)
    blocks = [row.flat() for row in summarise(load(study))]
    for one, other in zip(whole, blocks, strict=True):
        assert one.keys() == other.keys()
        for name, value in one.items():
            if isinstance(value, str):
                assert other[name] == value
            else:
                assert other[name] == pytest.approx(value, rel=1e-9, abs=1e-12, nan_ok=True), name


def test_large_results_are_read_when_asked_for(study, monkeypatch):
    monkeypatch.setattr(results, "MAX_RUNS_IN_MEMORY", 30)
    lazy = load(study)
    assert not {"truth", "trials"} & vars(lazy).keys()
    some = lazy.source.trials("wild", "1", 25, 47)
    np.testing.assert_array_equal(some.mean, lazy.get("wild", "1").mean[25:47])
    assert "trials" not in vars(lazy)
    held = lazy.in_memory()
    np.testing.assert_array_equal(held.source.world(25, 47)[0], lazy.truth[25:47])
    with pytest.raises(KeyError, match="there are estimators point-mass, wild"):
        lazy.get("nobody")


def test_dataframe(study):
    pytest.importorskip("pandas", reason="pandas is not installed: pip install 'rangefix[frames]'")
    loaded = load(study)
    frame = loaded.to_dataframe()
    assert len(frame) == 2 * 2 * 95
    row = frame[(frame.estimator == "wild") & (frame.beams == "1") & (frame.run == 7)].iloc[0]
    assert row.x1 == loaded.get("wild", "1").mean[7, 0, 0]
    assert row.x2_error == row.x2_true - row.x2
    assert (row.status, row.P_x2_x2) == ("ok", 1.5)


def test_xarray(study):
    pytest.importorskip("xarray", reason="xarray is not installed: pip install 'rangefix[frames]'")
    loaded = load(study)
    dataset = loaded.to_xarray()
    one = dataset["mean"].sel(estimator="wild", beams="1+2+3", run=7, component="x2")
    assert float(one.item()) == loaded.get("wild").mean[7, 0, 1]
    assert dataset.measurement.dims == ("run", "step", "beam")
    moving = dataframes.to_xarray(
        SimpleNamespace(names=("v1", "heading")), loaded.truth, loaded.measurement, loaded.trials, {}
    )
    units = [each["mean"].attrs["units"] for each in (dataset, moving)]
    assert units == ["m, m", "m/s, rad"] == [each.truth.attrs["units"] for each in (dataset, moving)]


def test_a_missing_library_is_one_line(study, monkeypatch):
    def missing(name):
        raise ModuleNotFoundError(name)

    monkeypatch.setattr(dataframes, "import_module", missing)
    with pytest.raises(ResultsError, match=r"needs pandas: pip install 'rangefix\[frames\]'"):
        load(study).to_dataframe()
    with pytest.raises(ResultsError, match="needs xarray"):
        load(study).to_xarray()


FULL = """
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (4000, 4000))
from rangefix.cli import main
main(["run", "point", "--runs", "200", "--out", "out"])
"""


def test_no_room_is_one_line(tmp_path):
    """Files may not grow beyond 4000 bytes, as on a full disk: exit code 2, one line, nothing in halves."""
    said = subprocess.run([sys.executable, "-c", FULL], cwd=tmp_path, capture_output=True, text=True)
    assert (said.returncode, said.stdout) == (2, "")
    assert said.stderr.count("\n") == 1
    assert said.stderr.startswith("rangefix: cannot write out/")
    assert not list(tmp_path.rglob("*.tmp"))


def test_a_folder_that_is_read_only(study, monkeypatch):
    """One line from whatever is written first; what is there stays readable."""

    def refuse(self, *arguments):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("pathlib.Path.write_bytes", refuse)
    monkeypatch.setattr("rangefix.evaluation.results.files._write_nameless", lambda *arguments: False)
    with pytest.raises(ResultsError, match=r"cannot write .*manifest.json: Permission denied"):
        run(Experiment(make_problem(), {"ekf": NamedEstimator("ekf")}, runs=3), study)
    assert load(study).runs == 95


def test_results_and_trials_show_what_they_are(study):
    """A few lines instead of every number; a page escapes what a label holds."""
    loaded = load(study)
    loaded.manifest["name"] = "<b>mine</b>"
    assert repr(loaded).splitlines() == [
        f"Results of <b>mine</b>: 95 runs, seed 1, in {study}",
        "  estimators: point-mass, wild",
        "  beams: 1, 1+2+3",
    ]
    assert "trials" not in vars(loaded), "nothing is read to say what it is"
    assert repr(loaded.in_memory()).splitlines()[0].endswith("seed 1, in memory")
    assert repr(loaded.get("wild")) == (
        "Trials of wild on beams 1+2+3: 95 x 1 x 2 runs, steps and components; 95 ok"
    )
    page = loaded._repr_html_()
    assert "<b>" not in page
    assert page.count("<tr>") == 5
    assert "<td>wild</td><td>1+2+3</td><td>95</td>" in page


def test_the_page_of_a_large_study_reads_nothing(study, monkeypatch):
    monkeypatch.setattr(results, "MAX_RUNS_IN_MEMORY", 30)
    lazy = load(study)
    assert "95 runs" in lazy._repr_html_()
    assert not {"truth", "trials"} & vars(lazy).keys()
