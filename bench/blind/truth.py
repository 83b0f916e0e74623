"""Generator of the blind bench: the machine as it "really" is.

Shares no code with the engine, the model or the force laws; it must not import from feltmb. Its
own table of parameters, its own integrator (semi-implicit Euler, 1/20 of the model's step,
vectorized over strokes), sharper friction, and a second functional form of every effect.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FRAME = 0.5e-3  # camera and input sensor [s]
STEP = FRAME / 80.0  # [s]
KEEP = 4  # steps between stored positions
LENGTH = 0.25  # of a record [s]
FIT = ("piano", "mezzo", "staccato")
HELD_OUT = ("forte", "repetition")
STROKES = FIT + HELD_OUT
ACTUATOR_STIFFNESS, ACTUATOR_DAMPING = 2.0e4, 20.0
RATIO = 5.0

#: What a drawing and a data sheet say: value and tolerance (1 sd). SI.
DRAWN = {
    "key_mass": (0.080, 0.0024),
    "hammer_mass": (0.0090, 0.00027),
    "jack_stiffness": (1.5e5, 1.2e4),
    "letoff_position": (8.2e-3, 4.0e-5),
    "bed_stiffness": (5.0e7, 4.0e6),
    "bed_exponent": (2.0, 0.1),
    "bed_position": (9.6e-3, 0.2e-3),
    "string_stiffness": (1.5e8, 1.2e7),
    "string_exponent": (2.4, 0.1),
    "check_position": (30.0e-3, 0.5e-3),
    "key_damping": (1.0, 0.2),
    "hammer_damping": (0.020, 0.004),
    "key_balance": (0.25, 0.05),
    "hammer_spring_rate": (2.0, 0.16),
}
SKEW = (0.0, 0.3e-3)  # hammer camera behind the key camera, uniform [s]
#: Changes from stroke to stroke by 1 %.
WANDERING = ("jack_stiffness", "bed_stiffness", "string_stiffness", "key_damping", "hammer_damping")

#: component and onset of every effect; an onset is what must have happened first.
EFFECTS: dict[str, tuple[str, str]] = {
    "key_dry_friction": ("key pivot", "key"),
    "hammer_dry_friction": ("hammer pivot", "key"),
    "hammer_drag": ("hammer", "key"),
    "spring_preload": ("butt spring", "key"),
    "hammer_bridle": ("bridle strap", "letoff"),
    "jack_hysteresis": ("jack felt", "key"),
    "bed_hysteresis": ("bed felt", "bed"),
    "string_hysteresis": ("string felt", "string"),
    "bed_creep": ("bed felt", "bed"),
    "string_compliance": ("string", "string"),
    "shank_flexibility": ("shank", "key"),
    "lost_motion": ("jack felt", "key"),
    "hammer_wear": ("string felt", "string"),
    "check_friction": ("backcheck", "check"),
    "rest_felt_hardening": ("back rail", "start"),
    "key_flexibility": ("key", "key"),
    "key_spring": ("key", "key"),
    "input_gain": ("input", "key"),
    "input_offset": ("input", "start"),
    "input_delay": ("input", "key"),
    "hammer_scale": ("hammer camera", "key"),
    "hammer_offset": ("hammer camera", "start"),
}
#: Magnitudes that can be negative as well.
BOTH_SIGNS = {
    "spring_preload", "bed_hysteresis", "string_hysteresis", "hammer_wear", "check_friction",
    "rest_felt_hardening", "key_spring", "input_gain", "input_offset", "input_delay",
    "hammer_scale", "hammer_offset",
}  # fmt: skip
#: Largest plausible magnitude: what would need more to stand out so far is not drawn.
LARGEST = {
    "key_dry_friction": 0.5, "hammer_dry_friction": 0.1, "hammer_drag": 0.03,
    "spring_preload": 0.045, "hammer_bridle": 60.0, "jack_hysteresis": 3.0, "bed_hysteresis": 0.8,
    "string_hysteresis": 0.13, "bed_creep": 2e-4, "string_compliance": 4e-5,
    "shank_flexibility": 4e-4, "lost_motion": 1.5e-3, "hammer_wear": 1.5e-3, "check_friction": 4.5,
    "rest_felt_hardening": 9e5, "key_flexibility": 3e-4, "key_spring": 60.0, "input_gain": 0.2,
    "input_offset": 0.5, "input_delay": 2e-3, "hammer_scale": 0.05, "hammer_offset": 2e-3,
}  # fmt: skip


@dataclass(frozen=True)
class Part:
    """One withheld effect of a case."""

    name: str
    form: str
    """A: the library's functional form; B: another; outside: a kind that no library holds."""
    size: float
    """In the library's unit; for kinds from outside in their own."""
    target: float
    """Noncentrality that the magnitude was chosen for."""


@dataclass
class Case:
    """Truth of one case; everything random in it comes from the seed."""

    number: int
    mode: str
    parts: list[Part]
    parameters: dict[str, list[float]]
    """By name, one value a stroke."""
    strokes: list[dict[str, Any]]
    skew: float
    seed: list[int] = field(default_factory=list)


