"""Measured machines of the yardstick, and small records in which one signal is wrong.

Each has a right answer and, where a prediction is measured, the held-out residual of a plain
engineer's fit: least squares with the right set (:mod:`blind.engineer`).
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from blind.marks import Cause, Truth
from blind.task import Task
from unmodeled import (
    Coordinate,
    Equations,
    Parameter,
    Record,
    Sensor,
    Simulator,
    State,
    candidates,
)

Array = NDArray[np.float64]

__all__ = ["MEASURED", "SIGNALS"]

DATA = Path(__file__).resolve().parents[2] / "bench" / "data"


def _record(path: Path, output: str, unit: str, held: Sequence[str], scale: float = 1.0) -> Record:
    """A record of two or three columns: time, an input u, and one output; its noise is not told."""
    t, *inputs, y = np.loadtxt(path, delimiter=",", skiprows=1).T
    return Record(
        name=path.stem,
        time=t,
        inputs={"u": inputs[0]} if inputs else {},
        input_units={"u": "N"} if inputs else {},
        outputs={output: scale * y},
        sensors={output: Sensor(name=output, unit=unit)},
        role="held_out" if path.stem in held else "fit",
    )


def _records(folder: str, *arguments: Any, **fields: Any) -> list[Record]:
    return [_record(p, *arguments, **fields) for p in sorted((DATA / folder).glob("*.csv"))]


# ---------------------------------------------------------------- measured machines


def _pendulum() -> Task:
    """Free swings of one pendulum; starts unknown."""
    arm = Coordinate(name="arm", position="q", speed="v", inertia=1.0, unit="rad/s^2")
    model = Equations(
        name="pendulum",
        states=[
            State(name="q", unit="rad", scale=1.0),
            State(name="v", unit="rad/s", scale=8.0),
        ],
        parameters=[
            Parameter(name="w2", value=64.0, sd=10.0, unit="1/s^2", lower=1.0),
            Parameter(name="damping", value=0.07, sd=0.07, unit="1/s", lower=0.0),
        ],
        rates=lambda t, x, u, p: (x.v, -p.w2 * np.sin(x.q) - p.damping * x.v),
        outputs={"angle": "q"},
        coordinates=[arm],
    )
    records = _records("pendulum", "angle", "rad", ("swing5", "swing6"))
    causes = (
        Cause(("dry friction arm",), ("Stribeck friction arm", "hysteresis arm")),
        Cause(("quadratic friction arm",)),
    )
    return Task(
        model,
        candidates(model, records),
        records,
        Truth(
            "effect",
            causes,
            sizes={"dry friction arm": 0.149, "quadratic friction arm": 0.0044},
            engineer=ENGINEER["pendulum"],
            about="pendulum, dry 0.149 rad/s2 and quadratic friction 0.0044 1/rad",
        ),
    )


def _bouc_wen() -> Task:
    """The hysteretic benchmark of Noel and Schoukens."""
    mass = Coordinate(name="mass", position="x", speed="v", inertia="m", unit="N")
    model = Equations(
        name="oscillator",
        states=[
            State(name="x", unit="m", scale=1e-3),
            State(name="v", unit="m/s", scale=0.3),
        ],
        parameters=[
            Parameter(name="m", value=2.0, sd=0.1, unit="kg", lower=0.1),
            Parameter(name="c", value=10.0, sd=20.0, unit="N s/m", lower=0.0),
            Parameter(name="k", value=8e4, sd=4e4, unit="N/m", lower=0.0),
        ],
        inputs={"u": "N"},
        rates=lambda t, x, u, p: (x.v, (u.u - p.c * x.v - p.k * x.x) / p.m),
        outputs={"y": "x"},
        coordinates=[mass],
    )
    records = _records("bouc_wen", "y", "m", ("test",), scale=1e-3)
    truth = Truth(
        "effect",
        (Cause(("Bouc-Wen hysteresis mass",), ("hysteresis mass",)),),
        {"k": 5e4, "c": 10.0},
        engineer=ENGINEER["bouc_wen"],
        about="Bouc-Wen hysteresis, beta 1000 and gamma 800 1/m",
    )
    return Task(model, candidates(model, records), records, truth)


def _ball() -> Task:
    """A whiffle ball from 40 m, resolution of a video."""
    ball = Coordinate(name="ball", position="h", speed="v", inertia=1.0, unit="m/s^2")
    model = Equations(
        name="fall",
        states=[State(name="h", unit="m", scale=10.0), State(name="v", unit="m/s", scale=10.0)],
        parameters=[Parameter(name="g", value=9.81, sd=0.01, unit="m/s^2")],
        rates=lambda t, x, u, p: (x.v, -p.g + 0.0 * x.v),
        outputs={"h": "h"},
        coordinates=[ball],
    )
    records = _records("falling_ball", "h", "m", ("whiffle_2",))
    truth = Truth(
        "effect",
        (Cause(("viscous friction ball", "quadratic friction ball")),),
        engineer=ENGINEER["ball"],
        about="whiffle ball, drag",
    )
    return Task(model, candidates(model, records), records, truth)


MEASURED: tuple[Callable[[], Task], ...] = (_pendulum, _bouc_wen, _ball)


# ---------------------------------------------------------------- one signal is wrong


def _noisy(
    name: str,
    unit: str,
    sigma: float,
    seed: int,
    made: Sequence[tuple[Array, Mapping[str, Array], Array]],
) -> list[Record]:
    """Records of an output with white noise."""
    rng = np.random.default_rng(seed)
    return [
        Record(
            name=f"r{k}",
            time=t,
            inputs=dict(inputs),
            outputs={name: y + sigma * rng.standard_normal(t.size)},
            sensors={name: Sensor(name=name, sigma=sigma, unit=unit)},
        )
        for k, (t, inputs, y) in enumerate(made)
    ]


def _one_of(model: Any, records: list[Record], about: str, *names: str) -> Task:
    truth = Truth("one of", (Cause(names),), about=about)
    return Task(model, candidates(model, records), records, truth)


def _half_scale(factor: float) -> Task:
    """y = k u with a factor that can be in u, in y, or in k."""
    t = np.arange(0.0, 10.0, 0.05)
    u = [2.0 + np.sin(a * t) for a in (1.0, 1.6, 0.8)]
    records = _noisy("y", "N", 0.01, 1, [(t, {"u": v}, factor * 3.0 * v) for v in u])
    k = {"k": (3.0, 0.03, "N/m")}
    model = Simulator(lambda time, inputs, p: {"y": p["k"] * inputs["u"]}, parameters=k)
    return _one_of(
        model, records, f"y = k u, {factor:g} times", "gain of input u", "gain of sensor y",
        "parameter:k",
    )  # fmt: skip


def _product_half() -> Task:
    """y = (1 + c) u w with a half that can be in any signal."""
    t, made = np.arange(0.0, 10.0, 0.05), []
    for a, b in ((1.0, 0.7), (1.6, 1.1), (0.8, 1.9)):
        u, w = 2.0 + np.sin(a * t), 1.0 + 0.5 * np.cos(b * t)
        made.append((t, {"u": u, "w": w}, 0.5 * u * w))
    model = Simulator(
        lambda time, inputs, p: {"y": (1.0 + p["c"]) * inputs["u"] * inputs["w"]},
        parameters={"c": (0.0, 0.01)},
    )
    return _one_of(
        model, _noisy("y", "1", 0.002, 1, made), "y = u w, half", "gain of input u",
        "gain of input w", "gain of sensor y", "parameter:c",
    )  # fmt: skip


def _lag_half(factor: float) -> Task:
    """A first-order lag whose input has another gain."""
    t, made = np.arange(0.0, 12.0, 0.04), []
    for w in (0.9, 2.1, 1.4):
        u, x, path = 1.5 * np.sign(np.sin(w * t)) + 0.5, 0.0, []
        for v in u:
            path.append(x)
            x += (1.0 - np.exp(-0.04 / 0.5)) * (factor * v - x)
        made.append((t, {"u": u}, np.array(path)))
    model = Equations(
        lambda t, x, u, p: ((p.b * u.u - x.x) / p.tau,),
        states={"x": (0.0, 0.01, "V")},
        parameters={"b": (1.0, 0.01, "1"), "tau": (0.5, 0.005, "s")},
        hold="zero",
        inputs={"u": "V"},
        outputs={"x": "x"},
    )
    return _one_of(
        model, _noisy("x", "V", 0.003, 3, made), f"lag, {factor:g} times", "gain of input u",
        "gain of sensor x", "parameter:b",
    )  # fmt: skip


def _table(kind: str, factor: float = 1.0) -> Task:
    """The table of the guide: a wrong scale of the motor force, another mass, or a dead zone."""
    h = 0.005
    t, made = np.arange(0.0, 2.0, h), []
    mass = 4.0 if kind == "mass" else 2.0
    for force in (
        4.0 * np.sin(2.0 * np.pi * 0.6 * t),
        3.0 * np.sin(2.0 * np.pi * 1.7 * t),
        3.0 * np.sign(np.sin(2.0 * np.pi * 0.8 * t)),
    ):
        x = v = 0.0
        path = []
        acting = np.sign(force) * np.maximum(np.abs(force) - 0.5, 0.0) if kind == "dead" else force
        for a in acting:
            path.append(x)
            for _ in range(50):
                v += h / 50.0 * (a - 90.0 * x - 3.0 * v) / mass
                x += h / 50.0 * v
        made.append((t, {"motor": factor * force}, np.array(path)))
    model = Equations(
        lambda t, x, u, p: (x.v, (u.motor - p.k * x.x - p.d * x.v) / p.m),
        states={"x": (0.0, 1e-4, "m"), "v": (0.0, 1e-3, "m/s")},
        parameters={
            "m": (2.0, 0.1, "kg"), "k": (90.0, 3.0, "N/m"), "d": (3.0, 0.5, "N s/m"),
        },
        hold="zero",
        inputs={"motor": "N"},
        outputs={"x": "x"},
    )  # fmt: skip
    records = _noisy("x", "m", 5e-5, 2, made)
    if kind == "scale":
        names = "gain of input motor", "gain of sensor x"
        return _one_of(model, records, f"table, {factor:g} times the force", *names)
    right = {"mass": "parameter:m", "dead": "dead zone of input motor"}[kind]
    truth = Truth("effect", (Cause((right,)),), about=f"table, {right}")
    return Task(model, candidates(model, records), records, truth)


def _late() -> Task:
    """Two of four records are one sample late."""
    rng, h, n, records = np.random.default_rng(9), 1e-3, 400, []
    for name, late in (("good 1", 0), ("good 2", 0), ("late 1", 1), ("late 2", 1)):
        u, x, path = np.repeat(rng.uniform(-1.0, 1.0, n // 10 + 1), 10)[:n], 0.0, []
        for v in u:
            path.append(x)
            x += (1.0 - np.exp(-h / 5e-3)) * (v - x)
        y = np.r_[np.zeros(late), np.array(path)[: n - late]] + 1e-3 * rng.standard_normal(n)
        sensors = {"x": Sensor(name="x", sigma=1e-3, unit="V")}
        records.append(
            Record(name=name, time=h * np.arange(float(n)), inputs={"u": u}, outputs={"x": y},
                   sensors=sensors)
        )  # fmt: skip
    model = Equations(
        lambda t, x, u, p: ((u.u - x.x) / p.tau,),
        states={"x": (0.0, 0.01, "V")},
        parameters={"tau": (5e-3, 2.5e-4, "s")},
        hold="zero",
        inputs={"u": "V"},
        outputs={"x": "x"},
    )
    truth = Truth(
        "effect", (Cause(("delay of sensor x in each record",)),), about="two records are late"
    )
    return Task(model, candidates(model, records), records, truth)


def _second_store() -> Task:
    """A wall behind the air of a room."""
    rng, dt, n, made = np.random.default_rng(7), 600.0, 500, []
    for k in range(3):
        outside = 3.0 + 3.0 * np.sin(2.0 * np.pi * np.arange(n) / 144.0 + k)
        heat = 4000.0 * np.repeat(rng.integers(0, 2, n // 10 + 1), 10)[:n]
        room, wall, path = 20.0, 18.0, []
        for a, p in zip(outside, heat, strict=True):
            path.append(room)
            for _ in range(20):
                q = (wall - room) / 1.1e-3
                room += dt / 20.0 * (p + q) / 2e6
                wall += dt / 20.0 * (-q + (a - wall) / 4e-3) / 9e6
        made.append((dt * np.arange(float(n)), {"Ta": outside, "Ph": heat}, np.array(path)))
    model = Equations(
        lambda t, x, u, p: (((u.Ta - x.T) / p.R + u.Ph) / p.C,),
        states={"T": (20.0, 0.1, "degC")},
        parameters={"C": (10e6, 3e6, "J/K"), "R": (5e-3, 1.5e-3, "K/W")},
        inputs={"Ta": "degC", "Ph": "W"},
        hold="zero",
        outputs={"T": "T"},
    )
    records = _noisy("T", "degC", 0.03, 7, made)
    # The store is in the path from outside: beside a store that hangs on the first one, the same
    # outputs need an outside temperature that comes with its lag.
    truth = Truth(
        "effect",
        (Cause(("second store T",)),),
        free=("lag of input Ta",),
        about="a second store behind the first",
    )
    return Task(model, candidates(model, records), records, truth)


def _car(kind: str) -> Task:
    """Yaw rate of a car: a wrong ratio of the steering, or understeer."""
    t, made = np.arange(0.0, 20.0, 0.05), []
    more, gain = (0.003, 1.0) if kind == "understeer" else (0.0, 0.5)
    for v, d in (
        (4.0 + 0.05 * t, 0.25 * np.sin(0.6 * t)),
        (9.0 + 0.1 * t, 0.10 * np.sin(0.9 * t)),
        (16.0 + 3.0 * np.sin(0.1 * t), 0.04 * np.sin(1.3 * t) + 0.01),
    ):
        made.append((t, {"v": v, "steer": d}, v * gain * d / (2.85 + more * v**2)))

    def car(time: Array, inputs: Mapping[str, Array], p: Mapping[str, float]) -> Any:
        v, d = inputs["v"], inputs["steer"]
        return {"yaw_rate": v * d / (p["wheelbase"] + p["understeer"] * v**2)}

    model = Simulator(
        car, parameters={"wheelbase": (2.85, 0.01, "m"), "understeer": (0.0, 1e-4, "s^2/m")}
    )
    records = _noisy("yaw_rate", "rad/s", 0.002, 2, made)
    if kind == "understeer":
        truth = Truth("effect", (Cause(("parameter:understeer",)),), about="car, understeer")
        return Task(model, candidates(model, records), records, truth)
    return _one_of(
        model, records, "car, half of the steering", "gain of input steer",
        "gain of sensor yaw_rate", "gain of input v", "parameter:wheelbase",
    )  # fmt: skip


def _free_fall() -> Task:
    """A constant rate and no inputs, and a residual that no law of the list has."""
    t = np.linspace(0.0, 3.0, 60)
    records = [
        Record(
            name=f"r{k}",
            time=t,
            inputs={},
            outputs={
                "h": 40.0 - 4.9 * t**2 + 0.5 * np.sin(3.0 * t + k) + 0.3 * np.sin(7.0 * t + 2.0 * k)
            },
            sensors={"h": Sensor(name="h", unit="m")},
        )
        for k in range(3)
    ]
    model = Equations(
        lambda t, x, u, p: (x.v, -p.g + 0.0 * x.v),
        states={"h": "m", "v": "m/s"},
        parameters={"g": (9.81, 0.01, "m/s^2")},
        outputs={"h": "h"},
    )
    effects = [e for e in candidates(model, records) if e.name.startswith(("viscous", "dry"))]
    return Task(model, effects, records, Truth("outside", about="free fall: UNKNOWN"))


def _motor_lag() -> Task:
    """Pitch axis of a small quadrotor: the lag of its motors is 70 ms, and 6 ms in the model.

    Each step is exact: by steps of 0.5 ms the records show another lag, 69.3 ms.
    """
    h, tau, inertia, drag = 5e-3, 0.07, 1.8e-5, 3e-6
    rates = np.array([[-1.0 / tau, 0.0, 1.0 / tau], [1.0 / inertia, -drag / inertia, 0.0]])
    step = expm(h * np.vstack([rates, np.zeros(3)]))
    t, made = np.arange(0.0, 6.0, h), []
    for moment in (
        4e-5 * np.sin(2.0 * np.pi * (0.6 * t + 0.25 * t**2)),
        3e-5 * np.sign(np.sin(2.0 * np.pi * 1.3 * t)),
        2e-5 * (np.sin(5.0 * t) + np.sin(11.0 * t + 1.0) + np.sin(17.0 * t + 2.0)),
    ):
        x, path = np.zeros(3), []
        for m in moment:
            path.append(x[1])
            x = step @ [x[0], x[1], m]
        made.append((t, {"moment": moment}, np.array(path)))
    model = Equations(
        lambda t, x, u, p: ((u.moment - x.motor) / p.tau, (x.motor - p.drag * x.rate) / p.J),
        states={"motor": (0.0, 0.0, "N m"), "rate": (0.0, 0.02, "rad/s")},
        parameters={
            "tau": (6e-3, 2e-3, "s"), "J": (1.7e-5, 2e-6, "kg m^2"),
            "drag": (3e-6, 2e-6, "N m s/rad"),
        },
        bounds={"tau": (1e-3, 0.5)},
        outputs={"rate": "rate"},
        inputs={"moment": "N m"},
        hold="zero",
    )  # fmt: skip
    records = _noisy("rate", "rad/s", 0.01, 11, made)
    truth = Truth(
        "effect", (Cause(("parameter:tau",)),), {"tau": tau, "J": inertia}, about="motors, lag"
    )
    return Task(model, candidates(model, records), records, truth)


SIGNALS: tuple[Callable[[], Task], ...] = (
    *(functools.partial(_half_scale, f) for f in (0.5, 2.0)),
    _product_half,
    *(functools.partial(_lag_half, f) for f in (0.5, 2.0)),
    *(functools.partial(_table, "scale", f) for f in (0.5, 2.0)),
    functools.partial(_table, "mass"),
    functools.partial(_table, "dead"),
    _late,
    _second_store,
    functools.partial(_car, "ratio"),
    functools.partial(_car, "understeer"),
    _free_fall,
    _motor_lag,
)

#: Rms of held-out records by least squares with the right set [unit of the output].
ENGINEER = {"pendulum": 0.0063, "bouc_wen": 1.9e-6, "ball": 0.114}
