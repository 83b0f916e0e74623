"""Runs: strokes, simulation, results, sweeps, studies and sensitivities of a mechanism."""
