"""Maps by name: files, and rooms in words."""

from .open_map import files_of, kind_of, load, map_table, open_map
from .plan_files import save

__all__ = ["files_of", "kind_of", "load", "map_table", "open_map", "save"]
