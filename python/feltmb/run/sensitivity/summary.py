"""Derivatives of the values of a summary: event times, values at events, and extrema."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from feltmb import _core
from feltmb.mechanism import Action
from feltmb.run.arrays import summary_unit
from feltmb.run.events import list_changes, name_events
from feltmb.run.strikes import find_strikes

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from feltmb.mechanism.schema import SummaryRow

    Array = npt.NDArray[np.float64]

#: Index and unit of each output, by name.
Outputs = Mapping[str, tuple[int, str]]
_SIGNS = {"largest": (1,), "smallest": (-1,), "range": (1, -1)}
_KEY = "key_travel"
_FLAT = "it depends on the time of an event, or of an extremum, that is too flat for a derivative"


@dataclass
class Summary:
    """Values of a summary in SI units with their derivatives, and the events with theirs."""

    values: dict[str, float] = field(default_factory=dict)
    derivatives: dict[str, Array] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    unknown: dict[str, str] = field(default_factory=dict)
    events: list[dict[str, Any]] = field(default_factory=list)

    def put(
        self, name: str, value: float, derivative: Array, *, unit: str | None = None, why: str = ""
    ) -> None:
        """Add a value; ``why``: why the derivative is NaN, if not by an event or extremum."""
        self.values[name] = float(value)
        self.derivatives[name] = derivative
        self.units[name] = summary_unit(name) if unit is None else unit
        if why or (derivative.size and derivative[0] != derivative[0]):
            self.unknown[name] = why or _FLAT


def add_rules(action: Action, options: Any) -> list[str]:
    """Add the travels of tracking points that are events."""
    import numpy as np

    names = []
    for name, rule in action.config.events.items():
        if rule.point is None or rule.travel is None:
            continue
        direction = np.asarray(rule.direction) / np.linalg.norm(rule.direction)
        index = action.mechanism.point_names.index(rule.point)
        options.add_rule(name, index, (float(direction[0]), float(direction[1])), rule.travel)
        names.append(name)
    return names


def _times(action: Action, run: Any, rules: list[str]) -> dict[str, float]:
    """Times of the named events on the clock of the run."""
    changes = list_changes(action, run.events, rules)
    return {n: changes[i].time for n, i in name_events(changes, action.config.events).items()}


def _rows(action: Action, when: Mapping[str, float]) -> dict[str, SummaryRow]:
    """Rows of ``[reading]`` whose events happened."""
    rows = action.config.reading.rows
    needed = {n: {*(r.between or ()), r.at, r.after, r.before} - {None} for n, r in rows.items()}
    return {name: row for name, row in rows.items() if needed[name] <= when.keys()}


def looks_of(
    action: Action, outputs: Outputs, rules: list[str], rate: float
) -> Callable[[Any], list[tuple[str, Any]]]:
    """Function that lists what the summary needs of a stroke, with the names of the values."""
    key = action.config.reading.key_point

    def choose(run: Any) -> list[tuple[str, Any]]:
        found = []
        if key is not None and f"{key}.y" in outputs:
            place = outputs[f"{key}.y"][0]
            found.append((_KEY, _core.SensitivityRequest(place, 0.0, 0.0, 0)))
            found.append((_KEY, _core.SensitivityRequest(place, 0.0, run.reached, -1)))
        return found + _row_looks(action, outputs, _times(action, run, rules), run.reached, rate)

    return choose


def _row_looks(
    action: Action, outputs: Outputs, when: Mapping[str, float], reached: float, rate: float
) -> list[tuple[str, Any]]:
    """What the rows of ``[reading]`` need of a stroke, with their names."""
    found: list[tuple[str, Any]] = []

    def look(name: str, output: str, begin: float, end: float, sign: int) -> None:
        found.append((name, _core.SensitivityRequest(outputs[output][0], begin, end, sign)))

    for name, row in _rows(action, when).items():
        if row.output is None:
            continue
        if row.at is not None:
            look(name, row.output, when[row.at], when[row.at], 0)
            continue
        begin = when.get(str(row.after), 0.0)
        end = when.get(str(row.before), reached)
        if begin > end:
            continue
        if row.take == "mean":
            count = max(2, round((end - begin) * rate) + 1)
            for i in range(count):
                t = begin + (end - begin) * i / (count - 1)
                look(name, row.output, t, t, 0)
        for sign in _SIGNS.get(str(row.take), ()):
            look(name, row.output, begin, end, sign)
    return found


def row_values(
    action: Action,
    drive: Any,
    start: tuple[Any, Any],
    options: Any,
    when: Mapping[str, float],
    reached: float,
) -> dict[str, float]:
    """Rows of ``[reading]`` of a run, as :func:`feltmb.gradient` has them.

    For rows of an output, the run is repeated: an extremum lies between samples. ``drive``,
    ``start`` (state, memory) and ``options`` are those of the run; ``when``: its named events.
    """
    import numpy as np

    out, still = Summary(), dict.fromkeys(when, np.zeros(0))
    _add_times(action, out, when, still, 0.0)
    named = _core.observables(action.mechanism)
    outputs = {name: (i, unit) for i, (name, unit, _) in enumerate(named)}
    looks = _row_looks(action, outputs, when, reached, options.output_rate)
    if not looks:
        return out.values
    settings = _core.SensitivityOptions()
    settings.simulation = options
    settings.outputs = []
    settings.output_rate = options.output_rate
    settings.set_looks(lambda _: [look for _, look in looks])
    state, memory = (np.asarray(part, dtype=float) for part in start)
    segment = _core.SensitivitySegment(
        0.0, reached, state.tolist(), memory.tolist(), np.zeros((state.size, 0))
    )
    (result,) = _core.sensitivities(action.mechanism, drive, [], [segment], settings)
    if result.run.status == "done":
        for name, found in _by_name(looks, result.looks).items():
            _add_look(out, name, found, action.config.reading.rows[name], still, outputs)
    return out.values


def summarize(
    action: Action,
    result: Any,
    rules: list[str],
    outputs: Outputs,
    choose: Callable[[Any], list[tuple[str, Any]]],
) -> Summary:
    """Values of the summary with their derivatives, and events with theirs."""
    import numpy as np

    numbers = action.mechanism.contact_numbers
    run = result.run
    changes = list_changes(action, run.events, rules)
    named = name_events(changes, action.config.events)
    derived = {(e.contact, e.monitor, e.direction, e.when): e for e in result.events}
    begin = float(result.time[0])
    by_index = {
        i: derived.get((contact, monitor, direction, time + begin))
        for i, (time, contact, monitor, direction) in enumerate(run.events)
    }
    out = Summary()
    for name, i in named.items():
        event = by_index[i]
        if event is not None:
            out.put(f"{name}_time", changes[i].time + begin, event.time)
    strike = action.config.reading.strike_contact
    if strike is not None:
        _add_strike(out, result, changes, strike, numbers.index(strike), by_index)
        let_off = by_index.get(named["let_off"]) if "let_off" in named else None
        if let_off is not None:
            column = numbers.index(strike)
            gap = -run.event_compression[named["let_off"], column]
            out.put("let_off_gap", gap, -let_off.compression[column])
    unknown = np.full(result.end_state.shape[1], np.nan)
    moved = {n: getattr(by_index[i], "time", unknown) for n, i in named.items()}
    _add_times(action, out, _times(action, run, rules), moved, begin)
    for name, looks in _by_name(choose(run), result.looks).items():
        if name != _KEY:
            _add_look(out, name, looks, action.config.reading.rows[name], moved, outputs)
        elif begin == 0.0:
            start, lowest = looks
            value = start.value - lowest.value
            out.put(name, value, start.derivative - lowest.derivative, why=lowest.reason)
    names = {i: name for name, i in reversed(list(named.items()))}
    for i, change in enumerate(changes):
        event = by_index[i]
        if event is not None:
            name = names.get(i) or _name_of(change)
            out.events.append({"event": name, "time": event.when, "gradient": event.time})
    return out


def _name_of(change: Any) -> str:
    """Name of an event that the mechanism does not name."""
    if change.monitor:
        return str(change.monitor)
    what = f"contact{change.contact:02d}" if change.contact else "finger"
    return what + ("_on" if change.closes else "_off")


def _add_strike(
    out: Summary,
    result: Any,
    changes: Sequence[Any],
    strike: int,
    column: int,
    by_index: Mapping[int, Any],
) -> None:
    """Add the numbers of the first strike; ``column``: that of its contact in the arrays."""
    run, begin = result.run, float(result.time[0])
    on, off = next(iter(find_strikes(changes, strike)), (None, None))
    first, last = (None if i is None else by_index.get(i) for i in (on, off))
    if on is not None and first is not None:
        out.put("impact_time", changes[on].time + begin, first.time)
        out.put("impact_speed", run.event_approach[on, column], first.approach[column])
        if off is not None and last is not None:
            out.put("rebound_speed", -run.event_approach[off, column], -last.approach[column])
            duration = changes[off].time - changes[on].time
            out.put("impact_duration", duration, last.time - first.time)
    for (contact, force, time), peak in zip(run.peaks, result.peaks, strict=True):
        if contact == column and force > 0:
            out.put("max_impact_force", force, peak.derivative, why=peak.reason)
            name = "max_impact_force_time"
            out.put(name, time + begin, peak.time_derivative, why=peak.reason)


def _by_name(chosen: list[tuple[str, Any]], looks: list[Any]) -> dict[str, list[Any]]:
    found: dict[str, list[Any]] = {}
    for (name, _), look in zip(chosen, looks, strict=True):
        found.setdefault(name, []).append(look)
    return found


def _add_times(
    action: Action,
    out: Summary,
    when: Mapping[str, float],
    moved: Mapping[str, Array],
    begin: float,
) -> None:
    """Add the rows of ``[reading]`` that are times."""
    for name, row in _rows(action, when).items():
        if row.output is not None:
            continue
        start, end = row.between or (None, str(row.at))
        value = when[end] + begin if start is None else when[end] - when[start]
        derivative = moved[end] if start is None else moved[end] - moved[start]
        out.put(name, value, derivative, unit="s")


def _add_look(
    out: Summary,
    name: str,
    looks: list[Any],
    row: SummaryRow,
    moved: Mapping[str, Array],
    outputs: Outputs,
) -> None:
    """Add a row of ``[reading]`` from its looks; the ends of a look move with their events."""
    import numpy as np

    def total(look: Any, event: str | None) -> Array:
        derivative: Array = look.derivative
        return derivative if event is None else derivative + look.rate * moved[event]

    if row.at is not None:
        value, derivative = looks[0].value, total(looks[0], row.at)
    elif row.take == "mean":
        weight = np.ones(len(looks))
        weight[[0, -1]] = 0.5
        weight /= weight.sum()
        value = float(weight @ [look.value for look in looks])
        derivative = weight @ np.array([look.derivative for look in looks])
        length = looks[-1].time - looks[0].time
        for look, event, sign in ((looks[0], row.after, -1.0), (looks[-1], row.before, 1.0)):
            if event is not None and length > 0.0:
                derivative = derivative + sign * (look.value - value) / length * moved[event]
    else:
        ends = {-1: row.after, 0: None, 1: row.before}
        parts = [(look.value, total(look, ends[look.edge])) for look in looks]
        value, derivative = parts[0]
        if row.take == "range":
            value, derivative = value - parts[1][0], derivative - parts[1][1]
    why = next((look.reason for look in looks if look.reason), "")
    out.put(name, value, derivative, unit=outputs[str(row.output)][1], why=why)
