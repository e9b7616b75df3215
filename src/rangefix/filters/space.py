"""The state space: names of the components, which of them are angles, and moments that respect them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from math import isfinite

import numpy as np

from ..arrays import Array, BoolArray, check_turns, read_only, real_number, wrap

LEAST_RESULTANT = 0.01  # length of a mean resultant vector below which angles have no mean direction
EVEN_STD = 9.0  # rad; on the circle the density of a wider normal varies by 5e-18, 2 exp(-EVEN_STD^2 / 2)
FEW_NUMBERS = 50  # in covariances: numpy takes longer to begin with so few than plain numbers take
VALUES_AT_ONCE = 1 << 15  # states times components whose moments are taken together: the cache holds them
LEAST_VARIANCE = 1e-20  # m^2 or rad^2: of places in a room no more than that is left by rounding


@dataclass(frozen=True)
class StateSpace:
    """Names of the state components, and the heading where it is known rather than estimated.

    Args:
        names: Component names; "x1" and "x2" (m) must be among them. "heading" (rad, clockwise from +x2)
            is an angle; every other name is a point on a line.
        heading: The known heading (rad) where "heading" is no component, else None.

    Raises:
        ValueError: If x1 or x2 is missing, a name stands twice, or the heading is both known and a
            component, or neither.
    """

    names: tuple[str, ...]
    heading: float | None = None

    def __post_init__(self) -> None:
        texts = isinstance(self.names, Sequence) and all(isinstance(name, str) for name in self.names)
        if isinstance(self.names, str) or not texts:
            raise ValueError(f"state names are a list of texts, got {self.names!r}")
        object.__setattr__(self, "names", tuple(self.names))
        if self.heading is not None:
            object.__setattr__(self, "heading", real_number("the known heading", self.heading))
        if len(set(self.names)) != len(self.names) or not {"x1", "x2"} <= set(self.names):
            raise ValueError(f"state names must be distinct and hold x1 and x2, got {self.names}")
        if ("heading" in self.names) == (self.heading is not None):
            raise ValueError("the heading is either a component or known: give exactly one of the two")
        if self.heading is not None and not np.isfinite(self.heading):
            raise ValueError(f"the known heading must be finite, got {self.heading}")
        if self.heading is not None:
            check_turns("the known heading", self.heading)

    @property
    def size(self) -> int:
        """The number of components n."""
        return len(self.names)

    @cached_property
    def is_angle(self) -> BoolArray:
        """Which components are angles, shape (n,)."""
        return read_only(np.array([name == "heading" for name in self.names]))

    @property
    def position_indices(self) -> list[int]:
        """Where x1 and x2 stand among the components."""
        return [self.names.index("x1"), self.names.index("x2")]

    def positions(self, states: Array) -> Array:
        """x1 and x2 of each state: (..., n) -> (..., 2); a view where they stand side by side."""
        first, second = self.position_indices
        states = np.asarray(states, dtype=float)
        return states[..., first : second + 1] if second == first + 1 else states[..., [first, second]]

    def poses(self, states: Array) -> Array:
        """x1, x2 and heading of each state: (..., n) -> (..., 3)."""
        states = np.asarray(states, dtype=float)
        poses = np.empty((*states.shape[:-1], 3))
        for column, component in enumerate(self.position_indices):  # both at once takes three times as long
            poses[..., column] = states[..., component]
        poses[..., 2] = states[..., self.names.index("heading")] if self.heading is None else self.heading
        return poses

    def from_pose_gradients(self, gradients: Array) -> Array:
        """Derivatives by x1, x2, heading turned into derivatives by the state: (..., 3) -> (..., n)."""
        result = np.zeros((*gradients.shape[:-1], self.size))
        for column, name in enumerate(("x1", "x2", "heading")):
            if name in self.names:
                result[..., self.names.index(name)] = gradients[..., column]
        return result

    def wrap(self, states: Array) -> Array:
        """The same states with angles in [-pi, pi): (..., n) -> (..., n)."""
        if self.heading is not None:
            return states
        wrapped = np.array(states, dtype=float)
        column = self.names.index("heading")
        wrapped[..., column] = wrap(wrapped[..., column])
        return wrapped

    def difference(self, states: Array, reference: Array) -> Array:
        """Differences states - reference, angles the short way round: (..., n), (..., n) -> (..., n)."""
        return self.wrap(np.asarray(states) - np.asarray(reference))

    def moments(self, states: Array, weights: Array) -> tuple[Array, Array]:
        """Weighted mean and covariance; for angles the circular mean, and the tangent space about it.

        Args:
            states: Points, shape (..., N, n).
            weights: Non-negative weights that sum to one over N, shape (..., N).

        Returns:
            mean (..., n) and covariance (..., n, n), symmetric.
        """
        if states.ndim == 3 and len(states) > 1 and states.size > VALUES_AT_ONCE:
            at_once = max(1, VALUES_AT_ONCE // states[0].size)
            weights = np.broadcast_to(weights, states.shape[:-1])
            parts = [slice(start, start + at_once) for start in range(0, len(states), at_once)]
            pairs = [self.moments(states[part], weights[part]) for part in parts]
            return np.concatenate([mean for mean, _ in pairs]), np.concatenate([cov for _, cov in pairs])
        rows = np.ascontiguousarray(np.swapaxes(states, -1, -2))  # numpy is slow on short rows
        mean = np.matmul(rows, weights[..., None])[..., 0]
        angles = np.flatnonzero(self.is_angle)
        for row in angles:
            sine = (weights * np.sin(rows[..., row, :])).sum(-1)
            cosine = (weights * np.cos(rows[..., row, :])).sum(-1)
            mean[..., row] = np.arctan2(sine, cosine)
        away = rows - mean[..., None]
        for row in angles:
            away[..., row, :] = wrap(away[..., row, :])
        covariance = (away * weights[..., None, :]) @ np.swapaxes(away, -1, -2)
        return mean, 0.5 * (covariance + np.swapaxes(covariance, -1, -2))


def with_another_heading(space: StateSpace, states: Array) -> Array:
    """States (M, ..., n) and, where the heading is estimated, one more with another heading behind them.

    Maps may go another way, with another rounding, where all headings are the same, as they are for a single
    state: with it along, ranges at a state are the same whichever others are asked for.
    """
    if not space.is_angle.any():
        return states
    along = states[:1].copy()
    along[..., space.is_angle] += 1.0
    return np.concatenate([states, along])


def deviations_apart(
    space: StateSpace, one: tuple[Array, Array, object], other: tuple[Array, Array, object]
) -> Array:
    """How far two means and covariances are apart, in deviations of the first, (M,); inf where it has none.

    The greatest of |m_i - m'_i| / s_i and |P_ij - P'_ij| / (s_i s_j), angles the short way round.

    Args:
        space: The state space.
        one, other: Means (M, n) and covariances (M, n, n), and whatever else an estimate has.
    """
    (mean, covariance), (mean_2, covariance_2) = one[:2], other[:2]
    std = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        off = np.abs(space.difference(mean_2, mean)) / std
        wrong = np.abs(covariance_2 - covariance) / (std[:, :, None] * std[:, None])
    apart = np.maximum(off.max(axis=1), wrong.max(axis=(1, 2)))
    return np.where(np.isnan(apart), np.inf, apart)


def resultant_of_cells(headings: Array, logs: Array) -> float:
    """Length of the mean resultant vector of headings, rad, (K,), of such log weights, (K,)."""
    weights = np.exp(logs - logs.max())
    return float(np.abs(weights @ np.exp(1j * headings)) / weights.sum())


def resultant_error(error: Array | float, variance: Array | float) -> Array:
    """How far the length of a heading's mean resultant vector may be off where moments are by so much.

    Args:
        error: Of the moments, in deviations.
        variance: Of the heading, rad^2; of more than 1 it counts as 1, for directions lie on a unit circle.
    """
    return np.asarray(error * np.sqrt(np.clip(variance, 0.0, 1.0)))


def may_lack_direction(
    space: StateSpace, covariance: Array, error: Array, resultant_of: Callable[[int], float]
) -> BoolArray:
    """In which runs headings may have no mean, (M,), as far as such an error of the moments tells.

    The length of the mean resultant vector, which is off by as much, is only asked for where the claimed
    variance v leaves it open: it is no less than 1 - v / 2, for 2 (1 - cos d) <= d^2.

    Args:
        space: The state space; of a known heading there is nothing to tell.
        covariance: Claimed covariances, (M, n, n).
        error: Of the moments, in deviations, (M,).
        resultant_of: Gives the length of a run's mean resultant vector.
    """
    lacking = np.zeros(len(error), bool)
    if space.heading is not None:
        return lacking
    place = space.names.index("heading")
    variances = covariance[:, place, place]
    off = resultant_error(error, variances)
    for run in np.flatnonzero(~(1 - variances / 2 - off >= LEAST_RESULTANT)):
        lacking[run] = not resultant_of(int(run)) - off[run] >= LEAST_RESULTANT
    return lacking


def is_definite(covariance: Array, rounding: float = 1e-14, least: float = LEAST_VARIANCE) -> BoolArray:
    """Which covariances are finite and positive definite by more than rounding leaves.

    Args:
        covariance: (..., n, n).
        rounding: A variance given the other components that is no more than this share of the whole is zero.
        least: And one that is no more than this.

    Returns:
        (...). Worked out for all at once, or in plain numbers where there are few.
    """
    size = covariance.shape[-1]
    if covariance.size <= FEW_NUMBERS:
        few = covariance.reshape(-1, size, size).tolist()
        fine = np.array([_is_definite(each, rounding, least) for each in few], bool)
        return fine.reshape(covariance.shape[:-2])
    rows = np.moveaxis(covariance, (-2, -1), (0, 1))
    fine = np.asarray(np.isfinite(rows).all((0, 1)))
    if not fine.all():
        rows = np.where(fine, rows, 0.0)
    for j in range(size):
        left = rows[0, 0]  # what is left of the variance, given the components before
        fine &= left > least
        if rounding:
            fine &= left > rounding * covariance[..., j, j]
        if j + 1 < size:
            slope = rows[1:, 0] / (left if fine.all() else np.where(fine, left, 1.0))
            rows = rows[1:, 1:] - slope[:, None] * rows[0, 1:]
    return fine


def lower_roots(covariances: Array, least: float = 0.0) -> Array:
    """Lower triangular roots L of covariances L L', (n, n, M) -> (n, n, M).

    Term by term, so that one has the same bits alone as among others. Where the variance given the components
    before is no more than a share `least` of the whole, it is taken for zero, and so is its column.
    """
    roots = np.zeros_like(covariances)
    for j in range(len(covariances)):
        column = covariances[j:, j].copy()
        for before in range(j):
            column -= roots[j, before] * roots[j:, before]
        fine = column[0] > least * covariances[j, j]
        if fine.all():
            roots[j:, j] = column / np.sqrt(column[0])
        else:
            roots[j:, j] = np.where(fine, column / np.sqrt(np.where(fine, column[0], 1.0)), 0.0)
    return roots


def _is_definite(rows: list[list[float]], rounding: float, least: float) -> bool:
    """The same for one covariance (n, n), step by step as for many; it is changed."""
    if not all(map(isfinite, chain.from_iterable(rows))):
        return False
    bars = [max(least, rounding * row[place]) for place, row in enumerate(rows)]
    for j, pivot in enumerate(rows):
        left = pivot[j]  # what is left of the variance, given the components before
        if not left > bars[j]:
            return False
        for row in rows[j + 1 :]:
            slope = row[j] / left
            for k in range(j + 1, len(pivot)):
                row[k] -= slope * pivot[k]
    return True


def position_space(heading: float = 0.0) -> StateSpace:
    """x1, x2 (m) under a known heading (rad, clockwise from +x2)."""
    return StateSpace(("x1", "x2"), heading=heading)


def pose_space() -> StateSpace:
    """x1, x2 (m) and heading (rad, clockwise from +x2), all estimated."""
    return StateSpace(("x1", "x2", "heading"))


def velocity_space(heading: float = 0.0) -> StateSpace:
    """x1, x2 (m) and their velocities v1, v2 (m/s) under a known heading (rad, clockwise from +x2)."""
    return StateSpace(("x1", "x2", "v1", "v2"), heading=heading)
