"""What is traced of equations: rates, outputs, effects and ports, each once."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from unmodeled.data import Array, Record
from unmodeled.errors import Error, InvalidParameter
from unmodeled.fit.calling import explained
from unmodeled.fit.coordinates import Named, Rate, values_of
from unmodeled.fit.model import BETWEEN, Candidate, Effect, State
from unmodeled.fit.tape import NotTraceable, Symbol, Tape, Traced

Key = tuple[Any, ...]
Push = Callable[[Any, Any, Named, Named, Named], Mapping[str, Any]]


@dataclass(frozen=True, eq=False)
class System:
    """What the integration needs of a model of equations."""

    name: str
    states: tuple[State, ...]
    rates: Callable[[Any, Named, Named, Named], Any]
    outputs: Mapping[str, str | Rate | Callable[[Any, Named, Named, Named], Any]]
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    ports: Mapping[str, Push]
    """Rates of states that an unknown force at a port causes."""
    hold: str
    method: str
    substeps: int

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the states."""
        return tuple(s.name for s in self.states)

    def all_states(self, included: Sequence[Candidate]) -> tuple[State, ...]:
        """States, followed by the hidden states of effects."""
        return self.states + tuple(h for t in included for h in t.effect.hidden)


@dataclass(frozen=True)
class Form:
    """An effect and the parts of its shape that are no floats: what its tape depends on."""

    effect: Effect
    text: str
    numbers: int
    """Number of floats of the shape, which are inputs of the tape."""


@dataclass(frozen=True)
class ProgramKind:
    """What simulations have in common that are one program."""

    parameters: tuple[str, ...]
    between: bool
    implicit: bool
    included: tuple[Form, ...] = ()
    forces: bool = False
    derivatives: bool = False
    candidates: tuple[Form, ...] = ()
    by_theta: tuple[int, ...] = ()
    by_starts: bool = False
    changes: tuple[tuple[str, ...], ...] = ()
    """Inputs of each change of the inputs."""
    turned: tuple[int, ...] = ()
    """Effect of each change of a shape."""


@dataclass
class Traces:
    """What was traced of a system, and its programs; copies of a model share it.

    A pickled one is empty.
    """

    effects: dict[tuple[Effect, str], Traced | NotTraceable] = field(default_factory=dict)
    programs: dict[ProgramKind, Any] = field(default_factory=dict)
    own: Traced | NotTraceable | None = None
    ports: dict[str, Traced] = field(default_factory=dict)
    signals: WeakKeyDictionary[Record, dict[Any, Array]] = field(default_factory=WeakKeyDictionary)
    """Signals of records between their samples, as long as the records exist."""

    def __reduce__(self) -> Any:
        return Traces, ()


# ------------------------------------------------------------------------------------- tracing


def untraced(system: System, traces: Traces, effects: Sequence[Effect] = ()) -> list[str]:
    """Sentences about functions that cannot be traced, with their lines."""
    found = [("its rates and outputs", own_trace(system, traces))]
    for effect in effects:
        if effect.rate is not None:
            form = form_of(system, traces, Candidate(effect, effect.shapes[0]))
            found.append((f"effect {effect.name}", traces.effects[effect, form.text]))
    return [
        f"model {system.name}: {what} cannot be traced: {t}; they run as functions of Python, "
        "which takes longer"
        for what, t in found
        if isinstance(t, NotTraceable)
    ]


def _twice(of: Callable[[], Traced], what: str) -> Traced | NotTraceable:
    """The trace of a function; the reason if it cannot be traced.

    Raises
    ------
    InvalidParameter
        Two calls differ, or the values are of no use.
    """
    try:
        with np.errstate(all="ignore"):
            one, other = of(), of()
    except Error:
        raise
    except NotTraceable as error:
        return NotTraceable(explained(error).removeprefix("NotTraceable: "))
    except Exception as error:
        return NotTraceable(explained(error))
    if one.tape.nodes != other.tape.nodes or one.values != other.values:
        raise InvalidParameter(
            f"{what} differ between two equal calls: expected a function of its arguments alone, "
            "without random numbers, counters or other states of its own"
        )
    return one


def own_trace(system: System, traces: Traces) -> Traced | NotTraceable:
    """Trace of rates and outputs."""

    def trace() -> Traced:
        tape = Tape()
        t, x, u, p = _arguments(system, tape)
        named = [("rate", n) for n in system.names]
        nodes = tape.called(lambda: dict(zip(named, rates_of(system, t, x, u, p), strict=True)))
        for name, of in system.outputs.items():
            if not isinstance(of, str | Rate):
                shown = functools.partial(of, t, x, u, p)
                nodes |= tape.called(lambda n=name, y=shown: {("output", n): y()})  # type: ignore[misc]
        return Traced.of(tape, nodes)

    if traces.own is None:
        traces.own = _twice(trace, f"model {system.name}: its rates or outputs")
    return traces.own


