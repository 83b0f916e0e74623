"""Rest poses: static deflection of a string, and poses that are refused."""

import numpy as np
import pytest

import feltmb

STILL = feltmb.ramp_stroke(0.0, duration=0.02)


def resting_on_the_string(data, **values):
    """The hammer of the tests, pulled onto its string by a weight."""
    return feltmb.load_action(data / "hammer_string.toml").with_values(
        {"gravity": [9.81, 0.0], "contacts.01.law": "guarded", **values}
    )


@pytest.mark.parametrize("start", [-0.01, 0.002, 0.02])
def test_a_string_under_a_weight_takes_its_static_deflection(data, start):
    """Wherever the search starts, also deep behind the string."""
    action = resting_on_the_string(data, **{"start_pose": {"hammer.x": start}})
    run = feltmb.simulate(action, STILL, 0.001)
    weight = 9e-3 * 9.81
    assert run["contact01.force"][0] == pytest.approx(weight, rel=1e-6)
    string = run._string()
    shape = np.sqrt(2.0 / (5.98e-3 * 0.6315)) * np.sin(
        np.pi * np.arange(1, 41) * 0.0789375 / 0.6315
    )
    deflection = weight * np.sum(shape**2 / string.angular_frequency**2)
    assert run["string.strike"][0] == pytest.approx(deflection, rel=1e-6)
    assert np.ptp(run["hammer.x"]) < 1e-9


@pytest.mark.parametrize(
    ("radius", "what"),
    [(0.573, r"J in contacts.*strap bridle_strap"), (0.43, r"J in contacts.*contact05")],
)
def test_a_rest_pose_with_energy_from_nowhere_is_refused(action, radius, what):
    """The rail of the key is lifted by decimeters: bodies are pushed past each other and jam."""
    moved = action.with_values({"surfaces.Gp2.radius": radius})
    with pytest.raises(feltmb.ModelError, match=what) as caught:
        moved.rest_pose  # noqa: B018
    assert caught.value.code == "no_equilibrium"
    for word in ("rest pose makes no sense", "expected at most", "start_pose"):
        assert word in str(caught.value)


def test_a_member_bent_beyond_its_length_is_no_rest_pose(action):
    soft = action.with_values({"wire.young_modulus": 1e4})
    with pytest.raises(feltmb.ModelError, match=r'member "wire" of .* is deflected by'):
        soft.rest_pose  # noqa: B018


def test_members_beyond_small_deflections_are_told(action):
    """A force of the finger that no finger has bends the wire by centimeters."""
    soft = action.with_values({"wire.young_modulus": 2e7})
    run = feltmb.simulate(soft, "forte", 0.1)
    found = [
        w for w in run.stats["warnings"] if w.startswith("member wire of 66.1 mm is deflected")
    ]
    assert len(found) == 1
    assert not any("member" in w for w in feltmb.simulate(action, "forte", 0.1).stats["warnings"])
