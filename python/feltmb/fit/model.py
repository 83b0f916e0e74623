"""Models that can be fitted and diagnosed: they simulate named outputs from parameters.

A *model* computes outputs from the inputs of a record, given parameters theta, magnitudes phi of
some effects and start states x of time segments. It is called with *jobs*. Every job is one segment
with its own theta, phi and start, so that one call can simulate a batch of segments and of finite
differences.
"""

from __future__ import annotations

import copy
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from feltmb.arguments import checked
from feltmb.data import Array, InputMode, Integers, Record
from feltmb.errors import InvalidParameter
from feltmb.fit.noise_of_function import difference_offsets

__all__ = [
    "INTERPOLATION",
    "LAWS",
    "OF_RECORDS",
    "VARIABILITY",
    "Batch",
    "Candidate",
    "Effect",
    "EffectKind",
    "Jobs",
    "Model",
    "Parameter",
    "Port",
    "Ready",
    "Sensitivity",
    "SensitivityRequest",
    "ShapeChange",
    "Simulated",
    "State",
]

#: Component name of parameters that represent random variation from record to record.
VARIABILITY = "run-to-run variability"
#: Component name of parameters of the interpolation of inputs between samples.
INTERPOLATION = "interpolation of inputs"

EffectKind = Literal["force", "kinematic", "state", "parameter", "sensor", "input", "drift"]
#: Kinds of effects whose magnitude multiplies a law of force.
LAWS = ("force", "state")
#: Kinds of effects that change the records, not the machine.
OF_RECORDS = ("sensor", "input")


@checked
@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A number of the model with its prior N(value, sd^2), truncated at lower and upper."""

    name: str
    value: float
    sd: float = math.inf
    """Standard deviation of the prior [unit]; inf: no prior knowledge; 0: fixed."""
    unit: str = "1"
    lower: float = -math.inf
    upper: float = math.inf
    component: str = ""
    scale: float | None = None
    """Scale for steps of finite differences [unit]; default: sd if finite, else abs(value) or 1."""
    label: str = ""
    """Name for people, as the subject of a sentence: "the hammer head"; default: the name."""
    words: tuple[str, str] = ("lower", "higher")
    """Words of a report for a value below and above the tabulated one."""
    relative: bool = False
    """Whether the value is a relative deviation from a tabulated value."""
    before: Parameter | None = None
    """The parameter before a test of the part replaced its prior; None: there was no test."""
    process_sd: float = 0.0
    """Standard deviation of the independent deviation from the value in each segment [unit]. It
    allows for errors in the form of the law; 0: the law is exact."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.value) and self.lower <= self.value <= self.upper):
            raise InvalidParameter(
                f"parameter {self.name}: value {self.value!r}, expected a finite number in "
                f"[{self.lower:g}, {self.upper:g}] {self.unit}"
            )
        if not self.sd >= 0.0:
            raise InvalidParameter(f"parameter {self.name}: sd = {self.sd!r}, expected >= 0")
        if not 0.0 <= self.process_sd < math.inf:
            raise InvalidParameter(
                f"parameter {self.name}: process_sd = {self.process_sd!r}, expected finite, >= 0"
            )

    @property
    def title(self) -> str:
        """Label, or else the name."""
        return self.label or self.name

    @property
    def of_the_machine(self) -> bool:
        """Whether it is a property of the machine: not of the simulation of single records."""
        return self.component not in (VARIABILITY, INTERPOLATION)

    @property
    def size(self) -> float:
        """Scale [unit], > 0."""
        if self.scale is not None:
            return self.scale
        if 0.0 < self.sd < math.inf:
            return self.sd
        return abs(self.value) or 1.0


