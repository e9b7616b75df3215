"""Scores and calibration of claims beyond covariance: each run's truth against the belief as a whole.

Everything here takes the GAUSSIAN CLAIM, N(mean, P), which every estimator makes by what it answers; what it
believes beyond two moments is in `belief_scores.py`. Lower scores are better, and the scores are proper: on
average none is lower than that of claiming what one believes (Gneiting and Raftery, "Strictly proper scoring
rules, prediction, and estimation", J. Am. Stat. Assoc. 102, 2007).
"""

from __future__ import annotations

import numpy as np
from scipy.special import erf, ndtr

from ...arrays import Array, BoolArray

DIRECTIONS = 60  # over which the energy score averages: off by less than 3e-4 of itself, and less than usual
SLAB = 500  # runs at once, which stay in the cache
TINY = 1e-100  # m; a claimed spread of nothing counts as this
BINS = 10


def log_score(squares: Array, covariance: Array, positive: BoolArray) -> Array:
    """Minus the log density of the Gaussian claim at the truth, nats, (M,).

    Units matter: compare estimators of one study only.

    Args:
        squares: Normalised errors squared e' P^-1 e, (M,).
        covariance: P, (M, n, n).
        positive: Which P are positive definite, (M,); the score of the others is inf.
    """
    size = np.shape(covariance)[-1]
    some = np.where(positive[..., None, None], covariance, np.eye(size))
    logs = np.linalg.slogdet(some)[1] + squares + size * np.log(2 * np.pi)
    return np.where(positive, 0.5 * logs, np.inf)


def crps(errors: Array, stds: Array) -> Array:
    """Continuous ranked probability score of a Gaussian claim, in the unit of the error, elementwise.

    std (z (2 Phi(z) - 1) + 2 phi(z) - 1 / sqrt(pi)) with z = error / std (Gneiting and Raftery, 2007, (21));
    the absolute error where the claimed std is zero.
    """
    stds = np.asarray(stds, dtype=float)
    sure = stds <= 0
    z = np.asarray(errors) / np.where(sure, 1.0, stds)
    density = np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi)
    score = stds * (z * (2 * ndtr(z) - 1) + 2 * density - 1 / np.sqrt(np.pi))
    return np.where(sure, np.abs(errors), score)


def energy_score(errors: Array, covariance: Array) -> Array:
    """Energy score E|X - x| - E|X - X'| / 2 of the Gaussian claim in the plane, m: (M, 2), (M, 2, 2) -> (M,).

    The length of a plane vector is pi / 2 times the mean over all directions of its absolute projection, so
    the score is pi / 2 times the mean CRPS of the projected claim: no draws are needed.
    """
    angles = np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    units = np.stack([np.sin(angles), np.cos(angles)])
    squares = np.stack([units[0] ** 2, 2 * units[0] * units[1], units[1] ** 2])
    entries = np.stack([covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]], axis=-1)
    found = np.empty(len(errors))
    for start in range(0, len(errors), SLAB):
        part = slice(start, start + SLAB)
        off = errors[part] @ units
        stds = np.sqrt(np.maximum(entries[part] @ squares, TINY**2))
        z = off / (np.sqrt(2) * stds)
        with np.errstate(over="ignore"):  # errors of 1e60 m: exp(-inf) is right
            bell = np.exp(-(z**2))
        terms = off * erf(z) + stds * (np.sqrt(2 / np.pi) * bell - 1 / np.sqrt(np.pi))
        found[part] = 0.5 * np.pi * terms.mean(-1)
    return found
