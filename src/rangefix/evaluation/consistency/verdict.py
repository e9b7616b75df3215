"""The figures of a row in words: whether an estimator's covariance may be trusted.

An exact filter gets another verdict than "honest" or "cannot tell" in at most 6 % of rows (`ALARMS`), mostly
through ANEES, else through its components and bias. docs/report.md has what was measured.

Two things about ANEES / n of an exact filter go into the rules. Its NEES may have a long tail: where a second
mode holds 1 % of a belief, 1 % of the runs have an error many times the usual. As long as none of these has
occurred the mean looks too small, so caution needs a smaller p-value than overconfidence. And the mean is k
or more with probability 1 / k at most, for any number of runs (Markov's inequality): 20 or more is evidence
even where a single run makes it and no interval can be given.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from .formatting import beams_in_words, factor, format_factor, format_number, format_percent, unit
from .intervals import Interval
from .row import Row

LARGE_FACTOR = 1.5  # ANEES / n beyond it, or its inverse, is no longer "a little"; intervals must tell it
BY_ANEES, BY_CAUTION, BY_COMPONENTS = 0.05, 0.02, 0.005  # two-sided p-values below which a figure accuses
CERTAIN = 1e6  # ANEES / n beyond this is no factor any more: the claim is one of certainty
ALARMS = 0.06  # the stated rate of false alarms, of a row and of an estimator as a whole
COMPONENT_RUNS = 100  # with fewer, p-values as small as components need are not to be relied on
MENTION_SHARE = 0.01  # failed, or improbable, runs that a verdict mentions, as a share
Kind = Literal["honest", "overconfident", "cautious", "uneven", "biased", "unsure", "failed"]
WORST_FIRST: tuple[Kind, ...] = (
    "overconfident", "uneven", "biased", "cautious", "failed", "unsure", "honest",
)  # fmt: skip


@dataclass(frozen=True)
class Verdict:
    """What to make of an estimator on a set of beams.

    Attributes:
        kind: "honest"; "overconfident", "cautious": squared errors are larger, smaller than claimed;
            "uneven": right on the whole, wrong in single components; "biased": right on the whole, but for a
            mean error; "unsure": too few runs; "failed": no run went well.
        factor: ANEES / n with its 95 % interval: squared error over claimed variance.
        words: One phrase.
        notes: What else a reader must know, a sentence each.
    """

    kind: Kind
    factor: Interval
    words: str
    notes: tuple[str, ...] = ()

    @property
    def severe(self) -> bool:
        """Whether it must not be trusted: much more error than claimed, or no answer at all."""
        return self.kind in ("uneven", "failed") or (
            self.kind == "overconfident" and self.factor.value > LARGE_FACTOR
        )

    @property
    def overconfident(self) -> bool:
        """Whether the errors are larger than claimed, on the whole or in a component."""
        return self.kind in ("overconfident", "uneven")


def decide(row: Row, family: int = 1) -> Verdict:
    """The verdict on a row.

    Args:
        row: The row.
        family: Rows among which false alarms are to be as rare as stated for one (Bonferroni). With 1, the
            verdict is "overconfident" wherever the 95 % interval of ANEES / n lies above 1.
    """
    value, low, high = row.anees
    if not row.ok:
        return Verdict("failed", row.anees, "no run went well", _caveats(row))
    ratios, biases = (_suspects(row, figure, family) for figure in ("ratio", "bias"))
    uneven = ", ".join(
        ("" if ratio > 1 else "too ") + _factor_words(ratio, name) for name, ratio in ratios.items()
    )
    biased = [_bias_words(name, bias) for name, bias in biases.items()]
    notes = (*([f"{uneven} (G over mean P)"] if uneven else []), *biased, *_caveats(row))
    if value > CERTAIN:
        share = format_percent(row.indefinite.value)
        indefinite = f"in {share} of the runs its covariance is not positive definite"
        why = indefinite if row.indefinite.value else "in some runs its covariance all but vanishes"
        return Verdict("overconfident", row.anees, "DO NOT TRUST: claims certainty, and errs", (why, *notes))
    p = row.p_values.get("anees", math.nan if low <= 1 <= high else 0.0)
    if value > 1 and (p < BY_ANEES / family or value > family / BY_ANEES):
        large = "DO NOT TRUST: " if value > LARGE_FACTOR else "a little "
        return Verdict("overconfident", row.anees, large + _factor_words(value), notes)
    if value < 1 and p < BY_CAUTION / family:
        large = "too " if value * LARGE_FACTOR < 1 else "a little "
        return Verdict("cautious", row.anees, large + _factor_words(value), notes)
    if uneven:
        over = any(ratio > 1 for ratio in ratios.values())
        kind: Kind = "uneven" if over else "cautious"
        return Verdict(kind, row.anees, "DO NOT TRUST: " * over + uneven, notes)
    if biased:
        told = f"errs as much as it claims, but is biased: {', '.join(biased)}"
        return Verdict("biased", row.anees, told, notes)
    if not (low == low and high <= LARGE_FACTOR and low >= 1 / LARGE_FACTOR):
        return Verdict("unsure", row.anees, f"cannot tell with {row.ok} runs", (_needed(row), *notes))
    off = 100 * (max(high, 1 / low) - 1)
    close = f"squared errors and claimed variances agree to within {off:.2g} %, at 95 % confidence"
    return Verdict("honest", row.anees, "honest: errs as it claims", (close, *notes))


def decide_overall(rows: Sequence[Row]) -> Verdict:
    """The verdict on one estimator from all its rows: every set of beams and every step.

    False alarms are as rare for the whole as for one row alone. The factor is that of the worst row.

    Raises:
        ValueError: If there is no row.
    """
    if not rows:
        raise ValueError("need a row at least")
    verdicts = [(decide(row, len(rows)), row) for row in rows]
    worst, row = min(verdicts, key=lambda pair: (WORST_FIRST.index(pair[0].kind), -_size(pair[0].factor)))
    alike = sum(verdict.kind == worst.kind for verdict, _ in verdicts)
    moving = any(row.step for row in rows)
    settings = "settings" if moving else "sets of beams"
    words = worst.words
    if len(rows) > 1 and alike == len(rows):
        words += f", in all {len(rows)} {settings}"
    elif len(rows) > 1:
        where = beams_in_words(row.beams) + f", measurement {row.step + 1}" * moving
        example = "" if worst.kind in ("unsure", "honest") else f"; worst: {where}"
        words += f" (in {alike} of {len(rows)} {settings}{example})"
    return Verdict(worst.kind, worst.factor, words, worst.notes)


def _size(factor: Interval) -> float:
    """How far ANEES / n is from 1, either way."""
    return abs(math.log(factor.value)) if 0 < factor.value < math.inf else math.inf


def _factor_words(value: float, component: str = "") -> str:
    """How much larger or smaller than claimed squared errors are, on the whole or in a component."""
    kind, where = "overconfident" if value > 1 else "cautious", f" in {component}" if component else ""
    return f"{kind}{where} by a factor of {format_factor(max(value, 1 / value)) if value else 'any number'}"


def _suspects(row: Row, figure: str, family: int) -> dict[str, float]:
    """Components whose figure speaks against the estimator; a circular mean may be biased by rights."""
    level = BY_COMPONENTS / (2 * len(row.names) * family) if row.ok >= COMPONENT_RUNS else 0.0
    return {
        name: row.figures[f"{figure}_{name}"].value
        for name in row.names
        if row.p_values.get(f"{figure}_{name}", math.nan) < level and (figure, name) != ("bias", "heading")
    }


def _bias_words(name: str, bias: float) -> str:
    side, size = "low" if bias > 0 else "high", format_number(factor(name) * abs(bias))
    return f"estimates of {name} are {size} {unit(name)} too {side} on average"


def _caveats(row: Row) -> tuple[str, ...]:
    notes = []
    if row.ok < row.planned:
        failed = ", ".join(f"{count} {name}" for name, count in row.failures.items())
        some = f"judged by the {row.ok} of {row.planned} runs that went well ({failed})"
        notes.append(some if row.ok else f"all {row.planned} runs failed ({failed})")
    if row.improbable.value > MENTION_SHARE:
        share = format_percent(row.improbable.value)
        notes.append(f"in {share} of the runs its own model all but excludes what was measured")
    if row.unresolved.value > MENTION_SHARE:
        share = format_percent(row.unresolved.value)
        notes.append(
            f"in {share} of the runs its cells are too coarse: by its own account it is off by more than "
            "5 % of a deviation"
        )
    if row.one_truth:
        notes.append(
            "all runs have the same true state: an exact Bayesian filter is honest on average over its "
            "prior, not at each place of it, so this verdict holds for this place alone"
        )
    return tuple(notes)


def _needed(row: Row) -> str:
    """How many runs would tell, the interval shrinking as their root."""
    _, low, high = row.anees
    if not (0 < low < math.inf and 0 < high < math.inf):
        return "too few runs for an interval"
    wide = max(math.log(high), -math.log(low)) / math.log(LARGE_FACTOR)
    about = row.ok * wide**2
    digits = 10 ** max(0, math.floor(math.log10(about)) - 1)
    return (
        f"squared errors may be {format_number(low)} to {format_number(high)} times what is claimed; about "
        f"{math.ceil(about / digits) * digits} runs would tell"
    )
