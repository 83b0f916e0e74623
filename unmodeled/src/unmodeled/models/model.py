"""Models that can be fitted and diagnosed: they simulate named outputs from parameters.

A *model* computes outputs from the inputs of a record, given parameters theta, magnitudes phi of
some effects and start states x. It is called with *jobs*. Every job simulates the record with its
own theta, phi and start, so that one call can simulate a batch of finite differences.
"""

from __future__ import annotations

import copy
import math
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from unmodeled.arguments import checked
from unmodeled.data import Array, InputMode, Record, StartPrior
from unmodeled.data.robots import Joint
from unmodeled.errors import InvalidParameter
from unmodeled.lazy import lazy_import
from unmodeled.models.coordinates import Coordinate, Coupling
from unmodeled.models.subject import Subject, subject_of

#: Component name of parameters of the interpolation of inputs between samples.
INTERPOLATION = "interpolation of inputs"
#: Prefix of the parameter of an input that is the share of a spline in its interpolation.
BETWEEN = "between."

EffectKind = Literal["force", "kinematic", "state", "parameter", "sensor", "input", "drift"]


@checked
@dataclass(frozen=True)
class UserUnit:
    """A further unit in which the owner of a machine knows a number: turns of a screw, grams."""

    unit: str
    """``turn``, or an SI unit, which is shown in its readable multiple."""
    per_unit: float
    """Number of these units in one unit of the parameter or effect."""
    words: tuple[str, str] = ("", "")
    """Directions of a positive and of a negative change: ("up", "down")."""


