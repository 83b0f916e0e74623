"""Laws that candidates of equations have: loads, products, directions, equal joints, signs."""

from dataclasses import replace

import numpy as np
import pytest

from unmodeled import Equations, Record, Sensor, candidates, check, library
from unmodeled.models.coordinates import Named
from unmodeled.models.model import prior_jobs
from unmodeled.models.subject import Scope

TIME = np.linspace(0.0, 4.0, 81)


def record(outputs, **inputs):
    sensors = {n: Sensor(name=n, unit=u, sigma=1e-3) for n, (u, _) in outputs.items()}
    values = {n: v for n, (_, v) in outputs.items()}
    return Record(name="r", time=TIME, inputs=inputs, outputs=values, sensors=sensors)


def servo():
    return Equations(
        lambda t, x, u, p: (
            x.w,
            (np.clip(8.0 * (u.goal - x.q), -1.5, 1.5) - 0.5 * np.sin(x.q) - p.d * x.w)
            / (p.J + 0.01),
        ),
        states={"q": (0.0, 1e-3, "rad"), "w": (0.0, 1e-2, "rad/s")},
        parameters={"J": (0.02, 0.001, "kg m^2"), "d": (0.1, 0.01, "N m s/rad")},
        inputs={"goal": "rad"},
        outputs={"q": "q"},
    )


def moved():
    return record({"q": ("rad", np.sin(2.0 * TIME))}, goal=np.sin(2.0 * TIME))


def rate(effect, size, shape, **at):
    x, u, p = (Named(at.get(k, {})) for k in ("x", "u", "p"))
    return effect.rate(0.0, x, u, p, size, shape)


def test_the_load_of_a_drive_is_what_the_inputs_cause():
    found = {e.name: e for e in candidates(servo(), moved())}
    effect = found["friction by the drive q"]
    at = {"x": {"q": 0.1, "w": 0.4}, "u": {"goal": 0.2}, "p": {"J": 0.02, "d": 0.1}}
    got = rate(effect, 0.3, 0.01, **at)["w"]
    assert got == pytest.approx(-0.3 * (8.0 * 0.1) / 0.03 * np.tanh(0.4 / 0.01))


def test_an_output_with_the_unit_of_a_force_is_a_load():
    torque = (lambda t, x, u, p: 8.0 * (u.goal - x.q), "N m")
    model = Equations(
        lambda t, x, u, p: (x.w, (8.0 * (u.goal - x.q) - p.d * x.w) / p.J),
        states={"q": (0.0, 1e-3, "rad"), "w": (0.0, 1e-2, "rad/s")},
        parameters={"J": (0.02, 0.001, "kg m^2"), "d": (0.1, 0.01, "N m s/rad")},
        inputs={"goal": "rad"},
        outputs={"q": "q", "motor": torque},
    )
    loads = {e.name: e for e in candidates(model, moved()) if e.name.startswith("friction by")}
    assert [*loads] == ["friction by motor q"]
    at = {"x": {"q": 0.1, "w": -0.4}, "u": {"goal": 0.2}, "p": {"J": 0.02, "d": 0.1}}
    got = rate(loads["friction by motor q"], 0.3, 0.01, **at)["w"]
    assert got == pytest.approx(0.3 * 0.8 / 0.02)


def test_friction_of_each_direction_is_one_law():
    """By default dry and one-sided friction are two causes: beside them it would tell nothing."""
    assert not [e for e in candidates(servo(), moved()) if "each direction" in e.name]
    effect = library.dry_friction_each_way(servo().coordinates[0], scale=1.0, speed=1.0)
    at = {"u": {"goal": 0.0}, "p": {"J": 0.02, "d": 0.1}}
    ways = [
        rate(effect, 2.0, (side, 0.25, 0.01), x={"q": 0.0, "w": w}, **at)["w"]
        for side in (1.0, -1.0)
        for w in (0.5, -0.5)
    ]
    assert ways == pytest.approx([-2.0, 0.5, -0.5, 2.0])


