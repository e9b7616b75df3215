"""The commands that take recordings of real robots."""
