"""Compares a model with records before any fit: size of the difference, factor, delay, hints."""

from __future__ import annotations

import itertools
import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Literal

import numpy as np

from unmodeled.arguments import checked
from unmodeled.chain.scales import one_signed
from unmodeled.data import Array, Record, join_records
from unmodeled.data.joining import align_clocks
from unmodeled.data.wrapping import wrap_of
from unmodeled.errors import DataError, Error, InvalidParameter
from unmodeled.fit.noise import rms_of_measured
from unmodeled.fit.observe import observe
from unmodeled.fit.simulator import Simulator
from unmodeled.lazy import lazy_import
from unmodeled.models.model import Candidate, Model, Ready, SensitivityRequest, start_in
from unmodeled.search.identifiable import told_apart
from unmodeled.search.problem import Observed
from unmodeled.search.records import noise_of_channel, ready_records, wrap_text
from unmodeled.search.result import Compared, Hint
from unmodeled.units import TEMPERATURE_SCALES, readable_unit, spelled_unit

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

#: Limit of simulations with other clocks, units and columns in a check [s].
TRIED = 3.0
#: Largest number of alignments of clocks; smallest standard deviation of their offset [s].
ALIGNMENTS, CLOCK_SD = 4, 2e-3


@dataclass(frozen=True, eq=False)
class Comparison:
    """Records and the tabulated model, simulated with the inputs of the records."""

    model: str
    rows: tuple[Compared, ...]
    hints: tuple[Hint, ...]
    records: tuple[Record, ...]
    """Records in the coordinates of the model."""
    simulated: Mapping[str, Mapping[str, Array]]
    """Outputs of the model by record and channel, at the times of the record."""
    notes: tuple[str, ...] = ()
    identifiability: tuple[str, ...] = ()
    """Numbers of the model that the motions do not show or cannot tell apart, and which motions
    would; (): they are not known."""

    @property
    def frame(self) -> pd.DataFrame:
        """One row for each channel of each record."""
        import pandas as pd

        rows = [asdict(r) | {"share": r.share, "in_noise": r.in_noise} for r in self.rows]
        return pd.DataFrame(rows)

    @checked
    def plot(self) -> Figure:
        """Record and model over time, and their difference; one row of panels per channel."""
        shown = [
            (r, next(x for x in self.records if x.name == r.record), self.simulated[r.record])
            for r in self.rows
            if r.samples
        ]
        draw: Callable[..., Figure] = lazy_import("unmodeled.report.figures:comparison")
        return draw(
            f"{self.model}: before anything is fitted",
            [(r.channel, r.unit, x, y[r.channel], r.noise) for r, x, y in shown],
        )


@checked
def check(
    model: Model,
    records: Sequence[Record] | Record,
    *,
    progress: Callable[[str], None] | None = None,
) -> Comparison:
    """Simulate the inputs of records with the tabulated parameters, and compare the outputs.

    No parameter is fitted, and no candidate gets a size. A start state that is not known is the one
    that fits the beginning of the record best. Where a record differs, other clocks, units and
    columns are simulated for at most 3 s; a note tells if some were left out. For as long, numbers
    of a MuJoCo model are sought that the motions cannot tell apart.

    Parameters
    ----------
    model
        Model of the machine.
    records
        Measured runs; at least one.
    progress
        Is called with what is simulated next.

    Raises
    ------
    DataError
        The records cannot be used with this model.
    InvalidParameter
        The model gives no finite outputs.

    Examples
    --------
    A line through records that are in mm, while the model is in m:

    >>> import numpy as np
    >>> import unmodeled
    >>> model = unmodeled.Simulator(
    ...     lambda time, inputs, p: {"x": p["c"] * inputs["F"]},
    ...     parameters={"c": (0.01, 1e-3, "m/N")}, inputs={"F": "N"}, outputs={"x": "m"},
    ... )
    >>> time = np.linspace(0.0, 1.0, 100)
    >>> force = np.sin(9.0 * time)
    >>> record = unmodeled.Record(
    ...     name="r", time=time, inputs={"F": force}, outputs={"x": 10.0 * force}
    ... )
    >>> [hint.text for hint in unmodeled.check(model, record).hints]
    ['x is 1000 times the model in all records: is its unit another one?']
    """
    tell = progress or (lambda _: None)
    tell("prepares the model and the records")
    ready = ready_records(model.tabulated(), records)
    found = _finite(model, compared(ready, TRIED, tell))
    tell("looks which numbers the motions tell apart")
    return replace(found, identifiability=told_apart(ready.model, ready.records, TRIED))


