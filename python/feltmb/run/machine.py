"""Simulation of a mechanism step by step, for controllers, haptics, co-simulation, learning."""

from __future__ import annotations

import copy
import difflib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
import numpy.typing as npt

from feltmb import _core
from feltmb.errors import IntegrationError
from feltmb.mechanism import Action, load_action
from feltmb.run.events import Change, list_changes
from feltmb.run.options import check_options
from feltmb.run.simulate import initial_values, refuse_kind, start_monitors
from feltmb.run.stroke.strokes import LARGEST, PRESCRIBED, UNITS, Kind
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter, shown
from unmodeled.units import conversion_factor


@dataclass(frozen=True, eq=False)
class MachineState:
    """State that determines all following steps of a machine; it can be compared and pickled.

    Attributes
    ----------
    time : float
        Time of the machine's clock [s]. Steps do not depend on it.
    y : ndarray
        Coordinates, their rates, states of contact laws, modal coordinates of strings and their
        rates, as in ``Run.end_state``.
    memory : ndarray
        Largest compression that each contact remembers [m].
    kind : str
        Kind of the last input.
    drive : tuple of float
        Value, rate and acceleration of the last input, and its mean rate over the last step, SI
        units.
    mechanism : str
        ``Action.hash`` of the mechanism in this state; empty: unknown, not compared.
    """

    time: float
    y: npt.NDArray[np.float64]
    memory: npt.NDArray[np.float64]
    kind: Kind
    drive: tuple[float, float, float, float] = field(default=(0.0, 0.0, 0.0, 0.0))
    mechanism: str = ""

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, MachineState):
            return NotImplemented
        return (
            self.time == other.time
            and self.kind == other.kind
            and self.drive == other.drive
            and self.mechanism == other.mechanism
            and np.array_equal(self.y, other.y)
            and np.array_equal(self.memory, other.memory)
        )

    __hash__ = None  # type: ignore[assignment]


def _numbers(name: str, given: Any, count: int) -> list[float]:
    """A field of a state as ``count`` real numbers; the core checks their meaning."""
    try:
        found = np.asarray(given)
    except ValueError:  # rows of different lengths
        found = np.asarray("")
    if found.dtype.kind not in "fiu" or found.shape != (count,):
        raise InvalidParameter(
            f"state: {name}: got {shown(given)}, expected {count} real "
            f"number{'s' if count > 1 else ''} of this mechanism"
        )
    return [float(value) for value in found]


