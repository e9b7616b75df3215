"""Gates: conditions on the rows of a study that make it a test, such as `anees=0.8:1.25`.

How the command line uses them (exit code 4 where a line did not pass):

    gates = parse_gates(["point-mass", "anees=0.8:1.25", "particle:ratio_x1=:1.5"])
    lines = check_gates(gates, rows)
    failed = not all(line.passed for line in lines)
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from .summary import Row
from .verdict import decide, name_beams, overconfident, short

LABELS = ("estimator", "beams")  # columns of a row that are no figures
FORM = "ESTIMATOR, FIGURE=LOW:HIGH or ESTIMATOR:FIGURE=LOW:HIGH, such as anees=0.8:1.25"
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
BAND = re.compile(rf"(?P<left>.*)=\s*(?P<low>{NUMBER})?\s*:\s*(?P<high>{NUMBER})?")


@dataclass(frozen=True)
class Gate:
    """One condition.

    Attributes:
        text: As it was written.
        estimator: Whose rows; None = of all estimators.
        figure: A column of the summary (anees, ratio_x1, coverage_90, ...), or None: not overconfident.
        low, high: Between which the figure must lie, ends included.
    """

    text: str
    estimator: str | None
    figure: str | None
    low: float = -math.inf
    high: float = math.inf


@dataclass(frozen=True)
class GateLine:
    """What a gate made of one row.

    Attributes:
        gate: The gate.
        row: The row.
        passed: Whether the figure itself lies in the band. A figure that is not a number does not pass.
        settled: Whether its whole 95 % interval lies on the same side; more runs settle what is not.
        text: One line for the reader.
    """

    gate: Gate
    row: Row
    passed: bool
    settled: bool
    text: str


def parse_gates(texts: Iterable[str]) -> list[Gate]:
    """Gates as they are written on the command line.

    `FIGURE=LOW:HIGH` holds for the rows of all estimators, `ESTIMATOR:FIGURE=LOW:HIGH` for those of one; an
    end may be left out (`anees=:1.25`). `ESTIMATOR` alone asks that it be not overconfident. Labels may hold
    colons and equal signs: the last ones count, and what does not end in two numbers is a label.

    Raises:
        ValueError: If a band is empty or upside down, or its figure is not named.
    """
    return [_parse(text) for text in texts]


def _parse(text: str) -> Gate:
    found = BAND.fullmatch(text.strip())
    if not found or not (found["low"] or found["high"]):
        if not text.strip() or text.strip().endswith(("=", "=:")):
            raise ValueError(f"gate {text!r} has no band: write {FORM}")
        return Gate(text, text.strip(), None)
    owner, _, figure = (part.strip() for part in found["left"].rpartition(":"))
    low, high = float(found["low"] or -math.inf), float(found["high"] or math.inf)
    if not low <= high:
        raise ValueError(f"gate {text!r}: the lower end {low:g} is above the upper end {high:g}")
    if not figure:
        raise ValueError(f"gate {text!r} names no figure: write {FORM}")
    return Gate(text, owner or None, figure, low, high)


def check_gates(gates: Sequence[Gate], rows: Sequence[Row]) -> list[GateLine]:
    """One line for each gate and row that it holds for: all sets of beams, all steps.

    Raises:
        ValueError: If a gate names an estimator or figure that is not there; it lists those there are.
    """
    labels = list(dict.fromkeys(row.estimator for row in rows))
    lines = []
    for gate in gates:
        if gate.estimator is not None and gate.estimator not in labels:
            raise ValueError(
                f"gate {gate.text!r} names no estimator of this study: there are {', '.join(labels)}; "
                f"or write {FORM}"
            )
        mine = [row for row in rows if gate.estimator in (None, row.estimator)]
        lines += [_verdict_line(gate, row) if gate.figure is None else _line(gate, row) for row in mine]
    return lines


def _where(row: Row) -> str:
    beams = f", {name_beams(row.beams)}" if row.beams else ""
    return f"{row.estimator}{beams}, measurement {row.step + 1}"


def _verdict_line(gate: Gate, row: Row) -> GateLine:
    found = decide(row)
    passed = bool(row.ok) and not overconfident(row)
    text = f"{'pass' if passed else 'FAIL'}  {_where(row)}: {found.words}"
    return GateLine(gate, row, passed, found.kind != "unsure", text)


def _line(gate: Gate, row: Row) -> GateLine:
    columns = row.flat()
    figures = {
        name: value
        for name, value in columns.items()
        if name not in LABELS and isinstance(value, int | float)
    }
    if gate.figure not in figures:
        known = ", ".join(name for name in figures if not name.endswith(("_low", "_high")))
        raise ValueError(f"gate {gate.text!r}: no figure {gate.figure!r}; there are {known}")
    value = float(figures[gate.figure])
    low, high = (float(figures.get(f"{gate.figure}_{end}", value)) for end in ("low", "high"))
    passed = gate.low <= value <= gate.high
    inside, meets = gate.low <= low and high <= gate.high, high >= gate.low and low <= gate.high
    settled = inside if passed else not meets
    band = f"[{gate.low:g}, {gate.high:g}]"
    text = f"{'pass' if passed else 'FAIL'}  {_where(row)}: {gate.figure} = {short(value)}"
    text += f" [{short(low)}, {short(high)}]" if (low, high) != (value, value) else ""
    text += f" is {'in' if passed else 'not in'} {band}"
    text += "" if settled else f"; {row.ok} runs do not settle it"
    return GateLine(gate, row, passed, settled, text)
