"""Centre lines of the walls of a grid map: where a wall is that is drawn some cells thick."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ..arrays import Array, BoolArray

THICKEST = 5  # cells; what is thicker is a block, and keeps its edges
STRAIGHT = 0.25  # cells that a line may be off the centres, to be straight
RING = ((0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1))  # neighbours in order
Node = tuple[int, int]


def centre_lines(walls: BoolArray) -> tuple[Array, BoolArray]:
    """The centre lines of thin walls, and the cells of blocks.

    Walls are thinned to lines of single cells (Zhang and Suen, 1984), which are moved to the middle of the
    wall, joined, straightened, and led on to where the wall ends.

    Args:
        walls: Which cells are walls, (n1, n2).

    Returns:
        Lines as x1a, x2a, x1b, x2b, (S, 4), in cells from the grid's corner; and which cells belong to
        blocks, whose edges are walls.
    """
    from scipy import ndimage

    padded = np.pad(walls, 1)
    block = ndimage.binary_opening(padded, np.ones((THICKEST + 1, THICKEST + 1), dtype=bool))
    thin = _thinned(padded, block)
    places = _middles(padded, thin, ndimage.distance_transform_edt(padded))
    lines = [_straightened(line) for line in _polylines(thin, block, places, padded)]
    parts = [np.hstack([line[:-1], line[1:]]) for line in lines]
    segments = np.concatenate([np.empty((0, 4)), *parts]) - 1.0
    return segments[np.hypot(*(segments[:, 2:] - segments[:, :2]).T) > 1e-6], np.asarray(block[1:-1, 1:-1])


def _thinned(walls: BoolArray, kept: BoolArray) -> BoolArray:
    """Walls one cell thick, by removing border cells in turns of two sides; `kept` ones stay."""
    thin = walls.copy()
    changed = True
    while changed:
        changed = False
        for first in (True, False):
            around = [np.roll(thin, (-i, -j), (0, 1)) for i, j in RING]
            east, north, west, south = around[::2]
            count = np.sum(around, axis=0)
            ahead = [*around[1:], around[0]]
            steps = np.sum([~one & two for one, two in zip(around, ahead, strict=True)], axis=0)
            sides = ~(north & east & south) & ~(east & south & west)
            others = ~(north & east & west) & ~(north & south & west)
            gone = thin & ~kept & (count >= 2) & (count <= 6) & (steps == 1) & (sides if first else others)
            changed |= bool(gone.any())
            thin &= ~gone
    return _with_specks(walls, thin, kept)


def _with_specks(walls: BoolArray, thin: BoolArray, kept: BoolArray) -> BoolArray:
    """One cell for each wall of which thinning left nothing, as of a square of two by two."""
    from scipy import ndimage

    parts, count = ndimage.label(walls, np.ones((3, 3)))
    left = np.bincount(parts[thin | kept], minlength=count + 1)
    for part in np.flatnonzero(left[1:] == 0) + 1:
        cells = np.argwhere(parts == part)
        thin[tuple(cells[np.hypot(*(cells - cells.mean(axis=0)).T).argmin()])] = True
    return np.asarray(thin & ~kept)


def _middles(walls: BoolArray, thin: BoolArray, depth: Array) -> dict[Node, Array]:
    """The middle of the wall about each cell of a line, in cells."""
    places = {}
    for i, j in np.argwhere(thin).tolist():
        reach = int(np.ceil(depth[i, j]))
        low = max(i - reach, 0), max(j - reach, 0)
        near = np.argwhere(walls[low[0] : i + reach + 1, low[1] : j + reach + 1])
        places[i, j] = near.mean(axis=0) + low + 0.5
    return places


def _neighbours(cells: BoolArray, node: Node) -> list[Node]:
    """Cells that a cell is joined to: by a side, and by a corner where no side leads there."""
    i, j = node
    found = [(i + di, j + dj) for di, dj in RING[::2] if cells[i + di, j + dj]]
    for di, dj in RING[1::2]:
        if cells[i + di, j + dj] and not cells[i + di, j] and not cells[i, j + dj]:
            found.append((i + di, j + dj))
    return found


def _polylines(thin: BoolArray, block: BoolArray, places: dict[Node, Array], walls: BoolArray) -> list[Array]:
    """Lines from branch to branch or end, each (K, 2)."""
    joined = thin | block
    beside = {node: _neighbours(joined, node) for node in places}
    lines = [line for node, near in beside.items() if not near for line in _cross(places[node])]
    taken: set[tuple[Node, Node]] = set()
    starts = [node for node, near in beside.items() if len(near) != 2] + list(beside)  # rings last
    for start in starts:
        for following in beside[start]:
            if (start, following) in taken:
                continue
            line, before, node = [start], start, following
            while True:
                taken |= {(before, node), (node, before)}
                line.append(node)
                if node not in beside or len(beside[node]) != 2 or node == start:
                    break
                before, node = node, next(each for each in beside[node] if each != before)
                if (before, node) in taken:
                    break
            points = [places.get(each, np.array(each) + 0.5) for each in line]
            if np.ptp(points, axis=0).max() < 0.5:  # a few cells, which all have the same middle
                points = [np.array(each) + 0.5 for each in line]
            if len(beside[line[0]]) == 1:
                points.insert(0, _led_on(points[1], points[0], walls))
            if line[-1] in beside and len(beside[line[-1]]) == 1:
                points.append(_led_on(points[-2], points[-1], walls))
            lines.append(np.array(points))
    return lines


def _cross(place: Array) -> tuple[Array, Array]:
    """A wall of one cell: a cross as large."""
    x, y = place
    return np.array([[x - 0.5, y], [x + 0.5, y]]), np.array([[x, y - 0.5], [x, y + 0.5]])


def _led_on(before: Array, end: Array, walls: BoolArray) -> Array:
    """Where the line that ends there leaves the wall."""
    ahead = (end - before) / max(float(np.hypot(*(end - before))), 1e-9)
    place = end
    for step in np.arange(0.0, THICKEST + 1, 0.25):
        i, j = np.floor(end + step * ahead).astype(int)
        if not (0 <= i < walls.shape[0] and 0 <= j < walls.shape[1] and walls[i, j]):
            break
        place = end + step * ahead
    return np.asarray(place)


def _straightened(line: Array) -> Array:
    """Fewer points, none of those left out farther off than STRAIGHT (Douglas and Peucker, 1973)."""
    kept, open_ = {0, len(line) - 1}, [(0, len(line) - 1)]
    while open_:
        first, last = open_.pop()
        if last - first < 2:
            continue
        along = line[last] - line[first]
        length = float(np.hypot(*along))
        arms = line[first + 1 : last] - line[first]
        off = np.hypot(*arms.T)
        if length > 1e-9:
            off = np.abs(along[0] * arms[:, 1] - along[1] * arms[:, 0]) / length
        worst = int(off.argmax())
        if off[worst] > STRAIGHT:
            kept.add(first + 1 + worst)
            open_ += pairwise([first, first + 1 + worst, last])
    return line[sorted(kept)]
