"""Data and simulation of the key actuator.

Thesis chapter 5: a motor turns a hub with a flexible arm. The tip mass at the end of the arm
presses the key, and the felt stop below the key stops it. Pressing is positive in all quantities.
"""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field, ValidationError

from feltmb import _core, params
from feltmb.errors import IntegrationError
from feltmb.mechanism import (
    LawChoice,
    Source,
    apply_values,
    core_law,
    load_raw,
    missing_law_faults,
    plain_data,
    spread_laws,
)
from feltmb.quantities import SI
from feltmb.run.stroke import Stroke, table_stroke, torque_stroke
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter, no_such, shortened
from unmodeled.files import write_file
from unmodeled.files.netcdf import Variable, encode
from unmodeled.units import conversion_factor
from unmodeled.units.quantity import Schema, fault_lines, fault_text

if TYPE_CHECKING:
    Array = npt.NDArray[np.float64]

#: Coefficients of the dampers in thesis sections 5.2.2 and 5.2.3 [N m s/rad].
DAMPING = {"none": 0.0, "dashpot": 0.0075, "one_sided": 0.05}


# --- the file ------------------------------------------------------------------------------------


class Hub(Schema):
    """Rigid hub on the motor's axis."""

    inertia: Annotated[float, SI("kg m^2"), Field(gt=0)]
    radius: Annotated[float, SI("m"), Field(ge=0)]


class Section(Schema):
    """A section of the arm with constant cross section."""

    length: Annotated[float, SI("m"), Field(gt=0)]
    density: Annotated[float, SI("kg/m^3"), Field(gt=0)]
    area: Annotated[float, SI("m^2"), Field(gt=0)]
    young_modulus: Annotated[float, SI("Pa"), Field(gt=0)]
    second_moment: Annotated[float, SI("m^4"), Field(gt=0)]


class Arm(Schema):
    """Uniform arm, or its sections from the hub outward."""

    note: str = ""
    elements: Annotated[int, Field(ge=1, le=200)] = 10
    printed_shapes: bool = False
    length: Annotated[float, SI("m"), Field(gt=0)] | None = None
    density: Annotated[float, SI("kg/m^3"), Field(gt=0)] | None = None
    area: Annotated[float, SI("m^2"), Field(gt=0)] | None = None
    young_modulus: Annotated[float, SI("Pa"), Field(gt=0)] | None = None
    second_moment: Annotated[float, SI("m^4"), Field(gt=0)] | None = None
    sections: dict[str, Section] = Field(default_factory=dict)

    def stretches(self) -> list[Section]:
        """Sections of the arm, from the hub outward."""
        if self.sections:
            return list(self.sections.values())
        return [Section(**{name: getattr(self, name) for name in _STRETCH})]


_STRETCH = tuple(Section.model_fields)


class Tip(Schema):
    """Tip mass at the end of the arm."""

    mass: Annotated[float, SI("kg"), Field(ge=0)]
    eccentricity: Annotated[float, SI("m"), Field(ge=0)] = 0.0
    placement: Literal["across", "along"] = "across"


class Stop(LawChoice):
    """Felt stop under the key."""

    note: str = ""
    enabled: bool = True
    gap: Annotated[float, SI("m"), Field(ge=0)]


class Damper(Schema):
    """Grounded damper on the hub."""

    kind: Literal["none", "dashpot", "one_sided"] = "none"
    coefficient: Annotated[float, SI("N m s/rad"), Field(ge=0)] = 0.0


class Series(Schema):
    """A quantity as a function of time."""

    note: str = ""
    time: list[float]
    value: list[float]
    unit: Annotated[list[str], Field(min_length=2, max_length=2)]
    interpolation: Literal["linear", "monotone", "spline"] = "linear"


class ActionForce(Series):
    """Measured force between tip and key as a function of time, by which the action resists."""

    unit: Annotated[list[str], Field(min_length=2, max_length=2)] = Field(
        default_factory=lambda: ["s", "N"]
    )


