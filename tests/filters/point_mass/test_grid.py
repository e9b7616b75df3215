"""Where the neighbours of a grid's cells are: as their centres say."""

from __future__ import annotations

import numpy as np
import pytest

from rangefix.filters import Uniform, pose_space, position_space
from rangefix.filters.point_mass.grid import Grid, _tiled, build_grid
from rangefix.maps import FloorPlan

CORNERS = [[0, 0], [4, 0], [4, 3], [2, 3], [2, 6], [0, 6]]  # an L: cells of its box are missing


def l_shaped(heading: bool) -> Grid:
    """Cells of 0.3 m, and of 30 degrees where headings are not known."""
    room, space = FloorPlan(CORNERS), pose_space() if heading else position_space()
    cell = [0.3, 0.3, np.deg2rad(30.0)] if heading else 0.3
    return build_grid(Uniform(room, space), space, cell, most=100_000)


@pytest.mark.parametrize("heading", [False, True])
def test_cells_inside_the_box_have_their_neighbours_so_many_places_on(heading: bool) -> None:
    grid = l_shaped(heading)
    box, inside = grid.box, np.flatnonzero(grid.box.inside)
    assert 0 < len(inside) < len(grid.centres)
    found = 0
    for offset, jump in zip(box.offsets, box.jumps, strict=True):
        cells = box.cell_at[box.place_of[inside] + jump]
        there = cells >= 0
        off = grid.centres[cells[there]] - grid.centres[inside[there]]
        np.testing.assert_allclose(off, np.broadcast_to(offset * grid.step, off.shape), atol=1e-12)
        found += np.count_nonzero(there)
        missing = grid.centres[inside[~there]] + offset * grid.step  # in the walls beside the L
        assert ((missing[:, 0] > 2.0) & (missing[:, 1] > 3.0)).all()
    assert found > 0.9 * len(inside) * len(box.offsets)


@pytest.mark.parametrize("heading", [False, True])
def test_cells_at_the_borders_of_the_box_are_not_inside(heading: bool) -> None:
    grid = l_shaped(heading)
    numbers = np.stack(np.unravel_index(grid.index, grid.shape), axis=-1)
    borders = ((numbers == 0) | (numbers == np.array(grid.shape) - 1)).any(axis=1)
    np.testing.assert_array_equal(grid.box.inside, ~borders)


@pytest.mark.parametrize("shape", [(13, 16), (1, 9), (8,), (3, 5, 9), (2, 1, 3, 4)])
@pytest.mark.parametrize("tile", [1, 4, 8])
def test_cells_of_a_tile_lie_together(shape: tuple[int, ...], tile: int) -> None:
    """Sorted by tile, and within tiles by place, the first axis first."""
    places = np.indices(shape).reshape(len(shape), -1)
    order = np.lexsort([*reversed(places % tile), *reversed(places // tile)])
    np.testing.assert_array_equal(_tiled(shape, tile), order)
