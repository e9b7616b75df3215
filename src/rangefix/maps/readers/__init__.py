"""Maps by name: files, and rooms in words."""

from .open_map import files_of, is_map_file, kind_of, load, map_table, open_map
from .plan_files import is_plan, save

__all__ = ["files_of", "is_map_file", "is_plan", "kind_of", "load", "map_table", "open_map", "save"]
