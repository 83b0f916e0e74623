"""Command group ``feltmb fiber``: structure, contacts, laws, fits, simulation of fiber masses."""

from feltmb.cli.fiber import fitting, laws, networks, simulation
from feltmb.cli.fiber.group import fiber

__all__ = ["command", "fiber", "fitting", "laws", "networks", "simulation"]

command = fiber
"""Command that the main group imports."""