def _finite(model: Model, found: Comparison) -> Comparison:
    """A comparison of values with a model that gives numbers."""
    if not any(np.isfinite(r.outputs[c.channel]).any() for r in found.records for c in found.rows
               if c.record == r.name):  # fmt: skip
        names = ", ".join(dict.fromkeys(c.channel for c in found.rows))
        raise DataError(
            f"{names}: the records hold no number, expected at least two in one of them"
        )
    values = [y[1:] for run in found.simulated.values() for y in run.values()]
    if not found.hints and not any(np.isfinite(y).any() for y in values):
        raise InvalidParameter(
            f"model {model.name}: it gives no finite outputs with the tabulated parameters; are "
            "its rates per second?"
        )
    return found


@checked
def join_by_motion(
    first: Record,
    second: Record,
    model: Model | None = None,
    *,
    inputs: Mapping[str, str] | None = None,
) -> Record:
    """Join two records with two clocks: by the begin of the motion, and then by that of a model.

    Parameters
    ----------
    first, second, inputs
        As in :func:`unmodeled.data.join_records`.
    model
        Model whose motion under the force is correlated with ``first``.
    """
    clocks, sd = align_clocks(first, second)
    offset, told, ready = clocks.offset, "", None
    late: dict[str, float] = {}
    for _ in range(ALIGNMENTS):
        if model is None:
            break
        made = join_records(first, second, same=[(0.0, offset)], inputs=inputs)
        ready = ready_records(model, [made])
        rows = _finite(model, compared(ready)).rows
        delays = {r.channel: r.delay for r in rows if np.isfinite(r.delay)}
        if not delays:
            break
        late = delays
        middle = sum(delays.values()) / len(delays)
        offset -= middle
        spread = max(delays.values()) - min(delays.values())
        sd = max(spread, CLOCK_SD, first.interval, second.interval)
        if abs(middle) < 0.1 * sd:
            break
    if ready is not None and late:
        own, told = _own_delay(ready, list(late))
        sd = max(sd, own)
    joined = join_records(first, second, same=[(0.0, offset)], inputs=inputs, same_sd=sd)
    return replace(joined, notes=(*joined.notes, told)) if told else joined


def _own_delay(ready: Ready, channels: Sequence[str]) -> tuple[float, str]:
    """Delay that the tolerances of a model make, to first order: one sd [s], and a note.

    A machine within its tolerances is late or early by itself, and this is taken for a part of the
    offset of the clocks.
    """
    model, record = ready.model, ready.records[0]
    free = [i for i, p in enumerate(model.parameters) if 0.0 < p.sd < math.inf]
    starts = np.array([start_in(s, record)[0] for s in model.states()])
    theta = np.array([p.value for p in model.parameters])
    ask = SensitivityRequest(record, theta, starts, by_theta=free, by_starts=False, rough=True)
    with np.errstate(all="ignore"):
        (found,) = model.sensitivities([ask])
    parts = []
    for name in channels:
        c = model.outputs.index(name)
        good = np.isfinite(record.outputs[name]) & np.isfinite(found.outputs[:, c])
        slope = np.gradient(found.outputs[:, c], record.time)[good]
        parts.append(-(slope @ found.d_theta[good, c]) / max(float(slope @ slope), 1e-300))
    late = np.nan_to_num(np.mean(parts, axis=0)) * [model.parameters[i].sd for i in free]
    sd = float(np.sqrt(late @ late))
    if not sd > 0.0:
        return 0.0, ""
    most = model.parameters[free[int(np.argmax(np.abs(late)))]].name
    return sd, (
        f"a machine within the tolerances of the model is late or early by {1e3 * sd:.2g} ms (most "
        f"by {most}), which cannot be told from the clocks; a fault beyond them adds to it"
    )


def compared(
    ready: Ready, seconds: float = math.inf, tell: Callable[[str], None] = lambda _: None
) -> Comparison:
    """Compare a prepared model with its records; see :func:`check`.

    ``seconds``: limit of simulations with other clocks, units and columns.
    """
    model, runs, trials = ready.model, [], _Trials(ready.model, seconds)
    for k, r in enumerate(ready.records, 1):
        tell(f"simulates {r.name}, record {k} of {len(ready.records)}")
        runs.append((r, trials.timed(r)))
    tell("compares other clocks, units and columns")
    rows = tuple(
        row_of(r, name, y[name]) for r, y in runs for name in r.outputs if name in model.outputs
    )
    told = hints(model, runs, rows, trials)
    left_out = [
        f"left out, because it would take more than {seconds:g} s: whether the model follows the "
        "records with another clock, unit or order of columns"
    ] * trials.left_out
    notes = (*ready.notes, *_not_finite(runs), *left_out)
    return Comparison(model.name, rows, told, ready.records, {r.name: y for r, y in runs}, notes)


