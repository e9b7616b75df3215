"""Which beam to measure next: what a position is expected to gain from it, before it is measured."""
