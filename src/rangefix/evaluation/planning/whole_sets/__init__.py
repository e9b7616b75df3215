"""How accurate a position is after all beams of a set, rare wrong places included."""
