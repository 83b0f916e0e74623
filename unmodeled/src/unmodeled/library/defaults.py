"""Candidates of a diagnosis from what a model has: effects with their sizes from the records."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from unmodeled.arguments import checked
from unmodeled.data import Array, Record
from unmodeled.errors import InvalidParameter, near_names
from unmodeled.fit.equations import Equations
from unmodeled.library import (
    constant_rate,
    exchange,
    for_all_inputs,
    for_all_sensors,
    for_coordinate,
    for_input,
    for_sensor,
    leak,
    load_friction,
    part_of,
    power_outflow,
    product_loss,
    second_store,
)
from unmodeled.library.forces import product, rate_of_all
from unmodeled.library.readings import together
from unmodeled.models.coordinates import Coordinate, Coupling, Named
from unmodeled.models.matching import matched
from unmodeled.models.model import Effect, Model, State, prior_jobs
from unmodeled.units import same_unit

#: Share of the values below the typical size of a quantity [1].
TYPICAL = 0.98
#: Laws that all coordinates may have with one size, as equal gears or bearings.
EQUAL = ("dry friction", "viscous friction")
#: Typical loss of a level by a missing flow, as a share of its own rate [1].
FLOW = 0.1


@checked
def candidates(model: Model, records: Sequence[Record] | Record) -> tuple[Effect, ...]:
    """Effects that a model may lack, with sizes from the records.

    They are the effects that the model offers (unknown parameters of a simulator, the library of a
    mechanism), those of every coordinate, of every other state, of every input, and of every
    sensor. :meth:`unmodeled.fit.Model.diagnose` tests them.

    Parameters
    ----------
    model
        Model of the machine.
    records
        Measured runs; at least one.

    Examples
    --------
    What may be lacking in the equation of a tank whose level [m] was measured:

    >>> import numpy as np
    >>> from unmodeled import Equations, Record, Sensor, candidates
    >>> def rates(t, x, u, p):
    ...     return (-p.outflow * x.level,)
    >>> tank = Equations(
    ...     rates, states={"level": "m"}, parameters={"outflow": (0.5, 0.05, "1/s")}
    ... )
    >>> time = np.linspace(0.0, 4.0, 41)
    >>> level = Sensor(name="level", unit="m", sigma=0.001)
    >>> record = Record(
    ...     name="empties",
    ...     time=time,
    ...     inputs={},
    ...     outputs={"level": np.exp(-0.5 * time)},
    ...     sensors={"level": level},
    ... )
    >>> sorted({"leak level", "gain of sensor level"} & {e.name for e in candidates(tank, record)})
    ['gain of sensor level', 'leak level']
    """
    records = (records,) if isinstance(records, Record) else tuple(records)
    same = matched(model, records)
    ready = same.model.ready(same.records)
    return tuple(_all(ready.model, ready.records))


def chosen_effects(
    model: Model,
    records: Sequence[Record],
    effects: Sequence[Effect | str] | None,
    exclude: Sequence[str] | str,
) -> tuple[tuple[Effect, ...], tuple[str, ...]]:
    """Effects of a diagnosis, and a note about the choice.

    Parameters
    ----------
    model, records
        A model that is ready for its records.
    effects
        Effects, or names and patterns of the default ones; None: all default ones.
    exclude
        Names, patterns, or components that are left out.

    Raises
    ------
    InvalidParameter
        A name fits no effect.
    """
    exclude = [exclude] if isinstance(exclude, str) else list(exclude)
    own = [e for e in effects or () if isinstance(e, Effect)]
    texts = [e for e in effects or () if isinstance(e, str)]
    if effects is not None and not texts and not exclude:
        return tuple(own), ()
    if effects is None:
        own += _all(model, records)
    elif texts:
        own += _named(tuple(_all(model, records)), texts, "effects")
    out = {e.name for e in _named(own, exclude, "exclude")}
    kept = tuple(e for e in own if e.name not in out)
    return kept, (_note(kept, [e.name for e in own if e.name in out], records),)


def _note(kept: Sequence[Effect], out: Sequence[str], records: Sequence[Record]) -> str:
    """Note about the choice of effects; ``out``: those that are left out."""
    counted = Counter((e.component, e.about.kind == "between") for e in kept)
    listed = ", ".join(
        f"{count} {'' if between else 'of '}{part}" for (part, between), count in counted.items()
    )
    left = f"; left out: {', '.join(out)}" if out else ""
    names = ", ".join(dict.fromkeys(r.name for r in records))
    return (
        f"effects tested: {len(kept)} ({listed or 'none'}), with sizes from {names}{left}; "
        "effects= and exclude= change the choice"
    )


def _named(effects: Sequence[Effect], names: Sequence[str], what: str) -> list[Effect]:
    """Effects by name, pattern or component."""
    found: dict[str, Effect] = {}
    for name in names:
        fitting = [
            e for e in effects if fnmatchcase(e.name, name) or fnmatchcase(e.component, name)
        ]
        if not fitting:
            known = [e.name for e in effects]
            raise InvalidParameter(
                f"{what}: got {name!r}, no effect, pattern or component"
                f"{near_names(name, known)}; there are {', '.join(known) or 'none'}"
            )
        found |= {e.name: e for e in fitting}
    return list(found.values())


def _all(model: Model, records: Sequence[Record]) -> Iterator[Effect]:
    yield from model.effects
    if model.offers_all:
        return
    yield from _of_states(model, records)
    for name in model.inputs or dict.fromkeys(n for r in records for n in r.inputs):
        with_it = [r for r in records if name in r.inputs]
        if with_it:
            widest = max(with_it, key=lambda r: float(np.ptp(r.inputs[name])))
            unit = model.units.get(name)
            yield from for_input(name, widest, unit=unit)
    inputs = model.inputs or tuple(dict.fromkeys(n for r in records for n in r.inputs))
    if together := [r for r in records if {*inputs} <= {*r.inputs}]:
        yield from for_all_inputs(inputs, together[0], model.units)
    shown = [n for n in model.outputs if any(n in r.outputs for r in records)]
    if together := [r for r in records if {*shown} <= {*r.outputs}]:
        yield from for_all_sensors(model.outputs, shown, together[0])
    for name in model.outputs:
        seen = [r for r in records if np.isfinite(r.outputs.get(name, np.nan)).any()]
        if seen:
            widest = max(seen, key=lambda r: float(np.nanstd(r.outputs[name])))
            yield from for_sensor(model.outputs, name, widest)
            yield from _parts(model, name, widest)


def _parts(model: Model, name: str, record: Record) -> Iterator[Effect]:
    """Parts of other signals in a reading."""
    long = 0.1 * float(record.time[-1] - record.time[0])
    for other in (n for n in model.outputs if n != name and n in record.outputs):
        yield part_of(model.outputs, name, other, record, unit=model.units.get(other, ""))
    for other in record.inputs:
        times, unit = (0.3 * long, 3.0 * long), model.units.get(other, "")
        yield part_of(model.outputs, name, other, record, times, unit=unit)


def _typical(values: Array) -> float:
    """Typical size of the values that are finite; 1 if all are zero."""
    known = np.abs(values[np.isfinite(values)])
    if not known.size or known.max() == 0.0:
        return 1.0
    return float(np.quantile(known, TYPICAL) or known.max())


def _of_states(model: Model, records: Sequence[Record]) -> Iterator[Effect]:
    states = model.states()
    if not states:
        return
    paths = [(r, x) for r in records if (x := _path(model, r)) is not None]
    if not paths:
        return
    named = [Named(dict(zip((s.name for s in states), x.T, strict=True))) for _, x in paths]
    times = [r.time for r, _ in paths]

    def rates(values: Sequence[Array]) -> list[Array]:
        slopes = [np.gradient(v, t) for v, t in zip(values, times, strict=True)]
        # Of a state that stays where it is, an uneven clock shows the rounding.
        moves = [np.ptp(v) > 1e3 * np.spacing(np.abs(v).max()) for v in values]
        return [s * moving for s, moving in zip(slopes, moves, strict=True)]

    used: set[str] = set()
    equal: dict[tuple[str, str], list[Effect]] = {}
    for c in model.coordinates:
        used |= {n for part in (c, *c.parts) for n in (part.position, part.speed)}
        position, speed = zip(*(c.motion(x) for x in named), strict=True)
        ways = [q - np.median(q) for q in position if q is not None]
        travel = _typical(np.concatenate(ways)) if ways else 1.0
        forces = [
            rate * _inertia(model, c.parts[0], r, x)
            for rate, (r, _), x in zip(rates(speed), paths, named, strict=True)
        ]
        within = model if isinstance(model, Equations) and isinstance(c, Coupling) else None
        if within is not None and isinstance(c, Coupling):
            inside = [within.force_in(c, r, x) for (r, _), x in zip(paths, named, strict=True)]
            forces = inside if np.any(np.concatenate(inside)) else forces
        pace, force = _typical(np.concatenate(speed)), _typical(np.concatenate(forces))
        for effect in for_coordinate(
            c,
            force=force,
            travel=travel,
            speed=pace,
            time=travel / pace,
        ):
            along = ((r, x) for (r, _), x in zip(paths, named, strict=True))
            if within is None or not any(within.is_parameter(effect, *at) for at in along):
                yield effect
            if isinstance(c, Coordinate) and effect.about.fault in EQUAL:
                equal.setdefault((effect.about.fault, effect.unit), []).append(effect)
        yield from _loads(model, c, [r for r, _ in paths], pace)
    for (_, unit), own in equal.items():
        if len(own) > 1:
            of = "coordinates" + f" in {unit}" * (len(equal) > len(EQUAL))
            yield together(own, f"all {of}", rate=rate_of_all([e.rate for e in own if e.rate]))
    for state in (s for s in states if s.name not in used):
        levels = [x[state.name] for x in named]
        values = np.concatenate(levels)
        rate, size = FLOW * _typical(np.concatenate(rates(levels))), _typical(values)
        yield constant_rate(state.name, scale=rate, unit=f"{state.unit}/s")
        yield leak(state.name, scale=rate / size)
        if values.min() >= 0.0:
            unit = "1/s" if state.unit == "1" else f"1/({state.unit} s)"
            yield power_outflow(state.name, 2.0, scale=rate / size**2, unit=unit)
        slow = float(np.median([t[-1] - t[0] for t in times]))
        yield second_store(
            state.name, scale=10.0 * rate / size, size=size, times=(0.03 * slow, 0.3 * slow)
        )
        yield from _exchanges(model, state, paths, values, rate)
        free = {s.name: s.unit for s in states if s.name not in used}
        yield from _products(
            model, state, free, [(r, x) for (r, _), x in zip(paths, named, strict=True)], rate
        )


def _loads(
    model: Model, c: Coordinate | Coupling, records: Sequence[Record], pace: float
) -> Iterator[Effect]:
    """Friction in proportion to an input or an output that is a force, or to what inputs cause."""
    known: dict[str, Callable[..., Any] | None] = {}
    for name in model.inputs:
        unit = model.units.get(name) or next((r.input_units.get(name, "") for r in records), "")
        if unit and unit != "1" and same_unit(unit, c.unit):
            known[name] = None
    if isinstance(model, Equations):
        known |= model.forces_in(c.unit)
        if not known and isinstance(c, Coordinate) and (drive := model.drive_of(c)):
            known["the drive"] = drive
    for name, force in known.items():
        yield load_friction(c, name, speed=pace, force=force)


def _products(
    model: Model,
    state: State,
    units: Mapping[str, str],
    paths: Sequence[tuple[Record, Named]],
    rate: float,
) -> Iterator[Effect]:
    """Losses of a state in proportion to it and another one, which the model does not have."""
    for other in (n for n in units if n != state.name):
        both = _typical(np.concatenate([x[state.name] * x[other] for _, x in paths]))
        unit = product(("s", -1), (units[other], -1))
        effect = product_loss(state.name, state.name, other, scale=rate / both, unit=unit)
        known = isinstance(model, Equations) and any(
            model.is_parameter(effect, *at) for at in paths
        )
        if not known:
            yield effect


def _exchanges(
    model: Model,
    state: State,
    paths: Sequence[tuple[Record, Array]],
    values: Array,
    rate: float,
) -> Iterator[Effect]:
    """Exchanges of a state with inputs in the same unit."""
    for name in model.inputs:
        unit = model.units.get(name) or next((r.input_units.get(name, "") for r, _ in paths), "")
        if not unit or unit == "1" or not same_unit(unit, state.unit):
            continue
        ambient = np.concatenate([r.inputs[name] for r, _ in paths])
        apart = _typical(values - ambient)
        for power in (1.0, 2.0):
            unit = "1/s" if power == 1.0 else f"1/({state.unit} s)"
            scale = rate / apart**power
            yield exchange(state.name, name, power, scale=scale, unit=unit)


def _path(model: Model, record: Record) -> Array | None:
    """States of the tabulated model over a record, (n, nx); None: it has none, or fails."""
    path = model.motion(record, prior_jobs(model, record))
    return None if path is None or not np.isfinite(path).all() else path[0]


def _inertia(model: Model, c: Coordinate, record: Record, x: Named) -> Array | float:
    """Inertia of a coordinate along a path, (n,); 1 if it is not stated."""
    p = Named({p.name: p.value for p in model.parameters})
    with np.errstate(all="ignore"):
        pushed = c.push(np.float64(1.0), record.time, x, Named(dict(record.inputs)), p)[c.speed]
        inertia = np.asarray(1.0 / np.abs(pushed))
    return np.where(np.isfinite(inertia), inertia, 1.0)
