"""A mechanism step by step: for controllers, haptic devices, co-simulation, learning agents."""

from __future__ import annotations

import copy
import difflib
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
import numpy.typing as npt

from feltmb import _core
from feltmb.arguments import checked
from feltmb.errors import IntegrationError, InvalidParameter, shown
from feltmb.mechanism import Action, load_action
from feltmb.run.events import Change
from feltmb.run.options import check_options
from feltmb.run.simulate import list_changes, refuse_kind, start_monitors
from feltmb.run.stroke.strokes import LARGEST, PRESCRIBED, UNITS, Kind
from feltmb.units import conversion_factor

__all__ = ["Machine", "MachineState"]


@dataclass(frozen=True, eq=False)
class MachineState:
    """All that the steps of a machine to come depend on; can be kept, compared and pickled.

    Attributes
    ----------
    time : float
        Of the machine's clock [s]. No step depends on it.
    y : ndarray
        Coordinates, their rates, states of contact laws, modal coordinates of strings and their
        rates, as ``Run.end_state``.
    memory : ndarray
        Largest compression that each contact remembers [m].
    kind : str
        Kind of the last input.
    drive : tuple of float
        Its value, rate, acceleration and mean rate over the last step, SI.
    mechanism : str
        ``Action.hash`` of the mechanism that was in this state; empty: not known, not compared.
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
    """A field of a state as ``count`` real numbers; that they make sense is the core's to say."""
    try:
        found = np.asarray(given)
    except ValueError:  # rows of several lengths
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
    thread at a time may use a machine. A step releases the lock of the interpreter.

    Parameters
    ----------
    action
        Object, or name for :func:`load_action`.
    hold
        Course of a force, a torque or a finger's motion over a step: ``"zero"`` is the value given,
        ``"linear"`` a straight line from the value of the last step.
    rtol, method, max_order, max_step, max_wall
        As in :class:`RunOptions`; ``max_wall`` is that of one step.
    events
        Find contact openings and closings.
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
        #: Unit of each channel, SI, by name.
        self.units: dict[str, str] = {name: unit for name, unit, _ in channels}
        #: Text of each channel by name.
        self.texts: dict[str, str] = {name: text for name, _, text in channels}
        self._place = {name: i for i, name in enumerate(self.names)}

    def __repr__(self) -> str:
        return f"<Machine {self.action.name!r} at {self.time:g} s>"

    def __copy__(self) -> Self:
        """A machine of its own in the same state, as ``copy.deepcopy`` gives it too."""
        other, own = self._in_this_state()
        other.__dict__.update(own)
        return other

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        other, own = self._in_this_state()
        memo[id(self)] = other
        other.__dict__.update(copy.deepcopy(own, memo))
        return other

    def _in_this_state(self) -> tuple[Self, dict[str, Any]]:
        """A machine of the same class and state, and the attributes that a subclass added."""
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
        """All channels at this time, SI, in the order of :attr:`names`."""
        return self._stepper.outputs()

    def reset(self) -> None:
        """Set the rest pose and time zero, and reset the memory of felts."""
        self._stepper.state = self._stepper.rest

    def read(self, channel: str, unit: str | None = None) -> float:
        """Value of a channel at this time.

        Parameters
        ----------
        channel
            One of :attr:`names`, such as ``"hammer_tip.y"``.
        unit
            Default: SI, as in :attr:`units`.

        Raises
        ------
        InvalidParameter
            There is no such channel, or it has another dimension.
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
        """Go back, or over, to a state of this mechanism.

        Parameters
        ----------
        same_parts
            Take the state of another mechanism too. It must have the same parts in the same order;
            only the numbers of states and memories are checked. Forces begin with a jump then.

        Raises
        ------
        InvalidParameter
            The state is of another mechanism, or is damaged.
        """
        if not isinstance(state.kind, str) or state.kind not in UNITS:
            raise InvalidParameter(f"state: kind {state.kind!r} is none of {', '.join(UNITS)}")
        if state.mechanism not in ("", self.action.hash) and not same_parts:
            raise InvalidParameter(
                f"state: is of a mechanism with other numbers or parts than {self.action.name!r} "
                f"(hash {str(state.mechanism)[:12]}, expected {self.action.hash[:12]}); if only "
                "numbers differ: restore(state, same_parts=True)"
            )
        _, y, memory, _, *drive = self._stepper.state
        values = (
            *_numbers("time", [state.time], 1),
            _numbers("y", state.y, len(y)),
            _numbers("memory", state.memory, len(memory)),
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
        """Advance by a step under one input.

        Parameters
        ----------
        dt
            [s], > 0.
        force
            Of the finger on the key [N], positive pressing.
        motion
            Of a finger that meets the key through its pad [m]; zero just touches the key at rest.
        key_motion
            Of the point under the finger itself at the end of the step [m], from its rest.
        torque
            Of the mechanism's motor [N m].
        motor_motion
            Of its hub at the end of the step [rad], from its rest.
        speed
            Of a ``key_motion`` [m/s] or ``motor_motion`` [rad/s] at the end of the step; default:
            that of a motion which is sampled with equal steps, in second order.

        Returns
        -------
        tuple of Change
            Contacts that opened or closed, and tracking points that passed their travel.

        Raises
        ------
        InvalidParameter
            No input or more than one is given, it is out of range, or the mechanism has no finger
            or motor for it.
        IntegrationError
            The solver stopped early; the machine is where it was before the step. ``error.partial``
            is None.
        KeyboardInterrupt
            Interrupted by the user, likewise.
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
        status, message, state, contact, events, _ = self._stepper.advance(
            dt, value, math.nan if speed is None else speed, self.hold == "linear"
        )
        if status == "interrupted":
            raise KeyboardInterrupt(message)
        if status != "done":
            raise IntegrationError(
                f"step of {dt:g} s from t = {self.time:.9g} s with {kind} = {value:g} {unit}: "
                f"{message}",
                partial=None,
                time=self.time,
                state=state,
                contact=contact,
            )
        return tuple(list_changes(self.action, events, self._monitors)) if events else ()
