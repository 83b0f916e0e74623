"""Parameters and unknown effects of a model from short forms: ``{"mass": (2.0, 0.1, "kg")}``."""

from __future__ import annotations

import math
from collections.abc import (
    Callable,
    Collection,
    Generator,
    Iterable,
    Mapping,
    Sequence,
)
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeVar

import numpy as np

from unmodeled.arguments import checked
from unmodeled.data import Array, Record
from unmodeled.errors import InvalidParameter, near_names
from unmodeled.models.model import Candidate, Effect, Model, Parameter, prior_jobs
from unmodeled.units import conversion_factor, same_unit, spelled_unit, stays_beside, to_si

V = TypeVar("V")
#: Parameters with their priors: ``(value, sd, unit)`` by name, or a list of :class:`Parameter`.
Priors = Sequence[Parameter] | Mapping[str, Any]
#: Effects that are parameters: unit, ``(value without it, expected size, unit)``,
#: :class:`Exposed`, or an :class:`Effect`.
Unknowns = Mapping[str, Any] | None
#: Lower and upper bound by name.
Bounds = Mapping[str, Any] | None


@checked
@dataclass(frozen=True, kw_only=True)
class Exposed:
    """An effect that is a parameter of the function, with its neutral value in the model."""

    scale: float
    """Expected deviation from the neutral value if the effect exists [unit]."""
    unit: str = "1"
    component: str = ""
    """Part of the machine; default: the name of the parameter."""
    sign: Literal[-1, 0, 1] = 0
    """+1: only values >= the neutral one; -1: only values <= the neutral one; 0: any."""
    neutral: float = 0.0
    """Value without the effect [unit]."""
    mechanism: str = ""
    """One sentence that describes the mechanism in the machine."""
    remedy: str = ""
    """Recommended remedy."""
    lower: float = -math.inf
    upper: float = math.inf
    """Upper limit of the parameter [unit]."""

    def effect(self, name: str) -> Effect:
        """The effect; its magnitude is the deviation from the neutral value."""
        return Effect(
            name=name,
            component=self.component or name,
            unit=self.unit,
            scale=self.scale,
            sign=self.sign,
            mechanism=self.mechanism,
            remedy=self.remedy,
            lower=self.lower - self.neutral,
            upper=self.upper - self.neutral,
            data=name,
        )


@dataclass(frozen=True)
class Stated:
    """What a model states about the numbers of its function, in the units that it gets."""

    parameters: tuple[Parameter, ...]
    effects: tuple[Effect, ...]
    """Effects that are numbers of the function."""
    neutral: dict[str, float]
    """Value of each of these numbers without the effect [its unit]."""
    unsized: frozenset[str]
    """Those whose expected size is not stated."""
    notes: tuple[str, ...]
    """What the function gets where a number was converted."""
    converted: dict[str, tuple[float, str]]
    """Factor and stated unit of the converted parameters."""
    units: dict[str, str]
    """Units of inputs and outputs, by name."""


def stated(
    function: Callable[..., Any],
    parameters: Priors,
    unknown: Unknowns,
    bounds: Bounds,
    model: str,
    channels: Mapping[str, str],
    states: Sequence[str] = (),
) -> Stated:
    """Parameters and unknown effects of a function, converted to the units that it wants.

    A stated unit is the unit of the number, and of its bounds. A unit that is made of those of
    ``channels``, by name, and of ``states`` is kept, so that both sides of an equation have it.
    Otherwise the function gets SI units. Its attribute ``units``, by name, states another unit.
    Its attribute ``values`` has values that need not be stated, and ``limits`` has bounds, both in
    the units that it gets.

    Raises
    ------
    InvalidParameter
        A form is wrong, a unit is unknown or measures another quantity, bounds belong to no
        parameter, or a parameter has another unit than a channel or a state of the same quantity.
    """
    unknown = unknown or {}
    names = [*(p if isinstance(p, str) else p.name for p in parameters), *unknown]
    for name in bounds or {}:
        if name not in names:
            raise InvalidParameter(
                f"model {model}: bounds of {name}, which is no parameter{near_names(name, names)}; "
                f"there are {', '.join(names) or 'none'}"
            )
    own = getattr(function, "units", {})
    channels = {**{n: unit for n, unit in own.items() if unit and n not in names}, **channels}
    reader = _Reader(function, bounds or {}, {*channels.values(), *states} - {"", "1"})
    if isinstance(parameters, Mapping):
        found = [reader.parameter(n, p) for n, p in parameters.items()]
    else:
        found = [reader.limited(p) for p in parameters]
    effects = [reader.unknown(n, u) for n, u in unknown.items()]
    reader.refuse_mixtures(model)
    return Stated(
        tuple(found),
        tuple(effects),
        reader.neutral,
        frozenset(reader.unsized),
        reader.notes,
        reader.converted,
        channels,
    )


