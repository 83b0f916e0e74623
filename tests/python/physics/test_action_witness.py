"""Checks of the witness itself, and of `feltmb` against the witness.

The comparison uses a set of states around one stroke: at rest, pushing, at let-off, at impact,
in check, with the jack tripped or beside the butt, and with the bridle strap taut.
"""

import functools

import action_witness as aw
import numpy as np
import pytest
from scipy.optimize import brentq

import feltmb

# Poses of a stroke of the rigid action (held ramp of 5 N), rounded; starting points only.
POSES = {
    "rest": aw.REST_POSE,
    "push": [-0.000223, 0.002275, 0.056186, 0.10819, -0.178198, -0.045825],
    "let-off": [-0.000233, -0.002355, 0.073241, 0.087841, -0.133751, -0.056199],
    "forced": [-0.000417, -0.010636, 0.091253, 0.060895, -0.093578, -0.065271],
    "impact": [-0.000232, -0.006149, 0.08815, 0.040141, -0.097669, -0.064772],
    "tripped": [-0.000253, -0.01229, 0.105972, -0.126464, -0.147276, -0.086047],
    # The side line of the jack top can only be met with the hammer behind its rest rail and deep
    # in the backcheck, so this pose is not one of a stroke; its jack coordinate still tests the
    # line, since none of the overloaded contacts acts on the jack.
    "beside": [-0.0002, -0.0122, 0.15, -0.18, -0.6, -0.10],
    "check": [-0.000214, -0.008241, 0.097045, -0.020737, -0.198185, -0.070616],
}

# Contacts to be closed at once, as (pose, contacts).
GROUPS = (
    ("rest", (1, 15, 3, 7, 11, 10)),
    ("rest", (1, 15, 3, 7, 10)),
    ("push", (15, 3, 4, 11, 9)),
    ("push", (15, 3, 4, 9, 10)),
    ("let-off", (15, 3, 4, 5, 9)),
    ("forced", (15, 2, 4, 6, 9)),
    ("impact", (15, 2, 3, 5, 6, 9)),
    ("tripped", (15, 2, 3, 12, 8, 9)),
    ("tripped", (15, 2, 13, 12, 8, 9)),
    ("check", (15, 2, 8, 13, 9)),
    ("check", (15, 2, 3, 14, 9)),
    ("beside", (15, 2, 4, 9)),
)
REPEATS = 8
DEEPEST = 1.5e-3
DEEPEST_CONTACT_4 = 0.25e-3
RATE_SPREAD = np.array([0.05, 1.0, 2.0, 6.0, 6.0, 2.0])


def random_rates(rng):
    """Random rates, from creeping to those of a forte stroke; now and then exactly zero."""
    if rng.random() < 0.05:
        return np.zeros(6)
    return RATE_SPREAD * rng.normal(size=6) * 10.0 ** rng.uniform(-4.0, 0.0, size=6)


def taut_strap_pose(rng):
    """Rest pose with the hammer lifted until the strap is 0.2 to 1.5 mm longer than slack."""
    wanted = rng.uniform(0.2e-3, 1.5e-3)

    def elongation(angle):
        q = np.array(aw.REST_POSE)
        q[4] = angle
        ends = []
        for body, point in (aw.STRAP_WHIPPEN, aw.STRAP_BUTT):
            origin, direction = aw.chained_pose(body, q)
            ends.append(origin + direction * complex(*point) * aw.MM)
        return abs(ends[0] - ends[1]) - aw.STRAP_LENGTH - wanted

    angles = np.linspace(-0.47, 0.4, 200)
    values = [elongation(a) for a in angles]
    start = next(i for i in range(199) if values[i] < 0.0 <= values[i + 1])
    q = np.array(aw.REST_POSE)
    q[4] = brentq(elongation, angles[start], angles[start + 1])
    return q