class _Trials:
    """Simulations of changed records, none of which begins that would end after a limit of time."""

    def __init__(self, model: Model, seconds: float):
        self._model, self._rest, self._longest = model, seconds, 0.0
        self.left_out = False

    def timed(self, record: Record, theta: Array | None = None) -> dict[str, Array]:
        """Outputs of the model for a record."""
        begin = time.monotonic()
        outputs = simulated(self._model, record, theta)
        self._longest = max(self._longest, time.monotonic() - begin)
        return outputs

    def __call__(self, record: Record, theta: Array | None = None) -> dict[str, Array] | None:
        """The same; None: it is left out."""
        self.left_out |= self._longest > self._rest
        if self.left_out:
            return None
        begin = time.monotonic()
        outputs = self.timed(record, theta)
        self._rest -= time.monotonic() - begin
        return outputs


def refuse(found: Comparison) -> None:
    """Refuse records with a certain error.

    Raises
    ------
    DataError
        A unit, sign, clock, or the order of columns is certainly wrong.
    """
    sure = [h for h in found.hints if h.sure]
    texts = "; ".join(h.text for h in sure)
    if sure and all(h.kind in ("wrap", "parameter") for h in sure):
        raise DataError(f"records: {texts}")
    if sure:
        raise DataError(
            f"records: {texts}. State it (--unit CHANNEL=UNIT, --column CHANNEL=COLUMN; "
            "in the TOML file unit, column, gain), or give parameters of the model their true "
            "tolerances"
        )


def _not_finite(runs: Runs) -> Iterator[str]:
    for record, outputs in runs:
        for name in [n for n in record.outputs if n in outputs]:
            if (v := ~np.isfinite(outputs[name])).any():
                yield (
                    f"{record.name}: the model gives no numbers for {name} at {v.sum()} of "
                    f"{v.size} samples, from {record.time[np.argmax(v)]:.4g} s on"
                )


# ----------------------------------------------------------------------- a model beside one record


#: Longest delay that is tried, as a share of the record [1].
LONGEST_DELAY = 0.25
NO_DELAY = math.nan, math.nan

#: Share of the record to which an unknown start is fitted; standard deviation, in scales of the
#: state, from which it is unknown [1].
BEGINNING, UNKNOWN_START = 0.2, 0.3


def simulated(
    model: Model,
    record: Record,
    theta: Array | None = None,
    included: tuple[Candidate, ...] = (),
    magnitudes: Array | None = None,
) -> dict[str, Array]:
    """Outputs of the model at the times of a record, by name.

    A start state that is not known is the one that fits the beginning of the record best.

    Without ``theta``, the parameters have their tabulated values.
    """
    theta = np.array([p.value for p in model.parameters]) if theta is None else theta
    states = model.states(included)
    known = [start_in(s, record) for s in states]
    start = np.array([mean for mean, _ in known])
    free = [i for i, s in enumerate(states) if known[i][1] > UNKNOWN_START * s.scale]

    def run(part: Record, x: Array) -> Array:
        with np.errstate(all="ignore"):
            return np.asarray(observe(model, part, theta, x, included, magnitudes))[: part.samples]

    measured, values = record.output_array(model.outputs), run(record, start)
    if free:
        scale = {i: states[i].scale for i in free}
        other = run(record, _fitted_start(run, record, measured, start, scale))
        # A start that hides a wrong unit does not follow the rest of the record.
        if np.isfinite(other).all() and _unlike(measured, other) <= 2.0 * _unlike(measured, values):
            values = other
    return {name: values[:, i] for i, name in enumerate(model.outputs)}


def _fitted_start(
    run: Callable[[Record, Array], Array],
    record: Record,
    measured: Array,
    start: Array,
    free: Mapping[int, float],
) -> Array:
    """Start states that fit the beginning of a record best, or the given ones.

    ``free``: scale of each state that is not known, by its index.
    """
    from scipy.optimize import least_squares

    part = Observed(record, measured, np.isfinite(measured), measured).first(BEGINNING)
    valid, scale = part.valid, np.array([*free.values()])
    if not valid.any():
        return start
    size = np.array([np.std(y[np.isfinite(y)]) or 1.0 if np.isfinite(y).any() else 1.0
                     for y in measured.T])  # fmt: skip

    def at(x: Array) -> Array:
        new = start.copy()
        new[[*free]] += scale * x
        return new

    def residual(x: Array) -> Array:
        gap = ((run(part.record, at(x)) - part.measured) / size)[valid]
        return np.asarray(np.nan_to_num(gap, nan=1e6).clip(-1e6, 1e6))

    with np.errstate(all="ignore"):
        found = least_squares(residual, np.zeros(len(free)), diff_step=1e-5, max_nfev=20)
        return at(found.x) if np.abs(residual(found.x)).max() < 1e6 else start


def _pair(x: Array, y: Array) -> tuple[Array, Array]:
    """Values about their means where both are numbers."""
    both = np.isfinite(x) & np.isfinite(y)
    x, y = x[both], y[both]
    return (x - x.mean(), y - y.mean()) if x.size > 2 else (np.zeros(0), np.zeros(0))


