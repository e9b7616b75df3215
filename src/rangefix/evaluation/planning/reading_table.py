"""How probable each reading is where a range is expected, as a table: any noise, no returns included."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator
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
WHOLE = 1_000_000  # probabilities that are worked out at once; of more, those about the ranges of some bins
BINS_AT_ONCE, MARGIN = 256, 8  # of these; readings that are taken besides to both sides
NOTHING = 1e-16  # probability of all readings to one side that are left out then
MOST_KEPT = 250_000_000  # probabilities of one table
SHARED_PARTS = 4.0  # of the ranges asked for: shared tables reach at most two of them further
SHARED_TABLES, MOST_SHARED = 100, 500_000  # that are kept, and probabilities in each
SHARPEN = 1 / 24  # Sheppard's correction: what bins blur, the table sharpens
Block = tuple[slice, slice, Array]  # readings, bins that can give them, and probabilities (bins, readings)


@dataclass(frozen=True)
class ReadingTable:
    """Probabilities of readings, in intervals, for expected ranges in bins of equal width.

    Attributes:
        low: Where the first bin begins, m.
        step: Width of a bin, m.
        bins: How many there are. One more row stands for "no wall, or a beam that is lost".
        readings: How many there are. The last ones are "no return" and "too close", where there are such.
        blocks: Probabilities of readings in bins, where there are any; each bin's sum to one. Where readings
            weigh less, their power.
        lost: The same of "no wall, or a beam that is lost", (readings,).
        minus_entropy: Sum of p log p over the readings, nats, (bins + 1,).
        law: By which readings are drawn that weigh less; None where they are drawn by these.
    """

    low: float
    step: float
    bins: int
    readings: int
    blocks: tuple[Block, ...]
    lost: Array
    minus_entropy: Array
    law: ReadingTable | None = None

    @cached_property
    def entropies(self) -> ReadingTable:
        """- p log p of each reading by itself, nats, in the place of probabilities."""
        blocks = tuple((readings, bins, -_p_log_p(part)) for readings, bins, part in self.blocks)
        return replace(self, blocks=blocks, lost=-_p_log_p(self.lost), law=None)

    @property
    def size(self) -> int:
        """How many probabilities are kept."""
        return sum(part.size for _, _, part in self.blocks)

    def readings_of(self, masses: Array) -> Array:
        """Sums over expected ranges, as functions of the reading: (D, C, bins + 1) -> (D, C, readings)."""
        flat = masses.reshape(-1, self.bins + 1)
        out = np.zeros((len(flat), self.readings))
        for readings, bins, part in self.blocks:
            out[:, readings] += flat[:, bins] @ part
        if flat[:, -1].any():
            out += flat[:, -1:] * self.lost
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
            if made.size > MOST_SHARED:
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
    first_bin = low - 2.5 * step
    centres = first_bin + step * (np.arange(-1, bins + 1) + 0.5)  # and neighbours, for the correction
    expected = np.append(centres, np.inf)[:, None]
    places, pitch, rest = _readings(sensor, law, width, (low, high), expected)
    if len(expected) * len(places) <= WHOLE:
        table = _joined(_core(law, places, pitch, expected), rest)
        table = _summing_to_one(table[:, table.max(axis=0) > ZERO])
        count, lost, parts = table.shape[1], table[-1], iter([(0, 0, table.shape[1], table[:-1])])
    else:
        windows = _windows(sensor, law, places, expected[:-1])
        if sum(BINS_AT_ONCE * (window.stop - window.start) for window in windows) > MOST_KEPT:
            raise ValueError(
                f"noise as fine as {width:.3g} m whose tails reach far, against ranges from {low:.3g} to "
                f"{high:.3g} m: planning keeps at most {MOST_KEPT} probabilities of readings"
            )
        count, parts = len(places) + rest.shape[1], _parts(law, places, pitch, rest, expected, windows)
        lost = _summing_to_one(_joined(_core(law, places, pitch, expected[-1:]), rest[-1:]))[0]
    blocks, powers, entropies = list[Block](), list[Block](), list[Array]()
    for start, first, of_core, table in parts:
        sharp = _summing_to_one(_sharpened(table))
        blocks += _blocks(sharp[:, :of_core], start, first) + _blocks(sharp[:, of_core:], start, len(places))
        entropies.append(_p_log_p(table[1:-1]).sum(axis=1))
        if weight != 1:
            power = _sharpened(table**weight)
            powers += _blocks(power[:, :of_core], start, first)
            powers += _blocks(power[:, of_core:], start, len(places))
    entropy = np.append(np.concatenate(entropies), _p_log_p(lost).sum())
    drawn = ReadingTable(first_bin, step, bins, count, tuple(blocks), lost, entropy)
    return drawn if weight == 1 else replace(drawn, blocks=tuple(powers), lost=lost**weight, law=drawn)


def _windows(sensor: Rangefinder, noise: Noise, places: Array, expected: Array) -> list[slice]:
    """Which of the readings that stand evenly some bins may give, for each BINS_AT_ONCE and neighbours."""
    least, windows = _least(sensor), list[slice]()
    for start in range(0, len(expected) - 2, BINS_AT_ONCE):
        rows = expected[start : start + BINS_AT_ONCE + 2]
        below = _below(noise, least, rows) if np.isfinite(least) else 0.0
        above = _above(noise, sensor.max_range, rows)
        first = bisect_left(
            places, True, key=lambda at: bool((_below(noise, at, rows) - below).max() > NOTHING)
        )
        last = bisect_left(
            places, True, key=lambda at: bool((_above(noise, at, rows) - above).max() <= NOTHING)
        )
        first = max(first - MARGIN, 0)
        windows.append(slice(first, max(min(last + MARGIN, len(places)), first)))
    return windows


def _parts(
    noise: Noise, places: Array, pitch: float, rest: Array, expected: Array, windows: list[slice]
) -> Iterator[tuple[int, int, int, Array]]:
    """Probabilities of some bins and their neighbours after the other.

    Yields:
        The first bin, the first reading, how many readings stand evenly from there, and the table of these
        and of the others.
    """
    for number, window in enumerate(windows):
        start = number * BINS_AT_ONCE
        rows = slice(start, min(start + BINS_AT_ONCE + 2, len(expected) - 1))
        table = _joined(_core(noise, places[window], pitch, expected[rows]), rest[rows])
        yield start, window.start, window.stop - window.start, _summing_to_one(table)


def _blocks(table: Array, first_bin: int, first: int) -> list[Block]:
    """A table (bins, readings) in parts: some readings, and the bins that can give them."""
    blocks = []
    for start in range(0, table.shape[1], READINGS_AT_ONCE):
        part = table[:, start : start + READINGS_AT_ONCE]
        rows = np.flatnonzero(part.max(axis=1) > ZERO)
        if len(rows):
            readings = slice(first + start, first + start + part.shape[1])
            bins = slice(first_bin + int(rows[0]), first_bin + int(rows[-1]) + 1)
            blocks.append((readings, bins, np.ascontiguousarray(part[rows[0] : rows[-1] + 1])))
    return blocks


def drawn_by(noise: Noise) -> tuple[Noise, float]:
    """The law of readings, and what one weighs: Gaussian ones that weigh less count as wider ones."""
    law, weight = law_and_weight(noise)
    return (noise, 1.0) if weight == 1 or wider_gaussian(noise) else (law, weight)


def _sharpened(table: Array) -> Array:
    """Sheppard's correction of all rows but the first and the last, which are neighbours only."""
    sharp = table[1:-1] - SHARPEN * (table[2:] - 2 * table[1:-1] + table[:-2])
    return np.asarray(np.maximum(sharp, 0.0))


