"""What may stand in a study, section by section, and how it is built."""

from .base import Misfit, Section
from .drives import Drive
from .estimators import EstimatorSection
from .map import FloorPlanMap, MeshMap, RectangleMap
from .motion import AnyMotion, ConstantVelocityMotion, OdometryMotion, RandomWalkMotion, StationaryMotion
from .prior import AnyPrior, CentredPrior, MixturePrior, UniformPrior
from .sensor import SensorSection
from .state import StateSection, TruthSection

__all__ = [
    "AnyMotion",
    "AnyPrior",
    "CentredPrior",
    "ConstantVelocityMotion",
    "Drive",
    "EstimatorSection",
    "FloorPlanMap",
    "MeshMap",
    "Misfit",
    "MixturePrior",
    "OdometryMotion",
    "RandomWalkMotion",
    "RectangleMap",
    "Section",
    "SensorSection",
    "StateSection",
    "StationaryMotion",
    "TruthSection",
    "UniformPrior",
]
