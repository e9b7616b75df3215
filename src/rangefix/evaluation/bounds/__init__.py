"""How good anybody could be: bounds that no estimator's covariance can lie below, and the optimum itself."""

from .bound import Bound, NoBoundError

__all__ = ["Bound", "NoBoundError"]
