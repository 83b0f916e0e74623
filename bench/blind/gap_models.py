"""Diagnoses of user models: nine systems from a simulator that is independent of feltmb.

python bench/blind/gap_models.py [CASE ...] [--json FILE]

Each machine is integrated by scipy (LSODA) with a cause that its model lacks; parameters of the
model are off, the library is the generic one of ``unmodeled.library``, one record is held-out.
Printed: verdict, what was named, its size against the truth, share of the held-out gap that it
closes, processor time. "between" is the parameter of an input's run between its samples.
"""

from __future__ import annotations

import argparse
import json
import time as clock
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from unmodeled import (
    Coordinate,
    Coupling,
    Effect,
    Equations,
    Parameter,
    Record,
    Sensor,
    State,
    candidates,
    diagnose,
)

Signal = Callable[..., Any]


@dataclass(frozen=True)
class Case:
    """One machine."""

    truth: str
    named: tuple[str, ...]
    """Correct names; empty: no effect of the library is correct."""
    size: float
    """True magnitude of the first one."""
    model: Equations
    effects: Sequence[Effect]
    records: Sequence[Record]


def multisine(
    random: np.random.Generator, low: float, high: float, tones: int, rms: float
) -> Signal:
    """A smooth input: tones of equal amplitude and random phase, from low to high [Hz]."""
    pitch, phase = np.linspace(low, high, tones), random.uniform(0.0, 2.0 * np.pi, tones)
    size = rms * np.sqrt(2.0 / tones)
    return lambda t: np.sum(
        size * np.sin(2.0 * np.pi * np.multiply.outer(np.asarray(t, float), pitch) + phase), axis=-1
    )


def simulate(rates: Signal, start: Sequence[float], time: np.ndarray, step: float) -> np.ndarray:
    """States at given times, (n, nx)."""
    run = solve_ivp(
        rates, (time[0], time[-1]), start, "LSODA", time, rtol=1e-8, atol=1e-11, max_step=step
    )
    assert run.success, run.message
    return np.asarray(run.y.T)


def record(
    name: str,
    time: np.ndarray,
    inputs: dict[str, np.ndarray],
    outputs: dict[str, np.ndarray],
    noise: dict[str, float],
    random: np.random.Generator,
    *,
    told: bool = True,
) -> Record:
    """A measured record; ``told``: whether its sensors state their noise."""
    return Record(
        name=name,
        time=time,
        inputs=inputs,
        outputs={k: v + noise[k] * random.standard_normal(time.size) for k, v in outputs.items()},
        sensors={k: Sensor(name=k, sigma=noise[k] if told else None) for k in outputs},
    )


def oscillator(name: str, m: float, k: float, c: float, **options: object) -> Equations:
    """Mass, spring and damper with a force; the true parameters differ by 2 to 10 %."""
    mass = Coordinate(name="mass", position="q", speed="v", inertia="m")
    return Equations(
        name=name,
        states=[State(name="q", unit="m", scale=0.01), State(name="v", unit="m/s", scale=0.2)],
        parameters=[
            Parameter(name="m", value=1.03 * m, sd=0.04 * m, unit="kg"),
            Parameter(name="k", value=1.04 * k, sd=0.05 * k, unit="N/m"),
            Parameter(name="c", value=1.1 * c, sd=0.2 * c, unit="N s/m", lower=0.0),
        ],
        inputs=["f"],
        rates=lambda t, x, u, p: (x.v, (u.f - p.k * x.q - p.c * x.v) / p.m),
        outputs={"q": "q"},
        coordinates=[mass],
        **options,  # type: ignore[arg-type]
    )


def shaken(
    seed: int,
    law: Callable[[float, float, float], float],
    *,
    m: float = 1.2,
    k: float = 300.0,
    c: float = 2.0,
    noise: float = 5e-5,
    samples: int = 2000,
    lag: float = 0.0,
    told: bool = True,
) -> tuple[Equations, Sequence[Effect], list[Record]]:
    """An oscillator with a force law(t, q, v) against its motion, and a sensor with a delay."""
    random = np.random.default_rng(seed)
    time = 0.005 * np.arange(samples)
    records = []
    for i, rms in enumerate((2.0, 4.0, 3.0, 4.0)):
        f = multisine(random, 0.3, 6.0, 25, rms)
        y = simulate(
            lambda t, x, f=f: [x[1], (f(t) - k * x[0] - c * x[1] - law(t, x[0], x[1])) / m],
            [0.0, 0.0],
            time,
            0.005,
        )
        q = np.interp(time - lag, time, y[:, 0])
        records.append(
            record(f"run {i}", time, {"f": f(time)}, {"q": q}, {"q": noise}, random, told=told)
        )
    model = oscillator("oscillator", m, k, c)
    effects = candidates(model, records)
    return model, effects, records