@checked
@dataclass(frozen=True, kw_only=True)
class State:
    """One state variable of the model, or a hidden one of an effect."""

    name: str
    unit: str = "1"
    scale: float = 1.0
    """Scale [unit]: determines steps of finite differences and the unit of continuity defects."""
    start: float = 0.0
    """Prior mean at the first sample of a record, unless the record specifies another value
    [unit]."""
    start_sd: float = math.inf
    """Prior standard deviation at the first sample [unit]; inf: unknown; 0: fixed."""
    hidden: bool = False
    """Whether it is a memory state of an effect, without influence on the outputs at magnitude
    0."""


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class Effect:
    """A cause that the model lacks. At magnitude zero, it must not change the model.

    At most one of the callables defines the effect; without a callable, the model must know its
    ``name``:

    ``rate(t, x, u, p, magnitude, shape) -> {state: (B,)}``
        For :class:`~feltmb.gap.OdeModel`: contribution to the rates of states, its own hidden
        states included.
    ``regressor(record, shape) -> (n,)``
        For :class:`~feltmb.gap.LinearModel`: output per unit of magnitude.
    ``observe(record, outputs (B, L, ny), segments (B, 2), magnitudes (B,), shape) -> (B, L, ny)``
        Sensor effect, for any model.
    ``excite(record, magnitude, shape) -> {input: (n,)}``
        Input effect, for any model: the inputs that replace those of the record. If a record is the
        later part of a run (:attr:`Record.before`), the function gets the run from its start.
    """

    name: str
    component: str
    unit: str = "1"
    scale: float = 1.0
    """Expected magnitude if the effect exists [unit]: prior sd and unit of finite differences."""
    sign: Literal[-1, 0, 1] = 0
    """+1: magnitude >= 0 (friction), -1: magnitude <= 0, 0: any."""
    mechanism: str = ""
    """One sentence that describes the mechanism in the machine."""
    kind: EffectKind = "force"
    shapes: tuple[Any, ...] = (None,)
    """Shape parameters, which have no meaning at magnitude zero; each is tried, and the best is
    used.

    If the list has two or more positive floats, values between and near them are tried as well. Use
    integers or texts if only the listed values have a meaning."""
    shape_names: tuple[str, ...] = ()
    """Names of the numbers of a shape, with units: ``("half width [m]",)``."""
    shape_zero: float = 0.0
    """Value from which the numbers of a shape have a scale: the fit changes the logarithm of their
    distance from it. Not 0 for a reading with an arbitrary zero, such as a temperature."""
    remedy: str = ""
    """Recommended remedy."""
    lower: float = -math.inf
    upper: float = math.inf
    """Upper limit of the magnitude [unit]; ``lower`` and ``upper`` apply in addition to
    ``sign``."""
    weight: float = 1.0
    """Prior weight relative to the other effects."""
    hidden: tuple[State, ...] = ()
    """Memory states of the effect, appended to the states of the model."""
    step: float = 0.01
    """First step of finite differences, as a share of ``scale``."""
    rate: Callable[..., Mapping[str, Any]] | None = None
    regressor: Callable[..., Array] | None = None
    observe: Callable[..., Array] | None = None
    excite: Callable[..., Mapping[str, Array]] | None = None
    tolerance_parameter: str = ""
    """Name of the parameter that the effect changes. A change within its tolerance is attributed to
    the parameter, and a much larger change to the effect."""
    tolerance_ratio: float = 1.0
    """Change of this parameter that acts as a magnitude of 1 does, to first order [unit of the
    parameter per unit of the effect]."""
    data: Any = None
    """Any data for the model; the engine does not use it."""

    def __post_init__(self) -> None:
        faults = []
        if not (math.isfinite(self.scale) and self.scale > 0.0):
            faults.append(f"scale = {self.scale!r}, expected a finite number > 0")
        if self.sign not in (-1, 0, 1):
            faults.append(f"sign = {self.sign!r}, expected -1, 0 or 1")
        if not self.shapes:
            faults.append("shapes is empty, expected at least (None,)")
        if not self.lower <= 0.0 <= self.upper:
            faults.append(f"limits [{self.lower:g}, {self.upper:g}] do not hold 0, the model")
        if not self.weight > 0.0:
            faults.append(f"weight = {self.weight!r}, expected > 0")
        if faults:
            raise InvalidParameter(f"effect {self.name}: " + "; ".join(faults))

    @property
    def bounds(self) -> tuple[float, float]:
        """Permitted magnitudes [unit]."""
        low = max(self.lower, 0.0) if self.sign > 0 else self.lower
        high = min(self.upper, 0.0) if self.sign < 0 else self.upper
        return low, high


@checked
@dataclass(frozen=True)
class Candidate:
    """An effect with one of its shapes."""

    effect: Effect
    shape: Any = None

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.effect.name


