"""Packaged data sets: mechanisms here, strokes in ``strokes``."""
