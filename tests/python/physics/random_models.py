"""Random valid mechanisms: trees of bodies on springs, any surface, any law, any stroke."""

from __future__ import annotations

import math
import random
from typing import Any

LAWS_OF_CURVES = ("guarded", "printed", "mean", "hunt_crossley", "stulov", "felt_memory")
LAWS = (*LAWS_OF_CURVES, "micromechanical")


def curve(rng: random.Random, scale: float) -> dict[str, float]:
    """Coefficients of eq. 4.21 of a soft or hard felt."""
    return {
        "a": scale * 10 ** rng.uniform(1, 3),
        "b": 10 ** rng.uniform(1.5, 3.0),
        "c": scale * 10 ** rng.uniform(1, 3),
    }


def memory(rng: random.Random) -> dict[str, float]:
    """What a felt remembers, with recovery, creep and rate or without."""
    out = {"kappa": rng.uniform(0.05, 2.0)}
    out["closing_compression"] = 10 ** rng.uniform(-3, -1.8)
    if rng.random() < 0.4:
        out["recovery_time"] = 10 ** rng.uniform(-3, 2)
    if rng.random() < 0.4:
        out["creep_stiffness"] = 10 ** rng.uniform(2, 5)
        out["creep_damping"] = 10 ** rng.uniform(0, 3)
    if rng.random() < 0.4:
        out["rate_amplitude"] = rng.uniform(0.0, 0.6)
        out["rate_time"] = 10 ** rng.uniform(-5, -1)
    return out


def layer(rng: random.Random) -> dict[str, Any]:
    """A packaged felt of any thickness under any indenter, even or by columns."""
    import feltmb.felt

    thickness = 10 ** rng.uniform(-3.3, -2.0)
    radius = 10 ** rng.uniform(-3.3, -1.5)
    width = 10 ** rng.uniform(-3.0, -1.7)
    area = rng.choice(
        (
            {"kind": "constant", "size": width * radius},
            {"kind": "crossed_cylinders", "radius_a": radius, "radius_b": 0.3 * width},
            {"kind": "circle_on_layer", "radius": radius, "width": width, "length": 2.0 * width},
            {"kind": "circle_on_layer", "radius": radius, "width": width},
            {"kind": "sphere_on_layer", "radius": radius},
        )
    )
    remembered = memory(rng)
    del remembered["closing_compression"]  # the felt's own
    return {
        "felt": rng.choice(feltmb.felt.packaged_materials()),
        "thickness": thickness,
        "area": area,
        "compression": rng.choice(("even", "columns")),
        **remembered,
    }


def contact(
    rng: random.Random, surfaces: list[str], friction: bool, laws: tuple[str, ...]
) -> dict[str, Any]:
    """A contact with a random law and the parameters that it needs."""
    law = rng.choice(laws)
    loading = curve(rng, 1.0)
    # The unloading curve lies below: part of each coefficient.
    share = rng.uniform(0.2, 0.95)
    out: dict[str, Any] = {
        "surfaces": surfaces,
        "law": law,
        "alpha": 10 ** rng.uniform(0, 3),
        "loading": loading,
        "unloading": {"a": share * loading["a"], "b": loading["b"], "c": share * loading["c"]},
    }
    if law == "hunt_crossley":
        p = rng.uniform(1.0, 3.5)
        out["hunt_crossley"] = {
            "stiffness": 10 ** rng.uniform(2.0, 3.0) * (1e-3) ** (1.0 - p),
            "exponent": p,
            "damping": rng.choice((0.0, 10 ** rng.uniform(-2, 0))),
        }
    if law == "stulov":
        p = rng.uniform(1.0, 3.5)
        out["stulov"] = {
            "stiffness": 10 ** rng.uniform(2.0, 3.0) * (1e-3) ** (1.0 - p),
            "exponent": p,
            "amplitude": rng.uniform(0.0, 0.95),
            "time": 10 ** rng.uniform(-6, -2),
        }
    if law == "felt_memory":
        out["memory"] = memory(rng)
    if law == "micromechanical":
        out["micromechanical"] = layer(rng)
    if friction and rng.random() < 0.6:
        out["friction"] = {
            "amplitude": rng.uniform(0.05, 0.6),
            "b1": rng.choice((0.0, rng.uniform(0, 1))),
            "b2": rng.choice((0.0, rng.uniform(0, 1))),
            "threshold_speed": 10 ** rng.uniform(-3, -1.5),
        }
    return out


