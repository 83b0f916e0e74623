"""Prepares model and records: noise of the sensors, held-out records, unknowns of each record."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from unmodeled.chain import fault_of, faults
from unmodeled.data import Array, Record, Role
from unmodeled.data.records import UNNAMED
from unmodeled.data.smoothing import noise_of_samples
from unmodeled.data.thinning import thinned
from unmodeled.data.wrapping import wrap_of
from unmodeled.errors import DataError, InvalidParameter, merged, near_names
from unmodeled.fit.noise import Noise, noise_of, rounding_error
from unmodeled.library import clock_rate
from unmodeled.models.matching import matched
from unmodeled.models.model import Effect, Model, Ready, start_in
from unmodeled.search.options import Options
from unmodeled.search.problem import (
    UNKNOWN_START,
    Cause,
    Local,
    Observed,
    Problem,
    spread,
)
from unmodeled.search.scopes import with_scopes
from unmodeled.units import same_unit, weight_hint, zero_and_factor

#: Prior probability that something stated is wrong: a tolerance of a parameter, the clock, or the
#: zero of a sensor in each record [1].
WRONG_STATEMENT = 0.05
#: Expected error of a sensor in each record, as a share of the motion or of the reading [1].
SHARE = 0.05
#: Simulated time after the end of a record, which a fast clock shows, as a share of it [1].
AFTER = 0.05


def ready_records(model: Model, records: Sequence[Record] | Record) -> Ready:
    """Model and records, checked and prepared, with notes about what was assumed.

    Raises
    ------
    DataError
        The faults because of which the records cannot be used, all in one message.
    """
    records, numbers = _numbered((records,) if isinstance(records, Record) else tuple(records))
    same = matched(model, records)
    model, records = same.model, same.records
    notes = check_records(records, model)
    records, told = _without_constant(records, model.outputs)
    records, less = thinned(records, model.outputs)
    notes += [*numbers, *same.notes, *told, *less]
    ready = model.ready(records)
    return replace(ready, notes=tuple(dict.fromkeys((*notes, *ready.notes))))


def _numbered(records: tuple[Record, ...]) -> tuple[tuple[Record, ...], list[str]]:
    """Records of which those without a name are numbered, and a note about them."""
    unnamed = [r for r in records if r.name == UNNAMED]
    if len(unnamed) < 2:
        return records, []
    taken = {r.name for r in records}
    names = (n for k in itertools.count(1) if (n := f"{UNNAMED}-{k}") not in taken)
    out = tuple(replace(r, name=next(names)) if r.name == UNNAMED else r for r in records)
    return out, [f"{len(unnamed)} records without a name are {UNNAMED}-1 and so on, in their order"]


def _without_constant(
    records: Sequence[Record], outputs: Sequence[str]
) -> tuple[tuple[Record, ...], list[str]]:
    """Remove outputs without a stated noise that change in no record: their noise is not known."""
    known = {
        n
        for r in records
        for n, y in r.outputs.items()
        if r.sensors[n].sigma is not None or np.unique(y[np.isfinite(y)]).size != 1
    }
    recorded = dict.fromkeys(n for r in records for n in r.outputs)
    still = [n for n in recorded if n in outputs and n not in known]
    for r in records:
        if still and not {*r.outputs} & {*outputs} - {*still}:
            raise DataError(
                f"record {r.name}: {', '.join(still)}: never changes, so that its noise cannot be "
                "estimated; expected sigma of its sensor, or a channel that changes"
            )
    kept = tuple(
        replace(
            r,
            outputs={n: v for n, v in r.outputs.items() if n not in still},
            sensors={n: v for n, v in r.sensors.items() if n not in still},
        )
        if still
        else r
        for r in records
    )
    return kept, [
        f"{n}: never changes, so that its noise cannot be estimated: it is not used; state sigma "
        "of its sensor to use it"
        for n in still
    ]


def prepare(
    ready: Ready,
    effects: Sequence[Effect],
    hold_out: Sequence[str] | str | None,
    options: Options,
) -> Problem:
    """The problem of a diagnosis.

    ``hold_out``: names of the held-out records; None: see :func:`split_records`.

    Raises
    ------
    InvalidParameter, DataError
        The model does not accept an effect, or no record shows an output of the model.
    """
    _check_effects(ready.model, effects)
    fitted, held = split_records(ready.records, hold_out)
    problem = problem_of(ready.model, effects, fitted, held, options, ready.notes, ready.records)
    problem = replace(problem, causes=tuple(as_parameter(ready.model, c) for c in problem.causes))
    return with_scopes(problem, ready.records, options.then)


def same_number(model: Model, effect: Effect) -> int | None:
    """Index of the parameter with a tolerance that an effect changes; None: there is none.

    A diagnosis has one unknown for both: two would share one deviation, and neither of them would
    be its size.
    """
    for i, p in enumerate(model.parameters):
        if p.name == effect.tolerance_parameter and 0.0 < p.sd < math.inf:
            return i
    return None


def as_parameter(model: Model, cause: Cause) -> Cause:
    """The cause, as a parameter if it is an effect that changes one with a tolerance."""
    if cause.effect is None or (index := same_number(model, cause.effect)) is None:
        return cause
    return replace(cause, effect=None, parameter=index, alias=cause.effect)


def problem_of(
    model: Model,
    effects: Sequence[Effect],
    fitted: Sequence[Record],
    held: Sequence[Record],
    options: Options,
    notes: tuple[str, ...] = (),
    measured: Sequence[Record] = (),
) -> Problem:
    """The problem of records that are ready for the model (:meth:`unmodeled.fit.Model.ready`).

    ``measured``: the whole records, of which ``fitted`` and ``held`` may be parts.

    Raises
    ------
    DataError
        No record shows an output of the model.
    """
    channels, records = _channels(model, fitted), (*fitted, *held)
    names = [model.outputs[c] for c in channels]
    units = dict.fromkeys(u for r in records for n, u in r.units.items() if n in names)
    if unknown := [n for n in options.good_enough if n not in {*model.outputs, *units}]:
        raise InvalidParameter(
            f"good_enough: got {', '.join(unknown)}, expected an output "
            f"({', '.join(model.outputs)}) or a unit of one ({', '.join(units)})"
        )
    sensors = [r.sensors[n] for r in fitted for n in names if n in r.outputs]
    noise = _noise_levels(measured or records)
    # Functions of a user may return arrays of the length of the measured record.
    clock = clock_rate()
    after = AFTER if model.states() and model.accepts(clock) else 0.0
    observed, unseen = (
        tuple(
            replace(_observed(model, r, names, noise, after), number=k)
            for r, k in zip(part, _places_of(part, measured), strict=True)
        )
        for part in (fitted, held)
    )
    of_records = _errors(model, effects, observed, names, clock)
    return Problem(
        model=model,
        causes=causes_of(model, effects, options.prior, of_records),
        fit=observed,
        held_out=unseen,
        channels=channels,
        noise_estimated=all(s.sigma is None for s in sensors),
        notes=notes,
    )


def _places_of(part: Sequence[Record], measured: Sequence[Record]) -> list[int]:
    """Index of the measured record of each record; blocks of records are in their order."""
    at = {id(r): k for k, r in enumerate(measured)}
    return [at.get(id(r), k) for k, r in enumerate(part)]


def _channels(model: Model, records: Sequence[Record]) -> tuple[int, ...]:
    """Outputs of the model that a record shows, as indices."""
    shown = {n for r in records for n, y in r.outputs.items() if np.isfinite(y).any()}
    channels = tuple(i for i, n in enumerate(model.outputs) if n in shown)
    if not channels:
        raise DataError(
            f"records: they show {', '.join(sorted(shown)) or 'nothing'}, expected an output of "
            f"the model {model.name} ({', '.join(model.outputs)})"
        )
    return channels


def _errors(
    model: Model,
    effects: Sequence[Effect],
    records: Sequence[Observed],
    names: Sequence[str],
    clock: Effect,
) -> list[Cause]:
    """Errors of the records that every diagnosis considers, unless the list or a sheet has them."""
    rms, found = spread(records), []
    listed = {e.name for e in effects}
    by_subject = {(e.about.kind, e.about.fault, e.about.channel) for e in effects}
    if model.accepts(clock) and clock.name not in listed:
        found.append(Cause(clock.name, clock.component, clock))
    stated = {(q.kind, c) for o in records for q in o.local for c in q.channels}
    if len(records) > 1 and model.accepts(clock) and "clock" not in {kind for kind, _ in stated}:
        every = tuple(range(len(names)))
        local = Local("clock", 0, 0.0, clock.scale, channels=every)
        found.append(Cause(f"{clock.name} in each record", clock.component, local=local))
    interval = float(np.median([o.record.interval for o in records]))
    for c, name in enumerate(names):
        if len(records) < 2 or rms[c] == 0.0:
            continue
        for fault in (f for f in faults().values() if f.each and (f.name, c) not in stated):
            if not (fault.always or ("sensor", fault.name, name) in by_subject):
                continue
            scale = {"": SHARE * float(rms[c]), "s": interval}.get(fault.unit, SHARE)
            label = f"{fault.name} of sensor {name} in each record"
            local = Local(fault.name, c, 0.0, scale, channels=(c,))
            found.append(Cause(label, f"sensor {name}", local=local, channel=name))
    return found


def causes_of(
    model: Model,
    effects: Sequence[Effect],
    missing: float,
    of_records: Sequence[Cause] = (),
) -> tuple[Cause, ...]:
    """Effects, errors of each record, and parameters outside their tolerances, with prior odds.

    ``missing``: prior probability that one of these causes exists [1].
    """
    covered = {e.tolerance_parameter for e in effects}
    free = [
        i
        for i, p in enumerate(model.parameters)
        if 0.0 < p.sd < math.inf and p.of_the_machine and p.name not in covered
    ]
    total = sum(e.weight for e in effects)
    share = WRONG_STATEMENT / max(len(free) + len(of_records), 1)
    wrong = math.log(share / (1.0 - share))
    by_effect = [
        Cause(
            e.name,
            e.component,
            e,
            log_odds=math.log(missing * e.weight / (total - missing * e.weight)),
        )
        for e in effects
    ]
    by_parameter = [
        Cause(p.name, p.component or p.title, parameter=i, log_odds=wrong)
        for i, p in ((i, model.parameters[i]) for i in free)
    ]
    return (*by_effect, *(replace(c, log_odds=wrong) for c in of_records), *by_parameter)


def _check_effects(model: Model, effects: Sequence[Effect]) -> None:
    faults = [
        f"effect {e.name}: the model {model.name} does not know how to simulate it"
        for e in effects
        if not model.accepts(e)
    ]
    names = [e.name for e in effects]
    faults += [
        f"effect {n}: is listed twice" for n in sorted({n for n in names if names.count(n) > 1})
    ]
    if faults:
        raise InvalidParameter("; ".join(faults))


def _observed(
    model: Model, measured: Record, names: Sequence[str], noise: Mapping[str, float], after: float
) -> Observed:
    """A record, continued by a share of it, with the noise of its sensors and its unknowns."""
    record = measured.continued(after)
    values = record.output_array(names)
    valid = np.isfinite(values)
    sd = np.ones_like(values)
    local: list[Local] = list(_starts(model, record))
    errors: dict[tuple[str, float, int], list[int]] = {}
    for c, name in enumerate(names):
        if not valid[:, c].any():
            continue
        sensor = record.sensors[name]
        own = noise_of_channel(record, name, noise[name])
        sd[:, c] = own.sd_of_measured(record.time, values[:, c])
        for kind, scale in sensor.unknown.items():
            apart = -1 if fault_of(kind).common else c
            errors.setdefault((kind, scale, apart), []).append(c)
    for (kind, scale, _), some in errors.items():
        local.append(Local(kind, some[0], 0.0, scale, channels=tuple(some)))
    more = record.samples - measured.samples
    return Observed(record, np.where(valid, values, 0.0), valid, sd, tuple(local), after=more)


def _noise_levels(records: Sequence[Record]) -> dict[str, float]:
    """Noise of each sensor, pooled over the records: one sensor has one noise [its unit]."""
    found: dict[str, list[tuple[bool, float]]] = {}
    for r in records:
        for name, values in r.outputs.items():
            moves = np.unique(values[np.isfinite(values)]).size > 1
            found.setdefault(name, []).append((moves, noise_of_channel(r, name).sigma))
    out = {}
    for name, own in found.items():  # a record in which it does not move shows no noise
        some = [sigma for moves, sigma in own if moves] or [sigma for _, sigma in own]
        out[name] = math.sqrt(float(np.mean(np.square(some))))
    return out


def noise_of_channel(record: Record, name: str, pooled: float | None = None) -> Noise:
    """Noise of a channel: stated, or estimated from the differences of neighboring samples.

    An estimate is at least the rounding error of the smallest step between two values.

    ``pooled``: noise of the sensor in all records, unless the record states it [its unit]; None: it
    is estimated from this record.
    """
    sensor, values = record.sensors[name], record.outputs[name]
    sigma = sensor.sigma
    most = float(np.nanmax(np.abs(values), initial=0.0))
    if sigma is None and pooled is not None:
        sigma = pooled
    elif sigma is None:
        known = values[np.isfinite(values)]
        steps = np.diff(np.unique(known))
        steps = steps[steps > 1e-9 * most]
        sigma = noise_of_samples(record.time[np.isfinite(values)], known)
        sigma = max(sigma, rounding_error(float(steps.min()))) if steps.size else 0.0
    found = noise_of(sensor, sigma, sensor.quantum)
    return replace(found, sigma=max(found.sigma, 1e-9 * (most or 1.0)))


def _starts(model: Model, record: Record) -> list[Local]:
    """Unknown start states of the model in a record."""
    found = []
    for i, state in enumerate(model.states()):
        mean, sd = start_in(state, record)
        if sd == 0.0:
            continue
        weight = UNKNOWN_START**-2 if math.isinf(sd) else 1.0
        found.append(Local("start", i, mean, state.scale if math.isinf(sd) else sd, weight))
    return found


def split_records(
    records: Sequence[Record], hold_out: Sequence[str] | str | None
) -> tuple[tuple[Record, ...], tuple[Record, ...]]:
    """Split records into fitted and held-out records.

    Held out are the named records; without names, those with the role "held_out", else a third of
    three or more records, see :func:`_third`. Of one or two records, every second of five blocks is
    held out (two blocks if there are less than 100 samples): both parts keep all times, and the
    outputs of the other blocks are removed.

    ``hold_out``: names; () holds nothing out, and None is as above.
    """
    held = _held(records, hold_out)
    kept = [r for r in records if r not in held]
    if not kept:
        raise InvalidParameter("hold_out: every record is held out, none is left to fit")
    if held:
        return _with_values(kept), _with_values(held)
    if hold_out is not None and not hold_out:
        return _with_values(records), ()
    return _with_values([_blocks(r, 0) for r in kept]), _with_values([_blocks(r, 1) for r in kept])


def _held(records: Sequence[Record], hold_out: Sequence[str] | str | None) -> list[Record]:
    """Whole records that are held out."""
    if hold_out is None:
        stated = [r for r in records if r.role == "held_out"]
        return stated or _third(records)
    chosen = [hold_out] if isinstance(hold_out, str) else list(hold_out)
    names = [r.name for r in records]
    if unknown := [h for h in chosen if h not in names]:
        raise InvalidParameter(
            f"hold_out: no record {', '.join(unknown)}; there are {', '.join(names)}"
        )
    return [r for r in records if r.name in chosen]


def _third(records: Sequence[Record]) -> list[Record]:
    """A third of the records, chosen from inputs and measured ranges before anything is fitted.

    Records whose ranges lie inside those of the others come first, so that the fitted ones show
    what the held-out ones do; among them, and then, every third one.
    """
    every = [*records[2::3], *(r for k, r in enumerate(records) if k % 3 != 2)]
    inside = [r for r in every if _inside(r, [o for o in records if o is not r])]
    chosen = [*inside, *(r for r in every if r not in inside)][: len(records) // 3]
    return [r for r in records if r in chosen]


def _inside(record: Record, others: Sequence[Record]) -> bool:
    """Whether all inputs and outputs of a record stay inside the ranges of others."""
    for name, values in {**record.inputs, **record.outputs}.items():
        rest = [o.inputs.get(name, o.outputs.get(name)) for o in others]
        known = [np.asarray(v) for v in rest if v is not None and np.isfinite(v).any()]
        if not np.isfinite(values).any():
            continue
        if not known or np.nanmin(values) < min(map(np.nanmin, known)):
            return False
        if np.nanmax(values) > max(map(np.nanmax, known)):
            return False
    return True


def _blocks(record: Record, odd: int) -> Record:
    """The record with the outputs of every second block, from the first or the second on."""
    edges = np.linspace(0, record.samples, (5 if record.samples >= 100 else 2) + 1).astype(int)
    block = np.searchsorted(edges, np.arange(record.samples), side="right") - 1
    outputs = {k: np.where(block % 2 == odd, v, np.nan) for k, v in record.outputs.items()}
    role: Role = "held_out" if odd else "fit"
    name = f"{record.name}[{'held-out' if odd else 'fit'}]"
    return replace(record, name=name, outputs=outputs, role=role)


def _with_values(records: Sequence[Record]) -> tuple[Record, ...]:
    """The records, if they contain measured values."""
    if not any(np.isfinite(y).any() for r in records for y in r.outputs.values()):
        names = ", ".join(r.name for r in records) or "there are none"
        raise DataError(
            f"records {names}: no output has a measured value; hold out another record, or give a "
            "longer one"
        )
    return tuple(records)


# -------------------------------------------------------------------- checks of clocks and numbers


#: Step of a clock above which the clock jumps, in steps beside it [1].
JUMP = 20.0
#: Share of the values at the end of the range from which a sensor may be saturated [1].
SATURATED = 0.05
#: Samples in a row at the end of the range from which it is no rounding of a rest [1].
PLATEAU = 8
#: Digits of the numbers that loggers write for "no value", and their smallest distance from all
#: other values, in ranges of these.
CODE, FAR = re.compile(r"9{3,}|999[89]|32767|32768|65535|21474836\d\d"), 0.5
#: The same where no measurement can be meant, and the size of numbers that are codes, too.
CERTAIN, CERTAINLY_FAR, HUGE = re.compile(r"9{4,}"), 5.0, 1e15
#: Distance of a spike from the samples before and after, in scatters of the samples and as a share
#: of the range [1].
SPIKE = 15.0, 0.1


def check_records(records: Sequence[Record], model: Model | None = None) -> list[str]:
    """Check the clocks and the numbers of records; returns notes.

    Without a model, only the records are checked.

    Raises
    ------
    DataError
        The faults because of which the records cannot be used, all in one message.
    """
    names = [r.name for r in records]
    faults = [
        f"the name {n} is used twice (a file given twice, or two files of one name)"
        for n in sorted({n for n in names if names.count(n) > 1})
    ]
    if not records:
        faults.append("there are none, expected at least one")
    notes: list[str] = []
    for k, r in enumerate(records):
        notes += [f"{r.name}: {note}" for note in r.notes]
        faults += [
            f"{r.name} holds the same numbers as {o.name}; give one of them"
            for o in records[:k]
            if o.name != r.name and _same_numbers(o, r)
        ]
        faults += [] if model is None else _against(model, r)
        for fault, text in _of_record(r, r.outputs if model is None else model.outputs):
            (faults if fault else notes).append(text)
    if faults:
        raise DataError("records: " + "; ".join(merged(faults)))
    return notes if model is None else [*notes, *_not_compared(records, model.outputs)]


def _of_record(record: Record, compared: Collection[str]) -> Iterator[tuple[bool, str]]:
    """What is strange about the clock and the compared outputs of a record; True: a fault."""
    for fault, text in _clock(record.time):
        yield fault, f"{record.name}: {text}"
    for name in (n for n in record.outputs if n in compared):
        values = record.outputs[name]
        for fault, text in _numbers(values[np.isfinite(values)]):
            yield fault, f"{record.name}.{name}: {text}"
    # Whether an output of a model wraps, too, is known when it is simulated.
    beside = () if compared is record.outputs else compared
    units = record.units
    for name, values in {**record.outputs, **record.inputs}.items():
        if name not in beside and (text := wrap_text(name, values, units.get(name, "1"))):
            yield False, f"{record.name}.{name}: {text}"


def wrap_text(name: str, values: Array, unit: str) -> str:
    """Sentence about a channel that wraps, and what makes it continuous; "" if it does not."""
    if (found := wrap_of(values, unit)) is None:
        return ""
    period, words = found
    size = f"{period:g}" if unit != "rad" else f"{math.degrees(period):g}deg"
    return (
        f"jumps by about {period:.6g}, as {words} that wraps: --period {name}={size} makes "
        f"it continuous (period in the TOML file; in Python numpy.unwrap(values, period="
        f"{period:.15g}))"
    )


def _clock(time: Array) -> Iterator[tuple[bool, str]]:
    """What is strange about a clock, and whether it cannot be used."""
    steps = np.diff(time)
    middle = float(np.median(steps))
    # A logger that goes on at another rate has steps of one size beside each other.
    beside = np.maximum(np.r_[steps[1:], 0.0], np.r_[0.0, steps[:-1]]) if steps.size > 1 else steps
    if (jumps := steps > JUMP * beside).any():
        at = int(np.argmax(np.where(jumps, steps, 0.0)))
        yield (
            True,
            f"the clock jumps by {steps[at]:g} s at {time[at]:g} s (median step {middle:g} s); "
            "split the record there",
        )
    elif lost := int(np.sum(steps > 1.5 * middle)):
        yield False, f"uneven clock, {lost} steps are longer than 1.5 medians"


def _not_compared(records: Sequence[Record], outputs: Sequence[str]) -> Iterator[str]:
    """Notes about outputs that only the model or only a record has."""
    recorded = dict.fromkeys(n for r in records for n in r.outputs)
    absent = [n for n in outputs if n not in recorded]
    if 0 < len(absent) <= len(recorded):  # a model may offer far more than one measures
        yield f"{', '.join(absent)}: not compared, because no record has this output"
    for n in recorded:
        if n not in outputs:
            yield (
                f"{n}: not compared, because the model has no such output{near_names(n, outputs)}"
            )


def _against(model: Model, record: Record) -> Iterator[str]:
    """Faults of a record with which the model cannot simulate it."""
    states = [s.name for s in model.states()]
    known = record.start
    unknown = [] if known is None else [n for n in {**known.mean, **known.sd} if n not in states]
    if states and unknown:
        yield (
            f"{record.name}: start of {', '.join(unknown)}, no state of the model {model.name} "
            f"({', '.join(states)})"
        )
    if not set(model.outputs) & set(record.outputs):
        yield (
            f"{record.name}: none of its outputs ({', '.join(record.outputs)}) is one of the model "
            f"({', '.join(model.outputs)})"
        )
    for name, unit in record.units.items():
        wanted = model.units.get(name) or "1"
        if "1" not in (unit, wanted) and not same_unit(unit, wanted):
            yield (
                f"{record.name}: {name} is in {unit}, in the model {model.name} in {wanted}"
                f"{weight_hint(unit, wanted) or _how_to_convert(unit, wanted)}"
            )


def _how_to_convert(unit: str, wanted: str) -> str:
    """The end of a message about a unit of the same quantity; else ""."""
    try:
        zero_and_factor(unit, wanted)
    except InvalidParameter:
        return ""
    return "; unmodeled.read(files, model=model) converts it"


def _same_numbers(one: Record, other: Record) -> bool:
    """Whether a record is a copy, which would confirm what was fitted to the other one."""
    if one.samples < 8 or one.inputs.keys() != other.inputs.keys():
        return False
    if one.outputs.keys() != other.outputs.keys():
        return False
    pairs = [(y, other.outputs[n]) for n, y in one.outputs.items()]
    moves = any(np.unique(y[np.isfinite(y)]).size > 2 for y, _ in pairs)
    pairs += [(u, other.inputs[n]) for n, u in one.inputs.items()]
    return moves and all(np.array_equal(a, b, equal_nan=True) for a, b in pairs)


def _numbers(values: Array) -> Iterator[tuple[bool, str]]:
    """What is strange about the values of a channel, and whether they cannot be used."""
    if not values.size:
        yield False, "it has no values"
        return
    if np.ptp(values) == 0.0:
        if values.size > 1:
            yield False, "it never changes"
        return
    for extreme in (float(values.max()), float(values.min())):
        same = values == extreme
        rest = values[~same]
        if not rest.size:  # all others stand for missing values
            return
        away, width = float(np.min(np.abs(rest - extreme))), float(np.ptp(rest))
        digits = f"{abs(extreme):.9e}".partition("e")[0].replace(".", "").strip("0")
        code = abs(extreme) >= HUGE or CODE.fullmatch(digits)
        if code and values.size >= 12 and 2 * same.sum() <= values.size and away > FAR * width:
            values = rest
            sure = abs(extreme) >= HUGE or bool(CERTAIN.fullmatch(digits))
            yield (
                sure and np.unique(rest).size > 5 and away > CERTAINLY_FAR * width,
                f"{same.sum()} values of {extreme:.6g}, far outside of all others "
                f"({rest.min():.4g} to {rest.max():.4g}): if this stands for a missing value, "
                "leave the cells empty, or state missing = [NUMBER] with the number of the file "
                "(--missing NUMBER, in Python missing of ReadOptions)",
            )
        elif (
            same.sum() > SATURATED * values.size
            and not (same[0] or same[-1])
            and max(len(run) for run in "".join(map(str, same.astype(int))).split("0")) > PLATEAU
        ):
            yield False, f"{same.mean():.0%} of the values are at the end of the range: saturated?"
    if (count := int(_spikes(values).sum())) and count <= max(2, 0.01 * values.size):
        yield (
            False,
            f"{count} single values are far from the samples before and after; if they are faults "
            "of the sensor, leave these cells empty in the file (in Python NaN)",
        )


def _spikes(values: Array) -> NDArray[np.bool_]:
    """Which values are single samples far from the samples before and after, which agree."""
    if values.size < 12:
        return np.zeros(0, dtype=bool)
    before, after = values[1:-1] - values[:-2], values[1:-1] - values[2:]
    away = np.where(before * after > 0.0, np.minimum(np.abs(before), np.abs(after)), 0.0)
    bend = np.abs(before + after) / 2.0
    padded = np.pad(bend, 3)
    near = np.max([padded[3 + k : 3 + k + bend.size] for k in (-3, -2, 2, 3)], axis=0)
    scatter = np.maximum(near, float(np.median(bend)) or 1e-300)
    range_ = float(np.ptp(np.sort(values)[2:-2]))
    far = (away > SPIKE[0] * scatter) & (away > SPIKE[1] * range_)
    return np.asarray(far & (np.abs(before - after) <= 0.2 * away))
