"""What bounds from pairs of states share: what tells two states apart, shifts to try, sums over a prior."""