def mechanism(rng: random.Random, laws: tuple[str, ...] = LAWS) -> dict[str, Any]:
    """Tables of a random mechanism of one to four bodies."""
    bodies: dict[str, Any] = {}
    springs: dict[str, Any] = {}
    surfaces: dict[str, Any] = {}
    contacts: dict[str, Any] = {}
    points: dict[str, Any] = {}
    places: dict[str, tuple[float, float]] = {"ground": (0.0, 0.0)}
    number = 0
    for k in range(rng.randint(1, 4)):
        name = f"body{k}"
        parent = "ground" if rng.random() < 0.5 or not bodies else rng.choice(list(bodies))
        at = (rng.uniform(-0.2, 0.2), rng.uniform(-0.2, 0.2))
        slides = rng.random() < 0.25
        tilt = rng.uniform(0.0, 2.0 * math.pi)
        mass = 10 ** rng.uniform(-3, -0.5)
        arm = (rng.uniform(-0.1, 0.1), rng.uniform(-0.1, 0.1))
        bodies[name] = {
            "parent": parent,
            "joint": "prismatic" if slides else "revolute",
            "coordinate": f"{name}.q",
            "position": list(at),
            "axis": [math.cos(tilt), math.sin(tilt)],
            "mass": mass,
            "center_of_mass": list(arm),
            "inertia": mass * 10 ** rng.uniform(-5, -3),
        }
        if rng.random() < 0.4:
            bodies[name]["friction"] = {
                "amplitude": 10 ** rng.uniform(-4, -2),
                "threshold_speed": 10 ** rng.uniform(-3, -1),
            }
        places[name] = (places[parent][0] + at[0], places[parent][1] + at[1])
        # Without a spring nothing would hold a body that no surface is under.
        springs[f"spring{k}"] = {
            "coordinate": f"{name}.q",
            "stiffness": 10 ** (rng.uniform(1, 3) if slides else rng.uniform(-0.5, 1.5)),
            "rest_angle": 0.0 if slides else rng.uniform(-0.1, 0.1),
        }
        points[f"point{k}"] = {"body": name, "point": list(arm)}
        for _ in range(rng.randint(0, 2)):
            number += 1
            tip = (rng.uniform(-0.12, 0.12), rng.uniform(-0.12, 0.12))
            radius = rng.choice((0.0, 10 ** rng.uniform(-3, -1.7)))
            surfaces[f"S{number}a"] = {
                "body": name, "kind": "circle", "point": list(tip), "radius": radius,
            }  # fmt: skip
            world = (places[name][0] + tip[0], places[name][1] + tip[1])
            others = [b for b in bodies if b != name and b != parent]
            other = "ground" if rng.random() < 0.7 or not others else rng.choice(others)
            way = rng.uniform(0.0, 2.0 * math.pi)
            n = (math.cos(way), math.sin(way))
            gap = rng.uniform(-2e-3, 8e-3)
            foot = [world[i] - places[other][i] - (radius + gap) * n[i] for i in (0, 1)]
            kind = rng.choice(("line", "line", "circle", "concave"))
            facing: dict[str, Any] = {"body": other, "kind": kind}
            if kind == "line":
                facing |= {"point": foot, "normal": list(n)}
            elif kind == "circle":
                size = 10 ** rng.uniform(-2.5, -1)
                facing |= {"point": [foot[i] - size * n[i] for i in (0, 1)], "radius": size}
            else:
                size = radius + 10 ** rng.uniform(-1.5, 0)
                facing |= {"point": [foot[i] + size * n[i] for i in (0, 1)], "radius": size}
            surfaces[f"S{number}b"] = facing
            contacts[f"{number:02d}"] = contact(
                rng, [f"S{number}a", f"S{number}b"], friction=True, laws=laws
            )
    pressed = rng.choice(list(bodies))
    way = rng.uniform(0.0, 2.0 * math.pi)
    return {
        "schema": 1,
        "name": "random",
        "bodies": bodies,
        "surfaces": surfaces,
        "contacts": contacts,
        "springs": springs,
        "points": points,
        "finger": {
            "body": pressed,
            "point": [rng.uniform(-0.1, 0.1), rng.uniform(-0.1, 0.1)],
            "direction": [math.cos(way), math.sin(way)],
        },
    }


def stroke(rng: random.Random) -> Any:
    """A force or a motion of the finger."""
    import feltmb

    duration = rng.uniform(0.02, 0.06)
    if rng.random() < 0.3:
        start = rng.uniform(0.001, 0.1 * duration)
        return feltmb.motion_stroke(
            [0.0, start, start + rng.uniform(0.25, 0.6) * duration, duration],
            [0.0, 0.0, rng.uniform(1e-3, 8e-3), rng.uniform(0.0, 8e-3)],
            duration=duration,
        )
    start, end = sorted(rng.uniform(0.0, 0.8 * duration) for _ in range(2))
    force = rng.choice((1.0, -1.0)) * 10 ** rng.uniform(-1.5, 1.0)
    return feltmb.ramp_stroke(force, start, end + 1e-4, duration=duration)
