"""Figures of recordings that were replayed."""