@checked
@dataclass(frozen=True, kw_only=True)
class Port:
    """A place where an unknown force may act, for example a coordinate or a contact."""

    name: str
    component: str
    unit: str = "N"
    scale: float = 1.0
    """Typical force [unit]."""
    position: str = ""
    """State that is the displacement at the port, if there is one."""
    speed: str = ""
    """State that is the speed at the port, if there is one."""


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class Jobs:
    """A batch of B segments that are simulated. Row b of every array belongs to job b."""

    theta: Array
    """Parameters, (B, p), in the order of ``model.parameters``."""
    segments: Integers
    """First and last sample, (B, 2): outputs at i0 <= i <= i1, end state at i1."""
    starts: Array
    """States at i0, (B, nx), in the order of ``model.states(included)``."""
    included: tuple[Candidate, ...] = ()
    magnitudes: Array = field(default_factory=lambda: np.zeros((0, 0)))
    """Magnitudes of the included effects [their units], (B, k)."""
    forces: Array | None = None
    """Unknown forces, (B, ports, m): linear between m knots from i0 to i1; None: no force."""

    @classmethod
    def at_point(
        cls,
        theta: Array,
        segments: Integers,
        starts: Array,
        included: tuple[Candidate, ...],
        magnitudes: Array,
    ) -> Jobs:
        """Jobs with equal parameters, (p,), and magnitudes, (k,), for all segments.

        Parameters
        ----------
        theta
            Values of the parameters [their units], (p,).
        segments
            First and last sample of each segment, (W, 2).
        starts
            States at the first samples, (W, nx).
        included
            Candidates that are part of the model.
        magnitudes
            Their magnitudes [their units], (k,).
        """
        count = len(segments)
        return cls(
            theta=np.tile(theta, (count, 1)),
            segments=segments,
            starts=starts,
            included=included,
            magnitudes=np.tile(magnitudes, (count, 1)),
        )

    def __post_init__(self) -> None:
        count = self.segments.shape[0]
        wanted = {"theta": self.theta, "segments": self.segments, "starts": self.starts}
        if self.included:
            wanted["magnitudes"] = self.magnitudes
        faults = [
            f"{name} has shape {array.shape}, expected {count} rows"
            for name, array in wanted.items()
            if array.ndim != 2 or array.shape[0] != count
        ]
        if self.segments.shape[1:] != (2,):
            faults.append(f"segments has shape {self.segments.shape}, expected (B, 2)")
        if faults:
            raise InvalidParameter("jobs: " + "; ".join(faults))

    @property
    def count(self) -> int:
        """Number of jobs B."""
        return int(self.segments.shape[0])

    @property
    def longest(self) -> int:
        """Number of samples of the longest segment, including both ends."""
        return int(np.max(self.segments[:, 1] - self.segments[:, 0])) + 1


def check_segments(
    model: Model,
    record: Record,
    segments: Integers,
    starts: Array | None = None,
    included: Sequence[Candidate] = (),
    magnitudes: Array | None = None,
    theta: Array | None = None,
) -> None:
    """Check that the segments are within the record and that the arrays match the model."""
    wanted = {
        "segments": (segments, (len(segments), 2)),
        "starts": (starts, (len(segments), len(model.states(included)))),
        "magnitudes": (magnitudes, (len(included),)),
        "theta": (theta, (len(model.parameters),)),
    }
    faults = [
        f"{name} has shape {array.shape}, expected {shape}"
        for name, (array, shape) in wanted.items()
        if array is not None and array.shape != shape
    ]
    if (
        not faults
        and segments.size
        and not (0 <= segments.min() <= segments.max() < record.samples)
    ):
        faults.append(f"segments lie outside the {record.samples} samples of the record")
    if not faults and np.any(segments[:, 1] < segments[:, 0]):
        faults.append("a segment ends before it begins")
    if faults:
        raise InvalidParameter(f"model {model.name}: " + "; ".join(faults))


#: A record and its jobs.
Batch = tuple[Record, Jobs]


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class Simulated:
    """Results of all jobs; the results of a failed job are NaN."""

    outputs: Array
    """(B, L, ny) at the samples i0, i0+1, ..., i1 of each job; values after i1 are undefined."""
    ends: Array
    """States at sample i1, (B, nx)."""


@dataclass(frozen=True)
class ShapeChange:
    """A change of the shape of an included effect, as a variable of differentiation."""

    effect: int
    """Index of the effect among the included ones."""
    lower: Any
    upper: Any
    """The two shapes of a central difference."""
    width: float
    """Difference of the variable between the two shapes."""


