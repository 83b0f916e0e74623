"""What is traced of equations: rates, outputs, effects and ports, each once."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from unmodeled.data import Array, Record
from unmodeled.errors import Error, InvalidParameter
from unmodeled.models.coordinates import Named, Rate, values_of
from unmodeled.models.model import BETWEEN, Candidate, Effect, State
from unmodeled.ode.calling import explained, line_of
from unmodeled.ode.reads import Words
from unmodeled.ode.tape import Kept, Node, NotTraceable, Tape, Traced

Key = tuple[Any, ...]
#: Key of the functions of a model, among those of effects.
OWN = "own"
#: Values by key of the inputs of a tape.
Values = Mapping[Key, Any]
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
    points: Mapping[Key, Array] | None = None
    """Values at which functions are compared with their traces, (points,)."""
    compared: dict[Any, tuple[bool, ...]] = field(default_factory=dict)
    """Whether the functions of a system, an effect or a port give with arrays of all jobs what they
    give with numbers; absent: not compared yet."""
    read: dict[Any, tuple[Mapping[Any, Words], frozenset[Any]]] = field(default_factory=dict)
    """What they read beside their arguments, and the places that they write, by the same keys."""

    def __reduce__(self) -> Any:
        return Traces, ()

    def forget(self) -> None:
        """Trace and compare anew: a function reads other values now."""
        self.own = None
        for known in (self.effects, self.programs, self.ports, self.compared, self.read):
            known.clear()


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


@dataclass(frozen=True, eq=False)
class Part:
    """A function of the user, as a function of the values of the inputs of a tape by key."""

    what: str
    """Words for it, which "raises" or "gives" may follow."""
    function: Any
    of: Callable[[Values], dict[Key, Any]]
    """Values by target, from numbers, arrays of jobs or symbols."""


def arguments(at: Values) -> tuple[Any, Named, Named, Named]:
    """Time, states, inputs and parameters as a function gets them."""
    named: dict[str, dict[str, Any]] = {"x": {}, "u": {}, "p": {}}
    for (kind, *name), value in at.items():
        if kind in named:
            named[kind][name[0]] = value
    return at["t",], *map(Named, named.values())


def keys_of(system: System) -> list[Key]:
    """Inputs of the tapes of a system."""
    own = [n for n in system.parameters if not n.startswith(BETWEEN)]
    named = (("x", system.names), ("u", system.inputs), ("p", own))
    return [("t",), *((kind, n) for kind, names in named for n in names)]


def own_parts(system: System) -> list[Part]:
    """Rates, and each output that is a function."""

    def rates(at: Values) -> dict[Key, Any]:
        names = [("rate", n) for n in system.names]
        return dict(zip(names, rates_of(system, *arguments(at)), strict=True))

    def output(name: str, of: Callable[..., Any]) -> Part:
        what = f"model {system.name}: its output {name}"
        return Part(what, of, lambda at: {("output", name): of(*arguments(at))})

    functions = {n: of for n, of in system.outputs.items() if not isinstance(of, str | Rate)}
    first = Part(f"model {system.name}: its rates function", system.rates, rates)
    return [first, *(output(n, of) for n, of in functions.items())]


def effect_part(candidate: Candidate, symbols: bool = False) -> Part:
    """The rate of an effect. ``symbols``: the floats of the shape are among the values."""

    def rate(at: Values) -> dict[Key, Any]:
        shape = candidate.shape
        if symbols:
            parts = list(shape) if isinstance(shape, tuple) else [shape]
            places = [i for i, v in enumerate(parts) if isinstance(v, float)]
            for k, i in enumerate(places):
                parts[i] = at["shape", k]
            shape = tuple(parts) if isinstance(shape, tuple) else parts[0]
        found = changes_of(candidate, *arguments(at), at["size",], shape)
        return {("rate", n): v for n, v in found.items()}

    return Part(f"effect {candidate.name}: its rate", candidate.effect.rate, rate)


def port_part(system: System, name: str) -> Part:
    """The rates that a force at a port causes."""
    push = system.ports[name]

    def pushed(at: Values) -> dict[Key, Any]:
        found = push(at["force",], *arguments(at))
        return {("rate", n): v for n, v in found.items()}

    return Part(f"model {system.name}: its port {name}", push, pushed)


def _traced(parts: Sequence[Part], keys: Iterable[Key]) -> Traced | NotTraceable:
    """The trace of functions; the reason if one of them cannot be traced.

    Raises
    ------
    InvalidParameter
        The values are of no use, or a function has a state of its own.
    """
    tape = Tape()
    nodes: dict[Key, Node] = {}
    try:
        with np.errstate(all="ignore"):
            at = {k: tape.input(k) for k in keys}
            for part in parts:
                nodes |= tape.called(functools.partial(part.of, at))
    except Error:
        raise
    except Kept:
        raise has_state(part) from None
    except (NotTraceable, Exception) as error:
        return NotTraceable(explained(error).removeprefix("NotTraceable: "))
    finally:
        tape.closed = True
    return Traced.of(tape, nodes)


class Untrue(InvalidParameter):
    """A function differs from its trace, or from itself."""


def has_state(part: Part, detail: str = "it uses a value of an earlier call") -> Untrue:
    """Error about a function that remembers."""
    return Untrue(
        f"{part.what} differs between two equal calls: {detail}{line_of(part.function)}; expected "
        "a function of its arguments alone, without random numbers, counters or other states of "
        "its own; what it must remember is a state of the model"
    )


def own_trace(system: System, traces: Traces) -> Traced | NotTraceable:
    """Trace of rates and outputs."""
    if traces.own is None:
        traces.own = _traced(own_parts(system), keys_of(system))
    return traces.own


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
    keys = effect_keys(system, candidate, symbols)
    return _traced([effect_part(candidate, symbols)], keys)


def effect_keys(system: System, candidate: Candidate, symbols: bool) -> list[Key]:
    """Inputs of the tape of an effect."""
    hidden = [("x", h.name) for h in candidate.effect.hidden]
    parts = candidate.shape if isinstance(candidate.shape, tuple) else (candidate.shape,)
    floats = sum(isinstance(v, float) for v in parts) if symbols else 0
    return [*keys_of(system), *hidden, ("size",), *(("shape", k) for k in range(floats))]


def port_trace(system: System, traces: Traces, name: str) -> Traced:
    """Trace of the rates that a force at a port causes."""
    if name not in traces.ports:
        found = _traced([port_part(system, name)], [*keys_of(system), ("force",)])
        traces.ports[name] = traced_of(found)
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
