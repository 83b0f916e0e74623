"""The action with flexible shank and wire against the numbers of the design's trial model."""

import numpy as np
import pytest

import feltmb

# Trial model, flexible members, string as printed: times in s, speeds in m/s, force in N, gap in m.
PIANO = {
    "damper_start_time": (0.2190, 5e-4),
    "jack_toe_time": (0.2323, 5e-4),
    "let_off_time": (0.2370, 5e-4),
    "impact_time": (0.2389, 5e-4),
    "key_landing_time": (0.2401, 5e-4),
    "let_off_gap": (1.9e-3, 2e-4),
    "impact_speed": (1.062, 0.02),
    "rebound_speed": (0.75, 0.02),
    "max_impact_force": (7.6, 0.15),
    "impact_duration": (4.0e-3, 3e-4),
    "check_gap": (15.6e-3, 0.5e-3),
}
FORTE = {
    "damper_start_time": (0.0855, 5e-4),
    "jack_toe_time": (0.0899, 5e-4),
    "impact_time": (0.0925, 5e-4),
    "key_landing_time": (0.0908, 5e-4),
    "impact_speed": (3.359, 0.06),
    "rebound_speed": (2.34, 0.05),
    "max_impact_force": (25.1, 0.3),
    "impact_duration": (3.4e-3, 3e-4),
    "check_gap": (21e-3, 0.5e-3),
}


@pytest.mark.parametrize(("stroke", "expected"), [("piano", PIANO), ("forte", FORTE)])
def test_numbers_of_the_trial_model(run_of, stroke, expected):
    one = {"string.count": 1}  # the trial has the one string that is printed
    found = run_of(stroke, values=one, rtol=1e-8, flexible=True).summary
    for name, (value, room) in expected.items():
        assert found[name] == pytest.approx(value, abs=room), name


def test_strap_pulls_as_in_the_trial_model(run_of):
    """Press and release: 1.4 N. Staccato, 0.5 to 0.9 N there, gives a first pull of 1.9 N here."""
    one = {"string.count": 1}
    release = run_of("press_release", values=one, rtol=1e-8, flexible=True)["bridle_strap.force"]
    assert 0.5 < np.max(release) < 1.6
    staccato = run_of("staccato", values=one, rtol=1e-8, flexible=True)["bridle_strap.force"]
    assert 0.5 < np.max(staccato) < 2.5


def test_axial_condensation_changes_nothing_that_matters(run_of):
    """Axial modes of 6 and 8 kHz in full, and found from their own equation without inertia."""
    whole = {"shank.condense_axial": False, "wire.condense_axial": False}
    condensed = run_of("forte", rtol=1e-8, flexible=True).summary
    full = run_of("forte", values=whole, rtol=1e-8, flexible=True).summary
    for name, room in (
        ("impact_time", 1e-5),
        ("impact_speed", 2e-3),
        ("rebound_speed", 2e-3),
        ("max_impact_force", 2e-3),
        ("check_gap", 5e-3),
    ):
        assert condensed[name] == pytest.approx(full[name], rel=room), name


@pytest.mark.parametrize("body", ["shank", "wire"])
def test_stiff_members_are_rigid_ones(action, body):
    """Bending stiffness times 1000: the strokes of the rigid member."""
    other = "wire" if body == "shank" else "shank"
    one = action.with_values({f"{other}.rigid": True})
    stiff = one.with_values(
        {
            f"{body}.young_modulus": 1000.0 * one.config.bodies[body].young_modulus,
            f"{body}.damping_time": 1e-6,
        }
    )
    rigid = one.with_values({f"{body}.rigid": True})
    a = feltmb.simulate(stiff, "forte", duration=0.1, rtol=1e-7)
    b = feltmb.simulate(rigid, "forte", duration=0.1, rtol=1e-7)
    assert a.summary["impact_speed"] == pytest.approx(b.summary["impact_speed"], rel=1e-3)
    assert a.summary["impact_time"] == pytest.approx(b.summary["impact_time"], abs=1e-5)
    assert a.summary["max_impact_force"] == pytest.approx(b.summary["max_impact_force"], rel=1e-2)


def test_mass_of_the_whole_is_the_same_with_flexible_members(action):
    """Generalized masses of the rigid coordinates at zero deflection."""
    rigid = action.with_values({"shank.rigid": True, "wire.rigid": True})
    q = rigid.rest_pose
    small = feltmb.evaluate(rigid, q, np.zeros(6)).mass_matrix
    large = feltmb.evaluate(action, np.append(q, np.zeros(6)), np.zeros(12)).mass_matrix
    assert large[:6, :6] == pytest.approx(small, rel=1e-9, abs=1e-18)


def test_gravity_of_the_whole_is_the_same_with_flexible_members(action):
    rigid = action.with_values({"shank.rigid": True, "wire.rigid": True})
    rng = np.random.default_rng(5)
    q = rigid.rest_pose
    v = rng.normal(size=6)
    small = feltmb.evaluate(rigid, q, v).force
    large = feltmb.evaluate(action, np.append(q, np.zeros(6)), np.append(v, np.zeros(6))).force
    assert large[:6] == pytest.approx(small, rel=1e-8, abs=1e-12)
