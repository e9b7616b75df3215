"""Whether to trust it: claimed against true errors."""