@functools.cache
def states():
    """List of (q, qd, finger force); see the coverage tests for what it contains."""
    rng = np.random.default_rng(20240611)
    result = []
    for name, contacts in GROUPS:
        kept = 0
        for _ in range(40 * REPEATS):
            guess = np.array(POSES[name], dtype=float)
            guess = guess + rng.normal(size=6) * np.array([2e-5, 4e-4, 1e-3, 6e-3, 2e-3, 1e-3])
            targets = {
                n: rng.uniform(1e-5, 1.6e-4 if n == 4 else 5e-4)
                * (1.0 if rng.random() < 0.9 else -1)
                for n in contacts
            }
            q = aw.pose_with(targets, guess)
            found = aw.compressions(q)
            reached = max(abs(found[n] - targets[n]) for n in contacts) < 1e-10
            spared = (7, 8, 13, 14) if name == "beside" else ()
            depths = [depth for n, depth in found.items() if n not in spared]
            shallow = max(depths) < DEEPEST and found[4] < DEEPEST_CONTACT_4
            if reached and shallow and np.max(np.abs(q - guess)) < 0.3:
                result.append((q, random_rates(rng), rng.uniform(0.0, 25.0)))
                kept += 1
            if kept == REPEATS:
                break
    for _ in range(REPEATS):
        result.append((taut_strap_pose(rng), random_rates(rng), rng.uniform(0.0, 5.0)))
    return result


# --------------------------------------------------------------------------------------
# Self-checks
# --------------------------------------------------------------------------------------


def test_rest_pose_is_an_equilibrium():
    """The stated rest pose leaves residuals far below the forces (it is given to 1e-7)."""
    e = aw.evaluate(aw.REST_POSE, np.zeros(6))
    assert np.all(np.abs(e.force) < 2e-4 * e.scale())
    solved = aw.equilibrium(aw.REST_POSE)
    assert np.all(np.abs(solved - aw.REST_POSE) < [1e-9, 1e-7, 1e-7, 1e-7, 1e-7, 1e-7])
    assert np.max(np.abs(aw.evaluate(solved, np.zeros(6)).force)) < 1e-11


def test_hammer_blow_distance():
    """Blow 48.24 mm at rest; 47.988 mm from the bare tables (shank just touching the rest rail)."""
    assert aw.hammer_gap(aw.REST_POSE) == pytest.approx(48.24e-3, abs=5e-6)
    bare = aw.bare_model()
    touching = aw.pose_with({7: 0.0}, aw.REST_POSE, bare)
    assert aw.hammer_gap(touching, bare) == pytest.approx(47.988e-3, abs=5e-7)


def test_regulated_distances_at_rest():
    """Dip 10.50 mm (11.81 as printed), rest rail 0.19 mm and 0.06 N, lost motion 0.60 mm."""
    e = aw.evaluate(aw.REST_POSE, np.zeros(6))
    assert -e.contacts[2]["compression"] == pytest.approx(10.50e-3, abs=1e-5)
    assert e.contacts[7]["compression"] == pytest.approx(0.19e-3, abs=5e-6)
    assert e.contacts[7]["normal_force"] == pytest.approx(0.06, abs=5e-3)
    assert -e.contacts[4]["compression"] == pytest.approx(0.60e-3, abs=5e-6)
    bare = aw.bare_model()
    dip = -aw.compressions(aw.equilibrium(aw.REST_POSE, model=bare), bare)[2]
    assert dip == pytest.approx(11.81e-3, abs=2e-5)


def test_curves_cross_at_the_stated_forces():
    """Loading and unloading curves of Table A.12 meet at the forces listed by the design note."""
    stated = {1: 21.5, 3: 51, 4: 33, 5: 28.5, 6: 52.5, 8: 31.5, 9: 8.7, 10: 10, 11: 22, 12: 6.7}
    stated |= {13: 33, 14: 33, 15: 52}
    for number, force in stated.items():
        _, _, loading, unloading, _ = aw.CONTACT_TABLE[number]
        grid = np.linspace(5e-3, 1e-5, 5000)
        loop = [aw.curve(x, loading) - aw.curve(x, unloading) for x in grid]
        start = next(i for i in range(4999) if loop[i] < 0.0 <= loop[i + 1])
        depth = brentq(
            lambda x, a=loading, b=unloading: aw.curve(x, a) - aw.curve(x, b),
            grid[start + 1],
            grid[start],
        )
        assert aw.curve(depth, loading) == pytest.approx(force, rel=0.02)


