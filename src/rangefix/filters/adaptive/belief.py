"""What the adaptive point-mass filter believes: what was predicted, and the posterior since the readings."""

from __future__ import annotations

from dataclasses import dataclass

from ...arrays import Array
from ..estimate import Estimate, brief
from ..problem import Prior
from .lattices.quadrature import Quadrature
from .prediction.predicted import Predicted


@dataclass(frozen=True)
class AdaptiveBelief:
    """What was predicted, what has been measured since, and the posterior that follows.

    Attributes:
        prior: What was predicted; the problem's prior before the first move.
        check: The same worked out from other points and with wider kernels; None before the first move.
        measurements: Since then, (U, B); readings of different beams share a row.
        posterior: Where it is; None before the first measurement after a move.
        log_evidence: Of all that was measured before `prior`, nats.
        possible: Whether some state allowed the last measurement; if not, the belief is the one before it.
        inherited: Error of mean and covariance before the last move, deviations; at most 1.
    """

    prior: Prior | Predicted
    check: Predicted | None
    measurements: Array
    posterior: Quadrature | None
    log_evidence: float
    possible: bool = True
    inherited: float = 0.0

    @property
    def untouched(self) -> Prior | None:
        """The problem's prior, as long as nothing was measured and no move predicted."""
        return None if self.posterior is not None or isinstance(self.prior, Predicted) else self.prior

    def __repr__(self) -> str:
        if self.posterior is None:
            return brief(self)
        return brief(self, Estimate(self.posterior.moments.mean, self.posterior.moments.covariance))
