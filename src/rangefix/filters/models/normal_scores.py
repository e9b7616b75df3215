"""Readings as standard normal numbers, and back: what a copula sees of noise of any kind."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from ...arrays import Array, BoolArray
from .beam_noise import Quantised
from .noise import CumulativeNoise, Gaussian, RangeProportional
from .noise_of_beams import noise_of_beams
from .wrapped_noise import Biased, LostBeams, reading_bias, reading_spread, reading_step

LARGEST_SCORE = 37.0  # beyond it a normal number's probability has no digits
FIRST_REACH = 4.0  # deviations, within which a reading is looked for first
PRECISION_M = 1e-9
FARTHEST_M = 1e4


def normal_scores(noise: CumulativeNoise, reading: Array, expected: Array) -> Array:
    """Phi^-1 of the probability of a reading below each, elementwise; N(0, 1) for readings of the noise.

    Beams that are lost are left out of the probabilities: they are independent of how the others scatter.

    Args:
        noise: The law of each reading by itself.
        reading: Finite, m.
        expected: Ranges, m; inf = no wall.

    Returns:
        From -37 to 37.
    """
    from scipy.special import ndtri_exp

    if isinstance(noise, Biased):
        return normal_scores(noise.noise, reading, np.asarray(expected) + noise.bias)
    if isinstance(noise, LostBeams | Quantised):
        return normal_scores(noise.noise, reading, expected)
    if isinstance(noise, Gaussian | RangeProportional):
        with np.errstate(invalid="ignore"):
            scores = (reading - expected) / np.sqrt(noise.variance(expected))
    else:
        below, above = noise.log_below(reading, expected), noise.log_above(reading, expected)
        scores = np.where(below < above, ndtri_exp(below), -ndtri_exp(above))
    return np.asarray(np.clip(scores, -LARGEST_SCORE, LARGEST_SCORE))


def spread_of_rounded(noise: CumulativeNoise, reading: Array) -> Array | None:
    """Standard deviations of the scores of rounded readings (K,); None where readings are not rounded.

    They are those of readings before rounding and an error that is even over a step, of w^2 / 12 for a step
    that is w scores wide about the reading.
    """
    if not (step := reading_step(noise)):
        return None
    wall = reading - reading_bias(noise)
    low, high = (normal_scores(noise, reading + side * step, wall) for side in (-0.5, 0.5))
    return np.asarray(np.sqrt(1 + (high - low) ** 2 / 12))


def readings_at(noise: CumulativeNoise, scores: Array, expected: Array, rng: Generator) -> Array:
    """The readings that have these normal scores, m; `rng` loses beams and nothing else. inf = no return."""
    expected = np.asarray(expected, dtype=float)
    if isinstance(noise, Biased):
        return readings_at(noise.noise, scores, expected + noise.bias, rng)
    if isinstance(noise, LostBeams):
        kept = readings_at(noise.noise, scores, expected, rng)
        return np.where(rng.random(expected.shape) < noise.probability, np.inf, kept)
    if isinstance(noise, Quantised):
        return np.asarray(np.round(readings_at(noise.noise, scores, expected, rng) / noise.step) * noise.step)
    if isinstance(noise, Gaussian | RangeProportional):
        return np.asarray(expected + np.sqrt(noise.variance(expected)) * scores)
    return _by_halving(noise, scores, expected)


def _by_halving(noise: CumulativeNoise, scores: Array, expected: Array) -> Array:
    """Where the probability of lower readings is that of lower scores; inf where none is so probable."""
    beams = expected.shape[-1]
    if beams > 1 and noise_of_beams(noise, 0, beams) is not noise:  # of each beam by itself
        each = [
            _by_halving(
                noise_of_beams(noise, beam, beams), scores[..., beam, None], expected[..., beam, None]
            )
            for beam in range(beams)
        ]
        return np.concatenate(each, axis=-1)
    lower = scores < 0  # of the two tails, the one that has digits
    readings = np.empty(expected.shape)
    for side in (lower, ~lower):
        readings[side] = _quantiles(noise, scores[side], expected[side], side is lower)
    return readings


def _quantiles(noise: CumulativeNoise, scores: Array, expected: Array, lower: bool) -> Array:
    """The same for scores on one side, (K,), (K,) -> (K,)."""
    from scipy.special import log_ndtr

    wanted = log_ndtr(scores if lower else -scores)

    def is_short(limit: Array) -> BoolArray:
        with np.errstate(divide="ignore"):
            if lower:
                return np.asarray(noise.log_below(limit, expected) < wanted)
            return np.asarray(noise.log_above(limit, expected) > wanted)

    centre = np.where(np.isfinite(expected), expected, 0.0)
    reach = FIRST_REACH * reading_spread(noise, expected)
    low, high = centre - reach, centre + reach
    while (outside := ~is_short(low) & (low > -FARTHEST_M)).any():
        low = np.where(outside, centre - 4 * (centre - low), low)
    while (outside := is_short(high) & (high < FARTHEST_M)).any():
        high = np.where(outside, centre + 4 * (high - centre), high)
    lost = is_short(high)
    while ((high - low)[~lost] > PRECISION_M).any():
        middle = 0.5 * (low + high)
        short = is_short(middle)
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    return np.where(lost, np.inf, high)
