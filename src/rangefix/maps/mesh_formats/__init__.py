"""Mesh files of all formats, as vertices and triangles in the units and axes of the file."""
