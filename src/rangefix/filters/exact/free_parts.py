"""Which parts of convex pieces are free space, where its border is not made of walls, as in meshes."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from ...arrays import Array, BoolArray
from .polygons import THIN_M, cut_off

BORDER_M = 0.02  # pieces this small are cut along the border of free space
BISECTIONS = 24  # by which its crossings of a piece's edges are found
PROBE_M = 0.05  # between places at which pieces are asked whether they are free
FEW_PROBES, MOST_PROBES = 4, 100  # to a side of a triangle: at first, and where all of those are free
INNER_SHARE = 0.98  # of the way from the middle to the border: where pieces are probed


def free_parts(pieces: list[Array], is_free: Callable[[Array], BoolArray]) -> list[Array]:
    """The pieces in free space; those that are free in part only, as in meshes, are halved, and then cut."""
    free: list[Array] = []
    crossed: list[Array] = []
    while pieces:
        centres = np.array([piece.mean(axis=0) for piece in pieces])
        share = _free_shares(centres, pieces, is_free, FEW_PROBES)
        whole = np.flatnonzero(share == 1)
        if len(whole):  # what stands in free space below a beam's height has no walls that cut pieces
            share[whole] = _free_shares(centres[whole], [pieces[k] for k in whole], is_free, MOST_PROBES)
        mixed = []
        for piece, level in zip(pieces, share, strict=True):
            size = np.ptp(piece, axis=0)
            if level == 0 or level == 1:
                if level == 1:
                    free.append(piece)
            elif size.max() <= BORDER_M:
                crossed.append(piece)
            else:
                axis = int(size.argmax())
                middle = piece[:, axis].min() + 0.5 * size[axis]
                for side in (1.0, -1.0):
                    half = cut_off(piece, side * np.eye(2)[axis], side * middle)
                    if len(half) >= 3:
                        mixed.append(half)
        pieces = mixed
    return free + _cut_along_borders(crossed, is_free)


def _free_shares(
    centres: Array, pieces: list[Array], is_free: Callable[[Array], BoolArray], most: int
) -> Array:
    """What share of places all over each piece is free, PROBE_M apart or so many to a side, (P,)."""
    probes = [_probes(centre, piece, most) for centre, piece in zip(centres, pieces, strict=True)]
    owners = np.repeat(np.arange(len(probes)), [len(each) for each in probes])
    inside = is_free(np.concatenate(probes))
    return np.asarray(np.bincount(owners, inside) / np.bincount(owners))


def _probes(centre: Array, piece: Array, most: int) -> Array:
    """Places all over a piece: a lattice over each triangle of its middle and an edge."""
    inner = centre + INNER_SHARE * (piece - centre)
    sides = int(min(max(np.ceil(np.ptp(piece, axis=0).max() / PROBE_M), 2), most))
    first, second, third = _shares(sides)
    following = np.roll(inner, -1, axis=0)
    places = first * centre[:, None] + second * inner[:, :, None] + third * following[:, :, None]
    return np.asarray(np.moveaxis(places, 1, 2).reshape(-1, 2))


@cache
def _shares(sides: int) -> tuple[Array, Array, Array]:
    """Of a triangle's corners at the nodes of a lattice over it, so many to a side."""
    steps = np.stack(np.meshgrid(np.arange(sides + 1), np.arange(sides + 1), indexing="ij"), axis=-1)
    second, third = steps[steps.sum(axis=-1) <= sides].T / sides
    return 1.0 - second - third, second, third


def _cut_along_borders(pieces: list[Array], is_free: Callable[[Array], BoolArray]) -> list[Array]:
    """The free sides of small pieces that the border of free space crosses, taken for straight in each.

    Where it does not cross two edges a piece is taken whole if its middle is free, else left out.
    """
    if not pieces:
        return []
    counts = np.array([len(piece) for piece in pieces])
    owners = np.repeat(np.arange(len(pieces)), counts)
    centres = np.array([piece.mean(axis=0) for piece in pieces])
    starts = np.concatenate([c + INNER_SHARE * (piece - c) for c, piece in zip(centres, pieces, strict=True)])
    following = np.arange(len(starts)) + 1
    ends = np.cumsum(counts)
    following[ends - 1] = ends - counts
    inside, middle_free = is_free(starts), is_free(centres)
    edges = np.flatnonzero(inside != inside[following])
    within, beyond = starts[edges].copy(), starts[following[edges]].copy()
    swapped = ~inside[edges]
    within[swapped], beyond[swapped] = beyond[swapped].copy(), within[swapped].copy()
    for _ in range(BISECTIONS):
        between = 0.5 * (within + beyond)
        good = is_free(between)[:, None]
        within, beyond = np.where(good, between, within), np.where(good, beyond, between)
    crossings = np.bincount(owners[edges], minlength=len(pieces))
    found: list[Array] = []
    for place, piece in enumerate(pieces):
        if crossings[place] != 2:
            if middle_free[place]:
                found.append(piece)
            continue
        one, other = within[owners[edges] == place]
        normal = np.array([other[1] - one[1], one[0] - other[0]])
        length = float(np.hypot(*normal))
        if length < THIN_M:
            continue
        normal /= length
        mine = starts[owners == place]
        side = 1.0 if (mine[inside[owners == place]] - one).mean(axis=0) @ normal <= 0 else -1.0
        part = cut_off(piece, side * normal, side * float(one @ normal))
        if len(part) >= 3:
            found.append(part)
    return found
