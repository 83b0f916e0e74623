"""Units at the door."""

import math

import pytest

from unmodeled.errors import InvalidParameter
from unmodeled.units import (
    ACCEPTED_UNITS,
    conversion_factor,
    convert,
    dimension_text,
    pretty,
    spelled_unit,
    to_si,
    zero_and_factor,
)
from unmodeled.units.quantity import parse_scalar


@pytest.mark.parametrize(
    ("value", "unit", "si", "expected"),
    [
        (10.5, "mm", "m", 0.0105),
        (90.0, "deg", "rad", math.pi / 2),
        (1741.0, "kg mm^2", "kg m^2", 1.741e-3),
        (1741.0, "kg*mm^2", "kg m^2", 1.741e-3),
        (27.0, "N/mm", "N/m", 27000.0),
        (3.0, "N m/rad", "N m/rad", 3.0),
        (2.0, "N mm/deg", "N m/rad", 2e-3 * 180.0 / math.pi),
        (1.0, "mg/mm^3", "kg/m^3", 1e3),
        (12.5, "ms", "s", 0.0125),
        (5.0, "kHz", "Hz", 5000.0),
        (200.0, "GPa", "Pa", 2e11),
        (100.0, "gf", "N", 0.980665),
        (7.0, "%", "1", 0.07),
        (3.0, "", "1", 3.0),
        (3.0, "-", "1", 3.0),
        (4.0, "1/mm", "1/m", 4000.0),
        (2.0, "N/m^2.3", "N/m^2.3", 2.0),
        (1.0, "m s^-2", "m/s^2", 1.0),
        (1.0, "kg m/s^2", "N", 1.0),
        (6.0, "µm", "m", 6e-6),
    ],
)
def test_conversion(value, unit, si, expected):
    assert convert(value, unit, si) == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize("unit", sorted(ACCEPTED_UNITS))
def test_every_unit_converts_to_itself(unit):
    assert conversion_factor(unit, unit) == 1.0


@pytest.mark.parametrize(
    ("unit", "factor", "si"),
    [
        ("rpm", math.pi / 30.0, "rad/s"),
        ("L/min", 1e-3 / 60.0, "m^3/s"),
        ("l/h", 1e-3 / 3600.0, "m^3/s"),
        ("N mm", 1e-3, "N m"),
        ("mJ", 1e-3, "J"),
        ("J*1", 1.0, "J"),
        ("kg/h", 1.0 / 3600.0, "kg/s"),
        ("N s/mm", 1e3, "N s/m"),
        ("N s/m^2", 1.0, "Pa s"),
        ("N/mm", 1e3, "N/m"),
        ("kg m^2", 1.0, "kg m^2"),
        ("g/cm^3", 1e3, "kg/m^3"),
        ("kg/s^2", 1.0, "N/m"),
        ("m^2/s^3", 1.0, "m^2/s^3"),
        ("kW", 1e3, "W"),
        ("V A", 1.0, "W"),
        ("kWh", 3.6e6, "J"),
        ("mmol/l", 1.0, "mol/m^3"),
        ("kJ/(h K)", 1e3 / 3600.0, "W/K"),
        ("W/(m² °C)", 1.0, "kg/s^3 K"),
        ("mV/A", 1e-3, "ohm"),
        ("mH", 1e-3, "H"),
        ("V s/A", 1.0, "H"),
        ("uF", 1e-6, "F"),
        ("pF", 1e-12, "F"),
        ("kΩ", 1e3, "ohm"),
        ("k\N{OHM SIGN}", 1e3, "ohm"),
        ("counts", 1.0, "counts"),
        ("kPa.0", 1.0, "1"),  # a heading without its end: a power without a digit before the point
    ],
)
def test_si_units_of_any_unit(unit, factor, si):
    found, name = to_si(unit)
    assert name == si
    assert found == pytest.approx(factor, rel=1e-15)
    assert conversion_factor(unit, si) == pytest.approx(factor, rel=1e-15)


@pytest.mark.parametrize(
    ("value", "unit", "shown"),
    [
        (2.2e-3, "H", ("2.2", "mH")),
        (3.3e-5, "H", ("33", "uH")),
        (4.7e-3, "F", ("4700", "uF")),
        (5e-8, "F", ("50", "nF")),
        (1e-10, "F", ("100", "pF")),
    ],
)
def test_small_inductances_and_capacitances_are_read_in_their_units(value, unit, shown):
    assert pretty(value, unit) == shown


@pytest.mark.parametrize(
    ("unit", "si", "message"),
    [
        ("kg", "m", "does not measure this quantity; expected a unit of m"),
        ("rad/s", "1/s", "does not measure"),
        ("g", "N", r"kgf, lbf\); hint: a force in grams has the unit gf \(kilograms: kgf, pounds"),
        ("N", "kg", r"expected a unit of kg \(kg, g, mg, ug, ng, lb\)$"),
        ("kg", "N m", r"expected a unit of N m \(J, .*, kWh\)$"),
        ("furlong", "m", "unknown unit 'furlong'"),
        ("RPM", "rad/s", r"unknown unit 'RPM' \(did you mean rpm\?\)"),
        ("N/m/s", "N/m", "does not measure"),
        ("mm^", "m", "unknown unit"),
        ("Mm", "m", "unknown unit"),
        ("ms", "m", "does not measure"),
        ("N", "W", "expected a unit of W"),
        ("degC", "K", "unit 'degC' has another zero than K; expected K"),
        ("K", "°C", "another zero"),
        ("mK", "degF", "another zero"),
    ],
)
def test_wrong_units_name_what_is_expected(unit, si, message):
    with pytest.raises(InvalidParameter, match=message.replace("^", r"\^")):
        conversion_factor(unit, si)


