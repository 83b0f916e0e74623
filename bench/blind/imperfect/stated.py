"""What an engineer states of each machine: a model, its tolerances, and the generic candidates.

These are models of :mod:`unmodeled` with the effects of its library at their default scales.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from blind.imperfect.generate import Table
from unmodeled import (
    Coordinate,
    Coupling,
    Effect,
    Equations,
    Parameter,
    Record,
    Sensor,
    State,
    library,
)

__all__ = ["STATED", "stated", "to_records"]

Stated = tuple[Equations, tuple[Effect, ...]]


def _parameters(table: Table) -> list[Parameter]:
    return [Parameter(name=n, value=v, sd=sd, lower=0.0) for n, (v, sd) in table.parameters.items()]


def _states(**scales: tuple[str, float, float]) -> list[State]:
    """States by name: unit, scale, known start."""
    return [
        State(name=n, unit=unit, scale=scale, start=start, start_sd=0.0)
        for n, (unit, scale, start) in scales.items()
    ]


def _model(table: Table, **given: Any) -> Equations:
    inputs = {n: u for n, u in table.units.items() if n not in table.outputs}
    return Equations(
        name=table.name,
        parameters=_parameters(table),
        inputs=inputs,
        hold="zero" if table.hold == "zero" else "linear",
        **given,
    )


def _generic(
    model: Equations,
    record: Record,
    *,
    parts: Sequence[tuple[Any, float, float, float]] = (),
    inputs: Sequence[str] | None = None,
    time: float = 0.1,
) -> tuple[Effect, ...]:
    """Effects of coordinates (with force, travel, speed), inputs and sensors."""
    out: list[Effect] = []
    for part, force, travel, speed in parts:
        out += library.for_coordinate(part, force=force, travel=travel, speed=speed, time=time)
    for name in model.inputs if inputs is None else inputs:
        out += library.for_input(name, record)
    for name in model.outputs:
        out += library.for_sensor(model.outputs, name, record)
    return tuple(out)


def stage(table: Table, record: Record) -> Stated:
    """Mass, damper and spring at a force."""
    mass = Coordinate(name="stage", position="q", speed="v", inertia="m")
    model = _model(
        table,
        states=_states(q=("m", 0.01, 0.0), v=("m/s", 0.2, 0.0)),
        rates=lambda t, x, u, p: (x.v, (u.f - p.k * x.q - p.d * x.v) / p.m),
        outputs={"position": "q"},
        coordinates=[mass],
        substeps=1,
    )
    return model, _generic(model, record, parts=[(mass, 8.0, 0.02, 0.3)])


def fan(table: Table, record: Record) -> Stated:
    """A rotor at a torque."""
    rotor = Coordinate(name="rotor", position="q", speed="w", inertia="J", unit="N m")
    model = _model(
        table,
        states=_states(q=("rad", 10.0, 0.0), w=("rad/s", 10.0, 0.0)),
        rates=lambda t, x, u, p: (x.w, (u.T - p.d * x.w) / p.J),
        outputs={"speed": "w"},
        coordinates=[rotor],
        substeps=1,
    )
    return model, _generic(model, record, parts=[(rotor, 0.5, 20.0, 20.0)], time=1.0)


def servo(table: Table, record: Record) -> Stated:
    """An arm at a controller with known gains."""
    arm = Coordinate(name="arm", position="q", speed="v", inertia="J", unit="N m")
    model = _model(
        table,
        states=_states(q=("rad", 0.3, 0.0), v=("rad/s", 3.0, 0.0)),
        rates=lambda t, x, u, p: (
            x.v,
            (40.0 * (u.target - x.q) - 0.6 * x.v - p.mgl * np.sin(x.q) - p.d * x.v) / p.J,
        ),
        outputs={"angle": "q"},
        coordinates=[arm],
        substeps=1,
    )
    return model, _generic(model, record, parts=[(arm, 5.0, 0.5, 5.0)])


def pendulum(table: Table, record: Record) -> Stated:
    """A pendulum that a torque drives."""
    bob = Coordinate(name="bob", position="q", speed="w", inertia="J", unit="N m")
    model = _model(
        table,
        states=_states(q=("rad", 0.5, 0.0), w=("rad/s", 2.0, 0.0)),
        rates=lambda t, x, u, p: (x.w, (u.T - p.mgl * np.sin(x.q) - p.d * x.w) / p.J),
        outputs={"angle": "q"},
        coordinates=[bob],
        substeps=1,
    )
    return model, _generic(model, record, parts=[(bob, 1.0, 0.8, 2.5)], time=0.5)


def magnet(table: Table, record: Record) -> Stated:
    """A mass on a linear spring."""
    mass = Coordinate(name="mass", position="q", speed="v", inertia="m")
    model = _model(
        table,
        states=_states(q=("m", 0.01, 0.0), v=("m/s", 0.2, 0.0)),
        rates=lambda t, x, u, p: (x.v, (u.f - p.k * x.q - p.d * x.v) / p.m),
        outputs={"hall": "q"},
        coordinates=[mass],
        substeps=1,
    )
    return model, _generic(model, record, parts=[(mass, 3.0, 0.02, 0.3)])


def motor(table: Table, record: Record) -> Stated:
    """A motor of known inductance at a voltage."""
    shaft = Coordinate(name="shaft", position="q", speed="w", inertia="J", unit="N m")
    model = _model(
        table,
        states=_states(q=("rad", 5.0, 0.0), w=("rad/s", 30.0, 0.0), i=("A", 1.0, 0.0)),
        rates=lambda t, x, u, p: (
            x.w,
            (p.K * x.i - p.d * x.w) / p.J,
            (u.U - p.R * x.i - p.K * x.w) / 5e-3,
        ),
        outputs={"speed": "w", "current": "i"},
        coordinates=[shaft],
        substeps=1,
    )
    return model, _generic(model, record, parts=[(shaft, 0.1, 5.0, 60.0)])


def drive(table: Table, record: Record) -> Stated:
    """A motor and a load at a shaft."""
    one = Coordinate(name="motor", position="a", speed="v", inertia="J1", unit="N m")
    two = Coordinate(name="load", position="b", speed="w", inertia="J2", unit="N m")
    shaft = Coupling(name="shaft", first=one, second=two, unit="N m")
    model = _model(
        table,
        states=_states(
            a=("rad", 0.2, 0.0), b=("rad", 0.2, 0.0), v=("rad/s", 3.0, 0.0), w=("rad/s", 3.0, 0.0)
        ),
        rates=lambda t, x, u, p: (
            x.v,
            x.w,
            (u.T - p.k * (x.a - x.b) - p.c * (x.v - x.w) - 0.02 * x.v) / p.J1,
            (p.k * (x.a - x.b) + p.c * (x.v - x.w) - p.k2 * x.b - 0.03 * x.w) / p.J2,
        ),
        outputs={"motor angle": "a", "load angle": "b"},
        coordinates=[one, two, shaft],
        substeps=1,
    )
    parts = [(one, 1.0, 0.3, 4.0), (two, 1.0, 0.3, 4.0), (shaft, 1.0, 0.02, 0.6)]
    return model, _generic(model, record, parts=parts)


def heater(table: Table, record: Record) -> Stated:
    """Two stores of heat in a room."""
    room = 21.0
    model = _model(
        table,
        states=_states(block=("degC", 30.0, room), plate=("degC", 30.0, room)),
        rates=lambda t, x, u, p: (
            (u.power - p.G * (x.block - x.plate) - 0.15 * (x.block - u.room)) / p.C1,
            (p.G * (x.block - x.plate) - p.h * (x.plate - u.room)) / p.C2,
        ),
        outputs={"block": "block", "plate": "plate"},
        ports={"block": "block", "plate": "plate"},
        substeps=1,
    )
    effects = []
    for state in ("block", "plate"):
        effects += [
            library.exchange(state, "room", 1.25, scale=1e-3, unit="K^-0.25/s"),
            library.exchange(state, "room", 2.0, scale=3e-5, unit="1/(K s)"),
            library.constant_rate(state, scale=0.02, unit="K/s"),
            library.overflow(state, levels=(40.0, 60.0), rate_scale=3e-3),
        ]
    return model, (*effects, *_generic(model, record, inputs=["power"]))


def tanks(table: Table, record: Record) -> Stated:
    """Two tanks with an outflow as the square root of the level."""

    def root(level: Any) -> Any:
        level = np.maximum(level, 0.0)
        return level / np.sqrt(np.sqrt(level**2 + 1e-4))

    model = _model(
        table,
        states=_states(upper=("V", 3.0, 4.0), lower=("V", 3.0, 4.0)),
        rates=lambda t, x, u, p: (
            p.pump * u.u - p.transfer * root(x.upper),
            p.transfer * root(x.upper) - p.drain * root(x.lower),
        ),
        outputs={"upper": "upper", "lower": "lower"},
        ports={"upper": "upper", "lower": "lower"},
        substeps=1,
    )
    effects = []
    for state, into in (("upper", "lower"), ("lower", "")):
        effects += [
            library.overflow(state, levels=(5.0, 7.0, 9.0), rate_scale=0.02, into=into),
            library.leak(state, scale=0.002),
            library.constant_rate(state, unit="V/s", scale=0.01),
            library.power_outflow(state, 2.0, unit="1/(V s)", scale=2e-4),
        ]
    return model, (*effects, *_generic(model, record))


def cylinder(table: Table, record: Record) -> Stated:
    """A cylinder of known mass and area at a valve with a linear flow."""
    piston = Coordinate(name="piston", position="q", speed="v", inertia=20.0)
    model = _model(
        table,
        states=_states(q=("m", 0.01, 0.0), v=("m/s", 0.05, 0.0), pressure=("MPa", 0.3, 0.0)),
        rates=lambda t, x, u, p: (
            x.v,
            (1000.0 * x.pressure - p.k * x.q - p.d * x.v) / 20.0,
            0.2 * (p.flow * u.spool - 1000.0 * x.v - p.leak * x.pressure),
        ),
        outputs={"position": "q", "pressure": "pressure"},
        coordinates=[piston],
        ports={"chamber": "pressure"},
        substeps=1,
    )
    effects = (
        library.leak("pressure", scale=0.5),
        library.constant_rate("pressure", unit="MPa/s", scale=0.5),
    )
    return model, (
        *effects, *_generic(model, record, parts=[(piston, 200.0, 0.01, 0.05)])
    )  # fmt: skip


def strut(table: Table, record: Record) -> Stated:
    """A quarter of a car."""
    body = Coordinate(name="body", position="zs", speed="vs", inertia=300.0)
    wheel = Coordinate(name="wheel", position="zu", speed="vu", inertia="mu")
    between = Coupling(name="strut", first=body, second=wheel)

    def push(x: Any, p: Any) -> Any:
        return p.ks * (x.zs - x.zu) + p.cs * (x.vs - x.vu)

    model = _model(
        table,
        states=_states(
            zs=("m", 0.02, 0.0), zu=("m", 0.02, 0.0), vs=("m/s", 0.2, 0.0), vu=("m/s", 0.5, 0.0)
        ),
        rates=lambda t, x, u, p: (
            x.vs,
            x.vu,
            -push(x, p) / 300.0,
            (push(x, p) - p.kt * (x.zu - u.z)) / p.mu,
        ),
        outputs={"stroke": lambda t, x, u, p: x.zs - x.zu, "body": "zs"},
        coordinates=[body, wheel, between],
        substeps=1,
    )
    parts = [(body, 400.0, 0.03, 0.3), (between, 400.0, 0.02, 0.3)]
    return model, _generic(model, record, parts=parts)


def speaker(table: Table, record: Record) -> Stated:
    """A cone of known mass at a coil without inductance."""
    cone = Coordinate(name="cone", position="q", speed="v", inertia=0.01)
    model = _model(
        table,
        states=_states(q=("m", 1e-3, 0.0), v=("m/s", 0.5, 0.0)),
        rates=lambda t, x, u, p: (
            x.v,
            (p.Bl * (u.U - p.Bl * x.v) / p.Re - p.k * x.q - p.d * x.v) / 0.01,
        ),
        outputs={"cone": "q", "current": lambda t, x, u, p: (u.U - p.Bl * x.v) / p.Re},
        coordinates=[cone],
        substeps=1,
    )
    return model, _generic(model, record, parts=[(cone, 5.0, 4e-3, 0.8)], time=0.02)


#: By name of the machine: function of its table and its first record.
STATED: Mapping[str, Callable[[Table, Record], Stated]] = {
    f.__name__: f
    for f in (
        stage, fan, servo, pendulum, magnet, motor, drive, heater, tanks, cylinder, strut, speaker,
    )
}  # fmt: skip


def to_records(
    table: Table, records: Sequence[Mapping[str, Any]], noise: Mapping[str, float]
) -> list[Record]:
    """Records of a case, with the noise of their data sheets."""
    out = []
    for k, columns in enumerate(records):
        inputs = {n: columns[n] for n in table.units if n not in table.outputs}
        out.append(
            Record(
                name=f"run {k}",
                time=columns["time"],
                inputs=inputs,
                outputs={n: columns[n] for n in table.outputs},
                sensors={
                    n: Sensor(name=n, unit=table.units[n], sigma=noise[n]) for n in table.outputs
                },
                input_units={n: table.units[n] for n in inputs},
                role="held_out" if k >= table.records - table.held_out else "fit",
            )
        )
    return out


def stated(table: Table, record: Record) -> Stated:
    """Model and candidates of a machine, with scales from its first record."""
    return STATED[table.name](table, record)
