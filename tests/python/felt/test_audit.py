"""Audit: the known faults of the printed curves, sound laws, losses of cycles."""

import numpy as np
import pytest

from feltmb import load_action
from feltmb.contact import law
from feltmb.felt import ConstantArea, audit, audit_targets, envelope, load_material
from feltmb.fiber.material import packaged_materials
from unmodeled.errors import InvalidParameter


@pytest.fixture(scope="module")
def printed():
    targets = audit_targets("steinway45", ["contacts.*.law=printed"], everything=True)
    return {name.partition(":")[2]: audit(c, name=name) for name, c in targets}


def kinds(result):
    return {f.kind for f in result.findings}


def find(result, kind):
    return [f for f in result.findings if f.kind == kind]


def test_printed_curves_fail_where_they_are_known_to(printed):
    assert len(printed) == 16
    assert {k for k, r in printed.items() if find(r, "crossing")} == {
        "04", "05", "06", "08", "13", "14",
    }  # fmt: skip
    assert {k for k, r in printed.items() if find(r, "adhesion")} == {"06", "09"}
    assert {k for k, r in printed.items() if find(r, "open")} == {"02"}
    assert {k for k, r in printed.items() if not r.law_is_sound} == {
        "04", "05", "06", "08", "09", "13", "14",
    }  # fmt: skip
    for number in ("13", "14"):
        (crossing,) = find(printed[number], "crossing")
        assert crossing.high == pytest.approx(0.196e-3, abs=1e-6)
        assert crossing.value == pytest.approx(6.83e-6, rel=1e-2)
    (hammer,) = find(printed["06"], "adhesion")
    assert hammer.high == pytest.approx(14.5e-6, rel=1e-3)
    assert hammer.value == pytest.approx(-2.187e-3, rel=1e-3)
    (rest,) = find(printed["09"], "adhesion")
    assert rest.value == pytest.approx(-36.9e-3, rel=2e-3)
    assert printed["06"].window[0] == pytest.approx(54.5e-6, rel=1e-2)


def test_every_printed_law_makes_energy_beyond_its_loop(printed):
    for number, r in printed.items():
        beyond = [f for f in find(r, "energy") if r.closing and f.low >= r.closing * (1 - 1e-9)]
        assert bool(beyond) == (number != "02")


def test_loss_of_a_full_cycle_of_contact_1(printed):
    # Eq. 4.22 with alpha = 100 s/m loses what the frequency says, not what the felt does.
    r = printed["01"]
    full = {c.frequency: c.loss for c in r.cycles if c.amplitude == r.closing}
    for frequency, loss in ((0.03, 0.0025), (1.0, 0.0814), (30.0, 0.3369)):
        assert full[frequency] == pytest.approx(loss, abs=6e-5)


def test_guarded_and_memory_laws_are_sound_on_the_same_data():
    for name in ("guarded", "felt_memory"):
        for number in ("01", "06", "09", "13"):
            action = load_action("steinway45").with_values({f"contacts.{number}.law": name})
            r = audit(action.config.contacts[number], name=number)
            assert r.law_is_sound, (name, number, [f.text for f in r.findings])
            assert r.law == name
            assert r.data_are_sound == (number == "01")


def test_memory_law_loses_the_same_at_every_frequency_and_its_loop_at_first():
    made = envelope(load_material("synthetic_soft_red"), 6e-3, ConstantArea(1e-4))
    r = audit(made)
    for amplitude in {c.amplitude for c in r.cycles}:
        row = [c for c in r.cycles if c.amplitude == amplitude]
        np.testing.assert_allclose([c.lost for c in row], row[0].lost, rtol=1e-9)
        area = float(made.core.loop_area(amplitude))
        assert row[0].first_lost == pytest.approx(area, rel=1e-3)
        assert 0 < row[0].lost < row[0].first_lost
    assert r.cycles[-1].first_loss == pytest.approx(made.loss, rel=2e-3)
    assert r.law_is_sound
    assert r.data_are_sound
    assert r.window == (0.0, made.closing)


