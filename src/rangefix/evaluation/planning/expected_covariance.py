"""How accurate a position is going to be after one more beam, on average over what the beam may read.

For each direction the cells of a belief are binned by the range that is expected in them. That gives the
probability of each range and the first moments of the state there; the noise turns both into functions
p(y) and m(y) of the reading y, and by the law of total variance

    E[P] = S - integral of m(y) m(y)' / p(y) dy,

with S the second moments before the reading. Readings that weigh less than their law says come by that law
and are believed by its power: then second moments are functions of the reading, too. Nothing is drawn at
random.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Literal, get_args

import numpy as np

from ...arrays import Array, IntArray
from ...filters import Rangefinder
from ...filters.models.noise_of_beams import noise_of_beams
from ...filters.models.rangefinder import some_beams
from .binning import bin_by_range, bin_in_convex_room, range_ends
from .cells import Cells, beams_alike
from .reading_table import ReadingTable, SharedTables, drawn_by, reading_table

Criterion = Literal["trace", "det", "largest", "information"]
CRITERIA: tuple[Criterion, ...] = get_args(Criterion)
BYTES_AT_ONCE = 200_000_000  # of ranges and slopes
VALUES_AT_ONCE = 10_000_000  # of binned moments
IMPROBABLE = 1e-14  # of a reading, over the most probable one: it counts as none


@dataclass(frozen=True)
class ExpectedAccuracy:
    """What is expected after one more beam, for each of D directions.

    Attributes:
        covariance: E[P], (D, n, n); m^2 and rad^2. Headings differ the short way round from the mean before.
        det: E[det P] of x1 and x2, m^4, (D,); NaN unless asked for.
        largest: E[largest eigenvalue of P] of x1 and x2, m^2, (D,); NaN unless asked for.
        information: Mutual information of the state and the reading, nats, (D,); of readings that weigh less,
            the mean divergence of what is believed after one from what was before.
    """

    covariance: Array
    det: Array
    largest: Array
    information: Array

    @property
    def trace(self) -> Array:
        """E[trace P] of x1 and x2: the expected square of the position's error, m^2, (D,)."""
        return np.asarray(self.covariance[:, 0, 0] + self.covariance[:, 1, 1])

    def objective(self, criterion: Criterion) -> Array:
        """What a plan makes as small as possible, (D,): for information it is minus that.

        Raises:
            ValueError: If there is no such criterion.
        """
        values = {
            "trace": self.trace, "det": self.det, "largest": self.largest, "information": -self.information,
        }  # fmt: skip
        if criterion not in values:
            raise ValueError(f"no criterion {criterion!r}; there are {', '.join(values)}")
        return values[criterion]


@dataclass(frozen=True)
class Views:
    """What is expected in each cell along each beam.

    Attributes:
        sensor: The rangefinder, whose beams are the D directions.
        ranges: m, (D, N); inf = no wall, or a beam that is lost.
        slopes: Their derivatives by the state, (D, N, n), in single precision: only spreads come of them.
        ends: Between which ranges are expected anywhere in the cells, m.
    """

    sensor: Rangefinder
    ranges: Array
    slopes: Array
    ends: tuple[float, float]

    @staticmethod
    def of(cells: Cells, sensor: Rangefinder) -> Views:
        """Cast the beams of a sensor from the centres of cells."""
        ranges, slopes = sensor.look(cells.centres)
        ranges = np.ascontiguousarray(ranges.T)
        slopes = np.ascontiguousarray(np.moveaxis(slopes, 0, 1), dtype=np.float32)
        low, high = range_ends(ranges, slopes, cells.widths)
        ends = (low, high) if low <= high else (0.0, 1.0)  # where no wall is met anywhere, any will do
        return Views(sensor, ranges, slopes, ends)

    def bin(self, part: slice | IntArray, belief: Cells, table: ReadingTable, out: Array) -> None:
        """Moments of a belief by expected range, for some of the beams: see `bin_by_range`."""
        bin_by_range(
            self.ranges[part], self.slopes[part], belief.weights, belief.away, belief.widths, table.low,
            table.step, self.ends, out,
        )  # fmt: skip


@dataclass(frozen=True)
class ConvexViews:
    """The same in a convex room, where no range need be kept.

    Attributes:
        sensor: The rangefinder, whose beams are the D directions.
        walls: Affine functions of the place, of which ranges are the least, m, (D, W, 3).
        points: Where cells are, m, (N, 2).
        ends: Between which ranges are expected anywhere in the cells, m.
    """

    sensor: Rangefinder
    walls: Array
    points: Array
    ends: tuple[float, float]

    @staticmethod
    def of(cells: Cells, sensor: Rangefinder) -> ConvexViews | None:
        """What beams of a sensor meet from the centres of cells; None if the map does not tell it so."""
        walls = sensor.walls_along(cells.centres)
        if walls is None:
            return None
        lower, upper = (cells.centres - cells.widths / 2).min(0), (cells.centres + cells.widths / 2).max(0)
        corners = np.array([[x1, x2] for x1 in (lower[0], upper[0]) for x2 in (lower[1], upper[1])])
        at_corners = walls[..., :1] + walls[..., 1:] @ corners.T
        low, high = float(at_corners.min()), float(at_corners.max(axis=2).min(axis=1).max())
        return ConvexViews(sensor, walls, np.ascontiguousarray(cells.centres[:, :2]), (max(low, 0.0), high))

    def bin(self, part: slice | IntArray, belief: Cells, table: ReadingTable, out: Array) -> None:
        """Moments of a belief by expected range, for some of the beams: see `bin_in_convex_room`."""
        bin_in_convex_room(
            self.walls[part], self.points, belief.weights, belief.away, belief.widths, table.low, table.step,
            self.ends, out,
        )  # fmt: skip