@checked
@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A number of the model with its prior N(value, sd^2), truncated at lower and upper.

    Examples
    --------
    A mass of 2 kg, known to 5 %:

    >>> from unmodeled import Parameter
    >>> mass = Parameter(name="m", value=2.0, sd=0.1, unit="kg", lower=0.0)
    >>> mass.value, mass.sd
    (2.0, 0.1)
    """

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
    """Name for people, as the subject of a sentence: "the front wheel"; default: the name."""
    relative: bool = False
    """Whether the value is a relative deviation from a tabulated value."""
    user_unit: UserUnit | None = None
    """A further unit of a change of the value; None: there is none."""
    before: Parameter | None = None
    """The parameter before a test of the part replaced its prior; None: there was no test."""
    process_sd: float = 0.0
    """Standard deviation of the independent deviation from the value in each record [unit]; 0:
    all records have the same value."""

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
        return self.component != INTERPOLATION

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
    """One state variable of the model, or a hidden one of an effect.

    Examples
    --------
    The position of a pendulum [rad], which starts within 0.1 rad of rest:

    >>> from unmodeled import State
    >>> State(name="q", unit="rad", scale=0.5, start_sd=0.1).start
    0.0
    """

    name: str
    unit: str = "1"
    scale: float = 1.0
    """Scale [unit]: determines steps of finite differences."""
    start: float = 0.0
    """Prior mean at the first sample of a record, unless the record specifies another value
    [unit]."""
    start_sd: float = math.inf
    """Prior standard deviation at the first sample [unit]; inf: unknown; 0: fixed."""
    hidden: bool = False
    """Whether it is a memory state of an effect, without influence on the outputs at magnitude
    0."""


def twice(names: Sequence[str]) -> list[str]:
    """Names that occur more than once."""
    return [n for n, count in Counter(names).items() if count > 1]


#: Start of a record that states nothing about it.
AS_STATED = StartPrior()


def start_in(state: State, record: Record) -> tuple[float, float]:
    """Mean and standard deviation of a state at the start of a record; inf: it is not known."""
    prior = record.start or AS_STATED
    sd = state.start_sd if prior.known else math.inf
    return prior.mean.get(state.name, state.start), prior.sd.get(state.name, sd)


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class Effect:
    """A cause that the model lacks. At magnitude zero, it must not change the model.

    At most one of the callables defines the effect; without a callable, the model must know its
    ``name``:

    ``rate(t, x, u, p, magnitude, shape) -> {state: (B,)}``
        For :class:`~unmodeled.Equations`: contribution to the rates of states, its own hidden
        states included.
    ``regressor(record, shape) -> (n,)``
        For :class:`~unmodeled.LinearModel`: output per unit of magnitude.
    ``observe(record, outputs (B, n, ny), magnitudes (B,), shape) -> (B, n, ny)``
        Sensor effect, for any model.
    ``excite(record, magnitude, shape) -> {input: (n,)}``
        Input effect, for any model: the inputs that replace those of the record. If a record is the
        later part of a run (:attr:`Record.before`), the function gets the run from its start.

    Examples
    --------
    A quadratic term of a line, in N per m^2, about 3 N/m^2 large:

    >>> from unmodeled import Effect
    >>> effect = Effect(
    ...     name="hardening", component="spring", unit="N/m^2", scale=3.0,
    ...     regressor=lambda record, shape: record.inputs["x"] ** 2,
    ... )
    >>> effect.name, effect.scale
    ('hardening', 3.0)
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
    label: str = ""
    """Name for people, with its article: what is added ("dry friction", "a dead zone"), or what
    changes ("the stiffness of the spring"); default: the name without the component."""
    subject: Subject | None = None
    """What it is about; default: its label and component."""
    remedy: str = ""
    """Recommended remedy."""
    lower: float = -math.inf
    upper: float = math.inf
    """Upper limit of the magnitude [unit]; ``lower`` and ``upper`` apply in addition to
    ``sign``."""
    relative: bool = False
    """Whether the magnitude is a share of a number of the model."""
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
    moves: int | None = None
    """Index of the parameter to which its magnitude is added; None: it is no parameter."""
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
    def about(self) -> Subject:
        """What it is about: nothing else tells a report or a search which law it is."""
        return self.subject or subject_of(self.name, self.component, self.label)

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
    """A batch of B simulations of one record. Row b of every array belongs to job b."""

    theta: Array
    """Parameters, (B, p), in the order of ``model.parameters``."""
    starts: Array
    """States at the first sample, (B, nx), in the order of ``model.states(included)``."""
    included: tuple[Candidate, ...] = ()
    magnitudes: Array = field(default_factory=lambda: np.zeros((0, 0)))
    """Magnitudes of the included effects [their units], (B, k)."""
    forces: Array | None = None
    """Unknown forces, (B, ports, m): linear between m knots over the record; None: no force."""

    def __post_init__(self) -> None:
        count = self.theta.shape[0]
        if not self.included:
            object.__setattr__(self, "magnitudes", np.zeros((count, 0)))
        wanted = {"theta": self.theta, "starts": self.starts}
        if self.included:
            wanted["magnitudes"] = self.magnitudes
        faults = [
            f"{name} has shape {array.shape}, expected {count} rows"
            for name, array in wanted.items()
            if array.ndim != 2 or array.shape[0] != count
        ]
        if faults:
            raise InvalidParameter("jobs: " + "; ".join(faults))

    @property
    def count(self) -> int:
        """Number of jobs B."""
        return int(self.theta.shape[0])


def prior_jobs(
    model: Model,
    record: Record,
    included: tuple[Candidate, ...] = (),
    magnitudes: Sequence[float] = (),
) -> Jobs:
    """One simulation of a record with the tabulated parameters, from its expected start."""
    return Jobs(
        theta=np.array([[p.value for p in model.parameters]], dtype=np.float64),
        starts=np.array([[start_in(s, record)[0] for s in model.states(included)]]),
        included=included,
        magnitudes=np.array([magnitudes], dtype=np.float64),
    )


#: A record and its jobs.
Batch = tuple[Record, Jobs]


