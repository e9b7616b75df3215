"""How probable each reading is where a range is expected, as a table: any noise, no returns included."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ...arrays import Array
from ...filters import Rangefinder
from ...filters.models.noise import log_below
from ...filters.models.rangefinder import LIMIT_ROUNDING
from ...filters.models.wrapped_noise import law_and_weight, reading_bias, reading_step, wider_gaussian
from ...filters.problem import Noise
from .one_beam import noise_width

BINS_PER_WIDTH = 2.0  # of the noise
LEAST_BINS = 8  # over the ranges that are expected
MOST_BINS = 60_000
CORE = 7.0  # widths of the noise beyond the expected ranges, in which readings stand evenly
GROWTH = 1.5  # from one reading's interval to the next, beyond the core
FARTHEST = 1e9  # widths
TAIL = 1e-10  # probability of readings that may be left out
READINGS_AT_ONCE = 32  # readings whose expected ranges are looked up together
ZERO = 1e-18  # probability of a reading that counts as none
SHARED_PARTS = 4.0  # of the ranges asked for: shared tables reach at most two of them further
SHARED_TABLES, MOST_SHARED = 100, 500_000  # that are kept, and probabilities in each
SHARPEN = 1 / 24  # Sheppard's correction: what bins blur, the table sharpens


@dataclass(frozen=True)
class ReadingTable:
    """Probabilities of readings, in intervals, for expected ranges in bins of equal width.

    Attributes:
        low: Where the first bin begins, m.
        step: Width of a bin, m.
        bins: How many there are. One more row stands for "no wall, or a beam that is lost".
        probability: Of each reading, (bins + 1, readings); rows sum to one. The last readings are "no return"
            and "too close", where there are such. Where readings weigh less, their power.
        minus_entropy: Sum of p log p over the readings, nats, (bins + 1,).
        law: By which readings are drawn that weigh less; None where they are drawn by `probability`.
    """

    low: float
    step: float
    bins: int
    probability: Array
    minus_entropy: Array
    law: ReadingTable | None = None

    @cached_property
    def entropies(self) -> ReadingTable:
        """- p log p of each reading by itself, nats, in the place of probabilities."""
        with np.errstate(divide="ignore", invalid="ignore"):
            terms = np.where(self.probability > 0, -self.probability * np.log(self.probability), 0.0)
        return replace(self, probability=terms, law=None)

    @cached_property
    def blocks(self) -> list[tuple[slice, slice, Array]]:
        """Readings, the bins that can give them, and the part of the table that belongs to both."""
        blocks, count = [], self.probability.shape[1]
        for start in range(0, count, READINGS_AT_ONCE):
            readings = slice(start, min(start + READINGS_AT_ONCE, count))
            rows = np.flatnonzero(self.probability[: self.bins, readings].max(axis=1) > ZERO)
            if len(rows):
                bins = slice(int(rows[0]), int(rows[-1]) + 1)
                blocks.append((readings, bins, np.ascontiguousarray(self.probability[bins, readings])))
        return blocks

    def readings_of(self, masses: Array) -> Array:
        """Sums over expected ranges, as functions of the reading: (D, C, bins + 1) -> (D, C, readings)."""
        flat = masses.reshape(-1, self.bins + 1)
        out = np.zeros((len(flat), self.probability.shape[1]))
        for readings, bins, part in self.blocks:
            out[:, readings] = flat[:, bins] @ part
        if flat[:, -1].any():
            out += flat[:, -1:] * self.probability[-1]
        return out.reshape(*masses.shape[:-1], -1)


@dataclass(frozen=True)
class SharedTables:
    """Tables of one rangefinder for many beliefs: reaching a little further than asked for, and kept."""

    _kept: dict[tuple[str, float, float], ReadingTable] = field(default_factory=dict)

    def table(self, beam: str, sensor: Rangefinder, noise: Noise, low: float, high: float) -> ReadingTable:
        """The table of a beam.

        Args:
            beam: What tells beams with different noise apart.
            sensor, noise, low, high: As for `reading_table`.

        Raises:
            ValueError: If the noise is too fine for the ranges.
        """
        pitch = 2.0 ** np.ceil(np.log2((high - low) / SHARED_PARTS)) if high > low else 1.0
        ends = max(float(np.floor(low / pitch) * pitch), 0.0), float(np.ceil(high / pitch) * pitch)
        if (beam, *ends) not in self._kept:
            made = reading_table(sensor, noise, *ends)
            if made.probability.size > MOST_SHARED:
                return made
            if len(self._kept) >= SHARED_TABLES:
                self._kept.clear()
            self._kept[(beam, *ends)] = made
        return self._kept[(beam, *ends)]


def reading_table(sensor: Rangefinder, noise: Noise, low: float, high: float) -> ReadingTable:
    """Tabulate the readings of a beam.

    Args:
        sensor: Whose limits count.
        noise: Of the beam.
        low, high: Between which ranges are expected, m.

    Raises:
        ValueError: If the noise is too fine for the ranges.
    """
    law, weight = drawn_by(noise)
    width = noise_width(law, low, high)
    count = max(np.ceil((high - low) * BINS_PER_WIDTH / width) + 1, LEAST_BINS)
    if count > MOST_BINS:
        raise ValueError(
            f"noise as fine as {width:.3g} m against ranges from {low:.3g} to {high:.3g} m: planning takes "
            f"at most {MOST_BINS} steps of half the noise"
        )
    step = max((high - low) / (count - 1), min(width / BINS_PER_WIDTH, 1e-3 * width + (high - low)))
    bins = int(count) + 4  # two more at each end, which cells at the ends give mass to
    first = low - 2.5 * step
    centres = first + step * (np.arange(-1, bins + 1) + 0.5)  # and neighbours, for the correction
    expected = np.append(centres, np.inf)[:, None]
    table = probabilities(sensor, law, width, (low, high), expected)
    with np.errstate(divide="ignore", invalid="ignore"):
        terms = np.where(table > 0, table * np.log(table), 0.0)
    sharp = _sharpened(table)
    sharp[:-1] /= sharp[:-1].sum(axis=1, keepdims=True)
    entropy = np.append(terms[1:-2].sum(axis=1), terms[-1].sum())
    drawn = ReadingTable(first, step, bins, sharp, entropy)
    return drawn if weight == 1 else replace(drawn, probability=_sharpened(table**weight), law=drawn)


def drawn_by(noise: Noise) -> tuple[Noise, float]:
    """The law of readings, and what one weighs: Gaussian ones that weigh less count as wider ones."""
    law, weight = law_and_weight(noise)
    return (noise, 1.0) if weight == 1 or wider_gaussian(noise) else (law, weight)


def _sharpened(table: Array) -> Array:
    """Sheppard's correction of all rows but the last; the first and the last but one are neighbours only."""
    inner, last = table[:-1], table[-1:]
    sharp = inner[1:-1] - SHARPEN * (inner[2:] - 2 * inner[1:-1] + inner[:-2])
    return np.concatenate([np.maximum(sharp, 0.0), last])


