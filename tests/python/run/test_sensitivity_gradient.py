"""Derivatives of a stroke: closed forms, exact identities, differences, a second way round."""

import copy
import signal

import numpy as np
import pytest
from scipy.special import ellipj, ellipk

import feltmb
from feltmb import _core
from feltmb.run.sensitivity import Segment, gradient, segments, state_at, state_names

STILL = feltmb.ramp_stroke(0.0, duration=0.02)
MASS, STIFFNESS = 20e-3, 2e4  # kg, N/m: tests/data/mass_spring.toml
G, M, ARM, INERTIA = 9.81, 20e-3, 0.1, 12e-6 + 20e-3 * 0.1**2  # of tests/data/pendulum.toml


@pytest.fixture(scope="module")
def sledge(data):
    return feltmb.load_action(data / "mass_spring.toml")


@pytest.fixture(scope="module")
def swing(pendulum):
    return pendulum.with_values({"contacts.01.enabled": False})


def test_blow_on_a_linear_spring(sledge):
    """Half a period of a mass on a spring; every number of the strike in closed form."""
    speed, gap = 2.0, 1e-3
    paths = ["contacts.01.hunt_crossley.stiffness", "sledge.mass"]
    (g,) = segments(
        sledge, STILL, [Segment(0.0, 0.02, [-gap, speed])], paths, ["x"], rtol=1e-11, tolerance=1e-7
    )
    assert g.columns == (paths[0], "bodies.sledge.mass", "start.x", "start.x.rate")
    assert g.column_units == ("N/m", "kg", "m", "m/s")
    root = np.sqrt(MASS / STIFFNESS)
    half = np.pi * root
    exact = {
        "impact_time": [0.0, 0.0, -1 / speed, -gap / speed**2],
        "impact_speed": [0.0, 0.0, 0.0, 1.0],
        "rebound_speed": [0.0, 0.0, 0.0, 1.0],
        "impact_duration": [-half / (2 * STIFFNESS), half / (2 * MASS), 0.0, 0.0],
        "max_impact_force": [speed * root / 2, speed / (2 * root), 0.0, 1 / root * MASS],
    }
    scale = np.array([1 / STIFFNESS, 1 / MASS, 1 / gap, 1 / speed])  # of the columns
    for name, derivative in exact.items():
        # The weak return spring of the file, 1e-3 N/m, is left out of the closed form.
        error = g.summary_gradient[name] - np.array(derivative)
        assert np.all(np.abs(error) < 2e-5 * abs(g.summary[name]) * scale), name
    # After the strike: x = -v (t - t_impact - T) from the wall.
    after = g.time > 0.006
    flight = g.time[after] - gap / speed - half
    by_mass = speed * half / (2 * MASS)
    assert g.of("x", "bodies.sledge.mass")[after] == pytest.approx(by_mass, rel=1e-4)
    by_speed = -flight - gap / speed
    assert g.of("x", "start.x.rate")[after] == pytest.approx(by_speed, rel=1e-3)


@pytest.mark.parametrize("amplitude", [0.5, 2.5])
def test_swing_of_a_pendulum(swing, amplitude):
    """Jacobi's elliptic functions, differentiated numerically."""

    def angle(start, gravity, t):
        rate = np.sqrt(M * gravity * ARM / INERTIA)
        k = np.sin(start / 2)
        _, _, dn, _ = ellipj(rate * t, k**2)
        _, cn, _, _ = ellipj(rate * t, k**2)
        return 2 * np.arcsin(k * cn / dn)

    (g,) = segments(
        swing,
        STILL,
        [Segment(0.0, 1.0, [amplitude, 0.0])],
        ["gravity.y"],
        ["arm.angle"],
        directions=["arm.angle"],
        rtol=1e-11,
        tolerance=1e-7,
    )
    assert ellipk(np.sin(amplitude / 2) ** 2) > 0
    h = 1e-5
    assert g.of("arm.angle", "start.arm.angle") == pytest.approx(
        (angle(amplitude + h, G, g.time) - angle(amplitude - h, G, g.time)) / (2 * h), abs=2e-5
    )
    by_gravity = (angle(amplitude, G + h, g.time) - angle(amplitude, G - h, g.time)) / (2 * h)
    assert g.of("arm.angle", "gravity.y") == pytest.approx(-by_gravity, abs=2e-5)


