"""What a report shows of a study, as plain records: verdicts, tables, calibration, failures, origin."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ..consistency import (
    CERTAIN,
    LARGE_FACTOR,
    Gate,
    GateLine,
    Interval,
    Kind,
    Row,
    Verdict,
    beams_in_words,
    check_gates,
    decide,
    decide_overall,
    factor,
    format_factor,
    format_interval,
    format_number,
    format_percent_interval,
    scaled,
    uniform_p_value,
    unit,
)
from ..consistency.summarise import summarise
from ..results import MAX_RUNS_IN_MEMORY, Results
from .calibration import Strip, calibration_of, course

SIGNS: dict[Kind, tuple[str, str]] = {
    "honest": ("\u2713", "honest"),
    "overconfident": ("!", "overconfident"),
    "cautious": ("\u2193", "too cautious"),
    "uneven": ("!", "uneven"),
    "biased": ("\u2192", "biased"),
    "unsure": ("?", "cannot tell"),
    "failed": ("\u00d7", "no answer"),
}
SMALLEST_P_VALUE_SHOWN = 1e-6
MAX_REASONS_SHOWN = 8  # of the failures of one estimator


class Cell(NamedTuple):
    """What stands in a cell of a table: a value and, small beneath it, the ends of its interval."""

    value: str
    ends: str = ""

    @classmethod
    def of(cls, interval: Interval, by: float = 1.0) -> Cell:
        """An interval in another unit."""
        value, _, ends = format_interval(scaled(interval, by)).partition(" ")
        return cls(value, ends)


class Table(NamedTuple):
    """A table of estimators, in groups by set of beams.

    Attributes:
        columns: Headings of all columns but the first.
        groups: The heading of each group, and in it the estimators with their cells.
    """

    columns: list[str]
    groups: list[tuple[str, list[tuple[str, list[Cell]]]]]


class Badge(NamedTuple):
    """A verdict at a glance: a sign, a word or two, and the class that colours it."""

    sign: str
    word: str
    colour: str

    @classmethod
    def of(cls, verdict: Verdict, with_factor: bool = False) -> Badge:
        """The badge of a verdict, with its factor if asked for."""
        sign, word = SIGNS[verdict.kind]
        value = verdict.factor.value
        if verdict.kind in ("overconfident", "cautious") and 0 < value <= CERTAIN:
            if 1 / LARGE_FACTOR <= value <= LARGE_FACTOR:
                word = f"a little {word.removeprefix('too ')}"
            if with_factor:
                word += f" \u00d7 {format_factor(max(value, 1 / value))}"
        return cls(sign, word, colour(verdict))


def colour(verdict: Verdict) -> str:
    """The class that colours a verdict."""
    return "mild" if verdict.kind == "overconfident" and not verdict.severe else verdict.kind


@dataclass(frozen=True)
class Setting:
    """One estimator on one set of beams after the last measurement.

    Attributes:
        row: Its row.
        verdict: The verdict on that row alone.
        calibration: Coverage, PIT or ranks, reliability of the runs that went well; none if none did.
        course: ANEES / n after each measurement; None where there is one.
        figures: Label -> figure with its interval.
        failures: Why trials failed -> how many did.
    """

    row: Row
    verdict: Verdict
    calibration: Sequence[Strip]
    course: Strip | None
    figures: dict[str, str]
    failures: Counter[str]


@dataclass(frozen=True)
class EstimatorReport:
    """One estimator: its label, its verdict in all settings, builder and options, and each setting."""

    name: str
    verdict: Verdict
    builder: str
    options: str
    settings: Sequence[Setting]

    @property
    def failed(self) -> bool:
        """Whether a trial failed."""
        return any(setting.row.failures for setting in self.settings)

    @property
    def reasons(self) -> list[tuple[str, int]]:
        """Why its trials failed and how many did, the most frequent first."""
        return sum((setting.failures for setting in self.settings), Counter[str]()).most_common()


@dataclass(frozen=True)
class ReportData:
    """All that a report shows of a study, but its figures.

    Attributes:
        title: Of the study.
        complete: Whether it was finished.
        summary: How many runs, estimators, sets of beams, and so on.
        steps: Measurements in a run.
        sampled: Whether an estimator's belief was sampled.
        estimators: Each estimator.
        table, scores: Of all settings after the last measurement.
        gates: What gates made of the rows.
        origin: Where the numbers come from, and how to have them again.
        config: The study file.
    """

    title: str
    complete: bool
    summary: Sequence[str]
    steps: int
    sampled: bool
    estimators: Sequence[EstimatorReport]
    table: Table
    scores: Table
    gates: Sequence[GateLine]
    origin: dict[str, str]
    config: str


def collect(results: Results, gates: Sequence[Gate] = ()) -> ReportData:
    """Work out what a report shows."""
    rows, manifest = summarise(results), results.manifest
    steps = 1 + max(row.step for row in rows)
    estimators = []
    for label in results.estimators:
        own = [row for row in rows if row.estimator == label]
        settings = [_setting(results, [row for row in own if row.beams == b]) for b in results.beam_sets]
        described = manifest.get("estimators", {}).get(label, {})
        builder = described.get("name") or described.get("builder") or label
        options = ", ".join(f"{key} = {value}" for key, value in (described.get("options") or {}).items())
        estimators.append(EstimatorReport(label, decide_overall(own), builder, options, settings))
    last = [row for row in rows if row.step == steps - 1]
    summary = [
        f"{results.runs} runs",
        _count(len(results.estimators), "estimator"),
        _count(len(results.beam_sets), "set") + " of beams",
        _count(steps, "measurement") + " a run",
        f"seed {manifest.get('seed', 'unknown')}",
        f"{sum(row.ok for row in last)} of {sum(row.planned for row in last)} trials went well",
    ]
    sampled = any(row.beliefs is not None for row in last)
    return ReportData(
        title=manifest.get("title") or manifest.get("name") or "study",
        complete=manifest.get("state") == "complete",
        summary=summary,
        steps=steps,
        sampled=sampled,
        estimators=estimators,
        table=_table(last, results.beam_sets),
        scores=_scores(last, results.beam_sets, sampled),
        gates=check_gates(gates, rows),
        origin=_origin(manifest),
        config=manifest.get("config") or "",
    )


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' * (number != 1)}"


def _setting(results: Results, rows: Sequence[Row]) -> Setting:
    """One estimator on one set of beams, from its rows by step."""
    row = rows[-1]
    trials = results.source.trials(row.estimator, row.beams, 0, min(results.runs, MAX_RUNS_IN_MEMORY))
    ok = trials.ok
    truth = results.source.world(0, len(ok))[0][:, -1]
    errors = results.space.difference(truth, trials.mean[:, -1])[ok]
    belief = trials.belief(-1)
    if belief is not None and not np.isfinite(belief.energy).all():
        belief = None  # of a folder whose parts were made in part without samples
    strips = calibration_of(row.names, errors, trials.covariance[ok, -1], belief) if row.ok else []
    verdicts = [(each.anees, colour(decide(each))) for each in rows]
    return Setting(
        row,
        decide(row),
        strips,
        course(verdicts) if row.ok and len(rows) > 1 else None,
        dict(_figures(row)),
        Counter(trials.reasons.values()),
    )


def _figures(row: Row) -> Iterator[tuple[str, str]]:
    """All figures of a row with their intervals."""
    scores, beliefs = row.scores, row.beliefs
    components = [(name, unit(name), factor(name)) for name in row.names]
    for i, (name, shown, k) in enumerate(components):
        yield f"G / P of {name} (1 = honest)", format_interval(row.ratio[i])
        yield f"mean error of {name}, {shown}", format_interval(scaled(row.bias[i], k))
        yield f"CRPS of {name}, {shown} (Gaussian claim)", format_interval(scaled(scores.crps[i], k))
    yield "ANEES / n", format_interval(row.anees)
    yield "NCI, dB", format_interval(row.nci)
    yield "inclination, dB", format_interval(row.inclination)
    yield "energy score of the position, m (Gaussian claim)", format_interval(scores.energy)
    yield "log score, nats (Gaussian claim at the truth; lower is better)", format_interval(scores.log)
    yield "log evidence, nats (of the measurements; higher is better)", format_interval(scores.evidence)
    for level, share in row.coverage.items():
        yield f"inside the {100 * level:g} % ellipse", format_percent_interval(share)
    if row.indefinite.value > 0:
        yield "covariance not positive definite", format_percent_interval(row.indefinite)
    if row.improbable.value > 0:
        yield "improbable measurements", format_percent_interval(row.improbable)
    if beliefs is not None:
        yield "energy score of the position, m (sampled belief)", format_interval(beliefs.energy)
        yield "mean share of the main mode", format_percent_interval(beliefs.share)
        for i, (name, shown, k) in enumerate(components):
            yield f"CRPS of {name}, {shown} (sampled belief)", format_interval(scaled(beliefs.crps[i], k))
            pair = _root_pair(beliefs.whole[i], beliefs.mode[i], k)
            yield f"std of {name}, {shown}: whole belief / main mode", pair


def _root_pair(one: Interval, other: Interval, by: float) -> str:
    """The roots of two variances beside each other."""
    return " / ".join(format_number(by * variance.sqrt().value) for variance in (one, other))


def _grouped(rows: Sequence[Row], beam_sets: Sequence[str]) -> Iterator[tuple[str, list[Row]]]:
    return ((beams_in_words(beams), [row for row in rows if row.beams == beams]) for beams in beam_sets)


def _table(rows: Sequence[Row], beam_sets: Sequence[str]) -> Table:
    """True and claimed standard deviations, ANEES / n and energy score."""
    stds = [f"std of {name}, {unit(name)}: true / claimed" for name in rows[0].names]
    columns = ["ok", *stds, "ANEES / n", "energy score, m", "ms per update"]

    def cells(row: Row) -> list[Cell]:
        pairs = [
            _root_pair(true, claimed, factor(name)) if row.ok else "-"
            for true, claimed, name in zip(row.g, row.p, row.names, strict=True)
        ]
        return [
            Cell(str(row.ok) if row.ok == row.planned else f"{row.ok} of {row.planned}"),
            *map(Cell, pairs),
            Cell.of(row.anees),
            Cell.of(row.scores.energy),
            Cell(format_number(1e3 * row.seconds) if math.isfinite(row.seconds) else "-"),
        ]

    groups = [
        (beams, [(row.estimator, cells(row)) for row in some]) for beams, some in _grouped(rows, beam_sets)
    ]
    return Table(columns, groups)


def _scores(rows: Sequence[Row], beam_sets: Sequence[str], sampled: bool) -> Table:
    """Scores of each Gaussian claim and, where beliefs were sampled, of the belief itself."""
    names, both = rows[0].names, ": claim / belief" if sampled else ""
    columns = [f"log score{' of the claim' if sampled else ''}, nats", f"energy score, m{both}"]
    columns += [f"CRPS of {name}, {unit(name)}{both}" for name in names]
    if sampled:
        columns += [f"std of {name}, {unit(name)}: whole belief / main mode" for name in names]
        columns += ["share of the main mode", "ranks, p"]

    def score(claim: Interval, belief: Interval | None, by: float) -> Cell:
        if not sampled:
            return Cell.of(claim, by)
        values = [math.nan if interval is None else by * interval.value for interval in (claim, belief)]
        return Cell(" / ".join("-" if math.isnan(value) else format_number(value) for value in values))

    def cells(row: Row) -> list[Cell]:
        claim, belief, factors = row.scores, row.beliefs, [factor(name) for name in names]
        line = [Cell.of(claim.log), score(claim.energy, belief and belief.energy, 1.0)]
        for i, by in enumerate(factors):
            line.append(score(claim.crps[i], belief and belief.crps[i], by))
        if belief is None:
            return line + [Cell("-")] * (len(columns) - len(line))
        variances = zip(belief.whole, belief.mode, factors, strict=True)
        line += [Cell(_root_pair(*pair)) for pair in variances]
        p_value = _format_p_value(uniform_p_value(belief.ranks[-1]))
        return [*line, Cell(f"{100 * belief.share.value:.3g} %"), Cell(p_value)]

    groups = [
        (beams, [(row.estimator, cells(row)) for row in some]) for beams, some in _grouped(rows, beam_sets)
    ]
    return Table(columns, groups)


def _format_p_value(p: float) -> str:
    if math.isnan(p):
        return "-"
    return f"{p:.2g}" if p >= SMALLEST_P_VALUE_SHOWN else f"< {SMALLEST_P_VALUE_SHOWN:g}"


def _origin(manifest: dict[str, Any]) -> dict[str, str]:
    """Where the numbers come from."""
    git, machine, versions, threads = (
        manifest.get(key) or {} for key in ("git", "machine", "versions", "threads")
    )
    commit = f"{git.get('commit', '')}{' with local changes' if git.get('dirty') else ''}"
    return {
        "command": " ".join(map(str, manifest.get("command_line") or [])) or "from Python",
        "date": manifest.get("date", ""),
        "seed": manifest.get("seed", ""),
        "rangefix": versions.get("rangefix", ""),
        "commit": commit if git else "no checkout",
        "libraries": ", ".join(
            f"{name} {version}" for name, version in versions.items() if name != "rangefix"
        ),
        "processor": f"{machine.get('cpu', '')}, {machine.get('cores', '')} cores",
        "system": machine.get("system", ""),
        "threads": ", ".join(f"{name}={count}" for name, count in threads.items() if count)
        or "as the libraries choose",
    }