class Reaction(Schema):
    """Equivalent reaction of the action (thesis section 5.1.1): a mass, a force, or both."""

    note: str = ""
    mass: Annotated[float, SI("kg"), Field(ge=0)] = 0.0
    force: ActionForce | None = None


class Torque(Series):
    """Torque of the motor as a function of time."""

    unit: Annotated[list[str], Field(min_length=2, max_length=2)] = Field(
        default_factory=lambda: ["s", "N m"]
    )


class Mount(Schema):
    """Position of the actuator above a key; see :func:`compose`."""

    note: str = ""
    pad: str = "pulp"
    pads: dict[str, LawChoice] = Field(default_factory=dict)
    finger_height: Annotated[float, SI("m"), Field(gt=0)] = 0.015
    finger_radius: Annotated[float, SI("m"), Field(gt=0)] = 0.005
    shapes: Annotated[int, Field(ge=1, le=8)] = 2
    damping_time: Annotated[float, SI("s"), Field(ge=0)] = 0.0


class ActuatorFile(Schema):
    """An actuator file."""

    schema_version: Annotated[Literal[1], Field(alias="schema")]
    name: str
    about: str = ""
    source: Source = Source()
    gravity: Annotated[float, SI("m/s^2")] = 9.81
    linear_gravity: bool = False
    hub: Hub
    arm: Arm
    tip: Tip
    stop: Stop | None = None
    damper: Damper = Damper()
    action: Reaction = Reaction()
    torque: Torque
    mount: Mount | None = None


def _resolve(name_or_path: str | Path) -> Path:
    return params.find(name_or_path, "actuators", "actuator")


@checked
def load_actuator(name_or_path: str | Path) -> Actuator:
    """Read an actuator: ``wood``, ``aluminum``, or the path of a TOML file.

    Raises
    ------
    InvalidParameter
        The file has faults; all of them are in the message.

    Examples
    --------
    The reach [m] of a packaged actuator:

    >>> from feltmb import actuator
    >>> wood = actuator.load_actuator("wood")
    >>> round(wood.reach, 3)
    0.102
    """
    path = _resolve(name_or_path)
    return Actuator(load_raw(path, _resolve), origin=path.name)


def _spread(raw: dict[str, Any], faults: list[str]) -> dict[str, Any]:
    """The table of the stop; ``law = { name = ... }`` is converted to the form of the schema."""
    if not isinstance(raw.get("stop"), Mapping):
        return raw
    found: list[str] = []
    spread = spread_laws({"contacts": {"stop": raw["stop"]}}, found)
    faults += [line.removeprefix("contacts.") for line in found]
    return {**raw, "stop": spread["contacts"]["stop"]}


def _faults(raw: Mapping[str, Any]) -> list[str]:
    faults = []
    arm = raw.get("arm")
    if isinstance(arm, Mapping):
        given = [name for name in _STRETCH if name in arm]
        if arm.get("sections") and given:
            faults.append(f"arm: has sections and {', '.join(given)}; give one of both")
        elif not arm.get("sections"):
            faults += [f"arm.{name}: is missing" for name in _STRETCH if name not in arm]
    stop = raw.get("stop")
    if isinstance(stop, Mapping):
        faults += missing_law_faults(stop, "stop")
    mount = raw.get("mount")
    pads = mount.get("pads", {}) if isinstance(mount, Mapping) else {}
    if not isinstance(mount, Mapping) or not isinstance(pads, Mapping):
        return faults  # the type check reports entries that are not tables
    for name, pad in pads.items():
        if isinstance(pad, Mapping):
            faults += missing_law_faults(pad, f"mount.pads.{name}")
    chosen = mount.get("pad", "pulp")
    if isinstance(chosen, str) and chosen not in pads:
        known = shortened(", ".join(pads)) or "none"
        faults.append(f"mount.pad: got {shortened(repr(chosen))}; pads are {known}")
    return faults


