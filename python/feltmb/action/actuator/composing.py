"""Actuator and action in one system: the input is the motor torque, the output is a stroke.

The thesis replaced the action by an equivalent reaction and left the coupled system to future work
(sections 5.3 and 6.2). Here hub, arm and tip become bodies of the action's mechanism. The tip
presses the key through its own contact.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from feltmb import _core
from feltmb.action.actuator.model import Actuator, Section, load_actuator
from feltmb.mechanism import Action, load_action
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

#: Names that the actuator adds; a mechanism must not use them.
HUB, ARM, TIP = "actuator_hub", "actuator_arm", "actuator_tip"
COORDINATE = "actuator.hub"
FINGER, KEY_TOP = "actuator_finger", "actuator_key_top"


def _faults_of_action(action: Action) -> Iterator[str]:
    """Why an actuator cannot press an action."""
    config = action.config
    if config.finger is None:
        yield f"mechanism {action.name!r} describes no finger, where the actuator presses"
    if config.motor is not None:
        yield f"mechanism {action.name!r} has a motor already"
    taken = [n for n in (HUB, ARM, TIP) if n in config.bodies]
    taken += [n for n in (FINGER, KEY_TOP) if n in config.surfaces]
    if taken:
        yield f"mechanism {action.name!r} uses the names {', '.join(taken)} already"


def _faults_of_mount(actuator: Actuator, pad: str) -> Iterator[str]:
    """Why an actuator cannot stand over a key."""
    mount = actuator.config.mount
    if mount is None:
        yield f"actuator {actuator.name!r} has no [mount]: how it stands over a key"
    elif pad not in mount.pads:
        yield f"pad {pad!r} is unknown; pads are {', '.join(mount.pads) or 'none'}"
    if actuator.config.tip.placement != "across":
        yield "a tip mass along the arm does not fit over a key; use placement 'across'"


@checked
def compose(action: Action | str, actuator: Actuator | str, *, pad: str | None = None) -> Action:
    """Mechanism of an action whose key is pressed by an actuator.

    Adds the bodies ``actuator_hub`` (revolute, coordinate ``actuator.hub``, positive pressing),
    ``actuator_arm`` (flexible beam; several for an arm of several sections) and ``actuator_tip``.
    The tip mass has the distance ``r`` from the arm toward the key. A contact acts between the
    finger and a plane through the action's finger point. The damper of the actuator and ``[motor]``
    are added too. At rest the arm is horizontal above the key and comes from the player's side. The
    key's own stop and the action replace the actuator's stop and equivalent reaction.

    Parameters
    ----------
    pad
        Name in ``[mount.pads]`` of the actuator, such as ``pulp`` or ``felt``; default: the pad of
        the actuator file.

    Raises
    ------
    InvalidParameter
        The action has no finger or already has a motor, the actuator has no ``[mount]``, the pad is
        unknown, or names are used twice.
    """
    action = load_action(action) if isinstance(action, str) else action
    actuator = load_actuator(actuator) if isinstance(actuator, str) else actuator
    config, mount = action.config, actuator.config.mount
    chosen = pad or (mount.pad if mount is not None else "")
    if faults := [*_faults_of_action(action), *_faults_of_mount(actuator, chosen)]:
        raise InvalidParameter("compose: " + "; ".join(faults))
    assert config.finger is not None
    assert mount is not None

    raw = action.raw
    point, normal = _key_at_rest(action)
    direction = config.finger.direction
    along = (direction[1], -direction[0])  # the arm: counterclockwise rotation presses
    end = [point[i] - mount.finger_height * direction[i] for i in (0, 1)]
    hub = [end[i] - actuator.reach * along[i] for i in (0, 1)]
    number = max([16, *(int(key) for key in config.contacts)]) + 1
    _add_arm(raw, actuator, hub, math.atan2(along[1], along[0]))
    surfaces = raw.setdefault("surfaces", {})
    surfaces[FINGER] = {
        "body": TIP,
        "kind": "circle",
        "point": [0.0, mount.finger_height - mount.finger_radius],
        "radius": mount.finger_radius,
    }
    surfaces[KEY_TOP] = {
        "body": config.finger.body,
        "kind": "line",
        "point": list(config.finger.point),
        "normal": list(normal),
    }
    contact = dict(actuator.raw["mount"]["pads"][chosen])
    contact.update(label=f"actuator finger - key ({chosen})", surfaces=[FINGER, KEY_TOP])
    raw.setdefault("contacts", {})[f"{number:02d}"] = contact
    raw["motor"] = {"coordinate": COORDINATE, "contact": number}
    raw["name"] = f"{action.name}+{actuator.name}"
    return Action(raw, origin=f"{action.origin} with {actuator.origin}")


@checked
def stand_alone(actuator: Actuator | str) -> Action:
    """The actuator with its own stop as a mechanism, without an equivalent reaction.

    It has the same physics as :func:`simulate_actuator` but other methods: geometrically exact
    joints, shape functions of the arm, multistep integration. Gravity is perpendicular to the arm
    at angle zero.
    """
    actuator = load_actuator(actuator) if isinstance(actuator, str) else actuator
    stop = actuator.config.stop
    if stop is None or not stop.enabled:
        raise InvalidParameter(f"stand_alone: actuator {actuator.name!r} has no stop")
    raw: dict[str, Any] = {
        "schema": 1,
        "name": actuator.name,
        "gravity": [0.0, -actuator.config.gravity],
        "bodies": {},
        "surfaces": {},
        "contacts": {},
    }
    _add_arm(raw, actuator, [actuator.reach, 0.0], math.pi)
    raw["surfaces"] = {
        FINGER: {"body": TIP, "kind": "circle", "point": [0.0, 0.0], "radius": 0.0},
        KEY_TOP: {
            "body": "ground",
            "kind": "line",
            "point": [0.0, -stop.gap],
            "normal": [0.0, 1.0],
        },
    }
    law = {k: v for k, v in actuator.raw["stop"].items() if k not in ("gap", "note", "enabled")}
    raw["contacts"]["01"] = {**law, "label": "finger - stop", "surfaces": [FINGER, KEY_TOP]}
    raw["motor"] = {"coordinate": COORDINATE, "contact": 1}
    raw["points"] = {"tip": {"body": TIP, "point": [0.0, 0.0]}}
    return Action(raw, origin=actuator.origin)


def _key_at_rest(action: Action) -> tuple[tuple[float, float], tuple[float, float]]:
    """Finger point [m] and outward normal of the key's top there, in the frame of its body."""
    finger = action.config.finger
    assert finger is not None
    # Rotation of the finger's body since its angle was zero.
    x, y, angle = _core.body_poses(action.mechanism, action.rest_pose)[finger.body]
    c, s = math.cos(angle), math.sin(angle)
    px, py = finger.point
    up = (-finger.direction[0], -finger.direction[1])
    point = (x + c * px - s * py, y + s * px + c * py)
    return point, (c * up[0] + s * up[1], -s * up[0] + c * up[1])


