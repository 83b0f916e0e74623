"""Parameters and unknown effects of a model from short forms: ``{"mass": (2.0, 0.1, "kg")}``."""

from __future__ import annotations

import math
from collections.abc import (
    Callable,
    Collection,
    Generator,
    Iterable,
    Iterator,
    Mapping,
    Sequence,
)
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeVar

import numpy as np

from unmodeled.arguments import checked
from unmodeled.data import Array, Record
from unmodeled.errors import InvalidParameter, near_names
from unmodeled.fit.model import Candidate, Effect, Model, Parameter, prior_jobs
from unmodeled.units import conversion_factor, spelled_unit, to_si

__all__ = [
    "Bounds",
    "Exposed",
    "Priors",
    "Stated",
    "Unknowns",
    "sized",
    "stated",
]

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


FORM = "expected (value, standard deviation, unit), such as (2.0, 0.1, 'kg'); sd 0 fixes it"


def _numbers(values: Iterable[Any]) -> bool:
    return all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)


def _range(name: str, bounds: Bounds) -> tuple[float, float]:
    given = (bounds or {}).get(name, (-math.inf, math.inf))
    pair = tuple(given) if isinstance(given, list | tuple) else ()
    if len(pair) != 2 or not _numbers(pair) or not pair[0] <= pair[1]:
        raise InvalidParameter(f"bounds of {name}: got {given!r}, expected (lowest, highest)")
    return float(pair[0]), float(pair[1])


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


def stated(
    function: Callable[..., Any],
    parameters: Priors,
    unknown: Unknowns,
    bounds: Bounds,
    model: str,
) -> Stated:
    """Parameters and unknown effects of a function, converted to the units that it wants.

    A stated unit is the unit of the number, and of its bounds. The function gets SI units, except
    where its attribute ``units``, by name, has another unit. Its attribute ``values`` has values
    that need not be stated, and ``limits`` has bounds, both in the units that it gets.

    Parameters
    ----------
    function
        Function of the model.
    parameters, unknown, bounds
        Short forms of a user.
    model
        Name of the model, for messages.

    Raises
    ------
    InvalidParameter
        A form is wrong, a unit is unknown or measures another quantity, or bounds belong to no
        parameter.
    """
    known = _Known(function)
    if isinstance(parameters, Mapping):
        parameters = {n: known.parameter(n, p) for n, p in parameters.items()}
    else:
        parameters = tuple(known.converted(p.name, p, _OF_PARAMETER) for p in parameters)
    unknown = {n: known.unknown(n, u) for n, u in (unknown or {}).items()}
    names = [*(p if isinstance(p, str) else p.name for p in parameters), *unknown]
    check_bounds(bounds, names, model)
    limits = known.limits(names, bounds)
    effects, neutral, unsized = unknown_effects(unknown, limits)
    return Stated(
        parameters_of(parameters, limits), effects, neutral, unsized, tuple(known.notes())
    )


#: Fields of a parameter and of effects that have its unit.
_OF_PARAMETER = ("value", "sd", "lower", "upper", "scale", "process_sd")
_OF_EXPOSED = ("scale", "neutral", "lower", "upper")
_OF_EFFECT = ("scale", "lower", "upper")