@checked
@dataclass(frozen=True, eq=False)
class SensitivityRequest:
    """Segments of a record, the point of the simulation, and the variables of differentiation."""

    record: Record
    """Record whose inputs drive the model."""
    theta: Array
    """Parameters [their units], (p,)."""
    segments: Integers
    """First and last sample of each segment, (W, 2)."""
    starts: Array
    """States at the first samples, (W, nx), in the order of ``model.states(included)``."""
    included: tuple[Candidate, ...] = ()
    """Candidates that are part of the model; derivatives by all of their magnitudes are
    computed."""
    magnitudes: Array | None = None
    """Their magnitudes [their units], (k,); default: zero."""
    _: KW_ONLY
    by_theta: Sequence[int] | None = None
    """Indices of the parameters whose derivatives are requested; None: all."""
    by_starts: bool = True
    """Whether the derivatives by the start states are requested."""
    candidates: tuple[Candidate, ...] = ()
    """Further candidates at magnitude zero, whose derivatives at zero are requested (one-sided if
    they have a sign). Their hidden states start at their prior mean in the first segment and
    continue from segment to segment."""
    input_changes: tuple[Mapping[str, Array], ...] = ()
    """Changes of the recorded inputs, {input: (n,)} [unit of the input]. The derivative by h of a
    simulation with ``inputs + h * change`` is requested, at zero. Each segment is changed by
    itself: a sensor with memory keeps its state from the segment before."""
    shape_changes: tuple[ShapeChange, ...] = ()
    """Changes of the shapes of included effects whose derivatives are requested. Only models with
    ``d_shapes`` in their results compute them."""

    @property
    def sizes(self) -> Array:
        """Magnitudes of the included effects [their units], (k,)."""
        return np.zeros(len(self.included)) if self.magnitudes is None else self.magnitudes

    def parameters_of(self, model: Model) -> tuple[int, ...]:
        """Indices of the parameters whose derivatives are requested."""
        return tuple(range(len(model.parameters)) if self.by_theta is None else self.by_theta)

    def jobs(self) -> Jobs:
        """The segments as jobs."""
        return Jobs.at_point(self.theta, self.segments, self.starts, self.included, self.sizes)

    def check(self, model: Model) -> None:
        """Check that the request matches the record and the model."""
        check_segments(
            model,
            self.record,
            self.segments,
            self.starts,
            self.included,
            self.sizes,
            self.theta,
        )
        for change in self.input_changes:
            for name, value in change.items():
                if name not in self.record.inputs or np.shape(value) != (self.record.samples,):
                    raise InvalidParameter(
                        f"record {self.record.name}: input_changes of {name!r} with shape "
                        f"{np.shape(value)}, expected those of {', '.join(self.record.inputs)} "
                        f"with shape ({self.record.samples},)"
                    )
        known = range(len(model.parameters))
        if not set(self.parameters_of(model)) <= set(known):
            raise InvalidParameter(
                f"model {model.name}: by_theta = {list(self.by_theta or ())}, expected positions "
                f"of its {len(known)} parameters"
            )


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class Sensitivity:
    """Outputs and end states of W segments with their derivatives.

    The last axis of every ``d_*`` is the variable of differentiation; its length is 0 if no
    derivative was requested.
    """

    outputs: Array
    """(W, L, ny)"""
    ends: Array
    """(W, nx)"""
    d_theta: Array
    """(W, L, ny, p) by the requested parameters."""
    d_theta_ends: Array
    """(W, nx, p)"""
    d_magnitudes: Array
    """(W, L, ny, k) by the magnitudes of the included effects."""
    d_magnitudes_ends: Array
    """(W, nx, k)"""
    d_starts: Array
    """(W, L, ny, nx)"""
    d_starts_ends: Array
    """(W, nx, nx)"""
    d_candidates: Array
    """(W, L, ny, c) by the magnitudes of the further candidates, at zero."""
    d_candidates_ends: Array
    """(W, nx, c)"""
    d_inputs: Array | None = None
    """(W, L, ny, d) by the requested changes of the inputs; None: the model does not compute them,
    and they are computed from differences of simulations."""
    d_inputs_ends: Array | None = None
    """(W, nx, d)"""
    d_shapes: Array | None = None
    """(W, L, ny, s) by the requested changes of shapes; None: the model does not compute them."""


@checked
@dataclass(frozen=True, eq=False)
class Ready:
    """A model and records prepared for a fit; see :meth:`Model.ready`."""

    model: Model
    records: tuple[Record, ...]
    notes: tuple[str, ...] = ()
    """Sentences for the report: parts of the records that are not used, and larger noise of
    sensors."""
    unreached: str = ""
    """Sentence about what no record reaches, which is also in ``notes``; empty: nothing."""