def _unlike(measured: Array, outputs: Array) -> float:
    """Mean over the channels of the share that no factor of the model explains [1]."""
    shares = []
    for a, b in zip(measured.T, outputs.T, strict=True):
        x, y = _pair(a, b)
        with np.errstate(all="ignore"):
            product = float(x @ x) * float(y @ y)
            shares.append(1.0 - float(x @ y) ** 2 / product if 0.0 < product < 1e300 else 1.0)
    return float(np.mean(shares))


def row_of(record: Record, name: str, model: Array) -> Compared:
    """Numbers of one channel of a record beside the outputs of the model.

    ``model``: its values in the model at the times of the record.
    """
    measured, sensor = record.outputs[name], record.sensors[name]
    noise = noise_of_channel(record, name).sd_of_measured(record.time, measured)
    sigma = float(rms_of_measured(noise, measured))
    with np.errstate(over="ignore", invalid="ignore"):
        gap = measured - model
        both = np.isfinite(gap)
        rms = float(np.sqrt(np.mean(gap[both] ** 2))) if both.any() else math.nan
        x, y = _pair(measured, model)
        xy, xx, yy = float(x @ y), float(x @ x), float(y @ y)
    moves = xx > 0.0 and math.isfinite(yy) and yy > 0.0
    factor = xy / yy if moves else math.nan
    return Compared(
        record.name,
        name,
        sensor.unit,
        int(both.sum()),
        float(np.sqrt(xx / x.size)) if x.size else 0.0,
        sigma,
        sensor.sigma is not None,
        rms,
        factor,
        float(np.mean(measured[both]) - factor * np.mean(model[both])) if moves else math.nan,
        xy / math.sqrt(xx * yy) if moves else math.nan,
        *(_delay(record.time, measured, model) if moves and rms > sigma else NO_DELAY),
    )


def _delay(time: Array, measured: Array, model: Array) -> tuple[float, float]:
    """Delay with which the model explains most [s], and the share of the difference that remains.

    NaN if the delay explains less than half of the squared difference.
    """
    both = np.isfinite(measured) & np.isfinite(model)
    count = int(min(time.size, 4096))
    if both.sum() < 8:
        return NO_DELAY
    clock = np.linspace(time[0], time[-1], count)
    x = np.interp(clock, time[both], measured[both])
    y = np.interp(clock, time[both], model[both])
    most = int(LONGEST_DELAY * count)
    padded = np.concatenate([np.full(most, y[0]), y, np.full(most, y[-1])])
    # Sums of squares of all delays at once: x^2 - 2 x y + y^2.
    # (scipy.signal takes a second to start.)
    spectrum = np.fft.rfft(padded) * np.conj(np.fft.rfft(x, padded.size))
    product = np.fft.irfft(spectrum, padded.size)[: 2 * most + 1]
    squares = np.concatenate([[0.0], np.cumsum(padded**2)])
    cost = float(x @ x) - 2.0 * product + squares[count:] - squares[:-count]
    best = int(np.argmin(cost))
    if best in (0, 2 * most) or not cost[best] < (1.0 - TAKES_AWAY) * cost[most]:
        return NO_DELAY
    a, b, c = cost[best - 1 : best + 2]
    bend = a - 2.0 * b + c
    between = 0.5 * (a - c) / bend if bend > 0.0 else 0.0
    left = (b - 0.125 * (a - c) ** 2 / bend if bend > 0.0 else b) / cost[most]
    return float((most - best - between) * (clock[1] - clock[0])), max(0.0, float(left))


# ------------------------------------------------------------------------------------------- hints


#: Records, each with the outputs of the tabulated model.
Runs = Sequence[tuple[Record, Mapping[str, Array]]]

#: Correlation of record and model from which a factor is told, and is certain [1].
CORRELATED, CERTAIN = 0.9, 0.99
#: Largest distance of a factor from that of a unit, as a share of their logarithms [1].
NEAR_FACTOR = 0.15
#: Share of the squared difference that an explanation must take away; shares that another clock,
#: input, or scale may leave to be told, and to be certain: less needs no explanation [1].
TAKES_AWAY, LEAVES, LEAVES_CERTAIN = 0.5, 0.1, 0.04
#: Largest spread of the delays of all channels that are one delay [1].
DELAY_SPREAD = 0.3
#: Distance of the first sample from the model, in noise and as a share of the motion, from which
#: the start is another one, and least number of samples for it.
AT_START, LEAST_START = (10.0, 0.1), 5
#: Prior standard deviation, as a share of the value, from which a parameter may have any size [1].
ANY_SIZE = 0.5
#: Factors of record over model of a wrong unit or direction, by the unit of the channel; "": any.
_FACTORS: Mapping[str, tuple[float, ...]] = {
    "": (1e3, 1e-3, -1.0),
    "m": (10.0, 0.1, 100.0, 0.01, 25.4, 1.0 / 25.4),
    "N": (9.80665, 1.0 / 9.80665),
    "rad": (180.0 / math.pi, math.pi / 180.0),
}
#: Factors of a clock in a wrong unit.
_CLOCKS = (60.0, 1.0 / 60.0, 1e-3, 1e3, 3600.0, 1.0 / 3600.0)


