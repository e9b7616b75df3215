"""The figures of a row in words: whether an estimator's covariance may be trusted.

An exact filter gets another verdict than "honest" or "cannot tell" in at most 6 % of rows (`ALARMS`),
whatever the shape of its beliefs. What the p-values rest on is in `evidence.py`;
docs/report.md has what was measured.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

from ...errors import counted
from .evidence import Evidence, Family, ShapeFault
from .formatting import beams_in_words, factor, format_factor, format_number, format_percent, unit
from .intervals import Interval
from .metrics import MAX_ERROR, MIN_EFFECTIVE
from .null_distribution import FAR, LARGE_FACTOR, FarErrors
from .row import Row

BY_ANEES = 0.05  # two-sided level of its 95 % interval, beyond which it accuses where there are no draws
CERTAIN = 1e6  # ANEES / n beyond this is no factor any more: the claim is one of certainty
ALARMS = 0.06  # the stated rate of false alarms, of a row and of an estimator as a whole
MENTION_SHARE = 0.01  # failed, or improbable, runs that a verdict mentions, as a share
HONEST = "honest: errs as it claims"
KNOWN = 2.0  # a factor whose lower bound is further from it is known as "at least" that bound
Kind = Literal[
    "honest", "overconfident", "cautious", "uneven", "biased", "shape", "unsure", "failed", "pending"
]
WORST_FIRST: tuple[Kind, ...] = (
    "overconfident", "uneven", "biased", "shape", "cautious", "failed", "unsure", "pending", "honest",
)  # fmt: skip


SHORT_WORDS: dict[Kind, str] = {
    "honest": "honest", "overconfident": "overconfident", "cautious": "cautious", "uneven": "uneven",
    "biased": "biased", "shape": "other shape", "unsure": "cannot tell", "failed": "no answer",
    "pending": "not run yet",
}  # fmt: skip


class Levels(NamedTuple):
    """p-values below which figures accuse: one-sided for ANEES, two-sided for all components together."""

    too_large: float
    too_small: float
    components: float
    shape: float


WITH_DRAWS = Levels(0.0265, 0.0105, 0.006, 0.004)  # 4.7 %: draws of 39 studies scatter themselves
WITHOUT_DRAWS = Levels(BY_ANEES / 2, 0.01, 0.005, 0.0)
FEW_RUNS = 3  # of fewer only errors on the whole are judged: the same 39 or 78 draws would judge everything
LEVEL_OF_FEW_RUNS = 0.02  # one-sided, for ANEES there: one of 39 draws beyond a truth does not reach it


@dataclass(frozen=True)
class Verdict:
    """What to make of an estimator on a set of beams.

    Attributes:
        kind: "honest"; "overconfident", "cautious": squared errors are larger, smaller than claimed;
            "uneven": right on the whole, wrong in single components; "biased": right on the whole, but for a
            mean error; "shape": the covariance is right, the tails or the symmetry of the belief are not;
            "unsure": too few runs; "failed": it gave no answer;
            "pending": no run of it was made yet.
        factor: ANEES / n, squared error over claimed variance, with what is known of it at 95 %.
        words: One phrase.
        notes: What else a reader must know, a sentence each.
    """

    kind: Kind
    factor: Interval
    words: str
    notes: tuple[str, ...] = ()

    @property
    def severe(self) -> bool:
        """Whether it must not be trusted: much more error than claimed."""
        return self.kind == "uneven" or (self.kind == "overconfident" and self.factor.value > LARGE_FACTOR)

    @property
    def short(self) -> str:
        """The verdict in at most two words, or three where it must not be trusted."""
        return "DO NOT TRUST" if self.severe else SHORT_WORDS[self.kind]

    @property
    def by(self) -> str:
        """By which factor squared errors are larger or smaller than claimed, in a few letters.

        One that is known only from below begins with ">"; "-" where the verdict rests on something else.
        """
        value, low, _ = _as_factor(self.factor)
        if not math.isfinite(value) or _factor_words(self.factor) not in self.words:
            return "-"
        if low < value / KNOWN:
            return f"> {format_factor(low)}" if low >= 1.1 else "-"
        return f"{value:.3g}" if value < 1.1 else format_factor(value)

    @property
    def plain(self) -> bool:
        """Whether it is honest without reserve, which needs no words."""
        return self.kind == "honest" and self.words == HONEST

    @property
    def overconfident(self) -> bool:
        """Whether the errors are larger than claimed, on the whole or in a component."""
        return self.kind in ("overconfident", "uneven")


def decide(row: Row, family: int | Family = 1) -> Verdict:
    """The verdict on a row.

    Args:
        row: The row.
        family: Rows among which false alarms are to be as rare as stated for one, or how many there are.
    """
    if not row.made:
        return Verdict("pending", row.anees, f"not run yet ({_how_far(row)})")
    if not row.ok:
        return Verdict("failed", row.anees, "gave no answer", _caveats(row))
    evidence = Evidence(row, family if isinstance(family, Family) else Family(family))
    known, tolerance, value = evidence.factor, evidence.tolerance, row.anees.value
    levels = _levels(evidence)
    ratios, biases = evidence.ratios(levels.components), evidence.biases(levels.components)
    uneven = ", ".join(
        ("" if ratio.value > 1 else "too ") + _factor_words(ratio, name) for name, ratio in ratios.items()
    )
    biased = [_bias_words(name, bias) for name, bias in biases.items()]
    notes = (*([f"{uneven} (G over mean P)"] if uneven else []), *biased, *_ground(evidence), *_caveats(row))
    if value > CERTAIN:
        share = format_percent(row.indefinite.value)
        indefinite = f"in {share} of the runs its covariance is not positive definite"
        why = indefinite if row.indefinite.value else "in some runs its covariance all but vanishes"
        return Verdict("overconfident", known, "DO NOT TRUST: claims certainty, and errs", (why, *notes))
    fault = evidence.shape(levels.shape)
    shape = "" if fault is None else f"errs as much as it claims, but {_shape_words(fault)}"
    if shape and evidence.scatters_about_one and 1 / LARGE_FACTOR <= value <= LARGE_FACTOR:
        return Verdict("shape", known, shape, notes)
    if evidence.too_large < levels.too_large:
        large = "DO NOT TRUST: " if value > LARGE_FACTOR else "a little "
        return Verdict("overconfident", known, large + _factor_words(known), (*_few(known), *notes))
    too_small = evidence.too_small < levels.too_small
    if too_small and evidence.shows_caution:
        large = "too " if value * LARGE_FACTOR < 1 else "a little "
        return Verdict("cautious", known, large + _factor_words(known), notes)
    if uneven:
        over = any(ratio.value > 1 for ratio in ratios.values())
        kind: Kind = "uneven" if over else "cautious"
        return Verdict(kind, known, "DO NOT TRUST: " * over + uneven, notes)
    if biased:
        told = f"errs as much as it claims, but is biased: {', '.join(biased)}"
        return Verdict("biased", known, told, notes)
    if shape:
        return Verdict("shape", known, shape, notes)
    if too_small:
        return Verdict("unsure", known, _cannot_tell(row), (_unseen(known), *notes))
    _, low, high = tolerance
    if not (low == low and high <= LARGE_FACTOR and low >= 1 / LARGE_FACTOR):
        needed = _needed(tolerance, row.ok)
        if (far := evidence.far) is not None:
            told = f"{HONEST}, but for the rarest errors, of which too few are met"
            return Verdict("honest", tolerance, told, (_far_words(far, row.ok), needed, *notes))
        return Verdict("unsure", tolerance, _cannot_tell(row), (needed, *notes))
    off = format_percent(max(high, 1 / low) - 1)
    close = f"squared errors and claimed variances agree to within {off}, at 95 % confidence"
    return Verdict("honest", tolerance, HONEST, (close, *notes))


def _levels(evidence: Evidence) -> Levels:
    """The levels for a row that is one of a family."""
    levels = WITH_DRAWS if evidence.drawn else WITHOUT_DRAWS
    if evidence.row.ok < FEW_RUNS:
        levels = Levels(min(levels.too_large, LEVEL_OF_FEW_RUNS), levels.too_small, 0.0, 0.0)
    return Levels(*(level / evidence.family.rows for level in levels))


def _cannot_tell(row: Row) -> str:
    return f"cannot tell with {counted(row.ok, 'run')}"


def decide_overall(rows: Sequence[Row]) -> Verdict:
    """The verdict on one estimator from all its rows: every set of beams and every step.

    False alarms are as rare for the whole as for one row alone. The factor is that of the worst row.

    Raises:
        ValueError: If there is no row.
    """
    if not rows:
        raise ValueError("need a row at least")
    family = Family.of(rows)
    verdicts = [(decide(row, family), row) for row in rows]
    worst, row = min(verdicts, key=lambda pair: (WORST_FIRST.index(pair[0].kind), -_size(pair[0].factor)))
    alike = sum(verdict.kind == worst.kind for verdict, _ in verdicts)
    moving = any(row.step for row in rows)
    settings = "settings" if moving else "sets of beams"
    words = worst.words
    if len(rows) > 1:
        every = "both" if len(rows) == 2 else f"all {len(rows)}"
        share = every if alike == len(rows) else f"{alike} of {len(rows)}"
        where = beams_in_words(row.beams) + f", measurement {row.step + 1}" * moving
        example = "" if worst.kind in ("unsure", "pending", "honest") else f"; worst: {where}"
        whole = share == every and not example
        words += f", in {every} {settings}" if whole else f" (in {share} {settings}{example})"
    return Verdict(worst.kind, worst.factor, words, worst.notes)


def _size(factor: Interval) -> float:
    """How far ANEES / n is from 1, either way."""
    return abs(math.log(factor.value)) if 0 < factor.value < math.inf else math.inf


def short_factor(known: Interval) -> str:
    """By how much squared errors are larger or smaller than claimed, for a badge; "" if that is open."""
    value, low, _ = _as_factor(known)
    if low < value / KNOWN:
        return f"\u00d7 {format_factor(low)} or more" if low >= 1.1 else ""
    return f"\u00d7 {format_factor(value)}" if value >= 1.1 else f"by {format_percent(value - 1)}"


def _as_factor(known: Interval) -> Interval:
    """The same as a factor of 1 or more, also where errors are smaller than claimed."""
    if known.value > 1:
        return known
    return Interval(*(1 / end if end else math.inf for end in (known.value, known.high, known.low)))


def _factor_words(known: Interval, component: str = "") -> str:
    """How much larger or smaller than claimed squared errors are, as far as that is known."""
    where = f" in {component}" if component else ""
    said = f"{'overconfident' if known.value > 1 else 'cautious'}{where}"
    value, low, high = _as_factor(known)
    if value == math.inf:
        return f"{said} by a factor of any number"
    if low < value / KNOWN:
        least = f" by a factor of at least {format_factor(low)}"
        return said + (least if low >= 1.1 else ", by how much is open")
    if value < 1.1:
        return f"{said}, by {format_percent(value - 1)}"
    ends = [format_factor(max(end, 1.0)) for end in (low, high)]
    told = f" ({ends[0]} to {ends[1]})" if ends[0] != ends[1] and high < math.inf else ""
    return f"{said} by a factor of {format_factor(value)}{told}"


def _few(known: Interval) -> tuple[str, ...]:
    """A note where a few runs make most of the factor."""
    if known.low * KNOWN >= known.value:
        return ()
    ends = f"{format_number(known.value)} [{format_number(known.low)}, {format_number(known.high)}]"
    return (f"a few runs make most of ANEES / n = {ends}",)


def _shape_words(fault: ShapeFault) -> str:
    """In which way the shape of the beliefs is not that of the errors."""
    share = format_percent(fault.inner)
    if fault.name:
        return f"its beliefs in {fault.name} have another shape ({share} of truths in their lower half)"
    if abs(fault.inner - 0.5) < 0.03:
        return "its beliefs have another shape"
    tails = "heavier" if fault.inner > 0.5 else "lighter"
    return f"with {tails} tails than it believes ({share} of truths in the nearer half of its beliefs)"


def _ground(evidence: Evidence) -> tuple[str, ...]:
    """What the verdict rests on, where that is not draws from all beliefs."""
    if evidence.drawn:
        return ()
    if (null := evidence.row.null) is None:
        return ("judged by means and covariances alone, for want of samples of its beliefs",)
    claimed = format_number(null.claimed.value)
    return (f"its samples have {claimed} times the squared distances that it claims: judged without them",)


def _far_words(far: FarErrors, runs: int) -> str:
    """What the runs cannot tell of, and what they met of it."""
    return (
        f"{format_percent(far.share)} of the squared errors that it claims lie more than {FAR:g} claimed "
        f"deviations from its estimates, where {format_number(far.expected)} of {counted(runs, 'truth')} "
        f"are to be expected and {far.found} were found; nearer ones agree with its claims"
    )


def _unseen(known: Interval) -> str:
    """Why errors that are too small are no evidence."""
    return (
        f"squared errors are {format_number(known.value)} times what is claimed in these runs: it claims too "
        "much, or a rare mode of its beliefs was not met; samples of its beliefs, or more runs, would tell"
    )


def _bias_words(name: str, bias: float) -> str:
    side, size = "low" if bias > 0 else "high", format_number(factor(name) * abs(bias))
    return f"estimates of {name} are {size} {unit(name)} too {side} on average"


def _how_far(row: Row) -> str:
    how = "still running" if row.running else "interrupted"
    return f"{how} after {row.made} of {counted(row.planned, 'run')}"


def _caveats(row: Row) -> tuple[str, ...]:
    notes = []
    if row.pending:
        notes.append(f"{_how_far(row)}, by which it is judged")
    if row.ok < row.made:
        failed = ", ".join(f"{count} {name}" for name, count in row.failures.items())
        some = f"judged by the {row.ok} of {counted(row.made, 'run')} that went well ({failed})"
        notes.append(some if row.ok else f"all {counted(row.made, 'run')} failed ({failed})")
    if row.collapsed.value > MENTION_SHARE:
        notes.append(
            f"in {format_percent(row.collapsed.value)} of the runs it collapsed: fewer than {MIN_EFFECTIVE} "
            "effective particles, whose covariance is not to be trusted"
        )
    if row.inaccurate.value > MENTION_SHARE:
        notes.append(
            f"in {format_percent(row.inaccurate.value)} of the runs its own numerical error may be more than "
            f"{MAX_ERROR:g} of a deviation; where cells are given (cell_m), smaller ones mend it"
        )
    if row.undirected.value > MENTION_SHARE:
        notes.append(
            f"in {format_percent(row.undirected.value)} of the runs headings are spread so evenly that none "
            "is their mean: errors and claims of the heading mean nothing there"
        )
    if row.improbable.value > MENTION_SHARE:
        share = format_percent(row.improbable.value)
        notes.append(f"in {share} of the runs its own model all but excludes what was measured")
    if row.one_truth:
        notes.append(
            "all runs have the same true state: an exact Bayesian filter is honest on average over its "
            "prior, not at each place of it, so this verdict holds for this place alone"
        )
    return tuple(notes)


def _needed(known: Interval, runs: int) -> str:
    """How many runs would tell, the interval shrinking as their root."""
    _, low, high = known
    if not (0 < low < math.inf and 0 < high < math.inf):
        return "too few runs for an interval"
    wide = max(math.log(high), -math.log(low)) / math.log(LARGE_FACTOR)
    about = runs * wide**2
    digits = 10 ** max(0, math.floor(math.log10(about)) - 1)
    return (
        f"squared errors may be {format_number(low)} to {format_number(high)} times what is claimed; about "
        f"{math.ceil(about / digits) * digits} runs would tell"
    )
