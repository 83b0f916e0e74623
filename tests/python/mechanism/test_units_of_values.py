"""Values in any unit: a text, a table or a number; units by the kind of joint or contact."""

import importlib

import pytest
from calls import command

import feltmb
from feltmb import _core
from feltmb.mechanism import Action, describe
from feltmb.mechanism.parameters import all_parameters
from unmodeled.errors import InvalidParameter


@pytest.fixture(scope="module")
def sledge(data):
    return feltmb.load_action(data / "mass_spring.toml")


@pytest.mark.parametrize("written", ["15 g", "0.015 kg", {"value": 15.0, "unit": "g"}, 0.015])
def test_a_value_is_scaled_however_it_is_written(pendulum, written):
    raw = pendulum.raw
    raw["bodies"]["arm"]["mass"] = written
    made = Action(raw)
    axis = importlib.import_module("feltmb.run.sweep").Axis("arm.mass", (1.2,), "scale")
    assert made.with_values(axis.at(1.2)).config.bodies["arm"].mass == pytest.approx(0.018)
    table = feltmb.sweep(
        made,
        feltmb.ramp_stroke(1.0, duration=0.002),
        {"arm.mass": {"scale": [1.0, 1.2]}},
        progress=False,
    ).table
    assert list(table["status"]) == ["done", "done"]


def test_a_number_without_a_unit_is_in_si_units_where_the_file_has_a_text(pendulum):
    raw = pendulum.raw
    raw["bodies"]["arm"]["mass"] = "15 g"
    raw["surfaces"]["block"]["point"] = ["9 mm", "350 mm"]
    made = Action(raw).with_values({"arm.mass": 0.016, "surfaces.block.point.x": 0.01})
    assert made.config.bodies["arm"].mass == pytest.approx(0.016)
    assert made.raw["bodies"]["arm"]["mass"] == "16.0 g"
    assert made.config.surfaces["block"].point == pytest.approx((0.010, 0.350))
    assert Action(raw).with_values({"arm.mass": "16 kg"}).config.bodies["arm"].mass == 16.0


def test_units_of_a_spring_are_those_of_its_joint(sledge, pendulum, data):
    raw = pendulum.raw
    raw["springs"] = {"s": {"coordinate": "arm.angle", "stiffness": 1.0, "rest_angle": 0.1}}
    expected = {
        "stiffness": ("N/m", "N m/rad"),
        "rest_angle": ("m", "rad"),
        "damping": ("N s/m", "N m s/rad"),
        "clearance": ("m", "rad"),
        "seating": ("N", "N m"),
    }
    for i, action in enumerate((sledge, Action(raw))):
        found = {p.path.rpartition(".")[2]: p.unit for p in all_parameters(action)
                 if p.path.startswith("springs.")}  # fmt: skip
        assert found == {name: units[i] for name, units in expected.items()}
    shown = command("show", data / "mass_spring.toml").output
    assert "0.001 N/m, from 0 m" in shown
    assert "rad" not in shown.partition("springs and straps")[2]


def test_units_of_friction_are_those_of_joint_or_contact(sledge, pendulum):
    for action, path, unit in (
        (sledge, "bodies.sledge.friction.viscous", "N s/m"),
        (sledge, "bodies.sledge.friction.stribeck_speed", "m/s"),
        (pendulum, "bodies.arm.friction.viscous", "N m s/rad"),
        (pendulum, "bodies.arm.friction.amplitude", "N m"),
        (pendulum, "contacts.01.friction.viscous", "s/m"),
        (pendulum, "contacts.01.friction.amplitude", "1"),
    ):
        assert {p.path: p.unit for p in all_parameters(action)}[path] == unit


def test_the_core_names_units_by_joint_too(sledge):
    description = describe(sledge.config, None)
    (spring,) = description.springs
    spring.stiffness = spring.damping = float("inf")
    description.springs = [spring]
    with pytest.raises(InvalidParameter, match=r"stiffness = inf N/m, must be >= 0") as caught:
        _core.assemble(description)
    assert "damping = inf N s/m, must be >= 0" in str(caught.value)


@pytest.mark.parametrize("law", ["guarded", "micromechanical"])
def test_two_lines_are_told_as_such(pendulum, law):
    raw = pendulum.raw
    raw["surfaces"]["head"] = {"body": "arm", "kind": "line", "point": [0, -0.15], "normal": [1, 0]}
    if law == "micromechanical":
        area = {"kind": "circle_on_layer", "width": "9 mm"}
        raw["contacts"]["01"] = {
            "surfaces": ["head", "block"],
            "law": {"name": law, "felt": "synthetic_hammer", "thickness": "6 mm", "area": area},
        }
    with pytest.raises(InvalidParameter) as caught:
        Action(raw)
    assert "a line (head) cannot meet a line (block); one of the pair must be a circle" in str(
        caught.value
    )
    assert "radius" not in str(caught.value)
