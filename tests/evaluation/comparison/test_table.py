"""The comparison as a table for a paper: the numbers of the rows, and labels that are shown as they are."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable

import numpy as np
import pytest

from rangefix.evaluation import Experiment, Results, ResultsError, comparison_table, decide, run, summarise
from rangefix.evaluation.comparison.table import _latex_number

from ..conftest import PriorOnly, make_problem

ODD = r"50 % of $x_1$ & {a|b} #1 ~^ \ <i> *"


@pytest.fixture(scope="module")
def results() -> Results:
    """Of an honest estimator and of one that claims a hundredth of its variance, on two sets of beams."""
    estimators: dict[str, Callable] = {
        "=honest": PriorOnly,
        ODD: lambda problem: PriorOnly(problem, scale=0.01),
    }
    experiment = Experiment(make_problem(), estimators, runs=40, beam_sets=[[1], [1, 2]], title="100 % mine")
    return run(experiment, timing=False)


def test_csv_holds_the_numbers_in_full(results: Results) -> None:
    """Standard deviations and ANEES / n with their intervals are those of the rows, to the last bit."""
    lines = list(csv.DictReader(io.StringIO(comparison_table(results, "csv"))))
    rows = sorted(summarise(results), key=lambda row: results.beam_sets.index(row.beams))
    assert len(lines) == len(rows) == 4
    for line, row in zip(lines, rows, strict=True):
        assert line["estimator"].removeprefix("'") == row.estimator
        assert (line["beams"], int(line["ok"])) == (row.beams, row.ok)
        assert float(line["true_std_x1_m"]) == row.g[0].sqrt().value
        assert float(line["claimed_std_x2_m_high"]) == row.p[1].sqrt().high
        assert [float(line[f"anees{end}"]) for end in ("", "_low", "_high")] == list(row.anees)
        assert line["verdict"] == decide(row).short
    assert lines[0]["estimator"] == "'=honest"  # no formula in a spreadsheet


def test_csv_has_one_number_to_a_name(results: Results) -> None:
    """What is called as in summary.csv is the same there; shares in per cent have another name."""
    rows = {(row.estimator, row.beams): row for row in summarise(results)}
    lines = list(csv.DictReader(io.StringIO(comparison_table(results, "csv"))))
    for line in lines:
        row = rows[line["estimator"].removeprefix("'"), line["beams"]]
        flat = {name: value for name, value in row.flat().items() if isinstance(value, float)}
        alike = [name for name in line if name in flat]
        assert {"anees_low", "energy_score"} < set(alike)
        np.testing.assert_array_equal([float(line[name]) for name in alike], [flat[name] for name in alike])
        assert float(line["share_improbable_percent_high"]) == 100 * row.improbable.high


def test_latex_is_a_tabular_of_equal_lines(results: Results) -> None:
    """Each line has as many cells as columns; labels are escaped; braces and environments match."""
    text = comparison_table(results, "latex")
    lines = text.splitlines()
    assert lines[0].startswith("% 100 per cent mine: 40 runs")
    columns = len(re.search(r"\\begin\{tabular\}\{(\w+)\}", text)[1])  # type: ignore[index]
    for line in lines:
        if line.endswith(r"\\"):
            spans = [int(span) for span in re.findall(r"\\multicolumn\{(\d+)\}", line)]
            cells = len(re.findall(r"(?<!\\)&", line)) + 1
            assert cells + sum(spans) - len(spans) == columns, line
    assert lines[-1] == r"\end{tabular}"
    shown = r"50 \% of \$x\_1\$ \& \{a\textbar{}b\} \#1 \textasciitilde{}\textasciicircum{} \textbackslash{} "
    assert f"{shown}\\textless{{}}i\\textgreater{{}} * & 40" in text
    assert r"\textbf{beams 1 + 2}" in text
    assert r"\multicolumn{2}{c}{std of $x_1$, m}" in text
    plain = re.sub(r"\\[{}]", "", text)
    assert plain.count("{") == plain.count("}")
    assert "DO NOT TRUST" in text


def test_markdown_has_a_line_for_each_row(results: Results) -> None:
    text = comparison_table(results)
    table = [line for line in text.splitlines() if line.startswith("|")]
    assert len({len(re.findall(r"(?<!\\)\|", line)) for line in table}) == 1
    assert len(table) == 2 + 4
    assert r"50 % of \$x\_1\$ & \{a\|b\} \#1 \~^ \\ \<i\> \*" in text


@pytest.mark.parametrize(
    ("plain", "shown"),
    [
        ("-0.5", "$-0.5$"),
        ("1.2e+06", r"$1.2 \times 10^{6}$"),
        ("-3e-07", r"$-3 \times 10^{-7}$"),
        ("inf", r"$\infty$"),
        ("1.02 [0.9, 1.1]", "1.02 [0.9, 1.1]"),
        ("-1 [-2, 0]", "$-1$ [$-2$, 0]"),
        ("-", "--"),
    ],
)
def test_numbers_in_latex(plain: str, shown: str) -> None:
    assert _latex_number(plain) == shown


def test_estimators_without_good_runs_have_dashes(results: Results) -> None:
    """No `nan` in a table for readers."""

    def never(problem: object) -> object:
        raise RuntimeError("no")

    failed = run(Experiment(make_problem(), {"prior": PriorOnly, "bad": never}, runs=8), timing=False)
    assert not np.isfinite(summarise(failed)[1].anees.value)
    for form in ("latex", "markdown"):
        assert "nan" not in comparison_table(failed, form)
    assert "no answer" in comparison_table(failed)


def test_an_unknown_format_is_refused(results: Results) -> None:
    with pytest.raises(ResultsError, match=r"no table in the format 'latx'; did you mean latex\?"):
        comparison_table(results, "latx")
