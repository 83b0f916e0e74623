"""Parameters of differentiation, and the mechanisms in which each of them is shifted."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from feltmb import _core
from feltmb.mechanism import Action
from feltmb.mechanism.parameters import Parameter, all_parameters, find_parameters, mechanism_with
from feltmb.run.stroke import Stroke
from unmodeled.errors import InvalidParameter

#: Relative shift of parameters for df/dp; the errors by rounding and by curvature are below 1e-8 of
#: the derivative.
SHIFT = 2e-6

#: The same for places and angles of bodies and surfaces: a shift must be small against the
#: compression of a contact, which is a thousandth of them.
SHIFT_OF_PLACES = 2e-8


def choose_parameters(
    action: Action, paths: str | Iterable[str] | None, *, every: bool
) -> list[Parameter]:
    """Parameters of the given paths, or all parameters that can be shifted."""
    if every:
        return [p for p in all_parameters(action) if _can_shift(action, p)]
    given = [] if paths is None else [paths] if isinstance(paths, str) else list(paths)
    own = {
        "stroke.scale": Parameter("stroke.scale", 1.0, "1", 1.0),
        "stroke.delay": Parameter("stroke.delay", 0.0, "s", 1e-4),
    }
    find_parameters(action, [p for p in given if p not in own])  # all faults in one message
    out: dict[str, Parameter] = {}
    for path in given:  # in the requested order
        for parameter in [own[path]] if path in own else find_parameters(action, path):
            out[parameter.path] = parameter
    return list(out.values())


def _shift(parameter: Parameter) -> float:
    place = parameter.unit in ("m", "rad") and not parameter.path.startswith("contacts.")
    return (SHIFT_OF_PLACES if place else SHIFT) * parameter.size


def _can_shift(action: Action, parameter: Parameter) -> bool:
    try:
        _nodes(action, parameter)
    except InvalidParameter:
        return False
    return True


def _nodes(action: Action, parameter: Parameter) -> list[tuple[Any, float, float]]:
    """Mechanisms, shifts and weights of a finite difference of second order."""
    h = _shift(parameter)
    known = dict(action.described)  # parts of shifted values are not cached

    def at(shift: float) -> Any:
        value = parameter.value + shift
        return mechanism_with(action, {parameter.path: value}, known)

    faults = []
    for sign in (1.0, -1.0):
        try:
            near = at(sign * h)
        except InvalidParameter as error:
            faults.append(str(error))
            continue
        try:
            return [(near, sign * h, sign * 0.5 / h), (at(-sign * h), -sign * h, -sign * 0.5 / h)]
        except InvalidParameter:
            # At a limit of the permitted range: three points on one side.
            s = sign / h
            return [
                (action.mechanism, 0.0, -1.5 * s),
                (near, sign * h, 2.0 * s),
                (at(2.0 * sign * h), 2.0 * sign * h, -0.5 * s),
            ]
    raise InvalidParameter(f"parameter {parameter.path!r} cannot be shifted: {faults[0]}")


def shifted(action: Action, stroke: Stroke, parameter: Parameter) -> Any:
    """A parameter for the core: mechanisms and strokes with shifted values, and weights."""

    def model(mechanism: Any, shift: float, weight: float, **changed: Any) -> Any:
        return _core.Perturbed(
            mechanism,
            _core.InputSignal(
                changed.get("profile", stroke.profile), stroke.kind, changed.get("origin", 0.0)
            ),
            shift,
            weight,
        )

    h = _shift(parameter)
    sides = [(h, 0.5 / h), (-h, -0.5 / h)]
    if parameter.path == "stroke.scale":
        nodes = [
            model(action.mechanism, s, w, profile=stroke.scaled(1.0 + s).profile) for s, w in sides
        ]
    elif parameter.path == "stroke.delay":
        nodes = [model(action.mechanism, s, w, origin=-s) for s, w in sides]
    else:
        nodes = [model(*node) for node in _nodes(action, parameter)]
    return _core.SensitivityParameter(parameter.path, nodes, parameter.size)
