"""The exact Jacobian, as the structured solver applies it, against differences of the equations.

``jacobian_check`` gives the inverse of I - gamma J, string modes eliminated; J follows from it. The
differences are of fourth order, the best of four steps. Entries are weighted by the size of their
state (1 mm of felt, 1 m/s), rows by their largest weighted entry. What remains, 1e-9 typically and
3e-8 at most, is the rounding of the differences: forces of 1e4 N/kg at eps over steps of 1e-7.
"""

import numpy as np
import pytest

import feltmb
from feltmb import _core

ROOM = 2e-7
STEPS = (1e-4, 1e-5, 1e-6, 1e-7)
STILL = 1e-5  # m/s: at smaller compression rates the law's kink at zero lies within the steps


def scales(action):
    """Size of each state; threshold speeds of the friction are far below 1 m/s."""
    mechanism = action.mechanism
    q = np.array(mechanism.coordinate_scale)
    modes = mechanism.total_modes
    laws = np.ones(mechanism.total_law_states)
    string = action.config.string
    shape = np.sqrt(2.0 / (string.linear_density * string.length)) if string else 1.0
    return np.concatenate(
        [q, 10.0 * q, laws, np.full(modes, 1e-3 / shape), np.full(modes, 1.0 / shape)]
    )


def sampled_states(action, stroke, rate, duration=None):
    options = _core.SimulationOptions()
    options.duration = duration or stroke.duration
    options.rtol = 1e-7
    options.output_rate = rate
    options.ledger = options.events = False
    options.finger_reference = 0.0  # as in rhs and jacobian_check: motion counts from y = 0
    n, modes = len(action.coordinates), action.mechanism.total_modes
    rest = action.equilibrium
    start = np.concatenate([rest["q"], np.zeros(n), rest["law"], rest["eta"], np.zeros(modes)])
    return _core.simulate(
        action.mechanism,
        stroke.input,
        start=list(start),
        monitors=[],
        options=options,
    )


def exact(action, stroke, t, y, gamma=1e-4):
    inverse = _core.jacobian_check(action.mechanism, list(y), stroke.input, time=t, gamma=gamma)
    return (np.eye(len(y)) - np.linalg.inv(inverse)) / gamma


def differences(action, stroke, t, y, scale):
    def rate(z):
        return _core.rhs(action.mechanism, list(z), stroke.input, time=t)

    for step in STEPS:
        jacobian = np.empty((len(y), len(y)))
        for j, size in enumerate(scale):
            e = np.zeros(len(y))
            e[j] = h = step * size
            jacobian[:, j] = (
                8.0 * (rate(y + e) - rate(y - e)) - (rate(y + 2 * e) - rate(y - 2 * e))
            ) / (12.0 * h)
        yield jacobian


def worst_error(action, stroke, t, y):
    scale = scales(action)
    jacobian = exact(action, stroke, t, y)
    difference = np.min(
        [np.abs(jacobian - d) for d in differences(action, stroke, t, y, scale)], axis=0
    )
    rows = np.max(np.abs(jacobian) * scale, axis=1, keepdims=True)
    rows[rows < 1e-4] = 1.0  # rows of coordinates that are held: rounding only
    return float(np.max(difference * scale / rows))


def check_along(action, stroke, *, rate=20000.0, count=25, duration=None, every=6):
    """Compare at states spread over the run and, denser, while the string is touched."""
    run = sampled_states(action, stroke, rate, duration)
    column = {name: i for i, name in enumerate(run.names)}
    names = [n for n in action.mechanism.contact_names if n != "finger"]
    force = np.stack([run.data[:, column[f"{n}.force"]] for n in names])
    speed = np.stack([run.data[:, column[f"{n}.rate"]] for n in names])
    depth = np.stack([run.data[:, column[f"{n}.compression"]] for n in names])
    # Away from the kinks of the laws: opening, and the change from loading to unloading.
    clear = np.all((np.abs(depth) > 1e-6) & ((depth < 0) | (np.abs(speed) > STILL)), axis=0)
    touched = force[names.index("contact06")] > 0 if "contact06" in names else force[0] > 0
    picked = np.union1d(
        np.nonzero(clear)[0][:: max(1, int(clear.sum() / count))],
        np.nonzero(clear & touched)[0][::every],
    )
    assert len(picked) > 10
    errors = [worst_error(action, stroke, run.time[i], run.states[i]) for i in picked]
    assert max(errors) < ROOM
    closed = {names[c] for i in picked for c in np.nonzero(force[:, i] > 0)[0]}
    strap = "bridle_strap.force" in column and np.any(
        run.data[picked, column["bridle_strap.force"]] > 0
    )
    return closed, bool(strap)


