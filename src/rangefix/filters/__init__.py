"""What an estimator believes after measuring."""

from .beam_noise import BeamMixture, Quantised
from .estimator import EachRun, Estimate, Estimator, SingleRunEstimator
from .motion import Stationary
from .noise import Gaussian, RangeProportional, StudentT
from .priors import Uniform
from .problem import Motion, Noise, Prior, Problem, RangeMap, Sensor
from .rangefinder import Rangefinder, sweep
from .registry import available, build
from .space import StateSpace, pose_space, position_space

__all__ = [
    "BeamMixture",
    "EachRun",
    "Estimate",
    "Estimator",
    "Gaussian",
    "Motion",
    "Noise",
    "Prior",
    "Problem",
    "Quantised",
    "RangeMap",
    "RangeProportional",
    "Rangefinder",
    "Sensor",
    "SingleRunEstimator",
    "StateSpace",
    "Stationary",
    "StudentT",
    "Uniform",
    "available",
    "build",
    "pose_space",
    "position_space",
    "sweep",
]
