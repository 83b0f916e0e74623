"""Accepted units. Inside all values are in SI units.

A value in a file is a number (in the SI unit of its field), a text ``"10.5 mm"``, or a table
``{ value = 10.5, unit = "mm", source = "..." }``. Composite units are written with spaces or ``*``
for products, ``/`` for quotients and ``^`` for powers: ``"kg mm^2"``, ``"N m/rad"``,
``"N/m^2.3"``. The caret is optional: ``"mm2"``, ``"m/s2"``, ``"mm²"``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator
from functools import lru_cache

import numpy as np

from unmodeled.arguments import AnyNumber, checked, text_readers
from unmodeled.errors import InvalidParameter

#: Dimensions. Radians are one, because an angle is not a plain number. Counts of a converter and
#: decibels measure nothing else.
_BASES = ("m", "kg", "s", "rad", "A", "K", "mol", "counts", "dB")
#: Name -> factor to SI, and exponents of the dimensions.
ACCEPTED_UNITS: dict[str, tuple[float, tuple[float, ...]]] = {
    "1": (1.0, (0.0,) * len(_BASES)),
    **{name: (1.0, tuple(float(name == n) for n in _BASES)) for name in _BASES},
}


def _prefixed(name: str, prefixes: str = "mµnukM") -> dict[str, float]:
    """A unit with and without prefixes, and the factors."""
    sizes = {"k": 1e3, "M": 1e6, "G": 1e9, "m": 1e-3, "u": 1e-6, "µ": 1e-6, "n": 1e-9, "p": 1e-12}
    return {name: 1.0, **{prefix + name: sizes[prefix] for prefix in prefixes}}


#: Dimension as a product of units above it -> factors to SI of units that measure it.
_UNITS_OF: dict[str, dict[str, float]] = {
    "m": {
        "mm": 1e-3,
        "cm": 1e-2,
        "um": 1e-6,
        "µm": 1e-6,
        "km": 1e3,
        "in": 0.0254,
        "ft": 0.3048,
        "mi": 1609.344,
    },
    "m^3": {"L": 1e-3, "l": 1e-3, "mL": 1e-6, "ml": 1e-6, "uL": 1e-9, "µL": 1e-9},
    "kg": {"g": 1e-3, "mg": 1e-6, "ug": 1e-9, "µg": 1e-9, "ng": 1e-12, "lb": 0.45359237},
    "s": {"ms": 1e-3, "us": 1e-6, "µs": 1e-6, "min": 60.0, "h": 3600.0, "day": 86400.0},
    "rad": {"mrad": 1e-3, "deg": math.pi / 180.0, "rev": 2.0 * math.pi},
    "rad/s": {"rpm": math.pi / 30.0},
    "m/s^2": {"gn": 9.80665},
    "1/s": {"Hz": 1.0, "kHz": 1e3},
    "kg/m": {"tex": 1e-6, "dtex": 1e-7, "den": 1e-3 / 9e3},
    "kg m/s^2": {
        **{"N": 1.0, "mN": 1e-3, "cN": 1e-2, "daN": 10.0, "kN": 1e3, "MN": 1e6},
        **{"uN": 1e-6, "µN": 1e-6},
        **{"gf": 9.80665e-3, "kgf": 9.80665, "lbf": 4.4482216152605},
    },
    "N/m^2": {
        **{"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9, "bar": 1e5, "mbar": 1e2, "hPa": 1e2},
        **{"psi": 4.4482216152605 / 0.0254**2},
    },
    "N m": {**_prefixed("J", "mkM"), "Wh": 3600.0, "kWh": 3.6e6},
    "J/s": _prefixed("W"),
    "A": _prefixed("A"),
    "A s": {"C": 1.0, "Ah": 3600.0, "mAh": 3.6},
    "W/A": _prefixed("V"),
    "V/A": _prefixed("ohm"),
    "V s/A": _prefixed("H", "munµ"),
    "A s/V": _prefixed("F", "munµp"),
    "V s/m^2": _prefixed("T"),
    # Differences of temperature; the zeros are in TEMPERATURE_SCALES.
    "K": {"mK": 1e-3, "degC": 1.0, "degF": 1.0 / 1.8},
    "mol": _prefixed("mol", "kmuµ"),
    "1": {"%": 1e-2, "ppm": 1e-6},
}

#: Unit of a reading, and unit of a scale -> zero of the scale as a reading, and factor: on the
#: scale, the temperature is (reading - zero) * factor.
TEMPERATURE_SCALES = {
    ("K", "degC"): (273.15, 1.0),
    ("degC", "K"): (-273.15, 1.0),
    ("degF", "degC"): (32.0, 1.0 / 1.8),
    ("degF", "K"): (-459.67, 1.0 / 1.8),
    ("degC", "degF"): (-32.0 / 1.8, 1.8),
    ("K", "degF"): (273.15 - 32.0 / 1.8, 1.8),
}

LONGEST_UNIT = 100  # characters
LONGEST_PRODUCT = 8  # characters that are read as a product of units in a hint
_FACTOR = re.compile(r"^(1(?=\^|$)|[A-Za-zµ%]+)(?:\^?([-+]?\d*\.?\d+))?$")
#: Signs, and how they are written here. Letters mu and omega are not the signs of micro and ohm.
_SIGNS = str.maketrans(
    {"²": "^2", "³": "^3", "μ": "µ", "°": "deg", "℃": "degC", "Ω": "ohm", "\N{OHM SIGN}": "ohm"}
)


def _plain(unit: str) -> str:
    """A unit without signs: degC for °C."""
    return unit.strip().translate(_SIGNS)


def _tokens(unit: str) -> Iterator[tuple[str, float]]:
    """Names and powers of the units of which a unit is composed."""
    if len(unit) > LONGEST_UNIT:
        raise ValueError(f"{len(unit)} characters; the limit is {LONGEST_UNIT}")
    text = _plain(unit)
    if text in ("", "-"):
        text = "1"
    parts = text.split("/")
    for number, part in enumerate(parts):  # rad/s/V is rad/(s V)
        sign = -1.0 if number else 1.0
        if sign < 0.0 and part.strip().startswith("(") and part.strip().endswith(")"):
            part = part.strip()[1:-1]  # J/(kg K) is J/kg K
        for token in part.replace("*", " ").replace("·", " ").split():
            match = _FACTOR.match(token)
            if match is None or match.group(1) not in ACCEPTED_UNITS:
                raise ValueError(f"unknown unit {token!r}{_alike(token)}")
            power = sign * float(match.group(2) or 1.0)
            if abs(power) > 10.0:
                raise ValueError(f"the power of {token!r} is beyond 10")
            yield match.group(1), power


@lru_cache(maxsize=10_000)
def _parse(unit: str) -> tuple[float, tuple[float, ...]]:
    factor = 1.0
    exponents = [0.0] * len(_BASES)
    for name, power in _tokens(unit):
        scale, dims = ACCEPTED_UNITS[name]
        factor *= scale**power
        exponents = [e + power * d for e, d in zip(exponents, dims, strict=True)]
    return factor, tuple(exponents)


for _dimension, _names in _UNITS_OF.items():
    _factors = {name: (factor, _parse(_dimension)[1]) for name, factor in _names.items()}
    ACCEPTED_UNITS.update(_factors)


def _alike(token: str) -> str:
    """A hint if a unit exists in another case, or if units are written without a space."""
    near = [name for name in ACCEPTED_UNITS if name.lower() == token.lower()]
    near = near or [" ".join(parts) for parts in _products(token)]
    return f" (did you mean {' or '.join(near[:2])}?)" if near else ""


def _products(token: str) -> list[tuple[str, ...]]:
    """Products of different units that are a text without its spaces, most units first."""
    found: list[tuple[str, ...]] = []
    for n in range(1, len(token) + 1 if len(token) <= LONGEST_PRODUCT else 0):
        head, rest = token[:n], token[n:]
        match = _FACTOR.match(head)
        if match is None or match[1] not in ACCEPTED_UNITS or rest[:1].isdigit():
            continue
        others = _products(rest) if rest else [()]
        found += [(head, *more) for more in others if head not in more]
    return sorted(found, key=len, reverse=True)


@checked
def dimension_text(si_unit: str) -> str:
    """Accepted forms of a quantity with the SI unit ``si_unit``, as text."""
    try:
        _, wanted = _parse(si_unit)
    except ValueError:
        return si_unit
    if _has_zero(si_unit):
        return si_unit
    same = [
        name
        for name, (_, dims) in ACCEPTED_UNITS.items()
        if dims == wanted and name != "1" and "µ" not in name and not _has_zero(name)
    ]
    return ", ".join(same) if same else si_unit


@checked
def conversion_factor(unit: str, si_unit: str) -> float:
    """Factor that converts a value in ``unit`` to the SI unit of its field.

    Parameters
    ----------
    unit
        As written in a file, for example ``"N/mm"``.
    si_unit
        Unit of the field, for example ``"N/m"``.

    Raises
    ------
    InvalidParameter
        The unit is unknown or has another dimension, or is a temperature with another zero
        (:func:`zero_and_factor`). Radians are a dimension of their own, because an angle is not a
        plain number; therefore ``1/s`` and ``rad/s`` differ as well.

    Examples
    --------
    How many N/m one kN/mm is:

    >>> from unmodeled.units import conversion_factor
    >>> conversion_factor("kN/mm", "N/m")
    1000000.0
    """
    if unit == si_unit:
        return 1.0
    try:
        factor, dims = _parse(unit)
    except ValueError as error:
        raise InvalidParameter(
            f"unit {unit!r}: {error}; expected a unit of {_with_examples(si_unit)}"
        ) from None
    try:
        target, wanted = _parse(si_unit)
    except ValueError:  # not a known unit: it can only be converted to itself
        raise InvalidParameter(
            f"unit {unit!r} does not measure this quantity; expected {si_unit}"
        ) from None
    if any(abs(a - b) > 1e-12 for a, b in zip(dims, wanted, strict=True)):
        raise InvalidParameter(
            f"unit {unit!r} does not measure this quantity; expected a unit of "
            f"{_with_examples(si_unit)}{weight_hint(unit, si_unit)}"
        )
    if (_has_zero(unit) or _has_zero(si_unit)) and _plain(unit) != _plain(si_unit):
        raise InvalidParameter(f"unit {unit!r} has another zero than {si_unit}; expected {si_unit}")
    return factor / target


@checked
def weight_hint(unit: str, wanted: str) -> str:
    """The end of a message about a mass in place of a force, or g as an acceleration; else "".

    Parameters
    ----------
    unit
        Given unit.
    wanted
        Expected unit.
    """
    if shows_gravity(unit, wanted):
        return "; hint: an acceleration of one g is the unit gn"
    try:
        dims = _parse(unit)[1], _parse(wanted)[1]
    except ValueError:
        return ""
    if dims != (_parse("kg")[1], _parse("N")[1]):
        return ""
    return "; hint: a force in grams has the unit gf (kilograms: kgf, pounds: lbf)"


@checked
def shows_gravity(unit: str, wanted: str) -> bool:
    """Whether a unit is the g of an accelerometer, because an acceleration is expected.

    Parameters
    ----------
    unit
        Given unit.
    wanted
        Expected unit.
    """
    try:
        return unit.strip() in ("g", "G") and _parse(wanted)[1] == _parse("gn")[1]
    except ValueError:
        return False


def _has_zero(unit: str) -> bool:
    """Whether the zero of a unit is not the zero of the quantity."""
    return _plain(unit) in ("degC", "degF")


@checked
def zero_and_factor(unit: str, other: str) -> tuple[float, float]:
    """Zero and factor that convert a reading: it is (reading - zero) * factor in the other unit.

    Only temperatures have a zero. See :func:`conversion_factor`.

    Parameters
    ----------
    unit
        Unit of the reading, for example ``"degC"``.
    other
        Unit of the result, for example ``"K"``.

    Examples
    --------
    Zero and factor of degrees Fahrenheit in K:

    >>> from unmodeled.units import zero_and_factor
    >>> [round(v, 4) for v in zero_and_factor("degF", "K")]
    [-459.67, 0.5556]
    """
    scale = TEMPERATURE_SCALES.get((_plain(unit), _plain(other)))
    return scale or (0.0, conversion_factor(unit, other))


def _with_examples(si_unit: str) -> str:
    """An SI unit, and other units of the quantity if there are any."""
    others = dimension_text(si_unit)
    return si_unit if others == si_unit else f"{si_unit} ({others})"


@checked
def convert(value: float, unit: str, si_unit: str) -> float:
    """Convert ``value`` from ``unit`` to ``si_unit``; see :func:`conversion_factor`.

    Parameters
    ----------
    value
        Number.
    unit
        Unit of the value.
    si_unit
        SI unit of the result.

    Examples
    --------
    A length of a drawing, and a speed:

    >>> from unmodeled.units import convert
    >>> convert(1.0, "in", "mm"), round(convert(1.0, "m/s", "km/h"), 6)
    (25.4, 3.6)
    """
    return value * conversion_factor(unit, si_unit)


_QUANTITY = re.compile(r"^\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S.{0,40})?$")


@checked
def number_and_unit(text: str) -> tuple[float, str] | None:
    """Number and unit of a text, whether or not the unit is known; None if there is no number.

    Examples
    --------
    >>> from unmodeled.units import number_and_unit
    >>> number_and_unit("12 mm")
    (12.0, 'mm')
    """
    match = _QUANTITY.match(text[:100])
    return None if match is None else (float(match.group(1)), (match.group(2) or "").strip())


@checked
def split_quantity(text: str) -> tuple[float, str] | None:
    """Number and unit of a text such as ``"300 ms"``; None if there is no known unit.

    Examples
    --------
    Number and unit of a text:

    >>> from unmodeled.units import split_quantity
    >>> split_quantity("3.5 mm")
    (3.5, 'mm')
    """
    quantity = number_and_unit(text)
    if quantity is None:
        return None
    try:
        _parse(quantity[1])
    except ValueError:
        return None
    return quantity


@checked
def si_value(text: str) -> float | None:
    """Value in SI units of a text such as ``"300 ms"``, for any quantity; None if invalid.

    Examples
    --------
    >>> from unmodeled.units import si_value
    >>> si_value("3.5 mm")
    0.0035
    """
    quantity = split_quantity(text)
    return None if quantity is None else quantity[0] * _parse(quantity[1])[0]


text_readers.append(si_value)

#: SI units of quantities that have a usual form.
_USUAL = (
    *("1", "m", "kg", "s", "rad", "1/s", "Hz", "N", "Pa", "J", "m^2", "m^3", "m/s", "m/s^2"),
    *("rad/s", "rad/s^2", "N/m", "N s/m", "N m/rad", "N m s/rad", "kg m^2", "m^3/s", "kg/s"),
    *("kg/m^3", "N m", "Pa s", "A", "V", "W", "ohm", "H", "F", "T", "K", "mol", "J/K", "W/K"),
)


@checked
def to_si(unit: str) -> tuple[float, str]:
    """Factor to SI, and the SI unit, of any accepted unit.

    Of several SI units of one dimension, the unit is the one that is written most alike: N mm is a
    torque in N m and mJ an energy in J; kg/h is a flow in kg/s and N s/mm a damping in N s/m.
    Readings in degC and degF are kept, because their scale has another zero than that of K.

    Parameters
    ----------
    unit
        As written in a file, for example ``"L/min"``.

    Raises
    ------
    InvalidParameter
        The unit is unknown.

    Examples
    --------
    Factor and SI unit of an instrument's unit:

    >>> from unmodeled.units import to_si
    >>> to_si("kN"), to_si("N mm")
    ((1000.0, 'N'), (0.001, 'N m'))
    """
    try:
        factor, dims = _parse(unit)
    except ValueError as error:
        raise InvalidParameter(f"unit {unit!r}: {error}") from None
    if _has_zero(unit):
        return 1.0, _plain(unit)
    same = [usual for usual in _USUAL if _parse(usual)[1] == dims]
    if same:
        named = _quantities_in(unit)
        return factor, max(same, key=lambda usual: len(_quantities_in(usual) & named))
    powers = dict(zip(_BASES, dims, strict=True))
    over = " ".join(_power(name, p) for name, p in powers.items() if p > 0.0)
    under = " ".join(_power(name, -p) for name, p in powers.items() if p < 0.0)
    return factor, f"{over or '1'}/{under}" if under else over


@checked
def stays_beside(unit: str, others: Collection[str]) -> bool | None:
    """Whether a unit is a product of powers of other units and of SI units: cm^2 or N/cm beside cm.

    Parameters
    ----------
    unit
        An accepted unit.
    others
        Units; those that are not accepted do not count.

    Returns
    -------
    bool or None
        False: it has no part that measures what one of the others measures, apart from time: SI
        units in its place change nothing that they share. None: it is neither, as mm beside cm.
    """
    known = {other: parts for other in others if (parts := _not_si(other))}
    own = _not_si(unit)
    if not own or not known:
        return False
    names = list({name for parts in (own, *known.values()) for name in parts})
    columns = np.array([[parts.get(name, 0.0) for parts in known.values()] for name in names])
    wanted = np.array([own.get(name, 0.0) for name in names])
    powers = np.linalg.lstsq(columns, wanted, rcond=None)[0]
    if np.allclose(columns @ powers, wanted):
        return True
    apart = {_without_time(q) for q in (*own, _parse(unit))}
    shared = {_without_time(q) for o, parts in known.items() for q in (*parts, _parse(o))}
    return None if (apart & shared) - {_without_time(_parse("1"))} else False


def _not_si(unit: str) -> dict[tuple[float, tuple[float, ...]], float]:
    """Powers of the units in a unit that are not SI units, by factor and dimensions."""
    found: dict[tuple[float, tuple[float, ...]], float] = {}
    for name, power in _tokens(unit) if _is_accepted(unit) else ():
        if ACCEPTED_UNITS[name][0] != 1.0:
            found[ACCEPTED_UNITS[name]] = found.get(ACCEPTED_UNITS[name], 0.0) + power
    return {name: power for name, power in found.items() if power}


def _is_accepted(unit: str) -> bool:
    try:
        return bool(_parse(unit))
    except ValueError:
        return False


def _without_time(quantity: tuple[float, tuple[float, ...]]) -> tuple[float, ...]:
    """Dimensions of a quantity, or of its rate."""
    return tuple(d * (base != "s") for d, base in zip(quantity[1], _BASES, strict=True))


def _quantities_in(unit: str) -> set[tuple[float, ...]]:
    """Dimensions of the units of which a unit is composed."""
    tokens = re.findall(r"[^\s/*·()]+", _plain(unit))
    return {ACCEPTED_UNITS[match[1]][1] for token in tokens if (match := _FACTOR.match(token))}


def _power(name: str, power: float) -> str:
    return name if power == 1.0 else f"{name}^{power:g}"


#: SI unit -> (limit of the value, factor, unit) for small values, in ascending order.
_SMALL = {
    "m": [(1e-6, 1e6, "um"), (1.0, 1e3, "mm")],
    "s": [(1.0, 1e3, "ms")],
    "J": [(1.0, 1e3, "mJ")],
    "kg": [(1e-5, 1e6, "mg"), (0.1, 1e3, "g")],
    "H": [(1e-3, 1e6, "uH"), (1.0, 1e3, "mH")],
    "F": [(1e-9, 1e12, "pF"), (1e-6, 1e9, "nF"), (0.1, 1e6, "uF")],
}


@checked
def readable_unit(value: AnyNumber, unit: str) -> tuple[float, str]:
    """Factor and unit in which people read a value: small lengths in mm, short times in ms.

    Parameters
    ----------
    value
        Value [``unit``].
    unit
        SI unit; without an entry in the list, the factor is 1.

    Examples
    --------
    The factor and the unit in which a length of 0.3 mm is told:

    >>> from unmodeled.units import readable_unit
    >>> readable_unit(3e-4, "m")
    (1000.0, 'mm')
    """
    for limit, factor, name in _SMALL.get(unit, []):
        if abs(value) < limit:
            return factor, name
    return 1.0, unit


@checked
def pretty(value: AnyNumber, unit: str) -> tuple[str, str]:
    """Number with four digits and unit for people: small lengths in mm, short times in ms.

    Parameters
    ----------
    value
        Value [``unit``].
    unit
        SI unit.
    """
    factor, name = readable_unit(value, unit)
    return f"{value * factor:.4g}", name


@checked
def unit_suffix(unit: str) -> str:
    """Text after a number: a space and the unit, or nothing for the unit 1."""
    return "" if unit == "1" else f" {unit}"
