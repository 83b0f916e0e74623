"""Changes of the felt of one contact: stiffness, hardening, thickness."""

from __future__ import annotations

from scipy.optimize import brentq

from feltmb.adapters.changes import Change
from feltmb.mechanism import Contact, Curve, MechanismFile

__all__ = ["changes"]

#: Force that is unchanged when the hardening of a felt changes [N].
REFERENCE_FORCE = 5.0


def changes(
    config: MechanismFile, contact: str, what: str, times: float = 1.0
) -> list[Change] | None:
    """Changes of the entries of a contact; None if its law does not have them.

    Parameters
    ----------
    what
        ``stiffness``: both curves are multiplied by 1 + times * magnitude. ``hardening``: the
        exponents b of both curves are multiplied by 1 + magnitude; their a is changed so that a
        exp(b e) is constant at the depth at which the loading curve gives 5 N. ``thickness``: the
        thickness of the felt is reduced by magnitude [m].
    """
    node = config.contacts[contact]
    if what == "thickness":
        return _thickness(config, node)
    if node.law == "hunt_crossley":
        path = f"contacts.{contact}.hunt_crossley.stiffness"
        return [Change(path=path, scale=times)] if what == "stiffness" else None
    if node.loading is None or node.unloading is None:
        return None
    out = []
    depth = _depth(node.loading)
    for branch in ("loading", "unloading"):
        path = f"contacts.{contact}.{branch}"
        if what == "stiffness":
            out += [Change(path=f"{path}.{k}", scale=times) for k in "ac"]
        else:
            b = getattr(node, branch).b
            out += [
                Change(path=f"{path}.a", exp=-b * depth),
                Change(path=f"{path}.b", scale=1.0),
            ]
    return out


def _depth(curve: Curve) -> float:
    """Compression at which the loading curve gives the reference force [m]."""
    import math

    def excess(e: float) -> float:
        power = min(curve.b * e, 40.0)
        return curve.a * e * math.exp(power) + curve.c * e - REFERENCE_FORCE

    deep = 1e-5
    while excess(deep) < 0.0 and deep < 1.0:
        deep *= 1.5
    return float(brentq(excess, 1e-7, deep)) if excess(deep) > 0.0 else 1e-3


def _thickness(config: MechanismFile, node: Contact) -> list[Change] | None:
    """Reduce the radius of the circle of the pair; with radius zero, move its line instead."""
    for name in node.surfaces:
        surface = config.surfaces[name]
        if surface.kind == "circle" and surface.radius:
            return [Change(path=f"surfaces.{name}.radius", add=-1.0)]
    for name in node.surfaces:
        surface = config.surfaces[name]
        if surface.kind == "line" and surface.normal is not None:
            return [
                Change(path=f"surfaces.{name}.point.{axis}", add=-n)
                for axis, n in zip("xy", surface.normal, strict=True)
                if n != 0.0
            ]
    return None