def _summing_to_one(table: Array) -> Array:
    return np.asarray(table / table.sum(axis=1, keepdims=True))


def _p_log_p(table: Array) -> Array:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(table > 0, table * np.log(table), 0.0)


def probabilities(
    sensor: Rangefinder, noise: Noise, width: float, ends: tuple[float, float], expected: Array
) -> Array:
    """Probabilities of all readings, (R, readings), for expected ranges (R, 1); rows sum to one."""
    places, pitch, rest = _readings(sensor, noise, width, ends, expected)
    table = _joined(_core(noise, places, pitch, expected), rest)
    return _summing_to_one(table[:, table.max(axis=0) > ZERO])


def _least(sensor: Rangefinder) -> float:
    """The least reading that comes back, m: a step at the limit is read."""
    return sensor.min_range * (1 - 10 * LIMIT_ROUNDING) if sensor.min_range else -np.inf


def _readings(
    sensor: Rangefinder, noise: Noise, width: float, ends: tuple[float, float], expected: Array
) -> tuple[Array, float, Array]:
    """Readings that stand evenly, how far apart, m, and probabilities of all others, (R, others)."""
    least = _least(sensor)
    low, high = np.array(ends) + reading_bias(noise)  # about which readings stand, not about the ranges
    start, end = max(float(low) - CORE * width, least), min(float(high) + CORE * width, sensor.max_range)
    places, pitch, edges = np.empty(0), 0.0, (start, start)
    if end > start:
        places, pitch = _places(noise, width, start, end)
        edges = places[0] - pitch / 2, places[-1] + pitch / 2
    silent = _above(noise, sensor.max_range, expected)
    close = _below(noise, least, expected) if sensor.min_range else np.zeros_like(silent)
    lower, upper = _tails(noise, width, edges, (least, sensor.max_range), expected)
    return places, pitch, np.concatenate([lower, upper, silent, close], axis=1)


def _core(noise: Noise, places: Array, pitch: float, expected: Array) -> Array:
    """Probabilities of readings that stand evenly, (R, places), not yet of the right sum."""
    if not len(places):
        return np.empty((len(expected), 0))
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        core = np.exp(np.asarray(noise.log_density(places, expected))) * pitch
    return np.nan_to_num(core, nan=0.0)


def _joined(core: Array, rest: Array) -> Array:
    """Probabilities of all readings, those that stand evenly so that all sum to one."""
    left = 1 - rest[:, -2] - rest[:, -1] - rest[:, :-2].sum(axis=1)
    total = core.sum(axis=1)
    core *= np.where(total > TAIL, np.maximum(left, 0.0) / np.maximum(total, TAIL), 1.0)[:, None]
    return np.concatenate([core, rest], axis=1)


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
