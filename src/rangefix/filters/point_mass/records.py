"""Records that the point-mass filter hands to its compiled loops: readings, ranges, weights and results."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...arrays import Array, IntArray

NEGLIGIBLE_NATS = 40.0  # below the heaviest cell's log weight: lighter cells are left out
PROBE_CELLS = 16  # cells of each belief that are asked for the posterior's shape


class Readings(NamedTuple):
    """Mean readings of each run and beam, and how much each counts.

    Attributes:
        values: In metres, (M, B); inf = no return.
        precisions: Number of readings over their variance, 1/m^2, (M, B); a beam of precision 0 is not used.
    """

    values: Array
    precisions: Array


class CellMass(NamedTuple):
    """Log weights of cells before the readings, and their maxima.

    Attributes:
        logs: Of each cell, (1 or M, G); (1 or M, C, H) where ranges are kept by direction.
        tops: The greatest in each block of cells, (1 or M, ...).
    """

    logs: Array
    tops: Array


class CellTable(NamedTuple):
    """Expected ranges kept for each cell, and where the cells are: one row for each beam and component.

    Attributes:
        ranges: In metres, (B, G).
        low: The least in each block of cells, (B, K), m.
        high: The greatest, (B, K), m.
        centres: Of the cells, (n, G).
    """

    ranges: Array
    low: Array
    high: Array
    centres: Array


class SharedRanges(NamedTuple):
    """Expected ranges of places by directions, which serve all beams at all headings.

    At heading k beam j expects ranges[place, kind[j], (k + shift[j]) % period]. Ranges kept cell by cell are
    of this form too: with one heading, one direction, and as many kinds as beams.

    Attributes:
        kind: Which directions each beam needs, (B,).
        shift: How many directions on it starts, (B,).
        ranges: In metres, (C, R, at least W).
        period: The number of directions W before they start again.
        headings: The number of headings H.
    """

    kind: IntArray
    shift: IntArray
    ranges: Array
    period: int
    headings: int


class Moments(NamedTuple):
    """What sums over the cells of each run come to.

    Attributes:
        means: (M, n); of no meaning where no cell is possible.
        covariances: (M, n, n); likewise.
        log_sums: Log of the sums of weights, (M,); -inf where no cell is possible.
        probe_cells: Cells spread evenly over the belief, (M, K); -1 where no cell is possible.
    """

    means: Array
    covariances: Array
    log_sums: Array
    probe_cells: IntArray

    @classmethod
    def blank(cls, runs: int, size: int) -> Moments:
        """Room for the results of runs with a state of so many components."""
        probe_cells = np.full((runs, PROBE_CELLS), -1, np.int64)
        return cls(np.empty((runs, size)), np.empty((runs, size, size)), np.empty(runs), probe_cells)