class _Known:
    """Units, values and limits that a function states, and what was converted to them."""

    def __init__(self, function: Callable[..., Any]):
        self._units: Mapping[str, str] = getattr(function, "units", {})
        self._values: Mapping[str, float | None] = getattr(function, "values", {})
        self._limits: Mapping[str, tuple[float, float]] = getattr(function, "limits", {})
        called = getattr(function, "__name__", "")
        self._named = called if called.isidentifier() else "function"
        self._first = self._unit = ""
        self._factors: dict[str, float] = {}
        self._told: list[str] = []

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
        self._factors[name] = factor
        return factor, unit if factor == 1.0 and not wanted else si

    def parameter(self, name: str, prior: Any) -> Any:
        """A short form of a parameter; a value None is that of the function."""
        parts = [*prior] if isinstance(prior, list | tuple) else [prior]
        unit = parts[2] if len(parts) == 3 else "1"
        right = 1 <= len(parts) <= 3 and _numbers(v for v in parts[:2] if v is not None)
        if not right or not isinstance(unit, str):
            return prior  # the reader of the form tells its fault
        factor, got = self._factor(name, unit)
        if factor != 1.0:
            at, mark = (1, "\N{PLUS-MINUS SIGN}") if parts[0] is None else (0, "=")
            self._tell(name, mark, factor, parts[at], unit, got)
            parts[:2] = [v if v is None else factor * v for v in parts[:2]]
        if parts[0] is None and (value := self._values.get(name)) is None:
            return prior
        parts[0] = value if parts[0] is None else parts[0]
        return (*parts[:2], *([math.inf] if len(parts) == 1 else []), got)

    def unknown(self, name: str, item: Any) -> Any:
        """A short form of an unknown effect; a value None is that of the function, or 0."""
        if isinstance(item, Exposed):
            return self.converted(name, item, _OF_EXPOSED)
        if isinstance(item, Effect):
            return self.converted(name, item, _OF_EFFECT)
        parts = (None, 0.0, item) if isinstance(item, str) else item
        if not isinstance(parts, list | tuple) or len(parts) != 3 or not isinstance(parts[2], str):
            return item
        at, size, unit = parts
        factor, got = self._factor(name, unit)
        if factor != 1.0 and _numbers(v for v in (at, size) if v is not None):
            self._tell(name, "\N{PLUS-MINUS SIGN}", factor, size, unit, got)
            at, size = at if at is None else factor * at, factor * size
        return (self._values.get(name) or 0.0) if at is None else at, size, got

    def converted(self, name: str, item: Any, fields: Sequence[str]) -> Any:
        """A parameter or an effect with its numbers in the unit that the function gets."""
        factor, got = self._factor(name, item.unit)
        if factor == 1.0:
            return item if got == item.unit else replace(item, unit=got)
        self._tell(name, "=", factor, getattr(item, fields[0]), item.unit, got)
        sizes = {f: v if (v := getattr(item, f)) is None else factor * v for f in fields}
        return replace(item, unit=got, **sizes)

    def _tell(self, name: str, mark: str, factor: float, size: float, unit: str, got: str) -> None:
        text = f"{mark} {factor * size:.6g} {got} ({size:.6g} {unit})"
        self._told.append(f"{name} {text if size else f'in {got} (not {unit})'}")
        self._first, self._unit = name, unit

    def limits(self, names: Sequence[str], bounds: Bounds) -> dict[str, tuple[float, float]]:
        """Bounds by name in the units that the function gets."""
        found = {n: self._limits[n] for n in names if n in self._limits}
        for n in bounds or {}:
            low, high = _range(n, bounds)
            factor = self._factors.get(n, 1.0)
            found[n] = factor * low, factor * high
        return found

    def notes(self) -> Iterator[str]:
        """What the function gets where a number was converted."""
        if self._told:
            yield (
                f"units: the function gets {', '.join(self._told)}; an attribute of it, such as "
                f"{self._named}.units = {{{self._first!r}: {self._unit!r}}}, states another unit"
            )


def check_bounds(bounds: Bounds, known: Sequence[str], model: str) -> None:
    """Refuse bounds of a name that is no parameter."""
    for name in bounds or {}:
        if name not in known:
            raise InvalidParameter(
                f"model {model}: bounds of {name}, which is no parameter{near_names(name, known)}; "
                f"there are {', '.join(known) or 'none'}"
            )