@checked
class Machine:
    """A mechanism that advances step by step. Each step has its own input.

    A step depends on the state only, and not on the history of an integrator. The input may
    therefore jump, and the same state and input give the same result to the last bit. Only one
    thread at a time may use a machine. A step releases the global interpreter lock.

    Parameters
    ----------
    action
        Object, or name for :func:`load_action`.
    hold
        Time function of a force, a torque or a finger's motion within a step. ``"zero"``: constant
        at the given value. ``"linear"``: a straight line from the value of the last step.
    rtol, method, max_order, max_step, max_wall
        As in :class:`RunOptions`; ``max_wall`` applies to one step. In a step shorter than 10 ms,
        the tolerance is smaller in proportion to its duration.
    events
        Whether contact openings and closings are found.

    Examples
    --------
    A millisecond of a key that is pressed by 5 N:

    >>> import feltmb
    >>> machine = feltmb.Machine("steinway45")
    >>> _ = machine.advance(1e-3, force=5.0)
    >>> round(machine.time, 6)
    0.001
    """

    def __init__(
        self,
        action: Action | str | Path,
        *,
        hold: Literal["zero", "linear"] = "zero",
        rtol: float = 1e-6,
        method: str = "auto",
        max_order: int | None = None,
        max_step: float | None = None,
        max_wall: float | None = None,
        events: bool = True,
    ):
        self._given = {
            "hold": hold,
            "rtol": rtol,
            "method": method,
            "max_order": max_order,
            "max_step": max_step,
            "max_wall": max_wall,
            "events": events,
        }
        check_options({"max_order": max_order, "max_step": max_step, "max_wall": max_wall})
        self.action = action if isinstance(action, Action) else load_action(action)
        self.hold = hold
        self._options: dict[str, Any] = {
            "rtol": rtol,
            "method": method,
            "max_order": max_order or 0,
            "max_step": max_step or 0.0,
            "max_wall": max_wall or 0.0,
            "events": events,
            "finger_reference": (
                math.nan
                if self.action.config.finger is None
                else _core.finger_place(self.action.mechanism, self.action.rest_pose)
            ),
            "monitors": start_monitors(self.action),
        }
        rules = self.action.config.events
        self._monitors = [name for name, rule in rules.items() if rule.point is not None]
        self._steppers: dict[str, _core.Stepper] = {}
        self._kind: Kind = "force"
        self._stepper = self._of("force")
        channels = self._stepper.channels
        #: Names of all channels, in the order of :attr:`values`.
        self.names: tuple[str, ...] = tuple(name for name, _, _ in channels)
        #: SI unit of each channel, by name.
        self.units: dict[str, str] = {name: unit for name, unit, _ in channels}
        #: Description of each channel, by name.
        self.texts: dict[str, str] = {name: text for name, _, text in channels}
        self._place = {name: i for i, name in enumerate(self.names)}

    def __repr__(self) -> str:
        return f"<Machine {self.action.name!r} at {self.time:g} s>"

    def __copy__(self) -> Self:
        """A separate machine in the same state, equal to the result of ``copy.deepcopy``."""
        other, own = self._in_this_state()
        other.__dict__.update(own)
        return other

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        other, own = self._in_this_state()
        memo[id(self)] = other
        other.__dict__.update(copy.deepcopy(own, memo))
        return other

    def _in_this_state(self) -> tuple[Self, dict[str, Any]]:
        """A machine of the same class and state, with the attributes that a subclass added."""
        other = object.__new__(type(self))
        Machine.__init__(other, self.action, **self._given)  # type: ignore[arg-type]
        Machine.restore(other, self.state())
        return other, {k: v for k, v in self.__dict__.items() if k not in other.__dict__}

    def __reduce__(self) -> Any:
        raise InvalidParameter(
            f"machine {self.action.name!r} cannot be pickled; pickle its state() and restore that "
            "in a machine of the other process"
        )

    def _of(self, kind: Kind) -> _core.Stepper:
        if kind not in self._steppers:
            self._steppers[kind] = _core.Stepper(self.action.mechanism, kind, **self._options)
        return self._steppers[kind]

    @property
    def time(self) -> float:
        """Time since the reset [s]."""
        return float(self._stepper.time)

    @property
    def values(self) -> npt.NDArray[np.float64]:
        """Present values of all channels, SI units, in the order of :attr:`names`."""
        return self._stepper.outputs()

    def reset(self, start: Mapping[str, float | str] | None = None) -> None:
        """Set the rest pose and time zero, and clear the memory of felts.

        Parameters
        ----------
        start
            Coordinates and speeds that differ from the rest pose, as in :func:`simulate`:
            ``{"hammer.angle": "5 deg", "hammer.angle.rate": 2.0}``.
        """
        values = initial_values(self.action, start or {})
        self._stepper.state = self._stepper.rest
        if values:
            state = self.state()
            y = np.array(state.y)
            y[list(values)] = list(values.values())
            self.restore(replace(state, y=y))

    def read(self, channel: str, unit: str | None = None) -> float:
        """Present value of a channel.

        Parameters
        ----------
        channel
            One of :attr:`names`, such as ``"hammer_tip.y"``.
        unit
            Unit of the result; default: SI, as in :attr:`units`.

        Raises
        ------
        InvalidParameter
            The channel does not exist, or it has another dimension.
        """
        if channel not in self._place:
            near = difflib.get_close_matches(channel, self.names, n=3)
            raise InvalidParameter(
                f"channel {channel!r} is unknown; "
                + (f"did you mean {' or '.join(near)}?" if near else "see Machine.names")
            )
        value = float(self.values[self._place[channel]])
        if unit is None:
            return value
        return value / conversion_factor(unit, self.units[channel])

    def state(self) -> MachineState:
        """The state that determines all following steps."""
        time, y, memory, kind, *drive = self._stepper.state
        return MachineState(time, y, np.asarray(memory), kind, tuple(drive), self.action.hash)

    def restore(self, state: MachineState, *, same_parts: bool = False) -> None:
        """Set a state of this mechanism.

        Parameters
        ----------
        same_parts
            Accept the state of another mechanism too. It must have the same parts in the same
            order; only the numbers of states and memories are checked. Forces may then jump at the
            start.

        Raises
        ------
        InvalidParameter
            The state belongs to another mechanism, or is damaged.
        """
        if not isinstance(state.kind, str) or state.kind not in UNITS:
            raise InvalidParameter(f"state: kind {state.kind!r} is none of {', '.join(UNITS)}")
        if state.mechanism not in ("", self.action.hash) and not same_parts:
            raise InvalidParameter(
                f"state: is of a mechanism with other numbers or parts than {self.action.name!r} "
                f"(hash {str(state.mechanism)[:12]}, expected {self.action.hash[:12]}); if only "
                "numbers differ: restore(state, same_parts=True)"
            )
        _, y, _, _, *drive = self._stepper.state
        contacts = len(self.action.mechanism.contact_numbers)
        values = (
            *_numbers("time", [state.time], 1),
            _numbers("y", state.y, len(y)),
            # Turning points of laws that have them follow, in pairs.
            _numbers("memory", state.memory, max(contacts, np.size(state.memory))),
            state.kind,
            *_numbers("drive", state.drive, len(drive)),
        )
        stepper = self._of(state.kind)
        stepper.state = values
        self._kind, self._stepper = state.kind, stepper

    def advance(
        self,
        dt: float,
        *,
        force: float | None = None,
        motion: float | None = None,
        key_motion: float | None = None,
        torque: float | None = None,
        motor_motion: float | None = None,
        speed: float | None = None,
    ) -> tuple[Change, ...]:
        """Advance by one step with one input.

        Parameters
        ----------
        dt
            Step [s], > 0.
        force
            Force of the finger on the key [N], positive pressing.
        motion
            Displacement of a finger that presses the key through its pad [m]; at zero, it just
            touches the key at rest.
        key_motion
            Displacement of the point under the finger from rest at the end of the step [m].
        torque
            Torque of the mechanism's motor [N m].
        motor_motion
            Angle of the hub of the motor from rest at the end of the step [rad].
        speed
            Speed of a ``key_motion`` [m/s] or ``motor_motion`` [rad/s] at the end of the step;
            default: from equally spaced values of the motion, with second order.

        Returns
        -------
        tuple of Change
            Contacts that opened or closed, and tracking points that reached their travel.

        Raises
        ------
        InvalidParameter
            No input or several inputs are given, the input is out of range, or the mechanism has no
            finger or motor for it.
        IntegrationError
            The solver stopped early; the machine is unchanged. ``error.partial`` is None.
        KeyboardInterrupt
            The user interrupted the step; the machine is unchanged.
        """
        inputs: dict[Kind, float | None] = {
            "force": force,
            "motion": motion,
            "key_motion": key_motion,
            "torque": torque,
            "motor_motion": motor_motion,
        }
        given = [(kind, value) for kind, value in inputs.items() if value is not None]
        if len(given) != 1:
            got = ", ".join(kind for kind, _ in given) or "none"
            raise InvalidParameter(f"advance: got {got}, expected one of {', '.join(UNITS)}")
        kind, value = given[0]
        if speed is not None and kind not in PRESCRIBED:
            raise InvalidParameter(
                f"advance: speed is given with {kind}; it belongs to {' or '.join(PRESCRIBED)}"
            )
        if not 0.0 < dt < math.inf:
            raise InvalidParameter(f"advance: dt = {dt:.6g} s, expected finite, > 0")
        resolution = math.ulp(max(self.time, 1.0))
        if dt < resolution:
            raise InvalidParameter(
                f"advance: dt = {dt:.6g} s is below the resolution of the time t = "
                f"{self.time:.9g} s, expected at least {resolution:.2g} s"
            )
        unit = UNITS[kind]
        if abs(value) > LARGEST[unit]:
            raise InvalidParameter(
                f"advance: {kind} = {value:.6g} {unit}, expected {LARGEST[unit]:g} at most"
            )
        if value != 0.0:
            refuse_kind(self.action, kind, f"advance: {kind} = {value:g} {unit}")
        if kind != self._kind:
            stepper = self._of(kind)
            stepper.state = self._stepper.state
            self._kind, self._stepper = kind, stepper
        status, code, message, state, contact, events, _ = self._stepper.advance(
            dt, value, math.nan if speed is None else speed, self.hold == "linear"
        )
        if status == "interrupted":
            raise KeyboardInterrupt(message)
        if status != "done":
            raise IntegrationError(
                f"step of {dt:g} s from t = {self.time:.9g} s with {kind} = {value:g} {unit}: "
                f"{message}",
                code=code,
                partial=None,
                time=self.time,
                state=state,
                contact=contact,
            )
        return tuple(list_changes(self.action, events, self._monitors)) if events else ()
