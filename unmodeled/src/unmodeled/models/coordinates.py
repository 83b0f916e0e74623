"""Coordinates of a user's model, and couplings between them: the places where forces may act."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from unmodeled.arguments import checked, unchecked
from unmodeled.data import Array
from unmodeled.errors import InvalidParameter
from unmodeled.units import same_unit, spelled_unit, to_si


def _turns(unit: str) -> bool:
    """Whether a force in this unit is a torque or an angular acceleration."""
    try:
        si = to_si(spelled_unit(unit) or unit)[1]
    except InvalidParameter:
        return False
    return si == "N m" or si.startswith("rad")


def force_unit(travel: str, inertia: object) -> str:
    """Unit of the forces on a coordinate: of accelerations, if its inertia is not known."""
    if inertia is None:
        return f"{travel}/s^2"
    return "N m" if same_unit(travel, "rad") else "N"


def has_si_forces(travel: str) -> bool:
    """Whether an inertia in SI times an acceleration is a force in SI: not for a travel in mm."""
    try:
        factor, si = to_si(travel)
    except InvalidParameter:
        return False
    return factor == 1.0 or same_unit(si, "rad")


@checked
class Named:
    """Values by name: ``x.q`` or ``x["q"]``; arrays with one entry per job, (B,)."""

    __slots__ = ("_values",)

    @unchecked
    def __init__(self, values: Mapping[str, Any]):
        self._values = values

    def __getitem__(self, name: str) -> Any:
        try:
            return self._values[name]
        except KeyError:
            raise KeyError(self._unknown(name)) from None

    def __getattr__(self, name: str) -> Any:
        try:
            return self._values[name]
        except KeyError:
            raise AttributeError(self._unknown(name)) from None

    def _unknown(self, name: object) -> str:
        return f"no {name!r}; known are {', '.join(self._values)}"

    def __contains__(self, name: object) -> bool:
        return name in self._values


def values_of(named: Named) -> Mapping[str, Any]:
    """The values of ``named`` by name; no attribute of it, because a value may have any name."""
    return named._values


@checked
@dataclass(frozen=True)
class Rate:
    """An output that is the rate of a state, for example an acceleration: the rate of a speed.

    It includes effects and unknown forces, unlike a function of the states.
    """

    state: str


@checked
@dataclass(frozen=True, kw_only=True)
class Coordinate:
    """A coordinate of a mechanical system, on which generic effects act.

    A force F [unit] on it changes its acceleration by F / inertia.

    Examples
    --------
    A slider of 2 kg, whose position [m] and speed [m/s] are states:

    >>> from unmodeled import Coordinate
    >>> slider = Coordinate(name="slider", position="x", speed="v", inertia=2.0)
    >>> slider.unit
    'N'
    """

    name: str
    position: str = ""
    """State that is the position; empty: the model has only the speed, as for a motor, and only
    laws of the speed act."""
    speed: str
    """State that is the speed."""
    inertia: str | float | Callable[[Any, Named, Named, Named], Array] | None = None
    """Name of a parameter, a number, or a function (t, x, u, p) -> (B,). None: forces on it are
    accelerations, which is told unless ``unit`` is one."""
    unit: str = "N"
    scale: float = 1.0
    """Typical force on the coordinate [unit]."""
    position_unit: str = ""
    """Unit of the travel; default: rad if the force is a torque or an angular acceleration, else
    m."""

    @property
    def travel_unit(self) -> str:
        """Unit of the travel."""
        return self.position_unit or ("rad" if _turns(self.unit) else "m")

    @property
    def parts(self) -> tuple[Coordinate, ...]:
        """The coordinates that it consists of: only itself."""
        return (self,)

    @unchecked
    def motion(self, x: Named) -> tuple[Any, Any]:
        """Position and speed; the position is None if the model has none."""
        return x[self.position] if self.position else None, x[self.speed]

    @unchecked
    def push(self, force: Any, t: Any, x: Named, u: Named, p: Named) -> dict[str, Any]:
        """Rates of the states that a force causes, by name of the state.

        Parameters
        ----------
        force
            Force on the coordinate [N or N m].
        t
            Time [s].
        x
            States by name.
        u
            Inputs by name.
        p
            Parameters by name.
        """
        return {self.speed: self._acceleration(force, t, x, u, p)}

    def _acceleration(self, force: Any, t: Any, x: Named, u: Named, p: Named) -> Any:
        if isinstance(self.inertia, str):
            return force / p[self.inertia]
        if callable(self.inertia):
            return force / self.inertia(t, x, u, p)
        return force if self.inertia is None else force / self.inertia

    @property
    def without_inertia(self) -> str:
        """Sentence about forces that are accelerations; "" if the inertia or ``unit`` is told."""
        unit = f"{self.travel_unit}/s^2"
        if self.inertia is not None or same_unit(self.unit, unit):
            return ""
        return (
            f"coordinate {self.name} has no inertia: its forces in {self.unit} are accelerations "
            f"in {unit}, forces divided by the inertia; give inertia=, or unit={unit!r}"
        )


@checked
@dataclass(frozen=True, kw_only=True)
class Coupling:
    """A spring, gear or joint between two coordinates, on which generic effects act.

    Its position is that of the first coordinate minus ``ratio`` times that of the second; its speed
    follows in the same way. A force F on the coupling acts as F on the first coordinate and as
    -ratio F on the second.

    Examples
    --------
    A shaft between motor and load, with a gear of 10 to 1:

    >>> from unmodeled import Coordinate, Coupling
    >>> motor = Coordinate(name="motor", position="a", speed="va", inertia=1e-4, unit="N m")
    >>> load = Coordinate(name="load", position="b", speed="vb", inertia=1e-2, unit="N m")
    >>> Coupling(name="shaft", first=motor, second=load, ratio=10.0, unit="N m").ratio
    10.0
    """

    name: str
    first: Coordinate
    second: Coordinate
    ratio: float = 1.0
    """Displacement of the first coordinate per displacement of the second."""
    unit: str = "N"
    scale: float = 1.0
    """Typical force in the coupling [unit]."""
    position: str = ""
    """State that is its position, such as the twist of a shaft; empty: the position follows from
    those of the coordinates."""
    position_scale: float = 1.0
    """Position per value of this state: 1 / stiffness for a state that is the force of a spring."""
    speed: str = ""
    """Empty: no state is its speed."""
    found: bool = False
    """Whether it was found in a model that does not state it, and its name tells what it joins."""

    @property
    def travel_unit(self) -> str:
        """Unit of its position, equal to that of the first coordinate."""
        return self.first.travel_unit

    @property
    def parts(self) -> tuple[Coordinate, ...]:
        """The coordinates that it consists of."""
        return self.first, self.second

    @unchecked
    def motion(self, x: Named) -> tuple[Any, Any]:
        """Position and speed; the position is None if the model has none."""
        (q, v), (r, w) = self.first.motion(x), self.second.motion(x)
        if self.position:
            q = self.position_scale * x[self.position]
        elif q is not None:
            q = None if r is None else q - self.ratio * r
        return q, v - self.ratio * w

    @unchecked
    def push(self, force: Any, t: Any, x: Named, u: Named, p: Named) -> dict[str, Any]:
        """Rates of the states that a force causes, by name of the state.

        Parameters
        ----------
        force
            Force between the two coordinates [N or N m].
        t
            Time [s].
        x
            States by name.
        u
            Inputs by name.
        p
            Parameters by name.
        """
        return {
            **self.first.push(force, t, x, u, p),
            **self.second.push(-self.ratio * force, t, x, u, p),
        }
