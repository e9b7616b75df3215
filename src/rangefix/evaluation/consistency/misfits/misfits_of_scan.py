"""How badly a scan fits the map, as predicted and where it fits best: the mean of cut squares of scores."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import ndtri

from ....arrays import Array, IntArray
from ....filters import Noise, Sensor
from ....filters.models.noise import log_below
from ....filters.models.noise_of_beams import noise_of_beams
from ....filters.models.rangefinder import LIMIT_ROUNDING
from ....filters.models.wrapped_noise import law_and_weight, reading_step
from .cut_squares import CAP

LEAST_TAIL = 1e-12  # of a probability, beyond which scores are cut off anyhow
BEST, SCALES = 5, (1.0, 0.5, 0.25)  # states about which is looked, and how far, in distances between draws


@dataclass(frozen=True)
class ScanOnMap:
    """A scan that is held against a map.

    Attributes:
        sensor: The rangefinder and its map.
        reading: (B,), m; NaN = not measured, inf = no return, -inf = too close.
        law: How readings scatter; a weight is left out.
    """

    sensor: Sensor
    reading: Array
    law: Noise

    @cached_property
    def beams(self) -> IntArray:
        """Numbers of the beams whose readings count, from 0, (K,)."""
        unknown = np.isnan(self.reading) | self.sensor.blind
        return np.flatnonzero(~(unknown if self.sensor.min_range else unknown | np.isneginf(self.reading)))

    def misfits(self, before: Array, after: Array | None = None) -> tuple[float, float]:
        """As predicted, by the law averaged over draws; and the least at a draw, or between one and the next.

        Args:
            before: Draws from what was believed before the scan, (K, n).
            after: Draws from what is believed then, (L, n); None = the least is not asked for, and NaN.
        """
        tails = self.tails(before)
        predicted = float(mean_cut_square(tails.mean(axis=1)))
        if after is None:
            return predicted, np.nan
        known = mean_cut_square(np.concatenate([tails, self.tails(after)], axis=1))
        return predicted, self._least(np.concatenate([before, after]), known)

    def tails(self, states: Array) -> Array:
        """Probabilities of less and of more than was read, at states (K, n): (2, K, B), of beams that count.

        What has a probability of its own, a rounded reading or a missing return, lies in the middle of it:
        half of it counts as less, half as more. Scores of rounded readings vary by less than 1, the less the
        coarser the step: 0.87 for a step of a deviation, 0.54 for 2.5. They raise fewer alarms than stated.
        """
        sensor, reading = self.sensor, self.reading[self.beams]
        law, _ = law_and_weight(self.law)
        noise = noise_of_beams(law, self.beams, len(self.reading))
        expected = np.asarray(sensor.expected(np.asarray(states, dtype=float)))[:, self.beams]
        silent, close = np.isposinf(reading), np.isneginf(reading)
        least = sensor.min_range * (1 - 10 * LIMIT_ROUNDING)  # a rounded reading at the limit is no less
        ends = np.where(silent, sensor.max_range, np.where(close, least, ends_of_bins(reading, noise)))
        with np.errstate(over="ignore"):
            sides = [
                (np.exp(log_below(noise, end, expected)), np.exp(noise.log_above(end, expected)))
                for end in np.broadcast_to(ends[:, None], (len(ends), *expected.shape))
            ]
        below, above = np.mean(sides, axis=0)
        below, above = np.where(silent, 1 - 0.5 * above, below), np.where(silent, 0.5 * above, above)
        return np.stack([np.where(close, 0.5 * below, below), np.where(close, 1 - 0.5 * below, above)])

    def _least(self, states: Array, misfits: Array) -> float:
        """The least misfit at states (K, n), where it is known, (K,), or near the best of them.

        Draws stand apart by their deviations times K^(-1/n). About the best of them that and parts of it are
        tried along each axis, since a truth between draws is no misfit.
        """
        space = self.sensor.space
        _, covariance = space.moments(states, np.full(len(states), 1 / len(states)))
        apart = np.sqrt(np.maximum(np.diagonal(covariance), 0.0)) * len(states) ** (-1 / space.size)
        ways = np.concatenate([np.diag(apart), -np.diag(apart)])
        for scale in SCALES:
            order = np.argsort(misfits)[:BEST]
            best, kept = states[order], misfits[order]
            near = space.wrap(best[:, None] + scale * ways).reshape(-1, space.size)
            states = np.concatenate([best, near])
            misfits = np.concatenate([kept, mean_cut_square(self.tails(near))])
        return float(misfits.min())


def ends_of_bins(reading: Array, noise: Noise) -> Array:
    """Both ends of what is rounded to each reading, (2, B), m; where nothing is, the reading: (1, B)."""
    step = reading_step(noise)
    if not step:
        return reading[None]
    return np.asarray(np.round(reading / step) * step + np.array([[-0.5], [0.5]]) * step)


def mean_cut_square(tails: Array) -> Array:
    """Mean cut square of the scores of tails, over beams: (2, ..., B) -> (...)."""
    return np.asarray(np.minimum(scores_of(tails) ** 2, CAP).mean(-1))


def scores_of(tails: Array) -> Array:
    """Standard normal numbers that have these tails, (2, ...) -> (...)."""
    below, above = np.maximum(tails, LEAST_TAIL)
    return np.asarray(np.where(below < above, ndtri(below), -ndtri(above)))
