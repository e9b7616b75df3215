"""Resampling: which particles are copied, and how often, so that equal weights say what unequal ones said.

Every scheme is unbiased: particle i has N w_i copies on average. All of them count along the cumulative
weights, in O(N) and without a search (Kitagawa, 1996; Douc, Cappé and Moulines, 2005).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from ...arrays import Array

Indices = NDArray[np.intp]


def systematic(weights: Array, rng: Generator) -> Indices:
    """Ancestors by one random comb of N equal teeth: N w_i copies, rounded down or up.

    Args:
        weights: Non-negative, not all zero, (N,); they need not sum to one.
        rng: Draws one number.

    Returns:
        Indices of the particles to copy, ascending, (N,).
    """
    return comb(weights, len(weights), rng)


def one_in(more: int, weights: Array, rng: Generator) -> Indices:
    """Every `more`-th ancestor of `systematic`, from a random one of the first on, (N / more,)."""
    return systematic(weights, rng)[int(rng.integers(more)) :: more]


def comb(weights: Array, size: int, rng: Generator) -> Indices:
    """The same with so many teeth, (size,)."""
    from .kernels import comb_along  # numba takes a quarter of a second

    ancestors: Indices = np.zeros(size + 1, dtype=np.intp)
    comb_along(np.ascontiguousarray(weights, dtype=float), rng.random(), ancestors)
    return ancestors[:-1]


def stratified(weights: Array, rng: Generator) -> Indices:
    """Ancestors by one random point in each of N equal strata; arguments as for `systematic`, N draws."""
    cumulative = _cumulative(weights)
    strata = np.floor(cumulative)
    size = len(weights)
    points = rng.random(size)[np.minimum(strata, size - 1).astype(np.intp)]
    return _ancestors(strata + (points < cumulative - strata))


def multinomial(weights: Array, rng: Generator) -> Indices:
    """Ancestors drawn independently of each other; arguments as for `systematic`, N draws."""
    cumulative = _cumulative(weights)
    size = len(weights)
    spacings = np.cumsum(rng.standard_exponential(size + 1))  # N sorted uniform numbers without a sort
    points = spacings[:-1] * (cumulative[-1] / spacings[-1])
    ancestors: Indices = np.searchsorted(cumulative, points, side="right")
    return np.minimum(ancestors, size - 1, out=ancestors)


def residual(weights: Array, rng: Generator) -> Indices:
    """Ancestors N w_i times rounded down, and the rest by independent draws (Liu and Chen, 1998)."""
    size = len(weights)
    share = np.asarray(weights, dtype=float) * (size / np.sum(weights))
    whole = np.floor(share)
    copies = whole.astype(np.intp)
    rest = share - whole
    if left := size - int(copies.sum()):
        copies += rng.multinomial(left, rest / rest.sum())
    return np.repeat(np.arange(size), copies)


SCHEMES: Mapping[str, Callable[[Array, Generator], Indices]] = MappingProxyType(
    {"systematic": systematic, "stratified": stratified, "residual": residual, "multinomial": multinomial}
)


def kinds(ancestors: Indices) -> tuple[Indices, Indices]:
    """Where copies of another particle begin, and how many of each there are; ancestors ascend, (N,)."""
    first = np.flatnonzero(np.diff(ancestors, prepend=-1))
    return first, np.diff(first, append=len(ancestors))


def _cumulative(weights: Array) -> Array:
    """Sums of the weights up to and with each particle, scaled so that the last is N."""
    sums = np.cumsum(weights, dtype=float)
    sums *= len(sums) / sums[-1]
    return sums


def _ancestors(ends: Array) -> Indices:
    """Indices from the number of points that lie below the end of each particle's interval."""
    copies = np.minimum(ends, len(ends), out=ends).astype(np.intp)
    copies[-1] = len(copies)  # rounding must not lose the last point
    copies[1:] -= copies[:-1].copy()
    chosen = np.flatnonzero(copies)
    return np.repeat(chosen, copies[chosen])
