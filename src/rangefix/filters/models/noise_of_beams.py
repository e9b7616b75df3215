"""The noise of some beams of a rangefinder, and what all beams of a scan weigh together."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np

from ...arrays import LOG_TWO_PI, Array, BoolArray, IntArray
from ..problem import Noise
from .noise import Gaussian, RangeProportional, StudentT

MAX_BEAMS_UNROLLED = 8  # beams
BEAMS_PER_LOG = 8  # whose factors are multiplied: no overflow for a micrometre's spread at 1000 km
LEAST_STATES = 512  # that a scan is asked about; for fewer, going beam by beam takes longer than it saves


def noise_of_beams(noise: Noise, kept: int | IntArray, total: int) -> Any:
    """The noise of one beam, or of several, of a rangefinder with so many; itself if beams are alike.

    Parameters with a number for each beam keep those of these beams; all others stay, such as a tuple of
    records that happens to be as long. Of a noise that is no dataclass the parameters are not known: it is
    taken to be the same for all beams.

    Args:
        noise: Of all beams.
        kept: Their numbers, from 0: one, or (K,).
        total: How many beams the noise is for.
    """
    if not is_dataclass(noise) or isinstance(noise, type):
        return noise
    own: dict[str, Any] = {}
    for parameter in fields(noise):
        if not parameter.init:
            continue
        value = getattr(noise, parameter.name)
        if is_dataclass(value):
            inner = noise_of_beams(value, kept, total)
            if inner is not value:
                own[parameter.name] = inner
        elif (total > 1 or np.ndim(kept) == 0) and (numbers := _number_for_each(value, total)) is not None:
            own[parameter.name] = numbers[kept]
    return replace(noise, **own) if own else noise


def _number_for_each(value: Any, total: int) -> np.ndarray | None:
    """A parameter with a number for each beam, (total,); None where it is anything else, and as long."""
    try:
        values = np.asarray(value)
    except ValueError:  # rows that differ in length
        return None
    return values if values.shape == (total,) and values.dtype.kind in "biuf" else None


def log_density_of_scan(noise: Noise, measurement: Array, expected: Array) -> Array | None:
    """The sum over the beams of `noise.log_density`, quickly; None where there is no short form of it.

    Densities of several beams are multiplied, and one logarithm is taken, where the noise is Student's t or
    its spread grows with the range.

    Args:
        noise: The noise, whose errors are independent from beam to beam.
        measurement: Readings (..., B), m; NaN = not measured, which adds nothing.
        expected: Ranges, (..., B), m. The leading axes broadcast.

    Returns:
        Shape (...), nats; not finite where a reading or a range is infinite.
    """
    shared = expected.ndim > 1 and (measurement.ndim == 1 or measurement.shape[-2] == 1)
    states = expected.shape[-2] if shared else 1  # of a scan by itself: others beside it change no bit
    if type(noise) is not Gaussian and states < LEAST_STATES:
        return None
    measured = ~np.isnan(measurement)
    reading = np.where(measured, measurement, 0.0)
    with np.errstate(invalid="ignore", over="ignore"):
        if type(noise) is Gaussian:
            return _gaussian(noise.stds, measured, reading, expected)
        if type(noise) is StudentT:
            return _student(noise, measured, reading, expected)
        if type(noise) is RangeProportional:
            return _range_proportional(noise, measured, reading, expected)
    return None


def _gaussian(stds: Array, measured: BoolArray, reading: Array, expected: Array) -> Array:
    weight = measured / stds
    level = np.where(measured, 0.5 * LOG_TWO_PI + np.log(stds), 0.0).sum(-1)
    if reading.shape[-1] > MAX_BEAMS_UNROLLED:
        deviates = (expected - reading) * weight
        return np.asarray(-0.5 * np.einsum("...b,...b->...", deviates, deviates) - level)
    rows: Iterable[Array]
    if reading.ndim == 1 and expected.ndim == 2 and expected.flags.f_contiguous:  # long rows
        rows = (expected.T - reading[:, None]) * weight[:, None]
    else:  # numpy is slow on short rows: beam by beam
        beams = range(reading.shape[-1])
        rows = ((expected[..., beam] - reading[..., beam]) * weight[..., beam] for beam in beams)
    squares = np.zeros(np.broadcast_shapes(reading.shape, expected.shape)[:-1])
    for deviate in rows:
        squares += deviate * deviate
    squares *= -0.5
    squares -= level
    return squares


def _student(noise: StudentT, measured: BoolArray, reading: Array, expected: Array) -> Array:
    weight = measured / (noise.scales * np.sqrt(noise.dof))
    level = np.where(measured, noise.level, 0.0).sum(-1)
    logs = np.zeros(np.broadcast_shapes(reading.shape, expected.shape)[:-1])
    for first in range(0, reading.shape[-1], BEAMS_PER_LOG):
        product = np.ones_like(logs)
        for beam in range(first, min(first + BEAMS_PER_LOG, reading.shape[-1])):
            factor = np.asarray(expected[..., beam] - reading[..., beam])
            factor *= weight[..., beam]
            factor *= factor
            factor += 1.0
            product *= factor
        logs += np.log(product, out=product)
    logs *= -0.5 * (noise.dof + 1)
    return np.asarray(logs - level)


def _range_proportional(
    noise: RangeProportional, measured: BoolArray, reading: Array, expected: Array
) -> Array:
    at_zero, growth = (np.broadcast_to(line, reading.shape[-1:]) for line in noise.line)
    total = -0.5 * LOG_TWO_PI * np.asarray(measured.sum(-1))
    total = total + np.zeros(np.broadcast_shapes(reading.shape, expected.shape)[:-1])
    for first in range(0, reading.shape[-1], BEAMS_PER_LOG):
        product = np.ones_like(total)
        for beam in range(first, min(first + BEAMS_PER_LOG, reading.shape[-1])):
            here, std = measured[..., beam], at_zero[beam] + growth[beam] * np.abs(expected[..., beam])
            off = np.asarray(expected[..., beam] - reading[..., beam]) / std
            off *= off
            total -= 0.5 * off if here.all() else 0.5 * np.where(here, off, 0.0)
            product *= std if here.all() else np.where(here, std, 1.0)
        total -= np.log(product, out=product)
    return total
