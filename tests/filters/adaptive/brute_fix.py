"""A fix from one scan, by explicit quadrature over every pose that the readings leave possible.

A reference for filters that are cleverer; it shares no code with them. Poses x1, x2 and heading are cut into
boxes whose borders run along all walls, so that no box is cut by one: walls are parallel to the axes. Over a
box the range of a beam is bounded: for one direction and one wall it is linear in the position, so that its
extremes are at the corners; over a fan of directions it is convex, so that they are at the ends of the fan or
where it meets the wall squarely; and where the end of a wall lies in the fan, the distance to it counts too,
and behind a corner that sticks out anything is possible. With the ranges the likelihood is bounded, and a box
is dropped if that bound is `drop` nats below the best pose met. What is dropped holds at most
exp(-drop) times the ratio of the volumes of prior and posterior. Boxes that are kept are halved until they
are no wider than a few conditional standard deviations, and then summed over Gauss-Legendre points.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import lgamma

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
TURN = 2 * np.pi
FIRST = np.array([0.4, 0.4, np.deg2rad(10.0)])  # widest boxes to begin with
WIDEST = 1.6  # conditional standard deviations; boxes are halved down to this
LEAST = np.array([1e-3, 1e-3, 5e-4])  # boxes no wider than this are halved no more
JUMP = (0.025, 0.025, 0.01)  # deviations that are never exceeded where the wall met changes within a box
INSIDE = 1 - 1e-9  # corners of a box that lie on a wall are seen from within the box


@dataclass(frozen=True)
class Plan:
    """Walls parallel to the axes: an outline, corners (n, 2) counter-clockwise, and inner walls (k, 4)."""

    outline: Array
    inner: Array

    @property
    def walls(self) -> Array:
        """All walls, (S, 4), from x1, x2 to x1, x2."""
        return np.vstack([np.hstack([self.outline, np.roll(self.outline, -1, axis=0)]), self.inner])

    @property
    def ends(self) -> Array:
        """Ends of walls, (V, 3): x1, x2, and 1 where one may look past them at what is behind, else 0."""
        before, after = (
            self.outline - np.roll(self.outline, 1, 0),
            np.roll(self.outline, -1, 0) - self.outline,
        )
        reflex = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0] < 0
        tips = self.inner.reshape(-1, 2)
        return np.vstack(
            [np.column_stack([self.outline, reflex]), np.column_stack([tips, np.ones(len(tips))])]
        )

    @property
    def area(self) -> float:
        """Of the free space, m^2."""
        x1, x2 = self.outline.T
        return float(0.5 * (x1 @ np.roll(x2, -1) - x2 @ np.roll(x1, -1)))

    def boxes(self, heading: float | None) -> Array:
        """The free space, and any heading or this one, in boxes up to FIRST: centre, half widths, (N, 6)."""
        axes = []
        for axis in (0, 1):
            marks = np.unique(self.walls.reshape(-1, 2)[:, axis])
            parts = [np.linspace(a, b, 1 + int(np.ceil((b - a) / FIRST[axis]))) for a, b in pairwise(marks)]
            axes.append(np.unique(np.concatenate(parts)))
        count = 1 if heading is not None else int(np.ceil(TURN / FIRST[2]))
        turns = np.full(2, heading) if heading is not None else np.linspace(0, TURN, count + 1)
        axes.append(turns)
        centres = np.stack(np.meshgrid(*[(a[1:] + a[:-1]) / 2 for a in axes], indexing="ij"), -1).reshape(
            -1, 3
        )
        halves = np.stack(np.meshgrid(*[np.diff(a) / 2 for a in axes], indexing="ij"), -1).reshape(-1, 3)
        return np.hstack([centres, halves])[self._within(centres[:, :2])]

    def _within(self, points: Array) -> NDArray[np.bool_]:
        """Whether points (N, 2), none on a wall, are within the outline: crossings of a ray along +x1."""
        within = np.zeros(len(points), np.bool_)
        for a1, a2, _, b2 in self.walls[: len(self.outline)]:
            if a2 != b2:
                within ^= ((points[:, 1] > a2) != (points[:, 1] > b2)) & (points[:, 0] < a1)
        return within


@dataclass(frozen=True)
class Scan:
    """Readings (B,) in metres at bearings (B,); Student's noise of this scale, or Gaussian if dof is inf."""

    bearings: Array
    readings: Array
    scale: float
    dof: float = np.inf

    @property
    def log_peak(self) -> float:
        """Log density of readings that fit perfectly."""
        each = -0.5 * np.log(TURN)
        if np.isfinite(self.dof):
            each = lgamma((self.dof + 1) / 2) - lgamma(self.dof / 2) - 0.5 * np.log(self.dof * np.pi)
        return float(len(self.readings) * (each - np.log(self.scale)))


