"""Model of single impacts, for sparse published data instead of time series.

A record is one impact. Its input is the speed before the impact. Its outputs are values of
``run.summary``, such as the largest force and the duration of contact. The impact is a stroke of
the whole mechanism; all speeds are scaled 3 ms before it, so that the hammer has the given speed.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from feltmb import _core
from feltmb.adapters.effects import effect_of, parameter_of
from feltmb.adapters.library import Entry, load_library
from feltmb.adapters.reuse import Reuse
from feltmb.adapters.variants import Variant, Workshop, changed_config
from feltmb.arguments import checked
from feltmb.data import Array, Record, Sensor
from feltmb.errors import DataError, FeltmbError, InvalidParameter
from feltmb.files import named_file, read_toml
from feltmb.fit import (
    Candidate,
    Effect,
    Jobs,
    Model,
    Sensitivity,
    SensitivityRequest,
    Simulated,
    State,
)
from feltmb.mechanism import Action, load_action
from feltmb.run.arrays import renamed
from feltmb.run.simulate import simulate
from feltmb.run.strikes import ONE_STRIKE
from feltmb.run.stroke import Stroke, load_stroke
from feltmb.units.quantity import SI, Schema, fault_text, parse_scalar, validated

__all__ = ["ImpactModel", "impact_record", "load_impacts"]

#: Time before contact with the string at which the speed of the hammer is set [s].
BEFORE = 3e-3
#: Duration of the simulation after the speed was set [s].
AFTER = 13e-3


@checked
def impact_record(
    name: str,
    stroke: str,
    impact_speed: float,
    numbers: Mapping[str, tuple[float, float, str]],
    *,
    values: Mapping[str, float | str | bool] | None = None,
    role: str = "fit",
    source: str = "",
) -> Record:
    """Record of one impact.

    Parameters
    ----------
    stroke
        Packaged stroke or file that moves the hammer to the string.
    impact_speed
        Speed before the impact, normal to the string [m/s].
    numbers
        Key of ``run.summary`` -> (value, standard deviation, unit), in SI units.
    values
        Overrides of this impact, such as ``{"string.kind": "rigid_stop"}``.
    """
    conditions: dict[str, float | str] = {"stroke": stroke}
    conditions |= {
        f"set {k}": v if isinstance(v, str) else float(v) for k, v in (values or {}).items()
    }
    return Record(
        name=name,
        time=np.array([0.0, 1.0]),
        inputs={"impact_speed": np.full(2, impact_speed)},
        outputs={k: np.array([v, np.nan]) for k, (v, _, _) in numbers.items()},
        sensors={k: Sensor(name=k, unit=u, sigma=s) for k, (_, s, u) in numbers.items()},
        conditions=conditions,
        role="held_out" if role == "held_out" else "fit",
        source=source,
    )


class ImpactModel(Model):
    """A mechanism as a model of the values of impacts.

    Parameters
    ----------
    action
        The mechanism; it needs ``reading.strike_contact``.
    tolerances
        Parameters to be estimated.
    outputs
        Keys of ``run.summary``.
    rtol
        Relative tolerance of the integrator.
    """

    segment = None
    chaotic = False
    least_samples = 2
    difference_step = 0.05

    def __init__(
        self,
        action: Action,
        tolerances: Sequence[Entry],
        outputs: Sequence[str],
        *,
        rtol: float = 1e-7,
    ):
        if action.config.reading.strike_contact is None:
            raise InvalidParameter(
                f"mechanism {action.name!r} names no strike contact in [reading]: it has no impacts"
            )
        self.action = action
        self.name = action.name
        self.outputs = tuple(outputs)
        self.units = {**_UNITS, "impact_speed": "m/s"}
        self.tolerances = tuple(tolerances)
        self.rtol = rtol
        self.parameters = tuple(parameter_of(e) for e in tolerances)
        self.reuse = Reuse()
        self._known: dict[bytes, Array] = {}
        self._impact_times: dict[str, float] = {}
        self._actions: dict[str, Action] = {}
        self._lock = threading.Lock()
        self._workshop = Workshop()
        self._strike_contact = action.config.reading.strike_contact
        self._strike_index = action.mechanism.contact_numbers.index(self._strike_contact)

    def states(self, included: Sequence[Candidate] = ()) -> tuple[State, ...]:
        """No states: an impact starts at rest."""
        del included
        return ()

    def forget(self) -> None:
        """See :class:`~feltmb.fit.Model`: clears the cached derivatives."""
        self.reuse.clear()

    def accepts(self, effect: Effect) -> bool:
        """Whether an effect has an :class:`Entry`."""
        return isinstance(effect.data, Entry) or super().accepts(effect)

    def simulate(self, record: Record, jobs: Jobs) -> Simulated:
        """Simulate one impact for each job; both samples of the record contain it."""
        outputs = np.full((jobs.count, jobs.longest, len(self.outputs)), np.nan)

        def work(b: int) -> None:
            magnitudes = jobs.magnitudes[b] if jobs.included else np.zeros(0)
            outputs[b] = self._readings(record, jobs.theta[b], jobs.included, magnitudes)

        with ThreadPoolExecutor(min(8, os.cpu_count() or 1)) as pool:
            list(pool.map(work, range(jobs.count)))
        return Simulated(outputs=outputs, ends=np.zeros((jobs.count, 0)))

    def sensitivities(  # noqa: D102
        self, requests: Sequence[SensitivityRequest]
    ) -> list[Sensitivity]:
        # Differences, cached while the point changes little.
        compute = super().sensitivities
        for request in requests:
            request.check(self)
        return [self.reuse.ask(self, request, compute) for request in requests]

    def numbers(
        self,
        record: Record,
        theta: Array,
        included: tuple[Candidate, ...] = (),
        magnitudes: Array | None = None,
    ) -> dict[str, float]:
        """Values of an impact by key; NaN if the impact does not have the value.

        Parameters
        ----------
        record
            Record whose inputs drive the model.
        theta
            Values of the parameters [SI].
        included
            Effects that are included.
        magnitudes
            Magnitude of each included effect.
        """
        values = self._readings(
            record, theta, included, np.zeros(0) if magnitudes is None else magnitudes
        )
        return dict(zip(self.outputs, values.tolist(), strict=True))

    def _readings(
        self, record: Record, theta: Array, included: tuple[Candidate, ...], magnitudes: Array
    ) -> Array:
        entries: list[tuple[Entry, float, float | None]] = [
            (e, float(v), None) for e, v in zip(self.tolerances, theta, strict=True)
        ]
        for candidate, magnitude in zip(included, magnitudes, strict=True):
            if isinstance(candidate.effect.data, Entry):
                entries.append((candidate.effect.data, float(magnitude), candidate.shape))
        if "impact_speed" not in record.inputs:
            raise DataError(f"record {record.name}: input 'impact_speed' is missing")
        speed = float(record.inputs["impact_speed"][0])
        key = repr(
            (sorted(record.conditions.items()), speed, [(e.name, s, x) for e, s, x in entries if s])
        ).encode()
        if key not in self._known:
            self._known[key] = self._run(record, speed, entries)
        return self._known[key]

    def _run(
        self, record: Record, speed: float, entries: Sequence[tuple[Entry, float, float | None]]
    ) -> Array:
        stroke = load_stroke(str(record.conditions.get("stroke", "")))
        values = {
            k.removeprefix("set "): v for k, v in record.conditions.items() if k.startswith("set ")
        }
        try:
            config = changed_config(self._with(values).config, entries, record.conditions)
            numbers = self._strike(self._workshop.build(config), stroke, speed)
        except (FeltmbError, RuntimeError):
            return np.full(len(self.outputs), np.nan)
        return np.array([numbers.get(o, np.nan) for o in self.outputs])

    def _with(self, values: Mapping[str, float | str]) -> Action:
        key = repr(sorted(values.items()))
        if key not in self._actions:
            self._actions[key] = self.action.with_values(values) if values else self.action
        return self._actions[key]

    def _strike(self, v: Variant, stroke: Stroke, speed: float) -> dict[str, float]:
        """Values of an impact with the given speed."""
        start = self._start(stroke)
        before = self._simulate(v, stroke, list(v.rest), list(v.memory), start, events=False)
        later = stroke.shifted(-start)
        n = len(v.mechanism.coordinates)
        numbers: dict[str, float] = {}
        factor = 1.0
        for _ in range(3):
            state = np.asarray(before.end_state).copy()
            state[n : 2 * n] *= factor
            memory = list(before.end_largest_compression)
            run = self._simulate(v, later, list(state), memory, AFTER, events=True)
            numbers = self._numbers(run)
            if "impact_speed" not in numbers:
                raise InvalidParameter(f"stroke {stroke.name!r}: no impact within {AFTER:g} s")
            if abs(numbers["impact_speed"] / speed - 1.0) < 1e-5:
                break
            factor *= speed / numbers["impact_speed"]
        return numbers

    def _simulate(
        self,
        v: Variant,
        stroke: Stroke,
        state: list[float],
        memory: list[float],
        duration: float,
        *,
        events: bool,
    ) -> Any:
        options = _core.SimulationOptions()
        options.duration, options.rtol = duration, self.rtol
        options.output_rate = 2.0 / duration
        options.ledger = options.diagnose = False
        options.events = events
        options.finger_reference = v.finger_reference
        if events:
            options.peak_contacts = [self._strike_contact]
        return _core.simulate(v.mechanism, stroke.input, options, state, [], None, memory)

    def _numbers(self, run: Any) -> dict[str, float]:
        """First closing of the strike contact, its last opening within the impact, and the peak."""
        changes = [
            (i, time, direction)
            for i, (time, contact, _, direction) in enumerate(run.events)
            if contact == self._strike_index
        ]
        on = next(((i, t) for i, t, d in changes if d > 0), None)
        if on is None:
            return {}
        approach = run.event_approach[:, self._strike_index]
        out = {"impact_speed": float(approach[on[0]])}
        offs = [(i, t) for i, t, d in changes if d < 0 and on[1] < t <= on[1] + ONE_STRIKE]
        if offs:
            out["rebound_speed"] = float(-approach[offs[-1][0]])
            out["impact_duration"] = offs[-1][1] - on[1]
        for contact, force, _ in run.peaks:
            if contact == self._strike_index:
                out["max_impact_force"] = float(force)
        return out

    def _start(self, stroke: Stroke) -> float:
        """Time at which the speed is set: before the impact of the unchanged mechanism [s]."""
        with self._lock:
            if stroke.name not in self._impact_times:
                run = simulate(self.action, stroke, ledger=False, output_rate=100.0)
                if "impact_time" not in run.summary:
                    raise InvalidParameter(
                        f"stroke {stroke.name!r}: the hammer does not meet the string"
                    )
                self._impact_times[stroke.name] = run.summary["impact_time"]
            return self._impact_times[stroke.name] - BEFORE


class _ImpactTable(Schema):
    name: str
    stroke: str
    impact_speed: Annotated[float, SI("m/s"), Field(gt=0)]
    role: Literal["fit", "held_out"] = "fit"
    values: dict[str, float | str | bool] = {}
    note: str = ""
    rebound_speed: dict[str, Any] | None = None
    max_impact_force: dict[str, Any] | None = None
    impact_duration: dict[str, Any] | None = None


class _ImpactFile(Schema):
    schema_version: Annotated[Literal[1], Field(alias="schema")]
    about: str = ""
    action: str
    values: dict[str, float | str | bool] = {}
    cite: str = ""
    tolerances: list[str] = []
    effects: list[str] = []
    records: list[_ImpactTable]


_UNITS = {"rebound_speed": "m/s", "max_impact_force": "N", "impact_duration": "s"}


@checked
def load_impacts(path: str | Path) -> tuple[ImpactModel, tuple[Effect, ...], tuple[Record, ...]]:
    """Model, effects and records of a TOML file of impacts.

    Every value is a table ``{ value, unit, sd }``; ``sd`` is in the same unit and required.
    ``values`` at the top level are values of the mechanism by dotted path, for all impacts.

    Raises
    ------
    InvalidParameter
        Faults of the file, all in one message.
    """
    path = Path(path)
    file = validated(_ImpactFile, renamed(read_toml(path)), path.name)
    action = load_action(named_file(path.parent, file.action, f"{path.name}: action"))
    if file.values:
        action = action.with_values(file.values)
    library = load_library(action)
    faults, records, used = [], [], []
    for table in file.records:
        numbers = {}
        for key, unit in _UNITS.items():
            node = getattr(table, key)
            if node is None:
                continue
            try:
                if "sd" not in node:
                    raise ValueError("sd is missing")
                value = parse_scalar(node, unit)
                sd = parse_scalar({"value": node["sd"], "unit": node.get("unit", unit)}, unit)
                numbers[key] = (value, sd, unit)
                used.append(key)
            except ValueError as error:
                faults.append(f"records.{table.name}.{key}: {error}")
        if all(getattr(table, key) is None for key in _UNITS):
            faults.append(f"records.{table.name}: no number; known are {', '.join(_UNITS)}")
        if not numbers:
            continue
        records.append(
            impact_record(
                table.name,
                str(
                    named_file(
                        path.parent, table.stroke, f"{path.name}: records.{table.name}.stroke"
                    )
                ),
                table.impact_speed,
                numbers,
                values={k: v for k, v in table.values.items()},
                role=table.role,
                source=file.cite,
            )
        )
    tolerances: tuple[Entry, ...] = ()
    try:
        tolerances = library.choose_tolerances(file.tolerances or ["none"])
    except InvalidParameter as error:
        faults.append(str(error))
    if faults:
        raise InvalidParameter(fault_text(path.name, faults))
    outputs = [key for key in _UNITS if key in used]
    model = ImpactModel(action, tolerances, outputs)
    effects = tuple(effect_of(e, (), {}) for e in library.select(file.effects))
    return model, effects, tuple(records)
