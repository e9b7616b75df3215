"""A robot that counts its wheels' turns: displacement and turn in its own frame, noisy with both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from ...arrays import Array, compared_by, for_loops, keep_copies, real_array, wrap
from ..space import StateSpace
from .motion import step_stds

Errors = tuple[Array, Array, Array]  # forward, right (m) and turn (rad) by one standard deviation of an error
ON_THE_SPOT = 0.01  # m; below this a displacement has no direction that its noise could depend on
AT_ONCE = 1024  # states that one pass takes: what is worked out in between stays in the cache
MANY_VALUES = 64  # components of states: with fewer, one pass in compiled code is not worth it


@compared_by()
@dataclass(frozen=True)
class Odometry:
    """Motion by a control in the body frame: forward (m), right (m), turn (rad, clockwise).

    With heading K, clockwise from +x2, forward is (sin K, cos K) and right is (cos K, -sin K). The mean moves
    by the displacement in the frame of the heading before the move, then turns:

        x' = x + forward (sin K, cos K) + right (cos K, -sin K),    K' = K + turn.

    Noise is Gaussian in the body frame, of a covariance that depends on the control alone. Its four
    parameters are those of the odometry model of Thrun, Burgard and Fox (2005, section 5.4): the control is
    split into a turn rot1 towards the displacement, its length trans, and a turn rot2 for the rest, whose
    independent errors have variances

        rot1:  a1 rot1^2 + a2 trans^2
        trans: a3 trans^2 + a4 (rot1^2 + rot2^2)
        rot2:  a1 rot2^2 + a2 trans^2.

    The book passes them through the move's curve; here they enter to first order (trans moves along the
    displacement, rot1 moves across it by trans rot1, both rots turn), so that the law of a step is exactly
    Gaussian and every filter can hold exactly it. As in AMCL, going backwards counts as no turn, and a
    displacement under 1 cm counts as a turn on the spot.

    Args:
        space: A space with the heading among its components; others stay as they are.
        alphas: a1, a2 (rad^2/m^2), a3, a4 (m^2/rad^2), at least zero.
        floor: Standard deviations added to every step, however small: forward, right (m), turn (rad).

    Raises:
        ValueError: If the space has no heading, or a parameter is negative or not finite.
    """

    space: StateSpace
    alphas: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    floor: ArrayLike = 0.0
    is_gaussian = True

    def __post_init__(self) -> None:
        keep_copies(self)
        if "heading" not in self.space.names:
            raise ValueError("odometry needs the heading among the state's components: take pose_space()")
        alphas = real_array("alphas", self.alphas)
        if alphas.shape != (4,) or not (np.isfinite(alphas).all() and (alphas >= 0).all()):
            raise ValueError(f"odometry needs four alphas, at least zero and finite, got {self.alphas!r}")
        _ = self.floors  # refuses what does not fit

    @cached_property
    def floors(self) -> Array:
        """Standard deviations added to every step: forward, right, turn, (3,)."""
        return step_stds("odometry's floor", self.floor, ("forward", "right", "turn"))

    @property
    def _places(self) -> list[int]:
        """Where x1, x2 and heading stand among the components."""
        return [self.space.names.index(name) for name in ("x1", "x2", "heading")]

    def mean(self, states: Array, control: Array) -> Array:
        """The states after a noise-free move, (..., n), headings wrapped; control (3,) or (..., 3)."""
        states, control = _pair(states, control)
        if states.size >= MANY_VALUES and control.ndim == 1:
            return self._move_many(states, control, [], np.empty((0, *states.shape[:-1])))
        return self._moved(states, control[..., 0], control[..., 1], control[..., 2])

    def _move_many(self, states: Array, control: Array, errors: list[Errors], draws: Array) -> Array:
        """States (..., n) moved by one control (3,) with so many of each error, (E, ...): one pass."""
        from .kernels.moves import move_by_control  # numba takes a quarter of a second

        one, two, heading = self._places
        moved = np.array(states, order="C").reshape(-1, states.shape[-1])
        count, before = len(moved), np.ascontiguousarray(moved[:, heading])
        sizes, draws = np.array(errors, dtype=float).reshape(-1, 3), draws.reshape(-1, count)
        turned, parts = np.empty((2, count)), np.empty((3, min(count, AT_ONCE)))
        np.sin(before, out=turned[0])
        np.cos(before, out=turned[1])
        move_by_control(moved, (one, two, heading), for_loops(control), sizes, draws, turned, parts)
        return moved.reshape(states.shape)

    def _moved(self, states: Array, forward: Array, right: Array, turn: Array) -> Array:
        """States (..., n) moved by the parts of a control, (...) each."""
        one, two, heading = self._places
        before = np.array(states[..., heading])
        step1, step2 = _to_map(before, forward, right)
        moved = np.array(states)
        moved[..., one] += step1
        moved[..., two] += step2
        moved[..., heading] = wrap(before + turn)
        return moved

    def origins(self, states: Array, control: Array) -> Array:
        """The states that a noise-free move takes to these, (..., n), headings wrapped: see `CanGoBack`."""
        states, control = _pair(states, control)
        one, two, heading = self._places
        origins = np.array(states)
        origins[..., heading] = wrap(states[..., heading] - control[..., 2])
        step1, step2 = _to_map(origins[..., heading], control[..., 0], control[..., 1])
        origins[..., one] -= step1
        origins[..., two] -= step2
        return origins

    def jacobian(self, states: Array, control: Array) -> Array:
        """Derivatives of `mean` by the state, (..., n, n): the displacement turns with the heading."""
        states, control = _pair(states, control)
        one, two, heading = self._places
        result = np.zeros((*states.shape[:-1], self.space.size, self.space.size))
        result[...] = np.eye(self.space.size)
        step1, step2 = _to_map(states[..., heading], control[..., 0], control[..., 1])
        result[..., one, heading], result[..., two, heading] = step2, -step1
        return result

    def noise_covariance(self, states: Array, control: Array) -> Array:
        """Covariance of the move's noise in the map frame, (..., n, n)."""
        body = self.body_covariance(control)
        states, _ = _pair(states, control)
        heading = states[..., self._places[2]]
        turn = np.zeros((*heading.shape, 3, 3))
        turn[..., 0, 0], turn[..., 1, 0] = _to_map(heading, 1.0, 0.0)
        turn[..., 0, 1], turn[..., 1, 1] = _to_map(heading, 0.0, 1.0)
        turn[..., 2, 2] = 1.0
        rows, columns = np.ix_(self._places, self._places)
        result = np.zeros((*heading.shape, self.space.size, self.space.size))
        result[..., rows, columns] = turn @ body @ np.swapaxes(turn, -1, -2)
        return result

    def sample(self, states: Array, control: Array, rng: Generator) -> Array:
        """The states after one noisy move each, (..., n), headings wrapped."""
        errors = self._errors(_checked(control))
        states, control = _pair(states, control)
        draws = rng.standard_normal((len(errors), *states.shape[:-1]))
        if states.size >= MANY_VALUES and control.ndim == 1:
            return self._move_many(states, control, errors, draws)
        noisy = [control[..., column] for column in range(3)]
        for error, drawn in zip(errors, draws, strict=True):
            for column, part in enumerate(error):
                if part.ndim or part:
                    noisy[column] = noisy[column] + drawn * part
        return self._moved(states, *noisy)

    def sample_runs(self, states: Array, control: Array, rngs: Sequence[Generator]) -> Array:
        """One move of M runs, (M, n): run m as `sample` draws it from rngs[m], whatever the others do."""
        states, control = _pair(states, control)
        noisy = [control[..., column] for column in range(3)]
        for error in self._errors(control):
            has_error = np.any(error, axis=0).tolist()  # a control without it draws nothing for it
            runs = zip(rngs, has_error, strict=True)
            draws = np.array([rng.standard_normal() if errs else 0.0 for rng, errs in runs])
            for column, part in enumerate(error):
                noisy[column] = noisy[column] + draws * part
        return self._moved(states, *noisy)

    def body_covariance(self, control: Array) -> Array:
        """Covariance of the noise of (forward, right, turn), (..., 3) -> (..., 3, 3)."""
        control = _checked(control)
        result = np.zeros((*control.shape, 3))
        for error in self._errors(control):
            root = np.stack(np.broadcast_arrays(*error), axis=-1)
            result += root[..., :, None] * root[..., None, :]
        return result

    def _errors(self, control: Array) -> list[Errors]:
        """The independent errors, one standard deviation of each as (forward, right, turn), (...) each."""
        alphas = tuple(map(float, self.alphas))
        if control.ndim == 1:
            return _errors_of_one(alphas, tuple(self.floors.tolist()), tuple(control.tolist()))
        return _errors_of(alphas, self.floors, control)


