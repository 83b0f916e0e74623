"""Twelve machines whose stated models are a little wrong everywhere.

Their laws are not the library's (bristles, bump stops, air drag, soft saturation, diffusion,
radiation, backlash, delay, heating, valves, magnets), and each has a discrepancy: a law inside the
machine that depends on its state and that no candidate has. A case adds one effect, or none. The
numbers and the accepted answers are in :mod:`~blind.imperfect.machines`, the stated models and
their candidates in :mod:`~blind.imperfect.stated`, the records in :mod:`~blind.imperfect.generate`.
"""
