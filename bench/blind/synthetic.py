"""Synthetic records of a mechanism with known causes, for tests of the diagnosis.

The machine behind the records differs from the model. Every tolerance deviates from its value,
beams and string have more shapes and modes, the threshold speed of friction is a third, the
integrator has a smaller tolerance, and half of the effects have another form than in the library.
The sensors are a camera with noise and pixels, and a force sensor with noise and quantization.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from blind.refined import refined as refine
from feltmb.adapters.changes import Change, Entry
from feltmb.adapters.findings import action_with_effects
from feltmb.adapters.library import Library, load_library
from feltmb.mechanism import Action
from feltmb.run.simulate import simulate
from feltmb.run.stroke import Stroke, load_stroke, pulse_stroke, ramp_stroke
from unmodeled.data import Array, Record, Role, Sensor
from unmodeled.errors import InvalidParameter
from unmodeled.fit.noise import Noise

__all__ = ["Case", "Sensors", "Truth", "make_case", "make_record"]


@dataclass(frozen=True, kw_only=True)
class Sensors:
    """Sensors of the machine."""

    rate: float = 2000.0
    """Sample rate of camera and force sensor [Hz]."""
    noise: float = 2e-5
    """Standard deviation of the noise of a tracked point [m]."""
    pixel: float = 2e-5
    """Quantization step of a tracked point [m]; 0: none."""
    correlation_time: float = 0.0
    """Correlation time of the noise of the camera [s]."""
    force_noise: float = 0.01
    """Standard deviation of the noise of the force sensor [N]."""
    force_step: float = 0.006
    """Quantization step of the force sensor [N]: 25 N in 12 bit."""
    motion_noise: float = 2e-6
    """Standard deviation of the noise of the key's displacement as input [m]: a laser sensor."""