@dataclass(frozen=True)
class Brute:
    """The posterior, summed up in small boxes.

    centres: (N, 3). sums: Of 1, the offsets from the centre, and their products, times probability, (N, 13).
    log_evidence: nats. poses: How many were looked at.
    """

    centres: Array
    sums: Array
    log_evidence: float
    poses: int

    @cached_property
    def masses(self) -> Array:
        """Probability of each box, (N,)."""
        return np.asarray(self.sums[:, 0])

    def moments(
        self, start: float, turn: float = TURN, some: Array | None = None
    ) -> tuple[float, Array, Array]:
        """Probability, mean (3,) and covariance (3, 3) of all or some of the boxes.

        Headings are counted modulo `turn`, from `start` on.
        """
        sums, centres = self.sums, self.centres.copy()
        if some is not None:
            sums, centres = sums[some], centres[some]
        centres[:, 2] = start + (centres[:, 2] - start) % turn
        total = sums[:, 0].sum()
        mean = (sums[:, :1] * centres + sums[:, 1:4]).sum(0) / total
        away = centres - mean
        cross = np.einsum("ki,kj->ij", away, sums[:, 1:4])
        second = np.einsum("k,ki,kj->ij", sums[:, 0], away, away) + cross + cross.T
        second += sums[:, 4:].sum(0).reshape(3, 3)
        return float(total), mean, second / total


def brute_fix(
    plan: Plan, scan: Scan, heading: float | None = None, spacing: float = 0.2, drop: float = 25.0
) -> Brute:
    """The posterior under a uniform prior over the free space and, unless it is known, the heading.

    Args:
        plan: The walls.
        scan: The readings.
        heading: The known heading, rad.
        spacing: Of the poses looked at, in conditional standard deviations of a component: the smallest that
            the sensitivities of the ranges met in the box add up to.
        drop: Boxes are dropped whose densities are at least so many nats below the best.
    """
    walls, ends, boxes = plan.walls, plan.ends, plan.boxes(heading)
    best, leaves, shares = np.inf, [], []
    while len(boxes):
        bound, centre, slopes = _bounds(
            boxes, walls, ends, scan.bearings, scan.readings, scan.scale, scan.dof, best + drop
        )
        best = min(best, float(centre.min()))
        kept = bound <= best + drop
        boxes, width = boxes[kept], 2 * boxes[kept, 3:]
        # poorer boxes count for less and may be summed at less care: twice the spacing for each 3 nats
        many = width * slopes[kept] / 2 ** np.clip((bound[kept] - best - 5) / 3, 0, 6)[:, None]
        split = (many > WIDEST) & (width > LEAST)
        done = ~split.any(axis=1)
        leaves.append(boxes[done])
        shares.append(np.maximum(1, np.ceil(np.minimum(many[done], WIDEST) / (2 * spacing))))
        boxes, split = boxes[~done], split[~done]
        for axis in range(3):
            rows = boxes[split[:, axis]]
            rows[:, 3 + axis] /= 2
            shift = np.zeros(6)
            shift[axis] = 1
            step = rows[:, 3 + axis, None] * shift
            boxes = np.vstack([boxes[~split[:, axis]], rows - step, rows + step])
            split = np.vstack([split[~split[:, axis]], split[split[:, axis]], split[split[:, axis]]])
    found, counts = np.vstack(leaves), np.vstack(shares).astype(np.int64)
    sums = _sums(found, counts, walls, scan.bearings, scan.readings, scan.scale, scan.dof, best, best + drop)
    total = sums[:, 0].sum()
    log_prior = -np.log(plan.area) - (np.log(TURN) if heading is None else 0.0)
    evidence = float(np.log(total) - best + scan.log_peak + log_prior)
    some = sums[:, 0] > 0
    poses = int(np.prod(np.where(found[:, 3:] > 0, 2 * counts, 1), axis=1).sum())
    return Brute(found[some, :3], sums[some] / total, evidence, poses)


