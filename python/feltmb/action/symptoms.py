"""Symptoms of an action, and the parts that cause them in order of likelihood.

The likelihoods follow from a table of :func:`feltmb.wear` with screws. Each part deviates by a
normal distribution whose standard deviation is what one expects to meet. The likelihood of a part
is in proportion to the probability that it reaches the limit of the symptom by itself, with linear
effects. Each cause that the model does not have counts like the mean of those that are listed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any, Literal

from pydantic import Field

from feltmb import params
from feltmb.action.wearing import NUMBERS, Variant, Wear
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter, near_names, shown
from unmodeled.files import read_json, read_toml
from unmodeled.units.quantity import Schema, validated

#: Deviation that one expects to meet, by kind of change; of others: the tested change.
EXPECTED = {"thinner": 3e-4, "harder": 0.2, "friction": 1.0, "spring": 0.2}
#: Causes with a smaller share are not told [1].
LEAST = 0.02
#: Multiple of the limit that is reached when the number does not exist any more.
LOST = 1.5
#: Contractions in the name of a symptom, and words that do not count.
SHORT = {"won't": "will not", "doesn't": "does not", "isn't": "is not"}
SILENT = ("the", "a", "it", "is", "action", "hammer", "note", "key", "too")
#: Action whose table is packaged.
PACKAGED = "steinway45_leaded"
#: What to do about a kind of change.
REMEDIES = {
    "thinner": "Renew the felt",
    "harder": "Soften or renew the felt",
    "friction": "Clean, polish or ease it",
    "spring": "Strengthen or renew the spring",
    "tight": "Ease it, and polish the pin",
    "missing": "Renew it",
    "screw": "Turn it back",
}


class Definition(Schema):
    """A symptom of the file."""

    what: str
    test: str
    number: Literal[tuple(NUMBERS)]  # type: ignore[valid-type]
    worse: Literal["more", "less"]
    limit: float | None = None
    by: Annotated[float, Field(gt=0)] | None = None
    lost: bool = False
    also: tuple[str, ...] = ()
    """Other names."""
    beyond: tuple[str, ...] = ()
    """Causes that the model does not have."""


class _File(Schema):
    schema_version: Annotated[Literal[1], Field(alias="schema")]
    symptoms: dict[str, Definition]


@dataclass(frozen=True)
class Cause:
    """A part that can cause a symptom by itself."""

    part: str
    kind: str  #: thinner, harder, friction, spring, tight, missing or screw
    change: str  #: change that reaches the limit
    share: float  #: likelihood compared with all other causes [1]
    remedy: str


@dataclass(frozen=True)
class Symptom:
    """A symptom with its causes, in the units of :data:`feltmb.action.wearing.NUMBERS`."""

    name: str
    what: str
    test: str
    number: str
    unit: str
    value: float  #: of the regulated action
    limit: float  #: beyond it, the symptom is there
    worse: str  #: side of the limit with the symptom: more or less
    causes: tuple[Cause, ...]
    screws: tuple[str, ...]  #: screws that take the number from the limit back to the value
    beyond: tuple[str, ...] = ()  #: causes that the model does not have: look for them as well
    beyond_share: float = 0.0  #: likelihood of these, each like the mean of those listed [1]

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return {k: None if v != v else v for k, v in asdict(self).items()}


def load_symptoms() -> dict[str, Definition]:
    """Definitions of the symptoms by name."""
    path = params.folder("symptoms") / "symptoms.toml"
    return validated(_File, read_toml(path), path.name).symptoms


def packaged_wear() -> Wear:
    """Table of the packaged action: what ``feltmb wear steinway45_leaded --screws`` writes."""
    return Wear.from_dict(read_json(params.folder("symptoms") / f"{PACKAGED}.json"))


@checked
def symptom(name: str, wear: Wear | None = None) -> Symptom:
    """A symptom, and the parts that cause it in order of likelihood.

    Parameters
    ----------
    name
        Name of the symptom, such as ``blocks``, or another word for it, such as ``won't repeat``.
    wear
        Table of :func:`feltmb.wear` with ``screws=True``; default: that of the packaged action.

    Raises
    ------
    InvalidParameter
        There is no such symptom, or the number of the symptom does not exist in the action.
    """
    known = load_symptoms()
    name = _understood(name, known)
    table = packaged_wear() if wear is None else wear
    d = known[name]
    value = table.base[d.number]
    if not math.isfinite(value):
        raise InvalidParameter(
            f"symptom {name!r}: {NUMBERS[d.number][0]} does not exist in {table.name!r}; regulate "
            "the action first"
        )
    sign = 1.0 if d.worse == "more" else -1.0
    limit = value + sign * d.by if d.by is not None else float(d.limit or 0.0)
    needed = sign * (limit - value)
    #: share of the way to the limit, by variant
    reach = [(v, _reach(numbers, value, sign, needed, d)) for v, numbers in table.rows]
    causes, rest = _causes(reach, len(d.beyond))
    return Symptom(
        name=name,
        what=d.what,
        test=d.test,
        number=NUMBERS[d.number][0],
        unit=NUMBERS[d.number][1],
        value=value,
        limit=limit,
        worse=d.worse,
        causes=causes,
        screws=_screws(reach),
        beyond=d.beyond,
        beyond_share=rest,
    )


def _understood(name: str, known: Mapping[str, Definition]) -> str:
    """The symptom that is meant by words such as "the hammer won't repeat!"."""

    def plain(text: str) -> str:
        text = text.lower().replace("\N{RIGHT SINGLE QUOTATION MARK}", "'")
        for short, full in SHORT.items():
            text = text.replace(short, full)
        words = "".join(c if c.isalnum() else " " for c in text).split()
        return " ".join(w for w in words if w not in SILENT)

    names = {plain(word): n for n, d in known.items() for word in (n, *d.also)}
    asked = plain(name)
    if asked in names:
        return names[asked]
    parts = f" {asked} "
    # "heavy or sluggish" is two symptoms.
    found = dict.fromkeys(n for word, n in names.items() if f" {word} " in parts)
    if len(found) == 1:
        return next(iter(found))
    if found:
        raise InvalidParameter(
            f"{shown(name)} is {' or '.join(found)}: expected one of these symptoms"
        )
    raise InvalidParameter(
        f"there is no symptom {shown(name)}{near_names(asked, names)}, expected one of "
        f"{', '.join(known)}"
    )


def _reach(
    numbers: Mapping[str, float], value: float, sign: float, needed: float, d: Definition
) -> float:
    """Part of the way from the regulated action to the limit [1]; below 0: away from it."""
    number = numbers[d.number]
    if not math.isfinite(number):
        # Without weights, the slow press could not be measured: nothing is known.
        return LOST if d.lost and math.isfinite(numbers["down_weight"]) else 0.0
    # An action with the symptom: what changes the number most, compared with what is noticed.
    way = needed if needed > 0.0 else max(abs(value), 1.0)
    return sign * (number - value) / way


def _causes(reach: Sequence[tuple[Variant, float]], others: int) -> tuple[tuple[Cause, ...], float]:
    """Causes in the model, and the likelihood of the others, each like the mean of these."""
    best: dict[tuple[str, str], tuple[float, Variant, float]] = {}
    for variant, part in reach:
        if part <= 0.0 or (variant.kind == "missing" and part < 1.0):
            continue
        expected = EXPECTED.get(variant.kind, abs(variant.amount))
        z = abs(variant.amount) / expected / part
        key = (variant.part, variant.kind)
        if key not in best or z < best[key][0]:
            best[key] = (z, variant, part)
    chances = {key: math.erfc(z / math.sqrt(2.0)) for key, (z, _, _) in best.items()}
    own = sum(chances.values())
    listed = [key for key, chance in chances.items() if chance >= LEAST * own]
    if not listed:
        return (), 1.0
    total = own * (1.0 + others / len(listed))
    found = [
        Cause(v.part, v.kind, _scaled(v, 1.0 / part), chances[key] / total, REMEDIES[v.kind])
        for key, (_, v, part) in best.items()
        if key in listed
    ]
    return tuple(sorted(found, key=lambda c: -c.share)), 1.0 - own / total


def _screws(reach: Sequence[tuple[Variant, float]]) -> tuple[str, ...]:
    """Screws, best first, with the turn from the limit back to the regulated number."""
    found = [(part, v) for v, part in reach if v.kind == "screw" and part < -0.5]
    best: dict[str, tuple[float, Variant]] = {}
    for part, v in sorted(found, key=lambda f: f[0]):
        best.setdefault(v.part, (part, v))
    return tuple(f"{v.part}: {_scaled(v, -1.0 / part)}" for part, v in best.values())[:3]


def _scaled(v: Variant, times: float) -> str:
    """Change of a variant by a multiple, as text."""
    amount = v.amount * times
    if v.kind == "thinner":
        return f"{1e3 * amount:.2g} mm thinner"
    if v.kind == "harder":
        return f"{100.0 * amount:.2g} % harder"
    if v.kind == "friction":
        return f"friction {1.0 + amount:.2g} times as large"
    if v.kind == "spring":
        return f"{min(100.0, -100.0 * amount):.2g} % weaker"
    if v.kind == "tight":
        return f"{amount:.2g} N tighter"
    if v.kind == "missing":
        return v.change
    text = f"{1e3 * amount:+.2g} mm" if v.unit == "m" else f"{math.degrees(amount):+.2g}°"
    return text + (f" = {abs(v.turns * times):.2g} turn {v.word}" if v.turns else "")
