"""The Kalman filters: extended, unscented, cubature, ensemble, and those of filterpy."""

from .belief import GaussianBelief
from .ensemble import EnsembleBelief, EnsembleKalmanFilter
from .extended import BatchExtendedKalmanFilter
from .filterpy_adapters import ExtendedKalmanFilter, UnscentedKalmanFilter
from .unscented import BatchUnscentedKalmanFilter, cubature

__all__ = [
    "BatchExtendedKalmanFilter",
    "BatchUnscentedKalmanFilter",
    "EnsembleBelief",
    "EnsembleKalmanFilter",
    "ExtendedKalmanFilter",
    "GaussianBelief",
    "UnscentedKalmanFilter",
    "cubature",
]