@njit(cache=True, nogil=True, inline="always")
def _cast(x1: float, x2: float, sine: float, cosine: float, walls: Array) -> tuple[float, int]:
    """Distance to the first wall in a direction, and which it is."""
    least, which = np.inf, -1
    for k in range(walls.shape[0]):
        a1, a2 = walls[k, 0] - x1, walls[k, 1] - x2
        e1, e2 = walls[k, 2] - walls[k, 0], walls[k, 3] - walls[k, 1]
        det = sine * e2 - cosine * e1
        if det == 0.0:
            continue
        distance = (a1 * e2 - a2 * e1) / det
        if distance <= 0.0 or distance >= least:
            continue
        along = (a1 * cosine - a2 * sine) / det
        if -1e-12 <= along <= 1.0 + 1e-12:
            least, which = distance, k
    return least, which


@njit(cache=True, nogil=True, inline="always")
def _penalty(miss: float, scale: float, dof: float) -> float:
    """How many nats a reading that is off falls short of a perfect fit."""
    square = (miss / scale) ** 2
    return 0.5 * square if dof == np.inf else 0.5 * (dof + 1.0) * np.log1p(square / dof)


@njit(cache=True, nogil=True)
def _bounds(
    boxes: Array, walls: Array, ends: Array, bearings: Array, readings: Array, scale: float, dof: float,
    limit: float,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Least penalty in each box (inf beyond the limit), (N,), that at its centre, (N,), and sensitivities.

    The last are the roots of the sums over beams of the squared greatest slopes met, in standard deviations,
    (N, 3); where the wall met changes, no less than JUMP asks for.
    """
    bound, centre, slopes = np.zeros(len(boxes)), np.full(len(boxes), np.inf), np.zeros((len(boxes), 3))
    for n in range(len(boxes)):
        x1, x2, turn, h1, h2, half = boxes[n]
        reach, jumps = np.hypot(h1, h2), False
        for b in range(len(bearings)):
            middle = turn + bearings[b]
            low, high, first = np.inf, 0.0, -2
            s1, s2, s3 = 0.0, 0.0, 0.0
            for i in range(-1, 2 if half > 0 else 0):
                angle = middle + i * half if half > 0 else middle
                sine, cosine = np.sin(angle), np.cos(angle)
                for c in range(4):
                    p1 = x1 + INSIDE * (h1 if c % 2 else -h1)
                    p2 = x2 + INSIDE * (h2 if c // 2 else -h2)
                    distance, which = _cast(p1, p2, sine, cosine, walls)
                    low, high = min(low, distance), max(high, distance)
                    first = which if first == -2 else first
                    jumps |= which != first
                    if which >= 0:
                        e1, e2 = walls[which, 2] - walls[which, 0], walls[which, 3] - walls[which, 1]
                        det = sine * e2 - cosine * e1
                        s1, s2 = max(s1, abs(e2 / det)), max(s2, abs(e1 / det))
                        s3 = max(s3, abs(distance * (cosine * e2 + sine * e1) / det))
            low -= high * half * half
            for v in range(len(ends)):
                e1, e2 = ends[v, 0] - x1, ends[v, 1] - x2
                away = np.hypot(e1, e2)
                off = abs((np.arctan2(e1, e2) - middle + np.pi) % TURN - np.pi)
                if away <= reach or off <= half + np.arcsin(min(1.0, reach / away)):
                    low = min(low, away - reach)
                    high = np.inf if ends[v, 2] > 0 else max(high, away + reach)
            nearest = min(max(readings[b], low), high)
            bound[n] += _penalty(readings[b] - nearest, scale, dof)
            slopes[n, 0] += s1 * s1
            slopes[n, 1] += s2 * s2
            slopes[n, 2] += s3 * s3
            if bound[n] > limit:
                bound[n] = np.inf
                break
        else:
            total = 0.0
            for b in range(len(bearings)):
                angle = turn + bearings[b]
                distance, _ = _cast(x1, x2, np.sin(angle), np.cos(angle), walls)
                total += _penalty(readings[b] - distance, scale, dof)
            centre[n] = total
        for axis in range(3):
            slopes[n, axis] = np.sqrt(slopes[n, axis]) / scale
            if jumps:
                slopes[n, axis] = max(slopes[n, axis], 1 / JUMP[axis])
    return bound, centre, slopes


@njit(cache=True, nogil=True, inline="always")
def _place(middle: float, half: float, count: int, point: int) -> float:
    """The Gauss-Legendre points, two for each of so many equal parts of an interval, one if it is a point."""
    if half == 0.0:
        return middle
    part = half / count
    shift = -0.5773502691896258 if point % 2 == 0 else 0.5773502691896258
    return middle - half + part * (2 * (point // 2) + 1 + shift)


@njit(cache=True, nogil=True)
def _sums(
    boxes: Array, counts: NDArray[np.int64], walls: Array, bearings: Array, readings: Array, scale: float,
    dof: float, best: float, limit: float,
) -> Array:  # fmt: skip
    """Integrals over each box of the likelihood times 1, the offset and its products, (N, 13)."""
    sums = np.zeros((len(boxes), 13))
    beams = len(bearings)
    sine, cosine, away = np.empty(beams), np.empty(beams), np.empty(3)
    for n in range(len(boxes)):
        many, volume = np.ones(3, np.int64), 1.0
        for axis in range(3):
            if boxes[n, 3 + axis] > 0:
                many[axis] = 2 * counts[n, axis]
                volume *= 2 * boxes[n, 3 + axis] / many[axis]
        for k in range(many[2]):
            turn = _place(boxes[n, 2], boxes[n, 5], counts[n, 2], k)
            away[2] = turn - boxes[n, 2]
            for b in range(beams):
                sine[b], cosine[b] = np.sin(turn + bearings[b]), np.cos(turn + bearings[b])
            for i in range(many[0]):
                x1 = _place(boxes[n, 0], boxes[n, 3], counts[n, 0], i)
                away[0] = x1 - boxes[n, 0]
                for j in range(many[1]):
                    x2 = _place(boxes[n, 1], boxes[n, 4], counts[n, 1], j)
                    away[1] = x2 - boxes[n, 1]
                    total = 0.0
                    for b in range(beams):
                        distance, _ = _cast(x1, x2, sine[b], cosine[b], walls)
                        total += _penalty(readings[b] - distance, scale, dof)
                        if total > limit:
                            break
                    if total > limit:
                        continue
                    weight = volume * np.exp(best - total)
                    sums[n, 0] += weight
                    for r in range(3):
                        sums[n, 1 + r] += weight * away[r]
                        for c in range(3):
                            sums[n, 4 + 3 * r + c] += weight * away[r] * away[c]
    return sums
