"""Where estimators fail: tables, the map, and the command that repeats a run."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from rangefix.evaluation import Results, load, nees, worst_runs
from rangefix.evaluation.figures.embedded.places import Places
from rangefix.evaluation.figures.embedded.worst import worst_figure
from rangefix.evaluation.report.tables import Line
from rangefix.evaluation.report.worst import MAP_ID, WhereItFails, repeat_command, where_it_fails

from .conftest import LABEL


@pytest.fixture(scope="module")
def results(study: Path) -> Results:
    return load(study)


@pytest.fixture(scope="module")
def fails(results: Results) -> WhereItFails:
    found = where_it_fails(results, worst_runs(results), 1)
    assert found is not None
    return found


def values(line: Line) -> list[str]:
    return [cell.value for cell in line.cells]


def test_the_worst_run_of_each_estimator_the_worst_first(results: Results, fails: WhereItFails) -> None:
    """Against the NEES of every trial; an estimator that never answered is not there."""
    largest = {}
    for trials in results.trials:
        if trials.ok.any():
            ratios = nees(results.errors(trials)[trials.ok, 0], trials.covariance[trials.ok, 0]) / 2
            largest[trials.estimator] = max(largest.get(trials.estimator, 0.0), float(ratios.max()))
    ((_, lines),) = fails.first.groups
    assert [line.name for line in lines] == sorted(largest, key=lambda label: -largest[label])
    assert LABEL not in largest
    told = [float(values(line)[2]) for line in lines]
    assert told == pytest.approx(sorted(largest.values(), reverse=True), rel=5e-3)
    assert str(fails.run) == values(lines[0])[0]


def test_a_line_says_truth_estimate_error_claim_and_readings(results: Results, fails: WhereItFails) -> None:
    """Of the worst run of all, from the arrays; readings are those of its beams alone."""
    line = fails.first.groups[0][1][0]
    run, beams = int(values(line)[0]), values(line)[1]
    label = {"beam 1": "1", "beams 1 + 2 + 3": "1+2+3"}[beams]
    trials = results.get(line.name, label)
    shown = line.cells[3]
    truth, estimate = results.truth[run, 0, 0], trials.mean[run, 0, 0]
    assert shown.value == f"{truth:.3g} \u2192 {estimate:.3g}"
    std = np.sqrt(trials.covariance[run, 0, 0, 0])
    assert shown.ends == f"error {truth - estimate:.3g}, std {std:.3g}"
    used = [0] if label == "1" else [0, 1, 2]
    assert values(line)[-1] == ", ".join(f"{each:.3g}" for each in results.measurement[run, 0, used])


def test_all_worst_runs_are_in_the_map_where_the_walls_say(results: Results, fails: WhereItFails) -> None:
    """Each line has a place in the figure; places keep the ratios of positions, 4 m by 6 m with one scale."""
    lines = [line for _, group in fails.all.groups for line in group]
    assert len(lines) == 3 * 10
    assert all(line.spot is not None and line.spot.figure == MAP_ID for line in lines)
    assert all(0 <= share <= 100 for line in lines if line.spot for share in line.spot.at)
    assert fails.figure is not None
    size = fails.figure.width, fails.figure.height
    runs = [line.spot.run for line in lines if line.spot]
    places = np.array([line.spot.at[:2] for line in lines if line.spot]) / 100 * size
    truths = results.truth[runs, 0] * [1, -1]  # downwards on the page
    scale = np.ptp(places, axis=0) / np.ptp(truths, axis=0)
    assert scale[0] == pytest.approx(scale[1], rel=0.01)
    np.testing.assert_allclose(places - places[0], (truths - truths[0]) * scale[0], atol=0.5)


def test_places_are_shares_of_the_figure() -> None:
    """Corners and middle of axes that fill a known part of it; what lies beyond stands at the rim."""
    figure = Figure(figsize=(4.0, 2.0))
    axes = figure.add_axes((0.1, 0.2, 0.5, 0.6))
    axes.set_xlim(0, 10)
    axes.set_ylim(-1, 1)
    places = Places(figure, axes).of([[0, -1], [10, 1], [5, 0], [-99, 99]])
    np.testing.assert_allclose(places, [[0.1, 0.8], [0.6, 0.2], [0.35, 0.5], [0.1, 0.2]], atol=1e-12)


def test_without_a_map_there_are_the_tables_alone(results: Results) -> None:
    found = where_it_fails(replace(results, scene={}), worst_runs(results), 1)
    assert found is not None
    assert found.figure is None
    assert all(line.spot is None for _, lines in found.all.groups for line in lines)


def test_where_nothing_answered_there_is_nothing_to_show(results: Results) -> None:
    assert where_it_fails(results, [], 1) is None


def test_many_estimators_are_all_in_the_tables(results: Results, fails: WhereItFails) -> None:
    """The marks of 24 estimators differ in colour or shape."""
    runs = [replace(run, estimator=f"e{k}") for k in range(30) for run in worst_runs(results, 1)[:2]]
    many = replace(results, estimators=tuple(f"e{k}" for k in range(30)))
    found = where_it_fails(many, runs, 1)
    assert found is not None
    assert len(found.first.groups[0][1]) == 30
    assert len({(mark.colour, mark.shape) for mark in found.marks}) == len(found.marks) == 24


def test_the_named_largest_value_is_that_of_gaussian_claims(results: Results, fails: WhereItFails) -> None:
    """For two components a NEES / n above x has probability exp(-x); of 120 runs on two sets none with 95 %.

    The worst is chosen over both sets. Of exact posteriors of a linear problem with the paper's seven sets
    the value for the runs of one set was exceeded in 19 % of studies of 40 runs, with two in 10 %.
    """
    assert len(results.beam_sets) == 2
    assert fails.rare == pytest.approx(-np.log(1 - 0.95 ** (1 / (2 * results.runs))), rel=1e-9)


def test_a_far_estimate_and_a_scan_stay_readable(results: Results) -> None:
    """An estimate a million metres off does not shrink the map; of 360 beams the ends are told."""
    run = worst_runs(results)[0]
    scan = np.r_[np.linspace(0.5, 9.25, 357), np.inf, np.inf, np.nan]
    far = replace(run, estimate=np.array([1e6, -1e6]), readings=scan, nees=np.inf)
    found = where_it_fails(replace(results, estimators=(run.estimator,)), [far], 1)
    assert found is not None
    (line,) = found.first.groups[0][1]
    assert values(line)[-1] == "360 beams, 0.5 to 9.25; 2 met no wall; 1 not measured"
    assert values(line)[2] == "\u221e"
    figure, _ = worst_figure(replace(results, estimators=(run.estimator,)), [far])
    assert figure.axes[0].get_xlim()[1] < 5


def test_the_command_that_repeats_a_run() -> None:
    """The study, its runs and seed, and what changes its world."""
    words = ["rangefix", "run", "a/paper.toml", "--map", "room:4x6", "--out", "r"]
    manifest = {"name": "paper", "runs": 9, "seed": 4, "command_line": words}
    again = "rangefix run a/paper.toml --map room:4x6 --out r --runs 9 --seed 4 --only-run"
    assert repeat_command(manifest) == again


def test_a_hostile_command_line_is_quoted() -> None:
    """What is copied from the page into a shell is one word each."""
    line = ["rangefix", "run", "a b;$(rm x).toml"]
    manifest = {"name": "s", "runs": 1, "seed": 0, "command_line": line}
    assert repeat_command(manifest).startswith("rangefix run 'a b;$(rm x).toml' --runs")
    assert repeat_command(manifest | {"command_line": []}) == ""


def test_the_page_tells_it(page: str) -> None:
    """The command with the number of the worst run, which the script may change, and the map once."""
    section = page.partition('<section id="worst">')[2].partition("</section>")[0]
    assert section.count("<img") == 1
    told = re.sub("<[^>]+>", "", section.partition("<pre>")[2].partition("</pre>")[0])
    assert re.fullmatch(r"rangefix run .* --runs 120 --seed 2 --only-run \d+", told)