def in_si(model: Model, function: Callable[..., Any], records: Sequence[Record]) -> list[str]:
    """A note about the channels in SI units, because the model states no unit of them.

    Raises
    ------
    InvalidParameter
        Such a channel measures what a state or another channel measures in another unit.
    """
    channels = (*model.inputs, *model.outputs)
    known = {n: u for r in records for n, u in r.units.items() if n in channels}
    told = {n: u for n, u in known.items() if u not in ("", "1") and not model.units.get(n)}
    if not told:
        return []
    first = next(iter(told))
    others = {s.name: s.unit for s in model.states()} | {n: model.units.get(n, "1") for n in known}
    for name, unit in told.items():
        for other, stated in others.items():
            if stated != "1" and not same_unit(stated, unit) and _convertible(stated, unit):
                raise InvalidParameter(
                    f"model {model.name}: {name} has no stated unit and is read in {unit}, beside "
                    f"{other} in {stated}: expected the unit that the equations take, "
                    f"{_named(function)}.units = {{{name!r}: {stated!r}}} or {{{name!r}: {unit!r}}}"
                )
    listed = ", ".join(f"{n} in {u}" for n, u in told.items())
    return [
        f"its function gets and returns {listed}; its attribute units, such as "
        f"{_named(function)}.units = {{{first!r}: 'UNIT'}}, states other units"
    ]


def _named(function: Callable[..., Any]) -> str:
    called = getattr(function, "__name__", "")
    return called if called.isidentifier() else "function"


def _convertible(unit: str, other: str) -> bool:
    try:
        return bool(conversion_factor(unit, other))
    except InvalidParameter:
        return False


#: Fields of a parameter and of effects that have its unit.
_OF_PARAMETER = ("value", "sd", "lower", "upper", "scale", "process_sd")
_OF_EXPOSED = ("scale", "neutral", "lower", "upper")
_OF_EFFECT = ("scale", "lower", "upper")
_ABOUT = "\N{PLUS-MINUS SIGN}"


def _numbers(values: Iterable[Any]) -> bool:
    return all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)


