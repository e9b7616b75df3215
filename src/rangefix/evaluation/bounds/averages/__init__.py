"""Averages over truths and readings: sums over a grid of readings, or over draws with their error."""
