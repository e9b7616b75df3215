"""One row of the comparison table, and its CSV."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, cast

from ...arrays import Array
from ...errors import counted, printable
from ..results import FAILURES, html_table
from .formatting import beams_in_words, factor, format_interval, format_number
from .intervals import UNKNOWN, Interval, uniform_p_value
from .metrics import LEVELS, Metric, Place, metrics
from .null_distribution import NullDistribution
from .scores import anees_band

FORMULAS = ("=", "+", "-", "@", "\t", "\r", "\n", "\uff1d", "\uff0b", "\uff0d", "\uff20")  # begin so


class ClaimScores(NamedTuple):
    """Mean scores of the Gaussian claim; see `metrics.py`. The evidence is of the measurements."""

    log: Interval
    energy: Interval
    crps: tuple[Interval, ...]
    evidence: Interval


class BeliefSummary(NamedTuple):
    """What draws from the beliefs themselves come to, whatever their shape. See `belief_scores.py`.

    Attributes:
        energy, crps: Mean scores, the second of each component.
        whole, mode: Mean variances of the whole belief, and of its main mode alone, in each component.
        share: Mean share of the main mode.
        ranks: How often the truth has each rank among the draws, in equal bins; a row for each component and
            one for the distance from the middle of the belief, (n + 1, bins).
    """

    energy: Interval
    crps: tuple[Interval, ...]
    whole: tuple[Interval, ...]
    mode: tuple[Interval, ...]
    share: Interval
    ranks: Array


def _figure(name: str, meaning: str) -> Interval:
    """A property of a row, typed as what it gives: the figure of this name."""
    return cast(Interval, property(lambda row: row.figures[name], doc=meaning))


def _components(name: str, meaning: str) -> tuple[Interval, ...]:
    """The same for the figures of this name of all components."""
    return cast(tuple[Interval, ...], property(lambda row: row.of_components(name), doc=meaning))


@dataclass(frozen=True)
class Row:
    """One estimator on one set of beams at one step: what it claims against what is true.

    Averages are over the `ok` of the `planned` runs; lengths in metres, angles in rad, variances in m^2 or
    rad^2. A figure is an interval (value, low, high; 95 %).

    Attributes:
        estimator, beams: Labels.
        step: Number of the measurement, from 0.
        names: Names of the components.
        planned, ok: Runs planned, and runs that went well.
        failures: Runs that failed by status, of those that occurred.
        G: Unconditional covariance E[(x - x^)(x - x^)'], (n, n).
        P: Mean of the claimed (conditional) covariances, (n, n).
        figures: Figure -> its interval, as in the table of `metrics.py`. The properties name our own.
        seconds: Per update and run, median of serial passes on one thread; NaN if not timed.
        seconds_range: The least and the greatest of the passes, between which the median is in 97 of 100
            cases: an estimator is faster than another only where these do not overlap.
        updates_timed: How many updates of a run were timed, its first ones; None if all.
        p_values: Figure -> p-value against an honest estimator: see `intervals.py`.
        one_truth: Whether all runs have the same true state: an exact Bayesian filter is honest on average
            over its prior, and need not be at one place of it.
        ranks: See `BeliefSummary`; None where beliefs were not judged.
        null: How figures scatter where truths are draws from the beliefs; None without draws of all runs.
        directions: Mean squared errors over claimed variances along lines at right angles in the frame of the
            claims' principal axes, the least and the largest first and last, (n,); their mean is ANEES / n.
        pending: Of the runs planned, those that were not made yet, as the study was interrupted.
        running: Whether a process was still making them.
        anees_of_runs: ANEES / n with the interval that the runs alone give; that of `anees` holds it, and a
            far mode of the beliefs that no truth was in counts there.
    """

    estimator: str
    beams: str
    step: int
    names: tuple[str, ...]
    planned: int
    ok: int
    failures: dict[str, int]
    G: Array
    P: Array
    figures: dict[str, Interval]
    seconds: float
    seconds_range: tuple[float, float]
    p_values: dict[str, float] = field(default_factory=dict)
    one_truth: bool = False
    ranks: Array | None = None
    null: NullDistribution | None = None
    directions: Array | None = None
    pending: int = 0
    anees_of_runs: Interval | None = None
    updates_timed: int | None = None
    running: bool = False

    g = _components("G", "Diagonal of G.")
    p = _components("P", "Diagonal of P.")
    ratio = _components("ratio", "G_ii / P_ii, paired: 1 = honest, above 1 = overconfident.")
    rmse = _components("rmse", "Root mean square error, sqrt G_ii.")
    bias = _components("bias", "Mean error x - x^.")
    anees = _figure("anees", "Average NEES over n: 1 = honest; inf if a P is not positive definite.")
    nci = _figure("nci_db", "Noncredibility index of Li and Zhao, dB.")
    inclination = _figure("inclination_db", "Inclination index of Li and Zhao, dB.")
    indefinite = _figure("share_indefinite", "Share of ok runs whose P is not positive definite.")
    diverged = _figure("share_diverged", "Share of planned runs that no hypothesis explained.")
    improbable = _figure("share_improbable", "Share of ok runs whose evidence lies below the floor.")

    @property
    def made(self) -> int:
        """Runs that were made, of those planned."""
        return self.planned - self.pending

    def of_components(self, name: str) -> tuple[Interval, ...]:
        """A figure of each component."""
        return tuple(self.figures[f"{name}_{component}"] for component in self.names)

    @property
    def bound(self) -> tuple[Interval, ...] | None:
        """Variances below which no estimator's lie; NaN where no bound applies, None where none was saved."""
        columns = [f"bound_{component}" for component in self.names]
        return self.of_components("bound") if set(columns) <= self.figures.keys() else None

    @property
    def inaccurate(self) -> Interval:
        """Share of ok runs whose numerical error matters; NaN where an estimator states none."""
        return self.figures.get("share_inaccurate", UNKNOWN)

    @property
    def undirected(self) -> Interval:
        """Share of ok runs whose heading has no circular mean; NaN where an estimator does not say."""
        return self.figures.get("share_undirected", UNKNOWN)

    @property
    def collapsed(self) -> Interval:
        """Share of ok runs with too few effective particles; NaN without particles."""
        return self.figures.get("share_collapsed", UNKNOWN)

    @property
    def coverage(self) -> dict[float, Interval]:
        """Level of ellipse -> share of runs inside it."""
        return {level: self.figures[f"coverage_{100 * level:g}"] for level in LEVELS}

    @property
    def anees_band(self) -> tuple[float, float]:
        """Reference only: where ANEES / n would lie for Gaussian posteriors (chi-square)."""
        return anees_band(self.ok, len(self.names))

    @property
    def scores(self) -> ClaimScores:
        """Of the Gaussian claims."""
        log, energy, evidence = (self.figures[name] for name in ("log_score", "energy_score", "log_evidence"))
        return ClaimScores(log, energy, self.of_components("crps"), evidence)

    @property
    def beliefs(self) -> BeliefSummary | None:
        """What draws from the beliefs come to; None where they were not sampled."""
        if self.ranks is None:
            return None
        crps, whole, mode = map(self.of_components, ("belief_crps", "belief_P", "belief_main_mode_P"))
        energy, share = (self.figures[f"belief_{name}"] for name in ("energy_score", "main_mode_share"))
        return BeliefSummary(energy, crps, whole, mode, share, self.ranks)

    def shown(self, place: Place) -> Iterator[tuple[Metric, str, Interval]]:
        """The figures that the table of metrics shows in a place: metric, component or "", interval."""
        for metric in metrics():
            for component in ("", *self.names):
                if place in metric.shown and metric.column(component) in self.figures:
                    yield metric, component, self.figures[metric.column(component)]

    def flat(self) -> dict[str, str | int | float]:
        """The row as columns: name -> value, with `_low` and `_high` beside each figure that has them."""
        row: dict[str, str | int | float] = {
            name: getattr(self, name) for name in ("estimator", "beams", "step", "planned", "ok")
        }
        row |= {status: self.failures.get(status, 0) for status in FAILURES}
        for metric, component, interval in self.shown("csv"):
            name = metric.column(component)
            row |= {name: interval.value, f"{name}_low": interval.low, f"{name}_high": interval.high}
        row["anees_gauss_low"], row["anees_gauss_high"] = self.anees_band
        for i, one in enumerate(self.names):
            for j, other in enumerate(self.names[:i]):
                row |= {f"G_{other}_{one}": float(self.G[j, i]), f"P_{other}_{one}": float(self.P[j, i])}
        row["seconds_per_update"] = self.seconds
        row["seconds_per_update_low"], row["seconds_per_update_high"] = self.seconds_range
        if self.ranks is not None:
            names = [f"belief_rank_p_{name}" for name in (*self.names, "distance")]
            row |= dict(zip(names, map(uniform_p_value, self.ranks), strict=True))
        return row

    def __repr__(self) -> str:
        """What it is of, and the figures that a terminal shows."""
        figures = (": ".join(line) for line in self._lines("terminal"))
        return "\n  ".join(printable(line) for line in [f"Row of {self._title()}", *figures])

    def _repr_html_(self) -> str:
        """The figures of a report as a table, for notebooks."""
        return html_table(self._title(), ("figure", "value [95 %]"), self._lines("report"))

    @property
    def where(self) -> str:
        """Whose it is: the estimator, the beams and the measurement, in words."""
        beams = f", {beams_in_words(self.beams)}" if self.beams else ""
        return f"{self.estimator}{beams}, measurement {self.step + 1}"

    @property
    def milliseconds(self) -> str:
        """The time per update and run as tables show it, ms."""
        return format_number(1e3 * self.seconds) if math.isfinite(self.seconds) else "-"

    @property
    def milliseconds_range(self) -> str:
        """The same with the least and the greatest of its passes, or how few updates it is of."""
        if self.updates_timed is not None:
            return f"{self.milliseconds} (first {self.updates_timed} of a run)"
        if not all(map(math.isfinite, self.seconds_range)):
            return self.milliseconds
        low, high = (format_number(1e3 * seconds) for seconds in self.seconds_range)
        return f"{self.milliseconds} [{low}, {high}]"

    def pairs_of_stds(self, *variances: Sequence[Interval]) -> list[str]:
        """The roots of two variances of each component beside each other, as tables show them."""
        pairs = [
            [format_number(factor(name) * variance.sqrt().value) for variance in pair]
            for name, *pair in zip(self.names, *variances, strict=True)
        ]
        return ["-" if {*pair} == {"-"} else " / ".join(pair) for pair in pairs]

    def stds_beside_bound(self, bounded: bool) -> list[str]:
        """True and claimed standard deviations and, if asked for, before them that of the largest bound."""
        bound = (self.bound or [UNKNOWN] * len(self.names),) if bounded else ()
        return self.pairs_of_stds(*bound, self.g, self.p)

    def _title(self) -> str:
        return f"{self.where}: {self.ok} of {counted(self.made, 'run')} ok"

    def _lines(self, place: Place) -> Iterator[tuple[str, str]]:
        for metric, component, interval in self.shown(place):
            shown = metric.in_shown_unit(interval, component)
            yield metric.full_label(component), format_interval(shown)


def to_csv(rows: Sequence[Row]) -> str:
    """The rows as CSV text with a header; floats in full. A figure that a row does not have is nan.

    Text that a spreadsheet would compute, such as a label that begins with =, has an apostrophe before it;
    what a terminal would obey is written as escapes.
    """
    lines = [row.flat() for row in rows]
    text = io.StringIO()
    columns = dict.fromkeys(name for line in lines for name in line)
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(map(csv_cell, columns))
    writer.writerows([csv_cell(line.get(name, "nan")) for name in columns] for line in lines)
    return text.getvalue()


def csv_cell(value: object) -> object:
    """A cell of a table that a spreadsheet may open: text is never a formula (OWASP, CSV injection)."""
    if not isinstance(value, str):
        return value
    return printable(f"'{value}" if value.startswith(FORMULAS) else value)
