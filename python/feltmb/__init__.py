"""Multibody simulation of machines whose parts meet through felt."""

from feltmb.config import Action, load_action

__all__ = ["Action", "load_action"]
