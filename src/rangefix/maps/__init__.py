"""What a rangefinder would measure, anywhere: rooms, floor plans and meshes."""

from .base import Hits, MapError
from .floor_plan import FloorPlan
from .rectangle import RectangularRoom

__all__ = ["FloorPlan", "Hits", "MapError", "RectangularRoom"]
