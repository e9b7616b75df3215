"""Where in a wide prior a measurement can have been taken, by the table of ranges.

The least and the greatest range of a cell bound the likelihood in it, and a cell is passed over as soon as
the beams looked at so far rule it out: branch and bound, with one beam more at each depth.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array, IntArray
from ...compiled import in_threads, njit
from ..problem import Sensor
from .range_table import NO_WALL, QUANTUM_M, SearchTable, beam_order
from .target import CAP


def penalties(table: SearchTable, sensor: Sensor, measurement: Array) -> tuple[NDArray[np.float32], IntArray]:
    """How many nats each expected range falls short of the best one, for each beam of a measurement.

    Returns:
        Penalties (B, Q), capped, for ranges 0, 1, ... quanta and, last, for no wall; and the best range's
        place for each beam, (B,). A beam not measured has penalty 0 throughout.
    """
    finite = table.high[table.high != NO_WALL]
    count = int(finite.max(initial=1)) + 2
    ranges = np.append(QUANTUM_M * np.arange(count), np.inf)
    each = np.broadcast_to(ranges[:, None], (count + 1, len(measurement)))
    logs = np.array(sensor.beam_log_density(measurement, each).T, order="C")
    logs[(logs == -np.inf).all(axis=1)] = 0.0
    best = logs.argmax(axis=1)
    shortfall = logs[np.arange(len(logs)), best][:, None] - logs
    return np.minimum(shortfall, CAP).astype(np.float32), best


def shortfall_bounds(
    table: SearchTable, sensor: Sensor, measurement: Array, margin: float
) -> NDArray[np.float32]:
    """A bound on how many nats the coarse cells fall short of a perfect fit.

    Args:
        table: The table.
        sensor: The rangefinder.
        measurement: Readings (B,).
        margin: Nats that a cell may fall short beyond what is to be expected of the true state.

    Returns:
        For each cell at each heading, (C, H); inf where it falls short by more than that.
    """
    penalty, readings = penalties(table, sensor, measurement)
    measured = np.flatnonzero(~np.isnan(measurement))
    order = beam_order(measured)
    limits = table.limit(np.arange(1, len(order) + 1), margin)
    bounds = np.full((len(table.centres), len(table.headings)), np.inf, dtype=np.float32)
    work = bounds.size * len(order)
    columns = np.ascontiguousarray(table.columns.T, dtype=np.uint32)
    in_threads(_bound, len(bounds), work, table, columns, order, readings, penalty, limits, bounds)
    return bounds


@njit(cache=True, nogil=True, error_model="numpy")
def _bound(
    first: int, end: int, table: SearchTable, columns: NDArray[np.uint32], order: IntArray,
    readings: IntArray, penalty: NDArray[np.float32], limits: Array, bounds: NDArray[np.float32],
) -> None:  # fmt: skip
    """Sum the least penalties of some cells at each heading, as long as they stay within the limits.

    The s(C) of point 1 of docs/theory.md, "Adaptive cells", beam by beam at all headings that are left: what
    the table holds of one beam is close together. `columns` are the table's, beams first.
    """
    headings, last = columns.shape[1], np.uint64(penalty.shape[1] - 1)
    left, totals = np.empty(headings, dtype=np.uint16), np.empty(headings)
    peaked = np.empty(order.size, dtype=np.bool_)
    for k in range(order.size):
        peaked[k] = _falls_off(penalty[order[k]], readings[order[k]])
    free = 0  # so many beams rule nothing out, whatever they say
    while free < order.size and peaked[free] and CAP * (free + 1) <= limits[free]:
        free += 1
    for cell in range(first, end):
        low, high, count = table.low[cell], table.high[cell], headings
        for heading in range(headings):
            left[heading], totals[heading] = heading, 0.0
        for k in range(free):
            reading, lost, column_of = np.uint64(readings[order[k]]), penalty[order[k]], columns[order[k]]
            for heading in range(headings):
                column = column_of[heading]
                least, most = min(np.uint64(low[column]), last), min(np.uint64(high[column]), last)
                totals[heading] += lost[min(max(reading, least), most)]
        for k in range(free, order.size):
            reading, lost, column_of = np.uint64(readings[order[k]]), penalty[order[k]], columns[order[k]]
            kept = np.uint64(0)
            for i in range(count):
                column = column_of[left[i]]
                least, most = min(np.uint64(low[column]), last), min(np.uint64(high[column]), last)
                best = lost[min(max(reading, least), most)]
                if not peaked[k]:
                    best = min(best, min(lost[least], lost[most]))
                left[kept], totals[kept] = left[i], totals[i] + best
                kept += np.uint64(1) if totals[kept] <= limits[k] else np.uint64(0)
            count = np.int64(kept)
            if count == 0:
                break
        for i in range(count):
            bounds[cell, left[i]] = totals[i]


@njit(cache=True, nogil=True, error_model="numpy", inner=True)
def _falls_off(lost: NDArray[np.float32], reading: int) -> bool:
    """Whether a beam's penalties, (Q,), only grow away from its reading's place."""
    for place in range(1, len(lost)):
        if (lost[place] < lost[place - 1]) if place > reading else (lost[place] > lost[place - 1]):
            return False
    return True
