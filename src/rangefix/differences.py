"""What the command `compare` prints: two results side by side, in lines and a table."""

from __future__ import annotations

import math
from collections.abc import Iterator

from rich.table import Table

from .evaluation.compare import Comparison, Difference
from .evaluation.verdict import name_beams, short
from .tables import new_table

SHOWN = 40  # lines of a config's diff


def preamble(comparison: Comparison, a: str, b: str) -> list[str]:
    """What differs beside the numbers."""
    lines = [f"A: {a}", f"B: {b}", ""]
    lines += [
        f"{name}: {_brief(one)} -> {_brief(other)}" for name, (one, other) in comparison.settings.items()
    ]
    config = comparison.config
    lines += ["config:", *(f"  {line}" for line in config[:SHOWN])] if config else ["config: the same"]
    if len(config) > SHOWN:
        lines.append(f"  ... and {len(config) - SHOWN} lines more")
    for name, only in (("A", comparison.only_a), ("B", comparison.only_b)):
        lines += [f"only in {name}: {estimator}, {name_beams(beams)}" for estimator, beams in only]
    same = "the same" if comparison.same_truths else "other"
    return [*lines, f"truths: {same}; runs are paired by number", ""]


def differences(comparison: Comparison) -> Table:
    """A line for each figure; standard deviations are roots of mean squares."""
    columns = ("estimator", "beams", "figure", "runs", "A", "B", "B / A", "p (Holm)")
    table = new_table("", columns, left=3)
    table.add_column("", justify="left")
    last = max((each.step for each in comparison.differences), default=0)
    for each in comparison.differences:
        if each.step in (-1, last):
            table.add_row(*_cells(each), style="bold" if each.significant else "")
    return table


def _cells(each: Difference) -> Iterator[str]:
    root = each.figure.startswith(("mse_", "claimed_"))
    a, b = (math.sqrt(value) if root and value >= 0 else value for value in (each.a, each.b))
    yield from (each.estimator, each.beams, _named(each.figure), str(each.runs), short(a), short(b))
    yield f"{b / a:.3g}" if a and math.isfinite(a) and math.isfinite(b) else "-"
    yield "-" if each.adjusted != each.adjusted else f"{each.adjusted:.2g}"
    if each.change.value == 0 and each.p == 1.0:
        yield "the same"
    else:
        yield ("B is larger" if b > a else "B is smaller") if each.significant else "no difference seen"


def _named(figure: str) -> str:
    kind, _, name = figure.partition("_")
    return {"mse": f"{name} true std", "claimed": f"{name} claimed std", "anees": "ANEES/n"}.get(
        kind, "share ok"
    )


def _brief(value: object) -> str:
    text = str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
