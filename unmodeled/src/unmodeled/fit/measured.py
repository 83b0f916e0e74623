"""Tests of single parts as data, for example the weight or the stiffness of one part.

::

    [measured."spring.04"]
    value = "3 %"
    sd = "2 %"
    how = "compression test of 2026-11-20"

    [measured.string_distance]
    value = "1.9 mm"
    sd = "0.1 mm"

The first is a parameter of the model, and the test replaces its tolerance. The second is an effect
that the model lacks. With a measured magnitude it becomes a parameter of the model.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter, near_names
from unmodeled.fit.inclusion import including
from unmodeled.models.model import Effect, Model


@checked
@dataclass(frozen=True, kw_only=True)
class Measured:
    """Result of a separate test of a part: the value of a parameter, or the magnitude of an effect.

    The value of a parameter replaces its tolerance. An effect becomes a parameter.
    """

    parameter: str
    """Name of the parameter or of the effect."""
    value: float
    """[unit of the parameter]"""
    sd: float
    """Standard deviation [unit of the parameter]."""
    how: str = ""

    def __post_init__(self) -> None:
        if not math.isfinite(self.value):
            raise InvalidParameter(
                f"measured {self.parameter}: value = {self.value!r}, expected a finite number"
            )
        if not 0.0 < self.sd < math.inf:
            raise InvalidParameter(
                f"measured {self.parameter}: sd = {self.sd!r}, expected finite, > 0"
            )


@checked
def read_measured(
    path: str | Path, model: Model, effects: Sequence[Effect] = ()
) -> tuple[Measured, ...]:
    """Read ``[measured.NAME]`` tables with ``value``, ``sd`` and ``how``.

    Numbers are in the unit of the parameter or effect, or texts with a unit; a share may be
    ``"3 %"``.

    Parameters
    ----------
    path
        TOML file.
    model
        Model whose parameters were measured.
    effects
        Effects that the model lacks, whose magnitudes may have been measured too.

    Returns
    -------
    tuple of Measured
        Tests in the order of the file.

    Raises
    ------
    DataError
        All faults of the file in one message: unknown names, then those of each table. The table of
        an unknown name is not checked, because the unit of its numbers is unknown.
    """
    from unmodeled.fit.measured_file import read

    units = units_of_tests(model, effects)
    return read(Path(path), Measured, units, lambda name: no_test_of(name, model, effects))


def no_test_of(name: str, model: Model, effects: Sequence[Effect] = ()) -> str:
    """Reason why a test of a part by itself cannot give a parameter or effect; empty: it can."""
    parameters = [p.name for p in model.parameters]
    known = {e.name: e for e in effects}
    if name in parameters:
        return ""
    if name not in known:
        kind = "parameter or tested effect" if known else "parameter"
        names = [*dict.fromkeys((*parameters, *known))]
        hint = near_names(name, names) or f"; there are {', '.join(names)}"
        return f"no {kind} of {model.name}{hint}"
    effect = known[name]
    if effect.observe is not None or effect.excite is not None:
        return (
            "an effect of the records and not of the machine: correct the records by the measured "
            "value, and leave the effect out"
        )
    if effect.tolerance_parameter in parameters:
        return f"it changes the same number as {effect.tolerance_parameter}: give that parameter"
    return ""


def untested(effects: Sequence[Effect], model: Model) -> list[Effect]:
    """Effects that change no number which a test of a part measured.

    The test measured the number as it is, with the effect. The effect is then no cause besides it.
    """
    tested = {p.name for p in model.parameters if p.before is not None}
    return [e for e in effects if e.tolerance_parameter not in tested]


def units_of_tests(model: Model, effects: Sequence[Effect] = ()) -> dict[str, str]:
    """Unit by name of all parameters and effects.

    An effect with the name of a parameter changes the same number: the parameter is meant.
    """
    return {e.name: e.unit for e in effects} | {p.name: p.unit for p in model.parameters}


@checked
def with_measured(
    model: Model, measured: Sequence[Measured], effects: Sequence[Effect] = ()
) -> Model:
    """Copy of the model with the values and uncertainties of tests of parts.

    Several tests of one parameter are combined.

    Parameters
    ----------
    model
        Model of the machine.
    measured
        Tests of its parameters, and of ``effects``.
    effects
        Effects that the model lacks. Those that were measured become parameters of the model, with
        the measured magnitude and its standard deviation as the prior. Of an effect with several
        shapes, the first counts. A diagnosis of this model does not test them as causes.

    Returns
    -------
    unmodeled.fit.Model
        The model itself if nothing was measured.

    Raises
    ------
    InvalidParameter
        A parameter or effect that does not exist, or a value beyond its limits. An effect of a
        sensor or an input, for which the records must be corrected, or one that changes the same
        number as a parameter, which must be given instead.
    """
    parameters = {p.name: p for p in model.parameters}
    known = {e.name: e for e in effects}
    by_name: dict[str, list[Measured]] = {}
    for m in measured:
        by_name.setdefault(m.parameter, []).append(m)
    faults, changed, included = [], {}, {}
    for name, tests in by_name.items():
        if why := no_test_of(name, model, effects):
            faults.append(f"{name}: {why}")
            continue
        value, sd = _combined(tests)
        p = parameters.get(name)
        unit = known[name].unit if p is None else p.unit
        lower, upper = known[name].bounds if p is None else (p.lower, p.upper)
        if not lower <= value <= upper:
            faults.append(
                f"{name}: got {value:g} {unit}, expected a value in [{lower:g}, {upper:g}]"
            )
        elif p is None:
            included[name] = value, sd
        else:
            changed[name] = replace(p, value=value, sd=sd, before=p.before or p)
    if faults:
        raise InvalidParameter("measured: " + "; ".join(faults))
    out = model.with_parameters(changed) if changed else model
    if not included:
        return out
    out = including(out, [known[n] for n in included], *zip(*included.values(), strict=True))
    unknown = {p.name: replace(p, value=0.0, sd=math.inf) for p in out.own}
    return out.with_parameters({p.name: replace(p, before=unknown[p.name]) for p in out.own})


def _combined(tests: Sequence[Measured]) -> tuple[float, float]:
    """Mean of tests of one number, weighted by their accuracy, and its standard deviation."""
    best = min(m.sd for m in tests)
    weights = [(best / m.sd) ** 2 for m in tests]  # at most 1, so that no square overflows
    value = sum(w * m.value for w, m in zip(weights, tests, strict=True)) / sum(weights)
    return value, best / math.sqrt(sum(weights))
