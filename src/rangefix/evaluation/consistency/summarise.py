"""The rows of a study: truth against claim, over the runs that went well."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from ...arrays import Array
from ..results import STATUSES, Results
from .accumulator import PASSES, Accumulator, RunBlock
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
    blocks = list(results.blocks())
    judgements: list[Accumulator] = []
    counts = np.zeros(len(STATUSES), dtype=int)
    improbable: Array = np.zeros(0, dtype=int)
    chunks: list[RunBlock] = []
    for number in range(PASSES):
        for first, end in blocks:
            if number == 0 or len(blocks) > 1:
                trials = results.source.trials(estimator, beams, first, end)
                errors = results.space.difference(results.source.world(first, end)[0], trials.mean)
                ok = trials.ok
                chunks = [
                    RunBlock(
                        errors[ok, t], trials.covariance[ok, t], trials.log_evidence[ok, t], trials.belief(t)
                    )
                    for t in range(errors.shape[1])
                ]
                if number == 0:
                    judgements = judgements or [Accumulator(results.space.names) for _ in chunks]
                    counts += np.bincount(trials.status, minlength=len(STATUSES))
                    improbable = trials.improbable.sum(0) + (improbable if improbable.size else 0)
            for judgement, chunk in zip(judgements, chunks, strict=True):
                judgement.add(number, chunk)
        for judgement in judgements:
            judgement.end(number)
    for step, judgement in enumerate(judgements):
        yield judgement.row(
            planned=results.runs,
            failures={name: int(n) for name, n in zip(STATUSES, counts, strict=True) if n and name != "ok"},
            improbable=int(improbable[step]),
            estimator=estimator,
            beams=beams,
            step=step,
            seconds=results.timing.get((estimator, beams), np.nan),
            one_truth=results.one_truth,
        )
