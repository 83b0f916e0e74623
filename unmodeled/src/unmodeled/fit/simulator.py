"""A model from any simulator: a Python function of a whole record, used as a black box.

Runs are cached by their content; long runs are computed in processes. Derivatives are finite
differences. Their steps follow from the numerical noise of the function.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from unmodeled.arguments import checked
from unmodeled.data import Array, Record
from unmodeled.errors import InvalidParameter, near_names, which_column
from unmodeled.fit.noise import Noise
from unmodeled.fit.priors import (
    Bounds,
    Priors,
    Unknowns,
    in_si,
    sized,
    stated,
)
from unmodeled.fit.running import Run, Runner
from unmodeled.models.coordinates import Named
from unmodeled.models.elsewhere import Means, by_means, cached, resumed
from unmodeled.models.matching import matched, with_same_channels
from unmodeled.models.model import (
    Batch,
    Candidate,
    Effect,
    Jobs,
    Model,
    Origin,
    Parameter,
    Ready,
    State,
    check_shapes,
    difference_offsets,
    twice,
)
from unmodeled.models.writing import numbers
from unmodeled.ode.calling import calling
from unmodeled.units import same_unit

#: Steps that are tried for a parameter; spacing of the values from which the noise of the function
#: is estimated, as shares of the scales; number of spacings.
TRIAL, SPACING, SPACINGS = 0.1, 1e-3, 6
#: Shares of the scales that are steps without a trial; the largest one is central.
UNTESTED = 0.01, 0.1
#: Numerical noise below this share of the noise of a sensor has no influence on a result.
NO_MATTER = 1e-3
#: Duration of a run [s] above which processes are faster.
WORTH_A_PROCESS = 5e-3


class _Asked(dict[str, Array]):
    """Columns of a record that notes which of them a function reads."""

    def __init__(self, columns: Mapping[str, Array], record: str):
        super().__init__({k: v.copy() for k, v in columns.items()})
        self.read: dict[str, None] = {}
        self.whole = False
        self._record = record

    def __getitem__(self, name: str) -> Array:
        if name not in self:
            raise InvalidParameter(
                f"there is no column {name} in record {self._record}{near_names(name, self)}; "
                f"there are {', '.join(self)} ({which_column(name)})"
            )
        self.read[name] = None
        return super().__getitem__(name)

    def get(self, name: str, default: Any = None) -> Any:
        self.read[name] = None
        return super().get(name, default)

    def __iter__(self) -> Iterator[str]:
        self.whole = True
        return super().__iter__()

    def keys(self) -> Any:
        self.whole = True
        return super().keys()

    def values(self) -> Any:
        self.whole = True
        return super().values()

    def items(self) -> Any:
        self.whole = True
        return super().items()


class _Stated(dict[str, float]):
    """Parameters by name that tell which one is missing."""

    def __missing__(self, name: str) -> float:
        raise InvalidParameter(
            f"its function reads the parameter {name}, which is not stated"
            f"{near_names(name, self)}; stated are {', '.join(self) or 'none'}: add {name} to "
            "parameters or unknown (on the command line --parameter, --unknown)"
        )


@dataclass(frozen=True)
class _Variable:
    """A number of the function, by which it is differentiated."""

    name: str
    size: float
    """Scale [unit]."""
    low: float
    high: float
    value: float

    @property
    def trials(self) -> tuple[float, float]:
        """Two changes: to both sides, or both to the permitted one."""
        (one, _), (other, _) = difference_offsets(
            self.value, TRIAL * self.size, self.low, self.high
        )
        return one, other


@checked
class Simulator(Model):
    """A simulator of the user: ``function(time, inputs, parameters) -> {output: array}``.

    The function gets the times [s] of a whole record, a dictionary of its inputs, each (n,), and a
    dictionary of all parameters, unknown effects included, as numbers. It returns every output at
    every time, (n,). The same arguments must give the same outputs. If there is no result, it may
    raise an exception or return NaN. At the given values of the parameters this is an error. At
    other values, which a fit tries, only that trial fails.

    Parameters
    ----------
    function
        The simulator. If processes cannot be forked, it must be picklable to run in several of
        them.
    parameters
        Fitted parameters with their priors: ``(value, sd, unit)`` by name (``sd=0`` fixes it; a
        value alone has no prior), or a list of :class:`Parameter`. The unit is that of the numbers.
        The function gets SI units, or those that its attribute ``units`` states by name, as
        ``{"rate": "1/h"}``; a note tells what was converted. Readings in degC and degF stay, and
        units of inputs and outputs (of cm: also cm^2 and N/cm), so that both sides of an equation
        are in one unit; mm beside cm is refused.
    unknown
        Parameters that are effects which the model may lack: the unit (the value without the effect
        is 0, and its expected size follows from the records), ``(value without it, expected size,
        unit)``, :class:`Exposed`, or an :class:`Effect` whose magnitude is added to zero. An effect
        whose ``data`` is the name of a parameter acts on it and need not be listed here.
    inputs, outputs
        Names; or names and units, ``{"force": "N"}``. Default: the columns of the records that the
        function reads, and those that it returns, in SI units or in those of its attribute
        ``units``.
    bounds
        Lowest and highest value by name of a parameter or an unknown effect, in its stated unit.
    workers
        Number of processes; 1: none; default: number of cores if a run takes longer than 5 ms.
    name
        Name in messages; default: the name of the function.

    Examples
    --------
    A body that a force [N] moves from rest, 2 kg known to 5 %:

    >>> import numpy as np
    >>> from unmodeled import Simulator
    >>> def body(time, inputs, parameters):
    ...     return {"v": np.cumsum(inputs["force"]) * 0.01 / parameters["m"]}
    >>> model = Simulator(
    ...     body, parameters={"m": (2.0, 0.1, "kg")}, inputs={"force": "N"}, outputs={"v": "m/s"}
    ... )
    >>> [(p.name, p.value, p.sd, p.unit) for p in model.parameters]
    [('m', 2.0, 0.1, 'kg')]
    """

    function: Callable[..., Mapping[str, Any]]
    """The simulator."""

    #: Whether steps of derivatives are tested by trials.
    _tested = True
    #: Parameters whose first change switches something on: they tell no noise of the function.
    _jumps: frozenset[str] = frozenset()

    def __init__(
        self,
        function: Callable[..., Mapping[str, Any]],
        *,
        parameters: Priors = (),
        unknown: Unknowns = None,
        inputs: Sequence[str] | Mapping[str, str] | None = None,
        outputs: Sequence[str] | Mapping[str, str] | None = None,
        bounds: Bounds = None,
        workers: int | None = None,
        name: str = "",
    ):
        called = getattr(function, "__name__", "")
        self.name = name = name or (called if called.isidentifier() else "simulator")
        named = [g for g in (inputs, outputs) if isinstance(g, Mapping)]
        channels = {k: v for g in named for k, v in g.items() if v}  # "": unknown
        given = stated(function, parameters, unknown, bounds, name, channels)
        self.parameters, self.effects = given.parameters, given.effects
        self.converted = given.converted
        self._neutral, self._unsized, self._converted = given.neutral, given.unsized, given.notes
        self.inputs = tuple(inputs or ())
        self.outputs = tuple(outputs or ())
        self._names = (*(p.name for p in self.parameters), *self._neutral)
        self.units = given.units
        faults = [f"{n!r} is used twice" for n in twice([*self._names, *self.inputs])]
        if outputs is not None and not self.outputs:
            faults.append("outputs is empty, expected at least one name")
        if workers is not None and workers < 1:
            faults.append(f"workers = {workers}, expected a whole number >= 1, or None")
        if faults:
            raise InvalidParameter(f"model {name}: " + "; ".join(faults))
        self.open = inputs is None, outputs is None
        self._means = Means(workers)
        self.function = function
        self._runner = self.new_runner()
        self._steps: dict[str, Step] = {}
        self._ready, self._varied = False, True
        again = {"unknown": unknown, "inputs": inputs, "outputs": outputs, "bounds": bounds}
        self.origin = Origin("Simulator", "", {**again, "name": name})

    def new_runner(self) -> Runner:
        """What computes its runs, without those that are known."""
        names = {"inputs": self.inputs, "outputs": self.outputs, "parameters": self._names}
        return Runner(self.function, self.outputs, self.name, self._means, names)

    @property
    def simulations(self) -> int:
        """Number of runs of the function so far; cached runs are not repeated."""
        return self._runner.made

    def accepts(self, effect: Effect) -> bool:
        """Whether the ``data`` of an effect is a parameter, or it is a sensor or input effect."""
        own = isinstance(effect.data, str) and effect.data in self._names
        unit = {p.name: p.unit for p in self.parameters if own}.get(effect.data, "1")
        if "1" not in (unit, effect.unit) and not same_unit(effect.unit, unit):
            raise InvalidParameter(
                f"effect {effect.name}: is in {effect.unit} and is added to the parameter "
                f"{effect.data}, which the function gets in {unit}: expected this unit"
            )
        return own or super().accepts(effect)

    def tabulated(self) -> Simulator:
        """See :class:`~unmodeled.fit.Model`: derivatives get no steps either."""
        out = copy.copy(self)
        out._varied = False
        return out

    def ready(self, records: Sequence[Record]) -> Ready:
        """Test the function at the priors and choose steps of finite differences for these records.

        Raises
        ------
        InvalidParameter
            The function fails at the priors, or returns invalid values.
        """
        if self._ready:
            return Ready(self, tuple(records))
        if any(self.open):
            same = matched(self, records)
            ready = same.model.ready(same.records)
            return replace(ready, notes=(*same.notes, *ready.notes))
        self._check_inputs(records)
        # A file has its own units.
        assumed = [] if hasattr(self.function, "values") else in_si(self, self.function, records)
        runner = self._runner
        prior = self._point([p.value for p in self.parameters])
        records, begun = self._begun(records)
        seconds, again = runner.first(self._run(records[0], prior))
        workers = self._means.workers
        if workers != 1 and (workers or seconds > WORTH_A_PROCESS):
            runner.start()
        runner.values([self._run(r, prior) for r in records], must=True)
        out, sizes, notes = copy.copy(self), list[str](), list[str]()
        if self._varied:
            with runner.trying():
                out.effects, sizes = self._sized(records)
            out._steps, notes = out._chosen_steps(records[0], again)
        out._ready = True
        notes += [*self._converted, *assumed, *begun, *sizes, *runner.notices]
        return Ready(out, tuple(records), tuple(f"model {self.name}: {n}" for n in notes))

    def _begun(self, records: Sequence[Record]) -> tuple[Sequence[Record], list[str]]:
        """The records with the starts of their runs, and notes about these."""
        return records, []

    def _sized(self, records: Sequence[Record]) -> tuple[tuple[Effect, ...], list[str]]:
        """The effects with their expected sizes, and notes about these."""
        return sized(self, self.effects, self._unsized, records)

    def _point(self, theta: Sequence[float] | Array) -> dict[str, float]:
        """All parameters of the function, with the values without unknown effects."""
        values = dict(zip((p.name for p in self.parameters), map(float, theta), strict=True))
        return {**values, **self._neutral}

    def _variables(self) -> list[_Variable]:
        """Parameters and unknown effects, by which the function is differentiated."""
        rows = [
            _Variable(p.name, p.size, p.lower, p.upper, p.value)
            for p in self.parameters
            if p.sd > 0.0
        ]
        for e, (name, neutral) in zip(self.effects, self._neutral.items(), strict=True):
            low, high = e.bounds
            rows.append(_Variable(name, e.scale, low + neutral, high + neutral, neutral))
        return rows

    def _chosen_steps(self, record: Record, repeated: Array) -> tuple[dict[str, Step], list[str]]:
        """Steps by parameter from trials at the priors, with notes for the report."""
        rows = self._variables()
        if not rows:
            return {}, []
        tested = rows if self._tested else []
        seen = self._runner.values(self._trials(record, rows, tested))
        base = seen[0]
        unit = spread_of(base)
        jitter = float(np.sqrt(np.mean(((repeated - base) / unit) ** 2))) / math.sqrt(2.0)
        along = np.array([s / unit for s in seen[: SPACINGS + 1]])
        noise = max(noise_of_function(along), jitter)
        dead = []
        pairs = iter(seen[SPACINGS + 1 :])
        share = float(np.clip(2.0 * math.sqrt(noise), *UNTESTED))
        steps = {v.name: Step(share * v.size, share == UNTESTED[1]) for v in rows}
        for v in tested:
            near, far = next(pairs), next(pairs)
            one, other = v.trials
            both = other == -one
            ends = base / unit, near / unit, far / unit
            steps[v.name] = choose_step(*ends, one, noise, v.size, both)
            if np.array_equal(near, base) and np.array_equal(far, base):
                dead.append(v.name)
        notes = self._notes_of_noise(record, base, noise * unit, noise, rows, steps)
        if jitter > 1e-12:
            notes.append("two runs with the same arguments differ: seed its random numbers")
        if dead:
            known = hasattr(self.function, "notices")  # the names of a file are right
            notes.append(
                f"{', '.join(dead)} changes no output of record {record.name}"
                f"{'' if known else ': is it misspelled in the function?'}"
            )
        return steps, notes

    def _trials(
        self, record: Record, rows: Sequence[_Variable], tested: Sequence[_Variable]
    ) -> list[Run]:
        """Runs along one direction that changes all parameters, then with single changes."""
        prior = self._point([p.value for p in self.parameters])
        smooth = [v for v in rows if v.name not in self._jumps]  # to the permitted side
        way = {v.name: v.size if v.value + v.size <= v.high else -v.size for v in smooth}
        changes = [{k: i * SPACING * v for k, v in way.items()} for i in range(SPACINGS + 1)]
        changes += [{v.name: o} for v in tested for o in v.trials]
        return [
            self._run(record, {k: v + change.get(k, 0.0) for k, v in prior.items()})
            for change in changes
        ]

    def _notes_of_noise(
        self,
        record: Record,
        outputs: Array,
        noise: Array,
        share: float,
        rows: Sequence[_Variable],
        steps: Mapping[str, Step],
    ) -> list[str]:
        """Notes about the numerical noise, [units of the outputs], beside that of the sensors."""
        matters, large = False, []
        for name, y, own in zip(self.outputs, outputs.T, noise, strict=True):
            sensor = record.sensors.get(name)
            sigma = 0.0
            if sensor is not None and sensor.sigma:
                sd = Noise(sensor.sigma, relative=sensor.relative_sigma).sd(y)
                sigma = float(np.sqrt(np.mean(sd**2)))
            matters |= sigma == 0.0 or own > NO_MATTER * sigma
            large += [name] if 0.0 < sigma < own / 0.3 else []
        notes = []
        if matters:
            forward = sum(1 for s in steps.values() if not s.central)
            shares = [steps[v.name].size / v.size for v in rows]
            kinds = ((forward, "forward"), (len(steps) - forward, "central"))
            how = ", ".join(f"{kind} for {count}" for count, kind in kinds if count)
            notes.append(
                f"its numerical noise is {share:.1g} of the spread of its outputs; derivatives by "
                f"differences over {min(shares):.1g} to {max(shares):.1g} of the scales, {how} of "
                f"{len(steps)} parameters"
            )
        if large:
            notes.append(
                "its numerical noise is not small compared with that of the sensor of "
                f"{', '.join(large)}: reduce its tolerances"
            )
        return notes

    def _run(self, record: Record, values: dict[str, float], start: Array | None = None) -> Run:
        """Run of a record. ``start``: values of the states; None: those that are expected."""
        del start
        return Run.of(record, self.inputs, values)

    def simulate(self, record: Record, jobs: Jobs) -> Array:
        """See :class:`~unmodeled.fit.Model`."""
        return self.simulate_all([(record, jobs)])[0]

    def simulate_all(self, batches: Sequence[Batch]) -> list[Array]:
        """Simulate batches; equal runs are computed once."""
        self._check_batches(batches)
        runs = []
        for record, jobs in batches:
            table = np.hstack([jobs.theta, jobs.magnitudes]) if jobs.included else jobs.theta
            runs += [
                self._run(record, self._values(row, jobs.included), start)
                for row, start in zip(table, jobs.starts, strict=True)
            ]
        seen = iter(self._runner.values(runs))
        return [np.array([next(seen) for _ in range(jobs.count)]) for _, jobs in batches]

    def _values(self, row: Array, included: tuple[Candidate, ...]) -> dict[str, float]:
        count = len(self.parameters)
        values = self._point(row[:count])
        for candidate, magnitude in zip(included, row[count:], strict=True):
            if candidate.effect.data not in values:
                raise InvalidParameter(
                    f"effect {candidate.name}: its data is {candidate.effect.data!r}, expected the "
                    f"name of a parameter of model {self.name}: {', '.join(values)}"
                )
            values[candidate.effect.data] += float(magnitude)
        return values

    def _offsets(self, of: Parameter | Effect, at: float) -> tuple[tuple[float, float], ...]:
        # With the steps chosen for the noise of the function.
        if isinstance(of, Parameter):
            name, scale, low, high = of.name, of.size, of.lower, of.upper
        else:
            name, scale, (low, high) = str(of.data), of.scale, of.bounds
        if name in self._jumps and at == 0.0:  # a small one tells nothing of a usual one
            side = scale if scale <= high else -scale
            return ((side, 1.0 / side),)
        step = self._steps.get(name) or Step(TRIAL * scale, central=True)
        return step.offsets(at, low, high)


@matched.register
def match_simulator(model: Simulator, records: Sequence[Record]) -> Ready:
    """Channels that are not stated are found by one run."""
    if not any(model.open) or not records:
        return with_same_channels(model, records)
    first = records[0]
    asked = _Asked({**first.outputs, **first.inputs}, first.name)
    point = _Stated(model._point([p.value for p in model.parameters]))
    with calling(f"model {model.name}: its function"), np.errstate(all="ignore"):
        given = model.function(first.time.copy(), asked, point)
    if not isinstance(given, Mapping):
        raise InvalidParameter(
            f"model {model.name}: its function returned {type(given).__name__}, expected a "
            'dictionary of arrays by output, such as {"x": x}'
        )
    out = copy.copy(model)
    if model.open[1]:
        out.outputs = _shown(model, given, records)
    if model.open[0]:
        read = asked.read if asked.whole is False else dict.fromkeys(first.inputs)
        if wrong := [n for n in read if n in out.outputs]:
            raise InvalidParameter(
                f"model {model.name}: its function reads {', '.join(wrong)}, which it also "
                "returns: a measured output must not be used"
            )
        out.inputs = tuple(read)
    out.open = False, False
    out._runner = out.new_runner()
    if not asked.whole:
        columns = {n: {**first.outputs, **first.inputs}[n] for n in out.inputs}
        out._runner.took(Run(first.name, first.time, columns, dict(point)), given)
    return matched(out, records)


def _shown(
    model: Simulator, given: Mapping[str, Any], records: Sequence[Record]
) -> tuple[str, ...]:
    """What the function returns and the records show."""
    shown = dict.fromkeys(n for r in records for n in r.outputs)
    found = tuple(n for n in given if n in shown)
    if not found:
        raise InvalidParameter(
            f"model {model.name}: its function returns {', '.join(map(str, given))}, and the "
            f"records show {', '.join(shown)}: expected the same names (--column NAME=COLUMN, "
            "in Python columns of ReadOptions, renames a column)"
        )
    return found


@by_means.register
def _(model: Simulator, means: Means) -> Simulator:
    given = {k: v for k, v in vars(means).items() if v is not None}
    out = copy.copy(model)
    out._means = replace(model._means, **given)
    out._runner = out.new_runner()
    out._ready = False
    return out


@cached.register
def _(model: Simulator) -> str:
    found, made = model._runner.found, model._runner.made
    return f"{found} of {found + made} runs from the cache {model._means.cache}" if found else ""


@resumed.register
def _(model: Simulator) -> str:
    if model._means.cache is None:
        return (
            "nothing is kept, and the same command begins anew; with --cache FOLDER, in Python "
            "cache=, finished runs are kept, and it goes on from them"
        )
    return (
        f"the finished runs are kept in {model._means.cache}, and the same command goes on from "
        "them"
    )


@numbers.register
def numbers_of_simulator(
    model: Simulator, theta: Array, included: Sequence[Candidate], magnitudes: Array
) -> tuple[dict[str, float], dict[str, float]]:
    """Arguments of the function, and magnitudes of the effects that are no arguments."""
    check_shapes(model, included, {"theta": theta, "magnitudes": magnitudes})
    own = [c for c in included if c.effect.data in model._names]
    sizes = dict(zip((c.name for c in included), map(float, magnitudes), strict=True))
    row = np.array([*theta, *(sizes.pop(c.name) for c in own)])
    return model._values(row, tuple(own)), sizes


# ----------------------------------------------------------------------- numerical noise and steps


#: Smallest noise relative to the spread of the outputs: rounding.
ROUNDING = float(np.finfo(float).eps)
#: Permitted relative error of a derivative by forward differences.
GOOD = 0.02
#: Smallest and largest step relative to the scale of the parameter.
SMALLEST, LARGEST = 1e-5, 0.3


@dataclass(frozen=True)
class Step:
    """Step of a finite difference by one parameter."""

    size: float
    """[unit of the parameter]"""
    central: bool

    def offsets(self, at: float, low: float, high: float) -> tuple[tuple[float, float], ...]:
        """Changes of the parameter within its limits, and their weights in the derivative."""
        h = self.size
        if not self.central:
            side = h if at + h <= high else -h
            return ((side, 1.0 / side),)
        return difference_offsets(at, h, low, high)


def spread_of(outputs: Array) -> Array:
    """Standard deviation of each output over time; of a constant one, its size (1 if it is 0)."""
    spread, size = np.std(outputs, axis=0), np.abs(outputs).max(axis=0, initial=0.0)
    size[size == 0.0] = 1.0
    # The mean of equal numbers differs from them by rounding.
    return np.asarray(np.where(spread > len(outputs) * ROUNDING * size, spread, size))


def noise_of_function(values: Array) -> float:
    """Standard deviation of the noise of equally spaced values, (m + 1, ...), by ECnoise.

    Differences of a smooth function decrease with their order, but those of noise do not: order k
    has the variance sigma^2 (2k)! / (k!)^2. The result is taken from the first order at which three
    estimates agree within a factor of four (J. J. More and S. M. Wild, "Estimating computational
    noise", SIAM J. Sci. Comput. 33, 2011); all outputs and samples are averaged. If no estimates
    agree, the function is still smooth at the last order, and the result is an upper limit.
    """
    table, gamma, sigmas = values, 1.0, []
    for k in range(1, len(values)):
        table = np.diff(table, axis=0)
        gamma *= 0.5 * k / (2 * k - 1)
        sigmas.append(math.sqrt(gamma * float(np.mean(table**2))))
    for i in range(len(sigmas) - 2):
        three = sigmas[i : i + 3]
        if max(three) <= 4.0 * min(three):
            return max(sigmas[i], ROUNDING)
    return max(sigmas[-1], ROUNDING)


def choose_step(
    base: Array, near: Array, far: Array, step: float, noise: float, scale: float, both: bool
) -> Step:
    """Step with the smallest error, from values at 0, ``step``, -``step`` (or 2 ``step``).

    A forward difference has the error 2 noise / h + h |f''| / 2, which is smallest at h = 2
    sqrt(noise / |f''|). A central difference has the error noise / h + h^2 |f'''| / 6, where |f'''|
    is estimated as |f''|^2 / |f'|.
    """
    if not (np.all(np.isfinite(near)) and np.all(np.isfinite(far))):
        return Step(0.1 * abs(step), central=True)

    def norm(x: Array) -> float:
        return float(np.sqrt(np.mean(x**2)))

    h = abs(step)
    slope = norm(near - far) / (2.0 * h) if both else norm(near - base) / h
    bend = norm(near - 2.0 * base + far) if both else norm(far - 2.0 * near + base)
    if slope == 0.0:
        return Step(h, central=True)
    bend = max(bend, 4.0 * noise) / h**2  # a change below the noise may still exist
    forward = float(np.clip(2.0 * math.sqrt(noise / bend), SMALLEST * scale, LARGEST * scale))
    if 2.0 * noise / forward + 0.5 * forward * bend <= GOOD * slope:
        return Step(forward, central=False)
    central = (3.0 * noise * slope / bend**2) ** (1.0 / 3.0)
    return Step(float(np.clip(central, SMALLEST * scale, LARGEST * scale)), central=True)


# --------------------------------------------------------------------- functions of single samples


@checked
class FunctionModel(Model):
    """Outputs that depend on the inputs at the same sample only, without memory.

    Parameters
    ----------
    outputs
        Name -> function ``(record, p) -> (n,)``; ``p.name`` is a parameter as a number.
    """

    cheap_derivatives = True
    any_inputs = True

    def __init__(
        self,
        *,
        outputs: Mapping[str, Callable[[Record, Named], Array]],
        parameters: Sequence[Parameter],
        name: str = "model",
    ):
        self.name = name
        self.parameters = tuple(parameters)
        self.outputs = tuple(outputs)
        self._outputs = dict(outputs)

    def states(self, included: Sequence[Candidate] = ()) -> tuple[State, ...]:
        """The model has no states."""
        del included
        return ()

    def accepts(self, effect: Effect) -> bool:
        """Whether an effect has a ``regressor``, or is a sensor or input effect."""
        return effect.regressor is not None or super().accepts(effect)

    def whole(self, record: Record, theta: Array) -> Array:
        """Outputs of a whole record, (n, ny)."""
        check_shapes(self, (), {"theta": theta})
        p = Named({q.name: theta[i] for i, q in enumerate(self.parameters)})
        try:
            outputs: Array = np.column_stack([f(record, p) for f in self._outputs.values()])
        except KeyError as error:
            known = ", ".join(record.inputs) or "none"
            text = (
                f"model {self.name}: its functions raise KeyError: {error}; "
                f"the inputs of record {record.name} are {known}"
            )
            raise InvalidParameter("; ".join((text, *record.notes))) from error
        return outputs

    def simulate(self, record: Record, jobs: Jobs) -> Array:
        """See :class:`~unmodeled.fit.Model`."""
        columns: list[Array] = []
        for candidate in jobs.included:
            assert candidate.effect.regressor is not None
            with calling(f"effect {candidate.name}: its regressor"):
                column = candidate.effect.regressor(record, candidate.shape)
            columns.append(self._place(candidate, column))
        distinct, which = np.unique(jobs.theta, axis=0, return_inverse=True)
        outputs = np.array([self.whole(record, theta) for theta in distinct])[which.reshape(-1)]
        for k, column in enumerate(columns):
            outputs = outputs + jobs.magnitudes[:, k, None, None] * column
        return outputs

    def _place(self, candidate: Candidate, column: Any) -> Array:
        """Regressor of an effect as (n, ny), on the output ``effect.data`` or the only output."""
        values: Array = np.asarray(column, dtype=np.float64)
        if values.ndim == 2:
            return values
        output = (
            candidate.effect.data if isinstance(candidate.effect.data, str) else self.outputs[0]
        )
        if output not in self.outputs:
            raise InvalidParameter(
                f"effect {candidate.name}: {output!r} is no output of {self.name} "
                f"({', '.join(self.outputs)})"
            )
        out = np.zeros((values.size, len(self.outputs)))
        out[:, self.outputs.index(output)] = values
        return out


@checked
class LinearModel(FunctionModel):
    """One output that is linear in its parameters: y = sum over j of p_j column_j(record).

    Parameters
    ----------
    columns
        Name of a parameter -> function of the record that returns its column, (n,).

    Examples
    --------
    A line through the origin with a slope of 2, at three values of its input:

    >>> import numpy as np
    >>> from unmodeled import LinearModel, Parameter, Record
    >>> from unmodeled.fit import Jobs
    >>> slope = Parameter(name="k", value=2.0, sd=0.2)
    >>> line = LinearModel(output="y", columns={"k": lambda r: r.inputs["u"]}, parameters=[slope])
    >>> u = np.array([0.0, 1.0, 2.0])
    >>> record = Record(name="r", time=u, inputs={"u": u}, outputs={"y": u})
    >>> once = Jobs(theta=np.array([[2.0]]), starts=np.zeros((1, 0)))
    >>> line.simulate(record, once)[0, :, 0].tolist()
    [0.0, 2.0, 4.0]
    """

    def __init__(
        self,
        *,
        output: str,
        columns: Mapping[str, Callable[[Record], Array]],
        parameters: Sequence[Parameter] = (),
        name: str = "model",
    ):
        given = {p.name: p for p in parameters}
        unknown = sorted(set(given) - set(columns))
        if unknown:
            raise InvalidParameter(f"model {name}: parameter {', '.join(unknown)} has no column")
        ordered = [given.get(n, Parameter(name=n, value=0.0)) for n in columns]
        self.columns = dict(columns)

        def value(record: Record, p: Named) -> Array:
            total: Array = sum(
                (p[n] * np.asarray(f(record)) for n, f in self.columns.items()),
                np.zeros(record.samples),
            )
            return total

        super().__init__(outputs={output: value}, parameters=ordered, name=name)
