"""What may stand in a study, section by section, and how it is built."""

from .map import MapSection
from .motion import MotionSection

__all__ = ["MapSection", "MotionSection"]