def hints(model: Model, runs: Runs, rows: Sequence[Compared], trials: _Trials) -> tuple[Hint, ...]:
    """Hints about the differences; a certain one rests on parameters with small tolerances."""
    if certain := [*_wraps(runs), *_as_stated(model, runs, trials), *_elsewhere(model, runs)]:
        return tuple(certain)
    size = _size_of_tolerances(model)
    found: list[Hint] = []
    if math.isfinite(size):
        found += _follows(runs, _clocks(model), trials)
        if not found:
            units = [*_units(rows)]
            known = {n for h in units for n in h.channels}  # as good an explanation as an exchange
            found += [h for h in _exchanged(runs, rows) if not known >= {*h.channels}]
            taken = {n for h in found for n in h.channels}
            found += [h for h in units if not taken & {*h.channels}]
        if not found:
            found += _follows(runs, [*_inputs(model, runs), *_scales(rows)], trials)
    if size > ANY_SIZE:
        found = [replace(h, sure=False) for h in found]
    return tuple(found or [*_without_sign(runs)] or _delays(rows))


def _without_sign(runs: Runs) -> Iterator[Hint]:
    """Channels that never change their sign, where the model does and its absolute value fits."""
    for name in dict.fromkeys(n for r, y in runs for n in r.outputs if n in y):
        seen = [(r.outputs[name], y[name]) for r, y in runs if name in r.outputs]
        own, model = (np.concatenate(part) for part in zip(*seen, strict=True))
        known = np.isfinite(own) & np.isfinite(model)
        own, model = own[known], model[known]
        if not known.any() or one_signed(own) != 1 or one_signed(model):
            continue
        left, without = (float(np.sum((own - y) ** 2)) for y in (np.abs(model), model))
        if left < LEAVES * without:
            yield Hint(
                "absolute",
                (name,),
                f"{name} never changes its sign, and its model does: is it an absolute value? "
                "The model follows all records with that of its output",
            )


def _wraps(runs: Runs) -> Iterator[Hint]:
    """Channels that wrap, where the model does not: no error of a sensor has their jumps."""
    found: dict[tuple[str, str], list[str]] = {}
    for record, outputs in runs:
        for name in [n for n in record.outputs if n in outputs]:
            unit = record.sensors[name].unit
            text = wrap_text(name, record.outputs[name], unit)
            if text and wrap_of(outputs[name], unit) is None:
                found.setdefault((name, text), []).append(record.name)
    for (name, text), where in found.items():
        yield Hint("wrap", (name,), f"{name} of {', '.join(where)} {text}", sure=True)


def _elsewhere(model: Model, runs: Runs) -> Iterator[Hint]:
    """Channels of a simulator that start elsewhere than the record, and approach it later."""
    if model.states() or not isinstance(model, Simulator):
        return
    far: list[tuple[str, str]] = []
    for record, outputs in runs:
        for name in [n for n in record.outputs if n in outputs]:
            gap = record.outputs[name] - outputs[name]
            there = np.flatnonzero(np.isfinite(gap))
            if there.size < LEAST_START:
                continue
            first, motion = abs(gap[there[0]]), float(np.std(record.outputs[name][there]))
            noise = noise_of_channel(record, name).sigma
            later = abs(float(np.median(gap[there])))
            if first > max(AT_START[0] * noise, AT_START[1] * motion) and later < 0.5 * first:
                seen, own = (y[name][there[0]] for y in (record.outputs, outputs))
                text = f"{name} of {record.name} at {seen:.4g}, in the model at {own:.4g}"
                far.append((name, f"{text} {record.sensors[name].unit}"))
    if far:
        more = f" (and {len(far) - 2} more)" if len(far) > 2 else ""
        yield Hint(
            "start", tuple(dict.fromkeys(n for n, _ in far)),
            f"the model does not start where the records start: {', '.join(t for _, t in far[:2])}"
            f"{more}; state its start by its parameters, or of a MuJoCo model by --key and --settle"
            " (without them, measured joints start at their first samples)",
        )  # fmt: skip


