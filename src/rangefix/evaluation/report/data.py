"""What a report shows of a study, as plain records: verdicts, tables, calibration, failures, origin."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ..consistency import (
    CERTAIN,
    LARGE_FACTOR,
    Gate,
    GateLine,
    Kind,
    Row,
    Verdict,
    check_gates,
    decide,
    decide_overall,
    format_factor,
    format_interval,
)
from ..consistency.summarise import summarise
from ..results import MAX_RUNS_IN_MEMORY, Results
from .calibration import Strip, calibration_of, course
from .tables import Table, overview, scores

SIGNS: dict[Kind, tuple[str, str]] = {
    "honest": ("\u2713", "honest"),
    "overconfident": ("!", "overconfident"),
    "cautious": ("\u2193", "too cautious"),
    "uneven": ("!", "uneven"),
    "biased": ("\u2192", "biased"),
    "unsure": ("?", "cannot tell"),
    "failed": ("\u00d7", "no answer"),
}
MAX_REASONS_SHOWN = 8  # of the failures of one estimator


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
    by_beams = {beams: place for place, beams in enumerate(results.beam_sets)}
    last = sorted((row for row in rows if row.step == steps - 1), key=lambda row: by_beams[row.beams])
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
        table=overview(last),
        scores=scores(last, sampled),
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
        {
            metric.full_label(name): format_interval(metric.in_shown_unit(interval, name))
            for metric, name, interval in row.shown("report")
        },
        Counter(trials.reasons.values()),
    )


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
