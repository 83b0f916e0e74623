"""Units and column headings in the notation of instruments: ``Extension (mm)``, ``Time_s``."""

from __future__ import annotations

import re
from functools import lru_cache

from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter
from unmodeled.units.names import ACCEPTED_UNITS, conversion_factor, to_si

#: Not a unit until its size is known.
PIXEL = "px"

_NAMES = {
    "m": "meter meters metre metres",
    "mm": "millimeter millimeters millimetre millimetres",
    "cm": "centimeter centimeters centimetre centimetres",
    "um": "micrometer micrometers micrometre micrometres micron microns",
    "in": "inch inches",
    "s": "sec secs second seconds sekunde sekunden",
    "ms": "msec msecs millisecond milliseconds",
    "us": "usec microsecond microseconds",
    "min": "minute minutes",
    "h": "hour hours hr hrs stunde stunden",
    "day": "days tag tage",
    "bar": "bars",
    "rpm": "rpm u/min r/min",
    "L": "liter liters litre litres",
    "mL": "milliliter milliliters millilitre millilitres",
    "lb": "lbs pound pounds",
    "N": "newton newtons",
    "mN": "millinewton millinewtons",
    "kN": "kilonewton kilonewtons",
    "kg": "kilogram kilograms",
    "g": "gram grams",
    "rad": "radian radians",
    "deg": "degree degrees °",
    "Hz": "hertz",
    "kHz": "kilohertz",
    "Pa": "pascal pascals",
    "%": "percent",
    "degC": "°c celsius degc",
    "degF": "°f fahrenheit degf",
    "K": "kelvin",
    "A": "ampere amperes amps",
    "V": "volt volts",
    "W": "watt watts",
    "kW": "kilowatt kilowatts",
    "ohm": "ohm ohms",
    "T": "tesla",
    "km/h": "kmh kph kmph",
    "mi/h": "mph",
    "Ah": "ah",
    "mAh": "mah",
    PIXEL: "px pixel pixels pix",
}
#: Torques as instruments write them; "nm" is a length.
_TORQUES = {
    f"{prefix}N{dot}m": f"{prefix}N m"
    for prefix in ("", "m", "u", "µ", "k")
    for dot in ("", ".", "-")
}
_SPELLED = {word: unit for unit, words in _NAMES.items() for word in words.split()}
_LENGTH, _FORCE = "m", "N"
#: Words after which a bare unit may follow (``Time_s``), and their quantity. Elsewhere, the end of
#: a name is not a unit: ``force_in`` is not a force in inches.
_WORDS_OF = {
    "s": "time t zeit temps tiempo",
    _FORCE: "force load kraft fz fy fx",
    _LENGTH: "displacement extension position travel stroke distance compression deflection weg "
    "x y",
    "rad": "angle rotation winkel",
    "A": "current strom",
    "V": "voltage",
    "W": "power leistung",
    "K": "temperature temperatur temp",
}
_MEASURED = {word: si for si, words in _WORDS_OF.items() for word in words.split()}
_BRACKETED = re.compile(r"(.*\S)?\s*[\[(<]((?:[^\[\]()<>]|\([^()]*\))*)[\])>]\s*")
#: ``pos[0]``, ``pos[x]``: an index, no unit; ``pump [1]`` has the unit 1.
_INDEX = re.compile(r".*\S\[(?:\d+|[xyz])\]")
#: As in standards of notation, a quantity over its unit: ``U_B1 / V``, ``M / N m``.
_OVER = re.compile(r"(.*\S)\s+/\s+(\S.*)")
_BARE = re.compile(r"(.*?[^\s_,/])(\s*[_,/]\s*|\s+|\s+in\s+)([mkuµ]?N m|[^\s_,/]+(?:/[^\s_,/]+)?)")
#: Units that are no word and no label: after a space they count behind any name (``Taste mm``).
_CLEAR = (
    "mm cm um µm ms us µs mN cN uN µN kN MN gf kgf lbf kPa MPa GPa hPa mbar psi mrad deg ° Hz kHz "
    "rpm km/h mA mV kW °C degC degF °F kg N/mm N/m m/s mm/s m/s^2 m/s² rad/s deg/s mN/mm Nm mNm "
    "uNm µNm px"
)


