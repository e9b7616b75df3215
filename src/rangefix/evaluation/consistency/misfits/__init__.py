"""How badly a scan fits the map: at a state, where it fits best, and what that comes to by chance."""