# --- the public object ---------------------------------------------------------------------------


@checked
class Actuator:
    """An actuator, read from data. It is immutable and safe to share between threads.

    Parameters
    ----------
    raw
        The tables of an actuator file.
    origin
        Name in messages, usually the name of the file.
    """

    def __init__(self, raw: Mapping[str, Any], origin: str = "actuator"):
        self._raw: dict[str, Any] = plain_data(raw)
        self.origin = origin
        faults: list[str] = []
        spread = _spread(self._raw, faults)
        try:
            self.config = ActuatorFile.model_validate(spread)
        except ValidationError as error:
            faults += fault_lines(error, ActuatorFile)
        faults += _faults(spread)
        if faults:
            raise InvalidParameter(fault_text(origin, list(dict.fromkeys(faults))))
        try:
            self.torque = _torque(self.config.torque)
            self._core = _core.Actuator(self._describe())
        except InvalidParameter as error:
            raise InvalidParameter(f"{origin}: {error}") from None

    def __repr__(self) -> str:
        kind = self.config.damper.kind
        return f"Actuator({self.name!r}, {self.config.arm.elements} elements, damper {kind})"

    def __reduce__(self) -> tuple[Any, ...]:
        return (Actuator, (self._raw, self.origin))

    def _describe(self) -> _core.ActuatorDescription:
        c = self.config
        d = _core.ActuatorDescription()
        d.arm = self._describe_arm()
        d.gravity = c.gravity
        d.linear_gravity = c.linear_gravity
        if c.stop is not None and c.stop.enabled:
            d.gap = c.stop.gap
            d.stop = core_law(c.stop)
        d.damper = getattr(_core.DamperKind, c.damper.kind)
        d.damping = c.damper.coefficient
        d.action_mass = c.action.mass
        if c.action.force is not None:
            d.action_force = _action_force(c.action.force).profile
        return d

    def _describe_arm(self) -> _core.HubBeamDescription:
        c = self.config
        d = _core.HubBeamDescription()
        d.hub_radius = c.hub.radius
        d.hub_inertia = c.hub.inertia
        d.sections = [_core.ArmSection(**s.model_dump()) for s in c.arm.stretches()]
        d.tip_mass = c.tip.mass
        d.eccentricity = c.tip.eccentricity
        d.tip = getattr(_core.TipPlacement, c.tip.placement)
        d.elements = c.arm.elements
        d.printed_shapes = c.arm.printed_shapes
        return d

    @property
    def name(self) -> str:
        """Name of the data set."""
        return self.config.name

    @property
    def raw(self) -> dict[str, Any]:
        """Copy of the tables of the file, with units and sources."""
        return copy.deepcopy(self._raw)

    @property
    def reach(self) -> float:
        """Distance from the axis to the end of the arm, a + L [m]."""
        return float(self._core.beam.reach)

    @property
    def rigid_inertia(self) -> float:
        """Moment of inertia about the axis if the arm is rigid [kg m^2]."""
        return float(self._core.beam.rigid_inertia)

    @cached_property
    def matrices(self) -> tuple[Array, Array]:
        """M and K of thesis eq. 5.17 for [theta, w_1, theta_1, ..., w_N, theta_N], SI units."""
        return np.asarray(self._core.beam.mass), np.asarray(self._core.beam.stiffness)

    def frequencies(self, count: int = 4, *, clamped: bool = False) -> Array:
        """Lowest natural frequencies of the elastic arm [Hz], with the hub free or ``clamped``."""
        return np.asarray(self._core.beam.frequencies(count, clamped))

    def with_values(self, values: Mapping[str, Any]) -> Actuator:
        """Copy with other values by dotted path, such as ``{"arm.young_modulus": 5e9}``.

        A number without a unit is in SI units; see ``Action.with_values``.
        """
        return Actuator(apply_values(self._raw, values, "with_values"), self.origin)

    def with_damper(self, kind: str, coefficient: float | None = None) -> Actuator:
        """Copy with a damper ``none``, ``dashpot`` or ``one_sided``.

        Parameters
        ----------
        coefficient
            c [N m s/rad], >= 0; default: the value of the thesis, 0.0075 (dashpot), 0.05
            (one-sided).
        """
        kind = kind.replace("-", "_")
        if kind not in DAMPING:
            raise InvalidParameter(f"damper {kind!r} is none of {', '.join(DAMPING)}")
        if kind == "none" and coefficient:
            raise InvalidParameter(f"damper none takes no coefficient; got {coefficient:g}")
        value = DAMPING[kind] if coefficient is None else coefficient
        return self.with_values(
            {"damper": {"kind": kind, "coefficient": {"value": value, "unit": "N m s/rad"}}}
        )

    def with_action(self, force: Stroke) -> Actuator:
        """Copy whose tip acts against a measured force of the action instead of its mass.

        Thesis section 5.1.1: the force between tip and key, measured with the same torque. It acts
        against pressing, at the times of the record; it is constant before and after the record.
        When the key reaches its felt, the stop carries the tip. From there on, the record should
        only contain the force of the action, which is negligible, and not the force of the stop.

        Parameters
        ----------
        force
            A stroke of kind ``force``, positive against pressing, such as
            ``read_stroke_csv("measured.csv")``.
        """
        if force.kind != "force":
            raise InvalidParameter(
                f"stroke {force.name!r} is a {force.kind}; the action answers with a force"
            )
        if force.oscillation_amplitude:
            raise InvalidParameter(f"stroke {force.name!r} oscillates; give its force as a table")
        table = {
            "note": f"force of the action: {force.name}",
            "time": list(force.time),
            "value": list(force.value),
            "interpolation": force.interpolation,
        }
        raw = self.raw
        raw["action"] = {"mass": {"value": 0.0, "unit": "kg"}, "force": table}
        return Actuator(raw, self.origin)

    def to_toml(self) -> str:
        """Text of a file that defines this actuator."""
        import tomlkit

        return tomlkit.dumps(self._raw)


