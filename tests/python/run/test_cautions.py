"""What a run says of itself although it did not fail."""

from pathlib import Path

import pytest

import feltmb

PENDULUM = Path(__file__).resolve().parents[2] / "data" / "pendulum.toml"
AREA = {"kind": "constant", "size": {"value": 40.0, "unit": "mm^2"}}


def pressed(thickness, force):
    """Warnings of a pendulum pressed into a layer of felt, and its largest compression [m]."""
    law = {"name": "micromechanical", "felt": "synthetic_soft_red", "thickness": thickness}
    action = feltmb.load_action(PENDULUM).with_values(
        {"contacts.01.law": law | {"area": AREA}, "finger.direction": [1.0, 0.0]}
    )
    run = feltmb.simulate(action, feltmb.ramp_stroke(force, 0.001, 0.02, duration=0.03))
    assert run.status == "done"
    return action, run.stats["warnings"], float(run.end_memory.max())


def test_a_felt_pressed_beyond_its_loop_is_told():
    action, warnings, reached = pressed(4e-3, 0.3)
    felt = action.config.contacts["01"].micromechanical.felt
    end = 4e-3 * (1.0 - felt.v_f0 / felt.end)
    assert 0.0 < reached < end
    assert warnings == []
    action, warnings, reached = pressed(1e-3, 60.0)
    end = 1e-3 * (1.0 - felt.v_f0 / felt.end)
    assert reached > end
    assert len(warnings) == 1
    assert (
        f"contact 01: the felt is compressed by {1e3 * reached:.3g} mm of its 1 mm" in warnings[0]
    )
    assert f"{1e3 * end:.3g} mm at v_f_max" in warnings[0]
    _, warnings, reached = pressed(0.2e-3, 4000.0)
    assert reached > 0.2e-3 * (1.0 - felt.v_f0)
    assert "at which it is solid" in warnings[0]


def test_sweeps_keep_the_warnings_of_their_runs(tmp_path):
    action, _, _ = pressed(1e-3, 0.3)
    strokes = [feltmb.ramp_stroke(force, 0.001, 0.02, duration=0.03) for force in (0.01, 60.0)]
    run = feltmb.simulate(action, strokes[1])
    assert len(run.warnings) == 1
    assert repr(run).endswith("done, 1 warning)")
    for _ in range(2):  # computed, then read from the folder
        found = feltmb.sweep(action, strokes, [{}], mode="list", folder=tmp_path / "members")
        assert list(found.table["warnings"]) == ["", run.warnings[0]]
        assert "1 with warnings" in repr(found)


def test_all_faults_of_a_law_come_at_once():
    from feltmb.contact import law

    with pytest.raises(feltmb.InvalidParameter) as error:
        law("felt_memory", loading=(1.0, 2.0), kapa=0.2, rate_time="x")
    assert str(error.value).splitlines() == [
        "law 'felt_memory': parameter 'unloading' is missing",
        "law 'felt_memory': unknown parameter kapa; known are loading, unloading, envelope, "
        "closing_compression, kappa, wiping_out, recovery_time, creep_stiffness, creep_damping, "
        "rate_amplitude, rate_time",
        "law 'felt_memory': loading = (1.0, 2.0), expected (a [N/m], b [1/m], c [N/m]) of eq. 4.21",
        "law 'felt_memory': rate_time: got 'x', expected a finite number with a unit of s",
    ]
    curve = (1e3, 1e3, 0.0)
    with pytest.raises(feltmb.InvalidParameter) as error:
        law("guarded", loading=(1e3, -1.0, 0.0), unloading=curve, alpha=0.0, rate_amplitude=-1.0)
    for name in ("loading curve: b = -1", "alpha [s/m] = 0", "rate_amplitude = -1", "rate_time"):
        assert name in str(error.value)


def test_jammed_parts_are_told_with_the_contact():
    """The jack is pushed past the butt: 570 N at rest, of an action that weighs 1.6 N."""
    action = feltmb.load_action("steinway45")
    jammed = action.with_values(
        {"surfaces.Jp2.point": [-5.3e-3, 69.8e-3], "straps.bridle_strap.free_length": "25.2 mm"}
    )
    run = feltmb.simulate(jammed, "forte", duration=0.01)
    assert run.status == "done"
    (text,) = [w for w in run.warnings if "jammed" in w]
    assert text.startswith("contact 04 jack - hammer butt leather is pressed by 572 N at rest")
    assert "all parts weigh 1.62 N" in text
    assert run["contact04.force"][0] == pytest.approx(572.0, abs=0.5)
    for name in ("steinway45", "steinway45_felt"):
        run = feltmb.simulate(name, "forte", duration=0.01)
        assert not [w for w in run.warnings if "jammed" in w]


@pytest.mark.parametrize(
    ("changes", "force"),
    [
        (
            {
                "surfaces.Jp2.point": {"value": [-5.5983, 70.0120], "unit": "mm"},
                "surfaces.Jp2.radius": "1.5429 mm",
                "surfaces.Hbp4.point": {"value": [10.4192, 10.3199], "unit": "mm"},
                "surfaces.Hbp4.radius": "9.7238 mm",
            },
            69.6,
        ),
        (
            {
                "bodies.whippen.position": {"value": [-179.0152, 51.4782], "unit": "mm"},
                "bodies.jack.position": {"value": [36.2879, 17.2821], "unit": "mm"},
                "surfaces.Gp11.point": {"value": [-115.7908, 109.6296], "unit": "mm"},
                "surfaces.Jp5.point": {"value": [4.5618, 48.7246], "unit": "mm"},
                "straps.bridle_strap.free_length": "34.3197 mm",
            },
            225.2,
        ),
    ],
)  # fmt: skip
def test_drawn_dimensions_that_jam_are_told(changes, force):
    """The dimensions that jam the parts, of two draws of all numbers of the file."""
    run = feltmb.simulate(feltmb.load_action("steinway45").with_values(changes), "forte", 0.001)
    (text,) = [w for w in run.warnings if "jammed" in w]
    assert text.startswith("contact 04 jack - hammer butt leather is pressed by ")
    assert run["contact04.force"][0] == pytest.approx(force, rel=2e-3)


def test_a_spring_that_presses_is_no_jam():
    """A light hammer that a strong spring holds against its pad."""
    action = feltmb.load_action(PENDULUM)
    raw = action.raw
    raw["springs"] = {"s": {"coordinate": "arm.angle", "stiffness": 50.0, "rest_angle": 0.2}}
    pressed = feltmb.mechanism.Action(raw)
    run = feltmb.simulate(pressed, feltmb.ramp_stroke(0.0, duration=0.01))
    assert run["contact01.force"][0] > 20.0
    weight = 9.81 * pressed.value("arm.mass").value
    assert run["contact01.force"][0] > 100.0 * weight
    assert not [w for w in run.warnings if "jammed" in w]
