"""What an estimator believes after measuring."""

from .estimator import EachRun, Estimate, Estimator, SingleRunEstimator
from .motion import Stationary
from .noise import Gaussian
from .priors import Uniform
from .problem import Motion, Noise, Prior, Problem, RangeMap, Sensor
from .rangefinder import Rangefinder, sweep
from .registry import available, build
from .space import StateSpace, pose_space, position_space

__all__ = [
    "EachRun",
    "Estimate",
    "Estimator",
    "Gaussian",
    "Motion",
    "Noise",
    "Prior",
    "Problem",
    "RangeMap",
    "Rangefinder",
    "Sensor",
    "SingleRunEstimator",
    "StateSpace",
    "Stationary",
    "Uniform",
    "available",
    "build",
    "pose_space",
    "position_space",
    "sweep",
]
