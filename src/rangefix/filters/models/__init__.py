"""What the world does: motions, sensors, noise and priors."""

from .beam_noise import BeamMixture, Quantised
from .confined import Confined, in_line_of_sight, sample_runs
from .gaussian_prior import GaussianPrior
from .mixture_prior import Mixture
from .motion import ConstantVelocity, RandomWalk, Stationary
from .noise import CumulativeNoise, Gaussian, RangeProportional, StudentT, check_spread
from .odometry import Odometry
from .product_prior import WithHeading, WithVelocity
from .rangefinder import Rangefinder, sweep
from .uniform_prior import Uniform

__all__ = [
    "BeamMixture",
    "Confined",
    "ConstantVelocity",
    "CumulativeNoise",
    "Gaussian",
    "GaussianPrior",
    "Mixture",
    "Odometry",
    "Quantised",
    "RandomWalk",
    "RangeProportional",
    "Rangefinder",
    "Stationary",
    "StudentT",
    "Uniform",
    "WithHeading",
    "WithVelocity",
    "check_spread",
    "in_line_of_sight",
    "sample_runs",
    "sweep",
]
