"""Tables on the terminal."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Sequence

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from .evaluation.intervals import Interval, uniform_p_value
from .evaluation.paper import BAND, CELLS, Paper
from .evaluation.summary import Row
from .evaluation.units import factor, unit
from .evaluation.verdict import name_beams, overconfident, short, verdict

NARROW = 130  # columns; below, the table of a study has fewer
WIDTH = 150  # where the output is not a terminal


def console() -> Console:
    """Standard output; as wide as the terminal, or WIDTH. Labels and titles are shown as they are."""
    width = None if sys.stdout.isatty() else WIDTH
    return Console(width=width, highlight=False, markup=False, emoji=False)


def new_table(title: str, columns: Iterable[str], left: int = 1) -> Table:
    """An empty table whose first `left` columns stand left and the others right."""
    table = Table(title=title, box=SIMPLE_HEAD, title_justify="left", title_style="bold", padding=(0, 1))
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if i < left else "right", no_wrap=i >= left)
    return table


def table1(paper: Paper) -> Table:
    """The paper's Table 1: noise-free values beside the printed ones, with the band over noise draws."""
    low, high = BAND
    title = (
        f"Table 1: conditional standard deviations, m (cells of {CELLS[-1]:g} m, {paper.draws} noise draws)"
    )
    columns = (
        "beams",
        "",
        "noise-free",
        "paper prints",
        f"{low:g}-{high:g} % of draws",
        "paper's percentile",
    )
    table = new_table(title, columns, left=2)
    for row in paper.rows:
        for i, inside in enumerate(row.in_band()):
            first, last = row.percentile[i]
            table.add_row(
                row.beams if i == 0 else "",
                ("x1", "x2")[i],
                f"{row.std[i]:.4f}",
                row.printed[i],
                f"{row.band[i, 0]:.4f} - {row.band[i, 1]:.4f}",
                f"{first:.0f} - {last:.0f}" + ("" if inside else " outside"),
                end_section=i == 1,
            )
    return table


def table1_notes(paper: Paper) -> list[str]:
    """What must be said with Table 1."""
    agreeing = round(paper.agreeing * paper.draws)
    outside = sum(not inside for row in paper.rows for inside in row.in_band())
    if outside:
        inside = f"All printed figures but {outside} lie in their bands."
    else:
        inside = "Every printed figure lies in its band."
    return [
        "The paper prints one unstated draw of the noise and cuts off: 0.64 is anything from 0.64 to 0.65,"
        " hence a range of percentiles.",
        f"{inside} All 14 at once come out for {agreeing} of {paper.draws} draws"
        + ("." if agreeing else ": the rows hardly come from a single draw."),
    ]


def _interval(interval: Interval) -> str:
    if not math.isfinite(interval.value):
        return short(interval.value)
    return f"{short(interval.value)} [{short(interval.low)}, {short(interval.high)}]"


def comparison(rows: Sequence[Row], title: str, width: int = WIDTH) -> Table:
    """The comparison of a study: true and claimed standard deviations, ANEES / n, time, and the verdict.

    Of many measurements it shows the last. On a narrow screen the verdict stands below the figures, and
    intervals, energy scores and times are left out: they are in `summary.csv`.
    """
    names, planned, narrow = rows[0].names, rows[0].planned, width < NARROW
    deviations = [f"{name} std, {unit(name)}\ntrue / claimed" for name in names]
    columns = ["\nestimator", f"ok of\n{planned}", *deviations]
    columns += ["\nANEES/n"] if narrow else ["ANEES/n\n[95 %]", "energy\nscore, m", "ms per\nupdate"]
    table = new_table(title, columns)
    if not narrow:
        table.add_column("\nverdict", justify="left", min_width=24)
    end = max(row.step for row in rows)
    sets = list(dict.fromkeys((row.beams, row.step) for row in rows if row.step == end))
    for beams, step in sets:
        last = f", after the last of {end + 1} measurements" if end else ""
        table.add_row(f"{name_beams(beams)}{last}", style="bold")
        for row in rows:
            if (row.beams, row.step) == (beams, step):
                style = "bold red" if overconfident(row) else ""
                table.add_row(*_cells(row, narrow), style=style)
                if narrow:
                    table.add_row(f"  {verdict(row)}", style=style)
        table.add_section()
    return table


def _cells(row: Row, narrow: bool) -> list[str]:
    triples = zip(row.g, row.p, map(factor, row.names), strict=True)
    cells = [
        f"  {row.estimator}",
        str(row.ok),
        *(f"{short(k * g.sqrt().value)} / {short(k * p.sqrt().value)}" for g, p, k in triples),
    ]
    if narrow:
        return [*cells, short(row.anees.value)]
    return [
        *cells,
        _interval(row.anees),
        short(row.scores.energy.value) if row.ok else "-",
        short(1e3 * row.seconds) if math.isfinite(row.seconds) else "-",
        verdict(row),
    ]


def beliefs(rows: Sequence[Row]) -> Table | None:
    """What samples of the beliefs say, after the last measurement; None where none were sampled."""
    end, names = max(row.step for row in rows), rows[0].names
    sampled = [row for row in rows if row.step == end and row.beliefs is not None]
    if not sampled:
        return None
    deviations = [f"{name} std, {unit(name)}\nwhole / main mode" for name in names]
    columns = [
        "\nestimator",
        *deviations,
        "share of\nmain mode",
        "energy score, m\nclaim / belief",
        "\nranks, p",
    ]
    table = new_table("Beliefs: 99 samples of each", columns)
    for beams in dict.fromkeys(row.beams for row in sampled):
        table.add_row(name_beams(beams), style="bold")
        for row in (row for row in sampled if row.beams == beams):
            table.add_row(*_belief_cells(row))
        table.add_section()
    return table


def _belief_cells(row: Row) -> list[str]:
    found = row.beliefs
    assert found is not None
    triples = zip(found.whole, found.mode, map(factor, row.names), strict=True)
    return [
        f"  {row.estimator}",
        *(f"{short(k * whole.sqrt().value)} / {short(k * mode.sqrt().value)}" for whole, mode, k in triples),
        f"{100 * found.share.value:.3g} %",
        f"{short(row.scores.energy.value)} / {short(found.energy.value)}",
        short(uniform_p_value(found.ranks[-1])),
    ]
