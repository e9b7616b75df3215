"""The point-mass filter by its options: cells of a given size, or cells that follow the readings.

Cells that follow the readings cover the prior, and are halved where a posterior is sharp or cut. All places
and all headings are too much to cover: there the modes are looked for first, and cells laid in the axes of
each (docs/decisions/0042-point-mass-at-any-heading.md).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from ...arrays import whole_number
from ..models.correlated import refuse_shared_errors
from ..models.motion import Stationary
from ..option_units import option_units
from ..problem import Problem
from ..refined_cells import RefinedPointMassFilter
from .filter import MEMORY_GB, PointMassFilter

if TYPE_CHECKING:
    from ..adaptive import AdaptivePointMassFilter

ACCURACY = 0.02  # of mean and covariance, in deviations
REFINED_CELLS, MODE_CELLS = 200_000, 1_000_000
GRID_CELLS = 20_000_000


@option_units(cell="m", heading_cell="rad")
def point_mass(
    problem: Problem,
    cell: ArrayLike | None = None,
    heading_cell: float | None = None,
    cell_correction: bool | None = None,
    accuracy: float | None = None,
    most_cells: int | None = None,
    memory_gb: float | None = None,
) -> PointMassFilter | RefinedPointMassFilter | AdaptivePointMassFilter:
    """The point-mass filter for an object that stays where it is: the exact posterior, up to its cells.

    Args:
        problem: The problem; its motion must be `Stationary`.
        cell: Largest size of a cell, one number or one for each component; the cells follow the readings
            unless given. In m, and in rad for a heading; without it the cells are as small as `accuracy` asks
            for; at an unknown heading they are those of `adaptive-point-mass`.
        heading_cell: With `cell`: the largest size in an unknown heading, needed there where `cell` is one
            number; that of `cell` unless given. In rad.
        cell_correction: With `cell`: false for the sums as the paper prints them; true, which adds what cells
            wider than the posterior miss (docs/decisions/0002-cell-width.md), unless given.
        accuracy: Without `cell`: what mean and covariance may be off by, in posterior deviations; 0.02 unless
            given.
        most_cells: The most cells; unless given, without `cell` 200 000 for one run, or at an unknown heading
            a million for one mode, and with it 20 million for the grid.
        memory_gb: With `cell`: the most that the expected ranges may take, GB, with those of two shifted
            grids that tell the error; 0.6 unless given.

    Raises:
        ValueError: If an option goes with the other kind of cells, or does not fit.
    """
    if cell is None:
        with_cell = {"heading_cell": heading_cell, "cell_correction": cell_correction, "memory_gb": memory_gb}
        if given := [name for name, value in with_cell.items() if value is not None]:
            raise ValueError(f"{given[0]} goes with cell: without it the cells follow the readings")
        accuracy = ACCURACY if accuracy is None else accuracy
        if looks_for_modes(problem):
            from ..adaptive import AdaptivePointMassFilter  # with all that it imports: a tenth of a second
            from ..adaptive.options import ACCURACIES, LEAST_CELLS

            most = MODE_CELLS if most_cells is None else most_cells
            refuse_shared_errors(problem.sensor, "the point-mass filter without cell")
            if not ACCURACIES[0] <= accuracy <= ACCURACIES[1]:
                raise ValueError(
                    f"at an unknown heading accuracy must be in {list(ACCURACIES)}, got {accuracy}"
                )
            most = whole_number("at an unknown heading most_cells", most, LEAST_CELLS)
            return AdaptivePointMassFilter(problem, accuracy, most_cells=most)
        return RefinedPointMassFilter(problem, accuracy, REFINED_CELLS if most_cells is None else most_cells)
    if accuracy is not None:
        raise ValueError("accuracy goes without cell: cells of a given size are as accurate as they are")
    return PointMassFilter(
        problem,
        cell,
        heading_cell,
        GRID_CELLS if most_cells is None else most_cells,
        MEMORY_GB if memory_gb is None else memory_gb,
        True if cell_correction is None else cell_correction,
    )


def looks_for_modes(problem: Problem) -> bool:
    """Whether cells that follow the readings are those of `adaptive-point-mass`.

    At an unknown heading of an object that stays where it is, unless that filter does not know the sensor.
    """
    if problem.space.names != ("x1", "x2", "heading") or not isinstance(problem.motion, Stationary):
        return False
    from ..adaptive.options import unknown_to_lattices

    return not unknown_to_lattices(problem)
