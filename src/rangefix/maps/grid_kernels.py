"""Compiled loops over a grid of cells: rays that end on cells' edges, surfaces below, and what is free."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..arrays import Array, BoolArray, IntArray
from ..compiled import njit
from .base import EDGE_ON, ON_IT, TOUCHING

ALONG = 1e-15  # a beam whose direction has less of an axis runs across it
FAR = 1e300  # cells
SHORT = 2  # cells; as many steps cost less than a leap


@njit(cache=True, nogil=True, error_model="numpy")
def cast_into_cells(
    leaps: NDArray[np.int16],
    positions: Array,
    s_turns: Array,
    c_turns: Array,
    s_beams: Array,
    c_beams: Array,
    resolution: float,
    ranges: Array,
    axes: NDArray[np.int8],
) -> None:
    """Distances from places to where beams leave the kind of cell that they start in: open, or wall.

    A beam goes from edge to edge of the cells (Amanatides and Woo, 1987), but over all cells at once that are
    nearer than the next change, where those are many. Distances are those of an edge's line from the start,
    and no sum: their error is one rounding.

    Args:
        leaps: How many cells away the next cell of the other kind is, by moves of a king, (n1, n2); negative
            in walls. The outermost cells are open; cell (i, j) ends at i + 1 and j + 1.
        positions: Starts in cells, (N, 2).
        s_turns, c_turns: Sines and cosines of headings, (N,) or (1,).
        s_beams, c_beams: Of bearings, (B,).
        resolution: Size of a cell, m.
        ranges: Gets the distances, m, (N, B); inf where a beam leaves the grid.
        axes: Gets -1, -2 for an edge across the first or second axis met in its positive direction, 1, 2 in
            its negative one, and 0 for none, (N, B) or (0, 0) to do without.
    """
    n1, n2 = leaps.shape
    for place in range(len(positions)):
        x0, y0 = positions[place, 0], positions[place, 1]
        turn = place if len(s_turns) > 1 else 0
        outside = x0 < 0.0 or x0 >= n1 or y0 < 0.0 or y0 >= n2
        for beam in range(len(s_beams)):
            dx = s_turns[turn] * c_beams[beam] + c_turns[turn] * s_beams[beam]
            dy = c_turns[turn] * c_beams[beam] - s_turns[turn] * s_beams[beam]
            right, up = dx > -ALONG, dy > -ALONG
            i_step, j_step = (1 if right else -1), (1 if up else -1)
            x_step = 1.0 / dx if abs(dx) > ALONG else FAR  # distance for one cell along each axis
            y_step = 1.0 / dy if abs(dy) > ALONG else FAR
            x_off, y_off = (1.0 if right else 0.0) - x0, (1.0 if up else 0.0) - y0
            t, axis, found = 0.0, 0, math.inf
            if outside:
                t = _entry(x0, y0, x_step, y_step, n1, n2)
                i = min(max(int(x0 + t * dx), 0), n1 - 1)
                j = min(max(int(y0 + t * dy), 0), n2 - 1)
            else:
                i, j = int(x0), int(y0)
            kind = leaps[i, j]
            in_wall = kind < 0
            x_next, y_next = (i + x_off) * x_step, (j + y_off) * y_step  # where the cell's edges are
            while t < FAR:
                if kind > SHORT or kind < -SHORT:
                    more = abs(int(kind)) - 1
                    x_end, y_end = x_next + more * abs(x_step), y_next + more * abs(y_step)
                    if x_end < y_end:
                        t, axis = x_end, 1
                        j = min(max(int(y0 + t * dy), j - more), j + more)
                        i += i_step * (more + 1)
                    else:
                        t, axis = y_end, 2
                        i = min(max(int(x0 + t * dx), i - more), i + more)
                        j += j_step * (more + 1)
                    if i < 0 or i >= n1 or j < 0 or j >= n2:
                        break
                    x_next, y_next = (i + x_off) * x_step, (j + y_off) * y_step
                elif x_next < y_next:
                    t, axis = x_next, 1
                    i += i_step
                    if i < 0 or i >= n1:
                        break
                    x_next = (i + x_off) * x_step
                else:
                    t, axis = y_next, 2
                    j += j_step
                    if j < 0 or j >= n2:
                        break
                    y_next = (j + y_off) * y_step
                kind = leaps[i, j]
                if (kind < 0) != in_wall:
                    found = max(t, 0.0) * resolution
                    break
            ranges[place, beam] = found
            if len(axes):
                sign = i_step if axis == 1 else j_step
                axes[place, beam] = 0 if math.isinf(found) else -sign * axis


@njit(cache=True, nogil=True, inner=True)
def _entry(x0: float, y0: float, x_step: float, y_step: float, n1: int, n2: int) -> float:
    """How far from outside a beam enters a grid; FAR if it never does."""
    enters, leaves = 0.0, FAR
    for start, step, size in ((x0, x_step, n1), (y0, y_step, n2)):
        if step == FAR:
            if start < 0.0 or start >= size:
                return FAR
        else:
            one, two = -start * step, (size - start) * step
            enters, leaves = max(enters, min(one, two)), min(leaves, max(one, two))
    return enters if enters < leaves else FAR


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


@njit(cache=True, nogil=True, error_model="numpy")
def free_in_cells(
    cells: NDArray[np.uint8], origin: Array, resolution: float, steps: IntArray, starts: IntArray,
    standing: IntArray, walls: Array, centre: Array, points: Array, free: BoolArray,
) -> None:  # fmt: skip
    """Whether points lie in a free cell, or in one that is cut by walls and see the centre of one beside it.

    Args:
        cells: 0 not free, 1 free, 2 cut by a wall, (n1, n2).
        origin: Lower corner of the cells from the centre, m, (2,).
        resolution: Size of a cell, m.
        steps: To the cells beside one, (8, 2).
        starts: Where the walls of each cell begin in `standing`, (n1 n2 + 1,).
        standing: Which walls run through the cells.
        walls: Ends, normal and offset along it from the centre: x1a, x2a, x1b, x2b, v1, v2, v.a, m, (S, 7).
        centre: m, (2,).
        points: m, (N, 2).
        free: Gets the answers, (N,).
    """
    rows, columns = cells.shape
    middle = origin[0] + 0.5 * resolution, origin[1] + 0.5 * resolution
    for place in range(len(points)):
        point = points[place, 0] - centre[0], points[place, 1] - centre[1]
        at1 = (point[0] - origin[0]) / resolution
        at2 = (point[1] - origin[1]) / resolution
        free[place] = False
        if at1 >= 0.0 and at1 < rows and at2 >= 0.0 and at2 < columns:
            row, column = int(at1), int(at2)
            free[place] = cells[row, column] == 1
            for step in range(len(steps) if cells[row, column] == 2 else 0):
                to_row, to_column = row + steps[step, 0], column + steps[step, 1]
                within = to_row >= 0 and to_row < rows and to_column >= 0 and to_column < columns
                if within and cells[to_row, to_column] == 1 and not free[place]:
                    target = middle[0] + to_row * resolution, middle[1] + to_column * resolution
                    clear = True  # in the cells that the line of sight runs through, but the free one
                    for near_row, near_column in ((row, column), (to_row, column), (row, to_column)):
                        cell = near_row * columns + near_column
                        near = standing[starts[cell] : starts[cell + 1]]
                        clear = clear and _in_sight(point, target, near, walls)
                    free[place] = clear


@njit(error_model="numpy", inner=True)  # kept with those that call it
def _in_sight(point: tuple[float, float], target: tuple[float, float], near: IntArray, walls: Array) -> bool:
    """Whether none of the walls near by, of all (S, 7), stands between a point and a target."""
    reach = math.hypot(point[0] - target[0], point[1] - target[1])
    d1, d2 = (point[0] - target[0]) / reach, (point[1] - target[1]) / reach
    for number in near:
        wall = walls[number]
        side_a = (wall[0] - target[0]) * d2 - (wall[1] - target[1]) * d1
        side_b = (wall[2] - target[0]) * d2 - (wall[3] - target[1]) * d1
        along = wall[4] * d1 + wall[5] * d2
        distance = (wall[6] - wall[4] * target[0] - wall[5] * target[1]) / along
        meets = min(side_a, side_b) <= TOUCHING and max(side_a, side_b) >= -TOUCHING
        if meets and distance >= 0.0 and distance < reach - ON_IT and abs(along) > EDGE_ON:
            return False
    return True
