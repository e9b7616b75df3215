"""Averages over truths and readings: on a grid of readings or by draws, over exact or sampled posteriors."""
