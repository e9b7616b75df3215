"""What an estimator believes after measuring."""

from .beam_noise import BeamMixture, Quantised
from .compound_priors import Mixture, WithVelocity
from .confined import Confined, is_clear, sample_runs
from .estimator import EachRun, Estimate, Estimator, SingleRunEstimator
from .gaussian_prior import GaussianPrior
from .heading_prior import WithHeading
from .motion import ConstantVelocity, RandomWalk, Stationary
from .noise import Gaussian, RangeProportional, StudentT
from .odometry import Odometry
from .priors import Uniform
from .problem import Motion, Noise, Prior, Problem, RangeMap, Sensor
from .rangefinder import Rangefinder, sweep
from .registry import available, build
from .space import StateSpace, pose_space, position_space, velocity_space

__all__ = [
    "BeamMixture",
    "Confined",
    "ConstantVelocity",
    "EachRun",
    "Estimate",
    "Estimator",
    "Gaussian",
    "GaussianPrior",
    "Mixture",
    "Motion",
    "Noise",
    "Odometry",
    "Prior",
    "Problem",
    "Quantised",
    "RandomWalk",
    "RangeMap",
    "RangeProportional",
    "Rangefinder",
    "Sensor",
    "SingleRunEstimator",
    "StateSpace",
    "Stationary",
    "StudentT",
    "Uniform",
    "WithHeading",
    "WithVelocity",
    "available",
    "build",
    "is_clear",
    "pose_space",
    "position_space",
    "sample_runs",
    "sweep",
    "velocity_space",
]
