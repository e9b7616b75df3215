"""Maps by name: files, and rooms in words."""

from .open_map import kind_of, load, map_table, open_map
from .plan_files import save

__all__ = ["kind_of", "load", "map_table", "open_map", "save"]
