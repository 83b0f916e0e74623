"""Numbers and clauses of the report: sizes in the units of a reader, changes as differences."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from unmodeled.errors import shortened
from unmodeled.search.result import Change, Channel, NamedCause, ParameterValue
from unmodeled.units import readable_unit

#: Shares of a turn as words.
TURNS = {0.25: "a quarter of a turn", 0.5: "half a turn", 0.75: "three quarters of a turn",
         1.0: "one turn"}  # fmt: skip
#: Comparatives of directions; "stronger" is one, and others are "further in".
FURTHER = {"up": "higher", "down": "lower", "more": "more", "less": "less", "": "further"}
#: What errors of a signal with a level take away.
LOST = {"dead zone": "within it", "saturation": "beyond it"}
#: Whose error is that of all times.
CLOCK = "the clock of the sensors"
#: What drifts during a record.
DRIFTS = {"gain drift": "gain", "gain fade": "gain", "zero drift": "zero"}
#: Largest half width of an interval with which a share of a turn is a word, and largest number of
#: equivalents that a clause names.
SURE, EQUIVALENTS = 0.1, 2


def number(value: float, uncertainty: float = 0.0, sign: str = "") -> str:
    """A number with the digits that its uncertainty supports: two of the uncertainty."""
    if not math.isfinite(value):
        return "-"
    if not math.isfinite(uncertainty) or uncertainty <= 0.0:
        return f"{value:{sign}.4g}"
    places = 1 - math.floor(math.log10(uncertainty))
    value = round(value, places)
    if value == 0.0:
        return "0"
    return f"{value:{sign}.{places}f}" if 0 <= places <= 6 else f"{value:{sign}.6g}"


def scale(low: float, high: float, unit: str, *, relative: bool = False) -> tuple[float, str]:
    """Factor and unit in which an interval is shown, the unit with a space before it."""
    if relative:
        return 100.0, " %"
    factor, name = readable_unit(max(abs(low), abs(high)), unit)
    return factor, "" if name == "1" else f" {name}"


def interval(x: NamedCause | ParameterValue) -> str:
    """Value with its unit and 95 % interval."""
    value = x.magnitude if isinstance(x, NamedCause) else x.value
    relative = isinstance(x, ParameterValue) and x.relative
    return _sized(value, x.low, x.high, x.unit, relative=relative)


def tabulated(p: ParameterValue) -> str:
    """Tabulated value with its unit."""
    factor, unit = scale(p.low, p.high, p.unit, relative=p.relative)
    return f"{number(factor * p.tabulated)}{unit}"


def _numbers(
    value: float, low: float, high: float, unit: str, *, relative: bool, sign: str = ""
) -> tuple[str, str, str, str]:
    """Value, its unit, and the ends of its interval."""
    factor, name = scale(low, high, unit, relative=relative)
    spread = 0.5 * factor * (high - low)
    ends = [number(factor * v, spread, sign) for v in (low, high)]
    return number(factor * value, spread, sign), name, *ends  # type: ignore[return-value]


def size_in(value: float, unit: str) -> str:
    """A size with three digits in a readable unit."""
    factor, name = readable_unit(value, unit)
    return f"{float(f'{factor * value:.3g}'):.6g}{'' if name == '1' else f' {name}'}"


def percent(value: float) -> str:
    """A share in percent, with two digits."""
    return f"{float(f'{100.0 * value:.2g}'):g} %" if math.isfinite(value) else "-"


def part(c: Channel, residual: float) -> str:
    """A residual as a share of the motion, or in its unit if nothing moves."""
    return percent(c.share(residual)) if c.motion > 0.0 else size_in(residual, c.unit)


def times_noise(c: Channel) -> str:
    """What remains as a multiple of the noise of the sensor; empty: it is not known."""
    return (
        "" if math.isnan(c.noise) else f"{float(f'{c.explained / c.noise:.2g}'):g} times the noise"
    )


def joined(words: Sequence[str], last: str = "and") -> str:
    """Words as a list of a sentence."""
    return f" {last} ".join([*filter(None, [", ".join(words[:-1])]), *words[-1:]])


# ---------------------------------------------------------------- changes


def clause(c: Change) -> str:
    """What is different from the model, with its size and interval; of a class, all equivalents.

    The machine, the sensor or the input is the subject: what to do about it is another sentence.
    """
    first = _clause(c) + _where(c)
    same = dict.fromkeys(_clause(e) + _where(e) for e in c.equivalents)
    every = [text for text in same if text != first]  # an effect may be a parameter, too
    if not every:
        return first
    others = every[: EQUIVALENTS - 1]
    rest = len(every) - len(others)
    others += [f"{rest} more that the records do not tell apart"] if rest else []
    return f"either {joined([first, *others], 'or')}"


@dataclass(frozen=True)
class _Words:
    """Verbs of a change by its certainty and number, what it is about, and its size."""

    be: str
    has: str
    acts: str
    differs: str
    place: str
    what: str
    size: str

    @classmethod
    def of(cls, c: Change) -> _Words:
        about = c.subject
        what = f"the {about.fault} of {about.component}" if about.of_signal else CLOCK
        size = _sized(c.size, c.low, c.high, c.unit, relative=c.relative)
        place = about.component if about.scope.channels else f"the {about.component}"
        if not (_is_sure(c) and not c.low < 0.0 < c.high):
            return cls("may be", "may have", "may act", "may differ", place, what, size)
        several = bool(about.scope.channels)
        be, has, acts = ("are", "have", "act") if several else ("is", "has", "acts")
        return cls(be, has, acts, "differs", place, what, size)


def _is_sure(c: Change) -> bool:
    return c.tier not in ("supported", "unsure")


def _sized(value: float, low: float, high: float, unit: str, *, relative: bool) -> str:
    return "{}{} ({} to {})".format(*_numbers(value, low, high, unit, relative=relative))


def _clause(c: Change) -> str:
    about, words = c.subject, _Words.of(c)
    if about.scope.each and not about.of_signal and about.kind != "clock":
        return _varies(c, words)
    if len(c.records) == len(c.by_record) > 1:
        return f"{words.what} {words.differs} between the records: {_by_record(c)}"
    if about.of_signal or about.kind == "clock":
        return _of_signal(c, words)
    told = c.title if c.kind == "parameter" else about.label
    thing = told[:1].lower() + told[1:] if told[:4].lower() == "the " else ""
    if c.kind == "parameter" or thing:
        return _of_parameter(c, words, thing or f"the parameter {c.title}")
    return _of_law(c, words)


def _of_signal(c: Change, words: _Words) -> str:
    """An error of a signal, or of the clock."""
    about, place, size = c.subject, words.place, words.size
    fault = about.fault if about.of_signal else ""
    if fault == "absolute value":
        return f"{place} {'shows' if words.be == 'is' else 'may show'} the {fault}, by {size}"
    if fault in LOST:
        return _lost(c, fault, place, size if c.high < 1.0 and c.low > 0.0 else "")
    if fault == "lag":
        return f"{place} {words.has} a lag of {size}"
    if fault in DRIFTS:
        drifts = "drifts" if words.differs == "differs" else "may drift"
        over = f" with a time of {size_in(float(c.shape), 's')}" if fault == "gain fade" else ""
        return f"the {DRIFTS[fault]} of {about.component} {drifts} by {size}{over}"
    if about.of_signal and about.label:
        return f"{place} {words.has} {about.label}, {size}"
    if sign := sign_of_delay(c):
        return _delayed(c, words, sign)
    be = "may be" if words.be.startswith("may") else "is"
    return f"{words.what} {be} off by {size}"


def _delayed(c: Change, words: _Words, sign: float) -> str:
    """What is late or early, and by how much."""
    of_input = c.subject.kind == "input"
    least, most = sorted((sign * c.low, sign * c.high))
    of, name, low, high = _numbers(abs(c.size), least, most, c.unit, relative=False)
    way, back = ("earlier", "later") if of_input else ("late", "early")
    way, back = (way, back) if sign > 0 else (back, way)
    if least < 0.0 < most:  # the records do not tell the direction
        size = f"{of}{name} {way}, between {low.removeprefix('-')}{name} {back} and "
        size += f"{high}{name} {way}"
        then = "act at another time than recorded" if of_input else "be late or early"
        return f"{words.place} may {then} ({size})"
    size = f"{of}{name} ({low} to {high})"
    if of_input:
        return f"{words.place} {words.acts} {size} {way} than recorded"
    return f"{words.place} {words.be} {size} {way}"


def _of_law(c: Change, words: _Words) -> str:
    """A law that acts on a part, or between two parts."""
    what, size = c.subject.label, words.size
    if not what or not c.component:  # only its name tells what it is
        return f"the effect {c.title} {words.has} a size of {size}"
    between, letter = c.subject.kind == "between", len(c.component) == 1
    if c.subject.fault == "dry friction of each direction":
        side, share, _ = c.shape
        what, back = "dry friction", size_in(abs(share * c.size), c.unit)
        way = ("positive", "negative")[:: int(side)][0]
        size += f" in the {way} direction and {back} in the other"
    if c.subject.scope.channels:
        return f"{c.component} {words.has} {what} of {size} each"
    if c.subject.fault == "dead zone":
        what += " of \N{PLUS-MINUS SIGN}"
        what += size_in(float(np.ravel(c.shape)[0]), c.shape_names[0][12:-1])
        rest = f"where the stiffness of {size} does not act"
        if between:
            return f"there {words.be} {what} {c.component}, {rest}"
        thing = c.component if letter else _with_article(c.component)
        return f"{thing} {words.has} {what}, {rest}"
    if between:
        return f"{what} of {size} {words.acts} {c.component}"
    if letter:  # it may stand for anything
        return f"{what} of {size} {words.acts} on {c.component}"
    return f"{_with_article(c.component)} {words.has} {what} of {size}"


def _of_parameter(c: Change, words: _Words, thing: str) -> str:
    of, name, low, high = _numbers(c.size, c.low, c.high, c.unit, relative=c.relative)
    if c.user_unit is not None and c.user_unit.unit == "turn":
        turns, way, _ = turns_of(c)
        there = FURTHER.get(way, way if way.partition(" ")[0].endswith("er") else f"further {way}")
        return f"{thing} {words.be} {turns} {there} than in the model ({of}{name}, {low} to {high})"
    if c.tabulated == 0.0 or c.relative:
        of, name, low, high = _numbers(c.size, c.low, c.high, c.unit, relative=c.relative, sign="+")
        other = "the other records" if c.subject.scope.records else "the model"
        size = f"{of}{name} ({low} to {high}{_also(c)})"
        return f"{thing} {words.differs} from {other} by {size}"
    ends = (c.tabulated + c.low, c.tabulated + c.high)
    of, name, low, high = _numbers(c.tabulated + c.size, *ends, c.unit, relative=False)
    factor, _ = scale(*ends, c.unit)
    before = number(factor * c.tabulated)
    return f"{thing} {words.be} {of}{name} ({low} to {high}{_also(c)}) instead of {before}"


def _lost(c: Change, fault: str, place: str, share: str) -> str:
    """A dead zone or a saturation: its level, and the share that it takes away unless it is all."""
    *end, level = c.shape if isinstance(c.shape, tuple) else (c.shape,)
    about = ""
    if end and not isinstance(end[0], str):
        about, end = f" about {end[0]:.4g}", []
    unit = c.shape_names[-1].partition("[")[2].removesuffix("]") or "1"
    way = {"highest": "above ", "lowest": "below "}.get("".join(end), "\N{PLUS-MINUS SIGN}")
    level = f"{way}{size_in(float(level), unit)}"
    may = "may have" if c.tier in ("supported", "unsure") else "has"
    less = f", which takes away {share} of what is {LOST[fault]}" if share else ""
    return f"{place} {may} a {fault} {'' if end else 'of '}{level}{about}{less}"


def _varies(c: Change, words: _Words) -> str:
    """A law or a parameter that each record has by itself: its scatter, mean and range."""
    told = c.subject.label or f"the size of {c.name.removesuffix(' in each record')}"
    place = c.component if len(c.component) == 1 else _with_article(c.component)
    thing = told if told[:4].lower() == "the " else f"{told} of {place}"
    least, most = min(c.by_record), max(c.by_record)
    middle = sum(c.by_record) / len(c.by_record)
    mean, unit, low, high = _numbers(middle, least, most, c.unit, relative=c.relative)
    return (
        f"{thing} {words.differs} by {words.size} rms between the records: {low} to {high}{unit}, "
        f"{mean} on average"
    )


def _where(c: Change) -> str:
    """The records in which it is; of what grows, the last one has the size."""
    scope = c.subject.scope
    if not scope.shares:
        return scope.where
    return f" in {scope.records[-1]}, to which it grows from zero in the first record"


def _by_record(c: Change) -> str:
    """Sizes of an error that each record has by itself: where it is, if most do not have it."""
    most = max(map(abs, c.by_record))
    factor, unit = scale(0.0, most, c.unit, relative=c.relative)

    def of(value: float) -> str:
        return number(factor * value, 0.5 * factor * (c.high - c.low)) + unit

    named = sorted(zip(c.records, c.by_record, strict=True))
    odd = [f"{of(v)} in {n}" for n, v in named if 2.0 * abs(v) > most]
    if 2 * len(odd) > len(named):
        return f"{of(min(c.by_record))} to {of(max(c.by_record))}"
    rest = max(abs(v) for _, v in named if 2.0 * abs(v) <= most)
    return f"{shortened(joined(odd), 100)}, at most {of(rest)} in the others"


def sign_of_delay(c: Change) -> float:
    """Sign of a delay, which is told without it; 0: it is no delay, or one in each record.

    The reading is late by the size: if that of an input is early, the machine acts later.
    """
    about = c.subject
    told = about.of_signal and about.fault == "delay" and not about.scope.each
    return math.copysign(1.0, c.size) if told else 0.0


def _with_article(name: str) -> str:
    return name if name[:4].lower() == "the " else f"the {name}"


def turned(
    size: float, low: float, high: float, per_unit: float, words: Sequence[str]
) -> tuple[str, str, str]:
    """Turns of a screw, the direction in which it is off, and the way back: half a turn, down, up.

    The turns are a word where the interval leaves only one. A hand turns hundredths at best.
    """
    turns, spread = abs(per_unit * size), 0.5 * abs(per_unit * (high - low))
    near = min(TURNS, key=lambda t: abs(t - turns))
    sure = abs(near - turns) <= spread < SURE
    away = per_unit * size < 0.0
    told = TURNS[near] if sure else f"{number(turns, max(spread, SURE))} turns"
    return told, words[away], words[not away]


def turns_of(c: Change) -> tuple[str, str, str]:
    """See :func:`turned`; the change is one in turns."""
    assert c.user_unit is not None
    return turned(c.size, c.low, c.high, c.user_unit.per_unit, c.user_unit.words)


def turn_back(thing: str, turns: tuple[str, str, str]) -> str:
    """What to do about a screw on the machine."""
    return f"turn {thing} {turns[0]} {turns[2]}".rstrip()


def _also(c: Change) -> str:
    """The change in the further unit of the user."""
    if c.user_unit is None:
        return ""
    per, unit = c.user_unit.per_unit, c.user_unit.unit
    of, name, *_ = _numbers(per * c.size, per * c.low, per * c.high, unit, relative=False, sign="+")
    return f"; {of}{name}"