def _torque(t: Torque) -> Stroke:
    time = conversion_factor(t.unit[0], "s")
    value = conversion_factor(t.unit[1], "N m")
    return torque_stroke(
        [x * time for x in t.time],
        [x * value for x in t.value],
        interpolation=t.interpolation,
        name="torque of the file",
    )


def _action_force(t: ActionForce) -> Stroke:
    time = conversion_factor(t.unit[0], "s")
    value = conversion_factor(t.unit[1], "N")
    return table_stroke(
        [x * time for x in t.time],
        [x * value for x in t.value],
        interpolation=t.interpolation,
        name="action.force",
    )


# --- simulation ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class ActuatorRun:
    """Outputs of a run as functions of time; ``run["finger.force"]``.

    Attributes
    ----------
    time
        Times [s], evenly spaced.
    names, units, long_names
        Names, units and descriptions of the outputs, i.e. of the columns of ``values``.
    events
        Events of the stop: tuples (time [s], closes, rate [m/s]).
    summary
        SI units: ``first_contact_time``, ``peak_stop_force`` and its ``..._time``,
        ``peak_finger_force``, ``bounces`` (closings after the first), ``ringing`` (rms of the
        finger force about its mean in the last quarter) and ``deflection`` (largest of the tip).
    energy
        ``work_motor``, ``work_gravity``, ``given_to_action``, stored and dissipated energies at the
        end [J]; ``residual_relative``: the largest imbalance relative to the largest of supplied
        work, stored energy and losses.
    stats
        Work counts of the stepper and the wall time [s].
    """

    time: Array
    names: tuple[str, ...]
    units: tuple[str, ...]
    long_names: tuple[str, ...]
    values: Array
    events: tuple[tuple[float, bool, float], ...]
    summary: dict[str, float]
    energy: dict[str, float]
    stats: dict[str, Any]
    provenance: dict[str, Any] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Array:
        if name not in self.names:
            raise no_such("output", name, self.names)
        return self.values[:, self.names.index(name)]

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __contains__(self, name: object) -> bool:
        return name in self.names

    def _variables(self) -> list[Variable]:
        rows = zip(self.names, self.units, self.long_names, strict=True)
        return [
            Variable("time", ("time",), self.time, "s", "time"),
            *(
                Variable(name, ("time",), self.values[:, i], unit, text)
                for i, (name, unit, text) in enumerate(rows)
            ),
        ]

    def _attributes(self) -> dict[str, str | int]:
        return {
            key: json.dumps(value, sort_keys=True)
            for key, value in (
                ("provenance", self.provenance),
                ("summary", self.summary),
                ("energy", self.energy),
            )
        }

    @checked
    def save(self, path: str | Path, *, force: bool = False) -> Path:
        """Write a NetCDF file (``.nc``) or a CSV table."""
        path = Path(path)
        if path.suffix == ".nc":
            # HDF5 fails badly on a full disk: the file is made in memory and written as bytes.
            content = encode(self._variables(), self._attributes())

            def write(target: Path) -> None:
                target.write_bytes(content)

            return write_file(path, write, force=force)
        if path.suffix != ".csv":
            raise InvalidParameter(f"{path}: expected the name of a .nc or .csv file")
        head = ",".join(
            ["time [s]", *(f"{n} [{u}]" for n, u in zip(self.names, self.units, strict=True))]
        )
        table = np.column_stack([self.time, self.values])
        return write_file(
            path,
            lambda p: np.savetxt(p, table, fmt="%.9g", delimiter=",", header=head, comments=""),
            force=force,
        )


