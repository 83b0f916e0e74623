"""Records of a mechanism: which part of measured ones is compared, and what noise it has."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from feltmb.adapters.simulator import DISPLACEMENT, FORCE, MechanismSimulator, input_of
from feltmb.mechanism import Reading
from unmodeled.data import Array, Record, Sensor
from unmodeled.data.records import NOT_OF_INPUTS
from unmodeled.data.smoothing import (
    LEAST_SAMPLES,
    REST_NOISE,
    WINDOW,
    noise_of_record,
    smooth_record,
    start_of,
)
from unmodeled.errors import DataError
from unmodeled.fit.noise import rounding_error

Mask = NDArray[np.bool_]

#: Number of simulated motions with noise: their rms is then known to a fifth in each window.
DRAWS = 4
#: A key moves where its speed exceeds so many standard deviations of the noise of the speed.
MOVING = 3.0
#: Estimated noise of an input above which a note is given: of a motion [m], of a force [N].
NOTED_NOISE = {"displacement": 2e-7, "force": 1e-4}
#: Displacement above which a part counts as moving [m].
START = 1e-4
#: Share of its largest displacement that a part must reach, and lose again, before a reversal
#: counts.
REACHED, RETURNED = 0.5, 0.1
#: Width of the median filter that removes bad samples.
BAD = 5
#: Relative rounding error of an absolute coordinate in a file.
ROUNDED = 1e-3
#: Smallest distance of two parts that certainly do not touch, whatever the tolerances [m].
CLEAR = 0.5e-3


# ------------------------------------------------------------------------------------- inputs


def driven(records: Sequence[Record]) -> tuple[tuple[Record, ...], tuple[str, ...]]:
    """Records with one kind of input, and sentences about what was changed.

    Where motion and force of the finger are measured, the force is the input, and the motion an
    output. The force that a motion needs depends on the second derivative of the motion, in which
    noise is large; the motion that a force causes depends on integrals of the force. Its samples
    must resolve the force. If the force of one record cannot drive a model, the motion drives all
    of them. The input of a record is not one of its outputs: the model repeats it exactly.
    """
    both = [r for r in records if r.input_mode == "motion" and FORCE in r.outputs]
    refused = [f"{r.name}: {why}" for r in both if (why := _why_not(r))]
    notes: list[str] = []
    if refused:
        notes.append(
            f"the motion drives the model, and {FORCE} is an output; the force would determine "
            f"more, but it cannot drive the model ({'; '.join(refused)})"
        )
    elif both:
        names = ", ".join(r.name for r in both)
        notes.append(
            f"{names}: {FORCE} is measured beside the motion. The measured force drives the model, "
            f"and the measured motion is compared with its {DISPLACEMENT}"
        )
    out = [r if refused or r not in both else _by_force(r) for r in records]
    repeated = [r for r in out if _own(r) in r.outputs and len(r.outputs) > 1]
    if repeated:
        names = ", ".join(r.name for r in repeated)
        notes.append(f"{names}: {_own(repeated[0])} drives the model and is therefore not compared")
    return tuple(_without(r, _own(r)) if r in repeated else r for r in out), tuple(notes)


def _own(record: Record) -> str:
    """Output of the model that repeats the input of a record."""
    return DISPLACEMENT if record.input_mode == "motion" else FORCE


def _without(record: Record, output: str) -> Record:
    return replace(
        record,
        outputs={n: v for n, v in record.outputs.items() if n != output},
        sensors={n: s for n, s in record.sensors.items() if n != output},
    )


def _why_not(record: Record) -> str:
    """Reason why the measured force of a record cannot drive a model; "": it can."""
    force, sensor = record.outputs[FORCE], record.sensors[FORCE]
    missing = int(np.count_nonzero(~np.isfinite(force)))
    if missing:
        return f"{missing} of {force.size} samples are missing"
    if not np.ptp(force) > 0.0:
        return "it is constant"
    unknown = [key for key in NOT_OF_INPUTS if getattr(sensor, key)]
    return f"an input has no {', '.join(unknown)}" if unknown else ""


def _by_force(record: Record) -> Record:
    """A record of a motion with the measured force as its input."""
    outputs, sensors = dict(record.outputs), dict(record.sensors)
    if DISPLACEMENT not in outputs:
        outputs[DISPLACEMENT] = record.inputs["displacement"]
        sensors[DISPLACEMENT] = Sensor(
            name=DISPLACEMENT,
            unit=record.input_units.get("displacement", "m"),
            sigma=record.input_sigma.get("displacement") or None,
            correlation_time=record.input_correlation_time.get("displacement", 0.0),
        )
    free = replace(
        record,
        inputs={},
        input_units={},
        input_sigma={},
        input_correlation_time={},
        outputs=outputs,
        sensors=sensors,
    )
    return free.with_output_as_input(FORCE, "force", mode="force")


def with_noise(record: Record, notes: list[str]) -> Record:
    """A record with the noise of its input; it is estimated, and noted, if it is not specified.

    The noise of a motion is removed by smoothing. The noise of a force moves the model but not the
    machine; it is therefore part of the run-to-run variability.
    """
    name = input_of(record)
    if name not in record.inputs or name in record.input_sigma:
        return record
    sigma = noise_of_record(record.inputs[name])
    if not sigma > 0.0:
        return record
    if sigma > NOTED_NOISE[name]:
        unit, what = ("m", "taken out") if name == "displacement" else ("N", "allowed for")
        notes.append(
            f"{record.name}: the noise of {name} is not specified; {sigma:.2g} {unit} are "
            f"estimated and {what} (specify sigma in the TOML)"
        )
    return replace(record, input_sigma={**record.input_sigma, name: sigma})


# ------------------------------------------------------------------- error of a simulated force


def with_force_error(
    simulator: MechanismSimulator, record: Record, turn: float | None, notes: list[str]
) -> Record:
    """Carry the noise of a measured motion into the force that the motion needs.

    The force depends on the acceleration of the motion, which is known only as far as the motion is
    sampled and smoothed. The smoothed motion is given new noise and smoothed again, and the force
    of the packaged mechanism is simulated with it. The rms difference of four such forces is the
    error. It is added to the noise of the force sensor (root sum of squares).

    A record has one noise by channel, but the error is several times larger where the motion has a
    kink. Samples with the largest error (rms over 8 ms) are therefore not used: as many as make the
    information of the other n samples, ``n^2 / sum(sigma_i^2)``, a maximum. Two other parts are not
    used: samples after the reversal of the stroke, because the impact shakes the key faster than a
    sampled motion shows; and a key at rest, because the sign of friction is that of a speed, which
    is known there only by its noise.

    Parameters
    ----------
    simulator
        Simulator of the mechanism.
    record
        A record; it is returned unchanged if its input is not a motion with noise, or if no force
        is measured.
    turn
        Time of the reversal of the stroke [s]; None: unknown.
    notes
        A sentence is added for each force that is changed.
    """
    names = [o for o in simulator.outputs if simulator.units[o] == "N" and o in record.outputs]
    sigma = record.input_sigma.get("displacement", 0.0)
    if record.input_mode != "motion" or not names or not sigma > 0.0:
        return record
    if record.samples < LEAST_SAMPLES:
        return record
    width = max(1, round(WINDOW / record.interval))
    errors = _squared_errors(simulator, record, sigma, width)
    if errors is None:
        return record
    square, moving = errors
    outputs, sensors = dict(record.outputs), dict(record.sensors)
    for name in names:
        finite = np.isfinite(outputs[name])
        measured = finite & moving & (record.time <= (np.inf if turn is None else turn))
        own = sensors[name].sigma or 0.0
        if not finite.any():
            continue
        used, error = _most_informative(
            square[:, simulator.outputs.index(name)], measured, own, width
        )
        outputs[name] = np.where(used, outputs[name], np.nan)
        sensors[name] = replace(sensors[name], sigma=math.hypot(own, error))
        left = 1.0 - np.count_nonzero(used) / np.count_nonzero(finite)
        notes.append(
            f"{record.name}: displacement has a noise of {sigma:.2g} m, which causes an error of "
            f"{error:.2g} N (rms) of the simulated {name}: it is added to the noise of the sensor; "
            f"{left:.0%} of the samples are not used: larger errors, rest, or after the impact"
        )
    return replace(record, outputs=outputs, sensors=sensors)


def _squared_errors(
    simulator: MechanismSimulator, record: Record, sigma: float, width: int
) -> tuple[Array, Mask] | None:
    """Mean squared error of the outputs by the noise of a motion, (n, ny), and where it moves.

    None if the mechanism cannot be simulated.
    """
    random = np.random.default_rng(0)
    clean = replace(record, input_sigma={**record.input_sigma, "displacement": 0.0})

    def outputs(displacement: Array) -> Array | None:
        return simulator.whole(clean.with_inputs({"displacement": displacement}), simulator.base)

    smoothed = simulator.drives.of(record).value
    base, squares, speeds = outputs(smoothed), [], []
    for _ in range(DRAWS):
        noisy = smoothed + sigma * random.standard_normal(record.samples)
        again = smooth_record(record.time, noisy, sigma)
        other = outputs(again)
        if base is not None and other is not None:
            squares.append(np.square(other - base))
            speeds.append(np.square(np.gradient(again - smoothed, record.time)))
    if not squares:
        return None
    noise = np.sqrt(_local_mean(np.mean(speeds, axis=0), width))
    moving = np.abs(np.gradient(smoothed, record.time)) > MOVING * noise
    return np.mean(squares, axis=0), moving


def _local_mean(values: Array, width: int) -> Array:
    """Mean over a window of some samples, shorter at the ends."""
    window = np.ones(min(width, values.size))
    count = np.convolve(np.ones(values.size), window, "same")
    return np.asarray(np.convolve(values, window, "same") / count)


def _most_informative(
    square: Array, measured: Mask, sigma: float, width: int
) -> tuple[Mask, float]:
    """Samples that are used, and their rms error, from the squared error of each sample."""
    local = _local_mean(square, width)
    order = np.argsort(np.where(measured, local, np.inf), kind="stable")[: measured.sum()]
    used = np.zeros(square.size, dtype=bool)
    if order.size:
        total = np.cumsum(local[order] + sigma**2)
        count = np.arange(1, order.size + 1)
        used[order[: int(np.argmax(count**2 / np.maximum(total, 1e-300))) + 1]] = True
    return used, float(np.sqrt(np.mean(square[used]))) if used.any() else 0.0


# ----------------------------------------------------------------------- displacements from rest


def from_rest(
    record: Record, rest: Mapping[str, float], model: str
) -> tuple[Record, tuple[str, ...], bool]:
    """The record with displacements from rest, a description, and whether all zeros are known.

    Parameters
    ----------
    rest
        Absolute coordinate at rest, for channels that have one [m].
    model
        Name of the model, for the notes.
    """
    starts = {n: _Start.of(record, n, rest[n]) for n in record.outputs if n in rest}
    clear = {s.kind for s in starts.values() if not s.stated}
    frame = "absolute" if "absolute" in clear and "rest" not in clear else "rest"
    outputs, sensors = dict(record.outputs), dict(record.sensors)
    notes: list[str] = []
    absolute: dict[bool, list[str]] = {True: [], False: []}
    lost: list[str] = []
    for name, start in starts.items():
        kind = frame if start.kind == "either" else start.kind
        if not kind:
            lost.append(f"{name} at {start.value:.6g} m ({start.rest:.6g} m)")
        if kind != "absolute":
            continue
        absolute[start.stated].append(name)
        zero = start.rest
        if abs(start.value - start.rest) > start.near:
            zero = start.value
            notes.append(
                f"{record.name}: {name} starts at {start.value:.6g} m, the rest value of {model} "
                f"is {start.rest:.6g} m: the first value of the record is used as rest value"
            )
        outputs[name] = record.outputs[name] - zero
        sensors[name] = replace(sensors[name], reference="rest")
    for stated, names in absolute.items():
        if names:
            why = "as specified" if stated else f"they start at the rest values of {model}"
            notes.insert(
                0,
                f"{record.name}: {', '.join(names)}: absolute coordinates ({why}); compared as "
                "displacements from rest",
            )
    if lost:
        option = lost[0].partition(" ")[0] if len(lost) == 1 else "CHANNEL"
        notes.insert(
            0,
            f"{record.name}: starts neither at zero nor at the rest values of {model} (in "
            f"brackets): {', '.join(lost)}; treated as displacements from rest (--origin "
            f"{option}=start: the first value is rest; --reference {option}=absolute; the same "
            "names are keys of the TOML)",
        )
    if not any(absolute.values()):
        return record, tuple(notes), not lost
    return replace(record, outputs=outputs, sensors=sensors), tuple(notes), not lost


@dataclass(frozen=True)
class _Start:
    """Start value of a channel, and the zero that follows from it."""

    value: float
    rest: float
    near: float
    """Largest distance from the rest position of the model that counts as a start at rest [m]."""
    kind: str
    """"rest", "absolute", "either" (both are equal within the noise), or "" (neither)."""
    stated: bool

    @classmethod
    def of(cls, record: Record, name: str, rest: float) -> _Start:
        sensor, values = record.sensors[name], record.outputs[name]
        known = values[np.isfinite(values)]
        white = noise_of_record(known) if sensor.sigma is None else sensor.sigma
        sigma = math.hypot(white, rounding_error(sensor.quantum))
        start = start_of(values, sigma)
        near = max(REST_NOISE * sigma, ROUNDED * abs(rest))
        still = max(REST_NOISE * sigma, ROUNDED * float(np.max(np.abs(known), initial=0.0)))
        at_zero, at_rest = abs(start) <= still, abs(start - rest) <= near
        kind = "rest" if at_zero or not math.isfinite(start) else "absolute" if at_rest else ""
        if at_zero and at_rest:
            kind = "either"
        return cls(start, rest, near, sensor.reference or kind, bool(sensor.reference))


def check_input_zero(record: Record, name: str) -> None:
    """Refuse a motion whose zero is not that of the machine at rest.

    Parameters
    ----------
    record
        Measured run.
    name
        Name of the motion among its inputs.

    Raises
    ------
    DataError
        The motion starts farther from zero than it moves.
    """
    values = record.inputs.get(name)
    if values is not None and abs(values[0]) > float(np.ptp(values)) > 0.0:
        raise DataError(
            f"record {record.name}: {name} starts at {values[0]:.4g} m and moves by "
            f"{np.ptp(values):.3g} m, expected a start near 0, at rest: what is its zero (--origin "
            f"{name}=start, origin in the TOML file)?"
        )


# -------------------------------------------------------------------------- what a stroke reaches


def first_turn(time: Array, values: Array) -> float | None:
    """Time of the first reversal of a motion [s]; None: it hardly moves, or does not reverse.

    Parameters
    ----------
    time, values
        Times (n,) [s] and displacements from rest [m]; NaN is missing. One or two consecutive bad
        samples are ignored.
    """
    from scipy.ndimage import median_filter

    finite = np.isfinite(values)
    clock, travel = time[finite], median_filter(np.abs(values[finite]), BAD)
    if travel.size == 0 or np.max(travel) < 10 * START:
        return None
    far = float(np.max(travel))
    highest = np.maximum.accumulate(travel)
    back = (highest >= REACHED * far) & (travel < highest - RETURNED * far)
    if not np.any(back):
        return None
    return float(clock[np.argmax(travel[: int(np.argmax(back))])])


def landmarks(
    time: Array, outputs: Mapping[str, Array], reading: Reading
) -> list[tuple[str, float]]:
    """Names and times [s] of the events in the channels, sorted by time.

    Parameters
    ----------
    time
        Times (n,) [s].
    outputs
        Displacements from rest [m] by output name; NaN is missing.
    reading
        Names of the points of the key and of the hammer.
    """
    found: list[tuple[str, float]] = []
    key = outputs.get(f"{reading.key_point}.y")
    if key is not None and np.isfinite(key).sum() > 10:
        start = _crossing(time, -key, START)
        if start is not None:
            found.append(("key_start", start))
        lowest = np.nanmin(key)
        landing = _crossing(time, -key, -0.97 * lowest) if lowest < -10 * START else None
        if landing is not None:
            found.append(("key_landing", landing))
    striker = reading.striker
    hammer = None if striker is None else outputs.get(f"{striker.point}.{striker.axis}")
    if hammer is not None and np.isfinite(hammer).sum() > 10:
        start = _crossing(time, np.abs(hammer), START)
        if start is not None:
            found.append(("hammer_start", start))
        if np.nanmax(np.abs(hammer)) > 10 * START:
            turn = int(np.nanargmax(np.abs(hammer)))
            found.append(("hammer_turn", float(time[turn])))
    return sorted(found, key=lambda item: item[1])


def _crossing(time: Array, values: Array, level: float) -> float | None:
    """First time at which values rise through a level, by linear interpolation."""
    above = np.flatnonzero(values > level)
    if above.size == 0 or above[0] == 0:
        return None
    i = int(above[0])
    low, high = values[i - 1], values[i]
    if not np.isfinite(low):
        return float(time[i])
    return float(time[i - 1] + (time[i] - time[i - 1]) * (level - low) / (high - low))


def unreached(simulator: MechanismSimulator, records: Sequence[Record]) -> str:
    """Sentence about the let-off, the strike and the check if no record reaches them.

    The tabulated mechanism is simulated. Empty if records reach all of them or come near, and if a
    record cannot be simulated.

    Parameters
    ----------
    simulator
        Simulator of the tabulated mechanism.
    records
        All records, as far as they are compared.
    """
    config = simulator.action.config
    roles = config.reading
    toe = config.events.get(roles.touch.toe or "")
    let_off = [] if toe is None or toe.contact is None else toe.contact
    contacts: dict[str, Sequence[int]] = {
        "let-off": [let_off] if isinstance(let_off, int) else let_off,
        "strike": [] if roles.strike_contact is None else [roles.strike_contact],
        "check": roles.check_contacts,
    }
    open_by: dict[str, tuple[float, str]] = {n: (np.inf, "") for n, own in contacts.items() if own}
    for record in records:
        result = simulator.run(record, simulator.base) if open_by else None
        if result is None:
            return ""
        for name in open_by:
            gaps = [(_distance(result, f"{n:02d}"), f"{n:02d}") for n in contacts[name]]
            open_by[name] = min(open_by[name], *gaps)
        open_by = {name: gap for name, gap in open_by.items() if gap[0] > CLEAR}
    apart = [
        f"the {name} (contact {number} stays {1e3 * distance:.2g} mm open)"
        for name, (distance, number) in open_by.items()
    ]
    if not apart or not records:
        return ""
    held = " and is held there" if apart[-1].startswith("the check") else ""
    return (
        f"no record reaches {' and '.join(apart)}, by the tabulated numbers: what acts from there "
        "on only, such as a part that is out of regulation, cannot be found in these records; add "
        f"a stroke that goes further{held}"
    )


def _distance(result: Any, number: str) -> float:
    """Smallest distance of two parts in a run [m]; a contact without a compression touches."""
    names = list(result.names)
    if f"contact{number}.compression" not in names:
        return -np.inf
    return -float(np.max(result.data[:, names.index(f"contact{number}.compression")]))