@checked
class Model(ABC):
    """Base class of all models that can be fitted and diagnosed.

    A subclass sets the attributes and implements :meth:`simulate`. If it can compute derivatives,
    it also overrides :meth:`sensitivities`; otherwise finite differences in batches are used.
    """

    name: str = "model"
    parameters: tuple[Parameter, ...] = ()
    outputs: tuple[str, ...] = ()
    """Names of the outputs; a record may contain only some of them."""
    inputs: tuple[str, ...] = ()
    """Names of the inputs; empty: any, or those of ``input_modes``."""
    effects: tuple[Effect, ...] = ()
    """Effects that the model offers for a diagnosis."""
    many_outputs: bool = False
    """Whether it has more outputs than one usually records; else data checks list the outputs that
    no record has."""
    units: Mapping[str, str] = MappingProxyType({})
    """SI units of outputs and inputs by name, if known; records with another unit are rejected."""
    input_modes: Mapping[InputMode, Sequence[str]] = MappingProxyType({})
    """Inputs that the model reads in each input mode of a record. They are searched in measured
    files without a sheet."""
    input_names: Mapping[str, Sequence[str]] = MappingProxyType({})
    """Other names of inputs in measured files, for example the names in a run of the model."""
    any_inputs: bool = False
    """Whether every column of a measured file that is no output is an input of this name."""
    least_samples: int = 8
    """Smallest number of samples of a record; fewer than the default only if an output is a single
    number."""
    ports: tuple[Port, ...] = ()
    """Places where unknown forces may act; empty: no test of unknown forces."""
    segment: float | None = None
    """Length of segments that suits the model [s]; None: chosen from the data."""
    difference_step: float = 1e-3
    """First step of finite differences by parameters, as a share of their scale; the step for
    states is a tenth of it. Choose it larger if the simulation is noisy."""
    chaotic: bool = False
    """Whether it has impacts after which a small error of the state grows strongly."""
    from_rest: bool = False
    """Whether the model can only simulate a record from its first sample. Such records are split by
    removing values instead of cutting them into blocks."""
    longest_run: float = math.inf
    """Longest duration that is simulated to find out whether the clock of a record has a wrong unit
    [s]."""

    variability_has_input_noise: bool = False
    """Whether the noise of the inputs is a part of the run-to-run variability of the records."""
    variability_is_tabulated: bool = False
    """Whether the run-to-run variability of at least one record is that of the tabulated
    parameters."""

    @abstractmethod
    def states(self, included: Sequence[Candidate] = ()) -> tuple[State, ...]:
        """States, followed by the hidden states of the included effects in order; () if none."""

    @abstractmethod
    def simulate(self, record: Record, jobs: Jobs) -> Simulated:
        """Simulate every job.

        The inputs are ``record.inputs``. The measured outputs must not be used, because the model
        has to explain them.
        """

    def simulate_all(self, batches: Sequence[Batch]) -> list[Simulated]:
        """Simulate jobs of several records. Default: one record after the other.

        A model overrides it if one large batch takes less time than several small ones.
        """
        return [self.simulate(record, jobs) for record, jobs in batches]

    def driven(self, records: Sequence[Record]) -> tuple[tuple[Record, ...], tuple[str, ...]]:
        """Select the input of measured records that contain several; also return sentences.

        By default the records are not changed. A model that can be driven by different quantities
        overrides this method.
        """
        return tuple(records), ()

    def referred(self, record: Record) -> tuple[Record, tuple[str, ...]]:
        """Convert a record to the coordinates of the outputs; also return a description.

        By default the record is not changed. A model whose outputs are displacements from rest
        overrides this method.
        """
        return record, ()

    def refined(self, batches: Sequence[Batch]) -> Model:
        """The model with steps that are small enough for these jobs and their included effects.

        By default the model itself.
        """
        del batches
        return self

    def with_variability_at(
        self, theta: Array, included: tuple[Candidate, ...], magnitudes: Array
    ) -> Model:
        """The model with the run-to-run variability of its records at other parameters.

        Variability is linear in its own parameters, and computed before a fit. At the fitted
        parameters and magnitudes, its directions can differ. The parameters of the returned model
        are the same. By default the model itself.

        Parameters
        ----------
        theta
            Values of the parameters [their units], (p,).
        included
            Included effects of the machine.
        magnitudes
            Their magnitudes [their units], (m,).
        """
        del theta, included, magnitudes
        return self

    def with_parameters(self, parameters: Mapping[str, Parameter]) -> Model:
        """Copy with other values and priors of some parameters, by their names.

        Raises
        ------
        InvalidParameter
            The model does not have one of the parameters.
        """
        own = {p.name for p in self.parameters}
        if not parameters.keys() <= own:
            missing = ", ".join(sorted(parameters.keys() - own))
            raise InvalidParameter(f"with_parameters: {missing}: no parameter of {self.name}")
        out = copy.copy(self)
        out.parameters = tuple(parameters.get(p.name, p) for p in self.parameters)
        return out

    @property
    def own_effects(self) -> tuple[Candidate, ...]:
        """Effects that are a part of the model, see :func:`including`."""
        return ()

    def identity(self) -> str | None:
        """Text that two models share only if they are equal; results are stored under it.

        By default None: functions cannot be compared, and nothing is stored.
        """
        return None

    @property
    def core(self) -> Model:
        """The model that simulates: itself, or the model that it is derived from."""
        return self

    def forget(self) -> None:  # noqa: B027
        """Delete the data of earlier fits, so that a fit does not depend on them."""

    def ready(self, records: Sequence[Record]) -> Ready:
        """Prepare the model and all records of a fit or diagnosis.

        Returns the model with the usable parts of the records. By default nothing is changed. A
        prepared model is returned unchanged.
        """
        return Ready(self, tuple(records))

    def check_writing(self, path: Path) -> None:
        """Check whether :meth:`write` can write the model.

        By default it cannot, because the model does not come from a file.

        Raises
        ------
        InvalidParameter
            The model cannot be written.
        """
        raise InvalidParameter(
            f"{path}: the model {self.name} ({type(self).__name__}) is made from no file, expected "
            "a mechanism; use report.model.simulate, .parameters and .effects"
        )

    def write(
        self,
        path: Path,
        theta: Array,
        included: Sequence[Candidate],
        magnitudes: Array,
        *,
        provenance: str = "",
        force: bool = False,
    ) -> Path:
        """Write the model with these values to a file; see :meth:`check_writing`.

        Parameters
        ----------
        path
            File to be written.
        theta
            Values of the parameters [their units], (p,).
        included
            Candidates that are part of the model.
        magnitudes
            Their magnitudes [their units], (k,).
        provenance
            Text about the origin of the values, for the file.
        force
            False: an existing file is not overwritten.
        """
        del theta, included, magnitudes, provenance, force
        self.check_writing(path)
        raise NotImplementedError

    def accepts(self, effect: Effect) -> bool:
        """Whether the model can simulate an effect. By default: only sensor and input effects."""
        return effect.observe is not None or effect.excite is not None

    def guess(self, records: Sequence[Record], segments: Sequence[Integers]) -> list[Array]:
        """First guess of the states at the segment starts, for the first fit.

        By default the model is simulated from the prior start state through all segments.

        Parameters
        ----------
        records
            Records whose inputs drive the model.
        segments
            First and last sample of each segment, (W, 2), one array per record.

        Returns
        -------
        list of arrays
            States at the first samples, (W, nx), one array per record.
        """
        for record, own in zip(records, segments, strict=True):
            check_segments(self, record, own)
        states = self.states()
        starts = [np.zeros((len(own), len(states))) for own in segments]
        if not states:
            return starts
        for x, record in zip(starts, records, strict=True):
            mean = {} if record.start is None else record.start.mean
            x[:1] = [mean.get(s.name, s.start) for s in states]
        theta = np.array([[p.value for p in self.parameters]])
        for w, which in by_segment([len(own) - 1 for own in segments]):
            one = slice(w, w + 1)
            runs = self.simulate_all(
                [
                    (
                        records[i],
                        Jobs(theta=theta, segments=segments[i][one], starts=starts[i][one]),
                    )
                    for i in which
                ]
            )
            for i, run in zip(which, runs, strict=True):
                starts[i][w + 1] = np.where(np.isfinite(run.ends[0]), run.ends[0], starts[i][w])
        return starts

    def events(self, record: Record, outputs: Mapping[str, Array]) -> list[tuple[str, float]]:
        """Names and times [s] of events found in outputs (measured or simulated, NaN: missing).

        By default there are none, and the steepest changes of each channel are used instead.
        """
        del record, outputs
        return []

    def sensitivities(self, requests: Sequence[SensitivityRequest]) -> list[Sensitivity]:
        """Outputs and derivatives of segments, one result per request.

        Subclasses that can compute derivatives override it; the default uses finite differences.
        """
        for request in requests:
            request.check(self)
        return difference_sensitivities(self, requests)


