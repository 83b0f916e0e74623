"""Strokes and simulations of a mechanism: runs, sweeps and sensitivities."""