def friction() -> Case:
    """Coulomb friction with a lower threshold speed than in the library."""
    parts = shaken(1, lambda t, q, v: 0.4 * np.tanh(v / 2e-4))
    return Case("dry friction 0.4 N", ("dry friction mass",), 0.4, *parts)


def duffing() -> Case:
    """A hardening spring; the noise is not stated."""
    parts = shaken(2, lambda t, q, v: 1.2e5 * q**3, told=False)
    return Case("cubic stiffness 1.2e5 N/m^3", ("cubic stiffness mass",), 1.2e5, *parts)


def pair() -> Case:
    """Friction and a sensor with a delay."""
    parts = shaken(9, lambda t, q, v: 0.5 * np.tanh(v / 1e-3), lag=0.006)
    truth = "dry friction 0.5 N and a sensor that lags 6 ms"
    return Case(truth, ("dry friction mass", "delay of sensor q"), 0.5, *parts)


def drift() -> Case:
    """A spring that softens while it warms up; the generic effects do not include this."""
    parts = shaken(8, lambda t, q, v: -24.0 * (1.0 - np.exp(-t / 4.0)) * q)
    return Case("stiffness that drifts by -8 %: not in the bundle", (), 0.0, *parts)


def absorber() -> Case:
    """A small mass on its own spring, which is not a generic effect."""
    random = np.random.default_rng(18)
    time = 0.005 * np.arange(1000)
    m, k, c, ma, ca = 1.2, 300.0, 2.0, 0.06, 0.06
    ka = ma * (2.0 * np.pi * 4.2) ** 2
    records = []
    for i, rms in enumerate((2.0, 4.0, 3.0, 4.0)):
        f = multisine(random, 0.3, 6.0, 25, rms)

        def rates(t: float, x: np.ndarray, f: Signal = f) -> list[float]:
            inner = ka * (x[0] - x[2]) + ca * (x[1] - x[3])
            return [x[1], (f(t) - k * x[0] - c * x[1] - inner) / m, x[3], inner / ma]

        y = simulate(rates, [0.0] * 4, time, 0.005)
        records.append(
            record(f"run {i}", time, {"f": f(time)}, {"q": y[:, 0]}, {"q": 5e-5}, random)
        )
    model = oscillator("oscillator", m, k, c)
    effects = candidates(model, records)
    return Case("an absorber on the mass: not in the library", (), 0.0, model, effects, records)


def backlash() -> Case:
    """Backlash of a shaft between two inertias."""
    random = np.random.default_rng(3)
    time = 0.004 * np.arange(1000)
    one, two, k, c, gap = 0.01, 0.02, 40.0, 0.02, 0.004
    motor = Coordinate(name="motor", position="a", speed="v", inertia="J1", unit="N m")
    load = Coordinate(name="load", position="b", speed="w", inertia="J2", unit="N m")
    shaft = Coupling(name="shaft", first=motor, second=load, unit="N m")
    records = []
    for i, rms in enumerate((0.5, 1.0, 0.7)):
        torque = multisine(random, 0.5, 12.0, 25, rms)

        def rates(t: float, x: np.ndarray, torque: Signal = torque) -> list[float]:
            twist = x[0] - x[1]
            inner = k * (twist - np.clip(twist, -gap, gap)) + c * (x[2] - x[3])
            return [
                x[2],
                x[3],
                (torque(t) - inner - 0.02 * x[2]) / one,
                (inner - 0.03 * x[3]) / two,
            ]

        y = simulate(rates, [0.0] * 4, time, 0.002)
        seen = {"a": y[:, 0], "b": y[:, 1]}
        records.append(
            record(f"run {i}", time, {"T": torque(time)}, seen, {"a": 2e-4, "b": 2e-4}, random)
        )
    model = Equations(
        name="drive",
        states=[State(name=n, unit="rad", scale=0.1) for n in "ab"]
        + [State(name=n, unit="rad/s", scale=2.0) for n in "vw"],
        parameters=[
            Parameter(name="J1", value=0.0103, sd=3e-4),
            Parameter(name="J2", value=0.0194, sd=6e-4),
            Parameter(name="k", value=42.0, sd=2.0),
            Parameter(name="d1", value=0.022, sd=0.003),
            Parameter(name="d2", value=0.028, sd=0.004),
            Parameter(name="c", value=0.022, sd=0.004),
        ],
        inputs=["T"],
        rates=lambda t, x, u, p: (
            x.v,
            x.w,
            (u.T - p.k * (x.a - x.b) - p.c * (x.v - x.w) - p.d1 * x.v) / p.J1,
            (p.k * (x.a - x.b) + p.c * (x.v - x.w) - p.d2 * x.w) / p.J2,
        ),
        outputs={"a": "a", "b": "b"},
        coordinates=[motor, load, shaft],
    )
    effects = candidates(model, records)
    return Case("backlash of 0.004 rad", ("dead zone shaft",), 40.0, model, effects, records)


