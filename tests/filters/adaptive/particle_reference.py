"""Moments after each measurement from many particles, with what they scatter by: a reference for drives.

Bootstrap filters with independent seeds move their particles by the motion's own law, draw them anew after
each measurement, and are joined by their evidence. It shares nothing with lattices, kernels or fans. As a
script it prints errors, stated errors and times of the adaptive filter:
`python -m tests.filters.adaptive.particle_reference walls 0 40`.
"""

from __future__ import annotations

import sys
import time
from typing import NamedTuple

import numpy as np

from rangefix.arrays import Array
from rangefix.filters import StateSpace
from rangefix.filters.adaptive import AdaptivePointMassFilter

from ..families import Drawn, draw

AT_ONCE = 100_000  # particles whose beams are cast at once


class Reference(NamedTuple):
    """Mean (n,), covariance (n, n) and log evidence after a measurement, and the scatter of the first two.

    The scatter is one standard error, in deviations, the greatest of all moments: by leaving out one batch at
    a time.
    """

    mean: Array
    covariance: Array
    log_evidence: float
    scatter: float


class Judged(NamedTuple):
    """Error of a step's mean and covariance in deviations, the reference's scatter, what is stated, CPU s."""

    error: float
    scatter: float
    stated: float
    seconds: float


def reference(drawn: Drawn, particles: int = 100_000, batches: int = 8) -> list[Reference]:
    """What is known after each measurement, by so many particles in each of so many batches."""
    problem, space, steps = drawn.problem, drawn.problem.space, len(drawn.readings)
    evidence, sums = np.zeros((steps, batches)), np.zeros((steps, batches, space.size, space.size + 1))
    for batch in range(batches):
        rng = np.random.default_rng([7, batch])
        states = problem.prior.sample(particles, rng)
        for step, reading in enumerate(drawn.readings):
            if step:
                states = problem.motion.sample(states, drawn.controls[step - 1], rng)
            parts = np.array_split(states, max(1, particles // AT_ONCE))
            logs = np.concatenate(
                [problem.sensor.log_density(reading, problem.sensor.expected(part)) for part in parts]
            )
            weights = np.exp(logs - logs.max())
            evidence[step, batch] = (
                evidence[step - 1, batch] * (step > 0) + logs.max() + np.log(weights.mean())
            )
            weights /= weights.sum()
            away = space.difference(states, drawn.truths[step])
            sums[step, batch, :, 0] = weights @ away
            sums[step, batch, :, 1:] = (away * weights[:, None]).T @ away
            places = (np.arange(particles) + rng.random()) / particles
            states = states[np.minimum(np.searchsorted(np.cumsum(weights), places), particles - 1)]
    return [_joined(space, *each) for each in zip(drawn.truths, evidence, sums, strict=True)]


def _joined(space: StateSpace, middle: Array, logs: Array, sums: Array) -> Reference:
    """Batches as one, with deviations from `middle` summed in (batches, n, 1 + n)."""
    weights, count = np.exp(logs - logs.max()), len(logs)

    def moments(used: Array) -> tuple[Array, Array]:
        total = np.einsum("b,bij->ij", weights[used], sums[used]) / weights[used].sum()
        return total[:, 0], total[:, 1:] - np.outer(total[:, 0], total[:, 0])

    mean, covariance = moments(np.arange(count))
    std = np.sqrt(np.diagonal(covariance))
    without = [moments(np.delete(np.arange(count), batch)) for batch in range(count)]
    scatter = np.sqrt(
        (count - 1)
        * max(
            (np.var([one for one, _ in without], axis=0) / std**2).max(),
            (np.var([other for _, other in without], axis=0) / np.outer(std, std) ** 2).max(),
        )
    )
    log_evidence = float(np.log(weights.mean()) + logs.max())
    return Reference(space.wrap(middle + mean), covariance, log_evidence, float(scatter))


def judged(drawn: Drawn, references: list[Reference]) -> list[Judged]:
    """The adaptive filter at its defaults against the reference, step by step."""
    space, estimator = drawn.problem.space, AdaptivePointMassFilter(drawn.problem)
    rng, steps = np.random.default_rng(0), []
    belief = estimator.init(drawn.problem.prior, rng)
    for step, (reading, known) in enumerate(zip(drawn.readings, references, strict=False)):
        begin = time.process_time()
        if step:
            belief = estimator.predict(belief, drawn.controls[step - 1], rng)
        belief = estimator.update(belief, reading, rng)
        seconds = time.process_time() - begin
        mean, covariance, _ = estimator.estimate(belief)
        std = np.sqrt(np.diagonal(known.covariance))
        off = np.abs(space.difference(mean, known.mean)) / std
        wrong = np.abs(covariance - known.covariance) / np.outer(std, std)
        error = float(max(off.max(), wrong.max()))
        steps.append(Judged(error, known.scatter, estimator.error(belief), seconds))
    return steps


def main() -> None:
    family, first, last = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    for number in range(first, last):
        drawn = draw(family, number)
        for step, each in enumerate(judged(drawn, reference(drawn))):
            error, scatter, stated, seconds = each
            told = f"error {error:.4f} scatter {scatter:.4f} stated {stated:.4f}, {seconds:.2f} s"
            print(family, number, step, told, flush=True)


if __name__ == "__main__":
    main()
