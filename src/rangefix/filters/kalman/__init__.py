"""The Kalman filters: extended, unscented, cubature, ensemble, and those of filterpy."""

from .belief import GaussianBelief
from .ensemble import EnsembleBelief, EnsembleKalmanFilter
from .extended import ExtendedKalmanFilter
from .filterpy_adapters import FilterpyExtendedKalmanFilter, FilterpyUnscentedKalmanFilter
from .unscented import UnscentedKalmanFilter, cubature

__all__ = [
    "EnsembleBelief",
    "EnsembleKalmanFilter",
    "ExtendedKalmanFilter",
    "FilterpyExtendedKalmanFilter",
    "FilterpyUnscentedKalmanFilter",
    "GaussianBelief",
    "UnscentedKalmanFilter",
    "cubature",
]
