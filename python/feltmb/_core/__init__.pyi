"""
C++ core of feltmb. Use the package feltmb; names here may change.
"""

from __future__ import annotations

import collections.abc
import typing

import numpy
import numpy.typing

from . import fiber

__all__: list[str] = [
    "Actuator",
    "ActuatorDescription",
    "ArmSection",
    "BatchStroke",
    "BeamDescription",
    "BodyDescription",
    "CircleOnLayer",
    "ConstantArea",
    "ContactDescription",
    "ContactLaw",
    "CrossedCylinders",
    "DamperKind",
    "DashpotDescription",
    "Envelope",
    "ExponentialCurve",
    "FeltLayer",
    "FeltMaterial",
    "FingerDescription",
    "Friction",
    "HubBeam",
    "HubBeamDescription",
    "InputSignal",
    "Interpolation",
    "JointKind",
    "LawPath",
    "LayerColumns",
    "Mechanism",
    "MechanismDescription",
    "ModalString",
    "Monitor",
    "MotorDescription",
    "Perturbed",
    "Profile",
    "RunResult",
    "SensitivityEvent",
    "SensitivityRequest",
    "SensitivityValue",
    "SensitivityOptions",
    "SensitivityParameter",
    "SensitivityResult",
    "SensitivitySegment",
    "ShapeSet",
    "SimulationOptions",
    "SphereOnLayer",
    "Stepper",
    "StopFlag",
    "StrapDescription",
    "StringDescription",
    "StringParameters",
    "SurfaceDescription",
    "SurfaceKind",
    "TipPlacement",
    "TorsionSpringDescription",
    "TrackingPointDescription",
    "assemble",
    "body_poses",
    "contact_laws",
    "description_numbers",
    "evaluate",
    "fiber",
    "find_equilibrium",
    "finger_place",
    "force_along",
    "jacobian_blocks",
    "jacobian_check",
    "law_numbers",
    "layer_envelope",
    "move_through",
    "observables",
    "point_position",
    "pressure_envelope",
    "read_description",
    "rhs",
    "sensitivities",
    "simulate",
    "simulate_many",
    "state_names",
    "tolerance_for",
    "write_description",
    "write_law",
]

class Friction:
    @staticmethod
    def field_names() -> list[str]:
        """
        Names of all fields.
        """
    @staticmethod
    def number_fields() -> list:
        """
        Name, kind, unit, meaning, limits and default of the fields that are numbers.
        """
    def __init__(self, **kwargs: typing.Any) -> None:
        """
        From its fields, SI; what is not given keeps its default.
        """
    def coefficient(
        self, speed: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]
    ) -> typing.Any:
        """
        Sum of all terms at sliding speed [m/s or rad/s].
        """
    def dry(self) -> Friction:
        """
        The terms that hold a joint back at speeds near zero, alone.
        """
    def sharpened(self, threshold_speed: typing.SupportsFloat | typing.SupportsIndex) -> Friction:
        """
        The limit of a threshold speed of zero, regularized at a chosen speed.
        """
    @property
    def acts(self) -> bool:
        """
        Whether a term is there.
        """
    @property
    def amplitude(self) -> float: ...
    @amplitude.setter
    def amplitude(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def b1(self) -> float: ...
    @b1.setter
    def b1(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def b2(self) -> float: ...
    @b2.setter
    def b2(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def dry_speeds(self) -> tuple[float, float]:
        """
        Speeds between which the dry terms rise and die away; infinite: they do not.
        """
    @property
    def quadratic(self) -> float: ...
    @quadratic.setter
    def quadratic(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def stribeck(self) -> float: ...
    @stribeck.setter
    def stribeck(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def stribeck_speed(self) -> float: ...
    @stribeck_speed.setter
    def stribeck_speed(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def threshold_speed(self) -> float: ...
    @threshold_speed.setter
    def threshold_speed(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def turns_over(self) -> bool:
        """
        Whether a term that acts turns over near the threshold speed.
        """
    @property
    def viscous(self) -> float: ...
    @viscous.setter
    def viscous(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...

class ExponentialCurve:
    def __init__(
        self,
        a: typing.SupportsFloat | typing.SupportsIndex,
        b: typing.SupportsFloat | typing.SupportsIndex,
        c: typing.SupportsFloat | typing.SupportsIndex,
    ) -> None: ...
    def force(
        self, compression: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]
    ) -> typing.Any:
        """
        Force [N] of thesis eq. 4.21 at compression [m].
        """
    @property
    def a(self) -> float: ...
    @property
    def b(self) -> float: ...
    @property
    def c(self) -> float: ...

class Envelope:
    @staticmethod
    def from_curves(
        loading: ExponentialCurve,
        unloading: ExponentialCurve,
        closing: typing.SupportsFloat | typing.SupportsIndex = 0.0,
    ) -> Envelope: ...
    @staticmethod
    def from_table(
        compression: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex],
        loading: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex],
        unloading: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex],
    ) -> Envelope: ...
    def loading(
        self, compression: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]
    ) -> typing.Any:
        """
        Virgin loading force [N].
        """
    def loading_energy(
        self, compression: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]
    ) -> typing.Any:
        """
        Work [J] of a virgin loading to compression [m].
        """
    def loop_area(
        self, largest: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]
    ) -> typing.Any:
        """
        Energy lost [J] in the cycle to `largest` [m].
        """
    def unloading(
        self,
        compression: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
        largest: typing.SupportsFloat | typing.SupportsIndex,
    ) -> typing.Any:
        """
        Unloading force [N] of the cycle to the compression `largest` [m].
        """
    def unloading_energy(
        self,
        compression: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
        largest: typing.SupportsFloat | typing.SupportsIndex,
    ) -> typing.Any:
        """
        Work [J] that the cycle to `largest` [m] gives back from compression [m].
        """
    @property
    def closing(self) -> float:
        """
        Compression e_M [m].
        """
    @property
    def repair(self) -> tuple[float, float, float]:
        """
        Largest change [N] of the unloading force that made its shape monotone, from and to [m]; zeros if none.
        """

class ContactLaw:
    def __init__(self, name: str, **kwargs: typing.Any) -> None:
        """
        A contact law by its name and the fields of contact_laws(), SI.
        """
    def evaluate(
        self,
        compression: typing.SupportsFloat | typing.SupportsIndex,
        rate: typing.SupportsFloat | typing.SupportsIndex,
        state: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex],
        largest: typing.SupportsFloat | typing.SupportsIndex,
    ) -> dict:
        """
        Force, slopes, state rates and powers at one point, as a dict.
        """
    def force(
        self,
        compression: typing.Annotated[numpy.typing.ArrayLike, numpy.float64],
        rate: typing.Annotated[numpy.typing.ArrayLike, numpy.float64] = 0.0,
        state: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex] = [],
        largest: typing.SupportsFloat | typing.SupportsIndex = 0.0,
    ) -> typing.Any:
        """
        Normal force [N] at compression [m] and compression rate [m/s].
        """
    def slopes(
        self,
        compression: typing.SupportsFloat | typing.SupportsIndex,
        rate: typing.SupportsFloat | typing.SupportsIndex = 0.0,
    ) -> tuple[float, float]:
        """
        dF/de [N/m] and dF/d(de/dt) [N s/m].
        """
    def stored_energy(
        self, compression: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]
    ) -> typing.Any:
        """
        Energy [J] stored under a virgin compression, states at rest.
        """
    @property
    def fields(self) -> dict:
        """
        Values of all fields by name.
        """
    @property
    def has_memory(self) -> bool: ...
    @property
    def n_states(self) -> int: ...
    @property
    def name(self) -> str: ...

