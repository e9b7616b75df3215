"""Truths and measurements of runs, each from its own streams."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from ...arrays import Array
from ...filters import Motion, Prior, Rangefinder, Sensor, Uniform, sample_runs
from ...filters.space import with_another_heading
from ...thread_pools import with_blas_on_one_thread
from ..experiment import Experiment
from ..seeds import streams

MAX_RANGES_PER_CAST = 1 << 20  # ranges cast at once


class Simulation(NamedTuple):
    """True states (M, T, n) and readings of all beams (M, T, B), m."""

    truth: Array
    measurement: Array


@with_blas_on_one_thread
def simulate(experiment: Experiment, first: int, end: int) -> Simulation:
    """Runs first to end - 1. A run's numbers do not depend on which others are asked for.

    Its streams are "truth" for the first state, "motion" for the moves and "measurement" for the readings.
    """
    problem, moves, seed = experiment.truth, experiment.control_sequence, experiment.seed
    runs = range(first, end)
    if experiment.start is None:
        starts = _starts(problem.prior, streams(seed, "truth", runs))
    else:
        starts = np.tile(np.asarray(experiment.start, dtype=float), (len(runs), 1))
    truth = starts[:, None]
    if len(moves):
        truth = follow(problem.motion, starts, moves, streams(seed, "motion", runs))
    measurement = np.empty((*truth.shape[:2], len(problem.sensor.bearings)))
    size = max(1, MAX_RANGES_PER_CAST // measurement[0].size)
    for place in range(0, len(runs), size):
        part = slice(place, place + size)
        expected = _expected(problem.sensor, truth[part])
        measurement[part] = _readings(
            problem.sensor, truth[part], expected, streams(seed, "measurement", runs[part])
        )
    return Simulation(truth, measurement)


def _starts(prior: Prior, rngs: Sequence[Generator]) -> Array:
    """A draw from the prior by each generator, (M, n)."""
    if (
        type(prior) is Uniform
    ):  # all at once, with the same numbers; what wraps or extends it draws its own way
        return prior.sample_each(rngs)
    return np.concatenate([prior.sample(1, rng) for rng in rngs])


def _readings(sensor: Sensor, states: Array, expected: Array, rngs: Sequence[Generator]) -> Array:
    """Readings of runs at states (M, T, n) that expect (M, T, B), each run's by its own generator."""
    if type(sensor) is Rangefinder:
        return sensor.read_each(expected, rngs, states)
    pairs = zip(expected, rngs, strict=True)
    return np.array([[sensor.read(step, rng) for step in steps] for steps, rng in pairs])


def _expected(sensor: Sensor, states: Array) -> Array:
    """Ranges without noise, (M, T, n) -> (M, T, B), each the same whichever others are asked for."""
    return np.asarray(sensor.expected(with_another_heading(sensor.space, states))[: len(states)])


def follow(motion: Motion, starts: Array, controls: Array, rngs: Sequence[Generator]) -> Array:
    """The states that objects pass when they take the controls, noise and walls as the motion has them.

    Args:
        motion: The true motion; `Confined` keeps it out of walls.
        starts: First states, (M, n).
        controls: (T, k) shared by the runs, or (M, T, k).
        rngs: One for each run; run m draws from rngs[m] alone.

    Returns:
        States, (M, T + 1, n).
    """
    starts, controls = np.asarray(starts, dtype=float), np.asarray(controls, dtype=float)
    states = [starts]
    for t in range(controls.shape[-2]):
        states.append(sample_runs(motion, states[-1], controls[..., t, :], rngs))
    return np.stack(states, axis=1)
