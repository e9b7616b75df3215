"""Where an object can be after a move: a belief on lattices becomes a sum of Gaussians."""
