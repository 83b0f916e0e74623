"""Strokes and simulations of a mechanism: runs, sweeps, studies and sensitivities."""