def motor() -> Case:
    """A motor whose friction decreases with speed; its voltage is constant between samples."""
    random = np.random.default_rng(5)
    time = 0.002 * np.arange(2000)
    R, L, K, J, d, dry, more, slow = 1.0, 5e-3, 0.05, 2e-4, 1e-4, 0.02, 0.012, 1.5
    records = []
    for i, rms in enumerate((2.0, 4.0, 6.0, 3.0)):
        volts = multisine(random, 0.3, 5.0, 15, rms)(time)

        def rates(t: float, x: np.ndarray, u: float) -> list[float]:
            drag = (dry + more * np.exp(-((x[1] / slow) ** 2))) * np.tanh(x[1] / 0.02)
            return [
                x[1],
                (K * x[2] - drag - d * x[1]) / J,
                (u - R * x[2] - K * x[1]) / L,
            ]

        x = np.zeros(3)
        states = [x]
        for u in volts[:-1]:
            x = solve_ivp(rates, (0.0, 0.002), x, "LSODA", args=(u,), rtol=1e-7, atol=1e-9).y[:, -1]
            states.append(x)
        y = np.array(states)
        seen = {"angle": y[:, 0], "current": y[:, 2]}
        noise = {"angle": 1e-3, "current": 0.02}
        records.append(record(f"run {i}", time, {"U": volts}, seen, noise, random))
    shaft = Coordinate(name="shaft", position="q", speed="w", inertia="J", unit="N m", scale=0.02)
    model = Equations(
        name="motor",
        states=[
            State(name="q", unit="rad", scale=1.0),
            State(name="w", unit="rad/s", scale=30.0),
            State(name="i", unit="A", scale=1.0),
        ],
        parameters=[
            Parameter(name="R", value=1.03, sd=0.04),
            Parameter(name="L", value=4.8e-3, sd=3e-4),
            Parameter(name="K", value=0.0515, sd=0.002),
            Parameter(name="J", value=2.08e-4, sd=1e-5),
            Parameter(name="d", value=1.2e-4, sd=4e-5, lower=0.0),
            Parameter(name="dry", value=0.022, sd=0.003, lower=0.0),
        ],
        inputs=["U"],
        rates=lambda t, x, u, p: (
            x.w,
            (p.K * x.i - p.d * x.w - p.dry * np.tanh(x.w / 0.02)) / p.J,
            (u.U - p.R * x.i - p.K * x.w) / p.L,
        ),
        outputs={"angle": "q", "current": "i"},
        coordinates=[shaft],
        hold="zero",
    )
    effects = candidates(model, records)
    named = ("Stribeck friction shaft",)
    return Case("Stribeck friction 0.012 N m", named, more, model, effects, records)


def pendulum() -> Case:
    """A pendulum that swings in air; start and noise are not stated, and there is no input."""
    random = np.random.default_rng(6)
    time = 0.01 * np.arange(2000)
    records = []
    for i, angle in enumerate((1.5, 0.9, 1.2, 0.6)):
        y = simulate(
            lambda t, x: [x[1], -12.26 * np.sin(x[0]) - 0.02 * x[1] - 0.02 * x[1] * abs(x[1])],
            [angle, 0.3 * random.standard_normal()],
            time,
            0.05,
        )
        records.append(
            record(f"run {i}", time, {}, {"th": y[:, 0]}, {"th": 2e-3}, random, told=False)
        )
    bob = Coordinate(name="bob", position="th", speed="w", unit="N m/(kg m^2)", position_unit="rad")
    model = Equations(
        name="pendulum",
        states=[
            State(name="th", unit="rad", scale=0.5),
            State(name="w", unit="rad/s", scale=2.0),
        ],
        parameters=[
            Parameter(name="w2", value=12.7, sd=0.4),
            Parameter(name="c", value=0.03, sd=0.015, lower=0.0),
        ],
        rates=lambda t, x, u, p: (x.w, -p.w2 * np.sin(x.th) - p.c * x.w),
        outputs={"th": "th"},
        coordinates=[bob],
    )
    effects = candidates(model, records)
    return Case("drag 0.02", ("quadratic friction bob",), 0.02, model, effects, records)