def probabilities(
    sensor: Rangefinder, noise: Noise, width: float, ends: tuple[float, float], expected: Array
) -> Array:
    """Probabilities of all readings, (R, readings), for expected ranges (R, 1); rows sum to one."""
    limit = sensor.min_range * (1 - 10 * LIMIT_ROUNDING)  # a step at the limit is read
    least = limit if sensor.min_range else -np.inf
    low, high = np.array(ends) + reading_bias(noise)  # about which readings stand, not about the ranges
    start, end = max(float(low) - CORE * width, least), min(float(high) + CORE * width, sensor.max_range)
    core, edges = np.empty((len(expected), 0)), (start, start)
    if end > start:
        places, step = _places(noise, width, start, end)
        edges = places[0] - step / 2, places[-1] + step / 2
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            core = np.exp(np.asarray(noise.log_density(places, expected))) * step
        core = np.nan_to_num(core, nan=0.0)
    silent = _above(noise, sensor.max_range, expected)
    close = _below(noise, limit, expected) if sensor.min_range else np.zeros_like(silent)
    lower, upper = _tails(noise, width, edges, (least, sensor.max_range), expected)
    tails = np.concatenate([lower, upper], axis=1)
    left = 1 - silent[:, 0] - close[:, 0] - tails.sum(axis=1)
    total = core.sum(axis=1)
    core *= np.where(total > TAIL, np.maximum(left, 0.0) / np.maximum(total, TAIL), 1.0)[:, None]
    table = np.concatenate([core, tails, silent, close], axis=1)
    table = table[:, table.max(axis=0) > ZERO]
    return np.asarray(table / table.sum(axis=1, keepdims=True))


def _places(noise: Noise, width: float, start: float, end: float) -> tuple[Array, float]:
    """Readings that stand evenly, m, and how far apart; those of a noise with steps are multiples."""
    if pitch := reading_step(noise):
        step = pitch * max(1.0, np.floor(width / BINS_PER_WIDTH / pitch))
        places = step * np.arange(np.ceil(start / step - 1e-9), np.floor(end / step + 1e-9) + 1)
        if len(places):
            return np.asarray(places, dtype=float), float(step)
    count = int(np.ceil((end - start) * BINS_PER_WIDTH / width))
    step = float((end - start) / max(count, 1))
    return np.asarray(start + step * (np.arange(max(count, 1)) + 0.5), dtype=float), step


def _tails(
    noise: Noise, width: float, edges: tuple[float, float], limits: tuple[float, float], expected: Array
) -> tuple[Array, Array]:
    """Probabilities of readings below and above those that stand evenly, in intervals that widen."""
    reach = width * np.append(GROWTH ** np.arange(0.0, np.log(FARTHEST) / np.log(GROWTH)), np.inf)
    lower = np.maximum(edges[0] - reach, limits[0])
    upper = np.minimum(edges[1] + reach, limits[1])
    below, above = _below(noise, edges[0], expected), _above(noise, edges[1], expected)
    end_below = _below(noise, limits[0], expected) if np.isfinite(limits[0]) else np.zeros_like(below)
    end_above = _above(noise, limits[1], expected)
    if (below - end_below).max() <= TAIL:
        lower_part = np.maximum(below - end_below, 0.0)
    else:
        at = [_below(noise, place, expected) if place > -np.inf else 0 * below for place in lower]
        lower_part = np.maximum(-np.diff(np.concatenate([below, *at], axis=1), axis=1), 0.0)
    if (above - end_above).max() <= TAIL:
        upper_part = np.maximum(above - end_above, 0.0)
    else:
        at = [_above(noise, place, expected) if place < np.inf else end_above for place in upper]
        upper_part = np.maximum(-np.diff(np.concatenate([above, *at], axis=1), axis=1), 0.0)
    return lower_part, upper_part


def _above(noise: Noise, limit: float, expected: Array) -> Array:
    """Probability of a reading above a limit, or of none, (R, 1)."""
    return np.exp(np.minimum(np.asarray(noise.log_above(np.asarray(limit), expected)), 0.0))


def _below(noise: Noise, limit: float, expected: Array) -> Array:
    """Probability of a finite reading up to a limit, (R, 1)."""
    return np.exp(np.minimum(np.asarray(log_below(noise, np.asarray(limit), expected)), 0.0))