@pytest.mark.parametrize(
    ("reading", "unit", "other", "expected"),
    [
        (26.85, "°C", "K", 300.0),
        (212.0, "°F", "°C", 100.0),
        (300.0, "K", "degC", 26.85),
        (5.0, "mV", "V", 5e-3),
    ],
)
def test_only_readings_of_temperatures_have_a_zero(reading, unit, other, expected):
    zero, factor = zero_and_factor(unit, other)
    assert (reading - zero) * factor == pytest.approx(expected, rel=1e-12)


def test_temperatures_keep_their_scale_and_rates_have_none():
    assert to_si("°C") == (1.0, "degC")
    assert to_si("degC/h") == (pytest.approx(1.0 / 3600.0), "K/s")


def test_accepted_ways_are_listed():
    assert dimension_text("N") == "N, mN, cN, daN, kN, MN, uN, gf, kgf, lbf"
    assert "mm" in dimension_text("m")
    assert dimension_text("K") == "K, mK"
    assert dimension_text("degC") == "degC"
    assert dimension_text("N/m^2.3") == "N/m^2.3"


@pytest.mark.parametrize(
    ("node", "expected"),
    [
        (3, 3.0),
        (2.5e-3, 2.5e-3),
        ("2.5 mm", 2.5e-3),
        ("-2.5e1mm", -0.025),
        ("7", 7.0),
        ({"value": 2.5, "unit": "mm"}, 2.5e-3),
        ({"value": 2.5}, 2.5),
        ({"value": 2.5, "unit": "mm", "source": "A.3", "status": "measured", "sd": 0.1}, 2.5e-3),
    ],
)  # fmt: skip
def test_quantity(node, expected):
    assert parse_scalar(node, "m") == pytest.approx(expected, rel=1e-15)


@pytest.mark.parametrize(
    ("node", "message"),
    [
        ("two mm", "expected a finite number with a unit of m"),
        ("2 kg", "does not measure"),
        (True, "expected a number"),
        (math.nan, "expected a finite number"),
        (math.inf, "expected a finite number"),
        ([1.0], "expected a number"),
        (None, "expected a number"),
        ({"unit": "mm"}, "needs the key 'value'"),
        ({"value": 1.0, "units": "mm"}, "unknown key units in a quantity; known are"),
        ({"value": 1.0, "unit": 3}, "got unit 3, expected a text"),
        ({"value": "1.0", "unit": "mm"}, "expected a number"),
        ({"value": 1.0, "status": "guessed"}, "status 'guessed' is none of measured"),
    ],
)
def test_faults_of_a_quantity(node, message):
    with pytest.raises(ValueError, match=message):
        parse_scalar(node, "m")


@pytest.mark.parametrize(
    ("text", "unit"),
    [("Nm", "N m"), ("N.m", "N m"), ("N-m", "N m"), ("mNm", "mN m"), ("NM", None), ("nm", None)],
)
def test_torques_are_read_as_instruments_write_them(text, unit):
    assert spelled_unit(text) == unit


@pytest.mark.parametrize(
    ("unit", "si", "factor"),
    [
        ("cm2", "m^2", 1e-4),
        ("mm²", "m^2", 1e-6),
        ("m/s2", "m/s^2", 1.0),
        ("N/mm2", "Pa", 1e6),
        ("m s-2", "m/s^2", 1.0),
        ("N/m^2.3", "N/m^2.3", 1.0),
        ("bar", "Pa", 1e5),
        ("μm", "m", 1e-6),
        ("1/s", "1/s", 1.0),
    ],
)
def test_powers_without_a_caret(unit, si, factor):
    assert conversion_factor(unit, si) == pytest.approx(factor, rel=1e-15)


@pytest.mark.parametrize("unit", ["m2m", "12", "mm^", "m^^2", "2m"])
def test_what_is_no_unit(unit):
    with pytest.raises(InvalidParameter, match="unknown unit"):
        conversion_factor(unit, "m")


@pytest.mark.parametrize(
    ("unit", "meant"),
    [("Ns/m", "N s"), ("kgm2", "kg m2"), ("Nms/rad", "N m s or N ms"), ("W/m2K", "m2 K")],
)
def test_units_without_a_space_between_them_are_told(unit, meant):
    with pytest.raises(InvalidParameter, match=f"did you mean {meant}"):
        to_si(unit)


def test_an_unknown_unit_of_many_letters_is_told_at_once():
    with pytest.raises(InvalidParameter, match="unknown unit 'mmm"):
        to_si("m" * 90)


def test_speeds_of_vehicles():
    assert conversion_factor("km/h", "m/s") == pytest.approx(1 / 3.6)
    assert conversion_factor(spelled_unit("mph"), "m/s") == pytest.approx(0.44704)
    assert conversion_factor(spelled_unit("mAh"), "A s") == pytest.approx(3.6)