def with_hidden(starts: Array, states: Sequence[State]) -> Array:
    """Start states (W, nx), with the further states at their prior mean."""
    rest = [s.start for s in states[starts.shape[1] :]]
    return np.hstack([starts, np.tile(rest, (len(starts), 1))])


def by_segment(counts: Sequence[int]) -> Iterator[tuple[int, list[int]]]:
    """Index of a segment, and indices of the records that have it, from the first segment on.

    ``counts``: number of segments of each record.
    """
    for w in range(max(counts, default=0)):
        yield w, [i for i, count in enumerate(counts) if w < count]


# ---------------------------------------------------------------- derivatives by differences

#: Number of candidates per simulation. Sharing is useful while the overhead of a step exceeds its
#: computation.
TOGETHER = 8
#: Rows of changed jobs, each with its weight in a derivative.
Weighted = list[tuple[int, float]]
#: A request and the magnitudes of its included effects, (V, k): one row per version of the model.
Versions = tuple[SensitivityRequest, Array]


def difference_sensitivities(
    model: Model, requests: Sequence[SensitivityRequest]
) -> list[Sensitivity]:
    """Central differences by parameters, magnitudes and start states.

    One-sided differences of second order are used where a bound or the sign of an effect excludes
    one side.
    """
    changed = [_changed_jobs(model, request) for request in requests]
    batches = [(r.record, jobs) for r, (jobs, _) in zip(requests, changed, strict=True)]
    found = [
        _derivatives(model, request, run, columns)
        for request, run, (_, columns) in zip(
            requests, model.simulate_all(batches), changed, strict=True
        )
    ]
    for hidden in (False, True):
        _add_candidates(model, requests, found, hidden=hidden)
    return found