def nothing() -> Case:
    """A quarter-car model on a road that is smooth between the samples, without an effect."""
    random = np.random.default_rng(7)
    time = 0.004 * np.arange(1500)
    ms, mu, ks, cs, kt = 300.0, 40.0, 18000.0, 1200.0, 180000.0
    records = []
    for i in range(4):
        road = multisine(random, 0.4, 12.0, 30, 0.01 * (1.0 + 0.3 * i))

        def rates(t: float, x: np.ndarray, road: Signal = road) -> list[float]:
            inner = ks * (x[0] - x[2]) + cs * (x[1] - x[3])
            return [x[1], -inner / ms, x[3], (inner - kt * (x[2] - road(t))) / mu]

        y = simulate(rates, [0.0] * 4, time, 0.01)
        push = -(ks * (y[:, 0] - y[:, 2]) + cs * (y[:, 1] - y[:, 3])) / ms
        seen = {"stroke": y[:, 0] - y[:, 2], "push": push}
        noise = {"stroke": 2e-4, "push": 0.05}
        records.append(record(f"run {i}", time, {"z": road(time)}, seen, noise, random))
    body = Coordinate(name="body", position="zs", speed="vs", inertia="ms")
    wheel = Coordinate(name="wheel", position="zu", speed="vu", inertia="mu")

    def lift(t: Any, x: Any, u: Any, p: Any) -> Any:
        return (-p.ks * (x.zs - x.zu) - p.cs * (x.vs - x.vu)) / p.ms

    off = {"ms": 1.05, "mu": 0.95, "ks": 1.05, "cs": 0.9, "kt": 0.95}
    sd = {"ms": 0.02, "mu": 0.025, "ks": 0.02, "cs": 0.04, "kt": 0.02}
    true = {"ms": ms, "mu": mu, "ks": ks, "cs": cs, "kt": kt}
    model = Equations(
        name="quarter car",
        states=[
            State(name="zs", unit="m", scale=0.02),
            State(name="vs", unit="m/s", scale=0.2),
            State(name="zu", unit="m", scale=0.02),
            State(name="vu", unit="m/s", scale=0.5),
        ],
        parameters=[
            Parameter(name=n, value=off[n] * v, sd=sd[n] * v, lower=0.0) for n, v in true.items()
        ],
        inputs=["z"],
        rates=lambda t, x, u, p: (
            x.vs,
            lift(t, x, u, p),
            x.vu,
            (p.ks * (x.zs - x.zu) + p.cs * (x.vs - x.vu) - p.kt * (x.zu - u.z)) / p.mu,
        ),
        outputs={"stroke": lambda t, x, u, p: x.zs - x.zu, "push": lift},
        coordinates=[body, wheel],
    )
    effects = candidates(model, records)
    return Case("nothing; parameters 2 to 3 sd off", (), 0.0, model, effects, records)


CASES: dict[str, Callable[[], Case]] = {
    c.__name__: c
    for c in (friction, duffing, pair, backlash, motor, pendulum, nothing, drift, absorber)
}


def main() -> None:
    """Diagnose the cases and print one line for each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"of {', '.join(CASES)}")
    parser.add_argument("--json", type=Path, help="file for the same numbers")
    chosen = parser.parse_args()
    unknown = [c for c in chosen.cases if c not in CASES]
    if unknown:
        parser.error(f"no case {', '.join(unknown)}; there are {', '.join(CASES)}")
    rows = []
    for name in chosen.cases or CASES:
        case = CASES[name]()
        begin = clock.process_time()
        report = diagnose(case.model, case.effects, case.records, hold_out=[case.records[-1].name])
        spent = clock.process_time() - begin
        named = [n.cause for n in report.named]
        one_of = [n.cause for group in report.classes for n in group]
        told = [*report.named, *(n for group in report.classes for n in group)]
        first = next((n for n in told if n.cause in case.named), None)
        row = {
            "case": name,
            "truth": case.truth,
            "verdict": report.verdict.name,
            "named": named,
            "one_of": one_of,
            "right": set(named) <= set(case.named) and set(case.named) <= {*named, *one_of},
            "size": None if first is None else [first.low, first.magnitude, first.high],
            "true_size": case.size,
            "held_out_gain": report.held_out_gain,
            "cpu_seconds": spent,
        }
        rows.append(row)
        size = (
            "" if first is None else f", {first.magnitude:.4g} [{first.low:.4g}, {first.high:.4g}]"
        )
        either = f" one of {', '.join(one_of)}" if one_of else ""
        gain = "" if report.held_out_gain is None else f", leaves {report.held_out_gain[0]:.0%}"
        print(
            f"{name}: {case.truth}\n    {report.verdict.name} {', '.join(named)}{either}{size}"
            f"{gain}, {spent:.0f} s",
            flush=True,
        )
    if chosen.json is not None:
        chosen.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
