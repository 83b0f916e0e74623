"""Effects and models whose callables are wrong are told before anything is fitted."""

from dataclasses import replace

import numpy as np
import pytest

from feltmb.data import Record, StartPrior
from feltmb.errors import DataError, InvalidParameter
from feltmb.gap import Coordinate, Effect, OdeNominal, Parameter, State, diagnose, library

ARM = Coordinate(name="arm", position="q", speed="v")


def model(rates=lambda t, x, u, p: (x.v, u.f - p.k * x.q)):
    return OdeNominal(
        name="arm",
        states=[State(name="q", unit="m"), State(name="v", unit="m/s")],
        parameters=[Parameter(name="k", value=400.0, sd=20.0)],
        inputs=["f"],
        rates=rates,
        outputs={"q": "q"},
        coordinates=[ARM],
    )


def records():
    time = np.arange(60) * 5e-3
    f = np.sin(20.0 * time)
    return [Record(name=n, time=time, inputs={"f": f}, outputs={"q": 1e-3 * f}) for n in "ab"]


def never(stage, *_):
    assert stage == "gates", "a fit was begun"


def message(nominal, effects):
    with pytest.raises(InvalidParameter) as caught:
        diagnose(nominal, effects, records(), hold_out="b", progress=never)
    return str(caught.value)


def rate(name, call):
    return Effect(name=name, component="arm", rate=call)


def test_all_faults_of_all_effects_at_once():
    text = message(
        model(),
        [
            library.dry_friction(ARM, scale=0.1, speed=0.1),
            rate("raises", lambda *a: 1 / 0),
            rate("shape", lambda t, x, u, p, size, shape: {"v": np.ones(7)}),
            rate("state", lambda t, x, u, p, size, shape: {"w": size}),
            rate("bare", lambda t, x, u, p, size, shape: size),
            Effect(name="cut", component="q", observe=lambda r, y, w, size, shape: y[:, :3]),
            Effect(name="short", component="f", excite=lambda r, size, shape: {"f": np.ones(3)}),
        ],
    )
    assert "dry friction" not in text
    assert "raises: its rate raises ZeroDivisionError" in text
    assert "shape: rate of v has shape (7,)" in text
    assert "state: rate changes 'w', which is no state; known are q, v" in text
    assert "bare: rate returned ndarray, expected a dictionary" in text
    assert "cut: observe returned shape (3, 3, 1), expected that of the outputs" in text
    assert "short: " in text


def test_a_model_at_fault_is_not_put_on_the_effects():
    dry = library.dry_friction(ARM, scale=0.1, speed=0.1)
    text = message(model(lambda t, x, u, p: (x.v,)), [dry])
    assert text == "model arm: rates returned 1 values, expected one for each state: q, v"
    text = message(model(lambda t, x, u, p: (x.v, x.nope)), [dry])
    assert text == "model arm: AttributeError: no 'nope'; known are q, v"


def test_later_shapes_are_tried_as_well():
    magnet = rate("magnet", lambda t, x, u, p, size, shape: {"v": size / shape["far"]})
    text = message(model(), [replace(magnet, shapes=({"far": 1.0}, None))])
    assert "magnet: its rate raises TypeError" in text


def test_an_effect_that_is_not_the_nominal_at_size_zero_is_told():
    text = message(
        model(),
        [
            library.dry_friction(ARM, scale=0.1, speed=0.1),
            rate("bias", lambda t, x, u, p, size, shape: {"v": size + 0.1}),
            Effect(name="lift", component="q", observe=lambda r, y, w, size, shape: y + 1e-3),
            Effect(name="more", component="f", excite=lambda r, size, s: {"f": r.inputs["f"] + 1}),
            rate("one by one", lambda t, x, u, p, size, shape: {"v": size if x.q > 0 else 0.0}),
        ],
    )
    assert "dry friction" not in text
    assert "bias: at size zero it is not the nominal" in text
    assert "lift: at size zero it is not the nominal" in text
    assert "more: at size zero it changes the input f" in text
    assert "it is called with whole arrays: use np.where" in text


def test_names_that_are_none_are_told_before_the_fit():
    with pytest.raises(InvalidParameter, match="inertia 'M' is no parameter; known are k"):
        OdeNominal(
            name="arm",
            states=[State(name="q"), State(name="v")],
            parameters=[Parameter(name="k", value=1.0)],
            rates=lambda t, x, u, p: (x.v, -p.k * x.q),
            outputs={"q": "q"},
            coordinates=[replace(ARM, inertia="M")],
        )
    late = [replace(r, start=StartPrior(mean={"zz": 1.0}, sd={"q": 0.1})) for r in records()]
    with pytest.raises(DataError, match=r"a: start of zz, no state of the model arm \(q, v\)"):
        diagnose(model(), [], late, hold_out="b")
