"""What a report shows of a study, as plain records: verdicts, tables, calibration, failures, origin."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from ..comparison.paired import compare_estimators
from ..comparison.worst_runs import WorstRun, worst_runs
from ..consistency.formatting import format_interval
from ..consistency.gates import Gate, GateLine, check_gates
from ..consistency.null_distribution import LARGE_FACTOR
from ..consistency.row import Row
from ..consistency.summarise import run_blocks, summarise
from ..consistency.verdict import (
    CERTAIN,
    Kind,
    Verdict,
    decide,
    decide_overall,
    short_factor,
)
from ..results import MAX_RUNS_IN_MEMORY, Results
from .calibration import Strip, calibration_of, course
from .tables import Table, accuracy, overview, scores
from .worst import WhereItFails, where_it_fails

SIGNS: dict[Kind, tuple[str, str]] = {
    "honest": ("\u2713", "honest"),
    "overconfident": ("!", "overconfident"),
    "cautious": ("\u2193", "too cautious"),
    "uneven": ("!", "uneven"),
    "biased": ("\u2192", "biased"),
    "shape": ("~", "wrong shape"),
    "unsure": ("?", "cannot tell"),
    "failed": ("\u00d7", "no answer"),
    "pending": ("\u2026", "not run yet"),
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
                word = f"{word} {short_factor(verdict.factor)}".rstrip()
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
        calibrated: Of how many runs, the first ones, that is.
        course: ANEES / n after each measurement; None where there is one.
        figures: Label -> figure with its interval.
        failures: Why trials failed -> how many did.
        worst: The runs with the largest errors against the claim, over all steps.
    """

    row: Row
    verdict: Verdict
    calibration: Sequence[Strip]
    calibrated: int
    course: Strip | None
    figures: dict[str, str]
    failures: Counter[str]
    worst: Sequence[WorstRun]


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
        results: The study; its manifest says where the numbers come from.
        steps: Measurements in a run.
        ok, made: Trials that went well, and those that were made.
        sampled: Whether an estimator's belief was sampled.
        estimators: Each estimator.
        table, scores: Of all settings after the last measurement.
        accuracy: Who is more accurate on the same truths.
        gates: What gates made of the rows.
        fails: The worst runs of all, and where they were; None where none went well.
    """

    results: Results
    steps: int
    ok: int
    made: int
    sampled: bool
    estimators: Sequence[EstimatorReport]
    table: Table
    scores: Table
    accuracy: Table
    gates: Sequence[GateLine]
    fails: WhereItFails | None


def collect(results: Results, gates: Sequence[Gate] = ()) -> ReportData:
    """Work out what a report shows."""
    rows = summarise(results)
    steps = 1 + max(row.step for row in rows)
    last = [row for beams in results.beam_sets for row in rows if (row.beams, row.step) == (beams, steps - 1)]
    worst = worst_runs(results)
    sampled = any(row.beliefs is not None for row in last)
    return ReportData(
        results,
        steps,
        ok=sum(row.ok for row in last),
        made=sum(row.made for row in last),
        sampled=sampled,
        estimators=[_estimator(results, label, rows, worst) for label in results.estimators],
        table=overview(last),
        scores=scores(last, sampled),
        accuracy=accuracy(compare_estimators(results)),
        gates=check_gates(gates, rows),
        fails=where_it_fails(results, worst, steps),
    )


def _estimator(
    results: Results, label: str, rows: Sequence[Row], worst: Sequence[WorstRun]
) -> EstimatorReport:
    """One estimator, from the rows of all."""
    own = [row for row in rows if row.estimator == label]
    settings = [
        _setting(results, [row for row in own if row.beams == beams], worst) for beams in results.beam_sets
    ]
    described = results.manifest.get("estimators", {}).get(label, {})
    builder = described.get("name") or described.get("builder") or label
    options = ", ".join(f"{key} = {value}" for key, value in (described.get("options") or {}).items())
    return EstimatorReport(label, decide_overall(own), builder, options, settings)


def _setting(results: Results, rows: Sequence[Row], worst: Sequence[WorstRun]) -> Setting:
    """One estimator on one set of beams, from its rows by step."""
    row = rows[-1]
    runs = min(results.runs, MAX_RUNS_IN_MEMORY)
    trials = results.source.trials(row.estimator, row.beams, 0, runs)
    reasons = Counter(trials.reasons.values())
    for first, last in results.blocks() if row.ok < row.made else ():
        if first >= runs:
            reasons.update(results.source.trials(row.estimator, row.beams, first, last).reasons.values())
    verdicts = [(step.anees, colour(decide(step))) for step in rows]
    return Setting(
        row,
        decide(row),
        calibration_of(run_blocks(results, trials, 0, trials.ok)[-1]) if trials.ok.any() else [],
        runs,
        course(verdicts) if row.ok and len(rows) > 1 else None,
        {
            metric.full_label(name): format_interval(metric.in_shown_unit(interval, name))
            for metric, name, interval in row.shown("report")
        },
        reasons,
        [run for run in worst if (run.estimator, run.beams) == (row.estimator, row.beams)],
    )