def parameters_of(given: Priors, bounds: Bounds = None) -> tuple[Parameter, ...]:
    """Parameters with their priors.

    Parameters
    ----------
    given
        Name -> ``(value, sd, unit)``, ``(value, sd)`` or a value without a prior; or parameters.
    bounds
        Name -> lowest and highest value.

    Raises
    ------
    InvalidParameter
        A prior has another form.
    """
    if not isinstance(given, Mapping):
        pairs = [(p, *_range(p.name, bounds)) for p in given]
        return tuple(
            replace(p, lower=max(p.lower, low), upper=min(p.upper, high)) for p, low, high in pairs
        )
    found = []
    for name, prior in given.items():
        parts = tuple(prior) if isinstance(prior, list | tuple) else (prior,)
        unit = parts[2] if len(parts) == 3 else "1"
        if not 1 <= len(parts) <= 3 or not _numbers(parts[:2]) or not isinstance(unit, str):
            raise InvalidParameter(f"parameter {name}: got {prior!r}, {FORM}")
        low, high = _range(name, bounds)
        sd = float(parts[1]) if len(parts) > 1 else math.inf
        found.append(
            Parameter(name=name, value=float(parts[0]), sd=sd, unit=unit, lower=low, upper=high)
        )
    return tuple(found)


def unknown_effects(
    given: Unknowns, bounds: Bounds = None
) -> tuple[tuple[Effect, ...], dict[str, float], frozenset[str]]:
    """Effects that are parameters of a function, their neutral values, and those without a size.

    Parameters
    ----------
    given
        Name -> unit, ``(neutral value, expected size, unit)`` or an effect.
    bounds
        Name -> lowest and highest value of the parameter.

    Raises
    ------
    InvalidParameter
        An item has another form.
    """
    effects, neutral, without = [], {}, set()
    for name, item in (given or {}).items():
        if isinstance(item, Exposed):
            effects.append(item.effect(name))
            neutral[name] = item.neutral
            continue
        if isinstance(item, Effect):
            effects.append(replace(item, data=name))
            neutral[name] = 0.0
            continue
        parts = (0.0, 0.0, item) if isinstance(item, str) else item
        parts = tuple(parts) if isinstance(parts, list | tuple) else ()
        right = len(parts) == 3 and _numbers(parts[:2]) and isinstance(parts[2], str)
        if not right or not 0.0 <= parts[1] < math.inf or not math.isfinite(parts[0]):
            raise InvalidParameter(
                f"unknown {name}: got {item!r}, expected its unit, such as 'N', or (value without "
                "the effect, expected size, unit)"
            )
        at, size, unit = parts
        low, high = (b - at for b in _range(name, bounds))
        if not low <= 0.0 <= high:
            raise InvalidParameter(f"bounds of {name}: they do not hold {at:g}, the value without")
        neutral[name] = float(at)
        if not size:
            without.add(name)
        effects.append(
            Effect(
                name=name,
                component=name,
                unit=unit,
                scale=size or 1.0,
                sign=1 if low == 0.0 else -1 if high == 0.0 else 0,
                lower=low,
                upper=high,
                data=name,
            )
        )
    return tuple(effects), neutral, frozenset(without)


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

    Parameters
    ----------
    model
        Model with all channels.
    effects
        Effects of the model.
    which
        Names of those without a size.
    records
        Measured runs.

    Returns
    -------
    The effects, and a note about each that got a size.
    """
    if not which:
        return tuple(effects), []
    record = max(records, key=lambda r: _motion(r, model.outputs))
    base = np.asarray(model.simulate(record, prior_jobs(model, record))[0])
    measured = record.output_array(model.outputs)
    spread = [float(np.std(y[np.isfinite(y)])) if np.isfinite(y).any() else 0.0 for y in measured.T]
    unit = np.where(np.array(spread) > 0.0, spread, np.maximum(np.std(base, axis=0), 1e-300))
    goal = min(max(_share(measured - base, unit), LEAST), MOST)
    chosen = [e for e in effects if e.name in which]
    found = _in_step(
        model,
        record,
        [(e, _with_size(e, record, _first(model, e, record), base, unit, goal)) for e in chosen],
    )
    by_name = {e.name: e for e, _ in found}
    return tuple(by_name.get(e.name, e) for e in effects), [note for _, note in found]


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


def _share(change: Array, unit: Array) -> float:
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
        if other is None or _share(other - base, unit) < NONE:
            why = "fails" if other is None else "has no influence"
        elif _share(other - best, unit) < NONE:
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
        share = math.nan if y is None else _share(y - base, unit)
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
