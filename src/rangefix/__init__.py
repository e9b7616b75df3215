"""rangefix: how far an indoor position estimate from a map and a rangefinder can be trusted."""

__version__ = "0.1.0"
