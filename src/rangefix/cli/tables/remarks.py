"""Lines below the table of a study: faults in some runs, what is to be done about them, and failures."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

from ...evaluation import Results, Row
from ...evaluation.consistency.formatting import beams_in_words
from ...evaluation.consistency.metrics import MAX_ERROR, MIN_EFFECTIVE

REMARKS = {  # share of a row -> what is said of it where it is not zero
    "collapsed": ("collapsed", f"; fewer than {MIN_EFFECTIVE} effective particles"),
    "inaccurate": ("inaccurate", f"; numerical error above {MAX_ERROR:g} deviations"),
    "undirected": ("no mean heading", ""),
    "improbable": ("improbable", "; its own model all but excludes what was measured"),
}


def remarks(rows: Sequence[Row], estimators: Mapping[str, Any] | None = None) -> list[str]:
    """A line for each estimator and set of beams with a fault in some runs, after the last measurement.

    Args:
        rows: What came out.
        estimators: Label -> name and options, as a manifest has them, for what is to be done about it.
    """
    end = max(row.step for row in rows)
    lines = []
    for name, (words, why) in REMARKS.items():
        for row in (row for row in rows if row.step == end):
            share: float = getattr(row, name).value
            if share > 0:
                where = f"{row.estimator}, {beams_in_words(row.beams)}"
                advice = _smaller_cells((estimators or {}).get(row.estimator)) if name == "inaccurate" else ""
                lines.append(f"{where}: {words} in {100 * share:.3g} % of the runs{why}{advice}")
    lines += [
        f"{row.estimator}, {beams_in_words(row.beams)}: a run takes long; the time is that of its first "
        f"{row.updates_timed} of {end + 1} updates"
        for row in rows
        if row.step == end and row.updates_timed is not None
    ]
    return lines


def _smaller_cells(estimator: Any) -> str:
    """What mends cells that are too wide, with a semicolon before it; "" where none are given."""
    options = estimator.get("options") if isinstance(estimator, Mapping) else None
    if not isinstance(options, Mapping) or estimator.get("name") != "point-mass":
        return ""
    cell, turn = options.get("cell"), options.get("heading_cell")
    told = (
        [f"cell_m = {cell:g}"] if isinstance(cell, int | float) else ["those of `cell`"] * (cell is not None)
    )
    told += [f"heading_cell_deg = {math.degrees(turn):g}"] if isinstance(turn, int | float) else []
    return f"; smaller cells than {' and '.join(told)} mend it" if told else ""


def failures(results: Results) -> list[str]:
    """A line for each estimator and set of beams of which runs failed: how many, and why the first did."""
    lines = []
    for estimator, beams in product(results.estimators, results.beam_sets):
        first, counts = "", Counter[str]()
        for block in results.blocks():
            trials = results.source.trials(estimator, beams, *block)
            counts.update(trials.failures)
            if not first and trials.reasons:
                run = min(trials.reasons)
                first = f"run {run}: {trials.reasons[run]}"
        if counts:
            told = ", ".join(f"{count} {status}" for status, count in counts.items())
            lines.append(f"{estimator}, {beams_in_words(beams)}: {told}; {first}")
    return lines
