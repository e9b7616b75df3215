"""A prior that falls smoothly to nothing at the ends of a box, as Van Trees' bound needs it."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from ...arrays import TWO_PI, Array, compared_by, read_only
from ...raster import Raster
from ..problem import RangeMap
from ..space import StateSpace
from .uniform_prior import LATTICE, box_of


@compared_by("space", "room", "support")
class SquaredCosine:
    """The density (2 / L) cos^2(pi (x - c) / L) along x1 and along x2, of a box of lengths L about c.

    Its Fisher information is (2 pi / L)^2 along each (Van Trees, 1968), its variance L^2 (1/12 - 1/(2 pi^2)).

    Args:
        room: The map; all of the box must be free.
        space: The state space: x1 and x2.
        lower, upper: Corners (x1, x2) of the box, m; the map's bounds unless given.

    Raises:
        ValueError: If the space has other components, or the box is empty, not finite or not all free.
    """

    def __init__(
        self,
        room: RangeMap,
        space: StateSpace,
        lower: ArrayLike | None = None,
        upper: ArrayLike | None = None,
    ) -> None:
        if space.names != ("x1", "x2"):
            raise ValueError(f"a squared-cosine prior covers x1 and x2, not {', '.join(space.names)}")
        low, high = box_of(room, lower, upper)
        if not np.isfinite([low, high]).all():
            raise ValueError(f"a squared-cosine prior needs a finite box, got {low} and {high}")
        raster = Raster.over(low, high, LATTICE)
        blocked = ~np.asarray(room.is_free(raster.centres)).ravel()
        if blocked.any():
            first = raster.centres.reshape(-1, 2)[blocked.argmax()]
            raise ValueError(
                f"a squared-cosine prior needs a box that is all free: {100 * blocked.mean():.3g} % of that "
                f"from ({low[0]:g}, {low[1]:g}) to ({high[0]:g}, {high[1]:g}) m is not, such as "
                f"({first[0]:.2f}, {first[1]:.2f})"
            )
        self.room, self.space = room, space
        self.support = read_only(low), read_only(high)

    @cached_property
    def mean(self) -> Array:
        """The middle of the box, (2,)."""
        return read_only(0.5 * (self.support[0] + self.support[1]))

    @property
    def lengths(self) -> Array:
        """Lengths of the box, m, (2,)."""
        low, high = self.support
        return np.asarray(high - low)

    @cached_property
    def covariance(self) -> Array:
        """L^2 (1/12 - 1/(2 pi^2)) along each, (2, 2)."""
        return read_only(np.diag(self.lengths**2 * (1 / 12 - 1 / (2 * np.pi**2))))

    @cached_property
    def fisher_information(self) -> Array:
        """Information of the density about where it stands, (2 pi / L)^2 along each, 1/m^2, (2, 2)."""
        return read_only(np.diag((TWO_PI / self.lengths) ** 2))

    def __repr__(self) -> str:
        low, high = (", ".join(f"{value:.3g}" for value in corner) for corner in self.support)
        return f"SquaredCosine(from ({low}) to ({high}) m)"

    def sample(self, size: int, rng: Generator) -> Array:
        """Independent draws, (size, 2)."""
        from scipy.stats import cosine  # half a second, for those who need it

        return self.mean + self.lengths * cosine.ppf(rng.random((size, 2))) / TWO_PI

    def log_density(self, states: Array) -> Array:
        """Log density, -inf at the ends of the box and outside: (..., 2) -> (...)."""
        share = (np.asarray(states, dtype=float) - self.mean) / self.lengths
        with np.errstate(divide="ignore"):
            logs = np.log(2 / self.lengths) + 2 * np.log(np.abs(np.cos(np.pi * share)))
        return np.asarray(np.where(np.abs(share) < 0.5, logs, -np.inf).sum(-1))