def _as_stated(model: Model, runs: Runs, trials: _Trials) -> Iterator[Hint]:
    """Whether the records contradict the conversion of parameters to SI.

    With the numbers as they are stated, the model follows the records, and with SI it does not.
    """
    if not model.converted:
        return
    theta = np.array([p.value / model.converted.get(p.name, (1.0, ""))[0]
                      for p in model.parameters])  # fmt: skip
    try:
        other = [(r, y) for r, _ in runs if (y := trials(r, theta)) is not None]
    except Error:  # it needs other values
        return
    if len(other) < len(runs):
        return

    def missed(run: tuple[Record, Mapping[str, Array]]) -> float:
        record, outputs = run
        shares = [
            float(np.sqrt(np.mean((y[good] - outputs[n][good]) ** 2)) / (np.std(y[good]) or 1.0))
            for n, y in record.outputs.items()
            if n in outputs and (good := np.isfinite(y)).any()
        ]
        return float(np.nan_to_num(max(shares, default=0.0), nan=math.inf))

    with np.errstate(all="ignore"):
        far, near = (max(map(missed, part)) for part in (runs, other))
    if near < 0.5 * min(far, 1.0):
        names = [p for p in model.parameters if p.name in model.converted]
        given = ", ".join(
            f"{p.name} = {p.value / model.converted[p.name][0]:.6g} ({model.converted[p.name][1]}, "
            f"not {p.value:.6g} {p.unit})"
            for p in names
        )
        first = names[0].name
        yield Hint(
            "parameter",
            tuple(p.name for p in names),
            f"the model follows the records with {given}: it takes the numbers as they are stated; "
            f"the attribute units of this function, such as {{{first!r}: "
            f"{model.converted[first][1]!r}}}, tells it, or state SI units",
            sure=True,
        )


def _size_of_tolerances(model: Model) -> float:
    """Largest tolerance of a parameter of the machine, as a share of its value [1]."""
    own = [p for p in model.parameters if p.of_the_machine]
    return max(
        (p.sd / abs(p.value or 1.0) for p in own if p.value or math.isinf(p.sd)), default=0.0
    )


def _relations(unit: str) -> Iterator[tuple[float, float]]:
    """Zero and factor of a record over the model that a wrong unit makes."""
    yield from ((0.0, factor) for factor in (*_FACTORS[""], *_FACTORS.get(unit, ())))
    if spelled_unit(unit) in {scale for scale, _ in TEMPERATURE_SCALES}:
        yield from ((zero, 1.0 / factor) for zero, factor in TEMPERATURE_SCALES.values())


def _known_relation(row: Compared) -> tuple[float, float] | None:
    """Zero and factor of the wrong unit, scale or sign that is near to those of a row."""
    near = []
    for zero, factor in _relations(row.unit):
        ratio = row.factor / factor
        far = min(row.motion, 0.5 * abs(zero) or math.inf)  # nearer to this zero than to none
        if ratio > 0.0 and abs(row.correlation) > CORRELATED and abs(row.offset - zero) <= far:
            off = abs(math.log(ratio)) / max(abs(math.log(abs(factor))), math.log(10.0))
            near += [(off, zero, factor)] if off < NEAR_FACTOR else []
    return min(near)[1:] if near else None


def _units(rows: Sequence[Compared]) -> Iterator[Hint]:
    """Channels that have a wrong unit, scale or sign in all records, or in some of them."""
    groups: dict[tuple[tuple[float, float], tuple[str, ...]], list[list[Compared]]] = {}
    for name in dict.fromkeys(r.channel for r in rows):
        known = {r: _known_relation(r)
                 for r in rows if r.channel == name and math.isfinite(r.correlation)}  # fmt: skip
        wrong = [r for r, relation in known.items() if relation]
        right = [r for r, relation in known.items() if not relation]
        relations = {relation for relation in known.values() if relation}
        if len(relations) == 1 and all(abs(r.factor - 1.0) < TAKES_AWAY for r in right):
            where = tuple(r.record for r in wrong) if right else ()
            groups.setdefault((relations.pop(), where), []).append(wrong)
    for ((zero, factor), where), channels in groups.items():
        wrong = [r for g in channels for r in g]
        yield _unit_hint(zero, factor, where, wrong)


def _unit_hint(zero: float, factor: float, where: Sequence[str], wrong: Sequence[Compared]) -> Hint:
    names = tuple(dict.fromkeys(r.channel for r in wrong))
    size = f"{float(np.median([r.factor for r in wrong])):.4g} times the model"
    size = f"on another scale of temperature (zero at {zero:.5g})" if zero else size
    turned = factor < 0.0
    question = "has it the other direction?" if turned else "is its unit another one?"
    place = f"record {', '.join(where)}" if where else "all records"
    sure = all(abs(r.correlation) > CERTAIN for r in wrong)
    kind: Literal["scale", "sign", "unit"] = "scale" if zero else "sign" if turned else "unit"
    return Hint(kind, names, f"{', '.join(names)} is {size} in {place}: {question}", sure)


