"""The machine of the blind bench, integrated by the generator's own code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from blind.truth import (
    ACTUATOR_DAMPING,
    ACTUATOR_STIFFNESS,
    EFFECTS,
    KEEP,
    LENGTH,
    RATIO,
    STEP,
    STROKES,
    Array,
    Case,
    played,
)


@dataclass
class Strokes:
    """What a batch of strokes gave, at a spacing of KEEP steps."""

    key: Array
    hammer: Array
    finger: Array
    """Force on the key [N]."""
    bend: Array
    """Bending of the shank [m]: the head is behind the rigid hammer by it."""
    key_speed: Array
    hammer_speed: Array


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
    """Integrate all strokes of all cases at once; job after job, stroke after stroke."""
    jobs = [(c, s) for c, names in zip(cases, strokes, strict=True) for s in names]
    n = len(jobs)
    p = {
        name: np.array([c.parameters[name][STROKES.index(s)] for c, s in jobs])
        for name in jobs[0][0].parameters
    }

    def magnitudes(name: str, form: str) -> Array:
        return np.array(
            [sum(q.size for q in c.parts if q.name == name and q.form == form) for c, _ in jobs],
            dtype=float,
        )

    e = {(name, form): magnitudes(name, form) for name in EFFECTS for form in "AB"}
    has = {key: bool(np.any(v)) for key, v in e.items()}
    strange = [
        (kind, np.flatnonzero(size), size[size != 0.0])
        for kind, size in ((outside[k], magnitudes(k, "outside")) for k in outside)
        if np.any(size)
    ]
    memories = [np.zeros((8, at.size)) for _, at, _ in strange]

    dt = STEP
    count = round(LENGTH / dt)
    force_mode = np.array([c.mode == "force" for c, _ in jobs])
    knots = np.arange(0, count + 1, KEEP, dtype=np.float64) * np.float64(dt)
    # The finger at a quarter of the frames' spacing and refined, linear between.
    u_all = np.stack(
        [played(knots, c.mode, s, c.strokes[STROKES.index(s)]) for c, s in jobs], axis=1
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
    out = Strokes(*(np.empty((kept, n)) for _ in range(6)))

    def felt(law: Array, loss: Array, rate: Array) -> Array:
        """Force k d^p with losses, never pulling."""
        return np.asarray(law * np.maximum(1.0 + loss * rate, 0.0))

    def logistic(a: Array) -> Array:
        return np.asarray(0.5 + 0.5 * np.tanh(0.5 * a))

    clock = 0
    for keep in range(kept):
        out.key[keep], out.hammer[keep] = x, h
        out.key_speed[keep], out.hammer_speed[keep] = v, w
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
            jack = felt(p["jack_stiffness"] * dp * np.sqrt(dp), jack_loss, rate) * engaged
            if has["jack_hysteresis", "B"]:
                jack = jack * (1.0 + 0.3 * e["jack_hysteresis", "B"] * np.tanh(rate / 0.3)).clip(0)
            if has["lost_motion", "B"]:
                inside = (e["lost_motion", "B"] > 0.0) & (d < 0.0) & (d > -lost)
                jack = jack + np.where(inside, 30.0 * (d + lost) * engaged, 0.0)
            # bed
            d = x - p["bed_position"] - bed_set[0] - bed_set[1] - bed_set[2]
            bed = p["bed_stiffness"] * np.power(np.maximum(d, 0.0), p["bed_exponent"])
            bed = felt(bed, bed_loss, v)
            if has["bed_hysteresis", "B"]:
                bed = bed * (1.0 + 0.4 * e["bed_hysteresis", "B"] * np.tanh(v / 0.4)).clip(0)
            # string
            d = h - string_at - give - give2[0] - bend[0]
            string = string_stiffness * np.power(np.maximum(d, 0.0), p["string_exponent"])
            string = felt(string, string_loss, w)
            if has["string_hysteresis", "B"]:
                string = string * (1.0 + e["string_hysteresis", "B"] * np.tanh(w / 1.0)).clip(0)
            # backcheck
            d = p["check_position"] - h
            dp = np.maximum(d, 0.0)
            check = felt(3.0e5 * dp * np.sqrt(dp), check_loss, -w)
            check = check * logistic((x - 8.6e-3) / width)
            if has["check_friction", "B"]:
                check = check * (1.0 + 0.3 * e["check_friction", "B"] * np.tanh(-w / 0.3)).clip(0)
            # rests
            dp = np.maximum(-x, 0.0)
            law = rest_stiffness * dp * np.sqrt(dp)
            if has["rest_felt_hardening", "B"]:
                law = law * (1.0 + np.clip(e["rest_felt_hardening", "B"] * dp / 60.0, -0.9, 9.0))
            rest = felt(law, np.full(n, 3.0), -v)
            dp = np.maximum(-h, 0.0)
            stop = felt(1.0e5 * dp * np.sqrt(dp), np.full(n, 3.0), -w)

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
