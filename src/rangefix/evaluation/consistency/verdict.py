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
    def alarm(self) -> bool:
        """Whether the runs speak against the estimator."""
        return self.kind not in ("honest", "unsure")

    @property
    def severe(self) -> bool:
        """Whether it must not be trusted: much more error than claimed, or no answer at all."""
        return self.kind in ("uneven", "failed") or (
            self.kind == "overconfident" and self.factor.value > LARGE_FACTOR
        )


def is_overconfident(row: Row) -> bool:
    """Whether the errors are larger than claimed, on the whole or in a component."""
    return decide(row).kind in ("overconfident", "uneven")


def verdict_text(row: Row) -> str:
    """One phrase on a row, for readers who do not know what ANEES is."""
    return decide(row).words


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
    notes = (*_component_notes(row, family), *_caveats(row))
    if value > CERTAIN:
        share = format_percent(row.indefinite.value)
        indefinite = f"in {share} of the runs its covariance is not positive definite"
        why = indefinite if row.indefinite.value else "in some runs its covariance all but vanishes"
        return Verdict("overconfident", row.anees, "DO NOT TRUST: claims certainty, and errs", (why, *notes))
    p = row.p_values.get("anees", math.nan if low <= 1 <= high else 0.0)
    if value > 1 and (p < BY_ANEES / family or value > family / BY_ANEES):
        return Verdict("overconfident", row.anees, _factor_words(value), notes)
    if value < 1 and p < BY_CAUTION / family:
        return Verdict("cautious", row.anees, _factor_words(value), notes)
    if wrong := _suspects(row, "ratio_", family):
        parts = ", ".join(_ratio_words(row, name) for name in wrong)
        over = any(row.ratio[row.names.index(name)].value > 1 for name in wrong)
        kind: Kind = "uneven" if over else "cautious"
        return Verdict(kind, row.anees, f"{'DO NOT TRUST: ' * over}{parts}", notes)
    if wrong := _suspects(row, "bias_", family):
        parts = ", ".join(_bias_words(row, name) for name in wrong)
        return Verdict("biased", row.anees, f"errs as much as it claims, but is biased: {parts}", notes)
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
    settings = "settings" if any(row.step for row in rows) else "sets of beams"
    where = beams_in_words(row.beams)
    if settings == "settings":
        where += f", measurement {row.step + 1}"
    words = worst.words
    if len(rows) > 1:
        if alike == len(rows):
            words += f", in all {len(rows)} {settings}"
        else:
            words += f" (in {alike} of {len(rows)} {settings}"
            words += ")" if worst.kind in ("unsure", "honest") else f"; worst: {where})"
    return Verdict(worst.kind, worst.factor, words, worst.notes)


def _size(factor: Interval) -> float:
    """How far ANEES / n is from 1, either way."""
    return abs(math.log(factor.value)) if 0 < factor.value < math.inf else math.inf


def _factor_words(value: float) -> str:
    if value > 1:
        words = f"overconfident by a factor of {format_factor(value)}"
        return f"DO NOT TRUST: {words}" if value > LARGE_FACTOR else f"a little {words}"
    inverse = format_factor(1 / value) if value else "any number"
    return f"{'too' if value * LARGE_FACTOR < 1 else 'a little'} cautious by a factor of {inverse}"


def _suspects(row: Row, prefix: str, family: int) -> list[str]:
    """Components whose figure speaks against the estimator; a circular mean may be biased by rights."""
    if row.ok < COMPONENT_RUNS:
        return []
    level = BY_COMPONENTS / (2 * len(row.names) * family)
    return [
        name
        for name in row.names
        if row.p_values.get(prefix + name, math.nan) < level and (prefix, name) != ("bias_", "heading")
    ]


def _ratio_words(row: Row, name: str) -> str:
    value = row.ratio[row.names.index(name)].value
    if value > 1:
        return f"overconfident in {name} by a factor of {format_factor(value)}"
    return f"too cautious in {name} by a factor of {format_factor(1 / value) if value else 'any number'}"


def _bias_words(row: Row, name: str) -> str:
    bias = row.bias[row.names.index(name)]
    side = "low" if bias.value > 0 else "high"
    size = format_number(factor(name) * abs(bias.value))
    return f"estimates of {name} are {size} {unit(name)} too {side} on average"


def _component_notes(row: Row, family: int) -> list[str]:
    notes = []
    if ratios := _suspects(row, "ratio_", family):
        notes.append(f"{', '.join(_ratio_words(row, name) for name in ratios)} (G over mean P)")
    notes += [_bias_words(row, name) for name in _suspects(row, "bias_", family)]
    return notes


def _caveats(row: Row) -> tuple[str, ...]:
    notes = []
    if row.ok < row.planned:
        failed = ", ".join(f"{count} {name}" for name, count in row.failures.items())
        some = f"judged by the {row.ok} of {row.planned} runs that went well ({failed})"
        notes.append(some if row.ok else f"all {row.planned} runs failed ({failed})")
    if row.improbable.value > MENTION_SHARE:
        share = format_percent(row.improbable.value)
        notes.append(f"in {share} of the runs its own model all but excludes what was measured")
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