@dataclass(frozen=True, kw_only=True)
class Truth:
    """The truth behind the records of a case."""

    seed: int
    effects: Mapping[str, float]
    """Name -> magnitude [unit of the effect]."""
    forms: Mapping[str, str]
    """Name -> difference from the form in the library; absent: no difference."""
    tolerances: Mapping[str, float]
    """Name -> deviation of the parameter [its unit]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """Records and their true causes."""

    name: str
    records: tuple[Record, ...]
    truth: Truth


#: Strokes of a case: three for the fit, two of another loudness that are held out.
STROKES: tuple[tuple[str, Role], ...] = (
    ("piano", "fit"),
    ("mezzo", "fit"),
    ("staccato", "fit"),
    ("forte", "held_out"),
    ("soft_staccato", "held_out"),
)


def _stroke(name: str) -> tuple[Stroke, float]:
    """A stroke and its duration [s]."""
    if name == "fast":
        return load_stroke("forte").scaled(0.9), 0.13
    if name == "slow":
        return ramp_stroke(10.0, 0.02, 0.15, name="slow"), 0.2
    if name == "mezzo":
        return ramp_stroke(12.0, 0.05, 0.18, name="mezzo"), 0.24
    if name == "soft_staccato":
        return pulse_stroke(12.0, 0.05, name="soft_staccato"), 0.26
    return load_stroke(name), {"piano": 0.32, "staccato": 0.26, "forte": 0.18}.get(name, 0.3)


def _shared(entry: Entry, share: float, path: str, other: float) -> tuple[Change, Change]:
    """The change of an entry with a share, and a change of another number beside it."""
    first = entry.changes[0]
    return (
        first.model_copy(update={"add": share}),
        first.model_copy(update={"path": path, "add": other}),
    )


def _other_form(entry: Entry, rng: np.random.Generator) -> tuple[Entry, str]:
    """The same cause in another form than in the library, if there is one."""
    if entry.insert is not None and entry.insert.kind == "clearance":
        seating = 0.6
        pin = entry.insert.model_copy(update={"seating": seating})
        return entry.model_copy(update={"insert": pin}), f"the pin seats at {seating} N"
    if entry.shape is not None:
        low, high = entry.shape.values[0], entry.shape.values[-1]
        value = float(np.exp(rng.uniform(np.log(low), np.log(high))))
        what = entry.shape.path.rpartition(".")[2]
        shape = entry.shape.model_copy(update={"values": (value,)})
        told = f"{what} = {value:.3g} {shape.unit}"
        return entry.model_copy(update={"shape": shape}), told
    if entry.name.startswith("coulomb_friction."):
        body = entry.name.partition(".")[2]
        dry, stribeck = _shared(entry, 0.8, f"bodies.{body}.friction.stribeck", 0.5)
        both = entry.model_copy(update={"changes": (dry, stribeck)})
        return both, "80 % dry friction, 50 % at slow turning"
    if entry.name.startswith("viscous_friction."):
        body = entry.name.partition(".")[2]
        linear, square = _shared(entry, 0.7, f"bodies.{body}.friction.quadratic", 0.2)
        return entry.model_copy(update={"changes": (linear, square)}), "partly v^2"
    return entry, ""


def make_record(
    machine: Action,
    stroke: Stroke,
    outputs: Sequence[str],
    *,
    duration: float,
    sensors: Sensors,
    rng: np.random.Generator,
    motion: bool = False,
    rtol: float = 1e-8,
    name: str = "",
    role: Role = "fit",
    signals: Mapping[str, float] | None = None,
) -> Record:
    """Simulate one measured stroke of a machine.

    Parameters
    ----------
    outputs
        ``POINT.x``, ``POINT.y`` [m], ``finger.force`` [N].
    motion
        Whether the input of the record is the motion of the key front instead of the force.
    signals
        Sensor and input effects by name in the library: ``camera_skew`` and so on.
    """
    chosen = dict(signals or {})
    fine = 4.0 * sensors.rate
    run = simulate(
        machine, stroke, duration=duration, rtol=rtol, output_rate=fine, ledger=False, events=False
    )
    time = np.arange(0.0, duration * (1.0 - 1e-9), 1.0 / sensors.rate)

    def sampled(values: Array, delay: float = 0.0) -> Array:
        out: Array = np.interp(time - delay, run.time, values)
        return out

    skew = chosen.get("camera_skew", 0.0)
    shown: dict[str, Array] = {}
    for output in outputs:
        column = run[output]
        if output == "finger.force":
            shown[output] = sampled(column)
            continue
        moved = sampled(column - column[0], skew)
        point, _, axis = output.rpartition(".")
        tilt = chosen.get("camera_tilt", 0.0)
        if tilt:
            other = run[f"{point}.{'y' if axis == 'x' else 'x'}"]
            moved = moved + (tilt if axis == "x" else -tilt) * sampled(other - other[0], skew)
        shown[output] = (1.0 + chosen.get("camera_scale", 0.0)) * moved
    noisy = {}
    for output, values in shown.items():
        camera = output != "finger.force"
        sigma = sensors.noise if camera else sensors.force_noise
        step = sensors.pixel if camera else sensors.force_step
        noise = Noise(sigma, sensors.correlation_time if camera else 0.0)
        values = values + noise.draw(time, rng)
        noisy[output] = np.round(np.round(values / step) * step, 9) if step else values
    applied = stroke.at(time)
    if motion:
        drop = -(run["key_front.y"] - run["key_front.y"][0])
        error = sensors.motion_noise * rng.standard_normal(time.size)
        inputs = {"displacement": np.round(sampled(drop) + error, 9)}
        input_sigma = {"displacement": sensors.motion_noise}
    else:
        delay = chosen.get("input_delay", 0.0)
        read = (1.0 + chosen.get("input_gain", 0.0)) * stroke.at(time - delay)
        read = read + chosen.get("input_offset", 0.0)
        read = read + sensors.force_noise * rng.standard_normal(applied.size)
        if sensors.force_step:
            read = np.round(np.round(read / sensors.force_step) * sensors.force_step, 9)
        inputs = {"force": read}
        input_sigma = {"force": math.hypot(sensors.force_noise, sensors.force_step / math.sqrt(12))}
    return Record(
        name=name or stroke.name,
        time=time,
        inputs=inputs,
        outputs=noisy,
        sensors={
            o: Sensor(
                name=o,
                unit="N" if o == "finger.force" else "m",
                sigma=sensors.noise if o != "finger.force" else sensors.force_noise,
                quantum=sensors.pixel if o != "finger.force" else sensors.force_step,
                correlation_time=sensors.correlation_time if o != "finger.force" else 0.0,
            )
            for o in noisy
        },
        input_mode="motion" if motion else "force",
        input_sigma=input_sigma,
        role=role,
        source="synthetic",
    )


def make_case(
    action: Action,
    effects: Mapping[str, float],
    *,
    seed: int,
    name: str = "case",
    library: Library | None = None,
    channels: Sequence[str] = (),
    strokes: Sequence[tuple[str, Role]] = STROKES,
    sensors: Sensors | None = None,
    motion: bool = False,
    spread: float = 1.0,
    tolerances: Sequence[str] = ("all",),
    refined: bool = True,
    after_impact: float | None = None,
    other_forms: bool | None = None,
    rtol: float = 1e-8,
) -> Case:
    """Make records of strokes with known causes.

    Parameters
    ----------
    effects
        Name in the library -> magnitude in the effect's own scale (1: the expected magnitude).
    seed
        Seed of all random numbers: tolerances, forms, noise.
    spread
        Deviations of the tolerances, in their standard deviations.
    tolerances
        Tolerances that deviate; names or patterns.
    after_impact
        End of the records after the hammer met the string [s]; None: the duration of the stroke.
        Until then, single shooting is nearly linear.
    refined
        Whether the machine has more shapes and modes and sharper friction than the model.
    other_forms
        Whether effects have another form than in the library, if there is one; None: random.
    motion
        Whether the input of the records is a motion instead of a force.

    Raises
    ------
    InvalidParameter
        An effect is not in the library, or a machine cannot have it twice.
    """
    rng = np.random.default_rng(seed)
    library = library or load_library(action)
    sensors = sensors or Sensors()
    outputs = library.outputs(channels)
    entries: list[tuple[Entry, float, float | None]] = []
    departures = {}
    moved = {e.name for e in library.choose_tolerances(tolerances)}
    for entry in library.tolerances:
        value = float(spread * entry.magnitude * rng.standard_normal())
        if entry.name not in moved:
            continue
        departures[entry.name] = value
        entries.append((entry, value, None))
    forms, magnitudes, signals = {}, {}, {}
    for effect, share in effects.items():
        entry = library.effect(effect)
        magnitude = share * entry.magnitude
        if entry.sign > 0 and magnitude < 0.0:
            raise InvalidParameter(
                f"effect {effect}: magnitude {magnitude:g}, it has none below zero"
            )
        magnitudes[effect] = magnitude
        other = bool(rng.random() < 0.5) if other_forms is None else other_forms
        if other:
            entry, form = _other_form(entry, rng)
            if form:
                forms[effect] = form
        if entry.sensor is not None or entry.input is not None:
            signals[effect] = magnitude
        else:
            entries.append((entry, magnitude, entry.shapes[0]))
    machine = action_with_effects(refine(action) if refined else action, entries)
    records = []
    for stroke_name, role in strokes:
        stroke, duration = _stroke(stroke_name)
        if after_impact is not None:
            found = simulate(machine, stroke, ledger=False, output_rate=100.0).summary
            if "impact_time" in found:
                duration = found["impact_time"] + after_impact
        records.append(
            make_record(
                machine,
                stroke,
                outputs,
                duration=duration,
                sensors=sensors,
                rng=rng,
                motion=motion,
                rtol=rtol,
                name=stroke_name,
                role=role,
                signals=signals,
            )
        )
    truth = Truth(seed=seed, effects=magnitudes, forms=forms, tolerances=departures)
    return Case(name=name, records=tuple(records), truth=truth)
