"""Figures into which a page points: where data stand in them is known."""