@pytest.mark.parametrize(
    "law", ["guarded", *(pytest.param(n, marks=pytest.mark.slow) for n in ("printed", "mean"))]
)
def test_along_strokes_with_every_contact(rigid, law):
    """Moving strike point, friction, strap: all fifteen contacts are closed at some state."""
    other = rigid.with_values({"string.modes": 5, "contacts.*.law": law})
    closed, strap = set(), False
    for name, duration in (("forte", 0.25), ("staccato", 0.25), ("press_release", 0.7)):
        stroke = feltmb.load_stroke(name)
        more, taut = check_along(other, stroke, rate=10000.0, count=40, duration=duration, every=3)
        closed, strap = closed | more, strap or taut
    assert strap
    assert {f"contact{n:02d}" for n in (2, 3, 4, 5, 6, 8, 9, 12, 15)} <= closed
    missing = {f"contact{n:02d}" for n in range(1, 16)} - closed
    assert missing <= {"contact13", "contact14", "contact07", "contact11", "contact01", "contact10"}


@pytest.mark.parametrize(
    "values",
    [
        {"string.strike_point": 0.0694},
        # Hammer and damper on the string together: the spoon is off.
        {"string.other_surfaces": ["Gp9"], "contacts.09.enabled": False},
        {"string.kind": "rigid_stop"},
        {"string.modes": 40},
        {"contacts.16.enabled": True},
        {"bodies.key.position": [0.5e-3, -0.2e-3]},
    ],
    ids=lambda v: next(iter(v)),
)
def test_along_a_forte_stroke(rigid, values):
    base = {"string.modes": 5}
    check_along(rigid.with_values(base | values), feltmb.load_stroke("forte"), count=8, every=12)


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"shank.damping_time": 1e-5, "wire.damping_time": 1e-5},
        {"shank.condense_axial": False, "wire.condense_axial": False},
        {"wire.rigid": True},
    ],
    ids=lambda v: next(iter(v), "as it is"),
)
def test_with_flexible_members(action, values):
    flexible = action.with_values({"string.modes": 4} | values)
    check_along(flexible, feltmb.load_stroke("forte"), count=10, every=10)


def test_with_a_prescribed_finger_motion(rigid):
    """The finger pad: its rate depends on time, its force on the key's motion."""
    point = rigid.mechanism.point_names.index("key_front")  # where the finger presses
    origin = -_core.point_position(rigid.mechanism, point, rigid.rest_pose)[1]
    stroke = feltmb.motion_stroke([0.0, 0.1, 0.2], [origin, origin + 0.01, origin + 0.01])
    check_along(rigid.with_values({"string.modes": 4}), stroke, count=12, duration=0.15)


@pytest.mark.parametrize("members", ["rigid", "flexible"])
def test_with_a_prescribed_key(action, rigid, members):
    """The reaction is one more unknown; the motion of the point couples turning and lift."""
    other = (rigid if members == "rigid" else action).with_values({"string.modes": 4})
    place = _core.finger_place(other.mechanism, other.rest_pose)  # rhs counts from zero
    t = np.linspace(0.0, 0.12, 25)
    way = place + 0.0102 * np.sin(0.5 * np.pi * np.clip(t / 0.1, 0, 1)) ** 2
    stroke = feltmb.motion_stroke(t, way, of="key")
    check_along(other, stroke, count=10, every=10)


def test_with_a_motor(rigid):
    """Torque on a coordinate, and the coordinate itself by prescription."""
    other = rigid.with_values({"string.modes": 4, "motor": {"coordinate": "key.angle"}})
    angle = other.rest_pose[other.coordinates.index("key.angle")]
    t = np.linspace(0.0, 0.12, 25)
    way = angle - 0.045 * np.sin(0.5 * np.pi * np.clip(t / 0.1, 0, 1)) ** 2
    check_along(other, feltmb.motion_stroke(t, way, of="motor"), count=8, every=12)
    check_along(
        other, feltmb.torque_stroke([0.0, 0.08, 0.12], [0.0, -5.0, -5.0]), count=8, every=12
    )


def test_gamma_does_not_matter(rigid):
    """The same J from small and large gamma: the elimination is right, not only its limit."""
    small = rigid.with_values({"string.modes": 3})
    stroke = feltmb.load_stroke("forte")
    run = sampled_states(small, stroke, 20000.0, 0.11)
    y, t = run.states[1880], run.time[1880]
    assert run.data[1880, run.names.index("contact06.force")] > 1.0
    scale = scales(small)
    reference = exact(small, stroke, t, y, 1e-4)
    rows = np.max(np.abs(reference) * scale, axis=1, keepdims=True)
    for gamma in (1e-6, 1e-5, 1e-3):
        other = exact(small, stroke, t, y, gamma)
        assert np.max(np.abs(other - reference) * scale / rows) < 1e-6