@pytest.fixture(scope="module")
def forte(action):
    paths = ["stroke.delay", "stroke.scale", "string.tension", "contacts.06.loading.a", "key.mass"]
    outputs = ["hammer.angle", "hammer.angle.rate", "contact06.force"]
    return gradient(action, "forte", paths, outputs, duration=0.1, rtol=1e-8, tolerance=2e-4)


def test_a_delay_moves_every_event_and_nothing_else(forte):
    """d time / d delay = 1 for all events; speeds and forces stay."""
    times = [e["gradient"][0] for e in forte.events]
    assert len(times) > 10
    assert times == pytest.approx([1.0] * len(times), abs=1e-2)
    assert forte.summary_gradient["impact_speed"][0] == pytest.approx(0.0, abs=0.1)
    # Everything moves with the rate that it has.
    assert forte.of("hammer.angle", "stroke.delay") == pytest.approx(
        -forte.values[:, 1], abs=2e-3 * np.abs(forte.values[:, 1]).max()
    )


def richardson(action, path, value, step, number, **options):
    """Differences of fourth order of tight runs."""

    def at(shift):
        changed = action.with_values({path: value + shift})
        run = feltmb.simulate(changed, "forte", ledger=False, output_rate=1000.0, **options)
        return number(run)

    coarse = (at(step) - at(-step)) / (2 * step)
    fine = (at(step / 2) - at(-step / 2)) / step
    return (4 * fine - coarse) / 3


@pytest.mark.parametrize(
    ("path", "value", "names"),
    [
        ("string.tension", 654.0, ["max_impact_force", "rebound_speed"]),
        ("contacts.06.loading.a", 23500.0, ["max_impact_force", "impact_duration"]),
    ],
)
def test_the_blow_against_differences(action, forte, path, value, names):
    column = forte.columns.index(path)
    for name in names:
        by_runs = richardson(
            action, path, value, 1e-3 * value, lambda r, n=name: r.summary[n],
            duration=0.097, rtol=1e-9,
        )  # fmt: skip
        assert forte.summary_gradient[name][column] == pytest.approx(by_runs, rel=3e-3), name


def test_the_right_hand_side_never_jumps(forte):
    """The laws of the data set are continuous at every switch: no saltation was called for."""
    assert forte.stats["switches"] > 50
    assert forte.stats["jumps"] == 0


def test_a_jump_of_the_right_hand_side(pendulum):
    """A finger whose speed jumps meets a damped pad: the force jumps at a moving time.

    The delay of the whole motion delays the answer, which the columns get only with their own jump.
    """
    stroke = feltmb.motion_stroke(
        [0.01, 0.0135, 0.05], [0.0, 0.7e-3, 3e-3], interpolation="linear", duration=0.08
    )
    pendulum = pendulum.with_values({"finger.pad.damping": 2.0})
    g = gradient(pendulum, stroke, ["stroke.delay"], ["arm.angle"], rtol=1e-10, tolerance=1e-6)
    assert g.stats["jumps"] >= 1
    h = 1e-5
    early, late = (
        feltmb.simulate(pendulum, stroke.shifted(s * h), duration=0.08, rtol=1e-11,
                        output_rate=1000.0)["arm.angle"]
        for s in (-1, 1)
    )  # fmt: skip
    by_runs = (late - early) / (2 * h)
    assert g.of("arm.angle", "stroke.delay") == pytest.approx(
        by_runs[: len(g.time)], abs=1e-3 * np.abs(by_runs).max()
    )


LAWS = {
    "guarded": {},
    "stulov": {
        "contacts.01.law": "stulov",
        "contacts.01.stulov": {"stiffness": 3e8, "exponent": 2.3, "amplitude": 0.4, "time": 1e-4},
    },
    "hunt_crossley": {
        "contacts.01.law": "hunt_crossley",
        "contacts.01.hunt_crossley": {"stiffness": 5e6, "exponent": 2.0, "damping": 0.2},
    },
    "felt_memory": {"contacts.01.law": "felt_memory"},
    "maxwell": {
        "contacts.01.law": "maxwell",
        "contacts.01.maxwell": {
            "stiffness": 1e7, "exponent": 2.0, "branch_stiffness": 5e7, "branch_exponent": 2.2,
            "branch_time": 2e-3,
        },
    },
    "dunlop": {
        "contacts.01.law": "dunlop",
        "contacts.01.dunlop": {
            "stiffness": 5e5,
            "exponent": 1.5,
            "share": 0.2,
            "damping": 20.0,
        },
    },
    "expression": {
        "contacts.01.law": "expression",
        "contacts.01.expression": {
            "force": "k*e^p*max(0.2, 1 + d*rate)", "parameters": {"k": 5e6, "p": 2.0, "d": 0.5},
        },
    },
}  # fmt: skip
NUMBER = {
    "guarded": "contacts.01.loading.b",
    "stulov": "contacts.01.stulov.amplitude",
    "hunt_crossley": "contacts.01.hunt_crossley.damping",
    "felt_memory": "contacts.01.loading.b",
    "maxwell": "contacts.01.maxwell.branch_time",
    "dunlop": "contacts.01.dunlop.share",
    "expression": "contacts.01.expression.parameters.d",
}


