"""Envelopes: areas against brute force, bounds, use in a mechanism."""

import numpy as np
import pytest

from feltmb import load_action
from feltmb.felt import (
    CircleOnLayer,
    ConstantArea,
    CrossedCylinders,
    SphereOnLayer,
    envelope,
    load_envelope,
    load_material,
    packaged_materials,
    parse_area,
)
from unmodeled.errors import InvalidParameter

SYNTHETIC = [name for name in packaged_materials() if name.startswith("synthetic")]
AREAS = (
    ConstantArea(1e-4),
    CrossedCylinders(9e-3, 0.55e-3),
    CircleOnLayer(5e-3, 10e-3),
    SphereOnLayer(5e-3),
)


def test_crossed_cylinders_against_brute_force():
    law = CrossedCylinders(9e-3, 0.55e-3)
    for e in (1e-5, 3e-4, 0.55e-3, 2e-3):
        edge = law.radius_b
        y = (np.arange(200000) + 0.5) / 200000 * 2 * edge - edge
        gap = np.clip(e - (edge - np.sqrt(edge**2 - y**2)), 0, None)
        area = np.mean(2 * np.sqrt(gap * (2 * law.radius_a - gap))) * 2 * edge
        assert law.area(e) == pytest.approx(area, rel=2e-6)
    small = 1e-8
    assert law.area(small) == pytest.approx(2 * np.pi * small * np.sqrt(9e-3 * 0.55e-3), rel=1e-4)
    assert CrossedCylinders(0.55e-3, 9e-3).area(3e-4) == pytest.approx(float(law.area(3e-4)))


def test_areas_are_zero_out_of_contact_and_grow():
    for law in AREAS:
        assert np.all(law.area([-1e-3, 0.0]) == 0.0)
        assert np.all(np.diff(law.area(np.linspace(1e-6, 4e-3, 50))) >= 0)
    circle = CircleOnLayer(5e-3, 10e-3)
    assert circle.area(5e-3) == pytest.approx(2 * 5e-3 * 10e-3)
    assert circle.area(9e-3) == pytest.approx(2 * 5e-3 * 10e-3)


@pytest.mark.parametrize("area", AREAS, ids=str)
@pytest.mark.parametrize("name", SYNTHETIC)
def test_table_is_a_loop(name, area):
    m = load_material(name)
    made = envelope(m, 6e-3, area)
    assert np.all(made.unloading >= 0)
    assert np.all(made.unloading <= made.loading)
    assert made.unloading[-1] == made.loading[-1]
    assert np.all(np.diff(made.loading) >= 0)
    assert 0.2 < made.loss < 0.5
    # The force is pressure times area at the volume fraction of the compression.
    i = 120
    v = m.v_f0 / (1 - made.compression[i] / 6e-3)
    p = m.pressure("loading", [v])[0]
    assert made.loading[i] == pytest.approx(p * float(area.area(made.compression[i])), rel=1e-6)
    # The table that the integrator uses is as fine as the felt itself.
    e = np.linspace(0.02, 0.98, 97) * made.closing
    exact = m.pressure("loading", m.v_f0 / (1 - e / 6e-3)) * area.area(e)
    np.testing.assert_allclose(made.core.loading(e), exact, atol=2e-4 * made.loading[-1])


def test_same_arguments_same_tables():
    m = load_material("synthetic_hammer")
    a = envelope(m, 6e-3, ConstantArea(1e-4))
    assert envelope(load_material("synthetic_hammer"), 6e-3, ConstantArea(1e-4)).core is a.core
    assert envelope(m, 6.1e-3, ConstantArea(1e-4)).core is not a.core
    with pytest.raises(ValueError, match="read-only"):
        a.loading[0] = 1.0


def test_law_with_memory_on_it_loads_along_the_table():
    made = envelope(load_material("synthetic_soft_red"), 5e-3, ConstantArea(1e-4))
    law = made.law(kappa=0.1)
    e = 0.4 * made.closing
    force = law.force(e, 1e-3, [0.0], 0.0)
    assert force == pytest.approx(float(made.core.loading(e)), rel=1e-12)
    back = law.force(e, -1e-3, [0.0], made.closing)
    assert back == pytest.approx(float(made.core.unloading(e, made.closing)), rel=1e-12)
    assert back < force


def test_in_a_mechanism_file(tmp_path):
    made = envelope(load_material("synthetic_hammer"), 6e-3, AREAS[1])
    path = tmp_path / "felt_hammer.toml"
    path.write_text(made.to_toml("steinway45", "06"), encoding="utf-8")
    contact = load_action(path).config.contacts["06"]
    assert contact.law == "felt_memory"
    assert contact.memory.envelope is not None
    np.testing.assert_allclose(
        np.array(contact.memory.envelope.compression) * 1e-3, made.compression, atol=1e-12
    )
    single = tmp_path / "envelope.toml"
    single.write_text(made.to_toml(), encoding="utf-8")
    again = load_envelope(single)
    np.testing.assert_allclose(again.unloading, made.unloading, rtol=1e-8)
    value = load_action("steinway45").with_values(
        {"contacts.06.law": "felt_memory", "contacts.06.memory": {"envelope": made.table()}}
    )
    assert value.config.contacts["06"].memory.envelope == contact.memory.envelope


def test_faults():
    m = load_material("synthetic_hammer")
    with pytest.raises(InvalidParameter, match=r"(?s)thickness = -1 m.*points = 2"):
        envelope(m, -1.0, AREAS[0], points=2)
    with pytest.raises(InvalidParameter, match=r"largest = 0.005 m, must be > 0 and <= 0.00211"):
        envelope(m, 6e-3, AREAS[0], largest=5e-3)
    with pytest.raises(InvalidParameter, match=r"(?s)radius_a = -1.*radius_b = 0"):
        CrossedCylinders(-1, 0)
    bare = m.model_copy(update={"unloading": None})
    with pytest.raises(InvalidParameter, match="unloading is missing"):
        envelope(bare, 6e-3, AREAS[0])


def test_area_from_text():
    assert parse_area("constant: 100 mm^2").size == pytest.approx(1e-4)
    assert parse_area("crossed_cylinders:9mm,0.55mm").radius_b == pytest.approx(0.55e-3)
    for text, part in (
        ("disk:1mm", "expected constant:SIZE"),
        ("constant:1mm^2,2mm^2", "2 numbers, expected 1"),
        ("circle_on_layer:5kg,10mm", "radius"),
    ):
        with pytest.raises(InvalidParameter, match=part):
            parse_area(text)