class LawPath:
    def __init__(self, law: ContactLaw) -> None: ...
    def energy(self, law: ContactLaw) -> float:
        """
        Stored energy [J].
        """
    def peek(
        self,
        compression: typing.SupportsFloat | typing.SupportsIndex,
        duration: typing.SupportsFloat | typing.SupportsIndex,
    ) -> float:
        """
        Force [N] if the step were taken; the memory stays.
        """
    def reset(self) -> None: ...
    def restore(
        self, saved: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex]
    ) -> None: ...
    def save(self) -> list[float]:
        """
        Compression, largest one, states, turning points, as numbers.
        """
    def step(
        self,
        compression: typing.SupportsFloat | typing.SupportsIndex,
        duration: typing.SupportsFloat | typing.SupportsIndex,
    ) -> float:
        """
        Moves to compression [m] within duration [s]; returns the force [N].
        """
    @property
    def compression(self) -> float: ...
    @property
    def largest(self) -> float: ...
    @property
    def state(self) -> typing.Annotated[list[float], "FixedSize(3)"]: ...

class ConstantArea:
    def __init__(self, size: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    def area(
        self, compression: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]
    ) -> typing.Any:
        """
        Area [m^2] at compression [m]; 0 for compression <= 0.
        """
    @property
    def size(self) -> float: ...

class CrossedCylinders:
    def __init__(
        self,
        radius_a: typing.SupportsFloat | typing.SupportsIndex,
        radius_b: typing.SupportsFloat | typing.SupportsIndex,
    ) -> None: ...
    def area(
        self, compression: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]
    ) -> typing.Any:
        """
        Area [m^2] at compression [m]; 0 for compression <= 0.
        """
    @property
    def radius_a(self) -> float: ...
    @property
    def radius_b(self) -> float: ...

class CircleOnLayer:
    def __init__(
        self,
        radius: typing.SupportsFloat | typing.SupportsIndex,
        width: typing.SupportsFloat | typing.SupportsIndex,
        length: typing.SupportsFloat | typing.SupportsIndex = ...,
    ) -> None: ...
    def area(
        self, compression: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]
    ) -> typing.Any:
        """
        Area [m^2] at compression [m]; 0 for compression <= 0.
        """
    @property
    def length(self) -> float: ...
    @property
    def radius(self) -> float: ...
    @property
    def width(self) -> float: ...

class SphereOnLayer:
    def __init__(self, radius: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    def area(
        self, compression: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]
    ) -> typing.Any:
        """
        Area [m^2] at compression [m]; 0 for compression <= 0.
        """
    @property
    def radius(self) -> float: ...

class FeltMaterial:
    def __init__(
        self,
        *,
        mu: typing.SupportsFloat | typing.SupportsIndex,
        Wf0: typing.SupportsFloat | typing.SupportsIndex,
        d_f: typing.SupportsFloat | typing.SupportsIndex,
        v_f0: typing.SupportsFloat | typing.SupportsIndex,
        v_f_max: typing.SupportsFloat | typing.SupportsIndex,
        loading: tuple[
            typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex
        ],
        unloading: tuple[
            typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex
        ],
        Q: typing.SupportsFloat | typing.SupportsIndex = 2.0,
    ) -> None: ...
    @property
    def v_f0(self) -> float: ...
    @property
    def v_f_max(self) -> float: ...

class FeltLayer:
    def __init__(
        self,
        pressure: Envelope,
        thickness: typing.SupportsFloat | typing.SupportsIndex,
        area: ConstantArea | CrossedCylinders | CircleOnLayer | SphereOnLayer,
        columns: bool = False,
    ) -> None: ...

class LayerColumns:
    def __init__(
        self,
        layer: FeltLayer,
        columns: typing.SupportsInt | typing.SupportsIndex,
        kappa: typing.SupportsFloat | typing.SupportsIndex = 0.2,
    ) -> None: ...
    def path(
        self, compression: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex]
    ) -> numpy.typing.NDArray[numpy.float64]:
        """
        Forces [N] along compressions [m], from virgin felt.
        """
    def step(self, compression: typing.SupportsFloat | typing.SupportsIndex) -> float:
        """
        Force [N] at compression [m].
        """

