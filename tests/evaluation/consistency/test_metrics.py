"""The table of figures: one entry adds a figure everywhere, also from another package."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rangefix.cli.main import main
from rangefix.evaluation import (
    Row,
    check_gates,
    credibility,
    load,
    parse_gates,
    share_interval,
    to_csv,
    write_report,
)
from rangefix.evaluation.comparison.compare import compare
from rangefix.evaluation.consistency import metrics as table
from rangefix.evaluation.consistency.gates import need_sound
from rangefix.evaluation.consistency.metrics import COMPONENT, METRICS, Metric, RunBlock, metrics

ERRORS = np.random.default_rng(1).normal(size=(200, 2))
EVERYWHERE = ("csv", "terminal", "report", "compare")


def first_error(runs: RunBlock) -> Any:
    return np.abs(runs.errors[:, runs.names.index("x1")])


MAE = Metric("mae_first", "m", first_error, "mean", shown=EVERYWHERE, label="mean absolute error")


@pytest.fixture
def offered(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What installed packages offer."""
    found: dict[str, Any] = {"mae": MAE}
    monkeypatch.setattr(table, "extensions", lambda group: found if group == "rangefix.metrics" else {})
    return found


def row(label: str = "mine") -> Row:
    return credibility(ERRORS, np.zeros((200, 2)), np.eye(2), label=label)


def test_a_metric_of_another_package_is_a_column_and_a_gate(offered: dict[str, Any]) -> None:
    found = row()
    (line,) = csv.DictReader(io.StringIO(to_csv([found])))
    expected = np.abs(ERRORS[:, 0]).mean()
    assert float(line["mae_first"]) == found.flat()["mae_first"] == pytest.approx(expected, rel=1e-12)
    assert float(line["mae_first_low"]) < expected < float(line["mae_first_high"])
    gates = parse_gates([f"mae_first=:{expected + 0.01}", f"mae_first=:{expected - 0.01}"])
    need_sound(gates, ["mine"], ("x1", "x2"), beliefs=False)
    assert [line.passed for line in check_gates(gates, [found])] == [True, False]


def test_without_the_package_there_is_no_such_figure() -> None:
    """Negative control."""
    assert "mae_first" not in row().flat()
    with pytest.raises(ValueError, match="no figure 'mae_first'"):
        check_gates(parse_gates(["mae_first=:1"]), [row()])


def test_it_is_shown_where_it_says(
    offered: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In JSON, as a gate, on the terminal, in the report and run by run, from the command line."""
    out = tmp_path / "out"
    command = ["run", "point", "--runs", "20", "--out", str(out), "--gate", "mae_first=:100"]
    with pytest.raises(SystemExit) as end:
        main([*command, "--json"])
    assert end.value.code == 0
    document = json.loads(capsys.readouterr().out)
    values = [line["mae_first"] for line in document["rows"]]
    assert all(0 <= value < 100 for value in values)  # 0 where the prior has its mean at the truth
    assert all(gate["passed"] for gate in document["gates"])
    with pytest.raises(SystemExit):
        main(command)
    shown = capsys.readouterr().out
    assert "absolute error, m" in shown
    assert f"{values[0]:.3g}" in shown
    page = write_report(out, tmp_path / "report.html").read_text(encoding="utf-8")
    assert "mean absolute error, m" in page
    compared = compare(load(out), load(out))
    assert "mae_first" in {difference.figure for difference in compared.differences}
    assert {each.label for each in compared.differences} >= {"mean absolute error", "x1 true std", "ANEES/n"}


@pytest.mark.parametrize(
    ("average", "per_run", "expected"),
    [
        ("mean", lambda runs: runs.errors, ERRORS.mean(0)),
        ("root mean", lambda runs: runs.errors**2, np.sqrt((ERRORS**2).mean(0))),
        ("share", lambda runs: runs.errors > 0.5, (ERRORS > 0.5).mean(0)),
        (
            "ratio of means",
            lambda runs: (runs.errors**2, np.abs(runs.errors)),
            (ERRORS**2).mean(0) / np.abs(ERRORS).mean(0),
        ),
    ],
)
def test_each_component_has_its_figure(
    offered: dict[str, Any], average: Any, per_run: Any, expected: Any
) -> None:
    offered["mine"] = Metric("mine", COMPONENT, per_run, average)
    figures = row().of_components("mine")
    assert [figure.value for figure in figures] == pytest.approx(expected.tolist(), rel=1e-12)
    assert all(figure.low < figure.value < figure.high for figure in figures)


def test_a_share_has_wilsons_interval_and_counts_what_it_is_given(offered: dict[str, Any]) -> None:
    offered["far"] = Metric("far", "", lambda runs: runs.errors[:50, 0] > 1, "share")
    assert row().figures["far"] == share_interval(int((ERRORS[:50, 0] > 1).sum()), 50)


def test_an_honest_value_has_a_p_value(offered: dict[str, Any]) -> None:
    offered["mine"] = Metric("mine", "m", lambda runs: runs.errors[:, 0], "mean", honest=5.0)
    assert row().p_values["mine"] < 1e-9


def test_what_runs_do_not_tell_is_no_figure(offered: dict[str, Any]) -> None:
    offered["mine"] = Metric("mine", "m", lambda runs: None, "mean")
    assert not [name for name in row().flat() if name.startswith("mine")]


def test_a_wrong_shape_is_named(offered: dict[str, Any]) -> None:
    offered["mine"] = Metric("mine", "m", lambda runs: runs.covariance, "mean")
    with pytest.raises(ValueError, match=r"metric 'mine': per_run gives \(200, 2, 2\) for errors \(200, 2\)"):
        row()


@pytest.mark.parametrize(
    ("offer", "says"),
    [("no metric", "'mine' is no Metric"), (METRICS[0], "'mine' has a name that is taken")],
)
def test_what_cannot_be_taken_is_left_out_with_a_warning(
    offered: dict[str, Any], offer: Any, says: str
) -> None:
    offered["mine"] = offer
    with pytest.warns(RuntimeWarning, match=says):
        found = metrics()
    assert found == (*METRICS, MAE)


def test_names_of_ours_are_unique() -> None:
    assert len({metric.name for metric in METRICS}) == len(METRICS)


def test_rows_show_what_they_are(offered: dict[str, Any]) -> None:
    """One to ten lines; a page escapes what a label holds."""
    text, page = repr(row()), row("<script>&")._repr_html_()
    assert text.splitlines()[0] == "Row of mine, measurement 1: 200 of 200 runs ok"
    assert "ANEES/n (1 = honest): " in text
    assert "mean absolute error, m: " in text
    assert 1 <= text.count("\n") < 10
    assert "<script>" not in page
    assert "&lt;script&gt;&amp;" in page
    assert "mean error of x1, m (0 = honest)" in page
