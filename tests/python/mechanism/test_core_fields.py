"""Structs of the core from their fields: names, kinds and defaults stand in the core alone."""

import pytest

from feltmb import InvalidParameter, _core
from feltmb.mechanism import schema

TABLES = {
    "FrictionParameters": _core.Friction,
    "Spring": _core.TorsionSpringDescription,
    "Dashpot": _core.DashpotDescription,
    "String": _core.StringParameters,
}


@pytest.mark.parametrize("table", TABLES)
def test_a_schema_has_the_numbers_of_its_struct(table):
    fields = getattr(schema, table).model_fields
    for number in TABLES[table].number_fields():
        field = fields[number["name"]]
        assert field.description == number["meaning"]
        assert field.is_required() or field.default == number["default"]


def test_a_struct_keeps_the_defaults_of_what_is_not_given():
    given = _core.Friction(amplitude=0.3)
    assert (given.amplitude, given.threshold_speed) == (0.3, 1e-3)
    body = _core.BodyDescription(name="lever", joint="prismatic", position=(1.0, 2.0))
    assert body.joint == _core.JointKind.prismatic
    assert (body.position, body.axis, body.parent) == ((1.0, 2.0), (0.0, 1.0), "ground")


@pytest.mark.parametrize(
    ("struct", "field", "value", "said"),
    [
        ("Friction", "amplitud", 1.0, r"Friction: unknown field amplitud; known are amplitude, b1"),
        ("Friction", "amplitude", "much", r"Friction: amplitude = 'much', expected a value such"),
        ("BodyDescription", "joint", "weldd", r"BodyDescription: joint = 'weldd'"),
        ("SurfaceDescription", "point", 1.0, r"SurfaceDescription: point = 1.0"),
    ],
)
def test_a_field_that_is_none_or_of_another_kind_is_refused(struct, field, value, said):
    with pytest.raises(InvalidParameter, match=said):
        getattr(_core, struct)(**{field: value})


def test_dry_friction_is_what_holds_at_speeds_near_zero():
    given = _core.Friction(amplitude=0.3, viscous=2.0, stribeck=0.1, stribeck_speed=0.05)
    dry = given.dry()
    assert (dry.amplitude, dry.stribeck, dry.viscous) == (0.3, 0.1, 0.0)
    assert given.sharpened(1e-9).coefficient(1e-6) == pytest.approx(0.4 + 2e-6, rel=1e-3)
    assert given.acts
    assert given.turns_over
    assert not _core.Friction(viscous=1.0).turns_over