def test_guarded_law_stays_inside_its_bounds():
    """Guarded: 0 <= F <= max(F_L, 0) for any rate; no force without compression; eq. 4.22."""
    for _, _, loading, unloading, _ in aw.CONTACT_TABLE.values():
        for compression in np.geomspace(1e-7, 2e-3, 40):
            top = aw.contact_force(compression, 1.0, loading, unloading)
            assert top == max(aw.curve(compression, loading), 0.0)
            forces = [
                aw.contact_force(compression, rate, loading, unloading)
                for rate in (-3.0, -0.1, -1e-3, -1e-6, 0.0)
            ]
            assert np.all(np.diff(forces) >= -1e-12 * top)
            assert forces[0] >= 0.0
            assert forces[-1] == top
        assert aw.contact_force(0.0, 1.0, loading, unloading) == 0.0
        assert aw.contact_force(-1e-3, -1.0, loading, unloading, "printed") == 0.0


def test_exponential_continues_linearly():
    """Beyond the exponent 40 the curve is finite and its slope continuous."""
    constants = (1.0, 4e4, 0.0)
    limit = 40.0 / constants[1]
    values = [aw.curve(limit * (1 + h), constants) for h in (-1e-6, 0.0, 1e-6)]
    assert values[2] - values[1] == pytest.approx(values[1] - values[0], rel=1e-4)
    assert np.isfinite(aw.curve(1.0, constants))


def test_strap_is_slack_below_the_root_of_its_cubic():
    """The strap of Appendix A.4 pulls only beyond 0.325 mm, where K changes sign."""
    assert aw.strap_force(-1e-3) == 0.0
    assert aw.strap_force(0.32e-3) == 0.0
    assert aw.strap_force(1e-3) == pytest.approx((3.47e7 * 1e-6 + 1.84e2 - 63.45) * 1e-3)


def test_coverage_of_contacts():
    """Every contact 1 to 15 is closed between 0.01 and 0.5 mm in several states."""
    assert len(states()) >= 60
    tally = dict.fromkeys(range(1, 16), 0)
    for q, _, _ in states():
        for number, depth in aw.compressions(q).items():
            tally[number] += 1e-5 <= depth <= 5e-4
    assert min(tally.values()) >= 6, tally


def test_coverage_of_the_hybrid_and_the_strap():
    """Contact 4 is closed on the arc and on both lines; the strap is taut in several states."""
    regions = dict.fromkeys(("arc", "top", "side"), 0)
    taut = 0
    for q, qd, finger in states():
        if aw.compressions(q)[4] > 0.0:
            regions[aw.hybrid_region(q)] += 1
        taut += aw.evaluate(q, qd, finger).strap_tension > 0.0
    assert min(regions.values()) >= 4, regions
    assert taut >= 5


def test_coverage_of_rates():
    """Closed contacts are met loading and unloading, sticking (slow) and sliding."""
    for number in range(1, 16):
        rates = [
            aw.evaluate(*state).contacts[number]["rate"]
            for state in states()
            if aw.compressions(state[0])[number] > 0.0
        ]
        assert min(rates) < 0.0 < max(rates)


def test_mass_matrix_is_symmetric_positive_definite():
    """M of eq. 4.6 in all states; the four trees are not coupled by mass."""
    for q, _, _ in states():
        mass = aw.default_model().mass_matrix(q)
        assert np.allclose(mass, mass.T, rtol=1e-14, atol=0.0)
        assert np.min(np.linalg.eigvalsh(mass)) > 0.0
        assert mass[1, 2] == 0.0
        assert mass[3, 4] == 0.0
        assert mass[4, 5] == 0.0


def test_frames_agree_with_complex_chain():
    """The SymPy transforms and the complex-number chain give the same body frames."""
    for q, _, _ in states():
        for body, (x, y, c, s) in aw.default_model().poses(q).items():
            origin, direction = aw.chained_pose(body, q)
            assert abs(complex(x, y) - origin) < 1e-15
            assert abs(complex(c, s) - direction) < 1e-15


def test_kinetic_energy_from_material_points():
    """T from finite differences of mass centers and of Gauss points along the rods."""
    p = aw.make_parameters()
    nodes, weights = np.polynomial.legendre.leggauss(3)

    def velocity(body, local, q, qd):
        h = 1e-6
        places = []
        for sign in (1.0, -1.0):
            origin, direction = aw.chained_pose(body, q + sign * h * qd)
            places.append(origin + direction * complex(*local))
        return (places[0] - places[1]) / (2 * h)

    rates = np.array([0.1, 0.7, -0.9, 3.0, -2.0, 1.1])
    spins = {"key": 0.7, "whippen": -0.9, "jack": 2.1, "backcheck": -0.9}
    spins |= {"butt": -2.0, "head": -2.0, "damper": 1.1}
    for q, _, _ in states()[::7]:
        energy = 0.0
        for body, (mass, inertia, center) in p.masses.items():
            energy += 0.5 * mass * abs(velocity(body, center, q, rates)) ** 2
            energy += 0.5 * inertia * spins[body] ** 2
        for body, (mass, length) in p.rods.items():
            for node, weight in zip(nodes, weights, strict=True):
                place = (0.5 * length * (1 + node), 0.0)
                energy += 0.25 * mass * weight * abs(velocity(body, place, q, rates)) ** 2
        assert aw.default_model().kinetic(q, rates) == pytest.approx(energy, rel=1e-8)


