"""Figures of runs and mechanisms: plots, the viewer in a browser, animations."""
