"""The rows of a study: truth against claim, over the runs that went well."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from ...arrays import BoolArray
from ..results import Results, Trials
from .accumulator import PASSES, Accumulator
from .metrics import RunBlock
from .row import Row


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
    seconds = results.timing.get((estimator, beams), np.nan)
    for step, accumulator in enumerate(accumulators):
        yield accumulator.row(estimator, beams, step, seconds, results.one_truth)


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
    return [
        RunBlock(
            results.space.names,
            errors[ok, step],
            trials.covariance[ok, step],
            log_evidence=trials.log_evidence[ok, step],
            improbable=trials.improbable[ok, step],
            status=trials.status,
            belief=trials.belief(step, ok),
        )
        for step in range(errors.shape[1])
    ]