@checked
def simulate_actuator(
    actuator: Actuator | str,
    torque: Stroke | None = None,
    duration: float = 0.2,
    *,
    output_rate: float = 10_000.0,
    tolerance: float = 3e-5,
) -> ActuatorRun:
    """Simulate an actuator from rest, with a straight arm.

    Parameters
    ----------
    actuator
        Actuator, or a name for :func:`load_actuator`.
    torque
        Torque stroke; default: the torque of the file.
    duration
        Duration [s], > 0.
    output_rate
        Sample rate of the outputs [Hz].
    tolerance
        Largest error of a force within a step relative to the largest force, in (0, 0.1]. The modes
        of the arm are integrated exactly. The default keeps the error of undamped runs below 1e-3
        of the largest force (docs/explanation/actuator.md).

    Raises
    ------
    InvalidParameter
        An argument is out of range.
    IntegrationError
        The energy balance error exceeds a tenth of the exchanged energy; ``error.partial`` is the
        run.

    Examples
    --------
    Two milliseconds without a torque:

    >>> from feltmb import actuator
    >>> run = actuator.simulate_actuator("wood", duration=0.002)
    >>> run.time.size
    21
    """
    if isinstance(actuator, str):
        actuator = load_actuator(actuator)
    stroke = actuator.torque if torque is None else torque
    if stroke.kind != "torque":
        raise InvalidParameter(
            f"stroke {stroke.name!r} is a {stroke.kind}; the actuator takes a torque"
        )
    out = actuator._core.simulate(
        stroke.profile, float(duration), float(output_rate), float(tolerance)
    )
    columns = dict(zip(out["names"], out["data"].T, strict=True))
    events = tuple((t, direction > 0, rate) for t, direction, rate in out["events"])
    energy = _energy(columns)
    run = ActuatorRun(
        time=out["time"],
        names=tuple(out["names"]),
        units=tuple(out["units"]),
        long_names=tuple(out["long_names"]),
        values=out["data"],
        events=events,
        summary=_summary(out, columns, events),
        energy=energy,
        stats={
            **out["counts"],
            "wall": out["wall"],
            "warnings": _warnings(actuator, columns, energy),
        },
        provenance={
            "feltmb": "actuator run",
            "version": _core.__version__,
            "actuator": actuator.name,
            "toml": actuator.to_toml(),
            "torque": stroke.as_dict(),
        },
    )
    limit = _core.SimulationOptions().ledger_limit
    if energy["residual_relative"] > limit:
        raise IntegrationError(
            f"actuator: the energy balance error is {energy['residual_relative']:.1%} of the "
            f"exchanged energy, expected at most {limit:.0%}; use a smaller tolerance",
            code="energy_balance",
            partial=run,
            time=float(run.time[-1]),
            state="",
            contact="",
        )
    return run


