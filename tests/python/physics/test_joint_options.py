"""Drag, Stribeck friction, spring damping, play of pivots, relaxing felt: closed forms, exact
Jacobian, energy ledger, and the limit of a pivot that does not give."""

import numpy as np
import pytest
from test_energy import check_ledger
from test_jacobian import check_along

import feltmb
from feltmb import _core
from feltmb.mechanism import Action

OPTIONS = {
    "bodies.butt.friction.viscous": 2e-5,
    "bodies.butt.friction.quadratic": 1e-6,
    "bodies.whippen.friction.stribeck": 4e-4,
    "bodies.whippen.friction.stribeck_speed": 0.3,
    "springs.butt_spring.damping": 1e-5,
    "contacts.03.hysteresis": 1.2,
    "contacts.02.memory.rate_amplitude": 0.2,
    "contacts.02.memory.rate_time": 0.02,
    "contacts.06.memory": {"rate_amplitude": 0.1, "rate_time": 0.002},
}


def sliding_mass(**spring):
    return Action(
        {
            "schema": 1,
            "name": "slider",
            "gravity": [0.0, -10.0],
            "bodies": {
                "mass": {
                    "joint": "prismatic",
                    "coordinate": "y",
                    "mass": 0.1,
                    "inertia": 1e-6,
                    "friction": {"threshold_speed": "1e-3 m/s"},
                }
            },
            "springs": {"pin": {"coordinate": "y", "rest_angle": 0.0, "stiffness": 0.0} | spring},
        }
    )


def test_a_pin_with_play_rests_where_its_load_puts_it():
    for clearance, seating in ((5e-5, 0.2), (1e-6, 0.2), (1e-4, 2.0)):
        rest = sliding_mass(clearance=clearance, seating=seating).rest_pose[0]
        assert rest == pytest.approx(-clearance * 1.0 / (1.0 + seating), rel=1e-6)


def test_a_damped_spring_decays_as_its_closed_form():
    action = sliding_mass(stiffness="40 N/m", damping="0.8 N s/m")
    rest = action.rest_pose[0]
    assert rest == pytest.approx(-1.0 / 40.0, rel=1e-9)
    options = _core.SimulationOptions()
    options.duration, options.rtol, options.output_rate = 0.5, 1e-10, 2000.0
    drive = feltmb.table_stroke([0.0, 1.0], [0.0, 0.0]).input
    run = _core.simulate(action.mechanism, drive, options, [rest + 1e-3, 0.0], [])
    decay = 0.5 * 0.8 / 0.1
    omega = np.sqrt(40.0 / 0.1 - decay**2)
    t = run.time
    x = 1e-3 * np.exp(-decay * t) * (np.cos(omega * t) + decay / omega * np.sin(omega * t))
    assert np.max(np.abs(run.states[:, 0] - rest - x)) < 1e-9
    ledger = dict(zip(run.ledger_names, run.ledger.T, strict=True))
    # What the oscillation had at first: the damper takes it.
    lost = ledger["dissipated.joint.y"][-1]
    assert lost == pytest.approx(0.5 * 40.0 * 1e-6, rel=0.03)


def test_jacobian_with_every_option(action):
    values = {"string.modes": 4} | OPTIONS
    check_along(action.with_values(values), feltmb.load_stroke("forte"), count=8, every=12)


def test_ledger_closes_with_every_option(rigid):
    run = feltmb.simulate(rigid.with_values(OPTIONS), "forte", rtol=1e-8, duration=0.3)
    check_ledger(run)
    lost = run.energy["dissipated"]
    plain = feltmb.simulate(rigid, "forte", rtol=1e-8, duration=0.3).energy["dissipated"]
    assert lost["joint.hammer.angle"] > plain["joint.hammer.angle"]
