"""Lattices about the modes of a posterior: their cells, and what they come to."""
