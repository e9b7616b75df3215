"""The paper's Table 1."""

from __future__ import annotations

from rich.table import Table

from ...evaluation.paper import BAND, CELLS, Paper
from ..screen import new_table


def table1(paper: Paper) -> Table:
    """The paper's Table 1: noise-free values beside the printed ones, with the band over noise draws."""
    low, high = BAND
    cells = f"cells of {CELLS[-1]:g} m, {paper.draws} noise draws"
    columns = [
        "beams",
        "",
        "noise-free",
        "paper prints",
        f"{low:g}-{high:g} % of draws",
        "paper's percentile",
    ]
    table = new_table(f"Table 1: conditional standard deviations, m ({cells})", columns, left=2)
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
    some = f"All printed figures but {outside} lie in their bands."
    inside = some if outside else "Every printed figure lies in its band."
    return [
        "The paper prints one unstated draw of the noise and cuts off: 0.64 is anything from 0.64 to 0.65,"
        " hence a range of percentiles.",
        f"{inside} All 14 at once come out for {agreeing} of {paper.draws} draws"
        + ("." if agreeing else ": the rows hardly come from a single draw."),
    ]
