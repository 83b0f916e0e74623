"""Simulation of a mechanism with a stroke."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from feltmb import _core
from feltmb.errors import IntegrationError
from feltmb.mechanism import Action, load_action
from feltmb.run.events import Change, list_changes, name_events
from feltmb.run.options import ALL_OPTIONS, RunOptions, check_options
from feltmb.run.results import Provenance, Run
from feltmb.run.strikes import (
    CHECK_WINDOW,
    add_check,
    find_strikes,
    list_strikes,
    strike_numbers,
)
from feltmb.run.stroke import MOTORS, Stroke, load_stroke
from feltmb.run.warnings import run_warnings
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter, near_names
from unmodeled.units.quantity import parse_scalar

if TYPE_CHECKING:
    import pandas as pd

    Array = npt.NDArray[np.float64]

#: Beyond it, squares of an initial value or its energy are no numbers [SI].
LARGEST = 1e9
#: Compression at the start beyond that of the rest pose, above which it is told [m].
PRESSED = 1e-5

_CONTACT_COLUMNS = (
    "compression",
    "rate",
    "normal_force",
    "slip_speed",
    "friction_force",
    "x",
    "y",
    "normal_x",
    "normal_y",
)


@dataclass(frozen=True)
class Evaluation:
    """Equations of motion at one state, M(q) qdd = force.

    Attributes
    ----------
    mass_matrix : ndarray (n, n)
        M; its units are energy divided by squared coordinate rates.
    force : ndarray (n,)
        Generalized force with gravity, springs, contacts, friction, finger and the quadratic
        velocity terms (thesis eq. 4.6) [N m, N].
    acceleration : ndarray (n,)
        qdd [rad/s^2, m/s^2].
    rows : tuple of tuples
        Contact number and the columns of ``contacts``.
    """

    mass_matrix: Array
    force: Array
    acceleration: Array
    rows: tuple[tuple[float, ...], ...]

    @cached_property
    def contacts(self) -> pd.DataFrame:
        """Table of contacts, by contact number.

        Columns: ``compression`` [m] (negative: gap), ``rate`` [m/s], ``normal_force`` [N],
        ``slip_speed`` [m/s], ``friction_force`` [N] (of the circle's body on the other, along the
        normal rotated by +90 degrees), ``x y`` of the contact point [m], ``normal_x normal_y``:
        unit normal into the circle's body.
        """
        import pandas as pd

        frame = pd.DataFrame(
            [row[1:] for row in self.rows],
            columns=list(_CONTACT_COLUMNS),
            index=pd.Index([int(row[0]) for row in self.rows], name="contact"),
        )
        return frame.sort_index()


@checked
def evaluate(
    action: Action, q: npt.ArrayLike, qd: npt.ArrayLike, finger_force: float = 0.0
) -> Evaluation:
    """Evaluate the equations of motion in a state, without integration; the string is at rest.

    Parameters
    ----------
    q, qd
        Mechanical coordinates [rad, m] and their rates, in the order of ``action.coordinates``.
    finger_force
        Finger force [N], positive pressing.

    Examples
    --------
    The hammer action at rest, without a finger:

    >>> import numpy as np
    >>> import feltmb
    >>> action = feltmb.load_action("steinway45")
    >>> still = np.zeros(len(action.coordinates))
    >>> found = feltmb.evaluate(action, still, still)
    >>> len(found.acceleration) == still.size
    True
    """
    if not np.isfinite(finger_force):
        raise InvalidParameter(f"evaluate: finger_force = {finger_force!r} N, must be finite")
    out = _core.evaluate(
        action.mechanism,
        np.asarray(q, dtype=float).ravel(),
        np.asarray(qd, dtype=float).ravel(),
        float(finger_force),
    )
    return Evaluation(
        out["mass_matrix"], out["force"], out["acceleration"], tuple(map(tuple, out["contacts"]))
    )


@checked
def simulate(
    action: Action | str,
    stroke: Stroke | str,
    duration: float | None = None,
    rtol: float | None = None,
    *,
    options: RunOptions | None = None,
    start: Run | Mapping[str, float | str] | None = None,
    progress: Callable[[float], object] | None = None,
    **given: Any,
) -> Run:
    """Simulate a stroke.

    Parameters
    ----------
    action, stroke
        Objects, or names for :func:`load_action` and :func:`load_stroke`.
    duration, rtol
        As in ``options``; they replace the values there.
    options
        See :class:`RunOptions`.
    start
        Run of the same mechanism whose end is the start state; time starts at zero again. Or
        coordinates and speeds that differ from the rest pose, in SI units or as texts with a unit:
        ``{"hammer.x": "-20 mm", "hammer.x.rate": "2 m/s"}``. Default: the rest pose.
    progress
        Function that is called now and then with the simulated time [s]. If it returns False, the
        run is interrupted; any other value, None included, continues it.
    given
        Any other field of :class:`RunOptions`, which replaces the value in ``options``.

    Raises
    ------
    InvalidParameter
        An argument is out of range, or ``start`` belongs to another mechanism.
    IntegrationError
        The solver stopped early, a result is not a number, or the energy balance error exceeds
        ``ledger_limit``; ``error.partial`` is the run so far.
    KeyboardInterrupt
        The user interrupted the simulation.

    Examples
    --------
    Speed of the hammer at the string [m/s] after a press with 20 N:

    >>> from feltmb import ramp_stroke, simulate
    >>> run = simulate("steinway45", ramp_stroke(20.0), summary_only=True)
    >>> round(run.summary["impact_speed"], 2)
    2.93
    """
    if isinstance(action, str):
        action = load_action(action)
    if isinstance(stroke, str):
        stroke = load_stroke(stroke)
    first: dict[str, Any] = {
        k: v for k, v in (("duration", duration), ("rtol", rtol)) if v is not None
    }
    check_options(given, known=ALL_OPTIONS)
    chosen = replace(options or RunOptions(), **first, **given)
    settings, arguments = prepare(action, stroke, chosen, start)
    mechanism, drive, y, monitors, memory = arguments
    result = _core.simulate(mechanism, drive, settings, y, monitors, progress, memory)
    run = to_run(action, stroke, settings, result, (y, memory))
    pressed: list[str] = []
    if isinstance(start, Mapping):
        run.provenance["initial"] = {k: str(v) for k, v in start.items()}
        pressed = _pressed_at_start(action, np.asarray(y))
        run.stats["warnings"] += pressed
    if isinstance(start, Run) and start.provenance.get("hash") != action.hash:
        run.stats["warnings"].append(
            f"started from a run of {start.provenance.get('action')!r} with other parameters"
        )
    if run.status == "interrupted":
        raise KeyboardInterrupt(run.message)
    if run.status != "done":
        raise IntegrationError(
            "\n".join([run.message, *pressed]),
            code=result.code,
            partial=run,
            time=run.reached,
            state=result.failed_state,
            contact=result.failed_contact,
        )
    return run


def prepare(
    action: Action,
    stroke: Stroke,
    given: RunOptions,
    start: Run | Mapping[str, float | str] | None = None,
) -> tuple[_core.SimulationOptions, tuple[Any, ...]]:
    """Options and other arguments of the core for a call of :func:`simulate`.

    The other arguments are the mechanism, the input, the start state, monitors and the memory of
    felt.
    """
    check_input(action, stroke)
    options = _core.SimulationOptions()
    options.duration = float(stroke.duration if given.duration is None else given.duration)
    options.rtol = (
        float(given.rtol)
        if given.error is None
        else _core.tolerance_for(given.error, action.mechanism, given.method)
    )
    options.output_rate = float(given.output_rate)
    options.ledger = given.ledger
    options.events = given.events
    options.method = given.method
    for name in ("max_wall", "max_step", "ledger_limit"):
        if getattr(given, name) is not None:
            setattr(options, name, float(getattr(given, name)))
    if given.max_order is not None:
        options.max_order = int(given.max_order)
    roles = action.config.reading
    if roles.strike_contact is not None:
        options.peak_contacts = [roles.strike_contact]
    if roles.key_point is not None:
        names = action.mechanism.point_names
        options.lowest_points = [names.index(roles.key_point)]
    if given.summary_only:
        # One additional sample in case of rounding; the core rejects an invalid rate or duration.
        early = CHECK_WINDOW + 1.5 / options.output_rate if options.output_rate > 0.0 else 0.0
        options.outputs_from = max(0.0, options.duration - early)

    y, memory = _start_state(action, start)
    if action.config.finger is not None:
        options.finger_reference = _core.finger_place(action.mechanism, action.rest_pose)
    return options, (
        action.mechanism,
        stroke.input,
        list(y),
        start_monitors(action, y),
        list(memory),
    )


def check_input(action: Action, stroke: Stroke) -> None:
    """Check that the mechanism has the finger or motor of the input."""
    if any(stroke.value):
        refuse_kind(action, stroke.kind, f"stroke {stroke.name!r} is a {stroke.kind}")


def refuse_kind(action: Action, kind: str, what: str) -> None:
    """Reject an input for which the mechanism has no finger or motor."""
    if kind in MOTORS:
        if action.config.motor is None:
            raise InvalidParameter(
                f"{what}, but mechanism {action.name!r} describes no motor; compose it with an "
                "actuator (--actuator, in Python feltmb.actuator.compose)"
            )
    elif action.config.finger is None:
        raise InvalidParameter(
            f"{what} of a finger, but mechanism {action.name!r} describes no finger"
        )
    elif action.config.motor is not None and action.config.motor.contact is not None:
        raise InvalidParameter(
            f"{what} of a finger, but a motor presses mechanism {action.name!r}; give its torque "
            "or motor angle"
        )


def _start_state(
    action: Action, start: Run | Mapping[str, float | str] | None
) -> tuple[Array, Array]:
    """Full state [q, v, law states, eta, deta/dt] and remembered compressions."""
    n = len(action.coordinates)
    modes = action.mechanism.total_modes
    size = 2 * (n + modes) + action.mechanism.total_law_states
    if start is None or isinstance(start, Mapping):
        rest = action.equilibrium
        y = np.concatenate([rest["q"], np.zeros(n), rest["law"], rest["eta"], np.zeros(modes)])
        for index, value in initial_values(action, start or {}).items():
            y[index] = value
        return y, np.asarray(rest["largest_compression"])
    if not isinstance(start, Run):
        raise InvalidParameter(
            f"start: got a {type(start).__name__}, expected a run or initial values by coordinate"
        )
    state, memory = (_reals(start, name) for name in ("end_state", "end_memory"))
    if start.coordinates != action.coordinates or state.size != size:
        raise InvalidParameter(
            f"start: the run ends with {state.size} states of coordinates "
            f"{', '.join(start.coordinates)}; this mechanism has {size} of "
            f"{', '.join(action.coordinates)}"
        )
    # Turning points of laws that have them follow, in pairs.
    rest_memory = action.equilibrium["largest_compression"]
    if memory.size < len(rest_memory) or (memory.size - len(rest_memory)) % 2:
        raise InvalidParameter(
            f"start: the run ends with {memory.size} remembered compressions, expected one a "
            f"contact of this mechanism ({len(rest_memory)}); without them its felts would forget"
        )
    return state, memory


def _pressed_at_start(action: Action, y: Array) -> list[str]:
    """Warnings about contacts that initial values press more than the rest pose does."""
    n = len(action.coordinates)
    rest, begin = (
        evaluate(action, q, v).contacts
        for q, v in ((action.rest_pose, np.zeros(n)), (y[:n], y[n : 2 * n]))
    )
    before = rest["compression"].clip(lower=0.0)
    more = begin["compression"] - before.reindex(begin.index, fill_value=0.0)
    return [
        f"contact {number:02d} is pressed by {1e3 * row.compression:.3g} mm in the initial pose, "
        f"with {row.normal_force:.3g} N; in the rest pose by {1e3 * before.get(number, 0.0):.3g} mm"
        for number, row in begin[more > PRESSED].iterrows()
    ]


def initial_values(action: Action, values: Mapping[str, float | str]) -> dict[int, float]:
    """Initial values of coordinates and speeds by their place in the state.

    Parameters
    ----------
    values
        ``"NAME"`` or ``"NAME.rate"`` of a coordinate -> value in SI units, or text with a unit.

    Raises
    ------
    InvalidParameter
        A coordinate does not exist or a value is invalid; all faults are in one message.
    """
    names = {name: (i, unit) for i, (name, unit) in enumerate(_coordinates(action))}
    known = [*names, *(f"{name}.rate" for name in names)]
    out, faults = {}, []
    for name, value in values.items():
        coordinate = name.removesuffix(".rate")
        if coordinate not in names:
            faults.append(f"start: there is no coordinate {name!r}{near_names(name, known)}")
            continue
        index, unit = names[coordinate]
        if name != coordinate:
            index, unit = index + len(names), f"{unit}/s"
        try:
            out[index] = parse_scalar(value, unit)
        except ValueError as error:
            faults.append(f"start: {name}: {error}")
        else:
            if not abs(out[index]) <= LARGEST:
                faults.append(f"start: {name} = {value}, expected at most {LARGEST:g} {unit}")
    if faults:
        raise InvalidParameter("\n".join(faults))
    return out


def _coordinates(action: Action) -> list[tuple[str, str]]:
    """Names and units of the coordinates."""
    return list(zip(action.coordinates, action.mechanism.coordinate_units, strict=True))


def _reals(run: Run, name: str) -> Array:
    """An array of a run as real numbers; its owner may have replaced it."""
    array = np.asarray(getattr(run, name))
    if array.ndim != 1 or array.dtype.kind not in "iuf":
        raise InvalidParameter(
            f"start: {name} is an array of {array.dtype} with {array.ndim} dimensions, expected a "
            "list of real numbers"
        )
    return array.astype(float)


def start_monitors(action: Action, y: Array | None = None) -> list[Any]:
    """Events of tracking points by their travel from a state; default: from rest."""
    monitors = []
    n = len(action.coordinates)
    if y is None:
        y = action.rest_pose
    for name, rule in action.config.events.items():
        if rule.point is None or rule.travel is None:
            continue
        index = action.mechanism.point_names.index(rule.point)
        x = np.asarray(_core.point_position(action.mechanism, index, y[:n]))
        direction = np.asarray(rule.direction) / np.linalg.norm(rule.direction)
        monitors.append(
            _core.Monitor(
                name=name,
                point=index,
                direction=(float(direction[0]), float(direction[1])),
                level=float(direction @ x) + rule.travel,
            )
        )
    return monitors


def to_run(
    action: Action, stroke: Stroke, options: Any, result: Any, start: tuple[Any, Any]
) -> Run:
    """Convert a result of the core to a run; ``start``: its state and memory at the start."""
    from feltmb.run.sensitivity.summary import row_values

    monitor_names = [name for name, rule in action.config.events.items() if rule.point is not None]
    changes = list_changes(action, result.events, monitor_names)
    named = name_events(changes, action.config.events)
    when = {name: changes[i].time for name, i in named.items()}
    n = len(action.coordinates)
    modes = action.mechanism.total_modes
    energy = _energy(result)
    string = action.config.string
    entries: dict[str, Any] = {
        "feltmb": "run",
        "version": _core.__version__,
        "action": action.name,
        "stroke": stroke.as_dict(),
        "options": {
            "duration": options.duration,
            "rtol": options.rtol,
            "output_rate": options.output_rate,
        },
    }
    late = {"toml": action.to_toml, "hash": lambda: action.hash}
    provenance = Provenance(entries, late)
    if string is not None and string.kind == "modal":
        provenance["string"] = {
            key: getattr(string, key)
            for key in (
                "diameter",
                "tension",
                "length",
                "linear_density",
                "young_modulus",
                "damping_ratio",
                "modes",
                "count",
            )
        }
    stats: dict[str, Any] = dict(result.counts)
    stats.update(
        restarts=result.restarts,
        method=result.method,
        strikes=result.strikes,
        wall=result.wall,
        reached=result.reached,
        limiting_states=dict(result.limiting_states[:10]),
        limiting_contacts=dict(result.limiting_contacts[:10]),
        rest_iterations=action.equilibrium["iterations"],
    )
    states = result.states
    laws = action.mechanism.total_law_states
    stats["warnings"] = run_warnings(action, stroke, options, result, energy)
    if len(changes) >= _MOST_EVENTS:
        stats["warnings"].append(
            f"only the first {_MOST_EVENTS} events were kept: named events and the summary may be "
            "wrong"
        )
    return Run(
        time=result.time,
        names=tuple(result.names),
        units=tuple(result.units),
        long_names=tuple(result.long_names),
        values=result.data,
        eta=states[:, 2 * n + laws : 2 * n + laws + modes],
        event_table=_event_table(action, changes, named, result),
        summary=_summary(action, named, changes, result)
        | row_values(action, stroke.input, start, options, when, result.reached),
        energy=energy,
        stats=stats,
        provenance=provenance,
        end_state=result.end_state,
        end_memory=np.asarray(result.end_largest_compression),
        coordinates=action.coordinates,
        status=result.status,
        message=result.message,
        strike_list=list_strikes(action, changes, result),
    )


#: Largest number of events that the core stores for one run.
_MOST_EVENTS = 100_000


def _event_table(
    action: Action, changes: list[Change], named: Mapping[str, int], result: Any
) -> dict[str, list[Any]]:
    names: dict[int, str] = {}
    for name, index in named.items():
        names.setdefault(index, name)
    table: dict[str, list[Any]] = {
        "event": [
            names.get(
                i,
                change.monitor
                if change.monitor is not None
                else (
                    f"contact{change.contact:02d}_{'on' if change.closes else 'off'}"
                    if change.contact
                    else "finger_on"
                    if change.closes
                    else "finger_off"
                ),
            )
            for i, change in enumerate(changes)
        ],
        "time": [c.time for c in changes],
        "contact": [c.contact for c in changes],
        "change": [
            "passes" if c.monitor is not None else "closes" if c.closes else "opens"
            for c in changes
        ],
    }
    n = len(action.coordinates)
    for k, name in enumerate(action.coordinates):
        table[f"{name}.rate"] = result.event_states[:, n + k].tolist()
    for i, number in enumerate(action.mechanism.contact_numbers):
        if number > 0:
            table[f"gap{number:02d}"] = (-result.event_compression[:, i]).tolist()
            table[f"approach{number:02d}"] = result.event_approach[:, i].tolist()
    return table


def _energy(result: Any) -> dict[str, Any]:
    """Ledger of a run; see docs/explanation/model.md, section "Energy"."""
    if result.ledger.shape[1] == 0 or result.ledger.shape[0] == 0:
        return {}
    parts = ("kinetic", "gravity", "elastic", "contact", "string")
    columns = {name: i for i, name in enumerate(result.names)}
    stored = {p: result.data[:, columns[f"energy.{p}"]] for p in parts}
    ledger = dict(zip(result.ledger_names, result.ledger.T, strict=True))
    dissipated = {
        name.removeprefix("dissipated."): float(values[-1])
        for name, values in ledger.items()
        if name.startswith("dissipated.")
    }
    turned = result.balance["turned_over"]
    start = result.start
    change = {p: float(stored[p][-1]) - start[columns[f"energy.{p}"]] for p in parts}
    return {
        "work_in": float(ledger["work_in"][-1]),
        "work_throughput": float(ledger["work_throughput"][-1]),
        "kinetic": change["kinetic"],
        "potential": change["gravity"],
        "elastic": change["elastic"] + change["contact"] + change["string"],
        "elastic_parts": {
            "springs": change["elastic"],
            "contacts": change["contact"],
            "string": change["string"],
        },
        "dissipated": dissipated,
        "dissipated_total": sum(dissipated.values()),
        "created_by": sorted(
            name for name, value in dissipated.items() if value < -1e-9 * max(turned, 1e-12)
        ),
        **result.balance,
    }


def _summary(
    action: Action, named: Mapping[str, int], changes: list[Change], result: Any
) -> dict[str, float]:
    roles = action.config.reading
    numbers = action.mechanism.contact_numbers
    out: dict[str, float] = {}
    for name, index in named.items():
        out[f"{name}_time"] = changes[index].time
    strike = roles.strike_contact
    if strike is not None:
        column = numbers.index(strike)
        for on, off in find_strikes(changes, strike)[:1]:
            out |= strike_numbers(changes, on, off, result, column)
        for contact, force, time in result.peaks:
            if contact == column:
                out["max_impact_force"] = float(force)
                out["max_impact_force_time"] = float(time)
        if "let_off" in named:
            out["let_off_gap"] = float(-result.event_compression[named["let_off"], column])
        if "check" in named:
            add_check(action, column, result, out)
    _add_key(action, result, out)
    return out


def _add_key(action: Action, result: Any, out: dict[str, float]) -> None:
    if action.config.reading.key_point is None or not result.lowest:
        return
    [(_, start, lowest)] = result.lowest
    out["key_travel"] = start - lowest
