"""The comparison of a study as a table for a paper or a page: LaTeX, Markdown or CSV."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Iterable, Sequence
from itertools import groupby
from typing import NamedTuple

from ...errors import counted, printable, suggestion
from ..consistency.formatting import beams_in_words, factor, format_number, scaled, unit
from ..consistency.intervals import UNKNOWN, Interval
from ..consistency.metrics import COMPONENT
from ..consistency.row import Row, csv_cell
from ..consistency.summarise import summarise
from ..consistency.verdict import decide
from ..results import Results, ResultsError

LATEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{",
    "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": r"\textless{}",
    ">": r"\textgreater{}", "|": r"\textbar{}",
}  # fmt: skip
MARKDOWN = re.compile(r"([\\`*_{}\[\]<>#|~$])")
SUFFIXES = {".tex": "latex", ".md": "markdown", ".csv": "csv"}


class Column(NamedTuple):
    """A column of figures.

    Attributes:
        name: In CSV; `_low` and `_high` follow for the interval.
        group: What it tells of, in words; columns side by side may share it.
        head: Which of these it is; "" if it stands alone.
        figures: A figure for each row, in the unit that `name` and `group` say.
        bounds: Whether intervals are shown where numbers are rounded.
    """

    name: str
    group: str
    head: str
    figures: list[Interval]
    bounds: bool = False


def comparison_table(results: Results, form: str = "markdown") -> str:
    r"""The estimators of a study after the last measurement: true and claimed deviations, ANEES / n, verdict.

    Args:
        results: Of a study.
        form: "latex" (a `tabular` for the package booktabs), "markdown", or "csv" (numbers in full, intervals
            in columns of their own).

    Returns:
        The table as text that ends with a new line. Labels are escaped, so that they are shown as they are.

    Raises:
        ResultsError: If there is no such form.
    """
    if form not in WRITERS:
        raise ResultsError(f"there is no table in the format {form!r}; {suggestion(form, WRITERS)}")
    rows = summarise(results)
    end = max(row.step for row in rows)
    sets = results.beam_sets
    last = sorted((row for row in rows if row.step == end), key=lambda row: sets.index(row.beams))
    return WRITERS[form](last, _columns(last), _caption(results, end))


def _caption(results: Results, end: int) -> str:
    """What the table shows, in one line."""
    name = results.manifest.get("title") or results.manifest.get("name") or "study"
    after = f", after the last of {end + 1} measurements" if end else ""
    runs = results.interruption or counted(results.runs, "run")
    return printable(f"{name}: {runs}{after}; 95 % intervals in brackets")


def _columns(rows: Sequence[Row]) -> list[Column]:
    """Standard deviations of each component, then the figures that a terminal shows, then the time."""
    columns = []
    variances: dict[str, list[tuple[Interval, ...]]] = {}
    if any(row.bound for row in rows):
        variances["bound"] = [row.bound or (UNKNOWN,) * len(row.names) for row in rows]
    variances |= {"true": [row.g for row in rows], "claimed": [row.p for row in rows]}
    for i, name in enumerate(rows[0].names):
        group = f"std of {name}, {unit(name)}"
        for head, of in variances.items():
            shown = [scaled(components[i].sqrt(), factor(name)) for components in of]
            columns.append(Column(_with_unit(f"{head}_std_{name}", unit(name)), group, head, shown))
    for metric, component in dict.fromkeys(each[:2] for row in rows for each in row.shown("terminal")):
        column = metric.column(component)
        figures = [metric.in_shown_unit(row.figures.get(column, UNKNOWN), component) for row in rows]
        label = metric.full_label(component)
        other = {"%": "percent", COMPONENT: unit(component)}.get(metric.unit, "")  # than in summary.csv
        columns.append(Column(_with_unit(column, other), label, "", figures, metric.honest is not None))
    if any(math.isfinite(row.seconds) for row in rows):
        times = [scaled(Interval(row.seconds, *row.seconds_range), 1e3) for row in rows]
        columns.append(Column("ms_per_update", "ms per update", "", times))
    return columns


def _with_unit(name: str, shown: str) -> str:
    """The name of a column of CSV with its unit, if there is one."""
    return f"{name}_{shown.replace('/', '_per_')}" if shown else name


def _cell(interval: Interval, bounds: bool) -> str:
    """A figure as plain text, with its interval if asked for; - where there is none."""
    value, low, high = interval
    if math.isnan(value):
        return "-"
    if bounds and math.isfinite(low + high):
        return f"{format_number(value)} [{format_number(low)}, {format_number(high)}]"
    return format_number(value)


def _lines(rows: Sequence[Row], columns: Sequence[Column]) -> list[list[str]]:
    """The cells of each row as plain text."""
    return [
        [
            row.estimator,
            str(row.ok),
            *(_cell(each.figures[k], each.bounds) for each in columns),
            decide(row).short,
        ]
        for k, row in enumerate(rows)
    ]


def _to_markdown(rows: Sequence[Row], columns: Sequence[Column], caption: str) -> str:
    def line(cells: Iterable[str]) -> str:
        return f"| {' | '.join(cells)} |"

    def plain(text: str) -> str:
        return MARKDOWN.sub(r"\\\1", printable(text))

    several = len({row.beams for row in rows}) > 1
    heads = ["estimator", *(["beams"] if several else []), f"ok of {rows[0].planned}"]
    heads += [f"{each.head} {each.group}".strip() for each in columns] + ["verdict"]
    text = 1 + several
    rule = [*[":--"] * text, *["--:"] * (len(heads) - text - 1), ":--"]
    lines = []
    for row, cells in zip(rows, _lines(rows, columns), strict=True):
        cells[1:1] = [beams_in_words(row.beams)] if several else []
        lines.append(line(map(plain, cells)))
    return "\n".join([plain(caption), "", line(map(plain, heads)), line(rule), *lines, ""])


def _to_latex(rows: Sequence[Row], columns: Sequence[Column], caption: str) -> str:
    groups = [(group, len(list(same))) for group, same in groupby(each.group for each in columns)]
    upper, rules, place = ["", ""], [], 3
    for group, width in groups:
        upper.append(rf"\multicolumn{{{width}}}{{c}}{{{_latex_words(group)}}}")
        if width > 1:
            rules.append(rf"\cmidrule(lr){{{place}-{place + width - 1}}}")
        place += width
    lower = ["estimator", f"ok of {rows[0].planned}", *(each.head for each in columns), "verdict"]
    lines = [
        f"% {caption.replace('%', 'per cent')}",
        r"% \usepackage{booktabs}",
        rf"\begin{{tabular}}{{l{'r' * (len(columns) + 1)}l}}",
        r"\toprule",
        " & ".join([*upper, r" \\"]).replace("&  \\\\", r"& \\"),
        *([" ".join(rules)] if rules else []),
        " & ".join(lower) + r" \\",
    ]
    several = len({row.beams for row in rows}) > 1
    beams = None
    for row, cells in zip(rows, _lines(rows, columns), strict=True):
        if row.beams != beams:
            beams = row.beams
            lines.append(r"\midrule")
            if several:
                lines.append(
                    rf"\multicolumn{{{len(lower)}}}{{l}}{{\textbf{{{_latex(beams_in_words(beams))}}}}} \\"
                )
        lines.append(
            " & ".join([_latex(cells[0]), *map(_latex_number, cells[1:-1]), _latex(cells[-1])]) + r" \\"
        )
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def _latex(text: str) -> str:
    """Text that LaTeX shows as it is."""
    return "".join(LATEX.get(letter, letter) for letter in printable(text))


def _latex_words(text: str) -> str:
    """Words of ours, whose components become symbols."""
    return re.sub(r"\b([xv])([12])\b", r"$\1_\2$", _latex(text))


def _latex_number(text: str) -> str:
    """A number, or one with its interval, in which minus signs and powers of ten are set as such."""
    if text == "-":
        return "--"
    text = re.sub(r"(-?[\d.]+)e\+?(-?)0*(\d+)", r"$\1 \\times 10^{\2\3}$", text)
    return re.sub(r"(?<![\d{$])-(?=[\d.])([\d.]+)", r"$-\1$", text).replace("inf", r"$\infty$")


def _to_csv(rows: Sequence[Row], columns: Sequence[Column], caption: str) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    heads = [head for each in columns for head in (each.name, f"{each.name}_low", f"{each.name}_high")]
    writer.writerow(["estimator", "beams", "planned", "ok", *heads, "verdict"])
    for k, row in enumerate(rows):
        figures = [end for each in columns for end in each.figures[k]]
        cells = [row.estimator, row.beams, row.planned, row.ok, *figures, decide(row).short]
        writer.writerow(map(csv_cell, cells))
    return text.getvalue()


WRITERS: dict[str, Callable[[Sequence[Row], Sequence[Column], str], str]] = {
    "latex": _to_latex, "markdown": _to_markdown, "csv": _to_csv,
}  # fmt: skip
