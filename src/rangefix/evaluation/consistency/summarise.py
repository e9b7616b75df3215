"""The rows of a study: truth against claim, over the runs that went well."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from ...arrays import BoolArray
from ..results import Results
from .accumulator import PASSES, Accumulator
from .row import Row
from .run_block import RunBlock


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
                blocks = run_blocks(results, estimator, beams, first, end)
                accumulators = accumulators or [Accumulator(results.space.names) for _ in blocks]
            for accumulator, block in zip(accumulators, blocks, strict=True):
                accumulator.add(number, block)
        for accumulator in accumulators:
            accumulator.end(number)
    seconds = results.timing.get((estimator, beams), np.nan)
    for step, accumulator in enumerate(accumulators):
        yield accumulator.row(
            estimator=estimator, beams=beams, step=step, seconds=seconds, one_truth=results.one_truth
        )


def run_blocks(
    results: Results, estimator: str, beams: str, first: int, end: int, also: BoolArray | None = None
) -> list[RunBlock]:
    """Runs first to end - 1 of one estimator on one set of beams, a block for each step.

    Args:
        results: The results.
        estimator, beams: Labels.
        first, end: Which runs.
        also: Which of them to take of those that went well, (M,); all unless given.
    """
    trials = results.source.trials(estimator, beams, first, end)
    errors = results.space.difference(results.source.world(first, end)[0], trials.mean)
    ok = trials.ok if also is None else trials.ok & also
    return [
        RunBlock(
            results.space.names,
            errors[ok, step],
            trials.covariance[ok, step],
            log_evidence=trials.log_evidence[ok, step],
            improbable=trials.improbable[ok, step],
            status=trials.status,
            belief=trials.belief(step),
        )
        for step in range(errors.shape[1])
    ]