def test_quadratic_terms_from_mass_matrix():
    """h = dM/dt qd - d(qd' M qd / 2)/dq, M differentiated by complex steps."""
    model, h = aw.default_model(), 1e-30
    for q, qd, _ in states()[::3]:
        change = np.imag(model.mass_matrix(q + 1j * h * qd)) / h
        expected = change @ qd
        for k in range(6):
            step = q + 1j * h * np.eye(6)[k]
            expected[k] -= 0.5 * np.imag(qd @ model.mass_matrix(step) @ qd) / h
        assert np.allclose(model.quadratic(q, qd), expected, rtol=1e-12, atol=1e-18)


@pytest.mark.parametrize("law", ["guarded", "printed"])
def test_power_balance(law):
    """d/dt(T + V + springs) equals the power of contacts, friction, strap and finger."""
    model, h = aw.default_model(), 1e-30
    for q, qd, finger in states():
        e = aw.evaluate(q, qd, finger, law)
        moving = q + 1j * h * qd
        rates = qd + 1j * h * e.acceleration
        energy = model.kinetic(moving, rates) + model.potential(moving) + aw.spring_energy(moving)
        done = {
            name: qd @ value
            for name, value in e.contributions.items()
            if name not in ("gravity", "quadratic", "springs")
        }
        terms = np.abs(qd) @ e.scale()
        assert abs(np.imag(energy) / h - sum(done.values())) <= 1e-12 * terms + 1e-15


def test_power_of_each_contact():
    """Normal power is -F rate; friction power is -f slip and never positive (guarded)."""
    for q, qd, finger in states():
        e = aw.evaluate(q, qd, finger)
        for number, c in e.contacts.items():
            normal = qd @ e.contributions[f"normal.{number}"]
            friction = qd @ e.contributions[f"friction.{number}"]
            assert normal == pytest.approx(-c["normal_force"] * c["rate"], rel=1e-9, abs=1e-12)
            drag = -c["friction_force"] * c["slip_speed"]
            assert friction == pytest.approx(drag, rel=1e-9, abs=1e-12)
            assert drag <= 0.0


def test_acceleration_and_sum_of_contributions():
    """M qdd = force, and the contributions add up to the force."""
    for state in states():
        e = aw.evaluate(*state)
        residual = e.mass_matrix @ e.acceleration - e.force
        room = e.scale() + np.abs(e.mass_matrix) @ np.abs(e.acceleration)
        assert np.all(np.abs(residual) <= 1e-12 * room)
        total = sum(e.contributions.values())
        assert np.all(np.abs(total - e.force) <= 1e-13 * e.scale())


@pytest.mark.parametrize("every", [20, pytest.param(4, marks=pytest.mark.slow)])
def test_compression_by_search_over_boundaries(every):
    """Compression of contacts 1 to 14 from sampled boundary curves, no distance formula."""
    for q, _, _ in states()[::every]:
        found = aw.compressions(q)
        for number in range(1, 15):
            searched = aw.brute_force_compression(q, number)
            assert searched == pytest.approx(found[number], abs=1e-10), number


def test_friction_gradient_by_finite_differences():
    """Slip speed from positions of the two material points a short time before and after."""
    h = 1e-6
    p = aw.make_parameters()
    for q, qd, _ in states()[::5]:
        e = aw.evaluate(q, qd)
        for number, c in e.contacts.items():
            if number == 15:
                continue
            first, second = (p.shapes[name] for name in p.contacts[number][:2])
            circle, other = (first, second) if first[1] == "circle" else (second, first)
            here = complex(c["x"], c["y"])
            speeds = []
            for body in (circle[0], other[0]):
                origin, direction = aw.chained_pose(body, q)
                local = (here - origin) / direction
                places = []
                for sign in (1.0, -1.0):
                    origin, direction = aw.chained_pose(body, q + sign * h * qd)
                    places.append(origin + direction * local)
                speeds.append((places[0] - places[1]) / (2 * h))
            relative = abs(speeds[0] - speeds[1])
            expected = np.hypot(c["rate"], c["slip_speed"])
            assert relative == pytest.approx(expected, rel=1e-6, abs=1e-9)