def check_shapes(
    model: Model,
    included: Sequence[Candidate],
    given: Mapping[str, Array],
    rows: tuple[int, ...] = (),
) -> None:
    """Check that arrays have a value for each parameter, state and included candidate of a model.

    ``given``: arrays by what they hold (theta, start, magnitudes); ``rows``: lengths of the axes
    before the last one.
    """
    wanted = {
        "theta": [p.name for p in model.parameters],
        "start": [s.name for s in model.states(included)],
        "magnitudes": [c.name for c in included],
    }
    faults = [
        f"{what} has shape {np.shape(array)}, expected {(*rows, len(wanted[what]))}: "
        f"{', '.join(wanted[what]) or 'none'}"
        for what, array in given.items()
        if np.shape(array) != (*rows, len(wanted[what]))
    ]
    if faults:
        raise InvalidParameter(f"model {model.name}: " + "; ".join(faults))


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
    """A record, the point of its simulation, and the variables of differentiation."""

    record: Record
    """Record whose inputs drive the model."""
    theta: Array
    """Parameters [their units], (p,)."""
    start: Array
    """States at the first sample, (nx,), in the order of ``model.states(included)``."""
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
    they have a sign). Their hidden states start at their prior mean."""
    input_changes: tuple[Mapping[str, Array], ...] = ()
    """Changes of the recorded inputs, {input: (n,)} [unit of the input]. The derivative by h of a
    simulation with ``inputs + h * change`` is requested, at zero."""
    shape_changes: tuple[ShapeChange, ...] = ()
    """Changes of the shapes of included effects whose derivatives are requested. Only models with
    ``d_shapes`` in their results compute them."""
    rough: bool = False
    """Whether errors of some percent do not matter: for a rank, a covariance, a step of a fit."""

    @property
    def sizes(self) -> Array:
        """Magnitudes of the included effects [their units], (k,)."""
        return np.zeros(len(self.included)) if self.magnitudes is None else self.magnitudes

    def parameters_of(self, model: Model) -> tuple[int, ...]:
        """Indices of the parameters whose derivatives are requested."""
        return tuple(range(len(model.parameters)) if self.by_theta is None else self.by_theta)

    def jobs(self) -> Jobs:
        """The simulation at the point."""
        return Jobs(
            theta=np.asarray(self.theta, dtype=np.float64)[None],
            starts=self.start[None],
            included=self.included,
            magnitudes=self.sizes[None],
        )

    def check(self, model: Model) -> None:
        """Check that the request matches the record and the model."""
        given = {"theta": self.theta, "start": self.start, "magnitudes": self.sizes}
        check_shapes(model, self.included, given)
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
    """Outputs over a record with their derivatives.

    The last axis of every ``d_*`` is the variable of differentiation; its length is 0 if no
    derivative was requested.
    """

    outputs: Array
    """(n, ny)"""
    d_theta: Array
    """(n, ny, p) by the requested parameters."""
    d_magnitudes: Array
    """(n, ny, k) by the magnitudes of the included effects."""
    d_starts: Array
    """(n, ny, nx)"""
    d_candidates: Array
    """(n, ny, c) by the magnitudes of the further candidates, at zero."""
    d_inputs: Array | None = None
    """(n, ny, d) by the requested changes of the inputs; None: the model does not compute them, and
    they are computed from differences of simulations."""
    d_shapes: Array | None = None
    """(n, ny, s) by the requested changes of shapes; None: the model does not compute them."""


@checked
@dataclass(frozen=True, eq=False)
class Ready:
    """A model and records prepared for a fit; see :meth:`Model.ready`."""

    model: Model
    records: tuple[Record, ...]
    notes: tuple[str, ...] = ()
    """Sentences for the report: parts of the records that are not used, and larger noise of
    sensors."""


@dataclass(frozen=True)
class Origin:
    """How a model is made again."""

    made_by: Literal["load_model", "fmu", "mujoco", "Simulator"]
    name: str
    """File, ``FILE.py:NAME``, or name that an extension knows; "": it is not known."""
    arguments: Mapping[str, Any] = field(default_factory=dict)
    """Other arguments of the function that makes it, without the parameters."""


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
    converted: Mapping[str, tuple[float, str]] = {}
    """Factor to SI and stated unit of each parameter that was converted for the function."""
    offers_all: bool = False
    """Whether ``effects`` contains those of inputs and sensors as well."""
    units: Mapping[str, str] = MappingProxyType({})
    """SI units of outputs and inputs by name, if known; records with another unit are rejected."""
    input_modes: Mapping[InputMode, Sequence[str]] = MappingProxyType({})
    """Inputs that the model reads in each input mode of a record. They are searched in measured
    files without a sheet."""
    input_names: Mapping[str, Sequence[str]] = MappingProxyType({})
    """Other names of inputs in measured files, for example the names in a run of the model."""
    any_inputs: bool = False
    """Whether every column of a measured file that is no output is an input of this name."""
    joints: tuple[Joint, ...] = ()
    """Joints of a robot, by which its logs are read."""
    ports: tuple[Port, ...] = ()
    """Places where unknown forces may act; empty: no test of unknown forces."""
    difference_step: float = 1e-3
    """First step of finite differences by parameters, as a share of their scale; the step for
    states is a tenth of it. Choose it larger if the simulation is noisy."""
    coordinates: tuple[Coordinate | Coupling, ...] = ()
    """Coordinates of second-order equations, and couplings: the places of force effects."""
    cheap_derivatives: bool = False
    """Whether derivatives take about as long as a simulation. If not, a fit uses them at several
    points."""
    origin: Origin | None = None
    """How it is made again, for a case that others repeat; None: by a script."""
    follows: Mapping[str, str] = MappingProxyType({})
    """Outputs that a controller leads to an input, with the name of this input: what matters is a
    share of input minus output, not of the motion."""

    def states(self, included: Sequence[Candidate] = ()) -> tuple[State, ...]:
        """States, followed by the hidden states of the included effects in order.

        By default there are none: the model knows how a run begins.
        """
        del included
        return ()

    @abstractmethod
    def simulate(self, record: Record, jobs: Jobs) -> Array:
        """Outputs of every job over the record, (B, n, ny); NaN: the simulation failed.

        The inputs are ``record.inputs``. The measured outputs must not be used, because the model
        has to explain them.
        """

    def simulate_all(self, batches: Sequence[Batch]) -> list[Array]:
        """Simulate jobs of several records. Default: one record after the other.

        A model overrides it if one large batch takes less time than several small ones.
        """
        return [self.simulate(record, jobs) for record, jobs in batches]

    def motion(self, record: Record, jobs: Jobs) -> Array | None:
        """States over the record, (B, n, nx), in the order of ``states``; None: it has none."""
        del record, jobs
        return None

    def doubts(self, batches: Sequence[Batch]) -> tuple[str, ...]:
        """Sentences about functions that give other numbers along motions than the runs had."""
        del batches
        return ()

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

    def diagnose(self, records: Sequence[Record] | Record, **given: Any) -> Any:
        """Find the effects that the model lacks: :func:`unmodeled.diagnose`, which lists ``given``.

        Parameters
        ----------
        records
            Measured runs.

        Returns
        -------
        unmodeled.Report
        """
        return lazy_import("unmodeled.diagnosis:diagnose")(
            self, given.pop("effects", None), records, **given
        )

    def fit(self, records: Sequence[Record] | Record, **given: Any) -> Any:
        """Fit the parameters to all records: :func:`unmodeled.fit_model`, which lists ``given``.

        Parameters
        ----------
        records
            Measured runs.

        Returns
        -------
        unmodeled.Report
        """
        return lazy_import("unmodeled.diagnosis:fit_model")(self, records, **given)

    def ready(self, records: Sequence[Record]) -> Ready:
        """Prepare the model and all records of a fit or diagnosis.

        Returns the model with the usable parts of the records. By default nothing is changed. A
        prepared model is returned unchanged.
        """
        return Ready(self, tuple(records))

    def tabulated(self) -> Model:
        """The model for a simulation with its tabulated numbers: :meth:`ready` sizes no effect."""
        return self

    def accepts(self, effect: Effect) -> bool:
        """Whether the model can simulate an effect. By default: only sensor and input effects."""
        return effect.observe is not None or effect.excite is not None

    def events(self, record: Record, outputs: Mapping[str, Array]) -> list[tuple[str, float]]:
        """Names and times [s] of events found in outputs (measured or simulated, NaN: missing).

        By default there are none, and the steepest changes of each channel are used instead.
        """
        del record, outputs
        return []

    def _check_inputs(self, records: Sequence[Record]) -> None:
        """Check that the records have the inputs of the model."""
        for record in records:
            missing = [n for n in self.inputs if n not in record.inputs]
            if missing:
                raise InvalidParameter(
                    f"record {record.name}: model {self.name} needs the input "
                    f"{', '.join(missing)}; there is {', '.join(record.inputs) or 'none'}"
                )

    def _check_batches(self, batches: Sequence[Batch]) -> None:
        """Check that records have the inputs of the model, and jobs all of its numbers."""
        self._check_inputs([record for record, _ in batches])
        for _, jobs in batches:
            given = {"theta": jobs.theta, "start": jobs.starts}
            given |= {"magnitudes": jobs.magnitudes} if jobs.included else {}
            check_shapes(self, jobs.included, given, (jobs.count,))

    def _offsets(self, of: Parameter | Effect, at: float) -> tuple[tuple[float, float], ...]:
        """Changes of a parameter or magnitude, each with its weight in the derivative."""
        if isinstance(of, Parameter):
            return difference_offsets(at, self.difference_step * of.size, of.lower, of.upper)
        return difference_offsets(at, of.step * of.scale, *of.bounds)

    def sensitivities(self, requests: Sequence[SensitivityRequest]) -> list[Sensitivity]:
        """Outputs and derivatives, one result per request.

        Subclasses that can compute derivatives override it; the default uses finite differences.
        """
        for request in requests:
            request.check(self)
        return difference_sensitivities(self, requests)


# ---------------------------------------------------------------- derivatives by differences

#: Number of candidates per simulation. Sharing is useful while the overhead of a step exceeds its
#: computation.
TOGETHER = 8
#: Rows of changed jobs, each with its weight in a derivative.
Weighted = list[tuple[int, float]]


def difference_offsets(
    at: float, step: float, low: float, high: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Two changes of a number, and their weights in a derivative of second order.

    The weights apply to differences from the value without a change. If a limit excludes one side,
    both changes are on the other one.
    """
    if at + step <= high and at - step >= low:
        return (step, 0.5 / step), (-step, -0.5 / step)
    side = step if at + 2.0 * step <= high else -step
    return (side, 2.0 / side), (2.0 * side, -0.5 / side)


