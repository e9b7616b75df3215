"""Truths and measurements of runs, each from its own streams."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from ..filters.problem import Sensor
from ..filters.space import Array
from .experiment import Experiment
from .seeds import stream

RARE = 1e-9  # share of honest measurements that the best pose explains worse than the floor
ALLOWANCE = 30.0  # nats for how much wider the prior is than the posterior


class Simulation(NamedTuple):
    """True states (M, T, n) and readings of all beams (M, T, B), m."""

    truth: Array
    measurement: Array


def simulate(experiment: Experiment, first: int, end: int) -> Simulation:
    """Runs first to end - 1. A run's numbers do not depend on which others are asked for.

    Its streams are "truth" for the first state, "motion" for the moves and "measurement" for the readings.
    """
    problem, moves = experiment.truth, experiment.moves
    truth = np.empty((end - first, experiment.steps, problem.space.size))
    measurement = np.empty((end - first, experiment.steps, len(problem.sensor.bearings)))
    for row, run in enumerate(range(first, end)):
        if experiment.start is None:
            state = problem.prior.sample(1, stream(experiment.seed, "truth", run))
        else:
            state = np.asarray(experiment.start, dtype=float)[None]
        motion = stream(experiment.seed, "motion", run) if len(moves) else None
        noise = stream(experiment.seed, "measurement", run)
        for step in range(experiment.steps):
            if motion is not None and step:
                state = problem.motion.sample(state, moves[step - 1], motion)
            truth[row, step] = state[0]
            measurement[row, step] = problem.sensor.sample(state, noise)[0]
    return Simulation(truth, measurement)


def evidence_floor(sensor: Sensor, measurement: Array) -> Array:
    """Log evidence below which the measurements so far are flagged as improbable; nats, (M, T, B) -> (M, T).

    The density that readings would have at a pose that explains them perfectly, less half the chi-square
    quantile that 1 in 10^9 honest measurements exceed, less 30 nats by which a prior may be wider than the
    posterior: ln p(y | y) - chi2.isf(1e-9, B) / 2 - 30, sums and B over all readings up to the step.
    """
    best = np.cumsum(sensor.log_density(measurement, measurement), axis=1)
    readings = np.cumsum(np.isfinite(measurement).sum(-1), axis=1)
    quantile = np.where(readings > 0, chdtri(np.maximum(readings, 1), RARE), 0.0)
    return np.asarray(best - 0.5 * quantile - ALLOWANCE)
