"""Moves that turn an object any way round: their law goes round the circle, as truths do."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from rangefix.arrays import TWO_PI
from rangefix.filters import Gaussian, GaussianPrior, Problem, RandomWalk, Rangefinder, build, pose_space
from rangefix.filters.adaptive.lattices.lattice import Lattice, keys_of
from rangefix.filters.adaptive.prediction.gaussian_sums import (
    Gaussians,
    log_sum,
    no_wider_than_even,
    turns_of,
)
from rangefix.filters.adaptive.prediction.moves import predict_modes
from rangefix.maps import RectangularRoom

POSE = pose_space()
STEP = np.diag([0.02, 0.03, 0.01])  # m, m, rad
TURN = np.array([0.0, 0.0, TWO_PI])


def gaussian(heading):
    """A Gaussian of three steps of a lattice along each axis, to 4.8 deviations."""
    index = np.array(list(product(range(-14, 15), repeat=3)))
    index = index[(index**2).sum(axis=1) <= 14.4**2]
    logs = -0.5 * (index**2).sum(axis=1) / 9.0
    return Lattice(POSE, np.array([2.0, 3.0, heading]), STEP, index, keys_of(index), logs)


@pytest.mark.parametrize(
    "std", [0.3, 1.5, *(pytest.param(std, marks=pytest.mark.study) for std in (3.0, 40.0))]
)
def test_the_law_of_a_turn_goes_round_the_circle(std):
    """Against the sum over all turns, to 2 %, what Gaussians at the points of a lattice are good for.

    The short way round alone is off by a factor of 2 half a turn away for 1.5 rad, by one of 3 for 3 rad.
    """
    motion, mode = RandomWalk(POSE, [0.1, 0.1, std]), gaussian(1.0)
    found = predict_modes((mode,), None, motion, np.zeros(0))
    rng = np.random.default_rng(0)
    states = np.column_stack([rng.normal(2, 0.1, 400), rng.normal(3, 0.1, 400), rng.uniform(0, TWO_PI, 400)])
    if std < 1:
        states[:, 2] = 1.0 + rng.normal(0, std, 400)
    law = multivariate_normal(np.array([2.0, 3.0, 1.0]), mode.covariance + np.diag([0.1, 0.1, std]) ** 2)
    wanted = sum(law.pdf(states + TURN * turn) for turn in range(-60, 61))
    np.testing.assert_allclose(np.exp(found.log_density(POSE.wrap(states))), wanted, rtol=0.02)


def test_sums_over_turns_are_sums():
    """Place and heading that hang together, all the way round: to 1e-9."""
    rng = np.random.default_rng(1)
    root = rng.normal(size=(6, 3, 3)) + 2 * np.eye(3)
    covariances, centres = root @ np.swapaxes(root, 1, 2), rng.uniform(-3, 3, (6, 3))
    states = rng.uniform(-np.pi, np.pi, (50, 3))
    scale = -0.5 * (3 * np.log(TWO_PI) + np.linalg.slogdet(covariances)[1])
    turns = turns_of(covariances, POSE.is_angle)
    found = log_sum(states, Gaussians(centres, np.linalg.inv(covariances), scale, POSE.is_angle, turns))
    wanted = sum(
        multivariate_normal(centre, covariance).pdf(states + TURN * turn)
        for centre, covariance in zip(centres, covariances, strict=True)
        for turn in range(-12, 13)
    )
    np.testing.assert_allclose(np.exp(found), wanted, rtol=1e-8)


def test_angles_that_are_even_are_no_wider_than_it_takes():
    """Places keep their spread, and what hangs together its correlation; narrower ones are as they were."""
    wide = np.array([[0.04, 1.2, 0.0], [1.2, 900.0, 0.0], [0.0, 0.0, 0.01]])[None]
    is_angle = np.array([False, True, False])
    found = no_wider_than_even(wide, is_angle)[0]
    np.testing.assert_allclose(found, [[0.04, 0.36, 0], [0.36, 81, 0], [0, 0, 0.01]], rtol=1e-12)
    np.testing.assert_array_equal(no_wider_than_even(found[None], is_angle)[0], found)


@pytest.mark.parametrize("std", [1.5, 3.0])
def test_a_reading_after_a_turn_any_way_round(std):
    """Mean, covariance and evidence against 400 000 particles: within 5 standard errors and what is stated.

    With the short way round alone the evidence was off by 0.3 and by 0.6 nats.
    """
    room = RectangularRoom(width=4.0, length=3.0)
    sensor = Rangefinder(room, [-1.0, 0.0, 1.5], Gaussian(0.3), POSE)
    prior = GaussianPrior([1.2, 1.0, 1.0], np.diag([0.2, 0.2, 0.3]) ** 2, POSE, room)
    motion = RandomWalk(POSE, [0.1, 0.1, std])
    reading = sensor.expected(np.array([1.3, 0.9, 4.3]))
    estimator, rngs = (
        build("adaptive-point-mass", Problem(POSE, motion, sensor, prior)),
        [np.random.default_rng(0)],
    )
    belief = estimator.predict(estimator.init(prior, rngs), np.zeros(0), rngs)
    mean, covariance, log_evidence = estimator.estimate(
        belief := estimator.update(belief, reading[None], rngs)
    )
    stated = float(estimator.error(belief)[0])
    rng, parts = np.random.default_rng(5), []
    for _ in range(8):
        states = motion.sample(prior.sample(50_000, rng), np.zeros(0), rng)
        states = states[room.is_free(states[:, :2])]
        weights = np.exp(sensor.log_density(reading, sensor.expected(states)))
        away = POSE.difference(states, mean[0])
        parts.append([weights.sum(), *(weights @ away), *(weights @ (away**2))])
    total = np.sum(parts, axis=0)
    without = np.array([(total - part)[1:] / (total - part)[0] for part in parts])
    stds = np.sqrt(np.diagonal(covariance[0]))
    offs = total[1:] / total[0] - np.concatenate([np.zeros(3), stds**2])
    scatter = np.sqrt(7 * without.var(axis=0))
    scale = np.concatenate([stds, stds**2])
    assert (np.abs(offs) / scale < 5 * scatter / scale + stated + 0.01).all()
    evidences = np.array(parts)[:, 0] / 50_000
    error = evidences.std(ddof=1) / np.sqrt(8) / evidences.mean()
    assert abs(log_evidence[0] - np.log(evidences.mean())) < 5 * error + 0.02