def test_stulov_loses_most_near_its_relaxation_rate():
    stulov = law("stulov", stiffness=1e8, exponent=2.5, amplitude=0.3, time=1e-3)
    r = audit(
        stulov, largest=1e-3, frequencies=(0.1, 1.0, 10.0, 100.0, 1e3, 1e4), amplitudes=(1.0,)
    )
    lost = [c.lost for c in r.cycles]
    assert min(lost) > 0
    assert np.argmax(lost) == 3
    # Against the closed form of slow cycles: lost = amplitude tau0 * integral of F0 d(e^p)/dt de.
    omega, p, a = 2 * np.pi * 0.1, 2.5, 1e-3
    t = np.linspace(0, 2 * np.pi, 200001)
    e, rate = a / 2 * (1 - np.cos(t)), a / 2 * omega * np.sin(t)
    slow = 0.3 * 1e-3 * 1e8 * np.mean(p * e ** (p - 1) * rate**2) * 2 * np.pi / omega
    assert lost[0] == pytest.approx(slow, rel=5e-3)
    assert "crossing" not in kinds(r)


def test_conservative_law_loses_nothing():
    r = audit(law("hunt_crossley", stiffness=1e8, exponent=2.5))
    assert max(abs(c.loss) for c in r.cycles) < 1e-9
    assert r.findings == ()
    i = 200
    e = r.compression[i]
    assert r.loading_stiffness[i] == pytest.approx(2.5e8 * e**1.5, rel=1e-3)


def test_felt_itself():
    r = audit(load_material("synthetic_hammer"), name="hammer")
    assert r.law_is_sound
    assert "SYNTHETIC" in r.about
    slick = load_material("synthetic_soft_red")
    slick = slick.model_copy(update={"fiber": slick.fiber.model_copy(update={"friction": 0.15})})
    assert "material" in kinds(audit(slick))


def test_targets(tmp_path):
    made = envelope(load_material("synthetic_hammer"), 6e-3, ConstantArea(1e-4))
    path = tmp_path / "one.toml"
    path.write_text(made.to_toml(), encoding="utf-8")
    assert audit_targets(str(path))[0][0] == "one"
    assert audit_targets("steinway45:04")[0][0] == "steinway45:04"
    assert audit_targets("synthetic_leather")[0][0] == "synthetic_leather"
    for text, part in (("steinway45:99", "expected one of 01"), ("nothing", "no mechanism")):
        with pytest.raises(InvalidParameter, match=part):
            audit_targets(text)
    with pytest.raises(InvalidParameter, match=r"--all"):
        audit_targets("steinway45")
    measured = tmp_path / "test.csv"
    measured.write_text("displacement [mm],force [N]\n")
    with pytest.raises(InvalidParameter, match="felt contact and identify read a measured loop"):
        audit_targets(str(measured))


def test_faults_and_plain_data():
    made = envelope(load_material("synthetic_hammer"), 6e-3, ConstantArea(1e-4))
    with pytest.raises(InvalidParameter, match=r"(?s)amplitude = -1.*frequency = 0"):
        audit(made, amplitudes=(-1.0,), frequencies=(0.0,))
    out = audit(made, amplitudes=(1.0,), frequencies=(1.0,)).to_dict()
    assert out["law"] == "felt_memory"
    low, high = out["stiffness"]["loading"]
    assert 0 <= low < high
    assert high == pytest.approx(
        (made.loading[-1] - made.loading[-2]) / (made.compression[-1] - made.compression[-2]),
        rel=0.02,
    )
    assert out["cycles"][0]["loss"] > 0


def test_settings_of_an_audit_are_told_or_refused():
    told = []
    ((_, plain),) = audit_targets("steinway45:06")
    ((_, changed),) = audit_targets("steinway45:06", ["contacts.06.alpha=20"], notify=told.append)
    assert changed.alpha != plain.alpha
    assert "contacts.06.alpha = 20 s/m" in told[0]
    assert f"was {plain.alpha:g} s/m" in told[0]
    with pytest.raises(InvalidParameter, match="is a felt, and settings change a mechanism"):
        audit_targets(packaged_materials()[0], ["contacts.06.alpha=20"])
    for idle in ("string.modes=3", "contacts.04.alpha=20", "contacts.06.friction.amplitude=0.1"):
        with pytest.raises(InvalidParameter, match=rf"^--set {idle.split('=')[0]}: has no effect"):
            audit_targets("steinway45:06", ["contacts.06.alpha=20", idle])
