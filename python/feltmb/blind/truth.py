"""Generator of the blind bench: the machine as it "really" is.

Shares no code with the engine, the nominal or the force laws; it must not import from feltmb. Its
own table of parameters, its own integrator (semi-implicit Euler, 1/20 of the nominal's step,
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
#: Sizes that can be negative as well.
BOTH_SIGNS = {
    "spring_preload", "bed_hysteresis", "string_hysteresis", "hammer_wear", "check_friction",
    "rest_felt_hardening", "key_spring", "input_gain", "input_offset", "input_delay",
    "hammer_scale", "hammer_offset",
}  # fmt: skip
#: Largest plausible size: what would need more to stand out so far is not drawn.
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
    """Noncentrality that the size was chosen for."""


@dataclass
class Case:
    """Truth of one case; everything random in it comes from the seed."""

    number: int
    mode: str
    parts: list[Part]
    parameters: dict[str, list[float]]
    """By name, one value a stroke."""
    strokes: list[dict[str, float]]
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

    ``scales``: {mode: {"name:form": noncentrality per unit of size}}; ``outside``: kinds from
    outside with their largest sizes. ``mix``: shares of none, one, two, three effects, outside.
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
        # Of the causes that can stand out so far at a plausible size.
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
    """Drawing values, plain strokes, no jitter: for the calibration of sizes."""
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


def played(t: Array, mode: str, stroke: str, own: Mapping[str, float]) -> Array:
    """Force [N] or motion [m] of the finger at the times t."""
    table = FORCES if mode == "force" else MOTIONS
    level, rise, release = table[stroke]
    if mode == "force":
        level *= own["strength"]
    rise /= own["speed"]

    def blow(start: float, until: float) -> Array:
        u = _ease(t, start, rise)
        # A finger sags a little while it follows the key.
        u = u * (1.0 - own["shape"] * np.sin(np.pi * np.clip((t - start) / 0.05, 0.0, 1.0)) ** 2)
        return u * (1.0 - _ease(t, until, 0.02)) if until > 0.0 else u

    u = blow(0.010, 0.010 + release if release > 0.0 else 0.0)
    if stroke == "repetition":
        u = u + blow(SECOND, 0.0)
    return np.asarray(level * u)


# ---------------------------------------------------------------- the machine


@dataclass
class Strokes:
    """What a batch of strokes gave, at a spacing of KEEP steps."""

    key: Array
    hammer: Array
    finger: Array
    """Force on the key [N]."""
    bend: Array
    speeds: tuple[Array, Array]


class _Bristles:
    """LuGre friction with the bristle moved exactly over a step at constant speed."""

    def __init__(self, size: Array, stribeck: float):
        self.at = np.flatnonzero(size)
        self.level = size[self.at]
        self.z = np.zeros(self.at.size)
        self.stribeck = stribeck

    def force(self, v: Array, dt: float) -> Array:
        v = v[self.at]
        # Stiction 10 % above sliding friction.
        level = self.level * (1.0 + 0.10 * np.exp(-((v / self.stribeck) ** 2)))
        stiffness = 2.0e4 * self.level / 0.1
        steady = level / stiffness
        decay = np.exp(-np.abs(v) * dt / steady)
        self.z = np.sign(v) * steady * (1.0 - decay) + self.z * decay
        return stiffness * self.z


def integrate(
    cases: Sequence[Case], strokes: Sequence[Sequence[str]], outside: Mapping[str, Any]
) -> Strokes:
    """Integrate all strokes of all cases at once; lane after lane, stroke after stroke."""
    lanes = [(c, s) for c, names in zip(cases, strokes, strict=True) for s in names]
    n = len(lanes)
    p = {
        name: np.array([c.parameters[name][STROKES.index(s)] for c, s in lanes])
        for name in lanes[0][0].parameters
    }

    def sizes(name: str, form: str) -> Array:
        return np.array(
            [sum(q.size for q in c.parts if q.name == name and q.form == form) for c, _ in lanes],
            dtype=float,
        )

    e = {(name, form): sizes(name, form) for name in EFFECTS for form in "AB"}
    has = {key: bool(np.any(v)) for key, v in e.items()}
    strange = [
        (kind, np.flatnonzero(size), size[size != 0.0])
        for kind, size in ((outside[k], sizes(k, "outside")) for k in outside)
        if np.any(size)
    ]
    memories = [np.zeros((8, at.size)) for _, at, _ in strange]

    dt = STEP
    count = round(LENGTH / dt)
    force_mode = np.array([c.mode == "force" for c, _ in lanes])
    knots = np.arange(0, count + 1, KEEP) * dt
    # The finger at a quarter of the frames' spacing and finer, linear between.
    u_all = np.stack(
        [played(knots, c.mode, s, c.strokes[STROKES.index(s)]) for c, s in lanes], axis=1
    )
    u_rate = np.diff(u_all, axis=0) / (KEEP * dt)

    x = p["start_key"].copy()
    h = p["start_hammer"].copy()
    v = np.zeros(n)
    w = np.zeros(n)
    bed_set = np.zeros((3, n))
    give = np.zeros(n)
    give2 = np.zeros((2, n))
    bend = np.zeros((2, n))
    im, ih = 1.0 / p["key_mass"], 1.0 / p["hammer_mass"]
    friction_key = _Bristles(e["key_dry_friction", "B"], 5e-3)
    friction_hammer = _Bristles(e["hammer_dry_friction", "B"], 2.5e-2)
    lost = e["lost_motion", "A"] + e["lost_motion", "B"]
    wear = e["hammer_wear", "A"] + e["hammer_wear", "B"]
    string_stiffness = p["string_stiffness"] * (1.0 - 150.0 * e["hammer_wear", "B"])
    jack_loss = 0.3 + e["jack_hysteresis", "A"]
    bed_loss = 1.0 + e["bed_hysteresis", "A"]
    string_loss = 0.15 + e["string_hysteresis", "A"]
    check_loss = 5.0 + e["check_friction", "A"]
    rest_stiffness = 1.0e6 + e["rest_felt_hardening", "A"]
    bed_any = any(has["bed_creep", f] for f in "AB")
    give_any = any(has["string_compliance", f] for f in "AB")
    bend_any = any(has["shank_flexibility", f] for f in "AB")
    bend_gain = e["shank_flexibility", "A"] + e["shank_flexibility", "B"]
    second = e["shank_flexibility", "B"] != 0.0
    omega = 2.0 * np.pi * np.where(second, 60.0, 50.0)
    zeta = np.where(second, 0.03, 0.05)
    preload = 0.05 + e["spring_preload", "A"] + 1.1 * e["spring_preload", "B"]
    preload_slope = -0.2 * 1.1 * e["spring_preload", "B"] / 45e-3
    string_at = 45.0e-3 + wear
    width = p["gate_width"]
    hammer_spring = p["hammer_spring_rate"] + preload_slope
    key_spring = e["key_spring", "A"]
    key_damping = p["key_damping"]
    hammer_damping = p["hammer_damping"]

    kept = knots.size
    out = Strokes(
        *(np.empty((kept, n)) for _ in range(4)), speeds=(np.empty((kept, n)), np.empty((kept, n)))
    )

    def felt(d: Array, law: Array, loss: Array, rate: Array) -> Array:
        """Force k d^p (law given) with losses, never pulling."""
        del d
        return np.asarray(law * np.maximum(1.0 + loss * rate, 0.0))

    def logistic(a: Array) -> Array:
        return np.asarray(0.5 + 0.5 * np.tanh(0.5 * a))

    clock = 0
    for keep in range(kept):
        out.key[keep], out.hammer[keep] = x, h
        out.speeds[0][keep], out.speeds[1][keep] = v, w
        out.bend[keep] = bend[0]
        u0 = u_all[keep]
        du = u_rate[min(keep, kept - 2)]
        for inner in range(KEEP):
            u = u0 + (inner * dt) * du
            finger = np.where(
                force_mode, u, ACTUATOR_STIFFNESS * (u - x) + ACTUATOR_DAMPING * (du - v)
            )
            if inner == 0:
                out.finger[keep] = finger
                if keep == kept - 1:
                    break
            # jack
            d = RATIO * x - h - lost
            rate = RATIO * v - w
            dp = np.maximum(d, 0.0)
            engaged = logistic((p["letoff_position"] - x) / width) * logistic(
                (2e-3 - d - lost) / 2e-4
            )
            jack = felt(d, p["jack_stiffness"] * dp * np.sqrt(dp), jack_loss, rate) * engaged
            if has["jack_hysteresis", "B"]:
                jack = jack * (1.0 + 0.3 * e["jack_hysteresis", "B"] * np.tanh(rate / 0.3)).clip(0)
            if has["lost_motion", "B"]:
                inside = (e["lost_motion", "B"] > 0.0) & (d < 0.0) & (d > -lost)
                jack = jack + np.where(inside, 30.0 * (d + lost) * engaged, 0.0)
            # bed
            d = x - p["bed_position"] - bed_set[0] - bed_set[1] - bed_set[2]
            bed = p["bed_stiffness"] * np.power(np.maximum(d, 0.0), p["bed_exponent"])
            bed = felt(d, bed, bed_loss, v)
            if has["bed_hysteresis", "B"]:
                bed = bed * (1.0 + 0.4 * e["bed_hysteresis", "B"] * np.tanh(v / 0.4)).clip(0)
            # string
            d = h - string_at - give - give2[0] - bend[0]
            string = string_stiffness * np.power(np.maximum(d, 0.0), p["string_exponent"])
            string = felt(d, string, string_loss, w)
            if has["string_hysteresis", "B"]:
                string = string * (1.0 + e["string_hysteresis", "B"] * np.tanh(w / 1.0)).clip(0)
            # backcheck
            d = p["check_position"] - h
            dp = np.maximum(d, 0.0)
            check = felt(d, 3.0e5 * dp * np.sqrt(dp), check_loss, -w)
            check = check * logistic((x - 8.6e-3) / width)
            if has["check_friction", "B"]:
                check = check * (1.0 + 0.3 * e["check_friction", "B"] * np.tanh(-w / 0.3)).clip(0)
            # rests
            dp = np.maximum(-x, 0.0)
            law = rest_stiffness * dp * np.sqrt(dp)
            if has["rest_felt_hardening", "B"]:
                law = law * (1.0 + np.clip(e["rest_felt_hardening", "B"] * dp / 60.0, -0.9, 9.0))
            rest = felt(dp, law, np.full(n, 3.0), -v)
            dp = np.maximum(-h, 0.0)
            stop = felt(dp, 1.0e5 * dp * np.sqrt(dp), np.full(n, 3.0), -w)

            fx = finger - p["key_balance"] - RATIO * jack - bed + rest - key_damping * v
            fx = fx - key_spring * x
            fh = jack - string + check + stop - preload - hammer_spring * h - hammer_damping * w
            if has["key_spring", "B"]:
                fx = fx - e["key_spring", "B"] * x * (0.6 + 0.8 * x / 9.6e-3)
            if has["key_dry_friction", "A"]:
                fx = fx - e["key_dry_friction", "A"] * np.tanh(v / (5e-3 / 3.0))
            if has["hammer_dry_friction", "A"]:
                fh = fh - e["hammer_dry_friction", "A"] * np.tanh(w / (2.5e-2 / 3.0))
            if friction_key.at.size:
                fx[friction_key.at] -= friction_key.force(v, dt)
            if friction_hammer.at.size:
                fh[friction_hammer.at] -= friction_hammer.force(w, dt)
            if has["hammer_drag", "A"]:
                fh = fh - e["hammer_drag", "A"] * w * np.abs(w)
            if has["hammer_drag", "B"]:
                fh = fh - e["hammer_drag", "B"] * w * np.abs(w) ** 0.75
            for form, slack, exponent in (("A", 1.0e-3, 1.0), ("B", 1.3e-3, 1.2)):
                if has["hammer_bridle", form]:
                    ahead = np.maximum(h - RATIO * x - slack, 0.0)
                    pull = e["hammer_bridle", form] * ahead**exponent
                    fh = fh - pull
                    fx = fx + RATIO * pull
            if strange:
                contacts = {"jack": jack, "bed": bed, "string": string, "check": check,
                            "finger": finger}  # fmt: skip
                now = clock * dt
                for (kind, at, size), memory in zip(strange, memories, strict=True):
                    if hasattr(kind, "force"):
                        seen = {k: f[at] for k, f in contacts.items()}
                        more = kind.force(now, x[at], v[at], h[at], w[at], seen, size, memory, dt)
                        fx[at] += more[0]
                        fh[at] += more[1]
            # hidden states
            if bed_any:
                a, b = e["bed_creep", "A"], e["bed_creep", "B"]
                bed_set[0] += dt / 30e-3 * (a * bed - bed_set[0])
                bed_set[1] += dt / 10e-3 * (0.5 * b * bed - bed_set[1])
                bed_set[2] += dt / 80e-3 * (0.5 * b * bed - bed_set[2])
            if give_any:
                give += dt / 1e-3 * (e["string_compliance", "A"] * string - give)
                pull = e["string_compliance", "B"] * string - give2[0]
                give2[1] += dt * (1.2e3**2 * pull - 1.4 * 1.2e3 * give2[1])
                give2[0] += dt * give2[1]
            if bend_any:
                bend[1] += dt * (
                    omega**2 * (bend_gain * jack - bend[0]) - 2.0 * zeta * omega * bend[1]
                )
                bend[0] += dt * bend[1]
            v = v + dt * im * fx
            w = w + dt * ih * fh
            x = x + dt * v
            h = h + dt * w
            clock += 1
    return out


# ---------------------------------------------------------------- what is measured


def _coarse(values: Array, quantum: float) -> Array:
    return np.asarray(np.round(values / quantum) * quantum)


NOISE_CAMERA = 5e-5
PIXEL = 2e-5
NOISE_INPUT = {"force": 0.02, "motion": 1e-5}
RANGE_INPUT = {"force": 25.0, "motion": 12e-3}


def record(
    case: Case, names: Sequence[str], result: Strokes, first: int, outside: Mapping[str, Any],
    *, ideal: bool = False,
) -> dict[str, dict[str, Array]]:  # fmt: skip
    """Sensors' view of the strokes of one case: {stroke: {input, key, hammer}}.

    `first`: lane of its first stroke. `ideal`: no noise and no steps of the digitizers.
    """
    fine = np.arange(result.key.shape[0]) * (KEEP * STEP)
    frames = np.arange(round(LENGTH / FRAME)) * FRAME
    total = {(q.name, q.form): q.size for q in case.parts}

    def size(name: str, form: str) -> float:
        return float(total.get((name, form), 0.0))

    views = {}
    for k, name in enumerate(names):
        lane = first + k
        rng = np.random.default_rng([*(case.seed or [0, 0]), 2, STROKES.index(name)])
        key = result.key[:, lane]
        hammer = result.hammer[:, lane] - result.bend[:, lane]
        finger = result.finger[:, lane]
        key = key + finger * size("key_flexibility", "A")
        key = key + size("key_flexibility", "B") * finger * (1.1 - 0.1 * np.tanh(finger / 5.0))
        hammer = hammer * (1.0 + size("hammer_scale", "A"))
        hammer = hammer + size("hammer_scale", "B") * hammer * (0.8 + 0.4 * hammer / 45e-3)
        hammer = hammer + size("hammer_offset", "A")
        hammer = hammer + size("hammer_offset", "B") * (0.8 + 0.4 * fine / LENGTH)
        for q in case.parts:
            if q.form == "outside" and hasattr(outside[q.name], "observe"):
                key, hammer = outside[q.name].observe(fine, key, hammer, q.size, rng)

        def expose(y: Array, late: float) -> Array:
            # The shutter is open for half a frame around the time stamp.
            moments = frames[:, None] - late + np.linspace(-0.5, 0.5, 11)[None, :] * 0.5 * FRAME
            return np.asarray(np.interp(moments, fine, y).mean(axis=1))

        def grain() -> Array:
            # Mean of three frames' white noise: correlated over three frames.
            white = rng.standard_normal(frames.size + 2)
            return np.asarray((white[:-2] + white[1:-1] + white[2:]) / np.sqrt(3.0))

        view = {"key": expose(key, 0.0), "hammer": expose(hammer, case.skew)}
        u = played(fine, case.mode, name, case.strokes[STROKES.index(name)])
        if case.mode == "motion":
            unit = 1e-3
        else:
            unit = 1.0
        # A sensor that reads too little makes the model believe in too little: size is what the
        # recorded input must be changed by to be true.
        gain = 1.0 + size("input_gain", "A")
        top = 6.0 if case.mode == "force" else 10e-3
        shown = u / (gain + size("input_gain", "B") * (0.8 + 0.2 * u / top))
        shown = shown - unit * size("input_offset", "A")
        shown = shown - unit * size("input_offset", "B") * (0.7 + 0.6 * fine / LENGTH)
        late = size("input_delay", "A")
        seen = np.interp(frames + late, fine, shown)
        blur = size("input_delay", "B")
        if blur != 0.0:
            ages = np.linspace(0.0, 2.0, 21)
            moments = frames[:, None] + blur * ages[None, :]
            seen = (
                seen + np.interp(moments, fine, shown).mean(axis=1) - np.interp(frames, fine, shown)
            )
        if not ideal:
            raw = seen + NOISE_INPUT[case.mode] * rng.standard_normal(seen.size)
            padded = np.pad(raw, 1, mode="edge")
            filtered = 0.25 * padded[:-2] + 0.5 * padded[1:-1] + 0.25 * padded[2:]
            seen = _coarse(filtered, RANGE_INPUT[case.mode] / 4096.0)
            for channel in ("key", "hammer"):
                view[channel] = _coarse(view[channel] + NOISE_CAMERA * grain(), PIXEL)
        view["finger"] = seen
        views[name] = view
    return views


def onset(case: Case, result: Strokes, lane: int, what: str) -> float:
    """Time [s] at which an effect first can act in a stroke; NaN: never."""
    key, hammer = result.key[:, lane], result.hammer[:, lane]
    k = STROKES.index(STROKES[lane % len(STROKES)])
    conditions = {
        "start": np.ones(key.size, dtype=bool),
        "key": key > 3e-4,
        "bed": key > case.parameters["bed_position"][k],
        "string": hammer > 45e-3,
        "letoff": hammer > RATIO * key + 1e-3,
        "check": (key > 8.6e-3)
        & (hammer < case.parameters["check_position"][k])
        & (np.arange(key.size) > int(np.argmax(hammer))),
    }
    happened = np.flatnonzero(conditions[what])
    return float(happened[0] * KEEP * STEP) if happened.size else float("nan")


def load_outside(module: ModuleType) -> dict[str, Any]:
    """Kinds from outside of a module: its ``KINDS``, by name."""
    return {kind.name: kind for kind in module.KINDS}
