"""A plan of beams, and what is expected after each of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...arrays import Array
from .expected_covariance import Criterion


@dataclass(frozen=True)
class Step:
    """One beam of a plan, and what is expected after it.

    Attributes:
        bearing: From the laser's forward axis, rad clockwise; None where it depends on the readings before.
        covariance: E[P] after this beam and those before it, (n, n); m^2 and rad^2.
        value: The criterion after it: m^2, m^4 for det, nats of this beam for information.
        error: Standard error of the value, of the drawn truths; 0 for the first beam, which draws none.
        objective: The criterion for each candidate as it was chosen, (D,); NaN where it was not asked for.
        truths: Over how many drawn truths the value is averaged; 0 where none is drawn.
        looked_at: From how many these were chosen, so that places which are easily mistaken for others are
            among them: what is rarer than about 3 in so many may not have been met, and is then missing
            from value and error.
        candidate: Its place among the candidates; None where it depends on the readings before.
    """

    bearing: float | None
    covariance: Array
    value: float
    error: float
    objective: Array
    truths: int = 0
    looked_at: int = 0
    candidate: int | None = None

    @property
    def position_std(self) -> float:
        """Root of the expected square of the position's error, m."""
        return float(np.sqrt(max(self.covariance[0, 0] + self.covariance[1, 1], 0.0)))


@dataclass(frozen=True)
class Plan:
    """Beams to measure, in this order.

    Attributes:
        candidates: Bearings that were compared, rad, (D,).
        criterion, method, adaptive: How they were chosen.
        steps: One for each beam.
    """

    candidates: Array
    criterion: Criterion
    method: str
    adaptive: bool
    steps: tuple[Step, ...]
