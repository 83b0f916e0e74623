"""Files of limits: what is read, and one message with all faults."""

from __future__ import annotations

from dataclasses import replace

import pytest

from unmodeled import Effect, Parameter
from unmodeled.errors import DataError, InvalidParameter
from unmodeled.experiment import PartTest, design, read_limits

from .models import SQUARE, limits, line

LIMITS = """
schema = 1
duration = "0.5 s"
[inputs.u]
unit = "N"
most = "20 N"
rate = "2 kN/s"
[[parts]]
parameter = "slope"
sd = "2 %"
[sensors.y]
sigma = 0.1
[further_sensors.y]
sigma = 0.01
"""


@pytest.fixture
def read(tmp_path):
    """Read a text as a file of limits."""

    def reading(text, model=None, effects=()):
        path = tmp_path / "limits.toml"
        path.write_text(text)
        return read_limits(path, model or line(), effects)

    return reading


def test_limits_are_read(read):
    found = read(LIMITS)
    assert found.inputs["u"].most == 20.0
    assert found.inputs["u"].rate == pytest.approx(2000.0)
    assert found.parts[0].sd == pytest.approx(0.02)
    assert found.sensors == {"y": 0.1}
    assert found.further == {"y": 0.01}


def test_limits_may_test_effects(read):
    text = LIMITS.replace('"slope"\nsd = "2 %"', '"gap"\nsd = "0.1 mm"\ncost = 0.5')
    gap = replace(SQUARE, name="gap", unit="m")
    found = read(text, effects=[gap])
    assert (found.parts[0].parameter, found.parts[0].sd) == ("gap", pytest.approx(1e-4))
    with pytest.raises(DataError, match="part gap: no parameter"):
        read(text)
    with pytest.raises(DataError, match="part gap: it changes the same number as slope"):
        read(text, effects=[replace(gap, tolerance_parameter="slope")])
    with pytest.raises(DataError, match=r"parts\.0\.sd"):
        read(text.replace("0.1 mm", "0.1 N"), effects=[gap])


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('most = "20 N"', 'most = "20 mm"', "inputs.u.most"),
        ('most = "20 N"', "most = -1", "least < most"),
        ('most = "20 N"', "most = true", "inputs.u.most: "),
        ("[inputs.u]", "[inputs.v]", "input v: no input"),
        ('"slope"', '"slop"', "part slop: no parameter"),
        ("[sensors.y]", "[sensors.z]", "sensor z: no output"),
        ("[further_sensors.y]", "[further_sensors.z]", "further sensor z: no output"),
        ('duration = "0.5 s"', "", "duration: is missing"),
        ("most =", "moste =", "moste"),
        ('"0.5 s"', '"1 us"', "samples"),
        ('[inputs.u]\nunit = "N"\nmost = "20 N"\nrate = "2 kN/s"', "[inputs]", "inputs is empty"),
    ],
)
def test_faults_of_limits_are_told(read, old, new, told):
    with pytest.raises((DataError, InvalidParameter), match=told):
        read(LIMITS.replace(old, new))


def test_keys_names_and_numbers_are_told_together(read):
    """The unit of an entry whose name is wrong is not known: of it the name is told alone."""
    text = """
schema = 1
duration = "0.5 s"
lead = "1 s"
[inputs.v]
most = "20 mm"
[inputs.u]
unit = "N"
moste = "20 N"
rate = "2 m/s"
[[parts]]
parameter = "slope"
sd = "2 kg"
cost = -1
[[parts]]
parameter = "slope"
sd = 0
[sensors.y]
sigma = -1
"""
    with pytest.raises(DataError, match="8 faults") as failure:
        read(text)
    lines = [text.strip() for text in str(failure.value).splitlines()[1:]]
    starts = (
        "input v: no input",
        "inputs.u.most: is missing",
        "inputs.u.rate: ",
        "inputs.u.moste: unknown key",
        "parts.0.sd: ",
        "parts.0.cost: got -1",
        "parts.1: test of slope: sd = 0",
        "limits: lead = 1 s",
    )
    assert [t.startswith(s) for t, s in zip(lines, starts, strict=False)] == [True] * 8, lines
    assert "sensor y: sigma = -1" in "".join(lines)
    assert "inputs.v" not in str(failure.value)


def test_units_outside_mechanics(read):
    model = line(sd=1.0)
    model.parameters = (Parameter(name="C", value=100.0, sd=10.0, unit="J/K"),)
    model.units = {"u": "W", "y": "K"}
    text = """schema = 1
duration = "10 s"
[inputs.u]
most = "200 W"
rate = "5 W/s"
[sensors.y]
sigma = "0.1 K"
[[parts]]
parameter = "C"
sd = "2 J/K"
"""
    found = read(text, model)
    assert (found.inputs["u"].most, found.inputs["u"].rate) == (200.0, 5.0)
    assert found.sensors == {"y": 0.1}
    assert found.parts[0].sd == 2.0
    with pytest.raises(DataError) as error:
        read(text.replace("200 W", "200 N").replace("0.1 K", "0.1 kK"), model)
    assert (
        "inputs.u.most: got '200 N'; unit 'N' does not measure this quantity; expected a unit of W"
    ) in str(error.value)
    assert "sensors.y.sigma: got '0.1 kK'; unit 'kK': unknown unit" in str(error.value)


def test_limits_of_another_model_are_refused():
    """The same names in Python, all in one message; effects of sensors have no test of a part."""
    shift = Effect(name="shift", component="camera", observe=lambda _r, y, *_: y + 1.0)
    box = limits(
        parts=(PartTest(parameter="shift", sd=0.1), PartTest(parameter="slop", sd=0.1)),
        sensors={"z": 1.0}, further={"w": 1.0},
    )  # fmt: skip
    with pytest.raises(InvalidParameter) as failure:
        design(line(), [SQUARE, shift], limits=box)
    for told in (
        "part shift: an effect of the records and not", "part slop: no parameter",
        "sensor z: no output", "further sensor w: no output",
    ):  # fmt: skip
        assert told in str(failure.value)