def _changed_jobs(model: Model, request: SensitivityRequest) -> tuple[Jobs, list[Weighted]]:
    """Jobs with changes of parameters, magnitudes and start states, and their use by column."""
    segments, included = request.segments, request.included
    count = len(segments)
    theta = np.asarray(request.theta, dtype=np.float64)
    magnitudes = np.asarray(request.sizes, dtype=np.float64)
    states = model.states(included)
    rows_theta, rows_magnitudes, rows_start = [theta], [magnitudes], [np.zeros(len(states))]
    columns: list[Weighted] = []

    def add(kind: str, index: int, step: float, low: float, high: float, value: float) -> None:
        entry = []
        for offset, weight in difference_offsets(value, step, low, high):
            t, s, x = theta.copy(), magnitudes.copy(), np.zeros(len(states))
            {"theta": t, "magnitudes": s, "start": x}[kind][index] += offset
            rows_theta.append(t)
            rows_magnitudes.append(s)
            rows_start.append(x)
            entry.append((len(rows_theta) - 1, weight))
        columns.append(entry)

    for i in request.parameters_of(model):
        p = model.parameters[i]
        add("theta", i, model.difference_step * p.size, p.lower, p.upper, theta[i])
    for i, candidate in enumerate(included):
        low, high = candidate.effect.bounds
        step = candidate.effect.step * candidate.effect.scale
        add("magnitudes", i, step, low, high, magnitudes[i])
    if request.by_starts:
        for i, state in enumerate(states):
            add("start", i, 0.1 * model.difference_step * state.scale, -np.inf, np.inf, 0.0)

    versions = len(rows_theta)
    jobs = Jobs(
        theta=np.repeat(np.array(rows_theta), count, axis=0),
        segments=np.tile(segments, (versions, 1)),
        starts=np.tile(request.starts, (versions, 1))
        + np.repeat(np.array(rows_start), count, axis=0),
        included=included,
        magnitudes=np.repeat(
            np.array(rows_magnitudes).reshape(versions, len(included)), count, axis=0
        ),
    )
    return jobs, columns


def _derivatives(
    model: Model, request: SensitivityRequest, run: Simulated, columns: list[Weighted]
) -> Sensitivity:
    """Derivatives from the results of the changed jobs; those by candidates are still zero."""
    count, nx = len(request.segments), run.ends.shape[1]
    longest, ny = run.outputs.shape[1:]
    outputs = run.outputs.reshape(-1, count, longest, ny)
    ends = run.ends.reshape(len(outputs), count, nx)

    def derive(all_of_it: Array, wanted: list[Weighted]) -> Array:
        out = np.zeros((*all_of_it.shape[1:], len(wanted)))
        with np.errstate(invalid="ignore", over="ignore"):
            for c, entry in enumerate(wanted):
                for row, weight in entry:
                    out[..., c] += weight * (all_of_it[row] - all_of_it[0])
        return out

    a = len(request.parameters_of(model))
    b = a + len(request.included)
    return Sensitivity(
        outputs=outputs[0],
        ends=ends[0],
        d_theta=derive(outputs, columns[:a]),
        d_theta_ends=derive(ends, columns[:a]),
        d_magnitudes=derive(outputs, columns[a:b]),
        d_magnitudes_ends=derive(ends, columns[a:b]),
        d_starts=derive(outputs, columns[b:]),
        d_starts_ends=derive(ends, columns[b:]),
        d_candidates=np.zeros((count, longest, ny, len(request.candidates))),
        d_candidates_ends=np.zeros((count, nx, len(request.candidates))),
    )


