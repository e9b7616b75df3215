"""Errors that readings share: along a scan, over time, in a whole scan, and at a place of the map.

A reading scatters by a law of its own, whatever the others do; a Gaussian copula over the readings' normal
scores says how they hang together (Joe, Dependence Modeling with Copulas, 2014, section 2.4). For Gaussian
noise that is the multivariate normal law. The scores' correlation is a sum of parts: white, AR(1) over beams
and scans, one error for each scan, and errors of the map's walls, which are the same whenever a beam meets
the same place.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.random import Generator

from ...arrays import Array, IntArray, keep_copies, keep_numbers
from ..problem import Noise, Sensor, check_part
from .noise import CumulativeNoise
from .noise_of_beams import noise_of_beams
from .normal_scores import normal_scores, readings_at, spread_of_rounded
from .wrapped_noise import WrapsNoise, law_and_weight

WAVES = 256  # of a random field; its fourth moment is off by 1 / (2 WAVES) of a Gaussian's
NUGGET = 1e-9  # of a variance, on the diagonal of correlations, which rounding must not make indefinite


@dataclass(frozen=True)
class PlaceError:
    """An error of the map: the same at the same place, alike within a length.

    Attributes:
        share: Of a reading's variance, from 0 to 1.
        length: Distance of two places on walls at which their correlation has fallen to 1 / e, m.
    """

    share: float
    length: float

    def __post_init__(self) -> None:
        keep_numbers(self, "share", "length")


@dataclass(frozen=True)
class Correlated:
    """Readings that scatter as another noise says, with errors that they share.

    Alone, every reading has the law of `noise`; that is what the methods here tell, which see one reading at
    a time. A `Rangefinder` knows where its beams point, draws readings together, and weighs the readings of
    one scan together. Errors that outlast a scan (`over_time`, `places`) are drawn, and no estimator here
    follows them: what they cost, a study shows, and `Tempered` is the stand-in. A missing return is taken to
    be independent of the rest.

    Args:
        noise: The law of each reading by itself.
        beams: Share of the variance that is AR(1) over beams.
        along: Correlation of that part between neighbouring beams.
        over_time: Correlation of that part between consecutive scans.
        scan: Share of the variance that is one error of a whole scan.
        places: Shares that are errors of the map.

    Raises:
        ValueError: If shares are negative or sum to more than one, or a correlation or length is not in its
            bounds.
    """

    noise: CumulativeNoise
    beams: float = 0.0
    along: float = 0.0
    over_time: float = 0.0
    scan: float = 0.0
    places: tuple[PlaceError, ...] = ()

    def __post_init__(self) -> None:
        keep_copies(self)
        check_part("noise", self.noise, "log_density", "sample")
        keep_numbers(self, "beams", "along", "over_time", "scan")
        shares = [self.beams, self.scan, *(place.share for place in self.places)]
        if not all(share >= 0 for share in shares) or not sum(shares) <= 1 + NUGGET:
            raise ValueError(f"shares of a variance must be at least 0 and sum to at most 1, got {shares}")
        if not (0 <= self.along < 1 and 0 <= self.over_time < 1):
            raise ValueError(
                f"along and over_time must be in [0, 1), got {self.along!r} and {self.over_time!r}"
            )
        if not all(0 < place.length < np.inf for place in self.places):
            raise ValueError(f"lengths of map errors must be positive and finite, got {self.places}")

    @cached_property
    def white(self) -> float:
        """Share of the variance that a reading has for itself."""
        return max(0.0, 1.0 - self.beams - self.scan - sum(place.share for place in self.places))

    def log_density(self, measurement: Array, expected: Array) -> Array:
        """That of each reading by itself, elementwise; nats."""
        return self.noise.log_density(measurement, expected)

    def log_above(self, limit: Array, expected: Array) -> Array:
        """Log probability of a reading above the limit, or of none."""
        return self.noise.log_above(limit, expected)

    def log_below(self, limit: Array, expected: Array) -> Array:
        """Log probability of a reading up to the limit."""
        return self.noise.log_below(limit, expected)

    def sample(self, expected: Array, rng: Generator) -> Array:
        """One reading for each expected range, each by itself, m; together they come from the rangefinder."""
        return self.noise.sample(expected, rng)

    def variance(self, expected: Array) -> Array:
        """That of each reading by itself, m^2."""
        return self.noise.variance(expected)

    def correlation(self, beams: IntArray, ends: Array) -> Array:
        """Correlation of the normal scores of some beams of one scan.

        Args:
            beams: Their numbers, (K,).
            ends: Where they end, m, in any frame, (K, 2).

        Returns:
            (K, K), with ones on the diagonal.
        """
        own = self.white * (beams[:, None] == beams)
        return np.asarray(self.scan + own + self.correlation_across(beams, ends, beams, ends, 0))

    def correlation_across(
        self, beams: IntArray, ends: Array, later_beams: IntArray, later_ends: Array, scans: int
    ) -> Array:
        """Correlation of the normal scores of some beams of one scan with those of some of another.

        Args:
            beams, later_beams: Their numbers, (K,) and (L,).
            ends, later_ends: Where they end, m, in one frame, (K, 2) and (L, 2).
            scans: How many scans later the other is.

        Returns:
            (K, L): of what outlasts a scan.
        """
        apart = np.abs(beams[:, None] - later_beams)
        total = self.beams * self.over_time**scans * self.along**apart
        if self.places:
            distance = np.hypot(*np.moveaxis(ends[:, None] - later_ends, -1, 0))
            total = total + self.from_places(distance)
        return np.asarray(total)

    def from_places(self, distance: Array) -> Array:
        """Correlation of beams that end so far apart, m, by errors of the map alone; of the same shape."""
        fields = (place.share * np.exp(-distance / place.length) for place in self.places)
        return sum(fields, np.zeros(np.shape(distance)))

    def log_copula(self, reading: Array, expected: Array, bearings: Array) -> Array:
        """What readings of one scan weigh together beyond what each weighs by itself; nats.

        -1/2 log |R| - 1/2 z' (R^-1 - I) z for the normal scores z of the finite readings and their
        correlation R. Beams end where they were read to end, which keeps R the same at all states. Rounding
        is an error of each reading by itself, which makes its score wider and R less.

        Args:
            reading: Of one scan, (B,), m.
            expected: Ranges at states, (..., B), m.
            bearings: Of the beams, rad, (B,).

        Returns:
            Shape (...).
        """
        read = np.flatnonzero(np.isfinite(reading))
        if not read.size:
            return np.zeros(np.shape(expected)[:-1])
        noise = noise_of_beams(self.noise, read, len(reading)) if len(read) < len(reading) else self.noise
        spread = spread_of_rounded(noise, reading[read])
        root = self._root(read, reading, bearings, spread)
        scores = normal_scores(noise, reading[read], np.asarray(expected)[..., read])
        scores = scores if spread is None else scores / spread
        white = scores @ np.linalg.inv(root).T
        return np.asarray(0.5 * ((scores**2).sum(-1) - (white**2).sum(-1)) - np.log(np.diagonal(root)).sum())

    def _root(self, read: IntArray, reading: Array, bearings: Array, spread: Array | None) -> Array:
        """Lower Cholesky factor of the correlation of the beams that were read, (K, K)."""
        ends = reading[read, None] * np.column_stack([np.sin(bearings[read]), np.cos(bearings[read])])
        correlation = self.correlation(read, ends)
        if spread is not None:
            correlation = (correlation + np.diag(spread**2 - 1)) / spread[:, None] / spread
        return np.asarray(np.linalg.cholesky(correlation + NUGGET * np.eye(len(read))))

    def sample_scans(self, expected: Array, ends: Array, rng: Generator) -> Array:
        """Consecutive scans of one drive, drawn together.

        Args:
            expected: Ranges without noise, (T, B), m; inf = no wall.
            ends: Where beams meet walls, in one frame for all scans, (T, B, 2), m; anywhere for those that
                meet none.
            rng: The only source of chance.

        Returns:
            Readings (T, B), m; inf = no return.
        """
        return readings_at(self.noise, self.scores(ends, rng), expected, rng)

    def scores(self, ends: Array, rng: Generator) -> Array:
        """Normal scores of consecutive scans: (T, B, 2) m -> (T, B), each N(0, 1)."""
        scans, beams = ends.shape[:2]
        total = np.sqrt(self.white) * rng.standard_normal((scans, beams))
        total += np.sqrt(self.scan) * rng.standard_normal((scans, 1))
        if self.beams:
            drawn = _autoregressive(rng.standard_normal((scans, beams)), self.over_time)
            total += np.sqrt(self.beams) * _autoregressive(drawn.T, self.along).T
        for place in self.places:
            total += np.sqrt(place.share) * random_field(ends, place.length, rng)
        return np.asarray(total)


def _autoregressive(drawn: Array, correlation: float) -> Array:
    """AR(1) along the first axis, stationary from the start, made of independent standard normal numbers."""
    for before, after in pairwise(drawn):
        after *= np.sqrt(1.0 - correlation**2)
        after += correlation * before
    return drawn


def random_field(points: Array, length: float, rng: Generator) -> Array:
    """A stationary field over the plane with unit variance and correlation exp(-distance / length).

    A sum of cosine waves (Rahimi and Recht, 2007); the waves of that correlation in two dimensions are Cauchy
    distributed.

    Args:
        points: Where, (..., 2), m.
        length: Of correlation, m.
        rng: Draws the field.

    Returns:
        Shape (...).
    """
    waves = rng.standard_normal((2, WAVES)) / (length * np.abs(rng.standard_normal(WAVES)))
    phases = rng.uniform(0.0, 2 * np.pi, WAVES)
    flat = points.reshape(-1, 2)
    values = np.empty(len(flat))
    for start in range(0, len(flat), 4096):
        part = flat[start : start + 4096]
        values[start : start + 4096] = np.cos(part @ waves + phases).sum(-1)
    return np.asarray(np.sqrt(2.0 / WAVES) * values.reshape(points.shape[:-1]))


def shared_errors(noise: Noise) -> tuple[Correlated | None, float]:
    """What beams share by a noise, and the weight that it is given; None, 1 for beams that share nothing."""
    law, weight = law_and_weight(noise)
    return (law, weight) if isinstance(law, Correlated) else (None, 1.0)


def check_shared_errors(noise: Noise) -> None:
    """Refuse errors that beams share within a noise that acts on every beam by itself, which would lose them.

    Raises:
        ValueError: If there are such.
    """
    outer, inner = noise, law_and_weight(noise)[0]
    while not isinstance(inner, Correlated) and isinstance(inner, WrapsNoise):
        outer, inner = inner, inner.noise
        if isinstance(inner, Correlated):
            name = type(outer).__name__
            raise ValueError(f"errors that beams share are lost in {name}: Correlated goes about it")


def refuse_shared_errors(sensor: Sensor, who: str) -> None:
    """Refuse a noise with errors that beams share, for what takes beams to be independent.

    Raises:
        ValueError: If there are such errors.
    """
    noise: Noise = sensor.noise
    while True:
        if isinstance(noise, Correlated):
            raise ValueError(
                f"{who} takes beams one by one, and this noise has errors that they share: tell it, under "
                "[assumed.sensor.noise], a noise without correlation and with the weight of its readings"
            )
        if not isinstance(noise, WrapsNoise):
            return
        noise = noise.noise