def _add_arm(raw: dict[str, Any], actuator: Actuator, hub: list[float], angle: float) -> None:
    config = actuator.config
    bodies: dict[str, Any] = raw["bodies"]
    bodies[HUB] = {
        "label": "hub of the actuator",
        "parent": "ground",
        "joint": "revolute",
        "coordinate": COORDINATE,
        "position": hub,
        "angle": angle,
        "inertia": config.hub.inertia,
    }
    mount = config.mount
    parent, position = HUB, [config.hub.radius, 0.0]
    stretches = config.arm.stretches()
    for i, section in enumerate(stretches):
        name = ARM if len(stretches) == 1 else f"{ARM}_{i + 1}"
        bodies[name] = _beam(section, parent, position, mount.shapes if mount else 2)
        if mount is not None and mount.damping_time:
            bodies[name]["damping_time"] = mount.damping_time
        parent, position = name, [section.length, 0.0]
    # Moment of inertia m r^2 about the end of the arm: the mass has the distance r toward the key.
    bodies[TIP] = {
        "label": "tip of the actuator",
        "parent": parent,
        "joint": "weld",
        "position": position,
        "mass": config.tip.mass,
        "center_of_mass": [0.0, config.tip.eccentricity],
    }
    if config.damper.kind != "none":
        raw.setdefault("dashpots", {})["actuator_damper"] = {
            "coordinate": COORDINATE,
            "coefficient": {"value": config.damper.coefficient, "unit": "N m s/rad"},
            "side": "negative" if config.damper.kind == "one_sided" else "both",
        }


def _beam(section: Section, parent: str, position: list[float], shapes: int) -> Mapping[str, Any]:
    return {
        "label": "arm of the actuator",
        "kind": "beam",
        "rigid": False,
        "shapes": "craig_bampton" if shapes > 1 else "clamped_free",
        "axial_shapes": 0,
        "lateral_shapes": shapes,
        "parent": parent,
        "joint": "weld",
        "position": position,
        **section.model_dump(),
    }
