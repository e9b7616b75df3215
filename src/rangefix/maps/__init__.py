"""What a rangefinder would measure, anywhere: rooms, floor plans and meshes."""

from .base import Hits, MapError
from .rectangle import RectangularRoom

__all__ = ["Hits", "MapError", "RectangularRoom"]
