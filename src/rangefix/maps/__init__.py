"""What a rangefinder would measure, anywhere: rooms, floor plans and meshes."""

from .base import Hits, MapError
from .floor_plan import FloorPlan
from .free_space import FreeSpace
from .mesh import MeshRoom
from .occupancy import OccupancyMap
from .readers import load, open_map, save
from .rectangle import RectangularRoom

__all__ = [
    "FloorPlan",
    "FreeSpace",
    "Hits",
    "MapError",
    "MeshRoom",
    "OccupancyMap",
    "RectangularRoom",
    "load",
    "open_map",
    "save",
]
