"""Recordings of real robots: read as they are, in bounded memory, and replayed through every estimator."""
