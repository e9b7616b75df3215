"""Some runs of an estimator after one step, as metrics see them."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...arrays import Array, BoolArray
from ..results import BeliefScores
from .normalised import is_positive, nees


class RunBlock:
    """K runs that went well, of M planned.

    Attributes:
        names: Components of the state.
        errors: Truth minus estimate, (K, n).
        covariance: Claimed, (K, n, n).
        log_evidence: Of the measurements so far, nats, (K,); NaN where the estimator gives none.
        improbable: Which met measurements that the estimator's model all but excludes, (K,).
        status: Codes of `Status` of the planned runs, (M,).
        belief: What draws from the beliefs come to, of the runs that have them; None if none has.
        G, inverse: E[e e'] over all runs of the estimator and its inverse, (n, n); None until they are known.
    """

    def __init__(
        self,
        names: tuple[str, ...],
        errors: Array,
        covariance: Array,
        *,
        log_evidence: Array | None = None,
        improbable: BoolArray | None = None,
        status: NDArray[np.int8] | None = None,
        belief: BeliefScores | None = None,
    ) -> None:
        runs = len(errors)
        self.names, self.errors, self.covariance = names, errors, covariance
        self.log_evidence = np.full(runs, np.nan) if log_evidence is None else log_evidence
        self.improbable = np.zeros(runs, dtype=bool) if improbable is None else improbable
        self.status = np.zeros(runs, dtype=np.int8) if status is None else status
        sampled = np.zeros(0, dtype=bool) if belief is None else np.isfinite(belief.energy)
        self.belief = (
            BeliefScores(*(array[sampled] for array in belief)) if belief and sampled.any() else None
        )
        self.G: Array | None = None
        self.inverse: Array | None = None

    @cached_property
    def positive(self) -> BoolArray:
        """Which covariances are positive definite, (K,)."""
        return is_positive(self.covariance)

    @cached_property
    def nees(self) -> Array:
        """Normalised estimation errors squared e' P^-1 e, (K,)."""
        return nees(self.errors, self.covariance)

    @property
    def variances(self) -> Array:
        """Claimed variances, (K, n)."""
        return self.covariance.diagonal(axis1=1, axis2=2)

    @property
    def true_nees(self) -> Array:
        """Errors squared normalised by what is true, e' G^-1 e, (K,); 0 until G is known."""
        if self.inverse is None:
            return np.zeros(len(self.errors))
        return np.asarray(((self.errors @ self.inverse) * self.errors).sum(-1))

    @property
    def log_ratios(self) -> Array:
        """log10 of e' P^-1 e over e' G^-1 e, (K,); 0 where there is no error, and until G is known."""
        true = self.true_nees
        apart = true > 0
        with np.errstate(divide="ignore"):
            ratios = np.where(apart, self.nees, 1.0) / np.where(apart, true, 1.0)
            return np.where(apart, np.log10(ratios), 0.0)
