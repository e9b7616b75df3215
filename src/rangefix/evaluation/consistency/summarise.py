"""The rows of a study: truth against claim, over the runs that went well.

Runs come in blocks: three passes over them, and no more memory than a block.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from ...arrays import Array, BoolArray
from ..results import STATUSES, Results, Status, Trials, failures_of
from .averages import AVERAGES, Mean
from .belief_scores import rank_histogram
from .intervals import LEVEL, UNKNOWN, Interval
from .metrics import Metric, RunBlock, metrics
from .null_distribution import NullSums
from .row import Row
from .scores import along_principal_axes

PASSES = 3  # over the runs: means; what varies about the means; what varies about G


def summarise(results: Results) -> list[Row]:
    """One row for each estimator, set of beams and step, over the runs that went well; made once."""
    kept = vars(results)
    if "_rows" not in kept:
        pairs = product(results.estimators, results.beam_sets)
        kept["_rows"] = [row for pair in pairs for row in _rows(results, *pair)]
    rows: list[Row] = kept["_rows"]
    return rows


def _rows(results: Results, estimator: str, beams: str) -> Iterator[Row]:
    """The rows of one estimator on one set of beams, block by block."""
    ranges = list(results.blocks())
    accumulators: list[Accumulator] = []
    blocks: list[RunBlock] = []
    for number in range(PASSES):
        for first, end in ranges:
            if number == 0 or len(ranges) > 1:
                trials = results.source.trials(estimator, beams, first, end)
                blocks = run_blocks(results, trials, first, trials.ok)
                accumulators = accumulators or [Accumulator(results.space.names) for _ in blocks]
            for accumulator, block in zip(accumulators, blocks, strict=True):
                accumulator.add(number, block)
    low, high = results.timing_range.get((estimator, beams), (np.nan, np.nan))
    seconds = Interval(results.timing.get((estimator, beams), np.nan), low, high)
    for step, accumulator in enumerate(accumulators):
        row = accumulator.row(estimator, beams, step, seconds, results.one_truth)
        cut = results.timing_cut.get((estimator, beams))
        yield replace(row, updates_timed=cut, running=results.running)


def run_blocks(results: Results, trials: Trials, first: int, ok: BoolArray) -> list[RunBlock]:
    """Runs of one estimator, a block for each step.

    Args:
        results: The results.
        trials: Some of its trials, of M runs that follow each other.
        first: The first of these runs.
        ok: Which of them to take, (M,).
    """
    truth = results.source.world(first, first + len(ok))[0]
    errors = results.space.difference(truth, trials.mean)
    last = errors.shape[1] - 1
    return [
        RunBlock(
            results.space.names,
            errors[ok, step],
            trials.covariance[ok, step],
            log_evidence=trials.log_evidence[ok, step],
            improbable=trials.improbable[ok, step],
            status=trials.status,
            belief=trials.belief(step, ok),
            diagnostics={name: array[ok, step] for name, array in trials.diagnostics.items()},
            draws=None if trials.draws is None else trials.draws[ok, step],
            bounds=results.bounds.get(trials.beams) if step == last else None,
        )
        for step in range(errors.shape[1])
    ]


class Accumulator:
    """What all runs of one estimator come to; each block is added in each pass, in the same order."""

    def __init__(self, names: tuple[str, ...], table: Sequence[Metric] | None = None) -> None:
        self.names, self.runs, self.counts = names, 0, np.zeros(len(STATUSES), dtype=int)
        self.table = metrics() if table is None else table
        self.averages: dict[str, dict[str, Mean]] = {metric.name: {} for metric in self.table}
        self.squares, self.claims = np.zeros((2, len(names), len(names)))
        self.ranks: Array = np.zeros(())
        self.null, self.directions = NullSums(names), np.zeros((len(names), len(names)))

    @classmethod
    def of(cls, runs: RunBlock, table: Sequence[Metric] | None = None) -> Accumulator:
        """After all passes over runs that are at hand."""
        accumulator = cls(runs.names, table)
        for number in range(PASSES):
            accumulator.add(number, runs)
        return accumulator

    def add(self, number: int, runs: RunBlock) -> None:
        """Add a block in a pass, 0, 1 or 2."""
        if number == 0:
            self.runs += len(runs.errors)
            self.counts += np.bincount(runs.status, minlength=len(STATUSES))
            self.squares = self.squares + runs.errors.T @ runs.errors
            self.claims = self.claims + runs.covariance.sum(0)
            self.null.add(runs)
            whitened = along_principal_axes(runs.errors, runs.covariance)
            self.directions = self.directions + whitened.T @ whitened
            if runs.belief is not None:
                ranks = (*runs.belief.ranks.T, runs.belief.distance_rank)
                self.ranks = self.ranks + np.stack([rank_histogram(column) for column in ranks])
        for metric in self.table:
            average, columns = AVERAGES[metric.average], self.averages[metric.name]
            if number < average.passes:
                for column, values in metric.values(runs).items():
                    columns.setdefault(column, average()).add(number, values, runs.errors)

    def figures(self, level: float = LEVEL) -> dict[str, Interval]:
        """The figures after all passes, by column, in the order of the table."""
        return {
            column: average.interval(level)
            for columns in self.averages.values()
            for column, average in columns.items()
        }

    def p_values(self) -> dict[str, float]:
        """p-values of the figures that an honest estimator fixes, by column; NaN = cannot say."""
        return {
            column: average.p_value(metric.honest)
            for metric in self.table
            if metric.honest is not None
            for column, average in self.averages[metric.name].items()
        }

    def row(
        self,
        estimator: str = "",
        beams: str = "",
        step: int = 0,
        seconds: Interval = UNKNOWN,
        one_truth: bool = False,
    ) -> Row:
        """The row after all passes."""
        runs, figures = self.runs or np.nan, self.figures()
        claims = self.claims / runs
        drawn = self.null.runs == self.runs  # not if a batch of the runs could not be sampled
        sound = bool(self.runs) and bool(np.isfinite(self.directions).all())
        null = self.null.distribution(figures, claims.diagonal()) if drawn else None
        alone = figures.get("anees")
        if alone is not None and null is not None and null.coherent and np.isfinite(alone.value):
            _, low, high = null.range_of(alone.value)
            figures["anees"] = Interval(alone.value, min(alone.low, low), max(alone.high, high))
        return Row(
            estimator=estimator,
            beams=beams,
            step=step,
            names=self.names,
            planned=int(self.counts.sum()),
            ok=self.runs,
            failures=failures_of(self.counts),
            G=self.squares / runs,
            P=claims,
            figures=figures,
            seconds=seconds.value,
            seconds_range=(seconds.low, seconds.high),
            p_values=self.p_values(),
            one_truth=one_truth,
            ranks=self.ranks if self.ranks.ndim else None,
            null=null,
            anees_of_runs=alone,
            pending=int(self.counts[Status.PENDING.code]),
            directions=np.asarray(np.linalg.eigvalsh(self.directions) / runs, float) if sound else None,
        )
