"""Published hammers, and stiffnesses in units of the literature."""

import json
import math

import numpy as np
import pytest

import feltmb
from feltmb.contact import HAMMERS, hammer, law


def test_the_numbers_are_those_of_the_sources():
    middle = HAMMERS["chaigne_askenfelt_C4"]
    assert (middle.mass, middle.stiffness, middle.exponent) == (2.97e-3, 4.5e9, 2.5)
    key = hammer("stulov:40")
    assert key.exponent == pytest.approx(4.3)
    assert key.stiffness == pytest.approx(183 * math.exp(1.8) * 1e3**4.3)
    with pytest.raises(feltmb.InvalidParameter, match="stulov:1 to stulov:88"):
        hammer("stulov:89")


def test_a_blow_on_a_rigid_surface_is_that_of_the_law():
    """Force and duration against a step by step integration; duration against force by its power.

    Hall and Askenfelt (1988): the duration goes with F^((1 - p)/(2 p)).
    """
    one = HAMMERS["chaigne_askenfelt_C4"]
    felt = law("hunt_crossley", stiffness=one.stiffness, exponent=one.exponent)
    h, e, v, force, time = 2e-7, 0.0, 2.0, [0.0], 0.0
    while e >= 0.0:
        v -= 0.5 * h * force[-1] / one.mass
        e += h * v
        force.append(felt.step(e, h))
        v -= 0.5 * h * force[-1] / one.mass
        time += h
    largest, duration = one.contact(2.0)
    assert max(force) == pytest.approx(largest, rel=1e-6)
    assert time == pytest.approx(duration, rel=1e-3)
    harder = one.contact(4.0)
    power = math.log(harder[1] / duration) / math.log(harder[0] / largest)
    assert power == pytest.approx((1.0 - one.exponent) / (2.0 * one.exponent), rel=1e-12)
    with pytest.raises(feltmb.InvalidParameter, match="mass None"):
        hammer("stulov:1").contact(1.0)


@pytest.mark.parametrize(
    ("stiffness", "expected"),
    [("164000 N/mm^4.3", 164e3 * 1e3**4.3), ("3e8 N/m^p", 3e8), ("3e8", 3e8), (3e8, 3e8)],
)
def test_stiffness_in_units_of_the_literature(stiffness, expected):
    numbers = {"stiffness": stiffness, "exponent": 4.3, "amplitude": 0.9, "time": "3 us"}
    made = law("stulov", **numbers).core.fields
    assert made["stiffness"] == pytest.approx(expected, rel=1e-12)
    assert made["time"] == pytest.approx(3e-6, rel=1e-12)
    entry = {"contacts.06.law": {"name": "stulov", **numbers}}
    contact = feltmb.load_action("steinway45").with_values(entry).config.contacts["06"]
    assert contact.stulov.stiffness == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("stiffness", "message"),
    [
        ("164000 N/mm^4.2", r"power 4.2 of a length, expected 4.3, that of exponent"),
        ("164000 N/mm^p", r"one such as 'N/mm\^4.3'"),
        ("3 kg", "got unit 'kg'"),
    ],
)
def test_wrong_units_of_a_stiffness_are_told(stiffness, message):
    numbers = {"stiffness": stiffness, "exponent": 4.3, "amplitude": 0.9, "time": 3e-6}
    with pytest.raises(feltmb.InvalidParameter, match=message):
        law("stulov", **numbers)
    with pytest.raises(feltmb.Error, match=message):
        feltmb.load_action("steinway45").with_values(
            {"contacts.06.law": {"name": "stulov", **numbers}}
        )


def test_the_list_tells_the_hammers(capsys):
    from feltmb.cli import main

    with pytest.raises(SystemExit):
        main(["list", "--json"])
    told = {one["name"]: one for one in json.loads(capsys.readouterr().out)["hammers"]}
    assert told["chaigne_askenfelt_C4"]["mass"] == 2.97e-3
    assert told["stulov:88"]["exponent"] == pytest.approx(5.02)
    assert np.isfinite(hammer("stulov:88").stiffness)
