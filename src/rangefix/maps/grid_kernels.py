"""Compiled loops over a grid of cells: rays that end on the cells' edges, and the surface below each cell."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, BoolArray, IntArray
from ..compiled import njit


@njit(cache=True, nogil=True)
def cast_into_cells(
    walls: BoolArray,
    leaps: NDArray[np.uint8],
    positions: Array,
    s_turns: Array,
    c_turns: Array,
    s_beams: Array,
    c_beams: Array,
    ranges: Array,
    axes: NDArray[np.int8],
) -> None:
    """Distances from places to where beams leave the kind of cell that they start in: open, or wall.

    A beam goes from edge to edge of the cells (Amanatides and Woo, 1987), but over all cells at once that are
    nearer than the next change, so that most beams end after few steps. Distances are those of an edge's line
    from the start, and no sum: their error is one rounding.

    Args:
        walls: Which cells are walls, (n1, n2), the outermost ones open; cell (i, j) ends at i + 1 and j + 1.
        leaps: How many cells away the next cell of the other kind is, by moves of a king, (n1, n2).
        positions: Starts in cells, (N, 2).
        s_turns, c_turns: Sines and cosines of headings, (N,) or (1,).
        s_beams, c_beams: Of bearings, (B,).
        ranges: Gets the distances in cells, (N, B); inf where a beam leaves the grid.
        axes: Gets -1, -2 for an edge across the first or second axis met in its positive direction, 1, 2 in
            its negative one, and 0 for none, (N, B) or (0, 0) to do without.
    """
    n1, n2 = walls.shape
    for place in range(len(positions)):
        x0, y0 = positions[place, 0], positions[place, 1]
        turn = place if len(s_turns) > 1 else 0
        for beam in range(len(s_beams)):
            dx = s_turns[turn] * c_beams[beam] + c_turns[turn] * s_beams[beam]
            dy = c_turns[turn] * c_beams[beam] - s_turns[turn] * s_beams[beam]
            x_step, y_step = math.inf, math.inf  # distance for one cell along each axis
            if abs(dx) > 1e-15:
                x_step = 1.0 / dx
            if abs(dy) > 1e-15:
                y_step = 1.0 / dy
            ranges[place, beam] = math.inf
            axis = 0
            t = 0.0
            i, j = math.floor(x0), math.floor(y0)
            if x0 < 0.0 or x0 >= n1 or y0 < 0.0 or y0 >= n2:  # where the beam enters the grid
                t, leaves = 0.0, math.inf
                for start, step, size in ((x0, x_step, n1), (y0, y_step, n2)):
                    if math.isinf(step):
                        if start < 0.0 or start >= size:
                            leaves = -1.0
                    else:
                        one, two = -start * step, (size - start) * step
                        t, leaves = max(t, min(one, two)), min(leaves, max(one, two))
                if t >= leaves:
                    if len(axes):
                        axes[place, beam] = 0
                    continue
                i = min(max(math.floor(x0 + t * dx), 0), n1 - 1) if dx != 0.0 else i
                j = min(max(math.floor(y0 + t * dy), 0), n2 - 1) if dy != 0.0 else j
            inside = walls[i, j]
            while True:
                leap = int(np.int64(leaps[i, j]))  # with a sign
                x_end, y_end = math.inf, math.inf
                if x_step > 0.0 and not math.isinf(x_step):
                    x_end = (i + leap - x0) * x_step
                elif x_step < 0.0:
                    x_end = (i - leap + 1 - x0) * x_step
                if y_step > 0.0 and not math.isinf(y_step):
                    y_end = (j + leap - y0) * y_step
                elif y_step < 0.0:
                    y_end = (j - leap + 1 - y0) * y_step
                if x_end < y_end:
                    t = x_end
                    low, high = j - leap + 1, j + leap - 1
                    i += leap if dx > 0.0 else -leap
                    j = min(max(math.floor(y0 + t * dy), low), high)
                    axis = -1 if dx > 0.0 else 1
                else:
                    t = y_end
                    low, high = i - leap + 1, i + leap - 1
                    j += leap if dy > 0.0 else -leap
                    i = min(max(math.floor(x0 + t * dx), low), high)
                    axis = -2 if dy > 0.0 else 2
                if i < 0 or i >= n1 or j < 0 or j >= n2:
                    axis = 0
                    break
                if walls[i, j] != inside:
                    ranges[place, beam] = max(t, 0.0)
                    break
            if len(axes):
                axes[place, beam] = axis


@njit(cache=True, nogil=True)
def surface_below(
    vertices: Array, triangles: IntArray, height: float, lower: Array, step: float, found: Array
) -> None:
    """The highest point of triangles straight below the centres of cells, of those not above a height.

    Args:
        vertices: x1, x2, z, (V, 3).
        triangles: Indices of vertices, (T, 3).
        height: From which to look down.
        lower: Corner of the cells, (2,).
        step: Size of a cell.
        found: Gets the heights, (n1, n2); where nothing lies below it is left as it is.
    """
    n1, n2 = found.shape
    for triangle in range(len(triangles)):
        a, b, c = triangles[triangle, 0], triangles[triangle, 1], triangles[triangle, 2]
        if min(vertices[a, 2], vertices[b, 2], vertices[c, 2]) > height:
            continue
        xa, ya = (vertices[a, 0] - lower[0]) / step - 0.5, (vertices[a, 1] - lower[1]) / step - 0.5
        xb, yb = (vertices[b, 0] - lower[0]) / step - 0.5, (vertices[b, 1] - lower[1]) / step - 0.5
        xc, yc = (vertices[c, 0] - lower[0]) / step - 0.5, (vertices[c, 1] - lower[1]) / step - 0.5
        area = (xb - xa) * (yc - ya) - (xc - xa) * (yb - ya)
        if abs(area) < 1e-12:  # upright
            continue
        first_i, last_i = math.ceil(min(xa, xb, xc)), math.floor(max(xa, xb, xc))
        first_j, last_j = math.ceil(min(ya, yb, yc)), math.floor(max(ya, yb, yc))
        for i in range(max(first_i, 0), min(last_i, n1 - 1) + 1):
            for j in range(max(first_j, 0), min(last_j, n2 - 1) + 1):
                at_b = ((i - xa) * (yc - ya) - (xc - xa) * (j - ya)) / area
                at_c = ((xb - xa) * (j - ya) - (i - xa) * (yb - ya)) / area
                if at_b >= -1e-9 and at_c >= -1e-9 and at_b + at_c <= 1.0 + 1e-9:
                    z = vertices[a, 2] + at_b * (vertices[b, 2] - vertices[a, 2])
                    z += at_c * (vertices[c, 2] - vertices[a, 2])
                    if z <= height and z > found[i, j]:
                        found[i, j] = z