def two():
    return Equations(
        lambda t, x, u, p: (x.v, x.w, (u.F - p.k * x.q) / p.m, (u.F - p.k * x.s) / p.n),
        states={
            "q": (0.0, 1e-3, "m"),
            "s": (0.0, 1e-3, "m"),
            "v": (0.0, 1e-3, "m/s"),
            "w": (0.0, 1e-3, "m/s"),
        },
        parameters={"k": (4.0, 0.1, "N/m"), "m": (1.0, 0.1, "kg"), "n": (2.0, 0.1, "kg")},
        inputs={"F": "N"},
        outputs={"q": "q", "s": "s"},
    )


def test_one_friction_of_all_coordinates_acts_on_each():
    seen = record({n: ("m", np.sin(TIME)) for n in ("q", "s")}, F=np.sin(TIME))
    found = {e.name: e for e in candidates(two(), seen)}
    effect = found["dry friction of all coordinates"]
    assert effect.about.scope.channels == ("q", "s")
    at = {"x": {"q": 0.0, "s": 0.0, "v": 1.0, "w": -1.0}, "u": {"F": 0.0}}
    got = rate(effect, 0.5, 0.01, p={"k": 4.0, "m": 1.0, "n": 2.0}, **at)
    assert got == pytest.approx({"v": -0.5, "w": 0.25})


def test_a_product_of_two_states_is_a_candidate_where_the_model_has_none():
    model = Equations(
        lambda t, x, u, p: (p.b * x.prey, p.g * x.prey * x.hunters - p.d * x.hunters),
        states={"prey": (1.0, 0.1, "1"), "hunters": (0.5, 0.1, "1")},
        parameters={"b": (0.2, 0.02, "1/s"), "g": (0.5, 0.02, "1/s"), "d": (0.4, 0.02, "1/s")},
        outputs={"prey": "prey", "hunters": "hunters"},
    )
    seen = record({n: ("1", 1.0 + 0.1 * np.sin(TIME)) for n in ("prey", "hunters")})
    found = {e.name: e for e in candidates(model, seen)}
    assert "loss ~ prey hunters prey" in found
    assert "loss ~ hunters prey hunters" not in found
    got = rate(found["loss ~ prey hunters prey"], 0.5, None, x={"prey": 2.0, "hunters": 3.0})
    assert got == pytest.approx({"prey": -3.0})


def meter(shown):
    model = Equations(
        lambda t, x, u, p: ((p.K * u.u - x.q) / p.T,),
        states={"q": (0.0, 1e-3, "1")},
        parameters={"K": (1.0, 0.03, "1"), "T": (0.2, 0.02, "s")},
        inputs={"u": "1"},
        outputs={"q": "q"},
    )
    seen = record({"q": ("1", 0.0 * TIME)}, u=np.sin(3.0 * TIME))
    path = model.simulate(seen, prior_jobs(model, seen))[0, :, 0]
    return model, replace(seen, outputs={"q": shown(path)})


def test_a_lost_sign_is_told_and_a_candidate():
    model, seen = meter(np.abs)
    (hint,) = check(model, seen).hints
    assert (hint.kind, hint.channels, hint.sure) == ("absolute", ("q",), False)
    assert "absolute value of sensor q" in {e.name for e in candidates(model, seen)}


def test_a_signal_with_both_signs_has_not_lost_its_sign():
    model, seen = meter(lambda y: 1.02 * y)
    assert not check(model, seen).hints
    assert "absolute value of sensor q" not in {e.name for e in candidates(model, seen)}


def test_a_cause_of_some_records_tells_what_to_repeat():
    scope = Scope(records=("b",))
    assert scope.repeat(("a", "b", "c")).startswith("repeat b with the input of a")
    assert scope.repeat(("b",)) == ""
    assert Scope().repeat(("a", "b")) == ""
