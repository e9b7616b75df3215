"""The row of one estimator, from runs that come in blocks: three passes, and no more memory than a block."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...arrays import Array
from ..results import STATUSES, failures_of
from .averages import AVERAGES, Mean
from .belief_scores import rank_histogram
from .intervals import LEVEL, Interval
from .metrics import Metric, RunBlock, metrics
from .row import Row

PASSES = 3  # over the runs: means; what varies about the means; what varies about G


class Accumulator:
    """What all runs of one estimator come to; each block is added in each pass, in the same order."""

    def __init__(self, names: tuple[str, ...], table: Sequence[Metric] | None = None) -> None:
        self.names, self.runs, self.counts = names, 0, np.zeros(len(STATUSES), dtype=int)
        self.table = metrics() if table is None else table
        self.averages: dict[str, dict[str, Mean]] = {metric.name: {} for metric in self.table}
        self.squares, self.claims = np.zeros((2, len(names), len(names)))
        self.ranks: Array = np.zeros(())

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
        seconds: float = np.nan,
        one_truth: bool = False,
    ) -> Row:
        """The row after all passes."""
        runs = self.runs or np.nan
        return Row(
            estimator=estimator,
            beams=beams,
            step=step,
            names=self.names,
            planned=int(self.counts.sum()),
            ok=self.runs,
            failures=failures_of(self.counts),
            G=self.squares / runs,
            P=self.claims / runs,
            figures=self.figures(),
            seconds=seconds,
            p_values=self.p_values(),
            one_truth=one_truth,
            ranks=self.ranks if self.ranks.ndim else None,
        )
