"""Impacts as sparse records, and the thesis's own gap put to the diagnosis."""

from pathlib import Path

import numpy as np
import pytest

import feltmb
from feltmb.adapters import ImpactModel, impact_record, load_impacts
from feltmb.data import read_records
from feltmb.errors import InvalidParameter

EXAMPLE = Path(__file__).parents[3] / "examples" / "thesis_gap"
OUTPUTS = ["rebound_speed", "max_impact_force", "impact_duration"]
#: Three strings as one: three times the tension, density and bending stiffness.
THREE = {"string.tension": 1962.0, "string.linear_density": 0.01794, "string.young_modulus": 6e11}
ONE = {"string.count": 1}


def record(values=None, speed=1.06):
    numbers = {o: (1.0, 1.0, "1") for o in OUTPUTS}
    return impact_record("impact", "piano", speed, numbers, values=values)


def test_a_impact_is_that_of_the_stroke_at_its_own_speed():
    action = feltmb.load_action("steinway45")
    run = feltmb.simulate(action, "piano", duration=0.26, ledger=False, rtol=1e-8)
    model = ImpactModel(action, (), [*OUTPUTS, "impact_speed"], rtol=1e-8)
    numbers = model.numbers(record(speed=run.summary["impact_speed"]), np.zeros(0))
    for key, value in numbers.items():
        assert value == pytest.approx(run.summary[key], rel=2e-5), key


def test_a_impact_arrives_with_the_speed_given_and_three_strings_are_stiffer():
    action = feltmb.load_action("steinway45").with_values(ONE)
    model = ImpactModel(action, (), [*OUTPUTS, "impact_speed"])
    one = model.numbers(record(), np.zeros(0))
    three = model.numbers(record(THREE), np.zeros(0))
    counted = model.numbers(record({"string.count": 3}), np.zeros(0))
    assert counted == pytest.approx(three, rel=1e-6)
    assert one["impact_speed"] == pytest.approx(1.06, rel=1e-5)
    # docs/validation/2026-11_thesis.md: 7.55 -> 11.6 N, 4.10 -> 2.87 ms at 1.051 m/s.
    assert three["max_impact_force"] / one["max_impact_force"] == pytest.approx(1.54, abs=0.02)
    assert three["impact_duration"] / one["impact_duration"] == pytest.approx(0.70, abs=0.01)


def test_the_committed_records_are_those_of_the_table():
    _, _, records = load_impacts(EXAMPLE / "table_4_3.toml")
    read = {r.name: r for r in read_records(sorted((EXAMPLE / "records").glob("*.csv")))}
    assert set(read) == {r.name for r in records}
    for made in records:
        same = read[made.name]
        assert same.role == made.role
        assert same.conditions == made.conditions
        for name, values in made.outputs.items():
            np.testing.assert_array_equal(same.outputs[name], values)
            assert same.sensors[name].sigma == made.sensors[name].sigma


def test_faults_of_a_table_come_at_once(tmp_path):
    path = tmp_path / "impacts.toml"
    path.write_text(
        """
schema = 1
action = "steinway45"
tolerances = ["mass.heat"]
[[records]]
name = "a"
stroke = "piano"
impact_speed = "1.0 m/s"
rebound_speed = { value = 0.5, unit = "m/s" }
[[records]]
name = "b"
stroke = "piano"
impact_speed = "1.0 m/s"
"""
    )
    with pytest.raises(InvalidParameter) as error:
        load_impacts(path)
    for part in ("3 faults", "records.a.rebound_speed: sd is missing", "records.b", "mass.head"):
        assert part in str(error.value)


@pytest.mark.slow
def test_the_gap_of_the_thesis_is_its_string():
    """Table 4.3 and the rebound speeds: three strings' impedance, proven on the forte impact."""
    from feltmb.gap import Options, diagnose

    model, effects, records = load_impacts(EXAMPLE / "table_4_3.toml")
    assert model.action.config.string.count == 1
    options = Options(bootstrap=0, restarts=0, max_effects=2, width=4)
    report = diagnose(model, effects, records, options=options)
    assert report.verdict == "NAMED"
    assert report.named == ("string_impedance",)
    found = report.which["string_impedance"]
    assert found.low < 2.0 < found.high  # one string plus two
    assert report.how_far.closed > 0.9
