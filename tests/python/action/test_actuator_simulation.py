"""Exact modal advance with implicit forces against other integrators, models and references."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import feltmb
from feltmb.action.actuator import load_actuator, simulate_actuator, stand_alone
from feltmb.mechanism import core_law
from unmodeled.errors import InvalidParameter

RAMP = feltmb.torque_stroke([0.0, 0.06], [0.0, 3.0])


def force_of(actuator):
    """Stop force as a function of compression and rate: the law alone."""
    law = core_law(actuator.config.stop)

    def force(e, rate):
        return float(law.force(e, rate)) if e > 0 else 0.0

    return force


def free(arm, **values):
    """Without the equivalent reaction of the action."""
    return load_actuator(arm).with_values({"action.mass": 0.0, **values})


@pytest.mark.parametrize("arm", ["wood", "aluminum"])
def test_reference_of_problem_a(arm, root):
    """Ten undamped elements, 0.2 s; reference converged to 1e-9 m (bench/speed/reference)."""
    actuator = free(
        arm,
        **{
            "gravity": -9.81,
            "linear_gravity": True,
            "tip.eccentricity": 0.0,
            "stop.gap": 10.5e-3,
            "stop.law": "printed",
            "stop.alpha": 10.0,
            "stop.unloading": {"a": 7.8, "b": 360.0, "c": 210.0},
        },
    )
    run = simulate_actuator(actuator, RAMP, tolerance=1e-5)
    reference = np.genfromtxt(
        root / "bench" / "speed" / "reference" / f"ref_A_{arm}.csv", delimiter=",", names=True
    )
    peak = np.max(reference["F"])
    assert np.max(np.abs(run["stop.force"] - reference["F"])) < 1e-3 * peak
    assert np.max(np.abs(run["tip.travel"] - reference["tip"])) < 3e-7
    assert np.max(np.abs(run["hub.angle"] - reference["theta"])) < 3e-6
    assert run.energy["residual_relative"] < 3e-4


def test_free_motion_against_a_runge_kutta_method():
    """No stop: the matrices of eq. 5.17 by DOP853."""
    actuator = free("wood", **{"stop.enabled": False, "arm.elements": 2, "linear_gravity": True})
    m, k = actuator.matrices
    weight = np.asarray(actuator._core.beam.weight)
    n = m.shape[0]
    inverse = np.linalg.inv(m)

    def rate(t, y):
        q = 9.81 * weight
        q[0] += 3.0 * min(t / 0.06, 1.0)
        return np.concatenate([y[n:], inverse @ (q - k @ y[:n])])

    t = np.linspace(0.0, 0.02, 201)
    other = solve_ivp(rate, (0, 0.02), np.zeros(2 * n), "DOP853", t, rtol=1e-10, atol=1e-13)
    run = simulate_actuator(actuator, RAMP, 0.02)
    assert run["hub.angle"] == pytest.approx(other.y[0], abs=1e-9)
    assert run["tip.deflection"] == pytest.approx(other.y[n - 2], abs=1e-9)


@pytest.mark.parametrize("damper", ["none", "dashpot", "one_sided"])
def test_on_the_stop_against_a_stiff_integrator(damper):
    """Radau on one element with the same law and damper, cosine of gravity included."""
    actuator = free("wood", **{"arm.elements": 1}).with_damper(damper)
    m, k = actuator.matrices
    beam = actuator._core.beam
    tip, weight = np.asarray(beam.tip), np.asarray(beam.weight)
    n = m.shape[0]
    inverse = np.linalg.inv(m)
    force = force_of(actuator)
    c = actuator.config.damper.coefficient
    gap = actuator.config.stop.gap

    def rate(t, y):
        q = 9.81 * np.cos(y[0]) * weight
        acts = damper == "dashpot" or (damper == "one_sided" and y[n] < 0)
        q[0] += 3.0 * min(t / 0.06, 1.0) - (c * y[n] if acts else 0.0)
        q -= tip * force(tip @ y[:n] - gap, tip @ y[n:])
        return np.concatenate([y[n:], inverse @ (q - k @ y[:n])])

    t = np.linspace(0.0, 0.014, 141)
    other = solve_ivp(rate, (0, 0.014), np.zeros(2 * n), "Radau", t, rtol=1e-7, atol=1e-10)
    run = simulate_actuator(actuator, RAMP, 0.014)
    stop = [force(tip @ y[:n] - gap, tip @ y[n:]) for y in other.y.T]
    assert np.max(stop) > 5.0
    assert run["tip.travel"] == pytest.approx(tip @ other.y[:n], abs=1e-6)
    assert run["stop.force"] == pytest.approx(np.array(stop), abs=2e-3 * np.max(stop))


def test_rigid_arm():
    """E times 1e4: one degree of freedom about the axis, solved on its own."""
    actuator = free("wood", **{"arm.young_modulus": 1e14})
    inertia, reach = actuator.rigid_inertia, actuator.reach
    weight = float(np.asarray(actuator._core.beam.weight)[0])
    force = force_of(actuator)

    def rate(t, y):
        f = force(reach * y[0] - 0.01, reach * y[1])
        moment = 3.0 * min(t / 0.06, 1.0) + 9.81 * np.cos(y[0]) * weight - reach * f
        return [y[1], moment / inertia]

    t = np.linspace(0.0, 0.05, 501)
    other = solve_ivp(rate, (0, 0.05), [0.0, 0.0], "LSODA", t, rtol=1e-9, atol=1e-12)
    run = simulate_actuator(actuator, RAMP, 0.05)
    # The first thousandth of a stop's rebound: the arm still gives a little.
    assert run["hub.angle"] == pytest.approx(other.y[0], abs=2e-3 * np.max(other.y[0]))
    assert np.max(np.abs(run["tip.deflection"])) < 2e-6


@pytest.mark.parametrize("damper", ["none", "dashpot", "one_sided"])
@pytest.mark.parametrize("arm", ["wood", "aluminum"])
def test_energy_ledger(arm, damper):
    run = simulate_actuator(load_actuator(arm).with_damper(damper), tolerance=1e-6)
    assert run.energy["residual_relative"] < 5e-6
    assert run.energy["given_to_action"] > 0.05
    assert run.energy["dissipated_stop"] > 0.0
    assert (run.energy["dissipated_damper"] > 0.0) == (damper != "none")
    for name in ("dissipated.stop", "dissipated.damper"):
        assert np.min(np.diff(run[name])) > -1e-9


def test_first_contact_of_the_thesis():
    """Section 5.2.4: 0.032 s. The equivalent mass was chosen for it; both arms meet it."""
    times = {
        (arm, damper): simulate_actuator(load_actuator(arm).with_damper(damper)).summary[
            "first_contact_time"
        ]
        for arm in ("wood", "aluminum")
        for damper in ("none", "dashpot", "one_sided")
    }
    for arm in ("wood", "aluminum"):
        assert times[arm, "none"] == pytest.approx(0.032, abs=5e-4)
        # Sections 5.2.2 and 5.2.3: the dashpot delays the contact, the one-sided one does not.
        assert times[arm, "dashpot"] > times[arm, "none"] + 5e-5
        assert times[arm, "one_sided"] == pytest.approx(times[arm, "none"], abs=1e-5)


def test_a_one_sided_damper_leaves_the_approach_alone():
    plain = simulate_actuator(load_actuator("wood"))
    damped = simulate_actuator(load_actuator("wood").with_damper("one-sided"))
    before = plain.time < plain.summary["first_contact_time"]
    # But for what the arm's own vibration turns the hub back.
    assert damped["tip.travel"][before] == pytest.approx(plain["tip.travel"][before], abs=2e-6)
    assert damped.summary["ringing"] < 0.5 * plain.summary["ringing"]


@pytest.mark.parametrize("law", ["guarded", "printed", "mean", "felt_memory", "hunt_crossley"])
def test_any_law_at_the_stop(law):
    values = {"stop.law": law}
    if law == "hunt_crossley":
        values["stop.hunt_crossley"] = {"stiffness": 2e5, "exponent": 1.5, "damping": 0.2}
    actuator = free("aluminum", **values)
    run = simulate_actuator(actuator, RAMP, 0.1, tolerance=1e-5)
    assert run.summary["peak_stop_force"] > 20.0
    assert run.energy["residual_relative"] < 3e-3
    if law == "felt_memory":  # passive: never gives energy
        assert np.min(np.diff(run["dissipated.stop"])) > -1e-8


@pytest.mark.parametrize("arm", ["wood", "aluminum"])
def test_the_same_actuator_as_a_mechanism(arm, state_of):
    """Finite elements and exact modes against the planar engine: shapes, joints, BDF.

    The engine's arm has two shapes and exact geometry; the moment arm of the stop shrinks with the
    cosine of the angle there, 0.5 % at 10 mm.
    """
    actuator = free(arm)
    run = simulate_actuator(actuator, RAMP, 0.03)
    alone = stand_alone(actuator)
    held = np.zeros(len(alone.coordinates))  # not the rest pose, where the arm lies on the stop
    other = feltmb.simulate(alone, RAMP, 0.03, rtol=1e-7, start=state_of(alone, held, held))
    assert other["actuator.hub"] == pytest.approx(run["hub.angle"], abs=4e-3)
    opened = run.summary["first_contact_time"]
    assert other.event_table["time"][0] == pytest.approx(opened, rel=5e-3)
    assert np.max(other["contact01.force"]) == pytest.approx(np.max(run["stop.force"]), rel=0.05)
    assert other.energy["residual_relative"] < 1e-4


def test_bad_input():
    with pytest.raises(InvalidParameter, match="duration = -1 s, must be > 0"):
        simulate_actuator("wood", duration=-1.0)
    with pytest.raises(InvalidParameter, match="is a force; the actuator takes a torque"):
        simulate_actuator("wood", feltmb.load_stroke("forte"))
    with pytest.raises(InvalidParameter, match="damper 'oil' is none of none, dashpot, one_sided"):
        load_actuator("wood").with_damper("oil")
    with pytest.raises(InvalidParameter, match=r"tolerance = 0\.5, must be in"):
        simulate_actuator("wood", tolerance=0.5)


def test_outputs_and_files(tmp_path):
    run = simulate_actuator("aluminum", duration=0.02, output_rate=3000.0)
    assert run.time[1] == pytest.approx(1 / 3000)
    assert run["finger.force"] == pytest.approx(run["stop.force"] + run["action.force"])
    with pytest.raises(InvalidParameter, match=r"no output 'finger'; near are finger\.force"):
        run["finger"]
    import xarray as xr

    data = xr.load_dataset(run.save(tmp_path / "run.nc"), engine="h5netcdf")
    assert data["stop.force"].attrs["units"] == "N"
    table = np.genfromtxt(run.save(tmp_path / "run.csv"), delimiter=",", skip_header=1)
    assert table[:, 3] == pytest.approx(run["tip.travel"], rel=1e-8)


@pytest.mark.parametrize("first", [0.035, 0.03507])
def test_corners_of_the_torque_inside_an_interval(first):
    """A pulse of 40 us, shorter than an interval: its work is in the ledger."""
    torque = feltmb.torque_stroke([0, first, first + 2e-5, first + 4e-5, 1], [0, 0, 50, 0, 0])
    run = simulate_actuator(load_actuator("wood"), torque, 0.05)
    assert abs(run.energy["work_motor"]) > 1e-3
    assert run.energy["residual_relative"] < 1e-3


def test_a_step_of_torque():
    torque = feltmb.torque_stroke([0, 0.01, 0.010000001, 1], [0, 0, 3, 3])
    run = simulate_actuator(load_actuator("wood"), torque, 0.05)
    assert run.energy["residual_relative"] < 1e-3


def test_what_leaves_the_equations_is_said():
    assert simulate_actuator("wood").stats["warnings"] == []
    pulled = simulate_actuator("wood", feltmb.torque_stroke([0.0, 0.06], [0.0, -3.0]))
    said = "\n".join(pulled.stats["warnings"])
    assert "the finger pulls" in said
    assert "the hub turns by" in said
    bent = load_actuator("wood").with_values({"hub.radius": 0.0})
    assert any("the arm bends by" in w for w in simulate_actuator(bent).stats["warnings"])
    with pytest.raises(InvalidParameter, match="less than one sample"):
        simulate_actuator("wood", duration=1e-5)
