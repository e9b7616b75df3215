"""Files of recordings, read scan by scan: each format turns its conventions into those of this package."""