def _arguments(system: System, tape: Tape) -> tuple[Symbol, Named, Named, Named]:
    """Symbols of time, states, inputs and parameters."""

    def named(kind: str, names: Sequence[str]) -> Named:
        return Named({n: tape.input((kind, n)) for n in names})

    return (
        tape.input(("t",)),
        named("x", system.names),
        named("u", system.inputs),
        named("p", [n for n in system.parameters if not n.startswith(BETWEEN)]),
    )


def form_of(system: System, traces: Traces, candidate: Candidate) -> Form:
    """Form of a candidate, whose effect is then traced."""
    effect, shape = candidate.effect, candidate.shape
    parts = shape if isinstance(shape, tuple) else (shape,)
    floats = [v for v in parts if isinstance(v, float)]
    free = repr(tuple("float" if isinstance(v, float) else v for v in parts))
    known = traces.effects.get((effect, free))
    if floats and not isinstance(known, NotTraceable):
        if known is None:
            known = traces.effects[effect, free] = _effect(system, candidate, symbols=True)
        if isinstance(known, Traced):
            return Form(effect, free, len(floats))
    text = repr(shape)
    if (effect, text) not in traces.effects:
        traces.effects[effect, text] = _effect(system, candidate, symbols=False)
    return Form(effect, text, 0)


def floats_of(form: Form, shape: Any) -> list[float]:
    """Numbers of a shape that are inputs of the tape."""
    parts = shape if isinstance(shape, tuple) else (shape,)
    return [v for v in parts if isinstance(v, float)] if form.numbers else []


def _effect(system: System, candidate: Candidate, symbols: bool) -> Traced | NotTraceable:
    """Trace of the rate of an effect."""
    check_names(system, candidate)

    def trace() -> Traced:
        tape, shape = Tape(), candidate.shape
        t, x, u, p = _arguments(system, tape)
        if symbols:
            parts = list(shape) if isinstance(shape, tuple) else [shape]
            places = [i for i, v in enumerate(parts) if isinstance(v, float)]
            for k, i in enumerate(places):
                parts[i] = tape.input(("shape", k))
            shape = tuple(parts) if isinstance(shape, tuple) else parts[0]
        hidden = {h.name: tape.input(("x", h.name)) for h in candidate.effect.hidden}
        seen = Named({**values_of(x), **hidden})
        size = tape.input(("size",))

        def changes() -> dict[Any, Any]:
            found = changes_of(candidate, t, seen, u, p, size, shape)
            return {("rate", n): v for n, v in found.items()}

        return Traced.of(tape, tape.called(changes))

    return _twice(trace, f"effect {candidate.name}: its rates")


def port_trace(system: System, traces: Traces, name: str) -> Traced:
    """Trace of the rates that a force at a port causes."""
    if name not in traces.ports:
        tape = Tape()
        t, x, u, p = _arguments(system, tape)
        pushed = system.ports[name](tape.input(("force",)), t, x, u, p)
        nodes = {("rate", n): tape.of(v) for n, v in pushed.items()}
        traces.ports[name] = Traced.of(tape, nodes)
    return traces.ports[name]


# ----------------------------------------------------------------------------- calls of functions


def rates_of(system: System, t: Any, x: Named, u: Named, p: Named) -> tuple[Any, ...]:
    """Rates of the model, one for each state."""
    found = tuple(system.rates(t, x, u, p))
    if len(found) != len(system.states):
        raise InvalidParameter(
            f"model {system.name}: rates returned {len(found)} values, expected one for "
            f"each state: {', '.join(system.names)}"
        )
    return found


def changes_of(
    candidate: Candidate,
    t: Any,
    x: Named,
    u: Named,
    p: Named,
    size: Any,
    shape: Any,
) -> Mapping[str, Any]:
    """Changes of the rates by an effect, by name of the state."""
    effect: Any = candidate.effect
    change = effect.rate(t, x, u, p, size, shape)
    if not isinstance(change, Mapping):
        raise InvalidParameter(
            f"effect {effect.name}: rate returned {type(change).__name__}, expected a "
            "dictionary of rates by name of the state"
        )
    for name in change:
        if name not in x:
            raise InvalidParameter(
                f"effect {effect.name}: rate changes {name!r}, which is no state; known are "
                f"{', '.join(values_of(x))}"
            )
    return change


def check_names(system: System, candidate: Candidate) -> None:
    """Refuse hidden states with the name of a state of the model."""
    taken = [h.name for h in candidate.effect.hidden if h.name in system.names]
    if taken:
        raise InvalidParameter(
            f"effect {candidate.name}: its hidden state {taken[0]!r} has the name "
            f"of a state of model {system.name}; rename one of them"
        )


def traced_of(of: Traced | NotTraceable) -> Traced:
    """A trace, which is known to be one."""
    if isinstance(of, NotTraceable):
        raise of
    return of


def untraced_reason(system: System, traces: Traces, forms: Sequence[Form]) -> NotTraceable | None:
    """Why simulations with effects cannot be traced; None: they can."""
    for traced in (own_trace(system, traces), *(traces.effects[f.effect, f.text] for f in forms)):
        if isinstance(traced, NotTraceable):
            return traced
    return None
