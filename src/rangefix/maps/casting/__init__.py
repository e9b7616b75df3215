"""Casting beams at walls of the plane: segments, sorted or seen from one place, and cells of grids."""
