"""Derivatives of a stroke by parameters of the mechanism and the stroke, and by its start state.

One pass gives the derivatives of every output by all parameters: forward sensitivities along the
steps of the stroke, with one factorised matrix for all of them (``docs/sensitivity.md``).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

from feltmb import _core
from feltmb.config import Action, load_action
from feltmb.errors import IntegrationError, InvalidParameter
from feltmb.events import name_events
from feltmb.parameters import Parameter, all_parameters, find_parameters, mechanism_with
from feltmb.simulate import check_input, find_strike, list_changes
from feltmb.stroke import MOTORS, PRESCRIBED, Stroke, load_stroke

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt
    import pandas as pd
    import xarray as xr

    Array = npt.NDArray[np.float64]

__all__ = ["Gradient", "Window", "gradient", "state_at", "state_names", "windows"]

#: Parameters are shifted by this part of their size for df/dp; rounding and curvature both lie
#: below 1e-8 of the derivative.
SHIFT = 2e-6

#: Parameters of the input.
STROKE_PARAMETERS = ("stroke.scale", "stroke.delay")


@dataclass(frozen=True)
class Window:
    """One stretch of a stroke, from a full state.

    Attributes
    ----------
    begin, end
        On the clock of the stroke [s].
    state
        Full state at ``begin`` in the order of :func:`state_names`; None: the rest pose.
    memory
        Largest compression that each contact remembers [m]; None: as at rest, zero.
    """

    begin: float
    end: float
    state: npt.ArrayLike | None = None
    memory: npt.ArrayLike | None = None


@dataclass(frozen=True, eq=False)
class Gradient:
    """Outputs of a stroke and their derivatives, all in SI.

    Attributes
    ----------
    time : ndarray (n_times,)
        Sample times on the clock of the stroke [s].
    outputs : tuple of str
        Names as in a run; ``output_units``.
    values : ndarray (n_times, n_outputs)
    columns : tuple of str
        What the derivatives are by: parameters by path, then ``start.NAME`` for directions of the
        start state; ``column_units``.
    parameters : tuple of Parameter
        The first columns, with value, unit and size.
    array : ndarray (n_times, n_outputs, n_columns)
        d output / d column [unit of the output / unit of the column].
    summary : dict
        Numbers of the run, SI: those of ``Run.summary`` that have a derivative.
    summary_gradient : dict of ndarray (n_columns,)
        Their derivatives.
    events : tuple of dict
        One for each event that has a derivative: ``event``, ``time`` [s] and ``gradient``
        (n_columns,) of the time.
    end_state, end_memory : ndarray
        Full state and remembered compressions at the end.
    end_gradient : ndarray (n_states, n_columns)
    end_memory_gradient : ndarray (n_contacts, n_columns)
    stats : dict
        Work counts and wall times of the stroke and of the derivatives.
    """

    time: Array
    outputs: tuple[str, ...]
    output_units: tuple[str, ...]
    values: Array
    columns: tuple[str, ...]
    column_units: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    array: Array
    summary: dict[str, float]
    summary_gradient: dict[str, Array]
    events: tuple[dict[str, Any], ...]
    end_state: Array
    end_memory: Array
    end_gradient: Array
    end_memory_gradient: Array
    stats: dict[str, Any]
    provenance: dict[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        return (
            f"Gradient({len(self.outputs)} outputs at {len(self.time)} times by "
            f"{len(self.columns)} columns)"
        )

    def of(self, output: str, column: str | None = None) -> Array:
        """D output / d column over time, (n_times,), or by all columns, (n_times, n_columns)."""
        out: Array = self.array[:, _place(output, self.outputs, "output"), :]
        return out if column is None else out[:, _place(column, self.columns, "column")]

    @cached_property
    def data(self) -> xr.Dataset:
        """``values`` (time, output) and ``gradient`` (time, output, column), with units."""
        import xarray as xr

        return xr.Dataset(
            {
                "values": (("time", "output"), self.values),
                "gradient": (("time", "output", "column"), self.array),
            },
            coords={
                "time": ("time", self.time, {"units": "s"}),
                "output": list(self.outputs),
                "output_unit": ("output", list(self.output_units)),
                "column": list(self.columns),
                "column_unit": ("column", list(self.column_units)),
            },
        )

    def effects(self, change: float = 0.01) -> pd.DataFrame:
        """What a relative change of each parameter does to each number of the summary.

        Parameters
        ----------
        change
            Part of the size of a parameter; 0.01 is one percent.

        Returns
        -------
        DataFrame
            Rows: parameters; columns: numbers of the summary, SI.
        """
        import numpy as np
        import pandas as pd

        sizes = np.array([p.size for p in self.parameters])
        n = len(sizes)
        return pd.DataFrame(
            {name: change * sizes * g[:n] for name, g in self.summary_gradient.items()},
            index=pd.Index([p.path for p in self.parameters], name="parameter"),
        )


def _place(name: str, names: Sequence[str], what: str) -> int:
    if name not in names:
        import difflib

        near = difflib.get_close_matches(name, names, n=3)
        hint = f"; near are {', '.join(near)}" if near else ""
        raise InvalidParameter(f"there is no {what} {name!r}{hint}")
    return names.index(name)


def state_names(action: Action) -> tuple[str, ...]:
    """Names of the full state: coordinates, their rates, states of laws, modes and their rates."""
    return tuple(_core.state_names(action.mechanism))


def gradient(
    action: Action | str,
    stroke: Stroke | str,
    parameters: str | Iterable[str] | None = None,
    outputs: Iterable[str] | None = None,
    *,
    duration: float | None = None,
    rtol: float = 1e-7,
    tolerance: float = 3e-3,
    output_rate: float = 1000.0,
) -> Gradient:
    """Derivatives of a stroke from the rest pose, which moves with the parameters.

    Parameters
    ----------
    action, stroke
        Objects, or names for ``load_action`` and ``load_stroke``.
    parameters
        Dotted paths as for ``--set``, ``*`` for any name; ``stroke.scale`` [1] multiplies the
        input, ``stroke.delay`` [s] shifts it. Default: every real number of the mechanism that can
        be shifted. Derivatives are by SI values.
    outputs
        Names of outputs as in a run; default: coordinates, tracking points, forces and compressions
        of the contacts.
    duration
        [s]; default: the stroke's own.
    rtol
        Of the stroke. Where the motion is sensitive its derivatives are more so: one decade below
        the default of ``simulate``.
    tolerance
        Local relative error of each column, 1e-10 to 0.1.
    output_rate
        Samples a second; events and peaks do not depend on it.

    Raises
    ------
    InvalidParameter
        Paths or outputs that do not exist, all at once; a parameter whose shift changes the number
        of states.
    IntegrationError
        The stroke failed; ``error.partial`` is None.

    Notes
    -----
    Numbers of the summary: times of events, impact and rebound speed, string contact duration,
    let-off gap, largest string force, key travel. They move with the times of their events.
    """
    action = load_action(action) if isinstance(action, str) else action
    stroke = load_stroke(stroke) if isinstance(stroke, str) else stroke
    end = float(stroke.duration if duration is None else duration)
    return windows(
        action,
        stroke,
        [Window(0.0, end)],
        parameters,
        outputs,
        directions=None,
        rtol=rtol,
        tolerance=tolerance,
        output_rate=output_rate,
        jobs=1,
    )[0]


def windows(
    action: Action | str,
    stroke: Stroke | str,
    windows: Sequence[Window],
    parameters: str | Iterable[str] | None = None,
    outputs: Iterable[str] | None = None,
    *,
    directions: str | Sequence[str] | npt.ArrayLike | None = "mechanical",
    rtol: float = 1e-7,
    tolerance: float = 3e-3,
    output_rate: float = 1000.0,
    jobs: int | None = None,
) -> list[Gradient]:
    """Derivatives of many stretches of one stroke, each from its own full state, in one call.

    This is what multiple shooting needs: with ``directions`` the columns after the parameters are
    derivatives by the start state of each window.

    Parameters
    ----------
    windows
        See :class:`Window`. A window without a state starts from the rest pose, which moves with
        the parameters; a state that is given does not.
    parameters
        As in :func:`gradient`, but default: none.
    directions
        ``"mechanical"``: by every coordinate and rate; ``"all"``: by every state; names of states;
        an array (n_states, n_directions); None.
    jobs
        Threads over windows; default: one a core. The results do not depend on it.
    """
    action = load_action(action) if isinstance(action, str) else action
    stroke = load_stroke(stroke) if isinstance(stroke, str) else stroke
    from_rest = len(windows) == 1 and windows[0].state is None and directions is None
    check_input(action, stroke)
    chosen = _choose(action, parameters, every=from_rest and parameters is None)
    infos = {name: (i, unit) for i, (name, unit, _) in enumerate(_observables(action))}
    names = _choose_outputs(action, infos, outputs)
    extra = [n for n in _summary_outputs(action) if n in infos and n not in names]

    options = _core.SensitivityOptions()
    simulation = _core.SimulationOptions()
    simulation.rtol = float(rtol)
    strike = action.config.summary.strike_contact
    if strike is not None:
        simulation.peak_contacts = [strike]
    options.simulation = simulation
    options.tolerance = float(tolerance)
    options.output_rate = float(output_rate)
    options.outputs = [infos[n][0] for n in (*names, *extra)]
    options.threads = 0 if jobs is None else _positive(jobs)
    rules = _add_rules(action, options)
    start_names, matrix = _directions(action, directions)
    columns = tuple(p.path for p in chosen) + tuple(f"start.{n}" for n in start_names)
    units = tuple(p.unit for p in chosen) + tuple(_state_unit(action, n) for n in start_names)
    prepared = [_window(action, w, matrix) for w in windows]
    results = _core.sensitivities(
        action.mechanism,
        stroke.profile,
        stroke.kind == "motion",
        [_shifted(action, stroke, p) for p in chosen],
        prepared,
        options,
        *_drives(stroke),
    )
    provenance = {
        "feltmb": "gradient",
        "version": _core.__version__,
        "action": action.name,
        "hash": action.hash,
        "stroke": stroke.as_dict(),
        "options": {"rtol": float(rtol), "tolerance": float(tolerance)},
    }
    return [
        _to_gradient(action, r, w, names, extra, infos, chosen, columns, units, rules, provenance)
        for r, w in zip(results, windows, strict=True)
    ]


def state_at(
    action: Action | str, stroke: Stroke | str, times: Sequence[float], *, rtol: float = 1e-7
) -> list[Window]:
    """Windows between the given times of a stroke, each with the state that the stroke has there.

    Parameters
    ----------
    times
        Growing [s]; the first may be 0, the rest pose.

    Returns
    -------
    list of Window
        One for each pair of neighbours.
    """
    action = load_action(action) if isinstance(action, str) else action
    stroke = load_stroke(stroke) if isinstance(stroke, str) else stroke
    cuts = [float(t) for t in times]
    if len(cuts) < 2 or any(b <= a for a, b in itertools.pairwise(cuts)) or cuts[0] < 0:
        raise InvalidParameter(f"times: got {cuts!r} s, expected at least two, growing, from 0 on")
    state: Any = None
    memory: Any = None
    if cuts[0] > 0:
        lead = windows(
            action, stroke, [Window(0.0, cuts[0])], (), (), directions=None, rtol=rtol, jobs=1
        )[0]
        state, memory = lead.end_state, lead.end_memory
    out = []
    for a, b in itertools.pairwise(cuts):
        out.append(Window(a, b, state, memory))
        if b < cuts[-1]:
            part = windows(action, stroke, [out[-1]], (), (), directions=None, rtol=rtol, jobs=1)
            state, memory = part[0].end_state, part[0].end_memory
    return out


# --- what to derive by ---------------------------------------------------------------------------


def _positive(jobs: int) -> int:
    if int(jobs) < 1:
        raise InvalidParameter(f"jobs = {jobs}, must be >= 1")
    return int(jobs)


def _choose(action: Action, paths: str | Iterable[str] | None, *, every: bool) -> list[Parameter]:
    if every:
        return [p for p in all_parameters(action) if _can_shift(action, p)]
    given = [] if paths is None else [paths] if isinstance(paths, str) else list(paths)
    own = {
        "stroke.scale": Parameter("stroke.scale", 1.0, "1", 1.0),
        "stroke.delay": Parameter("stroke.delay", 0.0, "s", 1e-4),
    }
    find_parameters(action, [p for p in given if p not in own])  # all faults at once
    out: dict[str, Parameter] = {}
    for path in given:  # in the order in which they were asked for
        for parameter in [own[path]] if path in own else find_parameters(action, path):
            out[parameter.path] = parameter
    return list(out.values())


def _can_shift(action: Action, parameter: Parameter) -> bool:
    try:
        _nodes(action, parameter)
    except InvalidParameter:
        return False
    return True


def _nodes(action: Action, parameter: Parameter) -> list[tuple[Any, float, float]]:
    """Mechanisms, shifts and weights of a difference of second order."""
    h = SHIFT * parameter.size
    known = dict(action._described)  # parts of shifted values are not worth keeping

    def at(shift: float) -> Any:
        value = parameter.value + shift
        return mechanism_with(action, {parameter.path: value}, known)

    faults = []
    for sign in (1.0, -1.0):
        try:
            near = at(sign * h)
        except InvalidParameter as error:
            faults.append(str(error))
            continue
        try:
            return [(near, sign * h, sign * 0.5 / h), (at(-sign * h), -sign * h, -sign * 0.5 / h)]
        except InvalidParameter:
            # At the edge of what is permitted: three points on one side.
            s = sign / h
            return [
                (action.mechanism, 0.0, -1.5 * s),
                (near, sign * h, 2.0 * s),
                (at(2.0 * sign * h), 2.0 * sign * h, -0.5 * s),
            ]
    raise InvalidParameter(f"parameter {parameter.path!r} cannot be shifted: {faults[0]}")


def _shifted(action: Action, stroke: Stroke, parameter: Parameter) -> Any:
    def model(mechanism: Any, shift: float, weight: float, **changed: Any) -> Any:
        return _core.Perturbed(
            mechanism,
            changed.get("profile", stroke.profile),
            stroke.kind == "motion",
            shift,
            weight,
            changed.get("origin", 0.0),
            *_drives(stroke),
        )

    h = SHIFT * parameter.size
    sides = [(h, 0.5 / h), (-h, -0.5 / h)]
    if parameter.path == "stroke.scale":
        nodes = [
            model(action.mechanism, s, w, profile=stroke.scaled(1.0 + s).profile) for s, w in sides
        ]
    elif parameter.path == "stroke.delay":
        nodes = [model(action.mechanism, s, w, origin=-s) for s, w in sides]
    else:
        nodes = [model(*node) for node in _nodes(action, parameter)]
    return _core.SensitivityParameter(
        parameter.path,
        nodes,
        parameter.size,
        _law_of(action, parameter.path),
        _is_inertial(action, parameter.path),
        parameter.path in _MODAL,
        _touched_contacts(action, parameter.path),
    )


def _touched_contacts(action: Action, path: str) -> list[int] | None:
    """Positions of the only contacts that a path changes; None: more than contacts."""
    table, name, *rest = path.split(".")
    numbers: list[int] = action.mechanism.contact_numbers
    if table == "points":  # where one looks
        return []
    if table == "contacts":
        return [numbers.index(int(name))]
    if table == "surfaces":
        users = (int(n) for n, c in action.config.contacts.items() if name in c.surfaces)
        return [numbers.index(n) for n in users if n in numbers]
    if table == "bodies" and action.config.bodies[name].kind == "beam" and rest[0] in _MASSES:
        return []  # those of a beam follow from its density
    return None


_MASSES = ("mass", "inertia", "center_of_mass")

#: Parameters that change the frequencies, damping and shapes of the string's modes, nothing else.
_MODAL = frozenset(
    f"string.{name}" for name in ("tension", "young_modulus", "damping_ratio", "linear_density")
)


def _is_inertial(action: Action, path: str) -> bool:
    """Whether a parameter changes the mass, center of mass or inertia of a rigid body only."""
    table, name, *rest = path.split(".")
    if table != "bodies" or rest[0] not in _MASSES:
        return False
    return action.config.bodies[name].kind == "rigid"


def _law_of(action: Action, path: str) -> int:
    """Position of the contact whose law is all that a parameter changes, else -1."""
    table, *rest = path.split(".")
    numbers: list[int] = action.mechanism.contact_numbers
    if table == "contacts" and rest[1] != "friction":
        return numbers.index(int(rest[0]))
    return -1


def _drives(stroke: Stroke) -> tuple[bool, bool]:
    """Whether a motion is prescribed exactly, and whether a motor drives."""
    return stroke.kind in PRESCRIBED, stroke.kind in MOTORS


def _directions(action: Action, given: Any) -> tuple[tuple[str, ...], Any]:
    import numpy as np

    names = state_names(action)
    n = len(action.coordinates)
    if given is None:
        return (), np.zeros((len(names), 0))
    if isinstance(given, str) or (
        isinstance(given, Sequence) and all(isinstance(g, str) for g in given)
    ):
        if given == "mechanical":
            chosen = names[: 2 * n]
        elif given == "all":
            chosen = names
        else:
            chosen = (given,) if isinstance(given, str) else tuple(given)
        matrix = np.zeros((len(names), len(chosen)))
        for j, name in enumerate(chosen):
            matrix[_place(name, names, "state"), j] = 1.0
        return chosen, matrix
    matrix = np.asarray(given, dtype=float)
    if matrix.ndim != 2 or matrix.shape[0] != len(names) or not np.all(np.isfinite(matrix)):
        raise InvalidParameter(
            f"directions: got an array of shape {matrix.shape}, expected finite numbers "
            f"({len(names)}, n_directions)"
        )
    return tuple(f"direction{j + 1}" for j in range(matrix.shape[1])), matrix


def _state_unit(action: Action, name: str) -> str:
    n = len(action.coordinates)
    names = state_names(action)
    if name not in names:
        return "1"
    i = names.index(name)
    units: list[str] = action.mechanism.coordinate_units
    if i < 2 * n:
        return units[i % n] + ("/s" if i >= n else "")
    if i < 2 * n + action.mechanism.total_law_states:
        return "SI"
    return "m kg^0.5/s" if name.endswith(".rate") else "m kg^0.5"


def _window(action: Action, window: Window, matrix: Any) -> Any:
    import numpy as np

    size = len(state_names(action))
    contacts = len(action.mechanism.contact_numbers)
    if not isinstance(window, Window):
        raise InvalidParameter(f"windows: got a {type(window).__name__}, expected Window objects")
    state = [] if window.state is None else np.asarray(window.state, dtype=float).ravel().tolist()
    memory = (
        [] if window.memory is None else np.asarray(window.memory, dtype=float).ravel().tolist()
    )
    for what, values, wanted in (("state", state, size), ("memory", memory, contacts)):
        if values and (len(values) != wanted or not all(map(math.isfinite, values))):
            raise InvalidParameter(
                f"window from {window.begin:g} s: {what} holds {len(values)} numbers, expected "
                f"{wanted}, all finite"
            )
    return _core.SensitivityWindow(float(window.begin), float(window.end), state, memory, matrix)


# --- what to derive ------------------------------------------------------------------------------


def _observables(action: Action) -> list[tuple[str, str, str]]:
    return list(_core.observables(action.mechanism))


def _choose_outputs(
    action: Action, infos: Mapping[str, tuple[int, str]], given: Iterable[str] | None
) -> list[str]:
    if given is not None:
        chosen = [given] if isinstance(given, str) else list(given)
        faults = []
        for name in chosen:
            try:
                _place(name, list(infos), "output")
            except InvalidParameter as error:
                faults.append(str(error))
        if faults:
            raise InvalidParameter("\n".join(faults))
        return list(dict.fromkeys(chosen))
    points = tuple(action.config.points)
    return [
        name
        for name in infos
        if name in action.coordinates
        or name.rpartition(".")[0] in points
        or name.endswith((".force", ".compression"))
    ]


def _summary_outputs(action: Action) -> list[str]:
    point = action.config.summary.key_point
    return [f"{point}.y"] if point is not None else []


def _add_rules(action: Action, options: Any) -> list[str]:
    """Travels of tracking points that are events."""
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


def _to_gradient(
    action: Action,
    result: Any,
    window: Window,
    names: list[str],
    extra: list[str],
    infos: Mapping[str, tuple[int, str]],
    chosen: list[Parameter],
    columns: tuple[str, ...],
    units: tuple[str, ...],
    rules: list[str],
    provenance: dict[str, Any],
) -> Gradient:
    import numpy as np

    run = result.run
    if run.status != "done":
        where = f"window from {window.begin:g} s to {window.end:g} s: "
        raise IntegrationError(
            where + run.message,
            partial=None,  # type: ignore[arg-type]  # only derivatives were wanted
            time=run.reached,
            state=run.failed_state,
            contact=run.failed_contact,
        )
    count = len(names)
    array = np.asarray(result.gradient)
    summary, summary_gradient, events = _summarize(action, result, rules)
    if extra or (names and _summary_outputs(action)):
        _add_key_travel(action, result, [*names, *extra], array, summary, summary_gradient)
    stats: dict[str, Any] = {
        "stroke": dict(run.counts),
        **result.counts,
        "wall_stroke": result.wall_stroke,
        "wall": result.wall,
    }
    return Gradient(
        time=result.time,
        outputs=tuple(names),
        output_units=tuple(infos[n][1] for n in names),
        values=result.values[:, :count],
        columns=columns,
        column_units=units,
        parameters=tuple(chosen),
        array=array[:, :count, :],
        summary=summary,
        summary_gradient=summary_gradient,
        events=tuple(events),
        end_state=run.end_state,
        end_memory=np.asarray(run.end_largest_compression),
        end_gradient=result.end_state,
        end_memory_gradient=result.end_memory,
        stats=stats,
        provenance=provenance,
    )


def _summarize(
    action: Action, result: Any, rules: list[str]
) -> tuple[dict[str, float], dict[str, Array], list[dict[str, Any]]]:
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
    summary: dict[str, float] = {}
    out: dict[str, Array] = {}

    def put(name: str, value: float, derivative: Any) -> None:
        summary[name] = float(value)
        out[name] = derivative

    for name, i in named.items():
        event = by_index[i]
        if event is not None:
            put(f"{name}_time", changes[i].time + begin, event.time)
    strike = action.config.summary.strike_contact
    if strike is not None:
        column = numbers.index(strike)
        on, off = find_strike(changes, strike)
        first = by_index.get(on) if on is not None else None
        last = by_index.get(off) if off is not None else None
        if on is not None and first is not None:
            put("impact_time", changes[on].time + begin, first.time)
            put("impact_speed", run.event_approach[on, column], first.approach[column])
        if on is not None and off is not None and first is not None and last is not None:
            put("rebound_speed", -run.event_approach[off, column], -last.approach[column])
            duration = changes[off].time - changes[on].time
            put("string_contact_duration", duration, last.time - first.time)
        for (contact, force, _), derivative in zip(run.peaks, result.peaks, strict=True):
            if contact == column and force > 0:
                put("max_string_force", force, derivative)
        let_off = by_index.get(named["let_off"]) if "let_off" in named else None
        if let_off is not None:
            gap = -run.event_compression[named["let_off"], column]
            put("let_off_gap", gap, -let_off.compression[column])
    names = {i: name for name, i in reversed(list(named.items()))}
    events = []
    for i, change in enumerate(changes):
        event = by_index[i]
        if event is None:
            continue
        name = (
            names.get(i)
            or change.monitor
            or (f"contact{change.contact:02d}" if change.contact else "finger")
            + ("_on" if change.closes else "_off")
        )
        events.append({"event": name, "time": event.when, "gradient": event.time})
    return summary, out, events


def _add_key_travel(
    action: Action,
    result: Any,
    names: list[str],
    array: Array,
    summary: dict[str, float],
    out: dict[str, Array],
) -> None:
    import numpy as np

    column = f"{action.config.summary.key_point}.y"
    if column not in names or result.time[0] != 0.0:
        return
    i = names.index(column)
    y = result.values[:, i]
    lowest = int(np.argmin(y))
    summary["key_travel"] = float(y[0] - y[lowest])
    out["key_travel"] = array[0, i] - array[lowest, i]