@pytest.mark.parametrize("law", LAWS)
def test_laws_with_branches_and_memory(pendulum, law):
    """Two strikes of the pendulum on each law, against differences; the second meets the memory."""
    felt = pendulum.with_values(LAWS[law])
    path = NUMBER[law]
    n = len(state_names(felt))
    start = np.zeros(n)
    start[0], start[1] = -0.05, 2.0
    stroke = feltmb.ramp_stroke(0.0, duration=0.5)
    contacts = np.zeros(len(felt.mechanism.contact_numbers))
    segment = Segment(0.0, 0.5, start, contacts)

    def run(action):
        return segments(
            action, stroke, [segment], (), ["arm.angle"], directions=None, rtol=1e-12, jobs=1
        )[0].values[:, 0]

    from feltmb.mechanism.parameters import find_parameters

    (parameter,) = find_parameters(felt, path)
    (g,) = segments(
        felt, stroke, [segment], [path], ["arm.angle"], directions=["arm.angle.rate"],
        rtol=1e-10, tolerance=1e-5,
    )  # fmt: skip
    closings = [e for e in g.events if e["event"] in ("felt_on", "contact01_on")]
    assert len(closings) >= 2
    shifts = (1e-4, 5e-5)
    values = []
    for relative in shifts:
        h = relative * parameter.value
        up, down = (run(felt.with_values({path: parameter.value + s * h})) for s in (1, -1))
        values.append((up - down) / (2 * h))
    by_runs = (4 * values[1] - values[0]) / 3
    assert g.of("arm.angle", path) == pytest.approx(by_runs, abs=3e-3 * np.abs(by_runs).max())


def test_a_felt_that_passes_what_it_remembers(pendulum):
    """What z keeps depends on how deep the felt was pressed before, and is pressed now."""
    felt = pendulum.with_values({**LAWS["felt_memory"], "contacts.01.memory": {"kappa": 0.2}})
    stroke = feltmb.ramp_stroke(0.0, duration=0.06)
    memory = np.full(len(felt.mechanism.contact_numbers), 1.35e-3)

    def strike(action, speed=2.0, paths=(), **options):
        segment = Segment(0.0, 0.06, [-0.05, speed, 0.0], memory)
        options = {"directions": None, "rtol": 1e-12, "jobs": 1, **options}
        return segments(action, stroke, [segment], paths, ["arm.angle.rate"], **options)[0]

    paths = ["contacts.01.loading.b", "contacts.01.memory.kappa", "bodies.arm.mass"]
    g = strike(felt, paths=paths, directions=["arm.angle.rate"], rtol=1e-10, tolerance=1e-6)
    assert memory[0] < g.end_memory[0] < 1.1 * memory[0]
    h = 1e-4

    def difference(run, value):
        up, down = (run(value * (1.0 + s * h)).values[-1, 0] for s in (1, -1))
        return (up - down) / (2.0 * h * value)

    for path in paths:
        by_runs = difference(
            lambda v, path=path: strike(felt.with_values({path: v})), felt.value(path)[0]
        )
        assert g.of("arm.angle.rate", path)[-1] == pytest.approx(by_runs, rel=1e-3), path
    by_speed = difference(lambda v: strike(felt, v), 2.0)
    assert g.of("arm.angle.rate", "start.arm.angle.rate")[-1] == pytest.approx(by_speed, rel=1e-3)