def _summary(
    out: Mapping[str, Any],
    columns: Mapping[str, Array],
    events: tuple[tuple[float, bool, float], ...],
) -> dict[str, float]:
    finger = columns["finger.force"]
    last = finger[3 * finger.size // 4 :]
    summary = {
        # The narrow peak of the stop force between samples is known exactly.
        "peak_finger_force": max(float(np.max(finger)), float(out["peak_force"])),
        "deflection": float(np.max(np.abs(columns["tip.deflection"]))),
        "ringing": float(np.std(last)),
        "mean_finger_force": float(np.mean(last)),
    }
    closings = [e for e in events if e[1]]
    if closings:
        summary["first_contact_time"] = closings[0][0]
        summary["first_contact_speed"] = closings[0][2]
        summary["bounces"] = float(len(closings) - 1)
        summary["peak_stop_force"] = out["peak_force"]
        summary["peak_stop_force_time"] = out["peak_time"]
    return summary


def _warnings(
    actuator: Actuator, columns: Mapping[str, Array], energy: Mapping[str, float]
) -> list[str]:
    """Warnings if a run is outside the range of validity of its equations."""
    found = []
    force = columns["finger.force"]
    if force.min() < -0.02 * max(force.max(), 1e-3):
        found.append(
            f"the finger pulls with {-force.min():.3g} N: the reaction of the action is two-sided "
            "(a positive torque turns the arm toward the stop)"
        )
    turned = float(np.max(np.abs(columns["hub.angle"])))
    if turned > math.pi / 4:
        found.append(f"the hub turns by {degrees(np.array(turned)):.0f} degrees")
    length = sum(s.length for s in actuator.config.arm.stretches())
    bent = float(np.max(np.abs(columns["tip.deflection"])))
    if bent > 0.25 * length:
        found.append(
            f"the arm bends by {1e3 * bent:.3g} mm of its {1e3 * length:.3g} mm: "
            "deflections are taken as small"
        )
    if energy["residual_relative"] > 1e-3:
        found.append(f"the energy balance error is {energy['residual_relative']:.1%}")
    return found


def _energy(columns: Mapping[str, Array]) -> dict[str, float]:
    stored = {name: columns[f"energy.{name}"] for name in ("kinetic", "elastic", "stop")}
    work_in = columns["work.motor"] + columns["work.gravity"]
    lost = columns["dissipated.stop"] + columns["dissipated.damper"] + columns["work.action"]
    residual = work_in - lost - (sum(stored.values()) - sum(s[0] for s in stored.values()))
    most = float(max(np.max(np.abs(x)) for x in (work_in, sum(stored.values()), lost)))
    return {
        "work_motor": float(columns["work.motor"][-1]),
        "work_gravity": float(columns["work.gravity"][-1]),
        "given_to_action": float(columns["work.action"][-1]),
        **{name: float(values[-1]) for name, values in stored.items()},
        "dissipated_stop": float(columns["dissipated.stop"][-1]),
        "dissipated_damper": float(columns["dissipated.damper"][-1]),
        "residual_relative": float(np.max(np.abs(residual))) / most if most > 0 else 0.0,
    }


def degrees(values: Array) -> Array:
    """Angles as text [deg]."""
    return values * (180.0 / math.pi)