def expected_covariance(
    belief: Cells, beams: Rangefinder, second: bool = False, tables: SharedTables | None = None
) -> ExpectedAccuracy:
    """What is expected after one more reading of one beam, for each beam of a rangefinder.

    Args:
        belief: What is believed now; x1 and x2 stand first in its states.
        beams: Its beams are the directions that are compared, from the heading. Its limits, noise (any law,
            one for all beams or one for each) and blind sector count; a blind beam tells nothing.
        second: Whether E[det P] and E[largest eigenvalue] are worked out too, which takes longer.
        tables: Of readings, to be shared by all beliefs that are asked about with beams of one rangefinder.

    Raises:
        ValueError: If the noise is too fine for the ranges.
    """
    size, count = belief.space.size, len(beams.bearings)
    less = drawn_by(beams.noise)[1] < 1  # then second moments are needed: see `_fold`
    seen = None if second or less else ConvexViews.of(belief, replace(beams, blind_sector=0.0))
    parts = [] if seen is None else [after_views(belief, seen, False, tables)]
    at_once = max(1, int(BYTES_AT_ONCE / (8 * len(belief.centres) * (1 + size))))
    for start in range(0, count if seen is None else 0, at_once):
        chosen = np.arange(start, min(start + at_once, count))
        parts.append(after_views(belief, Views.of(belief, some_beams(beams, chosen)), second, tables))
    joined = [np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(ExpectedAccuracy)]
    before = belief.covariance
    det, largest = np.linalg.det(before[:2, :2]), np.linalg.eigvalsh(before[:2, :2])[-1]
    for values, nothing_new in zip(joined, (before, det, largest, 0.0), strict=True):
        values[beams.blind] = nothing_new
    return ExpectedAccuracy(*joined)


def after_views(
    belief: Cells, views: Views | ConvexViews, second: bool = False, tables: SharedTables | None = None
) -> ExpectedAccuracy:
    """The same where ranges and slopes are known already: no ray is cast."""
    sensor, count = views.sensor, len(views.sensor.bearings)
    alike: dict[str, list[int]] = {}
    noises = [sensor.noise] * count
    if beams_alike(sensor):
        alike[""] = list(range(count))
    else:
        noises = [noise_of_beams(sensor.noise, beam, count) for beam in range(count)]
        for beam, noise in enumerate(noises):
            alike.setdefault(repr(noise), []).append(beam)
    size = belief.space.size
    result = ExpectedAccuracy(np.empty((count, size, size)), *np.full((3, count), np.nan))
    ends = views.ends
    for label, group in alike.items():
        noise = noises[group[0]]
        table = tables.table(label, sensor, noise, *ends) if tables else reading_table(sensor, noise, *ends)
        columns = 1 + size + (3 * second if table.law is None else size * (size + 1) // 2)
        at_once = max(1, VALUES_AT_ONCE // (columns * (table.bins + table.readings)))
        for start in range(0, len(group), at_once):
            some = np.array(group[start : start + at_once])
            part = slice(some[0], some[-1] + 1) if len(some) == some[-1] - some[0] + 1 else some
            masses = np.empty((len(some), columns, table.bins + 1))
            views.bin(part, belief, table, masses)
            _fold(result, some, belief, table, masses, second)
    return result


def _fold(
    result: ExpectedAccuracy, beams: IntArray, belief: Cells, table: ReadingTable, masses: Array, second: bool
) -> None:
    """From moments by expected range to moments by reading, and their averages over all readings."""
    size = belief.space.size
    by_reading = table.readings_of(masses)
    fits = p = by_reading[:, 0]
    if table.law is not None:
        p = table.law.readings_of(masses[:, 0])
    probable = (p > IMPROBABLE * p.max(axis=1, keepdims=True)) & (fits > 0)
    fits, p = np.where(probable, fits, 1.0), np.where(probable, p, 1.0)
    weight = np.where(probable, p, 0.0)
    means = np.where(probable[:, None], by_reading[:, 1 : 1 + size], 0.0)
    seconds = np.where(probable[:, None], by_reading[:, 1 + size :], 0.0)
    sharpness = masses[:, 0] @ table.minus_entropy
    if table.law is None:
        explained = np.matmul(means / p[:, None], np.swapaxes(means, 1, 2))
        covariance = belief.covariance - explained
    else:  # readings come by their law and weigh less: no law of total variance
        inside = np.tril_indices(size)
        covariance = np.zeros((len(p), size, size))
        covariance[:, inside[0], inside[1]] = np.einsum("dr,dcr->dc", weight / fits, seconds)
        covariance[:, inside[1], inside[0]] = covariance[:, inside[0], inside[1]]
        sharpness = -(weight / fits * table.entropies.readings_of(masses[:, 0])).sum(axis=1)
        covariance -= np.matmul(means * (weight / fits**2)[:, None], np.swapaxes(means, 1, 2))
    result.covariance[beams] = 0.5 * (covariance + np.swapaxes(covariance, 1, 2))
    result.information[beams] = sharpness - (p * np.log(fits)).sum(axis=1)
    if second:
        a, b, c = (
            seconds[:, pair] / fits - means[:, pair // 2] * means[:, (pair + 1) // 2] / fits**2
            for pair in range(3)
        )
        a, c = np.maximum(a, 0.0), np.maximum(c, 0.0)
        result.det[beams] = (weight * np.maximum(a * c - b * b, 0.0)).sum(axis=1)
        root = np.sqrt((0.5 * (a - c)) ** 2 + b * b)
        result.largest[beams] = (weight * (0.5 * (a + c) + root)).sum(axis=1)
