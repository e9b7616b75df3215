"""What an estimator believes after measuring.

Names are loaded when they are first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..lazy_names import offered_by
from .option_units import option_units

if TYPE_CHECKING:
    from .estimate import Estimate
    from .estimator import EachRun, Estimator, SingleRunEstimator
    from .measurement import check_measurement, check_reading
    from .models.beam_noise import BeamMixture, Quantised
    from .models.confined import Confined, in_line_of_sight, sample_runs
    from .models.correlated import Correlated, PlaceError
    from .models.gaussian_prior import GaussianPrior
    from .models.mixture_prior import Mixture
    from .models.motion import ConstantVelocity, RandomWalk, Stationary
    from .models.noise import Gaussian, RangeProportional, StudentT
    from .models.odometry import Odometry
    from .models.product_prior import WithHeading, WithVelocity
    from .models.rangefinder import Rangefinder, sweep
    from .models.squared_cosine_prior import SquaredCosine
    from .models.uniform_prior import Uniform
    from .models.wrapped_noise import Biased, LostBeams, Tempered
    from .mount import Mount
    from .problem import Motion, Noise, Prior, Problem, RangeMap, Sensor
    from .registry import available, build
    from .space import StateSpace, pose_space, position_space, velocity_space

    is_clear = in_line_of_sight

__all__ = [
    "BeamMixture",
    "Biased",
    "Confined",
    "ConstantVelocity",
    "Correlated",
    "EachRun",
    "Estimate",
    "Estimator",
    "Gaussian",
    "GaussianPrior",
    "LostBeams",
    "Mixture",
    "Motion",
    "Mount",
    "Noise",
    "Odometry",
    "PlaceError",
    "Prior",
    "Problem",
    "Quantised",
    "RandomWalk",
    "RangeMap",
    "RangeProportional",
    "Rangefinder",
    "Sensor",
    "SingleRunEstimator",
    "SquaredCosine",
    "StateSpace",
    "Stationary",
    "StudentT",
    "Tempered",
    "Uniform",
    "WithHeading",
    "WithVelocity",
    "available",
    "build",
    "check_measurement",
    "check_reading",
    "in_line_of_sight",
    "is_clear",
    "option_units",
    "pose_space",
    "position_space",
    "sample_runs",
    "sweep",
    "velocity_space",
]
_MODULES = {
    "estimate": ("Estimate",),
    "estimator": ("EachRun", "Estimator", "SingleRunEstimator"),
    "measurement": ("check_measurement", "check_reading"),
    "models.beam_noise": ("BeamMixture", "Quantised"),
    "models.confined": ("Confined", "in_line_of_sight", "sample_runs"),
    "models.correlated": ("Correlated", "PlaceError"),
    "models.gaussian_prior": ("GaussianPrior",),
    "models.mixture_prior": ("Mixture",),
    "models.motion": ("ConstantVelocity", "RandomWalk", "Stationary"),
    "models.noise": ("Gaussian", "RangeProportional", "StudentT"),
    "models.odometry": ("Odometry",),
    "models.product_prior": ("WithHeading", "WithVelocity"),
    "models.rangefinder": ("Rangefinder", "sweep"),
    "models.squared_cosine_prior": ("SquaredCosine",),
    "models.uniform_prior": ("Uniform",),
    "models.wrapped_noise": ("Biased", "LostBeams", "Tempered"),
    "mount": ("Mount",),
    "problem": ("Motion", "Noise", "Prior", "Problem", "RangeMap", "Sensor"),
    "registry": ("available", "build"),
    "space": ("StateSpace", "pose_space", "position_space", "velocity_space"),
}  # module -> what it offers
_OLDER = {"is_clear": "in_line_of_sight"}  # its name in 0.1
__getattr__, __dir__ = offered_by(__name__, _MODULES, _OLDER)
