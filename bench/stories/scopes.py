"""First diagnoses of causes in all their scopes, and of machines that lack nothing.

Written and sealed before the engine had run on any of them; own simulators, other than those of the
engine. A right answer tells the cause, or a class with it, with its size within a tenth. Changed
since: a replaced word, and the name of two records in ``friction_in_the_last_two``, which is "and"
where the seal expected "to". ``sensor_beside_the_heater`` has the time constant of its room, so
that its store is a change of both parameters: silent is what the records tell.

    python bench/stories/scopes.py [CASE ...]
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

import unmodeled
from unmodeled import Equations, Record, Sensor

#: Steps of a simulation within a sample.
FINE = 20


@dataclass(frozen=True)
class Case:
    """A machine, what it is modeled as, and what the model lacks."""

    make: Callable[[np.random.Generator], tuple[Equations, list[Record]]]
    right: tuple[tuple[str, float], ...] = ()
    """Patterns of the name of the cause with its size; NaN: any size; (): nothing is missing."""
    settings: dict[str, Any] = field(default_factory=dict)


CASES: dict[str, Case] = {}


def case(*right: tuple[str, float], **settings: Any) -> Callable[..., Any]:
    """Register a case by the name of its function."""

    def keep(make: Any) -> Any:
        CASES[make.__name__] = Case(make, right, settings)
        return make

    return keep


def simulate(rates, start, times, inputs):
    """States at the samples, by the midpoint rule with inputs that are held."""
    x, out = np.array(start, float), []
    for k, t in enumerate(times):
        out.append(x)
        if k + 1 < len(times):
            h, u = (times[k + 1] - t) / FINE, {n: v[k] for n, v in inputs.items()}
            for j in range(FINE):
                middle = x + 0.5 * h * np.array(rates(t + j * h, x, u))
                x = x + h * np.array(rates(t + (j + 0.5) * h, middle, u))
    return np.array(out)


def record(rng, name, times, inputs, outputs, sigma, units=None, **fields):
    """A record with white noise of each sensor."""
    units = units or {}
    values = {n: y + sigma[n] * rng.standard_normal(times.size) for n, y in outputs.items()}
    sensors = {n: Sensor(name=n, unit=units.get(n, "1"), sigma=sigma[n]) for n in outputs}
    return Record(name=name, time=times, inputs=inputs, outputs=values, sensors=sensors, **fields)


def drives(t, size=1.0):
    """Three inputs: a sine, steps, and a sum of sines."""
    yield size * np.sin(2.1 * t)
    yield 0.8 * size * np.sign(np.sin(1.3 * t + 0.2))
    yield size * (0.6 * np.sin(3.3 * t) + 0.5 * np.sin(0.9 * t + 1.0))


CART = Equations(
    lambda t, x, u, p: (x.v, (u.F - p.k * x.x - p.d * x.v) / p.m),
    states={"x": (0.0, 1e-4, "m"), "v": (0.0, 1e-3, "m/s")},
    parameters={"m": (1.5, 0.04, "kg"), "k": (20.0, 0.7, "N/m"), "d": (1.2, 0.2, "N s/m")},
    inputs={"F": "N"},
    outputs={"x": "x"},
    hold="zero",
)


def carts(rng, force=lambda t, v, r: 0.0, mass=lambda r: 1.5, gain=lambda t, r: 1.0, count=3):
    """Records of a cart with a further force and another mass or drive in a record."""
    t, out = np.arange(0.0, 10.0, 0.02), []
    for r in range(count):
        F = [*drives(t, 6.0)][r % 3] * (1.0 - 0.05 * (r // 3))

        def rates(s, x, u, r=r):
            push = gain(s, r) * u["F"] - 20.0 * x[0] - 1.2 * x[1] + force(s, x[1], r)
            return x[1], push / mass(r)

        x = simulate(rates, (0.0, 0.0), t, {"F": F})[:, 0]
        out.append(record(rng, f"run{r + 1}", t, {"F": F}, {"x": x}, {"x": 3e-4}, {"x": "m"}))
    return CART, out


@case()
def cart_alone(rng):
    return carts(rng, count=6)


@case(("*asymmetr*", 0.9), ("*each direction*", 0.9), ("dry friction*", 0.6))
def another_friction_backward(rng):
    return carts(rng, lambda t, v, r: -(0.9 if v > 0 else 0.3) * np.tanh(v / 0.002))


@case(("*friction*", np.nan))
def drag_of_power_three(rng):
    return carts(rng, lambda t, v, r: -0.5 * v**3)


@case(("dry friction*run3 and run4*", 0.5))
def friction_in_the_last_two(rng):
    return carts(rng, lambda t, v, r: -0.5 * (r > 1) * np.tanh(v / 0.002), count=4)


@case(("gain drift*input F*", np.nan), ("*fade*input F*", np.nan))
def drive_that_fades_to_a_share(rng):
    return carts(rng, gain=lambda t, r: 0.75 + 0.25 * np.exp(-t / 1.5))


@case(("gain of input F*over the records*", np.nan))
def drive_that_ages_from_run_to_run(rng):
    return carts(rng, gain=lambda t, r: 1.0 - 0.04 * r, count=6)


@case(("m*in each record*", np.nan))
def another_load_in_each_run(rng):
    loads = (1.5, 1.95, 1.2, 1.62, 1.35, 1.8)
    return carts(rng, mass=lambda r: loads[r], count=6)


@case(("dry friction*in each record*", np.nan))
def another_friction_in_each_run(rng):
    sizes = (0.5, 0.1, 0.8, 0.3, 0.6, 0.2)
    return carts(rng, lambda t, v, r: -sizes[r] * np.tanh(v / 0.002), count=6)


@case(("k in run4*", 4.0), settings_then=True)
def another_spring_after(rng):
    model, out = carts(rng, count=6)
    t = out[0].time
    for r in (3, 4, 5):
        F = out[r].inputs["F"]
        x = simulate(
            lambda s, x, u: (x[1], (u["F"] - 24.0 * x[0] - 1.2 * x[1]) / 1.5), (0, 0), t, {"F": F}
        )
        out[r] = record(rng, f"run{r + 1}", t, {"F": F}, {"x": x[:, 0]}, {"x": 3e-4}, {"x": "m"})
    return model, out


def animals(rng, eaten):
    """Prey and predators of four meadows; the model has the prey alone."""
    t, out = np.arange(0.0, 12.0, 0.1), []
    for r, (a, b) in enumerate(((0.6, 0.5), (1.4, 0.3), (0.9, 0.9), (1.8, 0.7))):
        x = simulate(
            lambda s, x, u: (
                0.8 * x[0] - 0.2 * x[0] ** 2 - eaten * x[0] * x[1],
                0.15 * x[0] * x[1] - 0.4 * x[1],
            ),
            (a, b),
            t,
            {},
        )
        start = unmodeled.StartPrior(
            mean={"prey": a, "hunters": b}, sd={"prey": 0.01, "hunters": 0.01}
        )
        y = {"prey": x[:, 0], "hunters": x[:, 1]}
        out.append(record(rng, f"meadow{r + 1}", t, {}, y, {n: 0.01 for n in y}, start=start))
    return Equations(
        lambda t, x, u, p: (
            p.birth * x.prey - p.crowd * x.prey**2,
            p.gain * x.prey * x.hunters - p.death * x.hunters,
        ),
        states={"prey": (1.0, 0.5, "1"), "hunters": (0.5, 0.3, "1")},
        parameters={
            "birth": (0.8, 0.03, "1/s"),
            "crowd": (0.2, 0.02, "1/s"),
            "gain": (0.15, 0.01, "1/s"),
            "death": (0.4, 0.02, "1/s"),
        },
        outputs={"prey": "prey", "hunters": "hunters"},
    ), out


@case(("*prey*hunters*", 0.35), ("*hunters*prey*", 0.35))
def hunters_eat_the_prey(rng):
    return animals(rng, 0.35)


@case()
def hunters_eat_something_else(rng):
    return animals(rng, 0.0)


def servos(rng, share):
    """A servo that swings a weight; the model states the torque of the motor as an output."""
    t, out = np.arange(0.0, 6.0, 0.01), []
    for r, goal in enumerate(
        (
            np.sin(2 * t),
            0.9 * np.sin(4.1 * t) + 0.4 * np.sin(1.1 * t),
            1.2 * np.sign(np.sin(1.6 * t)),
        )
    ):

        def rates(s, x, u):
            motor = np.clip(8.0 * (u["goal"] - x[0]) - 0.3 * x[1], -1.5, 1.5)
            friction = (0.02 + share * abs(motor)) * np.tanh(x[1] / 0.01)
            return x[1], (motor - 0.5 * np.sin(x[0]) - friction - 0.05 * x[1]) / 0.02

        q = simulate(rates, (0.0, 0.0), t, {"goal": goal})[:, 0]
        out.append(
            record(rng, f"move{r + 1}", t, {"goal": goal}, {"q": q}, {"q": 1e-3}, {"q": "rad"})
        )

    def motor(t, x, u, p):
        return np.clip(8.0 * (u.goal - x.q) - 0.3 * x.w, -1.5, 1.5)

    return Equations(
        lambda t, x, u, p: (
            x.w,
            (motor(t, x, u, p) - p.weight * np.sin(x.q) - p.dry * np.tanh(x.w / 0.01) - p.d * x.w)
            / p.J,
        ),
        states={"q": (0.0, 1e-3, "rad"), "w": (0.0, 1e-2, "rad/s")},
        parameters={
            "J": (0.02, 0.001, "kg m^2"),
            "weight": (0.5, 0.02, "N m"),
            "d": (0.05, 0.01, "N m s/rad"),
            "dry": (0.02, 0.01, "N m"),
        },
        inputs={"goal": "rad"},
        outputs={"q": "q", "motor": (motor, "N m")},
        hold="zero",
    ), out


@case(("friction by*", 0.3))
def gear_under_load(rng):
    return servos(rng, 0.3)


@case()
def gear_without_loss(rng):
    return servos(rng, 0.0)


@case(("dry friction*all*", 0.12))
def one_friction_of_three_axes(rng):
    t, out = np.arange(0.0, 5.0, 0.01), []
    for r in range(3):
        U = {
            f"u{j}": (0.5 - 0.1 * j) * np.sin((1.5 + 0.7 * j + 0.5 * r) * t + j + r)
            for j in range(3)
        }

        def rates(s, x, u):
            w = x[3:]
            push = [
                u[f"u{j}"] - 0.3 * x[j] - 0.08 * w[j] - 0.12 * np.tanh(w[j] / 0.005)
                for j in range(3)
            ]
            return (*w, *(f / (0.05 + 0.02 * j) for j, f in enumerate(push)))

        x = simulate(rates, np.zeros(6), t, U)
        y = {f"q{j}": x[:, j] for j in range(3)}
        out.append(
            record(rng, f"dance{r + 1}", t, U, y, {n: 5e-4 for n in y}, {n: "rad" for n in y})
        )
    return Equations(
        lambda t, x, u, p: (
            x.w0,
            x.w1,
            x.w2,
            (u.u0 - p.k * x.q0 - p.d * x.w0) / p.J0,
            (u.u1 - p.k * x.q1 - p.d * x.w1) / p.J1,
            (u.u2 - p.k * x.q2 - p.d * x.w2) / p.J2,
        ),
        states={
            **{f"q{j}": (0.0, 1e-3, "rad") for j in range(3)},
            **{f"w{j}": (0.0, 1e-3, "rad/s") for j in range(3)},
        },
        parameters={
            "k": (0.3, 0.01, "N m/rad"),
            "d": (0.08, 0.01, "N m s/rad"),
            **{f"J{j}": (0.05 + 0.02 * j, 0.002, "kg m^2") for j in range(3)},
        },
        inputs={f"u{j}": "N m" for j in range(3)},
        outputs={f"q{j}": f"q{j}" for j in range(3)},
        hold="zero",
    ), out


def rooms(rng, lag_of=0.0, wall=0.0, shield=0.0, constants=(1.0,) * 5, spread=0.0):
    """A heated room: a lag of the heater, a wall behind the air, or a slow part of the sensor."""
    t, out = np.arange(0.0, 24.0, 0.1), []
    for r in range(5):
        P = 2.0 * (np.sin(0.5 * t + r) > 0.3 * np.cos(r)) + 0.5 * np.sin((0.9 + 0.2 * r) * t)

        def rates(s, x, u, r=r):
            power = x[1] if lag_of else u["P"]
            flow = (power - 0.8 * x[0]) / (2.0 * constants[r]) - wall * (x[0] - x[2])
            return (
                flow,
                (u["P"] - x[1]) / (lag_of or 1.0),
                (x[0] - x[2]) / 6.0,
                (u["P"] - x[3]) / 2.5,
            )

        x = simulate(rates, (0.0, P[0] if lag_of else 0.0, 0.0, 0.0), t, {"P": P})
        y = {"T": x[:, 0] + shield * x[:, 3]}
        out.append(record(rng, f"day{r + 1}", t, {"P": P}, y, {"T": 0.01}, {"T": "K"}))
    return Equations(
        lambda t, x, u, p: ((u.P - p.loss * x.T) / p.C,),
        states={"T": (0.0, 1e-3, "K")},
        parameters={"C": (2.0, 0.1, "J/K"), "loss": (0.8, 0.04, "W/K")},
        inputs={"P": "W"},
        outputs={"T": "T"},
        hold="zero",
    ), out


@case(("lag of input P", 0.7), ("lag of sensor T", 0.7))
def heater_that_lags(rng):
    return rooms(rng, lag_of=0.7)


@case(("second store T", 0.15))
def wall_behind_the_air(rng):
    return rooms(rng, wall=0.15)


@case(("slow part of P in sensor T", 0.15), ("second store*", np.nan))
def sensor_beside_the_heater(rng):
    return rooms(rng, shield=0.15)


@case(("C*in each record*", np.nan))
def rooms_that_differ(rng):
    return rooms(rng, constants=(1.0, 1.25, 0.82, 1.12, 0.9))


@case()
def a_room(rng):
    return rooms(rng)


@case(("absolute value of sensor q*", np.nan), ("*sign*sensor q*", np.nan))
def meter_without_a_sign(rng):
    t, out = np.arange(0.0, 20.0, 0.05), []
    for r, u in enumerate(drives(t, 2.0)):
        q = simulate(lambda s, x, u: ((u["u"] - x[0]) / 0.8,), (0.0,), t, {"u": u})[:, 0]
        out.append(record(rng, f"flow{r + 1}", t, {"u": u}, {"q": np.abs(q)}, {"q": 0.01}))
    return Equations(
        lambda t, x, u, p: ((p.K * u.u - x.q) / p.T,),
        states={"q": (0.0, 1e-3, "1")},
        parameters={"K": (1.0, 0.03, "1"), "T": (0.8, 0.05, "s")},
        inputs={"u": "1"},
        outputs={"q": "q"},
        hold="zero",
    ), out


def told(report: Any) -> list[tuple[str, str, float]]:
    """What an answer tells as a cause: tier, name and size; equivalents with the tier of theirs."""
    found = [
        (c.tier, e.name, e.size)
        for c in report.changes
        if c.tier not in ("fitted", "unsure")
        for e in (c, *c.equivalents)
    ]
    return [row for row in found if row[1]]


def mark(own: Case, report: Any) -> str:
    """``right``: the cause, or its class, and no other; ``part``; ``silent``; ``wrong``."""
    rows = told(report)
    if not own.right:
        return "right" if not rows else "wrong"
    good = [c for c in report.changes if c.tier not in ("fitted", "unsure") and fits(own, c)]
    others = [c for c in report.changes if c.tier in ("named", "one of") and not fits(own, c)]
    if good:
        return "part" if others else "right"
    return "wrong" if others else "silent"


def fits(own: Case, change: Any) -> bool:
    """Whether a change, or one of its equivalents, is the cause with its size."""
    return any(
        fnmatchcase(e.name, pattern) and not abs(e.size - size) > 0.1 * abs(size)
        for e in (change, *change.equivalents)
        for pattern, size in own.right
    )


def main(names: list[str]) -> None:
    counts: dict[str, int] = {}
    for seed, (name, own) in enumerate(CASES.items()):
        model, records = own.make(np.random.default_rng(1000 + seed))
        if names and name not in names:
            continue
        then = records[3:] if own.settings else ()
        records = records[:3] if own.settings else records
        begin = time.process_time()
        try:
            report = model.diagnose(records, then=then) if then else model.diagnose(records)
            found, text = mark(own, report), report.summary()
        except unmodeled.Error as error:
            found, text = "wrong", f"{type(error).__name__}: {error}"
        counts[found] = counts.get(found, 0) + 1
        print(f"== {name}: {found} ({time.process_time() - begin:.1f} s)\n   {text}", flush=True)
    print(counts)


if __name__ == "__main__":
    main(sys.argv[1:])
