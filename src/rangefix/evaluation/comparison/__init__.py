"""Comparisons: two results, the estimators of one study on the same truths, and its worst runs."""
