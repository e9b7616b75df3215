"""What the world does: motions, sensors, noise and priors; `rangefix.filters` offers them."""