def _left(record: Record, outputs: Mapping[str, Array]) -> float:
    """Mean over the channels of the variance of the difference over that of the record."""
    shares = []
    for name, measured in record.outputs.items():
        if name in outputs:
            variance = float(np.nanvar(measured)) if np.isfinite(measured).any() else 0.0
            if variance > 0.0:
                with np.errstate(all="ignore"):
                    off = float(np.var((measured - outputs[name])[np.isfinite(measured)]))
                shares.append(off / variance if math.isfinite(off) else math.inf)
    return float(np.mean(shares)) if shares else 0.0


def _follows(
    runs: Runs, others: Iterable[tuple[Hint, Callable[[Record], Record]]], trials: _Trials
) -> list[Hint]:
    """The change of the records with which the model follows all of them far better, if any."""
    runs = [(r, y) for r, y in runs if r.start is None or r.start.known]
    now = [_left(*run) for run in runs]
    if not runs or min(now) < LEAVES:
        return []
    most = [min(LEAVES * v, TAKES_AWAY) for v in now]
    best: list[Hint] = []
    for hint, changed in others:
        left: list[float] = []
        for (record, _), limit in zip(runs, most, strict=True):
            outputs = trials(changed(record))
            if outputs is None:
                return best
            left.append(_left(record, outputs))
            if not left[-1] < limit:
                break
        else:
            sure = all(a < LEAVES_CERTAIN * b for a, b in zip(left, now, strict=True))
            best, most = [replace(hint, sure=sure)], left
    return best


def _is_quick(model: Model) -> bool:
    """Whether a much longer record takes little time: not in a simulator, nor in a mechanism."""
    return bool(model.states()) and not isinstance(model, Simulator)


def _clocks(model: Model) -> Iterator[tuple[Hint, Callable[[Record], Record]]]:
    for factor in _CLOCKS:
        if factor < 1.0 or _is_quick(model):
            yield (
                Hint("clock", ("time",), f"the model follows all records with a clock {factor:.4g} "
                     "times as long: is the unit of time another one, or are its rates not per "
                     "second?"),
                partial(Record.stretched, factor=factor),
            )  # fmt: skip


def _inputs(model: Model, runs: Runs) -> Iterator[tuple[Hint, Callable[[Record], Record]]]:
    """An input in another unit or direction, or two of one unit in exchanged columns.

    Outputs with a constant do not have the factor of an input.
    """

    def scaled(record: Record, name: str, factor: float) -> Record:
        return record.with_changed_inputs(lambda whole: {name: factor * whole.inputs[name]})

    def exchanged(record: Record, a: str, b: str) -> Record:
        return record.with_changed_inputs(lambda whole: {a: whole.inputs[b], b: whole.inputs[a]})

    shared = set.intersection(*(set(r.inputs) for r, _ in runs)) if _is_quick(model) else ()
    units = {n: u for r, _ in runs for n, u in r.input_units.items()} | dict(model.units)
    factors = {n: _factors_of_input(units.get(n, "")) for n in sorted(shared)}
    for name, factor in ((n, f) for n, group in factors.items() for f in group):
        why = (
            "is its unit another one than its label"
            if factor > 0.0
            else "has it the other direction"
        )
        yield (
            Hint("input", (name,), f"the model follows all records with {factor:g} times the "
                 f"values of {name}: {why}?"),
            partial(scaled, name=name, factor=factor),
        )  # fmt: skip
    for a, b in itertools.combinations(factors, 2):
        if units.get(a) == units.get(b):
            yield (
                Hint("exchange", (a, b), f"the model follows all records with {a} and {b} "
                     "exchanged: are their columns?"),
                partial(exchanged, a=a, b=b),
            )  # fmt: skip


def _factors_of_input(unit: str) -> tuple[float, ...]:
    """Factors by which an input may be wrong: thousand, direction, time of a rate, percent."""
    rate = (60.0, 1.0 / 60.0, 3600.0, 1.0 / 3600.0) * unit.endswith("/s")
    return 1e3, 1e-3, -1.0, *rate, *((100.0, 0.01) * (unit in ("", "1")))


def _scales(rows: Sequence[Compared]) -> Iterator[tuple[Hint, Callable[[Record], Record]]]:
    """Another scale of temperature, where a start that is not known hides its zero."""

    def read(record: Record, names: Sequence[str], zero: float, factor: float) -> Record:
        other = {n: (v - zero) / factor for n, v in record.outputs.items() if n in names}
        return replace(record, outputs={**record.outputs, **other})

    for unit in dict.fromkeys(r.unit for r in rows):
        names = tuple(dict.fromkeys(r.channel for r in rows if r.unit == unit))
        for zero, factor in _relations(unit):
            if zero:
                yield (
                    Hint("scale", names, f"the model follows all records with {', '.join(names)} "
                         f"on another scale of temperature (zero at {zero:.5g}): is its unit "
                         "another one?"),
                    partial(read, names=names, zero=zero, factor=factor),
                )  # fmt: skip


