"""The laws, parameters, causes and accepted answers of the twelve imperfect machines.

In every table ``e`` holds the magnitudes of the causes, 0 for those that a case does not have.
``e["foreign"]`` is the discrepancy: a law that depends on the state and that no candidate has. The
stated models are in :mod:`blind.imperfect.stated`; they share no code with these.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from blind.imperfect.generate import Cause, Table
from blind.imperfect.laws import bristle, bump, dead, iwan, smooth_sign, soft_clip

Array = NDArray[np.float64]
Values = Mapping[str, Any]

__all__ = ["TABLES"]


# ---------------------------------------------------------------- inputs


def tones(rng: np.random.Generator, t: Array, low: float, high: float, rms: float) -> Array:
    """Tones from low to high [Hz] of random phase; they begin within a tenth of the record."""
    pitch = np.linspace(low, high, 15) * (1.0 + 0.02 * rng.standard_normal(15))
    phase = rng.uniform(0.0, 2.0 * np.pi, 15)
    wave = np.sin(2.0 * np.pi * np.outer(t, pitch) + phase).sum(axis=1)
    return np.asarray(rms * np.sqrt(2.0 / 15.0) * wave * np.clip(10.0 * t / t[-1], 0.0, 1.0))


def steps(rng: np.random.Generator, t: Array, count: int, low: float, high: float) -> Array:
    """Levels between low and high that are held for random times, with short ramps."""
    ends = np.sort(rng.uniform(0.02, 1.0, count)) * t[-1]
    levels = np.concatenate([[0.0], rng.uniform(low, high, count)])
    value = levels[np.searchsorted(ends, t)]
    width = 3
    return np.convolve(np.pad(value, (width, width), "edge"), np.full(width, 1 / width), "same")[
        width:-width
    ]


def sweep(rng: np.random.Generator, t: Array, low: float, high: float, size: float) -> Array:
    """Sine whose pitch rises from low to high [Hz]."""
    rate = (high - low) / t[-1]
    phase = 2.0 * np.pi * (low * t + 0.5 * rate * t**2)
    return np.asarray(size * rng.uniform(0.9, 1.1) * np.sin(phase))


def mixed(rng: np.random.Generator, t: Array, k: int, low: float, high: float, rms: float) -> Array:
    """Tones, steps and a sweep in turn; the fourth record has larger tones."""
    if k == 1:
        return steps(rng, t, 14, -1.8 * rms, 1.8 * rms)
    if k == 2:
        return sweep(rng, t, low, high, 1.2 * rms)
    return tones(rng, t, low, high, rms if k == 0 else 1.15 * rms)


# ---------------------------------------------------------------- stage


def stage(x: Any, u: Values, p: Values, e: Values, out: Any) -> None:
    """A stage on a guide with a return spring."""
    q, v, z = x
    drag, out[2] = bristle(v, z, 4e-4, 0.04, 0.3)
    force = soft_clip(u["f"], e["amplifier"]) - p["k"] * q - p["d"] * v
    force -= e["bristles"] * drag + e["bump stop"] * bump(q, 0.012, 0.006)
    force -= e["foreign"] * np.sin(2.0 * np.pi * q / e["wave"] + e["phase"])
    out[0], out[1] = v, force / p["m"]


STAGE = Table(
    name="stage",
    rates=stage,
    states=("q", "v", "z"),
    outputs={"position": lambda x, u, p, e: x[0]},
    parameters={"m": (2.0, 0.08), "d": (8.0, 1.2), "k": (400.0, 20.0)},
    drive=lambda rng, t, k: {"f": mixed(rng, t, k, 0.3, 6.0, 4.0)},
    foreign=0.05,
    varied={"wave": (0.012, 0.02), "phase": (0.0, 6.28)},
    causes=(
        Cause(
            "bristles", 0.2, ("dry friction stage",),
            ("Stribeck friction stage", "hysteresis stage"),
        ),
        Cause(
            "bump stop", 0.5, ("end stop stage",),
            ("quadratic stiffness stage", "cubic stiffness stage"),
        ),
        Cause("amplifier", 0.1, ("saturation of input f",), ("nonlinearity of input f",)),
    ),
    units={"position": "m", "f": "N"},
    step=5e-3,
    samples=1000,
)  # fmt: skip


# ---------------------------------------------------------------- fan


def fan(x: Any, u: Values, p: Values, e: Values, out: Any) -> None:
    """A rotor with blades; a flutter brakes it near one speed."""
    w = x[1]
    torque = u["T"] - p["d"] * w - e["air"] * w * np.abs(w) ** 0.8
    torque -= e["bearing"] * smooth_sign(w, 0.6)
    away = (np.abs(w) - e["speed"]) / 4.0
    torque -= e["foreign"] * np.exp(-away * away) * np.sign(w)
    out[0], out[1] = w, torque / p["J"]


FAN = Table(
    name="fan",
    rates=fan,
    states=("q", "w"),
    outputs={"speed": lambda x, u, p, e: x[1]},
    parameters={"J": (0.02, 8e-4), "d": (0.012, 0.002)},
    drive=lambda rng, t, k: {
        "T": steps(rng, t, 12, -0.5, 0.5) if k != 2 else mixed(rng, t, 0, 0.03, 0.6, 0.3)
    },
    foreign=0.01,
    varied={"speed": (12.0, 18.0)},
    causes=(
        Cause("air", 3e-4, ("quadratic friction rotor",)),
        Cause(
            "bearing", 0.02, ("dry friction rotor",),
            ("Stribeck friction rotor",), {"dry friction rotor": 1.0},
        ),
        Cause(
            "drive lag", 0.05, ("lag of input T", "lag of sensor speed"),
            ("delay of input T", "delay of sensor speed"),
        ),
    ),
    slow={"drive lag": "T"},
    units={"speed": "rad/s", "T": "N m"},
    step=1e-2,
    samples=900,
    substeps=4,
    held_out=2,
)  # fmt: skip


# ---------------------------------------------------------------- servo

KP, KD = 40.0, 0.6  # of its controller, known [N m/rad], [N m s/rad]


def servo(x: Any, u: Values, p: Values, e: Values, out: Any) -> None:
    """An arm at a position controller; its motor cogs."""
    q, v, z = x
    drag, out[2] = bristle(v, z, 6e-3, 0.3, 0.2)
    torque = KP * (u["target"] - q) - KD * v - p["mgl"] * np.sin(q) - p["d"] * v
    torque -= e["gear friction"] * drag + e["air"] * v * np.abs(v) ** 0.75
    torque -= e["foreign"] * np.sin(12.0 * q + e["phase"])
    out[0], out[1] = v, torque / p["J"]


SERVO = Table(
    name="servo",
    rates=servo,
    states=("q", "v", "z"),
    outputs={"angle": lambda x, u, p, e: x[0]},
    parameters={"J": (0.05, 0.003), "d": (0.3, 0.06), "mgl": (1.5, 0.15)},
    drive=lambda rng, t, k: {"target": mixed(rng, t, k, 0.3, 5.0, 0.3)},
    foreign=0.1,
    varied={"phase": (0.0, 6.28)},
    causes=(
        Cause(
            "gear friction", 0.2, ("dry friction arm",),
            ("Stribeck friction arm", "hysteresis arm"),
        ),
        Cause(
            "late command", 4e-3, ("delay of input target", "delay of sensor angle"),
            ("lag of input target", "lag of sensor angle"),
        ),
        Cause("air", 0.02, ("quadratic friction arm",)),
    ),
    late={"late command": "target"},
    units={"angle": "rad", "target": "rad"},
    step=4e-3,
    samples=900,
    substeps=8,
    hold="zero",
)  # fmt: skip


# ---------------------------------------------------------------- pendulum


def pendulum(x: Any, u: Values, p: Values, e: Values, out: Any) -> None:
    """A driven pendulum; a brake of eddy currents acts away from the lowest point."""
    q, w = x
    load = np.abs(np.cos(q) + p["J"] / p["mgl"] * w * w)
    torque = u["T"] - p["mgl"] * np.sin(q) - p["d"] * w
    torque -= e["pivot"] * load * smooth_sign(w, 0.03) + e["air"] * w * np.abs(w) ** 0.9
    torque += e["magnet"] * (q / 0.35) / (1.0 + (q / 0.35) ** 2) ** 2.5
    torque -= e["foreign"] * w * -np.expm1(-((q / e["plate"]) ** 4))
    out[0], out[1] = w, torque / p["J"]


PENDULUM = Table(
    name="pendulum",
    rates=pendulum,
    states=("q", "w"),
    outputs={"angle": lambda x, u, p, e: x[0]},
    parameters={"J": (0.1, 0.003), "mgl": (1.2, 0.036), "d": (0.04, 0.012)},
    drive=lambda rng, t, k: {"T": mixed(rng, t, k, 0.15, 1.5, 0.25)},
    foreign=0.01,
    varied={"plate": (0.5, 0.8)},
    causes=(
        Cause(
            "pivot", 0.01, ("dry friction bob",),
            ("Stribeck friction bob", "quadratic friction bob"),
        ),
        Cause("air", 0.01, ("quadratic friction bob",)),
        Cause(
            "magnet", 0.05, ("dead zone bob",),
            ("cubic stiffness bob", "linear stiffness bob"),
        ),
    ),
    units={"angle": "rad", "T": "N m"},
    step=1e-2,
    samples=1000,
    substeps=4,
    held_out=2,
)  # fmt: skip


# ---------------------------------------------------------------- magnetic spring


def magnet(x: Any, u: Values, p: Values, e: Values, out: Any) -> None:
    """A mass between magnets; its drag rises with the cube of the speed."""
    q, v = x
    s = np.clip(q / 0.04, -0.9, 0.9)
    hardening = 0.25 * (1.0 / (1.0 - s) ** 2 - 1.0 / (1.0 + s) ** 2) - s
    force = u["f"] - p["k"] * dead(q, e["clearance"]) - p["d"] * v
    force -= e["hardening"] * hardening + e["foreign"] * (v / 0.2) ** 3
    out[0], out[1] = v, force / p["m"]


MAGNET = Table(
    name="magnet",
    rates=magnet,
    states=("q", "v"),
    outputs={"hall": lambda x, u, p, e: x[0] - e["field"] * x[0] ** 3 / 0.02**2},
    parameters={"m": (0.5, 0.015), "d": (1.2, 0.25), "k": (200.0, 10.0)},
    drive=lambda rng, t, k: {"f": mixed(rng, t, k, 0.5, 8.0, 1.2)},
    foreign=0.02,
    causes=(
        Cause("hardening", 1.0, ("cubic stiffness mass",), ("end stop mass",)),
        Cause(
            "clearance", 3e-4, ("dead zone mass",),
            ("cubic stiffness mass", "linear stiffness mass"),
        ),
        Cause(
            "field", 0.02, ("nonlinearity of sensor hall",),
            ("gain of sensor hall", "saturation of sensor hall", "gain of input f"),
        ),
    ),
    units={"hall": "m", "f": "N"},
    step=4e-3,
    samples=900,
    substeps=4,
)  # fmt: skip


# ---------------------------------------------------------------- motor


def motor(x: Any, u: Values, p: Values, e: Values, out: Any) -> None:
    """A motor with an amplifier; its winding becomes warm."""
    w, i, warm = x[1], x[2], x[3]
    volts = soft_clip(u["U"], e["amplifier"])
    torque = p["K"] * i - p["d"] * w - e["brushes"] * w / (np.abs(w) + 1.0)
    torque -= e["fan"] * w * np.abs(w) ** 0.9
    out[0], out[1] = w, torque / p["J"]
    out[2] = (volts - p["R"] * (1.0 + e["foreign"] * warm) * i - p["K"] * w) / 5e-3
    out[3] = (i * i - warm) / e["time"]


MOTOR = Table(
    name="motor",
    rates=motor,
    states=("q", "w", "i", "warm"),
    outputs={"speed": lambda x, u, p, e: x[1], "current": lambda x, u, p, e: x[2]},
    parameters={
        "R": (1.0, 0.04), "K": (0.05, 0.0015), "J": (2e-4, 8e-6), "d": (1.5e-4, 4e-5),
    },
    drive=lambda rng, t, k: {"U": mixed(rng, t, k, 0.4, 8.0, 3.0)},
    foreign=0.03,
    varied={"time": (0.6, 1.2)},
    causes=(
        Cause(
            "brushes", 5e-3, ("dry friction shaft",),
            ("Stribeck friction shaft",), {"dry friction shaft": 1.0},
        ),
        Cause("fan", 2e-6, ("quadratic friction shaft",)),
        Cause("amplifier", 0.1, ("saturation of input U",), ("nonlinearity of input U",)),
    ),
    units={"speed": "rad/s", "current": "A", "U": "V"},
    step=2e-3,
    samples=1000,
    substeps=4,
    held_out=2,
    hold="zero",
)  # fmt: skip


# ---------------------------------------------------------------- drive with a shaft


def drive(x: Any, u: Values, p: Values, e: Values, out: Any) -> None:
    """A motor and a load at a shaft; the motor cogs."""
    a, b, v, w, *slips = x
    inner = p["k"] * dead(a - b, e["backlash"]) + p["c"] * (v - w)
    level = 1.0 + 0.3 * np.exp(-((w / 0.3) ** 2))
    load = p["k2"] * b + 0.03 * w + e["bearing"] * level * smooth_sign(w, 0.02)
    for j, (stretch, share) in enumerate(((0.02, 0.5), (0.06, 0.3), (0.2, 0.2))):
        load = load + e["bushing"] * share * slips[j]
        out[4 + j] = iwan(w, slips[j], stretch)
    cog = e["foreign"] * np.sin(15.0 * a + e["phase"])
    out[0], out[1] = v, w
    out[2] = (u["T"] - inner - 0.02 * v - cog) / p["J1"]
    out[3] = (inner - load) / p["J2"]


DRIVE = Table(
    name="drive",
    rates=drive,
    states=("a", "b", "v", "w", "s1", "s2", "s3"),
    outputs={"motor angle": lambda x, u, p, e: x[0], "load angle": lambda x, u, p, e: x[1]},
    parameters={
        "J1": (0.01, 4e-4), "J2": (0.02, 8e-4), "k": (40.0, 2.0), "c": (0.05, 0.01),
        "k2": (3.0, 0.2),
    },
    drive=lambda rng, t, k: {"T": mixed(rng, t, k, 0.4, 9.0, 0.5)},
    foreign=0.02,
    varied={"phase": (0.0, 6.28)},
    causes=(
        Cause(
            "backlash", 2e-3, ("dead zone shaft",),
            ("cubic stiffness shaft", "linear stiffness shaft"),
        ),
        Cause(
            "bearing", 0.02, ("dry friction load",),
            ("Stribeck friction load",), {"dry friction load": 1.0},
        ),
        Cause(
            "bushing", 0.1, ("hysteresis load",),
            ("dry friction load", "Stribeck friction load", "creep load",
             "viscous friction load", "linear stiffness load"),
        ),
    ),
    units={"motor angle": "rad", "load angle": "rad", "T": "N m"},
    step=4e-3,
    samples=800,
)  # fmt: skip


# ---------------------------------------------------------------- heater


def heater(x: Any, u: Values, p: Values, e: Values, out: Any) -> None:
    """A heated block and a plate in a room; heat diffuses into the insulation of the plate."""
    block, plate, one, two, three = x
    room = u["room"]
    over = block - room
    warm = plate - room
    radiated = ((block + 273.15) / 300.0) ** 4 - ((room + 273.15) / 300.0) ** 4
    flow = p["G"] * over - p["G"] * warm
    lost = 0.15 * over + e["radiation"] * radiated
    out[0] = (u["power"] - flow - lost) / p["C1"]
    sunk = e["foreign"] * (plate - one)
    lost = p["h"] * warm + e["convection"] * np.sign(warm) * np.abs(warm) ** 1.3
    out[1] = (flow - lost - sunk) / p["C2"]
    out[2] = (plate - 2.0 * one + two) / e["time"]
    out[3] = (one - 2.0 * two + three) / e["time"]
    out[4] = (two - three) / e["time"]


ROOM = 21.0
HEATER = Table(
    name="heater",
    rates=heater,
    states=("block", "plate", "one", "two", "three"),
    outputs={"block": lambda x, u, p, e: x[0], "plate": lambda x, u, p, e: x[1]},
    parameters={"C1": (50.0, 2.5), "C2": (80.0, 4.0), "G": (0.8, 0.08), "h": (0.35, 0.04)},
    drive=lambda rng, t, k: {
        "power": np.maximum(steps(rng, t, 10, -15.0, 60.0), 0.0),
        "room": ROOM + 1.5 * np.sin(2.0 * np.pi * t / 3000.0 + 2.0 * k) * np.clip(t / 600, 0, 1),
    },
    foreign=0.05,
    varied={"time": (60.0, 140.0)},
    causes=(
        Cause(
            "thermometer", 8.0, ("lag of sensor plate",),
            ("delay of sensor plate",), {"lag of sensor plate": 1.0},
        ),
        Cause(
            "radiation", 0.5, ("exchange ~ (block - room)^2",),
            ("exchange ~ (block - room)^1.25",),
        ),
        Cause(
            "convection", 0.02, ("exchange ~ (plate - room)^1.25",),
            ("exchange ~ (plate - room)^2",),
        ),
    ),
    slow={"thermometer": "plate"},
    start={n: ROOM for n in ("block", "plate", "one", "two", "three")},
    units={"block": "degC", "plate": "degC", "power": "W", "room": "degC"},
    step=4.0,
    samples=800,
    substeps=3,
    held_out=2,
)  # fmt: skip


# ---------------------------------------------------------------- tanks


def tanks(x: Any, u: Values, p: Values, e: Values, out: Any) -> None:
    """Two tanks; the outflow of the upper one whirls near one level."""
    upper, lower = np.maximum(x[0], 0.0), np.maximum(x[1], 0.0)
    one = upper / np.sqrt(np.sqrt(upper**2 + 1e-4))
    two = lower / np.sqrt(np.sqrt(lower**2 + 1e-4))
    whirl = 1.0 - e["foreign"] * np.exp(-(((upper - e["level"]) / 1.2) ** 2))
    flow = p["transfer"] * one * whirl
    pumped = p["pump"] * u["u"] / np.sqrt(1.0 + (e["pump"] * u["u"]) ** 2)
    spilled = e["weir"] * np.maximum(upper - 6.0, 0.0) ** 1.5
    seeped = e["crack"] * lower * np.tanh(0.5 * lower)
    out[0], out[1] = pumped - flow - spilled, flow - p["drain"] * two - seeped


TANKS = Table(
    name="tanks",
    rates=tanks,
    states=("upper", "lower"),
    outputs={"upper": lambda x, u, p, e: x[0], "lower": lambda x, u, p, e: x[1]},
    parameters={"transfer": (0.06, 0.004), "drain": (0.06, 0.004), "pump": (0.05, 0.003)},
    drive=lambda rng, t, k: {
        "u": np.clip(2.6 + tones(rng, t, 0.0005, 0.012, 0.9), 0.3, 5.0)
        if k != 1
        else np.clip(2.6 + steps(rng, t, 14, -1.8, 1.8), 0.3, 5.0)
    },
    foreign=0.03,
    varied={"level": (3.5, 5.5)},
    causes=(
        Cause("pump", 0.1, ("nonlinearity of input u",), ("saturation of input u",)),
        Cause("weir", 0.01, ("overflow upper",), ("loss ~ upper^2",)),
        Cause(
            "crack", 1e-3, ("leak lower",), ("loss ~ lower^2", "constant inflow lower"),
        ),
    ),
    start={"upper": 4.0, "lower": 4.0},
    units={"upper": "V", "lower": "V", "u": "V"},
    step=3.0,
    samples=800,
    substeps=3,
)  # fmt: skip


# ---------------------------------------------------------------- hydraulic cylinder


def cylinder(x: Any, u: Values, p: Values, e: Values, out: Any) -> None:
    """A cylinder at a servo valve; its tube is wavy."""
    q, v, pressure = x
    spool = soft_clip(dead(u["spool"], e["overlap"]), e["amplifier"])
    flow = p["flow"] * spool
    level = (1.0 + 0.3 * np.exp(-((v / 0.02) ** 2))) * (1.0 + 0.2 * np.abs(pressure))
    seal = e["seal"] * level * smooth_sign(v, 2e-3)
    seal = seal + e["foreign"] * np.sin(2.0 * np.pi * q / e["wave"] + e["phase"])
    out[0] = v
    out[1] = (1000.0 * pressure - p["k"] * q - p["d"] * v - seal) / 20.0
    out[2] = 0.2 * (flow - 1000.0 * v - p["leak"] * pressure)


CYLINDER = Table(
    name="cylinder",
    rates=cylinder,
    states=("q", "v", "pressure"),
    outputs={"position": lambda x, u, p, e: x[0], "pressure": lambda x, u, p, e: x[2]},
    parameters={
        "k": (2e4, 1e3), "d": (300.0, 60.0), "flow": (100.0, 4.0), "leak": (20.0, 3.0),
    },
    drive=lambda rng, t, k: {"spool": mixed(rng, t, k, 0.4, 8.0, 0.4)},
    foreign=5.0,
    varied={"wave": (5e-3, 9e-3), "phase": (0.0, 6.28)},
    causes=(
        Cause(
            "overlap", 0.02, ("dead zone of input spool",), ("nonlinearity of input spool",)
        ),
        Cause("seal", 5.0, ("dry friction piston",), ("Stribeck friction piston",)),
        Cause(
            "amplifier", 1.0, ("saturation of input spool",), ("nonlinearity of input spool",)
        ),
    ),
    units={"position": "m", "pressure": "MPa", "spool": "1"},
    step=2e-3,
    samples=900,
    substeps=5,
    held_out=2,
)  # fmt: skip


# ---------------------------------------------------------------- strut


def strut(x: Any, u: Values, p: Values, e: Values, out: Any) -> None:
    """A quarter of a car; the damping of its strut depends on its position."""
    zs, zu, vs, vu, z, one, two = x
    s, rate = zs - zu, vs - vu
    drag, out[4] = bristle(rate, z, 6e-4, 0.05, 0.3)
    inner = p["ks"] * s + p["cs"] * rate * (1.0 + e["foreign"] * (s / 0.02) ** 2)
    inner = inner + e["guide"] * drag - e["bump stop"] * bump(-s, 0.010, 0.006)
    inner = inner + e["bushing"] * (0.5 * (s - one) + 0.5 * (s - two))
    out[5], out[6] = (s - one) / 0.03, (s - two) / 0.3
    out[0], out[1] = vs, vu
    out[2] = -inner / 300.0
    out[3] = (inner - p["kt"] * (zu - u["z"])) / p["mu"]


STRUT = Table(
    name="strut",
    rates=strut,
    states=("zs", "zu", "vs", "vu", "z", "one", "two"),
    outputs={"stroke": lambda x, u, p, e: x[0] - x[1], "body": lambda x, u, p, e: x[0]},
    parameters={
        "mu": (40.0, 1.2), "ks": (18e3, 900.0), "cs": (1200.0, 120.0), "kt": (180e3, 5e3),
    },
    drive=lambda rng, t, k: {"z": mixed(rng, t, k, 0.4, 12.0, 0.012)},
    foreign=0.1,
    causes=(
        Cause(
            "guide", 20.0, ("dry friction strut",),
            ("Stribeck friction strut", "hysteresis strut"),
        ),
        Cause(
            "bump stop", 50.0, ("end stop strut",),
            ("quadratic stiffness strut", "cubic stiffness strut"),
        ),
        Cause(
            "bushing", 1000.0, ("creep strut",),
            ("hysteresis strut", "viscous friction strut", "linear stiffness strut"),
        ),
    ),
    units={"stroke": "m", "body": "m", "z": "m"},
    step=4e-3,
    samples=800,
)  # fmt: skip


# ---------------------------------------------------------------- loudspeaker


def _coil(x: Any, u: Values, p: Values, e: Values) -> tuple[Any, Any]:
    """Force factor at the position, and current."""
    bl = p["Bl"] * (1.0 - e["foreign"] * (x[0] / 2e-3 - e["shift"]) ** 2)
    return bl, (soft_clip(u["U"], e["amplifier"]) - bl * x[1]) / p["Re"]


def speaker(x: Any, u: Values, p: Values, e: Values, out: Any) -> None:
    """A cone in the field of a magnet that becomes weaker away from the middle."""
    q, v, *slow = x
    bl, current = _coil(x, u, p, e)
    s = np.clip(q / 2e-3, -6.0, 6.0)
    force = bl * current - p["k"] * q - p["d"] * v - e["spider"] * (np.sinh(s) - s)
    for j, time in enumerate((0.006, 0.05, 0.4)):
        force = force - e["rubber"] * (q - slow[j]) / 3.0
        out[2 + j] = (q - slow[j]) / time
    out[0], out[1] = v, force / 0.01


SPEAKER = Table(
    name="speaker",
    rates=speaker,
    states=("q", "v", "z1", "z2", "z3"),
    outputs={"cone": lambda x, u, p, e: x[0], "current": lambda x, u, p, e: _coil(x, u, p, e)[1]},
    parameters={"k": (1000.0, 60.0), "d": (0.6, 0.12), "Bl": (5.0, 0.15), "Re": (6.0, 0.15)},
    drive=lambda rng, t, k: {"U": mixed(rng, t, k, 8.0, 110.0, 4.0)},
    foreign=0.02,
    varied={"shift": (-0.3, 0.3)},
    causes=(
        Cause("spider", 0.3, ("cubic stiffness cone",), ("end stop cone",)),
        Cause(
            "rubber", 60.0, ("creep cone",),
            ("hysteresis cone", "viscous friction cone", "linear stiffness cone"),
        ),
        Cause("amplifier", 0.08, ("saturation of input U",), ("nonlinearity of input U",)),
    ),
    units={"cone": "m", "current": "A", "U": "V"},
    step=5e-4,
    samples=900,
    substeps=3,
    held_out=2,
)  # fmt: skip

TABLES: tuple[Table, ...] = (
    STAGE, FAN, SERVO, PENDULUM, MAGNET, MOTOR, DRIVE, HEATER, TANKS, CYLINDER, STRUT, SPEAKER,
)  # fmt: skip
