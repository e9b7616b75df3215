"""What a replay is drawn from: a part of its steps, evenly spread and no more than so many."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ...arrays import Array
from ...filters.optional_methods import Image
from .replay import Believed

MOST_KEPT = 4000  # steps


@dataclass
class Trace:
    """Every k-th step of a replay, with k doubled whenever there are too many.

    Attributes:
        kept: Those steps, without their pictures.
        images: Pictures of the belief, with the steps that they are of.
    """

    kept: list[Believed] = field(default_factory=list)
    images: list[tuple[Believed, Image | None]] = field(default_factory=list)
    every: int = 1
    count: int = 0

    def add(self, believed: Believed, is_shown: bool) -> None:
        """Take a step."""
        if is_shown:
            self.images.append((believed, believed.image))
        if self.count % self.every == 0:
            self.kept.append(believed)
            if len(self.kept) > MOST_KEPT:
                self.kept, self.every = self.kept[::2], 2 * self.every
        self.count += 1

    @property
    def times(self) -> Array:
        """Times, s, (K,)."""
        return np.array([step.step.time_s for step in self.kept])

    @property
    def means(self) -> Array:
        """Estimates, (K, 3)."""
        return np.array([step.mean for step in self.kept]).reshape(-1, 3)

    @property
    def covariances(self) -> Array:
        """What is claimed for them, (K, 3, 3)."""
        return np.array([step.covariance for step in self.kept]).reshape(-1, 3, 3)

    @property
    def truths(self) -> Array:
        """True poses, (K, 3); NaN where they are not known."""
        unknown = np.full(3, np.nan)
        poses = [unknown if step.truth is None else step.truth for step in self.kept]
        return np.array(poses).reshape(-1, 3)

    @property
    def residuals(self) -> Array:
        """Readings less the ranges of the map at the estimates, (K, B), m."""
        return np.array([step.residuals for step in self.kept])

    @property
    def misfits(self) -> Array:
        """Misfit of the last scans and its threshold, (K, 2); NaN where no reading counts."""
        none = (np.nan, np.nan)
        fits = [step.fit for step in self.kept]
        return np.array(
            [none if fit is None or not fit.readings else (fit.misfit, fit.threshold) for fit in fits]
        )
