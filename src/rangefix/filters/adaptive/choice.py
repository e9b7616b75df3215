"""Which integration a problem gets: exact pieces for positions at a known heading, else adaptive lattices."""

from __future__ import annotations

from ...arrays import whole_number
from ..exact import ExactPositionFilter
from ..problem import Problem
from .filter import AdaptivePointMassFilter
from .options import LEAST_CELLS, LEAST_RAYS, check_options
from .range_table import TABLE_RAYS

MOST_PIECES = 100_000  # of the map: more take longer to find than lattices take for many fixes


def adaptive_point_mass(
    problem: Problem,
    accuracy: float = 0.02,
    drop: float = 1e-9,
    table_rays: int = TABLE_RAYS,
    most_cells: int = 1_000_000,
) -> ExactPositionFilter | AdaptivePointMassFilter:
    """The adaptive point-mass filter of a problem.

    For a position at a known heading, at rest, that is `ExactPositionFilter`, which no mode escapes; for any
    other problem, and for maps that are not made of segments or make too many pieces, it is
    `AdaptivePointMassFilter`, whose options these are.

    Args:
        problem: The problem.
        accuracy: Error allowed: of the mean in standard deviations, of the covariance in variances.
        drop: Density, relative to the greatest, below which no mode is looked at.
        table_rays: About how many rays to spend on the table of ranges.
        most_cells: The most cells of one mode.

    Raises:
        ValueError: If an option is out of bounds, or the problem is of a kind that neither takes.
    """
    check_options(accuracy, drop)
    table_rays = whole_number("table_rays", table_rays, LEAST_RAYS)
    most_cells = whole_number("most_cells", most_cells, LEAST_CELLS)
    try:
        return ExactPositionFilter(problem, most_pieces=MOST_PIECES)
    except ValueError:  # it says what it is not for: then lattices are
        return AdaptivePointMassFilter(problem, accuracy, drop, table_rays, most_cells)