@lru_cache(maxsize=256)  # particle filters ask of the same control many times
def _errors_of_one(
    alphas: tuple[float, ...], floors: tuple[float, ...], control: tuple[float, ...]
) -> list[Errors]:
    """The errors of a single control, (3,)."""
    return _errors_of(alphas, np.array(floors), np.array(control))


def _errors_of(alphas: tuple[float, ...], floors: Array, control: Array) -> list[Errors]:
    """The errors of controls, (..., 3), that any of them has."""
    a1, a2, a3, a4 = alphas
    forward, right, turn = np.moveaxis(control, -1, 0)
    trans = np.hypot(forward, right)
    first = np.where(trans < ON_THE_SPOT, 0.0, np.arctan2(right, forward))
    second = _least_turn(wrap(turn - first))
    first = _least_turn(first)
    rot1 = np.sqrt(a1 * first**2 + a2 * trans**2)
    rot2 = np.sqrt(a1 * second**2 + a2 * trans**2)
    along = np.sqrt(a3 * trans**2 + a4 * (first**2 + second**2))
    length = np.where(trans > 0, trans, 1.0)
    ahead, aside = np.where(trans > 0, forward / length, 1.0), right / length
    zero = np.zeros_like(forward)
    errors = [
        (-right * rot1, forward * rot1, rot1),
        (ahead * along, aside * along, zero),
        (zero, zero, rot2),
    ]
    for place, floor in enumerate(floors):
        parts = [zero, zero, zero]
        parts[place] = zero + floor
        errors.append((parts[0], parts[1], parts[2]))
    return [error for error in errors if any(np.any(part) for part in error)]


