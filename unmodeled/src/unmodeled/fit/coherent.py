"""Equations whose states and inputs are stated in units of another system than SI."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from unmodeled.errors import InvalidParameter
from unmodeled.fit.coordinates import Named, values_of
from unmodeled.fit.model import State
from unmodeled.fit.priors import Stated
from unmodeled.units import powers_of, spelled_unit, to_si

#: A function (t, x, u, p), of rates or of an output.
Function = Callable[[Any, Named, Named, Named], Any]


class Coherent:
    """What equations get, if a state or an input has a unit of another system than SI.

    If rates and outputs have one form in all coherent systems of units, they get SI. Else a number
    in them has a unit, and they get all numbers as they are stated, also those of parameters.

    Parameters
    ----------
    rates, states, outputs
        Of the equations.
    inputs
        Unit by name.
    given
        Parameters and unknown effects in SI.
    """

    def __init__(
        self,
        rates: Function,
        states: Sequence[State],
        inputs: Mapping[str, str],
        outputs: Mapping[str, Any] | None,
        given: Stated,
    ):
        self.rates, self.outputs, self.as_stated, self.note = rates, outputs, False, ""
        units = {**{s.name: s.unit for s in states}, **inputs}
        factors = {} if hasattr(rates, "units") else _factors(units)
        if not factors:
            return
        own = {n: of for n, of in (outputs or {}).items() if isinstance(of, tuple)}
        own = {n: of for n, of in own.items() if callable(of[0])}
        numbers = {p.name: (p.value or 1.0, p.unit) for p in given.parameters}
        numbers |= {e.data: (e.scale, e.unit) for e in given.effects}
        of_states = [_read(s.unit)[1] for s in states]
        ends = [{**powers, "s": powers.get("s", 0.0) - 1.0} for powers in of_states]
        one_form = _homogeneous(rates, states, inputs, numbers, ends) and all(
            _homogeneous(f, states, inputs, numbers, [_read(unit)[1]]) for f, unit in own.values()
        )
        names, self.as_stated = ", ".join(factors), not one_form
        if self.as_stated:
            self.note = (
                f"units: {names} are in no SI unit, and the equations hold a number with a unit: "
                "they get all numbers in the units in which they are stated, and seconds"
            )
            return
        self.note = f"units: the equations get {names} in SI units, like the parameters"
        self.rates = _in_si(rates, factors, [factors.get(s.name, 1.0) for s in states])
        self.outputs = outputs and {
            n: (_in_si(own[n][0], factors, _factors({n: own[n][1]}).get(n, 1.0)), own[n][1])
            if n in own
            else of
            for n, of in outputs.items()
        }


def _in_si(function: Function, factors: Mapping[str, float], out: Any) -> Function:
    """A function of SI values for states and inputs in other units, its values converted back.

    ``out``: factor of its value, or a list for its values.
    """

    def scaled(t: Any, x: Named, u: Named, p: Named) -> Any:
        x, u = (
            Named({n: factors[n] * v if n in factors else v for n, v in values_of(q).items()})
            for q in (x, u)
        )
        value = function(t, x, u, p)
        if isinstance(out, list):
            return tuple(v / f for v, f in zip(value, out, strict=True))
        return value / out

    return scaled


def _homogeneous(
    function: Function,
    states: Sequence[State],
    inputs: Mapping[str, str],
    numbers: Mapping[str, tuple[float, str]],
    ends: Sequence[Mapping[str, float]],
) -> bool:
    """Whether a function has one form in all coherent systems of units.

    It is evaluated at a random point in SI, and with another meter, kilogram, second and so on: a
    number in it that has a unit, such as 9.81, shows. ``ends``: powers of the units of its values.
    """
    random = np.random.default_rng(0)
    units = {**{s.name: s.unit for s in states}, **inputs}
    values = {n: float(random.uniform(0.5, 1.5)) for n in units}
    values |= {n: value for n, (value, _) in numbers.items()}
    powers = {n: _read(unit)[1] for n, unit in units.items()}
    powers |= {n: _read(unit)[1] for n, (_, unit) in numbers.items()}
    bases = {base for p in (*powers.values(), *ends) for base in p} - {"rad", "K"}

    def at(base: str, size: float) -> Any:
        scaled = {n: np.float64(v * size ** powers[n].get(base, 0.0)) for n, v in values.items()}
        x, u, p = (
            Named({n: scaled[n] for n in names})
            for names in ([s.name for s in states], inputs, numbers)
        )
        found = np.atleast_1d(np.asarray(function(np.float64(0.0), x, u, p), dtype=np.float64))
        return found / [size ** p.get(base, 0.0) for p in ends]

    try:
        with np.errstate(all="ignore"):
            return all(np.allclose(at(b, 1.0), at(b, 3.0), rtol=1e-9, atol=0.0) for b in bases)
    except Exception:  # it needs other values
        return False


def _factors(units: Mapping[str, str]) -> dict[str, float]:
    """Factors to SI of names with a unit of another system; angles and ratios are kept."""
    read = {name: _read(unit) for name, unit in units.items()}
    return {n: f for n, (f, powers) in read.items() if f != 1.0 and {*powers} - {"rad", "s"}}


def _read(unit: str) -> tuple[float, dict[str, float]]:
    """Factor to SI, and the powers of its base units; those of 1 for no known unit."""
    try:
        unit = spelled_unit(unit) or unit
        return to_si(unit)[0], powers_of(unit)
    except (InvalidParameter, ValueError):
        return 1.0, {}
