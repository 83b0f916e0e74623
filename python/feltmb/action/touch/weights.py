"""Weights that technicians keep, and the parts of the balance weight."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from feltmb import _core
from feltmb.mechanism import Action
from feltmb.mechanism.workshop import (
    key_ratio,
    moment_about,
    strike_weight,
    welded_to,
)

if TYPE_CHECKING:
    from feltmb.action.touch.static import StaticTouch


@dataclass(frozen=True)
class Weights:
    """Weights of parts as weighed, ratios, and what each part adds to the balance weight."""

    strike_weight: float  #: hammer on a scale with a level shank [kg]
    whippen_weight: float  #: whippen with jack and backcheck on a scale below its heel [kg]
    front_weight: float  #: key with all that is on it on a scale below the finger's point [kg]
    key_ratio: float  #: distance of the capstan from the balance rail by that of the finger
    action_ratio: float  #: travel of the hammer by that of the finger, mean over the window
    hammer_share: float  #: part of the strike weight that the key carries, by the lean of the shank
    parts: Mapping[str, float]  #: balance weight by parts: key, whippen, hammer, springs, other [N]


def weights(action: Action, static: StaticTouch) -> Weights | None:
    """Weights of an action; None if its file does not say which parts are weighed.

    The parts of the balance weight follow from virtual work: the work of their weight or spring
    between the ends of the window of the weights, by the travel of the finger.
    """
    import numpy as np

    config = action.config
    roles, finger, striker = config.reading.weights, config.finger, config.reading.striker
    strike = config.reading.strike_contact
    if roles is None or finger is None or striker is None or strike is None:
        return None
    path = static.lifted_press
    inside = np.flatnonzero((path.travel >= static.window[0]) & (path.travel <= static.window[1]))
    rows = inside[np.unique(np.linspace(0, inside.size - 1, 40).astype(int))]
    travel = float(path.travel[rows[-1]] - path.travel[rows[0]])
    poses = path.pose[rows]

    # Generalized force of gravity: that with it, less that without it.
    floating = action.with_values({"gravity": [0.0, 0.0]})
    still = np.zeros(len(action.coordinates))
    pull = np.array(
        [
            np.subtract(
                *(_core.evaluate(a.mechanism, q, still)["force"] for a in (action, floating))
            )
            for q in poses
        ]
    )
    work = -np.sum(0.5 * (pull[1:] + pull[:-1]) * np.diff(poses, axis=0), axis=0) / travel
    hammer, whippen = (welded_to(config, name) for name in (roles.hammer, roles.whippen))
    whippen |= {name for name, body in config.bodies.items() if body.parent in whippen}
    key = {finger.body, config.bodies[finger.body].parent}
    owners = {body.coordinate: name for name, body in config.bodies.items() if body.coordinate}
    groups = {"key": key - hammer - whippen, "whippen": whippen - hammer, "hammer": hammer}
    parts = dict.fromkeys(groups, 0.0)
    for name, amount in zip(action.coordinates, work, strict=True):
        owner = owners.get(name, name.partition(".")[0])
        for group, bodies in groups.items():
            parts[group] += float(amount) * (owner in bodies)
    for name, spring in config.springs.items():
        if not spring.enabled:
            continue
        k = action.coordinates.index(spring.coordinate)
        first, last = (float(poses[i][k]) - float(spring.rest_angle) for i in (0, -1))
        parts[name] = 0.5 * float(spring.stiffness) * (last**2 - first**2) / travel
    parts["others"] = static.balance_weight - sum(parts.values())
    gap = path.gap[strike][rows]
    ratio = float(gap[0] - gap[-1]) / travel
    weight, _ = strike_weight(config)
    g = float(np.hypot(*config.gravity))
    heel = config.surfaces[_heel(action, roles.capstan)].point[0]
    return Weights(
        strike_weight=weight,
        whippen_weight=moment_about(config, roles.whippen, whippen) / heel,
        front_weight=moment_about(config, finger.body, welded_to(config, finger.body))
        / finger.point[0],
        key_ratio=key_ratio(config),
        action_ratio=ratio,
        hammer_share=parts["hammer"] / (weight * g * ratio),
        parts=parts,
    )


def _heel(action: Action, capstan: str) -> str:
    """The surface that the capstan lifts."""
    for contact in action.config.contacts.values():
        if capstan in contact.surfaces:
            return next(name for name in contact.surfaces if name != capstan)
    return capstan