def difference_sensitivities(
    model: Model, requests: Sequence[SensitivityRequest]
) -> list[Sensitivity]:
    """Central differences of simulations.

    One-sided differences of second order are used where a bound or the sign of an effect excludes
    one side.
    """
    changed = [changed_runs(model, request) for request in requests]
    runs = iter(model.simulate_all([batch for batches, _ in changed for batch in batches]))
    found = []
    for request, (batches, columns) in zip(requests, changed, strict=True):
        own = [next(runs) for _ in batches]
        by = np.zeros((*own[0].shape[1:], len(columns)))
        with np.errstate(invalid="ignore", over="ignore"):  # a failed simulation is NaN
            for c, column in enumerate(columns):
                for batch, row, weight in column:
                    by[..., c] += weight * (own[batch][row] - own[0][0])
        found.append(sensitivity_of(model, request, own[0][0], by))
    return found


def sensitivity_of(
    model: Model, request: SensitivityRequest, outputs: Array, columns: Array
) -> Sensitivity:
    """Outputs and their derivatives, (n, ny, columns) in the order of :func:`changed_runs`."""
    counts = (
        len(request.parameters_of(model)),
        len(request.included),
        request.start.size if request.by_starts else 0,
        len(request.candidates),
        len(request.input_changes),
        len(request.shape_changes),
    )
    names = ("theta", "magnitudes", "starts", "candidates", "inputs", "shapes")
    first, parts = 0, {}
    for name, count in zip(names, counts, strict=True):
        parts[f"d_{name}"] = columns[..., first : first + count]
        first += count
    return Sensitivity(outputs=outputs, **parts)