def test_segments_chain(action):
    """Derivatives over two segments multiply to those over both (the second way round)."""
    first, second = state_at(action, "forte", [0.0, 0.085, 0.094])
    options = {"rtol": 1e-9, "tolerance": 1e-4, "jobs": 1}
    lead = segments(action, "forte", [first], ["key.mass"], (), directions=None, **options)[0]
    last = segments(action, "forte", [second], ["key.mass"], (), directions="all", **options)[0]
    whole = gradient(action, "forte", ["key.mass"], (), duration=0.094, rtol=1e-9, tolerance=1e-4)
    chained = last.end_gradient[:, 0] + last.end_gradient[:, 1:] @ lead.end_gradient[:, 0]
    assert last.end_state == pytest.approx(whole.end_state, rel=1e-3, abs=1e-3)
    n = 2 * len(action.coordinates)
    for i in range(n):
        kind = slice(0, n // 2) if i < n // 2 else slice(n // 2, n)
        room = 1e-2 * np.abs(whole.end_gradient[kind, 0]).max()
        assert chained[i] == pytest.approx(whole.end_gradient[i, 0], abs=room)


def test_threads_change_nothing(action):
    cuts = state_at(action, "forte", [0.0, 0.03, 0.06, 0.08])
    one, two = (
        segments(action, "forte", cuts, ["key.mass"], ["hammer.angle"], jobs=j) for j in (1, 2)
    )
    for a, b in zip(one, two, strict=True):
        assert a.array.tobytes() == b.array.tobytes()
        assert a.end_gradient.tobytes() == b.end_gradient.tobytes()


def test_work_does_not_grow_with_the_parameters(action):
    """One factorization a stage, whatever the number of columns."""
    few = gradient(action, "forte", ["key.mass"], (), duration=0.06)
    many = gradient(action, "forte", ["key.mass", "contacts.*.loading.a"], (), duration=0.06)
    assert many.stats["factorizations"] < 3 * few.stats["factorizations"]


def test_bad_input(action):
    with pytest.raises(feltmb.InvalidParameter) as failure:
        gradient(action, "forte", ["key.mss", "string.modes"])
    assert "bodies.key.mass" in str(failure.value)
    assert "string.modes" in str(failure.value)
    with pytest.raises(feltmb.InvalidParameter, match=r"hammer\.angle"):
        gradient(action, "forte", ["key.mass"], ["hammer.angel"])
    with pytest.raises(feltmb.InvalidParameter, match="tolerance"):
        gradient(action, "forte", ["key.mass"], tolerance=0.0)
    with pytest.raises(feltmb.InvalidParameter, match="must end after it begins"):
        segments(action, "forte", [Segment(0.1, 0.1)])
    with pytest.raises(feltmb.InvalidParameter, match="state holds 3 numbers"):
        segments(action, "forte", [Segment(0.0, 0.1, [0.0, 1.0, 2.0])])
    with pytest.raises(feltmb.InvalidParameter, match="cannot be shifted"):
        gradient(action, "forte", ["wire.mass"])
    with pytest.raises(feltmb.InvalidParameter, match="the limit is"):  # filled the memory
        gradient(action, "forte", ["key.mass"], output_rate=2.0**62)


def test_signals_are_seen_while_derivatives_are_integrated(action, monkeypatch):
    """Ctrl-C waited for the end of the derivatives, 45 s with all parameters of the action."""
    core, seen, counted = _core.sensitivities, [], []

    def call(mechanism, drive, parameters, segments, options, *more):
        options.set_looks(lambda _: seen.clear() or [])  # between the stroke and its derivatives
        out = core(mechanism, drive, parameters, segments, options, *more)
        counted.append(len(seen))
        return out

    monkeypatch.setattr(_core, "sensitivities", call)
    monkeypatch.setattr("feltmb.run.sensitivity.work.looks_of", lambda *_: lambda _: [])
    before = signal.signal(signal.SIGALRM, lambda *_: seen.append(1))
    signal.setitimer(signal.ITIMER_REAL, 0.01, 0.01)
    try:
        gradient(action, "forte", "contacts.*.loading.*", (), duration=0.2)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert counted[0] > 3


def test_full_state_of_the_core(action):
    names = state_names(action)
    assert names[: len(action.coordinates)] == action.coordinates
    assert len(names) == len(_core.state_names(action.mechanism))


def test_quick_ways_to_the_inhomogeneous_part(action):
    """A center of mass goes by its own formula, linear in the moments of mass; against runs."""
    path, value = "bodies.jack.center_of_mass.y", 0.0256
    g = gradient(
        action, "forte", [path, "bodies.butt.mass"], ["hammer.angle"], duration=0.09, rtol=1e-9,
        tolerance=1e-4,
    )  # fmt: skip

    def at(shift):
        run = feltmb.simulate(
            action.with_values({path: value + shift}), "forte", duration=0.09, rtol=1e-10,
            ledger=False, output_rate=1000.0,
        )  # fmt: skip
        return run["hammer.angle"]

    h = 1e-4
    by_runs = (at(h) - at(-h)) / (2 * h)
    assert g.of("hammer.angle", path) == pytest.approx(by_runs, abs=1e-3 * np.abs(by_runs).max())


QUICK = [
    "contacts.08.loading.a", "bodies.butt.inertia", "string.tension", "string.linear_density",
    "string.damping_ratio", "bodies.wire.inertia", "surfaces.Gp10.point.y",
    "contacts.06.friction.amplitude", "points.key_front.point.x", "stroke.scale",
    "bodies.butt.friction.amplitude", "springs.butt_spring.rest_angle", "gravity.x",
    "straps.bridle_strap.free_length", "bodies.backcheck.position.x", "finger.point.x",
]  # fmt: skip


@pytest.fixture
def whole_models(monkeypatch):
    """A switch: one right-hand side with the shifted model for every parameter."""
    core, state = _core.sensitivities, {"on": False}

    def call(mechanism, drive, parameters, segments, options, *more):
        options.whole_models = state["on"]
        return core(mechanism, drive, parameters, segments, options, *more)

    monkeypatch.setattr(_core, "sensitivities", call)
    return state


@pytest.mark.parametrize("law", ["guarded", "felt_memory"])
def test_what_a_parameter_touches_is_all_that_it_touches(action, whole_models, law):
    """Forces of the parts that the core finds changed, against the whole shifted model."""
    felt = action.with_values({"contacts.06.law": law, "shank.rigid": True, "wire.rigid": True})
    options = {"duration": 0.11, "rtol": 1e-8, "tolerance": 1e-3}
    outputs = ["hammer.angle", "key_front.x", "string.strike", "contact06.force"]
    quick = gradient(felt, "forte", QUICK, outputs, **options)
    whole_models["on"] = True
    plain = gradient(felt, "forte", QUICK, outputs, **options)
    assert quick.stats["rhs"] < 0.5 * plain.stats["rhs"]
    sizes = np.array([p.size for p in plain.parameters])
    for j, path in enumerate(quick.columns):
        for i, output in enumerate(outputs):
            want, got = (g.array[:, i, :] * sizes for g in (plain, quick))
            room = 1e-3 * np.abs(want[:, j]).max() + 1e-8 * np.abs(want).max()
            assert got[:, j] == pytest.approx(want[:, j], abs=room), (path, output)


def test_a_string_left_alone_by_differences(rigid):
    """Strings are rotated, not integrated, after the strike; by its own numbers, against runs."""
    for path, value in (("string.tension", 654.0), ("string.damping_ratio", 0.07)):
        g = gradient(rigid, "forte", path, ["string.strike"], duration=0.12, rtol=1e-9,
                     tolerance=1e-4)  # fmt: skip

        def at(shift, path=path, value=value):
            run = feltmb.simulate(
                rigid.with_values({path: value * (1.0 + shift)}), "forte", 0.12, rtol=1e-10,
                ledger=False, output_rate=1000.0,
            )  # fmt: skip
            return run["string.strike"]

        h = 1e-3
        by_runs = (8.0 * (at(h) - at(-h)) - (at(2 * h) - at(-2 * h))) / (12.0 * h * value)
        late = g.time > 0.1
        assert np.abs(by_runs[late]).max() > 0.0
        room = 3e-3 * np.abs(by_runs).max()
        assert g.of("string.strike", path) == pytest.approx(by_runs, abs=room), path


def test_a_felt_of_fibers_by_its_own_numbers(rigid):
    """Thickness, fibers and loop of a micromechanical contact, against Richardson differences."""
    from feltmb.mechanism.parameters import find_parameters

    law = {"name": "micromechanical", "felt": "synthetic_hammer", "thickness": "6 mm"}
    area = {"kind": "crossed_cylinders"}
    felt = rigid.with_values({"contacts.06.law": {**law, "area": area}})
    table = "contacts.06.micromechanical"
    paths = [f"{table}.{name}" for name in ("thickness", "felt.v_f0", "felt.loading.K_p",
                                            "felt.fiber.friction", "area.radius_a")]  # fmt: skip
    g = gradient(felt, "forte", paths, (), duration=0.105, rtol=1e-8, tolerance=1e-4)
    names = ("max_impact_force", "rebound_speed", "impact_duration")
    found = find_parameters(felt, paths)

    def at(parameter, shift):
        changed = feltmb.parameters.mechanism_with(
            felt, {parameter.path: parameter.value * (1.0 + shift)}
        )
        moved = copy.copy(felt)
        moved.mechanism = changed
        run = feltmb.simulate(moved, "forte", 0.105, rtol=1e-10, ledger=False, summary_only=True)
        return np.array([run.summary[name] for name in names])

    h = 1e-3
    for j, parameter in enumerate(found):
        once, twice = (at(parameter, k * h) - at(parameter, -k * h) for k in (1, 2))
        by_runs = (8.0 * once - twice) / (12.0 * h)
        got = np.array([g.summary_gradient[name][j] * parameter.size for name in names])
        room = 5e-5 * np.array([g.summary[name] for name in names])
        assert np.all(np.abs(got - by_runs) < 5e-3 * np.abs(by_runs) + room), parameter.path


def test_a_delay_of_a_prescribed_motion_whose_acceleration_jumps_at_its_knots():
    action = feltmb.load_action("steinway45")
    time = np.array([0.0, 0.01, 0.02, 0.03, 0.04, 0.06])
    travel = 9e-3 * np.array([0.0, 0.0, 0.3, 0.5, 0.9, 1.0])  # at rest up to the second knot
    stroke = feltmb.motion_stroke(time, travel, of="key", duration=0.03, interpolation="monotone")
    outputs = ["key.angle", "key.angle.rate"]
    g = gradient(action, stroke, ["stroke.delay"], outputs, tolerance=1e-4, output_rate=1000.0)
    rate = g.values[:, 1]
    error = np.abs(g.of("key.angle", "stroke.delay") + rate)
    assert error.max() < 5e-3 * np.abs(rate).max()


def test_key_that_follows_a_prescribed_motion():
    """The reaction takes part in every column; a heavier key starts lower."""
    action = feltmb.load_action("steinway45")
    time = np.linspace(0.0, 0.06, 7)
    travel = 9e-3 * np.sin(0.5 * np.pi * time / 0.06) ** 2

    def press(scale=1.0):
        return feltmb.motion_stroke(time, scale * travel, of="key", duration=0.03)

    changes = {"bodies.key.mass": 0.01, "bodies.jack.inertia": 0.01}
    outputs = ["hammer.angle", "finger.force"]
    g = gradient(
        action, press(), [*changes, "stroke.scale"], outputs, tolerance=1e-4, output_rate=1000.0
    )
    options = {"ledger": False, "rtol": 1e-9, "output_rate": 1000.0}

    def difference(one, other, width):
        runs = [feltmb.simulate(*each, **options) for each in (one, other)]
        return {name: (runs[0][name] - runs[1][name]) / width for name in outputs}

    found = {"stroke.scale": difference((action, press(1.001)), (action, press(0.999)), 2e-3)}
    for path, part in changes.items():
        body = action.config.bodies[path.split(".")[1]]
        value = getattr(body, path.split(".")[2])
        unit = "kg" if path.endswith("mass") else "kg m^2"
        both = [
            action.with_values({path: f"{value * (1.0 + sign * part)!r} {unit}"})
            for sign in (1, -1)
        ]
        found[path] = difference((both[0], press()), (both[1], press()), 2.0 * part * value)
    for path, values in found.items():
        for name, wanted in values.items():
            error = np.abs(g.of(name, path) - wanted).max()
            assert error < 5e-3 * np.abs(wanted).max(), (path, name)


def test_tolerance_is_relative_to_the_motion_of_a_column(rigid):
    """The line of a damper takes the damper with it: the compression between them hardly changes.

    The tolerance bounds its error against that motion (1 m a m), not against the small difference,
    which needs a tighter one (docs/howto/find_sensitivities.md, "Limits").
    """
    action = rigid.with_values({"string.other_surfaces": ["Gp9"], "contacts.09.enabled": False})
    path, outputs = "surfaces.Gp9.point.y", ["contact10.compression", "damper.angle"]

    def columns(tolerance):
        return gradient(
            action, "forte", path, outputs, duration=0.098, rtol=1e-9, tolerance=tolerance
        ).array[:, :, 0]

    exact = columns(1e-6)
    largest = np.abs(exact).max(axis=0)
    assert largest[0] < 1e-3  # m a m
    shares = {}
    for tolerance in (3e-3, 1e-4, 1e-5):
        error = np.abs(columns(tolerance) - exact).max(axis=0)
        assert error[0] < 0.1 * tolerance
        assert error[1] < 2.0 * tolerance * largest[1]
        shares[tolerance] = error[0] / largest[0]
    assert shares[1e-4] > 50.0 * 1e-4
    assert shares[1e-5] < 5e-3