def _add_candidates(
    model: Model,
    requests: Sequence[SensitivityRequest],
    found: Sequence[Sensitivity],
    *,
    hidden: bool,
) -> None:
    """Compute the derivatives by the candidates with, or without, hidden states."""
    groups: list[tuple[Sensitivity, list[int], Array]] = []
    versions: list[Versions] = []
    for request, s in zip(requests, found, strict=True):
        own = [c for c, t in enumerate(request.candidates) if bool(t.effect.hidden) is hidden]
        for at in range(0, len(own), TOGETHER):
            which = own[at : at + TOGETHER]
            some = tuple(request.candidates[c] for c in which)
            magnitudes, weights = _around_zero(some)
            if hidden:  # the base of the differences
                magnitudes = np.vstack([np.zeros(len(some)), magnitudes])
            table = np.hstack([np.tile(request.sizes, (len(magnitudes), 1)), magnitudes])
            groups.append((s, which, weights))
            versions.append((replace(request, included=(*request.included, *some)), table))
    if not groups:
        return
    runs = (run_through if hidden else _run_apart)(model, versions)
    for (s, which, weights), (y, x) in zip(groups, runs, strict=True):
        base_y, base_x = s.outputs, s.ends
        if hidden:
            y, x, base_y, base_x = y[1:], x[1:], y[0], x[0]
        with np.errstate(invalid="ignore", over="ignore"):
            dy = (y - base_y) * weights[:, None, None, None]
            dx = (x - base_x) * weights[:, None, None]
        s.d_candidates[..., which] = np.moveaxis(dy[0::2] + dy[1::2], 0, -1)
        s.d_candidates_ends[..., which] = np.moveaxis(dx[0::2] + dx[1::2], 0, -1)


def _around_zero(candidates: Sequence[Candidate]) -> tuple[Array, Array]:
    """Magnitudes for derivatives at zero, two rows per candidate, and the weights of the rows."""
    rows, weights = [], []
    for c, candidate in enumerate(candidates):
        step = candidate.effect.step * candidate.effect.scale
        for value, weight in difference_offsets(0.0, step, *candidate.effect.bounds):
            row = np.zeros(len(candidates))
            row[c] = value
            rows.append(row)
            weights.append(weight)
    return np.array(rows), np.array(weights)


def _run_apart(model: Model, versions: Sequence[Versions]) -> list[tuple[Array, Array]]:
    """Simulate all segments at once, each from its own start, in several versions of the model.

    Returns outputs (V, W, L, ny) and ends (V, W, nx) by request.
    """
    batches = []
    for request, magnitudes in versions:
        shape = (len(magnitudes), len(request.segments))
        jobs = Jobs(
            theta=np.tile(request.theta, (shape[0] * shape[1], 1)),
            segments=np.tile(request.segments, (shape[0], 1)),
            starts=np.tile(request.starts, (shape[0], 1)),
            included=request.included,
            magnitudes=np.repeat(magnitudes, shape[1], axis=0),
        )
        batches.append((request.record, jobs))
    found = []
    for (request, magnitudes), run in zip(versions, model.simulate_all(batches), strict=True):
        shape = (len(magnitudes), len(request.segments))
        outputs, ends = (v.reshape(*shape, *v.shape[1:]) for v in (run.outputs, run.ends))
        found.append((outputs, ends))
    return found


def run_through(model: Model, versions: Sequence[Versions]) -> list[tuple[Array, Array]]:
    """Simulate segments in order, in several versions of the model, passing hidden states on.

    The visible states of a segment come from the request, and its hidden ones from the end of the
    previous segment. Returns outputs (V, W, L, ny) and ends (V, W, visible) by request.
    """
    found, hidden = [], []
    for request, magnitudes in versions:
        visible = request.starts.shape[1]
        states = model.states(request.included)
        hidden.append(np.tile([s.start for s in states[visible:]], (len(magnitudes), 1)))
        shape = (len(magnitudes), len(request.segments))
        longest = int(np.max(request.segments[:, 1] - request.segments[:, 0])) + 1
        outputs = np.full((*shape, longest, len(model.outputs)), np.nan)
        found.append((outputs, np.full((*shape, visible), np.nan)))
    for w, which in by_segment([len(request.segments) for request, _ in versions]):
        batches = []
        for i in which:
            request, magnitudes = versions[i]
            times = (len(magnitudes), 1)
            jobs = Jobs(
                theta=np.tile(request.theta, times),
                segments=np.tile(request.segments[w], times),
                starts=np.hstack([np.tile(request.starts[w], times), hidden[i]]),
                included=request.included,
                magnitudes=magnitudes,
            )
            batches.append((request.record, jobs))
        for i, run in zip(which, model.simulate_all(batches), strict=True):
            outputs, ends = found[i]
            outputs[:, w, : run.outputs.shape[1]] = run.outputs
            ends[:, w] = run.ends[:, : ends.shape[2]]
            hidden[i] = run.ends[:, ends.shape[2] :]
    return found
