"""Warnings of completed runs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from feltmb import _core
from feltmb.mechanism import Action
from feltmb.run.stroke import PRESCRIBED, Stroke

#: Fraction by which the measured loop of a felt may be exceeded without a warning.
PASSED = 1e-3
#: Ratio of deflection to length of a member above which its equations are not valid.
BENT = 0.25
#: Force of a finger, as a share of the largest, that is not noise of the load cell.
FINGER = 0.02
#: Force of a contact at rest, in weights of all parts and forces of springs, above which parts jam
#: each other. Packaged mechanisms have 0.5 at most; parts pushed past each other had 38 to 370.
JAMMED = 20.0
#: Smallest lever by which the torque of a spring becomes a force [m].
LEVER = 1e-3
#: Rotation of a motor above which its arm swings and no longer presses [rad].
SWING = math.pi / 4


def run_warnings(
    action: Action, stroke: Stroke, options: Any, result: Any, energy: Mapping[str, Any]
) -> list[str]:
    """Warnings about the accuracy, the input, or the validity of the equations of a run."""
    out = list(action.doubts)
    residual = energy.get("residual_relative", 0.0)
    if residual > 1e-3:
        out.append(
            f"the energy balance error is {100 * residual:.2g} % of the exchanged energy at "
            f"rtol {options.rtol:g}: use a smaller rtol"
        )
    out += _of_rest(action) + _of_members(result)
    return (
        out
        + _of_input(action, stroke, result)
        + _of_motor(action, result)
        + _of_felts(action, result)
    )


def _of_rest(action: Action) -> list[str]:
    """Contacts that carry far more at rest than the weights and the springs can cause."""
    config, rest = action.config, action.rest_pose
    at = _core.evaluate(action.mechanism, rest, np.zeros(len(action.coordinates)))
    if not at["contacts"]:
        return []
    number, force = max(((row[0], abs(row[3])) for row in at["contacts"]), key=lambda r: r[1])
    mass = sum(
        b.mass + (b.density or 0.0) * (b.area or 0.0) * (b.length or 0.0)
        for b in config.bodies.values()
    )
    weight = mass * math.hypot(*config.gravity)
    springs = 0.0
    for spring in config.springs.values():
        if spring.enabled:
            angle = rest[action.coordinates.index(spring.coordinate)]
            load = abs(spring.stiffness * (angle - spring.rest_angle))
            springs += load / _lever(action, spring.coordinate)
    if force <= JAMMED * (weight + springs):
        return []
    key = f"{number:02d}"
    contact = config.contacts[key]
    name = f"contact {key} {contact.label}".strip()
    also = f" and the springs press by {springs:.3g} N" if springs else ""
    return [
        f"{name} is pressed by {force:.3g} N at rest, before any input; all parts weigh "
        f"{weight:.3g} N{also}: parts are jammed; check the surfaces "
        f"{' and '.join(contact.surfaces)} and start_pose"
    ]


def _lever(action: Action, coordinate: str) -> float:
    """Distance from a joint to the nearest surface of its body [m]; 1 for a prismatic joint."""
    for name, body in action.config.bodies.items():
        if body.coordinate == coordinate and body.joint == "prismatic":
            return 1.0
        if body.coordinate == coordinate:
            points = [s.point for s in action.config.surfaces.values() if s.body == name]
            return max(LEVER, min((math.hypot(*p) for p in points), default=LEVER))
    return LEVER


def _of_members(result: Any) -> list[str]:
    """Members whose deflection exceeds the range of the equations for small deflections."""
    return [
        f"member {name} of {1e3 * length:.3g} mm is deflected by {1e3 * largest:.3g} mm at "
        f"{time:.4f} s, more than a quarter of its length: the model assumes small deflections"
        for name, length, largest, time in result.deflections
        if largest > BENT * length
    ]


def _of_input(action: Action, stroke: Stroke, result: Any) -> list[str]:
    """Whether the input can be that of a finger, and is not noise."""
    finger = action.config.finger
    pressed = finger.body if finger is not None else "mechanism"
    if stroke.kind == "force":
        return _of_force(stroke, pressed)
    if stroke.kind not in PRESCRIBED:
        return []
    out = []
    noise = stroke.noise
    if noise > 0.0:
        step = (stroke.time[-1] - stroke.time[0]) / (len(stroke.time) - 1)
        jitter = np.sqrt(6.0) * noise / step**2
        largest = float(np.max(np.abs(stroke.smoothed(noise).profile.acceleration(stroke.time))))
        if jitter > 0.2 * largest:
            out.append(
                f"the noise of the record, about {noise:.2g} {stroke.unit}, causes accelerations "
                f"of {jitter:.2g} {stroke.unit}/s^2 between samples, and the motion itself has "
                f"{largest:.2g}: the reaction is mostly noise; smooth the record (--noise, "
                "Stroke.smoothed)"
            )
    names = list(result.names)
    if stroke.kind == "key_motion" and "finger.force" in names and result.time.size:
        force = result.data[:, names.index("finger.force")]
        lowest = int(np.argmin(force))
        if force[lowest] < -FINGER * max(1.0, float(np.max(force))):
            out.append(
                f"the prescribed {pressed} motion requires a finger that pulls with "
                f"{-force[lowest]:.3g} N at {result.time[lowest]:.4f} s: a real finger would "
                f"leave the {pressed}"
            )
    return out


def _of_force(stroke: Stroke, pressed: str) -> list[str]:
    """Whether a force may have a wrong sign or zero."""
    value = np.asarray(stroke.value)
    lowest, small = int(np.argmin(value)), FINGER * max(1.0, float(np.max(value)))
    out = []
    if value[lowest] < -small:
        out.append(
            f"the force of the finger is {value[lowest]:.3g} N at {stroke.time[lowest]:.4f} s: a "
            f"finger cannot pull the {pressed} (is the sign or the zero of the load cell wrong?)"
        )
    if value[0] > small:
        out.append(
            f"the force of the finger begins with {value[0]:.3g} N, on a mechanism at rest without "
            "this force (is the zero of the load cell wrong?)"
        )
    return out


def _of_motor(action: Action, result: Any) -> list[str]:
    """Whether the arm of a motor still presses the key."""
    motor = action.config.motor
    if motor is None or not result.time.size:
        return []
    angle = result.states[:, action.coordinates.index(motor.coordinate)]
    turned = np.abs(angle - angle[0])
    if turned.max() <= SWING:
        return []
    at = int(np.argmax(turned > SWING))
    return [
        f"{motor.coordinate} turns by {math.degrees(turned.max()):.0f} degrees, by more than "
        f"{math.degrees(SWING):.0f} from {result.time[at]:.4f} s on: its arm swings round instead "
        "of pressing"
    ]


def _of_felts(action: Action, result: Any) -> list[str]:
    """Felts that were compressed beyond the range of their measurement."""
    out = []
    numbers = action.mechanism.contact_numbers
    largest = dict(zip(numbers, result.end_largest_compression, strict=False))
    for key, contact in action.config.contacts.items():
        layer = contact.micromechanical
        if contact.law != "micromechanical" or layer is None or not contact.enabled:
            continue
        felt, thickness = layer.felt, layer.thickness
        reached = largest.get(int(key), 0.0)
        end = thickness * (1.0 - felt.v_f0 / felt.end)
        if reached <= end * (1.0 + PASSED):
            continue
        densest = thickness * (1.0 - felt.v_f0)
        where = (
            f"beyond the {1e3 * densest:.3g} mm at which it is solid"
            if reached >= densest
            else f"beyond the end of its measured loop, {1e3 * end:.3g} mm at v_f_max = "
            f"{felt.end:.3g}"
        )
        out.append(
            f"contact {key}: the felt is compressed by {1e3 * reached:.3g} mm of its "
            f"{1e3 * thickness:.3g} mm, {where}: forces there are extrapolated"
        )
    return out
