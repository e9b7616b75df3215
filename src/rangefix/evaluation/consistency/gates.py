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

import numpy as np

from ...errors import counted, suggestion
from ..results import BeliefScores, SavedBounds
from ..results.outcome import DIAGNOSTICS
from .evidence import Family
from .formatting import format_number
from .metrics import RunBlock
from .row import Row
from .summarise import Accumulator
from .verdict import decide

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
        gate, row: Which.
        passed: Whether the figure itself lies in the band. A figure that is not a number does not pass.
        settled: Whether its whole 95 % interval lies on the same side; more runs settle what is not.
        text: One line for the reader.
    """

    gate: Gate
    row: Row
    passed: bool
    settled: bool
    text: str


def parse_gates(texts: Iterable[str] | str) -> list[Gate]:
    """Gates as they are written on the command line, one or several.

    `FIGURE=LOW:HIGH` holds for the rows of all estimators, `ESTIMATOR:FIGURE=LOW:HIGH` for those of one; an
    end may be left out (`anees=:1.25`). `ESTIMATOR` alone asks that it be not overconfident. Labels may hold
    colons and equal signs: the last ones count, and what does not end in two numbers is a label.

    Raises:
        ValueError: If a band is empty or upside down, or its figure is not named.
    """
    return [_parse(text) for text in ([texts] if isinstance(texts, str) else texts)]


def _parse(text: str) -> Gate:
    band = BAND.fullmatch(text.strip())
    if not band or not (band["low"] or band["high"]):
        if not text.strip() or text.strip().endswith(("=", "=:")):
            raise ValueError(f"gate {text!r} has no band: write {FORM}")
        return Gate(text, text.strip(), None)
    owner, _, figure = (part.strip() for part in band["left"].rpartition(":"))
    low, high = float(band["low"] or -math.inf), float(band["high"] or math.inf)
    if not low <= high:
        raise ValueError(f"gate {text!r}: the lower end {low:g} is above the upper end {high:g}")
    if not figure:
        raise ValueError(f"gate {text!r} names no figure: write {FORM}")
    return Gate(text, owner or None, figure, low, high)


def need_sound(
    gates: Iterable[Gate],
    labels: Sequence[str],
    names: tuple[str, ...],
    beliefs: bool,
    bounds: bool = False,
) -> None:
    """Say before anything runs what would be said after it.

    Args:
        gates: What will be asked.
        labels: Labels of the estimators.
        names: Components of the state.
        beliefs: Whether beliefs will be judged.
        bounds: Whether it will be known how good anybody could be.

    Raises:
        ValueError: If a gate names an estimator or figure that will not be there, or its band is none.
    """
    gates = tuple(gates)
    if not gates:
        return
    every = figures(names, beliefs=True, bounds=True)
    known = figures(names, beliefs=beliefs, bounds=bounds)
    for gate in gates:
        if gate.figure is None and gate.estimator not in labels:
            if gate.text.strip() in every:
                raise ValueError(f"gate {gate.text!r} has no band: write {FORM}")
            if "=" in gate.text:
                band = gate.text.rpartition("=")[2].strip()
                raise ValueError(f"gate {gate.text!r}: {band!r} is no band LOW:HIGH: write {FORM}")
        _need_there(gate, labels, every if gate.figure in every else known)
        if gate.figure not in (None, *known):
            of_beliefs = gate.figure in figures(names, beliefs=True, bounds=bounds)
            needed = "beliefs = true in the study" if of_beliefs else "--bounds"
            raise ValueError(f"gate {gate.text!r} needs {needed}")


def figures(names: tuple[str, ...], *, beliefs: bool, bounds: bool) -> tuple[str, ...]:
    """Names of the figures that a row has, for components of the state."""
    errors = np.zeros((2, len(names)))
    covariance = np.broadcast_to(np.eye(len(names)), (2, len(names), len(names)))
    one = np.zeros(2)
    belief = BeliefScores(errors, one, one, errors, one, covariance, covariance) if beliefs else None
    both = (SavedBounds(best, errors[0], names) for best in (errors[0], None))
    told = dict.fromkeys(DIAGNOSTICS, one)
    rows = [
        Accumulator.of(
            RunBlock(names, errors, covariance, belief=belief, bounds=saved, diagnostics=told)
        ).row()
        for saved in (both if bounds else [None])
    ]
    return tuple(dict.fromkeys(name for row in rows for name in row.flat() if name not in LABELS))


def _need_there(gate: Gate, labels: Sequence[str], known: Iterable[str]) -> None:
    """Refuse a gate that names an estimator or figure that is not there."""
    if gate.estimator not in (None, *labels):
        meant = suggestion(gate.estimator or "", labels, more=f"; or write {FORM}")
        raise ValueError(f"gate {gate.text!r} names no estimator of this study: {meant}")
    if gate.figure not in (None, *known):
        plain = [name for name in known if not name.endswith(("_low", "_high"))]
        meant = suggestion(gate.figure or "", plain)
        raise ValueError(f"gate {gate.text!r}: no figure {gate.figure!r}; {meant}")


def check_gates(gates: Sequence[Gate], rows: Sequence[Row]) -> list[GateLine]:
    """One line for each gate and row that it holds for: all sets of beams, all steps.

    Raises:
        ValueError: If a gate names an estimator or figure that is not there; it lists those there are.
    """
    labels = list(dict.fromkeys(row.estimator for row in rows))
    lines = []
    known = dict.fromkeys(name for row in rows for name in row.flat() if name not in LABELS)
    for gate in gates:
        _need_there(gate, labels, known)
        its_rows = [row for row in rows if gate.estimator in (None, row.estimator)]
        if gate.figure is None:
            family = Family.of(its_rows)
            lines += [_verdict_line(gate, row, family) for row in its_rows]
        else:
            lines += [_line(gate, row) for row in its_rows]
    return lines


def _verdict_line(gate: Gate, row: Row, family: Family) -> GateLine:
    """The verdict on a row of some among which false alarms are as rare as for one: see `decide`."""
    verdict = decide(row, family)
    passed = bool(row.ok) and not verdict.overconfident
    text = f"{'pass' if passed else 'FAIL'}  {row.where}: {verdict.words}"
    return GateLine(gate, row, passed, verdict.kind != "unsure", text)


def _line(gate: Gate, row: Row) -> GateLine:
    columns = row.flat()
    value = float(columns.get(gate.figure or "", math.nan))  # of one that cannot sample its beliefs
    low, high = (float(columns.get(f"{gate.figure}_{end}", value)) for end in ("low", "high"))
    passed = gate.low <= value <= gate.high
    inside, apart = gate.low <= low and high <= gate.high, high < gate.low or low > gate.high
    settled = inside if passed else apart or math.isnan(value)
    band = f"[{gate.low:g}, {gate.high:g}]"
    text = f"{'pass' if passed else 'FAIL'}  {row.where}: {gate.figure} = {format_number(value)}"
    alone = (low, high) == (value, value) or math.isnan(low + high)
    text += "" if alone else f" [{format_number(low)}, {format_number(high)}]"
    text += f" is {'in' if passed else 'not in'} {band}"
    text += "" if settled else f"; {counted(row.ok, 'run')} {'does' if row.ok == 1 else 'do'} not settle it"
    return GateLine(gate, row, passed, settled, text)