def changed_runs(
    model: Model, request: SensitivityRequest
) -> tuple[list[Batch], list[list[tuple[int, int, float]]]]:
    """Changed simulations of a request, and their use.

    Returns batches, of which the first row of the first is the point without a change. For each
    variable of differentiation, several rows are given as batch, row and weight of its difference
    from the point: parameters, magnitudes, start states, candidates, changes of inputs, and of
    shapes.
    """
    jobs, weighted = changed_jobs(model, request)
    batches: list[Batch] = [(request.record, jobs)]
    columns = [[(0, row, weight) for row, weight in column] for column in weighted]
    for at in range(0, len(request.candidates), TOGETHER):
        jobs, weighted = _with_candidates(model, request, request.candidates[at : at + TOGETHER])
        columns += [[(len(batches), row, weight) for row, weight in c] for c in weighted]
        batches.append((request.record, jobs))
    pairs: list[tuple[Batch, Batch, float]] = []
    point = request.jobs()
    for change in request.input_changes:
        one, other = (
            request.record.with_inputs(
                {n: request.record.inputs[n] + sign * v for n, v in change.items()}
            )
            for sign in (1.0, -1.0)
        )
        pairs.append(((one, point), (other, point), 2.0))
    for shape in request.shape_changes:
        one_of, other_of = (
            replace(point, included=reshaped(request.included, shape.effect, value))
            for value in (shape.upper, shape.lower)
        )
        pairs.append(((request.record, one_of), (request.record, other_of), shape.width))
    for upper, lower, width in pairs:
        columns.append([(len(batches), 0, 1.0 / width), (len(batches) + 1, 0, -1.0 / width)])
        batches += [upper, lower]
    return batches, columns