class StringParameters:
    @staticmethod
    def field_names() -> list[str]:
        """
        Names of all fields.
        """
    @staticmethod
    def number_fields() -> list:
        """
        Name, kind, unit, meaning, limits and default of the fields that are numbers.
        """
    def __init__(self, **kwargs: typing.Any) -> None:
        """
        From its fields, SI; what is not given keeps its default.
        """
    @property
    def count(self) -> int: ...
    @count.setter
    def count(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    @property
    def damping_ratio(self) -> float: ...
    @damping_ratio.setter
    def damping_ratio(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def diameter(self) -> float: ...
    @diameter.setter
    def diameter(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def length(self) -> float: ...
    @length.setter
    def length(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def linear_density(self) -> float: ...
    @linear_density.setter
    def linear_density(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def modes(self) -> int: ...
    @modes.setter
    def modes(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    @property
    def tension(self) -> float: ...
    @tension.setter
    def tension(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def young_modulus(self) -> float: ...
    @young_modulus.setter
    def young_modulus(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...

class ModalString:
    def __init__(self, parameters: StringParameters) -> None: ...
    def bridge_force(
        self, eta: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]
    ) -> numpy.typing.NDArray[numpy.float64]:
        """
        Transverse force [N] on the far end, shape (n_times,).
        """
    def shapes(
        self, y: typing.SupportsFloat | typing.SupportsIndex
    ) -> tuple[numpy.typing.NDArray[numpy.float64], numpy.typing.NDArray[numpy.float64]]:
        """
        phi_j(y) [kg^-1/2] and their slopes at y [m] from the end y = 0.
        """
    @property
    def angular_frequency(self) -> numpy.typing.NDArray[numpy.float64]:
        """
        w_j [rad/s], thesis eq. 4.14, shape (modes,).
        """
    @property
    def inharmonicity_index(self) -> float: ...
    @property
    def parameters(self) -> StringParameters: ...

class JointKind:
    """
    Members:

      revolute

      prismatic

      weld
    """

    __members__: typing.ClassVar[dict[str, JointKind]]
    prismatic: typing.ClassVar[JointKind]
    revolute: typing.ClassVar[JointKind]
    weld: typing.ClassVar[JointKind]
    @typing.overload
    def __eq__(self, other: JointKind) -> bool: ...
    @typing.overload
    def __eq__(self, other: typing.Any) -> bool: ...
    def __getstate__(self) -> int: ...
    def __hash__(self) -> int: ...
    def __index__(self) -> int: ...
    def __init__(self, value: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    def __int__(self) -> int: ...
    @typing.overload
    def __ne__(self, other: JointKind) -> bool: ...
    @typing.overload
    def __ne__(self, other: typing.Any) -> bool: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, state: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    def __str__(self) -> str: ...
    @property
    def name(self) -> str: ...
    @property
    def value(self) -> int: ...

class SurfaceKind:
    """
    Members:

      line

      circle

      concave

      hybrid

      segment

      concave_arc
    """

    __members__: typing.ClassVar[dict[str, SurfaceKind]]
    circle: typing.ClassVar[SurfaceKind]
    concave: typing.ClassVar[SurfaceKind]
    concave_arc: typing.ClassVar[SurfaceKind]
    hybrid: typing.ClassVar[SurfaceKind]
    line: typing.ClassVar[SurfaceKind]
    segment: typing.ClassVar[SurfaceKind]
    @typing.overload
    def __eq__(self, other: SurfaceKind) -> bool: ...
    @typing.overload
    def __eq__(self, other: typing.Any) -> bool: ...
    def __getstate__(self) -> int: ...
    def __hash__(self) -> int: ...
    def __index__(self) -> int: ...
    def __init__(self, value: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    def __int__(self) -> int: ...
    @typing.overload
    def __ne__(self, other: SurfaceKind) -> bool: ...
    @typing.overload
    def __ne__(self, other: typing.Any) -> bool: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, state: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    def __str__(self) -> str: ...
    @property
    def name(self) -> str: ...
    @property
    def value(self) -> int: ...

class ShapeSet:
    """
    Members:

      polynomial

      clamped_free

      craig_bampton
    """

    __members__: typing.ClassVar[dict[str, ShapeSet]]
    clamped_free: typing.ClassVar[ShapeSet]
    craig_bampton: typing.ClassVar[ShapeSet]
    polynomial: typing.ClassVar[ShapeSet]
    @typing.overload
    def __eq__(self, other: ShapeSet) -> bool: ...
    @typing.overload
    def __eq__(self, other: typing.Any) -> bool: ...
    def __getstate__(self) -> int: ...
    def __hash__(self) -> int: ...
    def __index__(self) -> int: ...
    def __init__(self, value: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    def __int__(self) -> int: ...
    @typing.overload
    def __ne__(self, other: ShapeSet) -> bool: ...
    @typing.overload
    def __ne__(self, other: typing.Any) -> bool: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, state: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    def __str__(self) -> str: ...
    @property
    def name(self) -> str: ...
    @property
    def value(self) -> int: ...

class BeamDescription:
    condense_axial: bool
    shapes: ShapeSet
    @staticmethod
    def field_names() -> list[str]:
        """
        Names of all fields.
        """
    @staticmethod
    def number_fields() -> list:
        """
        Name, kind, unit, meaning, limits and default of the fields that are numbers.
        """
    def __init__(self, **kwargs: typing.Any) -> None:
        """
        From its fields, SI; what is not given keeps its default.
        """
    @property
    def axial_shapes(self) -> int: ...
    @axial_shapes.setter
    def axial_shapes(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    @property
    def axial_stiffness(self) -> float: ...
    @axial_stiffness.setter
    def axial_stiffness(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def bending_stiffness(self) -> float: ...
    @bending_stiffness.setter
    def bending_stiffness(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def damping_time(self) -> float: ...
    @damping_time.setter
    def damping_time(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def lateral_shapes(self) -> int: ...
    @lateral_shapes.setter
    def lateral_shapes(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    @property
    def length(self) -> float: ...
    @length.setter
    def length(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def linear_density(self) -> float: ...
    @linear_density.setter
    def linear_density(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...

class BodyDescription:
    beam: BeamDescription | None
    coordinate: str
    friction: Friction
    joint: JointKind
    name: str
    parent: str
    @staticmethod
    def field_names() -> list[str]:
        """
        Names of all fields.
        """
    @staticmethod
    def number_fields() -> list:
        """
        Name, kind, unit, meaning, limits and default of the fields that are numbers.
        """
    def __init__(self, **kwargs: typing.Any) -> None:
        """
        From its fields, SI; what is not given keeps its default.
        """
    @property
    def angle(self) -> float: ...
    @angle.setter
    def angle(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def axis(self) -> tuple[float, float]: ...
    @axis.setter
    def axis(
        self,
        arg0: tuple[
            typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex
        ],
    ) -> None: ...
    @property
    def center_of_mass(self) -> tuple[float, float]: ...
    @center_of_mass.setter
    def center_of_mass(
        self,
        arg0: tuple[
            typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex
        ],
    ) -> None: ...
    @property
    def inertia(self) -> float: ...
    @inertia.setter
    def inertia(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def mass(self) -> float: ...
    @mass.setter
    def mass(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def position(self) -> tuple[float, float]: ...
    @position.setter
    def position(
        self,
        arg0: tuple[
            typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex
        ],
    ) -> None: ...

class SurfaceDescription:
    body: str
    kind: SurfaceKind
    name: str
    @staticmethod
    def field_names() -> list[str]:
        """
        Names of all fields.
        """
    @staticmethod
    def number_fields() -> list:
        """
        Name, kind, unit, meaning, limits and default of the fields that are numbers.
        """
    def __init__(self, **kwargs: typing.Any) -> None:
        """
        From its fields, SI; what is not given keeps its default.
        """
    @property
    def arc(self) -> typing.Annotated[list[float], "FixedSize(2)"]: ...
    @arc.setter
    def arc(
        self,
        arg0: typing.Annotated[
            collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex], "FixedSize(2)"
        ],
    ) -> None: ...
    @property
    def end(self) -> tuple[float, float]: ...
    @end.setter
    def end(
        self,
        arg0: tuple[
            typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex
        ],
    ) -> None: ...
    @property
    def normal(self) -> tuple[float, float]: ...
    @normal.setter
    def normal(
        self,
        arg0: tuple[
            typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex
        ],
    ) -> None: ...
    @property
    def point(self) -> tuple[float, float]: ...
    @point.setter
    def point(
        self,
        arg0: tuple[
            typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex
        ],
    ) -> None: ...
    @property
    def radius(self) -> float: ...
    @radius.setter
    def radius(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...

class ContactDescription:
    enabled: bool
    friction: Friction
    label: str
    law: ContactLaw
    surface_a: str
    surface_b: str
    @staticmethod
    def field_names() -> list[str]:
        """
        Names of all fields.
        """
    @staticmethod
    def number_fields() -> list:
        """
        Name, kind, unit, meaning, limits and default of the fields that are numbers.
        """
    def __init__(self, **kwargs: typing.Any) -> None:
        """
        From its fields, SI; what is not given keeps its default.
        """
    @property
    def number(self) -> int: ...
    @number.setter
    def number(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None: ...

class TorsionSpringDescription:
    coordinate: str
    name: str
    @staticmethod
    def field_names() -> list[str]:
        """
        Names of all fields.
        """
    @staticmethod
    def number_fields() -> list:
        """
        Name, kind, unit, meaning, limits and default of the fields that are numbers.
        """
    def __init__(self, **kwargs: typing.Any) -> None:
        """
        From its fields, SI; what is not given keeps its default.
        """
    @property
    def clearance(self) -> float: ...
    @clearance.setter
    def clearance(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def damping(self) -> float: ...
    @damping.setter
    def damping(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def rest_angle(self) -> float: ...
    @rest_angle.setter
    def rest_angle(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def seating(self) -> float: ...
    @seating.setter
    def seating(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def stiffness(self) -> float: ...
    @stiffness.setter
    def stiffness(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...

class DashpotDescription:
    coordinate: str
    name: str
    @staticmethod
    def field_names() -> list[str]:
        """
        Names of all fields.
        """
    @staticmethod
    def number_fields() -> list:
        """
        Name, kind, unit, meaning, limits and default of the fields that are numbers.
        """
    def __init__(self, **kwargs: typing.Any) -> None:
        """
        From its fields, SI; what is not given keeps its default.
        """
    @property
    def coefficient(self) -> float: ...
    @coefficient.setter
    def coefficient(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def side(self) -> int: ...
    @side.setter
    def side(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None: ...

class StrapDescription:
    body_a: str
    body_b: str
    name: str
    @staticmethod
    def field_names() -> list[str]:
        """
        Names of all fields.
        """
    @staticmethod
    def number_fields() -> list:
        """
        Name, kind, unit, meaning, limits and default of the fields that are numbers.
        """
    def __init__(self, **kwargs: typing.Any) -> None:
        """
        From its fields, SI; what is not given keeps its default.
        """
    @property
    def coefficients(self) -> typing.Annotated[list[float], "FixedSize(3)"]: ...
    @coefficients.setter
    def coefficients(
        self,
        arg0: typing.Annotated[
            collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex], "FixedSize(3)"
        ],
    ) -> None: ...
    @property
    def free_length(self) -> float: ...
    @free_length.setter
    def free_length(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def point_a(self) -> tuple[float, float]: ...
    @point_a.setter
    def point_a(
        self,
        arg0: tuple[
            typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex
        ],
    ) -> None: ...
    @property
    def point_b(self) -> tuple[float, float]: ...
    @point_b.setter
    def point_b(
        self,
        arg0: tuple[
            typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex
        ],
    ) -> None: ...

class StringDescription:
    moving_strike_point: bool
    name: str
    parameters: StringParameters
    rigid: bool
    surface: str
    @staticmethod
    def field_names() -> list[str]:
        """
        Names of all fields.
        """
    @staticmethod
    def number_fields() -> list:
        """
        Name, kind, unit, meaning, limits and default of the fields that are numbers.
        """
    def __init__(self, **kwargs: typing.Any) -> None:
        """
        From its fields, SI; what is not given keeps its default.
        """
    @property
    def anchor(self) -> float: ...
    @anchor.setter
    def anchor(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def direction(self) -> tuple[float, float]: ...
    @direction.setter
    def direction(
        self,
        arg0: tuple[
            typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex
        ],
    ) -> None: ...
    @property
    def other_surfaces(self) -> list[str]: ...
    @other_surfaces.setter
    def other_surfaces(self, arg0: collections.abc.Sequence[str]) -> None: ...
    @property
    def strike_position(self) -> float: ...
    @strike_position.setter
    def strike_position(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...

class TrackingPointDescription:
    body: str
    name: str
    @staticmethod
    def field_names() -> list[str]:
        """
        Names of all fields.
        """
    @staticmethod
    def number_fields() -> list:
        """
        Name, kind, unit, meaning, limits and default of the fields that are numbers.
        """
    def __init__(self, **kwargs: typing.Any) -> None:
        """
        From its fields, SI; what is not given keeps its default.
        """
    @property
    def point(self) -> tuple[float, float]: ...
    @point.setter
    def point(
        self,
        arg0: tuple[
            typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex
        ],
    ) -> None: ...

class FingerDescription:
    body: str
    pad: ContactLaw
    @staticmethod
    def field_names() -> list[str]:
        """
        Names of all fields.
        """
    @staticmethod
    def number_fields() -> list:
        """
        Name, kind, unit, meaning, limits and default of the fields that are numbers.
        """
    def __init__(self, **kwargs: typing.Any) -> None:
        """
        From its fields, SI; what is not given keeps its default.
        """
    @property
    def direction(self) -> tuple[float, float]: ...
    @direction.setter
    def direction(
        self,
        arg0: tuple[
            typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex
        ],
    ) -> None: ...
    @property
    def point(self) -> tuple[float, float]: ...
    @point.setter
    def point(
        self,
        arg0: tuple[
            typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex
        ],
    ) -> None: ...

class MotorDescription:
    coordinate: str
    @staticmethod
    def field_names() -> list[str]:
        """
        Names of all fields.
        """
    @staticmethod
    def number_fields() -> list:
        """
        Name, kind, unit, meaning, limits and default of the fields that are numbers.
        """
    def __init__(self, **kwargs: typing.Any) -> None:
        """
        From its fields, SI; what is not given keeps its default.
        """
    @property
    def contact(self) -> int: ...
    @contact.setter
    def contact(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None: ...

class MechanismDescription:
    finger: FingerDescription | None
    motor: MotorDescription | None
    name: str
    @staticmethod
    def field_names() -> list[str]:
        """
        Names of all fields.
        """
    @staticmethod
    def number_fields() -> list:
        """
        Name, kind, unit, meaning, limits and default of the fields that are numbers.
        """
    def __init__(self, **kwargs: typing.Any) -> None:
        """
        From its fields, SI; what is not given keeps its default.
        """
    @property
    def bodies(self) -> list[BodyDescription]: ...
    @bodies.setter
    def bodies(self, arg0: collections.abc.Sequence[BodyDescription]) -> None: ...
    @property
    def contacts(self) -> list[ContactDescription]: ...
    @contacts.setter
    def contacts(self, arg0: collections.abc.Sequence[ContactDescription]) -> None: ...
    @property
    def dashpots(self) -> list[DashpotDescription]: ...
    @dashpots.setter
    def dashpots(self, arg0: collections.abc.Sequence[DashpotDescription]) -> None: ...
    @property
    def gravity(self) -> tuple[float, float]: ...
    @gravity.setter
    def gravity(
        self,
        arg0: tuple[
            typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex
        ],
    ) -> None: ...
    @property
    def points(self) -> list[TrackingPointDescription]: ...
    @points.setter
    def points(self, arg0: collections.abc.Sequence[TrackingPointDescription]) -> None: ...
    @property
    def springs(self) -> list[TorsionSpringDescription]: ...
    @springs.setter
    def springs(self, arg0: collections.abc.Sequence[TorsionSpringDescription]) -> None: ...
    @property
    def start_pose(self) -> list[tuple[str, float]]: ...
    @start_pose.setter
    def start_pose(
        self,
        arg0: collections.abc.Sequence[tuple[str, typing.SupportsFloat | typing.SupportsIndex]],
    ) -> None: ...
    @property
    def straps(self) -> list[StrapDescription]: ...
    @straps.setter
    def straps(self, arg0: collections.abc.Sequence[StrapDescription]) -> None: ...
    @property
    def strings(self) -> list[StringDescription]: ...
    @strings.setter
    def strings(self, arg0: collections.abc.Sequence[StringDescription]) -> None: ...
    @property
    def surfaces(self) -> list[SurfaceDescription]: ...
    @surfaces.setter
    def surfaces(self, arg0: collections.abc.Sequence[SurfaceDescription]) -> None: ...

class Mechanism:
    def beam_centerline(
        self,
        name: str,
        q: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"],
        count: typing.SupportsInt | typing.SupportsIndex = 20,
    ) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
        """
        Centerline (count, 2) [m] of a flexible beam in its own clamped frame.
        """
    @property
    def beam_names(self) -> list[str]: ...
    @property
    def contact_names(self) -> list[str]: ...
    @property
    def contact_numbers(self) -> list[int]: ...
    @property
    def coordinate_scale(self) -> list[float]: ...
    @property
    def coordinate_units(self) -> list[str]: ...
    @property
    def coordinates(self) -> list[str]: ...
    @property
    def law_state_names(self) -> list[str]: ...
    @property
    def name(self) -> str: ...
    @property
    def point_names(self) -> list[str]: ...
    @property
    def total_law_states(self) -> int: ...
    @property
    def total_modes(self) -> int: ...

class Interpolation:
    """
    Members:

      linear

      monotone

      spline
    """

    __members__: typing.ClassVar[dict[str, Interpolation]]
    linear: typing.ClassVar[Interpolation]
    monotone: typing.ClassVar[Interpolation]
    spline: typing.ClassVar[Interpolation]
    @typing.overload
    def __eq__(self, other: Interpolation) -> bool: ...
    @typing.overload
    def __eq__(self, other: typing.Any) -> bool: ...
    def __getstate__(self) -> int: ...
    def __hash__(self) -> int: ...
    def __index__(self) -> int: ...
    def __init__(self, value: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    def __int__(self) -> int: ...
    @typing.overload
    def __ne__(self, other: Interpolation) -> bool: ...
    @typing.overload
    def __ne__(self, other: typing.Any) -> bool: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, state: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    def __str__(self) -> str: ...
    @property
    def name(self) -> str: ...
    @property
    def value(self) -> int: ...

class Profile:
    def __init__(
        self,
        time: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex],
        value: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex],
        interpolation: Interpolation,
        oscillation_amplitude: typing.SupportsFloat | typing.SupportsIndex = 0.0,
        oscillation_frequency: typing.SupportsFloat | typing.SupportsIndex = 0.0,
    ) -> None: ...
    def acceleration(
        self, time: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]
    ) -> typing.Any: ...
    def rate(self, time: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]) -> typing.Any: ...
    def value(
        self, time: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]
    ) -> typing.Any: ...
    @property
    def breakpoints(self) -> list[float]: ...
    @property
    def smooth(self) -> bool: ...

class InputSignal:
    def __init__(
        self,
        profile: Profile,
        kind: str = "force",
        origin: typing.SupportsFloat | typing.SupportsIndex = 0.0,
    ) -> None:
        """
        What drives a mechanism: a force, the motion of a finger with its pad, a key_motion, a torque or a motor_motion, from a time [s] on the clock of the profile.
        """
    @property
    def origin(self) -> float: ...
    @property
    def profile(self) -> Profile: ...

class SimulationOptions:
    diagnose: bool
    events: bool
    ledger: bool
    method: str
    outputs: bool
    def __init__(self) -> None: ...
    @property
    def duration(self) -> float: ...
    @duration.setter
    def duration(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def finger_reference(self) -> float: ...
    @finger_reference.setter
    def finger_reference(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def ledger_limit(self) -> float: ...
    @ledger_limit.setter
    def ledger_limit(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def lowest_points(self) -> list[int]: ...
    @lowest_points.setter
    def lowest_points(
        self, arg0: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex]
    ) -> None: ...
    @property
    def max_order(self) -> int: ...
    @max_order.setter
    def max_order(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    @property
    def max_step(self) -> float: ...
    @max_step.setter
    def max_step(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def max_steps(self) -> int: ...
    @max_steps.setter
    def max_steps(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    @property
    def max_wall(self) -> float: ...
    @max_wall.setter
    def max_wall(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def output_rate(self) -> float: ...
    @output_rate.setter
    def output_rate(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def outputs_from(self) -> float: ...
    @outputs_from.setter
    def outputs_from(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def peak_contacts(self) -> list[int]: ...
    @peak_contacts.setter
    def peak_contacts(
        self, arg0: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex]
    ) -> None: ...
    @property
    def rtol(self) -> float: ...
    @rtol.setter
    def rtol(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...

class Monitor:
    def __init__(
        self,
        *,
        name: str,
        point: typing.SupportsInt | typing.SupportsIndex,
        direction: tuple[
            typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex
        ],
        level: typing.SupportsFloat | typing.SupportsIndex,
    ) -> None: ...

class RunResult:
    @property
    def balance(self) -> dict: ...
    @property
    def code(self) -> str: ...
    @property
    def counts(self) -> dict: ...
    @property
    def data(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]: ...
    @property
    def deflections(self) -> list:
        """
        Tuples (name, length [m], largest deflection [m], time [s]) by flexible beam.
        """
    @property
    def end_largest_compression(self) -> list[float]: ...
    @property
    def end_state(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]: ...
    @property
    def end_time(self) -> float: ...
    @property
    def event_approach(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]: ...
    @property
    def event_compression(
        self,
    ) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]: ...
    @property
    def event_states(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]: ...
    @property
    def events(self) -> list:
        """
        Tuples (time, contact index or -1, monitor index or -1, direction).
        """
    @property
    def failed_contact(self) -> str: ...
    @property
    def failed_state(self) -> str: ...
    @property
    def ledger(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]: ...
    @property
    def ledger_names(self) -> list[str]: ...
    @property
    def limiting_contacts(self) -> list[tuple[str, int]]: ...
    @property
    def limiting_states(self) -> list[tuple[str, int]]: ...
    @property
    def long_names(self) -> list[str]: ...
    @property
    def lowest(self) -> list:
        """
        Tuples (point index, y at the start, smallest y) [m].
        """
    @property
    def message(self) -> str: ...
    @property
    def method(self) -> str: ...
    @property
    def names(self) -> list[str]: ...
    @property
    def peaks(self) -> list: ...
    @property
    def reached(self) -> float: ...
    @property
    def restarts(self) -> int: ...
    @property
    def start(self) -> list[float]: ...
    @property
    def states(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]: ...
    @property
    def status(self) -> str: ...
    @property
    def strikes(self) -> int: ...
    @property
    def time(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]: ...
    @property
    def units(self) -> list[str]: ...
    @property
    def wall(self) -> float: ...

class Stepper:
    state: tuple
    def __init__(
        self,
        mechanism: Mechanism,
        kind: str,
        *,
        rtol: typing.SupportsFloat | typing.SupportsIndex,
        method: str,
        max_order: typing.SupportsInt | typing.SupportsIndex,
        max_step: typing.SupportsFloat | typing.SupportsIndex,
        max_wall: typing.SupportsFloat | typing.SupportsIndex,
        events: bool,
        finger_reference: typing.SupportsFloat | typing.SupportsIndex,
        monitors: collections.abc.Sequence[Monitor],
    ) -> None: ...
    def advance(
        self,
        duration: typing.SupportsFloat | typing.SupportsIndex,
        value: typing.SupportsFloat | typing.SupportsIndex,
        rate: typing.SupportsFloat | typing.SupportsIndex,
        linear: bool,
    ) -> tuple[str, str, str, str, str, list, int]: ...
    def outputs(self) -> numpy.typing.NDArray[numpy.float64]: ...
    @property
    def channels(self) -> list: ...
    @property
    def rest(self) -> tuple: ...
    @property
    def time(self) -> float: ...

class Perturbed:
    def __init__(
        self,
        mechanism: Mechanism,
        input: InputSignal,
        shift: typing.SupportsFloat | typing.SupportsIndex,
        weight: typing.SupportsFloat | typing.SupportsIndex,
    ) -> None: ...

class SensitivityParameter:
    def __init__(
        self,
        name: str,
        nodes: collections.abc.Sequence[Perturbed],
        scale: typing.SupportsFloat | typing.SupportsIndex,
    ) -> None: ...

class SensitivitySegment:
    def __init__(
        self,
        begin: typing.SupportsFloat | typing.SupportsIndex,
        end: typing.SupportsFloat | typing.SupportsIndex,
        state: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex] = [],
        memory: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex] = [],
        directions: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"] = ...,
        moves: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"] = ...,
    ) -> None: ...

class SensitivityRequest:
    def __init__(
        self,
        output: typing.SupportsInt | typing.SupportsIndex,
        begin: typing.SupportsFloat | typing.SupportsIndex,
        end: typing.SupportsFloat | typing.SupportsIndex,
        sign: typing.SupportsInt | typing.SupportsIndex,
    ) -> None: ...

class SensitivityValue:
    @property
    def derivative(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]: ...
    @property
    def edge(self) -> int: ...
    @property
    def rate(self) -> float: ...
    @property
    def reason(self) -> str: ...
    @property
    def time(self) -> float: ...
    @property
    def time_derivative(
        self,
    ) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]: ...
    @property
    def value(self) -> float: ...

class SensitivityOptions:
    simulation: SimulationOptions
    whole_models: bool
    def __init__(self) -> None: ...
    def add_rule(
        self,
        name: str,
        point: typing.SupportsInt | typing.SupportsIndex,
        direction: tuple[
            typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex
        ],
        travel: typing.SupportsFloat | typing.SupportsIndex,
    ) -> None: ...
    def set_looks(self, choose: collections.abc.Callable) -> None: ...
    @property
    def output_rate(self) -> float: ...
    @output_rate.setter
    def output_rate(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def outputs(self) -> list[int]: ...
    @outputs.setter
    def outputs(
        self, arg0: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex]
    ) -> None: ...
    @property
    def threads(self) -> int: ...
    @threads.setter
    def threads(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    @property
    def tolerance(self) -> float: ...
    @tolerance.setter
    def tolerance(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...

class SensitivityEvent:
    @property
    def approach(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]: ...
    @property
    def compression(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]: ...
    @property
    def contact(self) -> int: ...
    @property
    def direction(self) -> int: ...
    @property
    def monitor(self) -> int: ...
    @property
    def rate(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]: ...
    @property
    def time(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]: ...
    @property
    def when(self) -> float: ...

class SensitivityResult:
    @property
    def counts(self) -> dict: ...
    @property
    def end_memory(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]: ...
    @property
    def end_state(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]: ...
    @property
    def events(self) -> list[SensitivityEvent]: ...
    @property
    def gradient(self) -> numpy.typing.NDArray[numpy.float64]: ...
    @property
    def looks(self) -> list[SensitivityValue]: ...
    @property
    def peaks(self) -> list[SensitivityValue]: ...
    @property
    def run(self) -> RunResult: ...
    @property
    def time(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]: ...
    @property
    def values(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]: ...
    @property
    def wall(self) -> float: ...
    @property
    def wall_stroke(self) -> float: ...

class BatchStroke:
    def __init__(
        self,
        mechanism: Mechanism,
        input: InputSignal,
        options: SimulationOptions,
        start: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex],
        monitors: collections.abc.Sequence[Monitor],
        memory: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex],
    ) -> None: ...

class StopFlag:
    """
    Ends a batch at once, from any thread.
    """
    def __init__(self) -> None: ...
    def is_set(self) -> bool: ...
    def set(self) -> None: ...

class ArmSection:
    def __init__(
        self,
        *,
        length: typing.SupportsFloat | typing.SupportsIndex,
        density: typing.SupportsFloat | typing.SupportsIndex,
        area: typing.SupportsFloat | typing.SupportsIndex,
        young_modulus: typing.SupportsFloat | typing.SupportsIndex,
        second_moment: typing.SupportsFloat | typing.SupportsIndex,
    ) -> None: ...

class TipPlacement:
    """
    Members:

      across

      along
    """

    __members__: typing.ClassVar[dict[str, TipPlacement]]
    across: typing.ClassVar[TipPlacement]
    along: typing.ClassVar[TipPlacement]
    @typing.overload
    def __eq__(self, other: TipPlacement) -> bool: ...
    @typing.overload
    def __eq__(self, other: typing.Any) -> bool: ...
    def __getstate__(self) -> int: ...
    def __hash__(self) -> int: ...
    def __index__(self) -> int: ...
    def __init__(self, value: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    def __int__(self) -> int: ...
    @typing.overload
    def __ne__(self, other: TipPlacement) -> bool: ...
    @typing.overload
    def __ne__(self, other: typing.Any) -> bool: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, state: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    def __str__(self) -> str: ...
    @property
    def name(self) -> str: ...
    @property
    def value(self) -> int: ...

class HubBeamDescription:
    printed_shapes: bool
    tip: TipPlacement
    def __init__(self) -> None: ...
    @property
    def eccentricity(self) -> float: ...
    @eccentricity.setter
    def eccentricity(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def elements(self) -> int: ...
    @elements.setter
    def elements(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    @property
    def hub_inertia(self) -> float: ...
    @hub_inertia.setter
    def hub_inertia(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def hub_radius(self) -> float: ...
    @hub_radius.setter
    def hub_radius(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def sections(self) -> list[ArmSection]: ...
    @sections.setter
    def sections(self, arg0: collections.abc.Sequence[ArmSection]) -> None: ...
    @property
    def tip_mass(self) -> float: ...
    @tip_mass.setter
    def tip_mass(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...

class HubBeam:
    def __init__(self, description: HubBeamDescription) -> None: ...
    def frequencies(
        self, count: typing.SupportsInt | typing.SupportsIndex, clamped: bool = False
    ) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
        """
        The lowest frequencies [Hz] of the elastic arm, hub free or held.
        """
    @property
    def length(self) -> float: ...
    @property
    def mass(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]: ...
    @property
    def reach(self) -> float: ...
    @property
    def rigid_inertia(self) -> float: ...
    @property
    def stations(self) -> list[float]: ...
    @property
    def stiffness(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]: ...
    @property
    def tip(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]: ...
    @property
    def weight(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]: ...

class DamperKind:
    """
    Members:

      none

      dashpot

      one_sided
    """

    __members__: typing.ClassVar[dict[str, DamperKind]]
    dashpot: typing.ClassVar[DamperKind]
    none: typing.ClassVar[DamperKind]
    one_sided: typing.ClassVar[DamperKind]
    @typing.overload
    def __eq__(self, other: DamperKind) -> bool: ...
    @typing.overload
    def __eq__(self, other: typing.Any) -> bool: ...
    def __getstate__(self) -> int: ...
    def __hash__(self) -> int: ...
    def __index__(self) -> int: ...
    def __init__(self, value: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    def __int__(self) -> int: ...
    @typing.overload
    def __ne__(self, other: DamperKind) -> bool: ...
    @typing.overload
    def __ne__(self, other: typing.Any) -> bool: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, state: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    def __str__(self) -> str: ...
    @property
    def name(self) -> str: ...
    @property
    def value(self) -> int: ...

class ActuatorDescription:
    action_force: Profile | None
    arm: HubBeamDescription
    damper: DamperKind
    linear_gravity: bool
    stop: ContactLaw | None
    def __init__(self) -> None: ...
    @property
    def action_mass(self) -> float: ...
    @action_mass.setter
    def action_mass(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def damping(self) -> float: ...
    @damping.setter
    def damping(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def gap(self) -> float: ...
    @gap.setter
    def gap(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def gravity(self) -> float: ...
    @gravity.setter
    def gravity(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...

class Actuator:
    def __init__(self, description: ActuatorDescription) -> None: ...
    def mode_frequencies_squared(
        self, with_action: bool = False
    ) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]: ...
    def simulate(
        self,
        torque: Profile,
        duration: typing.SupportsFloat | typing.SupportsIndex = 0.2,
        output_rate: typing.SupportsFloat | typing.SupportsIndex = 10000.0,
        tolerance: typing.SupportsFloat | typing.SupportsIndex = 1e-05,
    ) -> dict: ...
    @property
    def beam(self) -> HubBeam: ...

def assemble(description: MechanismDescription) -> Mechanism:
    """
    Checked, immutable mechanism; one error lists all faults.
    """

def body_poses(
    mechanism: Mechanism, q: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"]
) -> dict:
    """
    Origin x, y [m] and angle [rad] of every body in the ground frame; of a flexible beam at its clamped end.
    """

def contact_laws() -> list:
    """
    All contact laws: name, about, table and fields, each with name, kind, unit, meaning, limits, default and whether it stands in the contact itself.
    """

def description_numbers(description: MechanismDescription) -> list:
    """
    Path, unit, meaning, value and limits of all real numbers.
    """

def evaluate(
    mechanism: Mechanism,
    q: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"],
    qd: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"],
    finger_force: typing.SupportsFloat | typing.SupportsIndex = 0.0,
) -> dict: ...
def find_equilibrium(
    mechanism: Mechanism, finger_force: typing.SupportsFloat | typing.SupportsIndex = 0.0
) -> dict: ...
def finger_place(
    mechanism: Mechanism, q: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"]
) -> float:
    """
    Place of the finger's point along its direction [m].
    """

def force_along(
    law: ContactLaw,
    time: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex],
    compression: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex],
) -> numpy.typing.NDArray[numpy.float64]:
    """
    Forces [N] of a law along a compression history.
    """

def jacobian_blocks(
    mechanism: Mechanism,
    q: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"],
    qd: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"],
    finger_force: typing.SupportsFloat | typing.SupportsIndex = 0.0,
) -> tuple[
    typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"],
    typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"],
]:
    """
    d(Q - M a)/dq and d(Q - M a)/dqd at fixed acceleration a.
    """

def jacobian_check(
    mechanism: Mechanism,
    y: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex],
    input: InputSignal,
    time: typing.SupportsFloat | typing.SupportsIndex,
    gamma: typing.SupportsFloat | typing.SupportsIndex,
) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
    """
    Inverse of I - gamma J as the structured solver applies it.
    """

def law_numbers(law: ContactLaw) -> list:
    """
    Path, unit, meaning, value and limits of all real numbers.
    """

def layer_envelope(layer: FeltLayer) -> Envelope:
    """
    Envelope of a contact through a felt layer; kept.
    """

def move_through(
    mechanism: Mechanism,
    q: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
    count: typing.SupportsInt | typing.SupportsIndex = 25,
) -> dict:
    """
    Poses, one a row of q: ``names`` and ``bodies`` (x, y [m], angle [rad] of each, side by side), ``numbers`` and ``contacts`` (x, y [m] and unit normal of each; no finger), ``beams``: by name the centerline's ``count`` points [m] in the clamped frame.
    """

def observables(mechanism: Mechanism) -> list:
    """
    Tuples (name, unit, long name) of all outputs in their order.
    """

def point_position(
    mechanism: Mechanism,
    point: typing.SupportsInt | typing.SupportsIndex,
    q: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"],
) -> typing.Any:
    """
    Position [m] of a tracking point in the ground frame.
    """

def pressure_envelope(material: FeltMaterial) -> Envelope:
    """
    Pressure [Pa] against strain [-] as a table; kept.
    """

def read_description(text: str) -> MechanismDescription: ...
def rhs(
    mechanism: Mechanism,
    y: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex],
    input: InputSignal,
    time: typing.SupportsFloat | typing.SupportsIndex,
) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
    """
    y' of the full state [q, v, eta, deta/dt].
    """

def sensitivities(
    mechanism: Mechanism,
    input: InputSignal,
    parameters: collections.abc.Sequence[SensitivityParameter],
    segments: collections.abc.Sequence[SensitivitySegment],
    options: SensitivityOptions,
) -> list[SensitivityResult]: ...
def simulate(
    mechanism: Mechanism,
    input: InputSignal,
    options: SimulationOptions,
    start: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex],
    monitors: collections.abc.Sequence[Monitor],
    progress: typing.Any = None,
    start_memory: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex] = [],
) -> RunResult: ...
def simulate_many(
    strokes: collections.abc.Iterator,
    sink: collections.abc.Callable,
    threads: typing.SupportsInt | typing.SupportsIndex = 0,
    ordered: bool = True,
    stop: StopFlag | None = None,
) -> int:
    """
    Simulates the strokes of an iterator on threads; sink(index, result, failure) gets the outcomes, in order or as soon as each is known; a returned False ends the rest. Returns their number.
    """

def state_names(mechanism: Mechanism) -> list[str]:
    """
    Names of the full state in its order.
    """

def tolerance_for(
    error: typing.SupportsFloat | typing.SupportsIndex, mechanism: Mechanism, method: str
) -> float: ...
def write_description(description: MechanismDescription) -> str:
    """
    Text of a description, to the last bit.
    """

def write_law(law: ContactLaw) -> str:
    """
    Text of a contact law, to the last bit.
    """

__version__: str = "0.3.0"