class _Reader:
    """Reads short forms into the units that a function gets."""

    def __init__(
        self, function: Callable[..., Any], bounds: Mapping[str, Any], beside: Collection[str]
    ):
        self._units: Mapping[str, str] = getattr(function, "units", {})
        self._values: Mapping[str, float | None] = getattr(function, "values", {})
        self._limits: Mapping[str, tuple[float, float]] = getattr(function, "limits", {})
        self._file = bool(self._values)
        """Whether a file states its units: an FMU, a MuJoCo model."""
        self._named = _named(function)
        self._bounds = bounds
        self._beside = () if self._file else beside
        self._kept: dict[str, str] = {}
        self._mixed: dict[str, tuple[str, str]] = {}
        self._first = self._unit = ""
        self._told: list[str] = []
        self.neutral: dict[str, float] = {}
        self.unsized: set[str] = set()
        self.converted: dict[str, tuple[float, str]] = {}

    def _factor(self, name: str, unit: str) -> tuple[float, str]:
        """Factor from a stated unit to that which the function gets, and this unit."""
        wanted = self._units.get(name, "")
        if unit in ("", "1") or unit == wanted:  # a plain number has the unit of the function
            return 1.0, wanted or "1"
        try:
            read = spelled_unit(unit) or unit
            factor, si = (conversion_factor(read, wanted), wanted) if wanted else to_si(read)
        except InvalidParameter as error:
            raise InvalidParameter(f"parameter {name}: {error}") from None
        if not wanted and factor != 1.0:
            stays = stays_beside(read, self._beside)
            if stays:
                self._kept[name] = unit
                return 1.0, unit
            if stays is None:
                self._mixed[name] = unit, si
        return factor, unit if factor == 1.0 and not wanted else si

    def _range(self, name: str, factor: float) -> tuple[float, float]:
        """Bounds in the unit that the function gets."""
        if name not in self._bounds:
            return self._limits.get(name, (-math.inf, math.inf))
        given = self._bounds[name]
        pair = tuple(given) if isinstance(given, list | tuple) else ()
        if len(pair) != 2 or not _numbers(pair) or not pair[0] <= pair[1]:
            raise InvalidParameter(f"bounds of {name}: got {given!r}, expected (lowest, highest)")
        return factor * float(pair[0]), factor * float(pair[1])

    def parameter(self, name: str, prior: Any) -> Parameter:
        """A parameter: ``(value, sd, unit)``, ``(value, sd)``, or a value without a prior.

        A value None is that of the function, of which a standard deviation in % is a share.
        """
        parts = [*prior] if isinstance(prior, list | tuple) else [prior]
        unit = parts[2] if len(parts) == 3 else "1"
        own = self._values.get(name) if parts and parts[0] is None else None
        if own and unit == "%" and self._units.get(name) != "%" and _numbers(parts[1:2]):
            parts[1], unit = 0.01 * parts[1] * abs(own), ""  # a share of the value of the file
        numbers = [*parts[:2]] if own is None else [own, *parts[1:2]]
        if not 1 <= len(parts) <= 3 or not _numbers(numbers) or not isinstance(unit, str):
            raise InvalidParameter(
                f"parameter {name}: got {prior!r}, expected (value, standard deviation, unit), "
                "such as (2.0, 0.1, 'kg'); sd 0 fixes it"
            )
        factor, got = self._factor(name, unit)
        value, sd = float(numbers[0]), float(numbers[1]) if len(numbers) > 1 else math.inf
        if own is None:
            self._tell(name, "=", factor, value, unit, got)
            value *= factor
        else:
            self._tell(name, _ABOUT, factor, sd, unit, got)
        low, high = self._range(name, factor)
        return Parameter(name=name, value=value, sd=factor * sd, unit=got, lower=low, upper=high)

    def limited(self, p: Parameter) -> Parameter:
        """A parameter within the bounds."""
        factor, _ = self._factor(p.name, p.unit)
        low, high = self._range(p.name, factor)
        p = self._converted(p.name, p, _OF_PARAMETER)
        return replace(p, lower=max(p.lower, low), upper=min(p.upper, high))

    def unknown(self, name: str, item: Any) -> Effect:
        """An effect: its unit, ``(value without it, size, unit)``, :class:`Exposed` or an effect.

        A value None is that of the function, or 0.
        """
        if isinstance(item, Exposed):
            own: Exposed = self._converted(name, item, _OF_EXPOSED)
            self.neutral[name] = own.neutral
            return own.effect(name)
        if isinstance(item, Effect):
            self.neutral[name] = 0.0
            effect: Effect = self._converted(name, item, _OF_EFFECT)
            return replace(effect, data=name)
        parts = (None, 0.0, item) if isinstance(item, str) else item
        parts = tuple(parts) if isinstance(parts, list | tuple) else ()
        right = len(parts) == 3 and _numbers(parts[parts[0] is None : 2])
        right = right and isinstance(parts[2], str) and 0.0 <= parts[1] < math.inf
        if not right or not math.isfinite(parts[0] or 0.0):
            raise InvalidParameter(
                f"unknown {name}: got {item!r}, expected its unit, such as 'N', or (value without "
                "the effect, expected size, unit)"
            )
        at, size, unit = parts
        factor, got = self._factor(name, unit)
        self._tell(name, _ABOUT, factor, size, unit, got)
        at = (self._values.get(name) or 0.0) if at is None else factor * at
        low, high = (b - at for b in self._range(name, factor))
        if not low <= 0.0 <= high:
            raise InvalidParameter(f"bounds of {name}: they do not hold {at:g}, the value without")
        self.neutral[name] = float(at)
        if not size:
            self.unsized.add(name)
        return Effect(
            name=name,
            component=name,
            unit=got,
            scale=factor * size or 1.0,
            lower=low,
            upper=high,
            data=name,
        )

    def _converted(self, name: str, item: Any, fields: Sequence[str]) -> Any:
        """A parameter or an effect with its numbers in the unit that the function gets."""
        factor, got = self._factor(name, item.unit)
        if factor == 1.0:
            return item if got == item.unit else replace(item, unit=got)
        self._tell(name, "=", factor, getattr(item, fields[0]), item.unit, got)
        sizes = {f: v if (v := getattr(item, f)) is None else factor * v for f in fields}
        return replace(item, unit=got, **sizes)

    def _tell(self, name: str, mark: str, factor: float, size: float, unit: str, got: str) -> None:
        if factor != 1.0:
            text = f"{mark} {factor * size:.6g} {got} ({size:.6g} {unit})"
            self._told.append(f"{name} {text if size else f'in {got} (not {unit})'}")
            self._first, self._unit = name, unit
        if mark == "=" and factor != 1.0 and not self._file:
            self.converted[name] = factor, unit

    def refuse_mixtures(self, model: str) -> None:
        """Refuse parameters in other units than the states that measure the same quantity."""
        if not self._mixed:
            return
        one, two = ({n: pair[k] for n, pair in self._mixed.items()} for k in (0, 1))
        raise InvalidParameter(
            f"model {model}: parameters in {', '.join(dict.fromkeys(one.values()))} beside states, "
            f"inputs or outputs in {', '.join(sorted(self._beside))}: expected the same units, or "
            f"those that the equations take, {self._named}.units = {one} or {two}"
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """What the function gets where a number was converted, or kept in another unit than SI."""
        kept = ", ".join(f"{n} in {unit}" for n, unit in self._kept.items())
        told = (f"units: the function gets {kept}, like its states, inputs or outputs",) * bool(
            kept
        )
        return (*told, *self._conversions())

    def _conversions(self) -> tuple[str, ...]:
        if not self._told:
            return ()
        how = (
            f"; an attribute of it, such as {self._named}.units = {{{self._first!r}: "
            f"{self._unit!r}}}, states another unit"
        )
        return (f"units: the function gets {', '.join(self._told)}{how * (not self._file)}",)


# ------------------------------------------------------------------------------- sizes from trials


#: Smallest and largest expected change of the outputs, as shares of the motion [1]; number of
#: trials of a size.
LEAST, MOST, TRIALS = 0.01, 0.3, 12
#: Largest change of the outputs, as a share of the motion, that is none [1].
NONE = 1e-9


def sized(
    model: Model, effects: Sequence[Effect], which: Collection[str], records: Sequence[Record]
) -> tuple[tuple[Effect, ...], list[str]]:
    """Effects whose expected size changes the outputs as much as model and records differ.

    An effect that acts on one side only, or on both sides alike, gets a sign.

    ``which``: names of those without a size. Also returns a note about each that got one.
    """
    if not which:
        return tuple(effects), []
    record, base, unit, goal = wanted_change(model, records)
    chosen = [e for e in effects if e.name in which]
    found = _in_step(
        model,
        record,
        [(e, _with_size(e, record, _first(model, e, record), base, unit, goal)) for e in chosen],
    )
    by_name = {e.name: e for e, _ in found}
    return tuple(by_name.get(e.name, e) for e in effects), [note for _, note in found]


def wanted_change(model: Model, records: Sequence[Record]) -> tuple[Record, Array, Array, float]:
    """The record that moves most, the model in it, and the change that an expected size makes.

    The change is a share of the motion in the channel that changes most; ``unit``: the motion of
    each output.
    """
    record = max(records, key=lambda r: _motion(r, model.outputs))
    base = np.asarray(model.simulate(record, prior_jobs(model, record))[0])
    measured = record.output_array(model.outputs)
    spread = [float(np.std(y[np.isfinite(y)])) if np.isfinite(y).any() else 0.0 for y in measured.T]
    unit = np.where(np.array(spread) > 0.0, spread, np.maximum(np.std(base, axis=0), 1e-300))
    return record, base, unit, min(max(share_of(measured - base, unit), LEAST), MOST)


#: The search for a size, which yields those of its runs and gets their outputs; None: a run failed.
_Search = Generator[float, Array | None, V]


def _in_step(
    model: Model, record: Record, searches: Sequence[tuple[Effect, _Search[V]]]
) -> list[V]:
    """Results of searches; the runs of one step of all of them are one call of the model."""
    results: dict[int, V] = {}
    asked: dict[int, float] = {}

    def advance(i: int, value: Array | None) -> None:
        try:
            asked[i] = searches[i][1].send(value)
        except StopIteration as end:
            results[i] = end.value

    for i in range(len(searches)):
        advance(i, None)
    while asked:
        batches = [
            (record, prior_jobs(model, record, (Candidate(e, e.shapes[0]),), [size]))
            for e, size in ((searches[i][0], size) for i, size in asked.items())
        ]
        waiting, asked = list(asked), {}
        for i, run in zip(waiting, model.simulate_all(batches), strict=True):
            advance(i, run[0] if np.isfinite(run[0]).all() else None)
    return [results[i] for i in range(len(searches))]


def _motion(record: Record, names: Sequence[str]) -> float:
    return sum(float(np.nanvar(record.outputs[n])) for n in names if n in record.outputs)


def share_of(change: Array, unit: Array) -> float:
    """Rms of a change in the channel that changes most, as a share of its motion."""
    squares = np.where(np.isfinite(change), change / unit, 0.0) ** 2
    return float(np.sqrt(squares.mean(axis=0).max(initial=0.0)))


def _first(model: Model, effect: Effect, record: Record) -> float:
    """A size for the first trial: a tenth of an input or a parameter in the same unit."""
    sizes = [np.quantile(np.abs(v), 0.98) for n, v in record.inputs.items()
             if record.input_units.get(n, model.units.get(n)) == effect.unit]  # fmt: skip
    sizes += [abs(p.value) for p in model.parameters if p.unit == effect.unit]
    return 0.1 * float(max(sizes, default=0.0)) or 1.0


def _with_size(
    effect: Effect, record: Record, first: float, base: Array, unit: Array, goal: float
) -> _Search[tuple[Effect, str]]:
    low, high = effect.bounds
    side = 1.0 if high > 0.0 else -1.0
    best, size = yield from _search(effect, side, first, base, unit, goal)
    if best is None and low < 0.0 < high:
        side = -side
        best, size = yield from _search(effect, side, first, base, unit, goal)
    if best is None:
        return effect, f"{effect.name}: no size of it changes record {record.name}"
    why = ""
    if low < 0.0 < high:
        other = yield min(max(-side * size, low), high)
        if other is None or share_of(other - base, unit) < NONE:
            why = "fails" if other is None else "has no influence"
        elif share_of(other - best, unit) < NONE:
            why = "acts alike"
    if why:
        effect = replace(effect, sign=1 if side > 0.0 else -1)
        why = f", with one sign, since the other {why}"
    digits = float(f"{size:.2g}")
    return replace(effect, scale=digits), (
        f"{effect.name}: expected size {digits:g} {effect.unit}, from its influence on record "
        f"{record.name}{why}"
    )


def _search(
    effect: Effect,
    side: float,
    size: float,
    base: Array,
    unit: Array,
    goal: float,
) -> _Search[tuple[Array | None, float]]:
    """The size whose change is nearest to the goal, and the outputs with it."""
    low, high = effect.bounds
    best: Array | None = None
    at, distance = 0.0, math.inf
    for _ in range(TRIALS):
        y = yield min(max(side * size, low), high)
        share = math.nan if y is None else share_of(y - base, unit)
        if y is not None and share > NONE:
            far = abs(math.log(share / goal))
            if far < distance:
                best, at, distance = y, size, far
            if far < math.log(1.5):
                break
            size *= min(max(goal / share, 1e-2), 1e2)
        else:
            size *= 0.1 if y is None else 100.0
    return best, at
