"""Maps by name: files, and rooms in words."""

from .open_map import load, save

__all__ = ["load", "save"]