def _least_turn(angle: Array) -> Array:
    """The turn up to going backwards, |angle| <= pi / 2, rad."""
    size = np.abs(angle)
    return np.minimum(size, np.pi - size)


def _to_map(heading: Array, forward: Array | float, right: Array | float) -> tuple[Array, Array]:
    """x1 and x2 parts of a displacement in the body frame."""
    sine, cosine = np.sin(heading), np.cos(heading)
    return forward * sine + right * cosine, forward * cosine - right * sine


def _checked(control: Array) -> Array:
    """A control as float64, (..., 3).

    Raises:
        ValueError: If it is of another shape, or not finite: a move that nobody knows moves to nowhere.
    """
    control = np.asarray(control, dtype=float)
    if control.shape[-1:] != (3,):
        raise ValueError(f"odometry's control is forward, right, turn: shape (..., 3), got {control.shape}")
    if not np.isfinite(control).all():
        first = control.reshape(-1, 3)[~np.isfinite(control).reshape(-1, 3).all(axis=1)][0]
        raise ValueError(f"odometry's control must be finite, got {first.tolist()}")
    return control


def _pair(states: Array, control: Array) -> tuple[Array, Array]:
    """States (..., n) and controls (..., 3) with their leading axes broadcast; a single control as it is."""
    states, control = np.asarray(states, dtype=float), _checked(control)
    if control.ndim == 1:
        return states, control
    shape = np.broadcast_shapes(states.shape[:-1], control.shape[:-1])
    return (
        np.broadcast_to(states, (*shape, states.shape[-1])),
        np.broadcast_to(control, (*shape, 3)),
    )
