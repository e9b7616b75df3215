"""Figures of plans and of maps of accuracy, as functions of what was worked out and of nothing else."""