def _exchanged(runs: Runs, rows: Sequence[Compared]) -> list[Hint]:
    """Channels that the model explains far better in another order, in all records."""
    found: Counter[tuple[tuple[str, str], ...]] = Counter()
    having: list[set[str]] = []
    for record, outputs in runs:
        own = [r for r in rows if r.record == record.name and r.samples > 2 and r.motion > 0.0]
        having.append({r.channel for r in own})
        for unit in dict.fromkeys(r.unit for r in own):
            found.update(_better_orders(record, outputs, [r for r in own if r.unit == unit]))
    hints = []
    for key, count in found.items():
        names = tuple(a for a, _ in key)
        of = sum(set(names) <= h for h in having)
        text = ", ".join(f"{a} looks like {b}" for a, b in key)
        hints.append(Hint("exchange", names, f"{text}: are the columns exchanged?", count == of))
    return hints


def _better_orders(
    record: Record, outputs: Mapping[str, Array], rows: Sequence[Compared]
) -> Iterator[tuple[tuple[str, str], ...]]:
    """Channels in one unit that other outputs of the model explain far better, and these."""
    cost = _left_by_pair(record, outputs, rows)
    if np.all(np.diag(cost) <= cost.min(axis=1, initial=np.inf)):  # no order leaves less
        return
    from scipy.optimize import linear_sum_assignment  # takes 0.2 s to start

    order = linear_sum_assignment(cost)[1].tolist()
    for cycle in _cycles(order):
        cycle = sorted(cycle, key=lambda k: rows[k].channel)
        now, left = cost[cycle, cycle], cost[cycle, [order[k] for k in cycle]]
        noise = np.array([(rows[k].noise / rows[k].motion) ** 2 for k in cycle])
        far = now.sum() > TAKES_AWAY * len(cycle) or (
            now.sum() > LEAVES * len(cycle) and left.sum() < LEAVES_CERTAIN * now.sum()
        )
        if far and np.all(now > noise) and np.all(left < TAKES_AWAY * np.minimum(now, 1.0)):
            yield tuple((rows[k].channel, rows[order[k]].channel) for k in cycle)


def _left_by_pair(record: Record, outputs: Mapping[str, Array], rows: Sequence[Compared]) -> Array:
    """Share of the motion of each channel that each output of the model leaves."""
    cost = np.full((len(rows), len(rows)), 1e9)
    for i, j in np.ndindex(cost.shape):
        gap = record.outputs[rows[i].channel] - outputs[rows[j].channel]
        if np.isfinite(gap).any():
            with np.errstate(all="ignore"):
                cost[i, j] = min(np.nanmean(gap**2) / rows[i].motion ** 2, 1e9)
    return cost


def _cycles(order: Sequence[int]) -> Iterator[list[int]]:
    """Cycles of a permutation that move something."""
    left = set(range(len(order)))
    while left:
        cycle = [min(left)]
        while (after := order[cycle[-1]]) != cycle[0]:
            cycle.append(after)
        left -= set(cycle)
        if len(cycle) > 1:
            yield cycle


def _delays(rows: Sequence[Compared]) -> list[Hint]:
    """About the same delay of every channel in every record, or of some, and nothing else.

    A lighter or an easier part is early, too. Then the difference is no pure delay, and a hint to
    shift the records would spoil them.
    """
    late = [r for r in rows if math.isfinite(r.delay)]
    if len(rows) < 2 or not late:
        return []
    delays = [r.delay for r in late]
    mean = float(np.mean(delays))
    one = float(np.ptp(delays)) <= DELAY_SPREAD * abs(mean)
    # The others follow the model.
    least = min(1.0, DELAY_SPREAD * min(r.rms / r.motion for r in late))
    on_time = [r for r in rows if r not in late and r.rms <= least * r.motion]
    follow = len(on_time) + len(late) == len(rows)
    if not (one and follow) or max(r.delayed for r in late) > LEAVES_CERTAIN:
        return []
    factor, unit = readable_unit(mean, "s")
    text = f"{abs(factor * mean):.3g} {unit} {'late' if mean > 0.0 else 'early'}"
    names = tuple(dict.fromkeys(r.channel for r in late))
    if not on_time:
        text = f"every channel is {text}: is the input on the same clock?"
        return [Hint("delay", names, text)]
    return [
        Hint("delay", names, f"{', '.join(names)} is {text} {_where_late(late, on_time, mean)}")
    ]


def _where_late(late: Sequence[Compared], on_time: Sequence[Compared], mean: float) -> str:
    where = dict.fromkeys(r.record for r in late)
    if {r.record for r in on_time} <= {*where}:
        others = ", ".join(dict.fromkeys(r.channel for r in on_time))
        cause = "does its sensor lag, or its clock?" if mean > 0.0 else "is its clock ahead?"
        return f"in every record, and {others} is not: {cause}"
    return (
        f"in record {', '.join(where)}, and not in the others: was this sensor or its clock "
        "different there?"
    )