@lru_cache(maxsize=10_000)
def spelled_unit(text: str) -> str | None:
    """The accepted notation of a unit; None if the text is not a unit.

    Examples
    --------
    Units as files write them:

    >>> from unmodeled.units import spelled_unit
    >>> spelled_unit("Nm"), spelled_unit("sec"), spelled_unit("parsnips")
    ('N m', 's', None)
    """
    text = text.strip()
    if text.startswith(("[", "(")):
        text = text.strip("[]() ")
    text = text.rstrip(".")
    if not text:
        return None
    word = _TORQUES.get(text) or _SPELLED.get(text.lower())
    if word is not None:
        return word
    try:
        to_si(text)
    except InvalidParameter:
        return None
    return text


@checked
def same_unit(one: str, other: str) -> bool:
    """Whether two texts are the same unit, for example ``N*m`` and ``N m``.

    Examples
    --------
    >>> from unmodeled.units import same_unit
    >>> same_unit("N m", "Nm"), same_unit("N", "kN")
    (True, False)
    """
    units = [spelled_unit(text) or text for text in (one, other)]
    if units[0] == units[1]:
        return True
    try:
        return conversion_factor(units[0], units[1]) == 1.0
    except InvalidParameter:
        return False


@checked
def split_column(heading: str) -> tuple[str, str]:
    """Name and unit of a column in the header of an instrument; "" if there is no unit.

    ``force [N]``, ``Extension (mm)``, ``Time<ms>``, ``Time_s``, ``Force, N``, ``U_B1 / V``. A text
    in square or angle brackets is a unit, known or not; elsewhere, only a known unit counts.

    Examples
    --------
    Headings of instruments:

    >>> from unmodeled.units import split_column
    >>> split_column("Force (kN)"), split_column("time_ms"), split_column("I (A)")
    (('Force', 'kN'), ('time', 'ms'), ('I', 'A'))
    """
    text = heading.strip()
    brackets = _BRACKETED.fullmatch(text)
    if brackets is not None and not _INDEX.fullmatch(text):
        name, unit = (brackets[1] or "").strip(), brackets[2].strip()
        if text.endswith(("]", ">")):
            return name, spelled_unit(unit) or unit
        known = _unit_in_brackets(name, unit)
        return (name, known) if name and known else (text, "")
    over = _OVER.fullmatch(text)
    if over is not None and (unit := spelled_unit(over[2])):
        return over[1].strip(), unit
    bare = _BARE.fullmatch(text)
    if bare is not None and (known := spelled_unit(bare[3])):
        clear = bare[2].isspace() and (bare[3] in _CLEAR.split() or " " in bare[3])
        if clear or _fits(bare[1].strip(), known):
            return bare[1].strip(), known
    return text, ""


def _unit_in_brackets(name: str, unit: str) -> str | None:
    """The unit that a text in round brackets is.

    "Force (L)" is a force at the left and "Force (A)" one of sensor A, but "Time (h)" is in hours
    and "I (A)" in amperes.
    """
    known = spelled_unit(unit)
    letter = unit in ("L", "l", "h", "C") or (unit in ("A", "T") and _measured(name))
    return None if letter and not (known and _fits(name, known)) else known


def _measured(name: str) -> str | None:
    """SI unit of the quantity that is the last word of a name."""
    return _MEASURED.get(re.split(r"[\s_./]", name.lower())[-1])


def _fits(name: str, unit: str) -> bool:
    """Whether the last word of a name is a quantity that the unit measures."""
    si = _measured(name)
    if si is None or unit == PIXEL:
        return unit == PIXEL and si == _LENGTH
    if unit not in ACCEPTED_UNITS:
        return False
    return ACCEPTED_UNITS[unit][1] == ACCEPTED_UNITS[si][1]
