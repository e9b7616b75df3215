"""What may stand in a study, section by section, and how it is built."""

from .base import Misfit, Section
from .drives import Drive
from .estimators import EstimatorSection
from .map import AnyMap, MapSection, RectangleMap
from .motion import AnyMotion, MotionSection, StationaryMotion, WalledMotion
from .prior import AnyPrior, UniformPrior
from .sensor import SensorSection
from .state import StateSection, TruthSection

__all__ = [
    "AnyMap",
    "AnyMotion",
    "AnyPrior",
    "Drive",
    "EstimatorSection",
    "MapSection",
    "Misfit",
    "MotionSection",
    "RectangleMap",
    "Section",
    "SensorSection",
    "StateSection",
    "StationaryMotion",
    "TruthSection",
    "UniformPrior",
    "WalledMotion",
]