def draw(
    seed: int,
    number: int,
    scales: Mapping[str, Mapping[str, float]],
    outside: Mapping[str, float],
    *,
    mix: Sequence[float] = (0.25, 0.45, 0.15, 0.05, 0.10),
) -> Case:
    """Draw the truth of a case.

    ``scales``: {mode: {"name:form": noncentrality per unit of magnitude}}; ``outside``: kinds from
    outside with their largest magnitudes. ``mix``: shares of none, one, two, three effects,
    outside.
    """
    rng = np.random.default_rng([seed, number, 1])
    mode = "force" if rng.random() < 0.5 else "motion"
    kind = int(rng.choice(5, p=np.asarray(mix) / np.sum(mix)))
    pool = (
        [(name, "outside", limit) for name, limit in sorted(outside.items())]
        if kind == 4
        else [(name, form, _largest(name, mode)) for name in sorted(EFFECTS) for form in "AB"]
    )
    weakest = 5.0 if kind == 4 else 0.5
    parts: list[Part] = []
    while len(parts) < (1 if kind == 4 else kind):
        target = float(np.exp(rng.uniform(np.log(weakest), np.log(50.0))))
        # Of the causes that can stand out so far at a plausible magnitude.
        able = [
            (name, form, target / scales[mode][f"{name}:{form}"])
            for name, form, limit in pool
            if limit * scales[mode][f"{name}:{form}"] >= target
            and all(name != q.name for q in parts)
        ]
        if not able:
            continue
        names = sorted({name for name, _, _ in able})
        name = names[int(rng.integers(len(names)))]
        forms = [(form, size) for other, form, size in able if other == name]
        form, size = forms[int(rng.integers(len(forms)))]
        if name in BOTH_SIGNS and rng.random() < 0.5:
            size = -size
        parts.append(Part(name, form, float(size), target))
    n = len(STROKES)
    parameters = {}
    for name, (value, sd) in DRAWN.items():
        own = value + sd * float(np.clip(rng.standard_normal(), -2.5, 2.5))
        wander = rng.standard_normal(n) * (0.01 if name in WANDERING else 0.0)
        parameters[name] = [float(v) for v in own * (1.0 + wander)]
    parameters["gate_width"] = [float(1e-4 * (1.0 + 0.1 * rng.standard_normal()))] * n
    parameters["start_key"] = [float(v) for v in 5e-5 * rng.standard_normal(n)]
    parameters["start_hammer"] = [float(v) for v in 1e-4 * rng.standard_normal(n)]
    strokes = [
        {
            "strength": float(np.exp(0.10 * rng.standard_normal())),
            "speed": float(np.exp(0.10 * rng.standard_normal())),
            "shape": float(rng.uniform(0.0, 0.15)),
        }
        for _ in range(n)
    ]
    return Case(number, mode, parts, parameters, strokes, float(rng.uniform(*SKEW)), [seed, number])


def _largest(name: str, mode: str) -> float:
    return 1.0 if name == "input_offset" and mode == "motion" else LARGEST[name]


def plain_case(mode: str, parts: Sequence[Part] = ()) -> Case:
    """Drawing values, plain strokes, no jitter: for the calibration of magnitudes."""
    n = len(STROKES)
    parameters = {name: [value] * n for name, (value, _) in DRAWN.items()}
    parameters |= {"gate_width": [1e-4] * n, "start_key": [0.0] * n, "start_hammer": [0.0] * n}
    strokes = [{"strength": 1.0, "speed": 1.0, "shape": 0.05} for _ in range(n)]
    return Case(0, mode, list(parts), parameters, strokes, 0.5 * sum(SKEW))


# ---------------------------------------------------------------- what the player does


def _ease(t: Array, start: Array | float, duration: Array | float) -> Array:
    """Smooth step from 0 to 1 with zero speed and acceleration at both ends."""
    s = np.clip((t - start) / duration, 0.0, 1.0)
    return s * s * s * (10.0 + s * (6.0 * s - 15.0))


FORCES = {  # force [N], rise [s], release [s] or 0
    "piano": (2.4, 0.025, 0.0),
    "mezzo": (4.2, 0.020, 0.0),
    "staccato": (8.0, 0.014, 0.040),
    "forte": (10.5, 0.015, 0.0),
    "repetition": (5.5, 0.015, 0.070),
}
MOTIONS = {  # travel [m], time of the travel [s], release [s] or 0
    "piano": (9.9e-3, 0.110, 0.0),
    "mezzo": (10.0e-3, 0.070, 0.0),
    "staccato": (10.0e-3, 0.045, 0.060),
    "forte": (10.2e-3, 0.038, 0.0),
    "repetition": (10.0e-3, 0.060, 0.080),
}
SECOND = 0.130  # of a repetition [s]


def played(t: Array, mode: str, stroke: str, own: Mapping[str, Any]) -> Array:
    """Force [N] or motion [m] of the finger at the times t; ``own["profile"]``: times and values
    of a request, which are played as they are."""
    if "profile" in own:
        times, values = own["profile"]
        return np.asarray(np.interp(t, times, values))
    table = FORCES if mode == "force" else MOTIONS
    level, rise, release = table[stroke]
    if mode == "force":
        level *= own["strength"]
    rise /= own["speed"]

    def impact(start: float, until: float) -> Array:
        u = _ease(t, start, rise)
        # A finger sags a little while it follows the key.
        sag = float(own["shape"])
        u = u * (1.0 - sag * np.sin(np.pi * np.clip((t - start) / 0.05, 0.0, 1.0)) ** 2)
        return u * (1.0 - _ease(t, until, 0.02)) if until > 0.0 else u

    u = impact(0.010, 0.010 + release if release > 0.0 else 0.0)
    if stroke == "repetition":
        u = u + impact(SECOND, 0.0)
    return np.asarray(level * u, dtype=np.float64)


def load_outside(module: ModuleType) -> dict[str, Any]:
    """Kinds from outside of a module: its ``KINDS``, by name."""
    return {kind.name: kind for kind in module.KINDS}
