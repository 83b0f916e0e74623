"""Changes in the words of a workshop: leads, screws by their names, strike weight, key ratio.

:func:`plain_values` translates them to the dotted paths of a mechanism file.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Collection, Mapping
from typing import Any

from feltmb.mechanism.numbers import number_at
from feltmb.mechanism.schema import MechanismFile, Screw
from feltmb.mechanism.to_core import with_leads
from feltmb.mechanism.values import expand_path, split_operator, tidy
from unmodeled.errors import InvalidParameter, shortened
from unmodeled.units import conversion_factor
from unmodeled.units.quantity import parse_scalar

#: Farthest place of a lead, as a multiple of that of the finger.
LEAD_REACH = 1.1

_LEAD = re.compile(r"\s*(.+?)\s+at\s+(.+?)\s*")
#: Turns of a screw: 0.5turn, 0,5 turn, 3/4 turn, 1 1/2 turns; or an angle: 90deg.
_TURNS = re.compile(
    r"\s*(?P<sign>[-+]?)(?:(?P<whole>\d+[.,]?\d*|[.,]\d+)?\s*?(?:(?<!\d)(?P<over>\d+)/(?P<under>[1-9]\d*))?)"
    r"\s*(?P<unit>turns?|deg|°|rad|rev)\s*"
)


def _word(name: str) -> str:
    return re.sub(r"[\s_-]+", "_", name.strip().lower())


def plain_values(
    config: MechanismFile, raw: Mapping[str, Any], values: Mapping[str, Any]
) -> Mapping[str, Any]:
    """Values by dotted path, with the words of a workshop replaced by paths.

    ``lead``, ``strike weight``, ``key ratio`` and the names of ``[screws]`` are such words, if the
    file has no table with that name. The same mapping is returned if there are none.
    """
    out: dict[str, Any] = {}
    for given, value in values.items():
        name, operator = split_operator(given) if isinstance(given, str) else ("", "")
        word = _word(name)
        new: Mapping[str, Any] = {given: value}
        if name and name not in raw and name not in config.bodies:
            if word in config.screws:
                new = _turned(config, word, operator, value)
            elif word == "lead" and config.bodies and not operator:
                new = {f"leads.{name}": lead for name, lead in _leads(config, value).items()}
                new = new if config.leads else {"leads": _leads(config, value)}
            elif word in ("strike_weight", "key_ratio") and config.reading.weights is not None:
                new = _weighed(config, word, operator, value)
        if twice := [path for path in new if path in out]:
            raise InvalidParameter(f"with_values: {given}: {twice[0]} is changed twice")
        out.update(new)
    return values if list(out) == list(values) else out


def _leads(config: MechanismFile, value: Any) -> dict[str, dict[str, str]]:
    """Leads to add by their names, from texts such as ``5 g at 200 mm``."""
    added: dict[str, dict[str, str]] = {}
    number = 1
    for text in value if isinstance(value, list) else [value]:
        found = _LEAD.fullmatch(text) if isinstance(text, str) else None
        if found is None:
            raise InvalidParameter(
                f"lead: got {shortened(repr(text))}, expected a mass and its distance from the "
                "balance rail, such as '5 g at 200 mm'"
            )
        reach = config.finger.point[0] if config.finger is not None else math.inf
        try:
            place = parse_scalar(found[2], "m")
        except ValueError:
            place = 0.0  # the file with the lead is checked, and tells it
        if abs(place) > LEAD_REACH * abs(reach):
            raise InvalidParameter(
                f"lead: got {text}, expected a place on the key; the finger presses it at "
                f"{1e3 * abs(reach):.0f} mm from the balance rail"
            )
        while f"added_{number}" in {**config.leads, **added}:
            number += 1
        added[f"added_{number}"] = {"mass": found[1], "position": found[2]}
    return added


def _turns(text: str) -> float | None:
    """Turns of a text such as ``3/4 turn`` or ``90deg``; None: it is neither."""
    found = _TURNS.fullmatch(text)
    if found is None or not (found["whole"] or found["over"]):
        return None
    number = float((found["whole"] or "0").replace(",", "."))
    number += int(found["over"]) / int(found["under"]) if found["over"] else 0.0
    number = -number if found["sign"] == "-" else number
    unit = found["unit"]
    return number if unit.startswith("turn") else number * conversion_factor(unit, "rev")


def _amount(screw: Screw, what: str, operator: str, value: Any) -> float:
    """Travel of a screw along its direction [m], from turns or a length."""
    if operator not in ("+", "-"):
        raise InvalidParameter(
            f"{what}: a screw is turned by an amount, such as {what}+=0.5turn or {what}-=0.2mm"
        )
    try:
        turns = _turns(value) if isinstance(value, str) else None
        if turns is None:
            amount = parse_scalar(value, "m")
        elif screw.pitch is None:
            raise ValueError("has no thread in [screws]; expected a length, such as 0.2mm")
        else:
            amount = turns * screw.pitch
    except ValueError as error:
        raise InvalidParameter(
            f"{what}{operator}={value}: {error}; expected turns, an angle or a length, such as "
            f"{what}{operator}=0.5turn, {what}{operator}=90deg or {what}{operator}=0.35mm"
        ) from None
    return -amount if operator == "-" else amount


def _turned(config: MechanismFile, name: str, operator: str, value: Any) -> dict[str, Any]:
    """Changes of numbers by a turn of a screw, or by a length or an angle."""
    screw = config.screws[name]
    if screw.direction is None:
        return {f"{screw.path} {operator}=" if operator else screw.path: value}
    amount = _amount(screw, name, operator, value)
    return {
        f"{screw.path}.{axis} +=": f"{tidy(1e3 * amount * part)!r} mm"
        for axis, part in zip("xy", screw.direction, strict=True)
        if part != 0.0
    }


def turns_of(config: MechanismFile, path: str, moved: float) -> tuple[float, str] | None:
    """Turns of the screw that moves the value at a path, and the word for the direction.

    ``moved`` is in m or rad. None: no screw with a thread, or nothing moved.
    """
    for screw in config.screws.values():
        if screw.path == path and screw.pitch is not None and moved:
            return abs(moved) / screw.pitch, screw.words[moved < 0.0]
    return None


def move_text(moved: float, unit: str, turns: tuple[float, str] | None) -> str:
    """Text such as ``+0.400 mm = 0.57 turn up``; ``turns``: those of :func:`turns_of`."""
    return f"{moved:+.3f} {unit}" + ("" if turns is None else f" = {turns[0]:.2g} turn {turns[1]}")


def notes_of_turns(config: MechanismFile, values: Mapping[str, Any]) -> list[str]:
    """Sentences about the leads and screws of ``values``: ``capstan +0.350 mm = 0.5 turn up``."""
    told = []
    for given, value in values.items():
        name, operator = split_operator(given)
        if _word(name) == "lead":
            told += [
                f"lead {key} added: {lead['mass']} at {lead['position']} from the balance rail"
                for key, lead in _leads(config, value).items()
            ]
        screw = config.screws.get(_word(name))
        if screw is not None and screw.direction is not None:
            moved = _amount(screw, name, operator, value)
            turns = turns_of(config, screw.path, moved)
            told.append(f"{screw.label or name} {move_text(1e3 * moved, 'mm', turns)}")
    return told


# --- strike weight and key ratio -----------------------------------------------------------------


def _places(
    config: MechanismFile, root: str, *, every_joint: bool = False
) -> dict[str, tuple[float, float, float]]:
    """Position (x, y) and angle of each body welded to a body, in the frame of that body.

    ``every_joint``: also bodies with other joints, at coordinate zero.
    """
    places = {root: (0.0, 0.0, 0.0)}
    more = True
    while more:
        more = False
        for name, body in config.bodies.items():
            welded = every_joint or body.joint == "weld"
            if name in places or not welded or body.parent not in places:
                continue
            x, y = _placed(places[body.parent], body.position)
            places[name] = (x, y, places[body.parent][2] + body.angle)
            more = True
    return places


def _placed(place: tuple[float, float, float], point: tuple[float, float]) -> tuple[float, float]:
    x, y, angle = place
    c, s = math.cos(angle), math.sin(angle)
    return x + c * point[0] - s * point[1], y + s * point[0] + c * point[1]


def mass_and_center(config: MechanismFile, name: str) -> tuple[float, tuple[float, float]]:
    """Mass of a body with its leads [kg], and its center in its own frame [m]."""
    body = with_leads(config, name)
    if body.kind == "beam":
        assert body.length is not None
        return (body.density or 0.0) * (body.area or 0.0) * body.length, (0.5 * body.length, 0.0)
    return body.mass, body.center_of_mass


def welded_to(config: MechanismFile, root: str) -> set[str]:
    """A body and the bodies welded to it."""
    return set(_places(config, root))


def moment_about(config: MechanismFile, root: str, bodies: Collection[str]) -> float:
    """Mass times distance along x from the joint of a body [kg m], with all joints at zero."""
    places = _places(config, root, every_joint=True)
    moment = 0.0
    for name in bodies:
        mass, center = mass_and_center(config, name)
        moment += mass * _placed(places[name], center)[0]
    return moment


def distance_from_joint(config: MechanismFile, coordinate: str, point: str) -> float:
    """Distance of a tracking point from the joint with a coordinate [m].

    The point belongs to the body of the joint, or to a body welded to it.
    """
    root = next(name for name, body in config.bodies.items() if body.coordinate == coordinate)
    places = _places(config, root)
    if point not in config.points or config.points[point].body not in places:
        known = ", ".join(name for name, p in config.points.items() if p.body in places) or "none"
        raise InvalidParameter(
            f"point {point!r} is not on {root!r} or a body welded to it; such points are {known}"
        )
    found = config.points[point]
    return math.hypot(*_placed(places[found.body], found.point))


def strike_weight(config: MechanismFile) -> tuple[float, float]:
    """Strike weight as weighed [kg], and its radius [m].

    The hammer assembly lies with a level shank on its center pin and, at the strike radius, on the
    scale. The radius counts from the pin to the striking point, across the line of the strike.
    """
    weights, striker = config.reading.weights, config.reading.striker
    if weights is None or striker is None:
        raise InvalidParameter("strike weight: needs reading.weights and reading.striker")
    places = _places(config, weights.hammer)
    point = config.points[striker.point]
    dx, dy = striker.direction
    length = math.hypot(dx, dy)

    def arm(at: tuple[float, float]) -> float:
        return (dx * at[1] - dy * at[0]) / length

    radius = arm(_placed(places[point.body], point.point))
    moment = 0.0
    for name, place in places.items():
        mass, center = mass_and_center(config, name)
        moment += mass * arm(_placed(place, center))
    return moment / radius, abs(radius)


def key_ratio(config: MechanismFile) -> float:
    """Distance of the capstan from the balance rail by that of the finger."""
    weights, finger = config.reading.weights, config.finger
    if weights is None or finger is None:
        raise InvalidParameter("key ratio: needs reading.weights and [finger]")
    return abs(config.surfaces[weights.capstan].point[0] / finger.point[0])


def _weighed(config: MechanismFile, word: str, operator: str, value: Any) -> dict[str, Any]:
    """Changes that give the hammer a strike weight, or the key a ratio."""
    weights, striker = config.reading.weights, config.reading.striker
    assert weights is not None
    unit, now = (
        ("kg", strike_weight(config)[0]) if word == "strike_weight" else ("1", key_ratio(config))
    )
    try:
        if operator == "*":
            wanted = now * parse_scalar(value, "1")
        else:
            amount = parse_scalar(value, unit)
            wanted = amount if not operator else now + (amount if operator == "+" else -amount)
    except ValueError as error:
        raise InvalidParameter(f"{word}: {error}") from None
    if word == "key_ratio":
        surface = config.surfaces[weights.capstan]
        x = surface.point[0] * wanted / now
        return {f"surfaces.{weights.capstan}.point.x": f"{tidy(1e3 * x)!r} mm"}
    # The head alone becomes heavier or lighter, in the same shape.
    assert striker is not None
    head = config.points[striker.point].body
    heavier = config.bodies[head].model_copy(update={"mass": config.bodies[head].mass + 1.0})
    changed = config.model_copy(update={"bodies": {**config.bodies, head: heavier}})
    by_mass = strike_weight(changed)[0] - now  # per kilogram at the center of the head
    mass = config.bodies[head].mass
    new = mass + (wanted - now) / by_mass
    if not new > 0.0:
        raise InvalidParameter(
            f"strike weight: {1e3 * wanted:g} g is below that without a head, "
            f"{1e3 * (now - mass * by_mass):.4g} g"
        )
    return {
        f"bodies.{head}.mass": f"{tidy(1e3 * new)!r} g",
        f"bodies.{head}.inertia *=": tidy(new / mass),
    }


def faults(config: MechanismFile) -> list[str]:
    """Screws that move nothing, and leads without a rigid body."""
    found = []
    for name, lead in config.leads.items():
        body = lead.body or (config.finger.body if config.finger is not None else "")
        if body not in config.bodies or config.bodies[body].kind == "beam":
            got = repr(body) if body else "none, and there is no [finger]"
            found.append(f"leads.{name}.body: got {got}, expected a rigid body")
    for name, screw in config.screws.items():
        found += _screw_faults(config, name, screw)
    weights = config.reading.weights
    for key, table in (("hammer", "bodies"), ("whippen", "bodies"), ("capstan", "surfaces")):
        known = getattr(config, table)
        if weights is not None and getattr(weights, key) not in known:
            near = difflib.get_close_matches(getattr(weights, key), known, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            found.append(f"reading.weights.{key}: {getattr(weights, key)!r} is missing{hint}")
    return found


def _screw_faults(config: MechanismFile, name: str, screw: Screw) -> list[str]:
    where = f"screws.{name}"
    if _word(name) != name:
        return [f"{where}: expected lower-case letters, digits and _"]
    if name in config.bodies or name in MechanismFile.model_fields:
        return [f"{where}: a body or a table has this name; choose another"]
    try:
        value = number_at(config, expand_path({"bodies": config.bodies}, screw.path)[0]).value
    except InvalidParameter as error:
        return [f"{where}.path: {str(error).removeprefix('value: ')}"]
    if (screw.direction is not None) != isinstance(value, tuple):
        return [f"{where}: a point needs a direction, and a number has none"]
    if screw.direction is not None and abs(math.hypot(*screw.direction) - 1.0) > 1e-3:
        return [f"{where}.direction: got {list(screw.direction)}, expected a length of 1"]
    return []
