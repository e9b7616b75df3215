"""The boundary for measurements and controls: what every built-in estimator asks before it looks at them.

What each reading means, the same to all, is the table of docs/models.md, "What a reading means".
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.random import Generator

from ..arrays import Array, BoolArray
from .problem import Sensor


def count_runs(rngs: Sequence[Generator]) -> int:
    """The number of runs M that an estimator is to begin.

    Raises:
        ValueError: If there is none, or one generator is given instead of a list, or numbers.
    """
    got = ""
    if isinstance(rngs, Generator | int):
        got = "a single generator" if isinstance(rngs, Generator) else "a number"
    elif not len(rngs):
        got = "none"
    elif isinstance(rngs, list | tuple) and isinstance(rngs[0], int | np.integer):
        got = "numbers: make them by np.random.default_rng(seed)"
    if got:
        raise ValueError(f"init takes a list of generators, one for each run, got {got}")
    return len(rngs)


def check_measurement(sensor: Sensor, measurement: object, runs: int) -> Array:
    """The readings of all runs as an estimator is to take them.

    Args:
        sensor: The rangefinder.
        measurement: Readings of each run, (M, B), m.
        runs: The number of runs M.

    Returns:
        The same, float64, with NaN wherever nothing was measured: in the blind sector, and for -inf (too
        close) if the sensor has no minimum range. What was passed in is returned itself if nothing changes,
        and never written to.

    Raises:
        ValueError: If it is not of shape (M, B) or does not hold real numbers.
    """
    return _as_measured(sensor, readings_of_shape(measurement, (runs, len(sensor.bearings)), "(runs, beams)"))


def check_reading(sensor: Sensor, reading: object) -> Array:
    """The same for an estimator of single runs: readings (B,), m.

    Raises:
        ValueError: If they are not of shape (B,) or not real numbers.
    """
    return _as_measured(sensor, readings_of_shape(reading, (len(sensor.bearings),), "(beams,)"))


def check_control(control: object, runs: int) -> Array:
    """A control as an estimator of M runs is to take it, float64: (k,) shared by the runs, or (M, k).

    None is a control of no numbers, for motions that ignore it.

    Raises:
        ValueError: If it is of another shape, or does not hold real numbers.
    """
    if type(control) is np.ndarray and control.dtype == np.float64 and control.ndim == 1:
        return control
    wanted = f"a control must be real numbers of shape (k,), shared by the runs, or ({runs}, k), got"
    try:
        array = np.zeros(0) if control is None else np.asanyarray(control)
    except ValueError:
        raise ValueError(f"{wanted} a {type(control).__name__} of rows of different lengths") from None
    if isinstance(array, np.ma.MaskedArray):
        raise ValueError(f"{wanted} a masked array")
    if array.ndim not in (1, 2) or (array.ndim == 2 and len(array) not in (1, runs)):
        raise ValueError(f"{wanted} shape {array.shape}")
    if array.dtype.kind not in "biuf":
        raise ValueError(f"{wanted} {array.dtype.name}")
    return np.asarray(array, dtype=np.float64)


def controls_of_runs(control: object, runs: int) -> Array:
    """The same for each run, (M, k)."""
    control = check_control(control, runs)
    return np.broadcast_to(control, (runs, control.shape[-1]))


def impossible_runs(sensor: Sensor, measurement: Array) -> BoolArray:
    """Runs with a finite reading that no range explains, (M, B) -> (M,): beyond a limit, or of a law's.

    For filters that do not ask for densities, which are -inf there for those that do.
    """
    if sensor.gaussian_stds is not None:
        return np.zeros(len(measurement), np.bool_)
    finite = np.isfinite(measurement)
    values = measurement[finite]
    none = np.zeros(len(measurement), np.bool_)
    if not values.size:
        return none
    ends = np.repeat([[values.min()], [values.max()]], measurement.shape[1], axis=1)
    if not np.isneginf(
        sensor.beam_log_density(ends, np.maximum(ends, 0.0))
    ).any():  # possible readings have no gaps
        return none
    fit = np.where(finite, np.maximum(measurement, 0.0), 0.0)
    lost = finite & np.isneginf(sensor.beam_log_density(measurement, fit))
    return np.asarray(lost.any(axis=1))


def readings_of_shape(values: object, shape: tuple[int | None, ...], axes: str) -> Array:
    """Values as float64 of one shape.

    Args:
        values: What an estimator was given.
        shape: What they must have; None = any length.
        axes: What the axes are, for the message.

    Raises:
        ValueError: If the shape is another, or they are no real numbers; masked arrays are none.
    """
    if type(values) is np.ndarray and values.dtype == np.float64 and values.shape == shape:
        return values
    lengths = ", ".join("any" if length is None else str(length) for length in shape)
    wanted = f"a measurement must be real numbers of shape ({lengths}) {axes}, got"
    try:
        array = np.asanyarray(values)
    except ValueError:
        raise ValueError(f"{wanted} a {type(values).__name__} of rows of different lengths") from None
    if isinstance(array, np.ma.MaskedArray):
        raise ValueError(f"{wanted} a masked array: write NaN where nothing was measured")
    fits = [length in (None, found) for length, found in zip(shape, array.shape, strict=False)]
    if array.ndim != len(shape) or not all(fits):
        raise ValueError(f"{wanted} shape {array.shape}")
    if array.dtype.kind not in "iuf":
        raise ValueError(f"{wanted} {array.dtype.name}")
    return np.asarray(array, dtype=np.float64)


def _as_measured(sensor: Sensor, values: Array) -> Array:
    """Readings with NaN where nothing was measured."""
    blind = sensor.blind
    if np.count_nonzero(blind):
        values = np.where(blind, np.nan, values)
    if sensor.min_range > 0:
        return values
    close = values == -np.inf
    return np.where(close, np.nan, values) if np.count_nonzero(close) else values
