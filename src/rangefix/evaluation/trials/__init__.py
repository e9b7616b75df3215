"""Trials: one estimator put to the measurements of runs, so that what goes wrong costs itself alone."""
