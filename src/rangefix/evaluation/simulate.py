"""Truths and measurements of runs, each from its own streams."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from ..filters.noise import Gaussian, RangeProportional
from ..filters.problem import Sensor
from ..filters.space import Array, BoolArray
from .experiment import Experiment
from .seeds import streams
from .trajectories import follow

DRAWS = 50_000  # readings from which the shortfall of other noise than Gaussian is found
LONG = 10.0  # m
RARE = 1e-9  # share of honest measurements that the best pose explains worse than the floor
MOST = 1 << 20  # ranges cast at once
ALLOWANCE = 30.0  # nats for how much wider the prior is than the posterior


class Simulation(NamedTuple):
    """True states (M, T, n) and readings of all beams (M, T, B), m."""

    truth: Array
    measurement: Array


def simulate(experiment: Experiment, first: int, end: int) -> Simulation:
    """Runs first to end - 1. A run's numbers do not depend on which others are asked for.

    Its streams are "truth" for the first state, "motion" for the moves and "measurement" for the readings.
    """
    problem, moves, seed = experiment.truth, experiment.moves, experiment.seed
    runs = range(first, end)
    if experiment.start is None:
        starts = np.concatenate([problem.prior.sample(1, rng) for rng in streams(seed, "truth", runs)])
    else:
        starts = np.tile(np.asarray(experiment.start, dtype=float), (len(runs), 1))
    truth = starts[:, None]
    if len(moves):
        truth = follow(problem.motion, starts, moves, streams(seed, "motion", runs))
    measurement = np.empty((*truth.shape[:2], len(problem.sensor.bearings)))
    read = getattr(problem.sensor, "read", None)
    size = max(1, MOST // measurement[0].size)
    for place in range(0, len(runs), size):
        part = slice(place, place + size)
        expected = _expected(problem.sensor, truth[part]) if read else None
        for row, rng in enumerate(streams(seed, "measurement", runs[part]), start=place):
            for step in range(experiment.steps):
                if read is not None and expected is not None:
                    measurement[row, step] = read(expected[row - place, step], rng)
                else:
                    measurement[row, step] = problem.sensor.sample(truth[row, step], rng)
    return Simulation(truth, measurement)


def _expected(sensor: Sensor, states: Array) -> Array:
    """Ranges without noise, (M, T, n) -> (M, T, B), each the same whichever others are asked for.

    Maps may go another way, with another rounding, where all headings are the same, as they are for a single
    state: so a state with another heading goes along.
    """
    along = states[:1].copy()
    along[..., sensor.space.is_angle] += 1.0
    return np.asarray(sensor.expected(np.concatenate([states, along]))[:-1])


def evidence_floor(sensor: Sensor, measurement: Array) -> Array:
    """Log evidence below which the measurements so far are flagged as improbable; nats, (M, T, B) -> (M, T).

    The density that readings would have at a pose that explains them perfectly, less what 1 in 10^9 honest
    series of measurements fall short of it, less 30 nats by which a prior may be wider than the posterior.
    For Gaussian noise that is ln p(y | y) - chi2.isf(1e-9, B) / 2 - 30, sums and B over all readings up to
    the step. For other noise the chi-square law gives way to the gamma law of the same mean and variance
    of an honest reading's shortfall.
    """
    mean, variance, counted = _shortfall(sensor, measurement)
    best = np.cumsum(sensor.log_density(measurement, measurement), axis=1)
    readings = np.cumsum(counted.sum(-1), axis=1)
    degrees = 2 * readings * mean**2 / variance
    quantile = np.where(readings > 0, chdtri(np.where(readings > 0, degrees, 1.0), RARE), 0.0)
    return np.asarray(best - 0.5 * variance / mean * quantile - ALLOWANCE)


def _shortfall(sensor: Sensor, measurement: Array) -> tuple[float, float, BoolArray]:
    """Mean and variance of ln p(y | y) - ln p(y | rho) of an honest reading, and which readings count.

    1/2 and 1/2 for Gaussian noise, where a missing return costs next to nothing; of other noise from draws
    of a fixed stream at all ranges up to 10 m or the maximum range.
    """
    read = getattr(sensor, "read", None)
    if read is None or isinstance(sensor.noise, Gaussian | RangeProportional):
        return 0.5, 0.5, np.isfinite(measurement)
    rng = np.random.default_rng(0)
    beams = len(sensor.bearings)
    longest = min(getattr(sensor, "max_range", LONG), LONG)
    expected = rng.uniform(0.0, longest, (-(-DRAWS // beams), beams))
    drawn = read(expected, rng)
    short = sensor.beam_log_density(drawn, drawn) - sensor.beam_log_density(drawn, expected)
    short = short[~np.isnan(drawn)]
    mean, variance = float(short.mean()), float(short.var())
    if not (0 < mean < np.inf and 0 < variance < np.inf):
        return 0.5, 0.5, np.isfinite(measurement)
    return mean, variance, ~np.isnan(measurement)
