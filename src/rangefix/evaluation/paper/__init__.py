"""The table and the figures of the paper of Stepanov and Mansour."""

from .table1 import BAND, CELLS, Paper, load, save, solve

__all__ = ["BAND", "CELLS", "Paper", "load", "save", "solve"]