# --------------------------------------------------------------------------------------
# Comparison with feltmb
# --------------------------------------------------------------------------------------

TOLERANCE = 1e-10


@functools.cache
def loaded_action(law):
    """The action under test with an undeflected string and the given contact law."""
    action = feltmb.load_action("steinway45").with_values(
        {"string.modes": 4, "shank.rigid": True, "wire.rigid": True}
    )
    if law == "printed":
        action = action.with_values({"contacts.*.law": "printed"})
    return action


def compared(law):
    """Yield (witness evaluation, evaluation by feltmb, rates) over all states."""
    action = loaded_action(law)
    for q, qd, finger in states():
        expected = aw.evaluate(q, qd, finger, law)
        yield expected, feltmb.evaluate(action, q, qd, finger_force=finger), qd


def test_coordinates_of_feltmb():
    """Names and order of the coordinates."""
    action = loaded_action("guarded")
    assert tuple(action.coordinates) == aw.COORDINATES


@pytest.mark.parametrize("law", ["guarded", "printed"])
def test_mass_matrix_of_feltmb(law):
    """Mass matrix, each entry against the geometric mean of its two diagonal entries."""
    for expected, point, _ in compared(law):
        root = np.sqrt(np.diag(expected.mass_matrix))
        error = np.abs(np.asarray(point.mass_matrix) - expected.mass_matrix)
        assert np.all(error <= TOLERANCE * np.outer(root, root))


@pytest.mark.parametrize("law", ["guarded", "printed"])
def test_force_of_feltmb(law):
    """Generalized force, against the largest contribution to the coordinate."""
    for expected, point, _ in compared(law):
        error = np.abs(np.asarray(point.force) - expected.force)
        assert np.all(error <= TOLERANCE * expected.scale())


@pytest.mark.parametrize("law", ["guarded", "printed"])
def test_acceleration_of_feltmb(law):
    """Acceleration, the force scale carried through the inverse mass matrix."""
    for expected, point, _ in compared(law):
        reach = np.abs(np.linalg.inv(expected.mass_matrix)) @ expected.scale()
        error = np.abs(np.asarray(point.acceleration) - expected.acceleration)
        assert np.all(error <= 10 * TOLERANCE * reach)


@pytest.mark.parametrize("law", ["guarded", "printed"])
def test_contacts_of_feltmb(law):
    """Contact table; slip and friction by magnitude, their sign depends on the side chosen."""
    for expected, point, qd in compared(law):
        table = point.contacts
        speed = np.max(np.abs(qd)) + np.abs(qd[0])
        for number, c in expected.contacts.items():
            row = table.loc[number]
            force_room = TOLERANCE * (1.0 + abs(c["normal_force"]))
            assert abs(row["compression"] - c["compression"]) <= 1e-13
            assert abs(row["rate"] - c["rate"]) <= TOLERANCE * speed
            assert abs(row["normal_force"] - c["normal_force"]) <= force_room
            friction = abs(row["friction_force"]) - abs(c["friction_force"])
            assert abs(friction) <= force_room
            if number == 15:
                continue  # a vertical force at the pin: no sliding, height of the point immaterial
            assert abs(abs(row["slip_speed"]) - abs(c["slip_speed"])) <= TOLERANCE * speed
            assert abs(row["x"] - c["x"]) <= 1e-11
            assert abs(row["y"] - c["y"]) <= 1e-11


def test_rest_of_feltmb_is_an_equilibrium():
    """At the equilibrium of the witness the force by feltmb vanishes too."""
    action = loaded_action("guarded")
    rest = aw.equilibrium(aw.REST_POSE)
    expected = aw.evaluate(rest, np.zeros(6))
    point = feltmb.evaluate(action, rest, np.zeros(6), finger_force=0.0)
    assert np.all(np.abs(np.asarray(point.force)) <= TOLERANCE * expected.scale())