def reshaped(included: tuple[Candidate, ...], place: int, shape: Any) -> tuple[Candidate, ...]:
    """Candidates, one of them with another shape."""
    return tuple(replace(c, shape=shape) if k == place else c for k, c in enumerate(included))


def changed_jobs(model: Model, request: SensitivityRequest) -> tuple[Jobs, list[Weighted]]:
    """Jobs with changes of parameters, magnitudes and start states, and their use by column."""
    included, states = request.included, model.states(request.included)
    base = {
        "theta": np.asarray(request.theta, dtype=np.float64),
        "magnitudes": np.asarray(request.sizes, dtype=np.float64),
        "starts": np.asarray(request.start, dtype=np.float64),
    }
    rows = {kind: [value] for kind, value in base.items()}
    columns: list[Weighted] = []

    def add(kind: str, index: int, offsets: Sequence[tuple[float, float]]) -> None:
        entry = []
        for offset, weight in offsets:
            for other, value in base.items():
                rows[other].append(value.copy() if other == kind else value)
            rows[kind][-1][index] += offset
            entry.append((len(rows[kind]) - 1, weight))
        columns.append(entry)

    for i in request.parameters_of(model):
        add("theta", i, model._offsets(model.parameters[i], base["theta"][i]))
    for i, candidate in enumerate(included):
        add("magnitudes", i, model._offsets(candidate.effect, base["magnitudes"][i]))
    if request.by_starts:
        for i, state in enumerate(states):
            if start_in(state, request.record)[1] == 0.0:  # it is no unknown
                columns.append([])
                continue
            step = 0.1 * model.difference_step * state.scale
            add("starts", i, difference_offsets(base["starts"][i], step, -np.inf, np.inf))
    return Jobs(included=included, **{k: np.array(v) for k, v in rows.items()}), columns


def _with_candidates(
    model: Model, request: SensitivityRequest, some: tuple[Candidate, ...]
) -> tuple[Jobs, list[Weighted]]:
    """Jobs with two magnitudes of each of some candidates, and their use by column."""
    rows: list[Array] = []
    columns: list[Weighted] = []
    for c, candidate in enumerate(some):
        entry = []
        for size, weight in model._offsets(candidate.effect, 0.0):
            entry.append((len(rows), weight))
            rows.append(np.zeros(len(some)))
            rows[-1][c] = size
        columns.append(entry)
    states = model.states((*request.included, *some))
    hidden = [h.start for h in states[request.start.size :]]
    count = len(rows)
    jobs = Jobs(
        theta=np.tile(request.theta, (count, 1)),
        starts=np.tile([*request.start, *hidden], (count, 1)),
        included=(*request.included, *some),
        magnitudes=np.hstack([np.tile(request.sizes, (count, 1)), np.array(rows)]),
    )
    return jobs, columns
