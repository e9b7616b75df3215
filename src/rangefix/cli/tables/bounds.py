"""The table of the optimum and of bounds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from rich.table import Table

from ...evaluation.consistency.formatting import beams_in_words, factor, format_number, format_percent, unit
from ..screen import new_table

if TYPE_CHECKING:
    from ...evaluation.bounds.catalogue import Row

UNTOLD_SHARE = 5e-4  # of a variance: an error that is not shown


def bounds(rows: Sequence[Row], components: Sequence[str], title: str) -> Table:
    """Deviations of the optimum and of bounds, and their variances as shares of the optimum's."""
    from ...evaluation.bounds.catalogue import NOT_BELOW  # brings scipy.stats, which no other table needs

    columns = ["", *(f"std {name}, {unit(name)}" for name in components)]
    columns += [f"variance {name}\nof the optimum's" for name in components]
    table = new_table(title, columns)
    for beams in dict.fromkeys(row.beams for row in rows):
        table.add_row(beams_in_words(beams), style="bold")
        for row in (row for row in rows if row.beams == beams and row.bound is not None):
            assert row.bound is not None
            variances = np.where(np.diagonal(row.bound.matrix) > 0, np.diagonal(row.bound.matrix), np.nan)
            stds = np.sqrt(variances)  # a bound of 0 says nothing, and is shown as "-"
            shown = [format_number(factor(name) * std) for name, std in zip(components, stds, strict=True)]
            shares = [""] * len(components)
            if row.name in NOT_BELOW:
                shares = [_known_to(share) for share in np.diagonal(row.bound.error) / variances]
            elif row.of_optimum is not None:
                shares = [
                    "-" if np.isnan(variance) else format_percent(share)
                    for share, variance in zip(row.of_optimum, variances, strict=True)
                ]
            table.add_row(f"  {row.name}", *shown, *shares)
    return table


def _known_to(share: float) -> str:
    """How well the optimum's variance is known, where it is not all but exact."""
    return "" if share < UNTOLD_SHARE else f"+- {format_percent(share)}"
