"""Effects and models whose callables are wrong are told before anything is fitted."""

import math
from dataclasses import replace

import numpy as np
import pytest

from feltmb.data import Record, StartPrior
from feltmb.errors import DataError, InvalidParameter
from feltmb.gap import (
    Coordinate,
    Effect,
    LinearModel,
    OdeModel,
    Options,
    Parameter,
    State,
    diagnose,
    fit_model,
    library,
    plan,
)

ARM = Coordinate(name="arm", position="q", speed="v")


def model(rates=lambda t, x, u, p: (x.v, u.f - p.k * x.q)):
    return OdeModel(
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
    return [
        Record(name=n, time=time, inputs={"f": size * f}, outputs={"q": 1e-3 * size * f})
        for n, size in (("a", 1.0), ("b", 2.0))
    ]


def never(told):
    assert told.stage == "checks of the data", "a fit was begun"


def message(model, effects):
    with pytest.raises(InvalidParameter) as caught:
        diagnose(model, effects, records(), hold_out="b", progress=never)
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
    said = "model arm: its rates function raises AttributeError: no 'nope'; known are q, v"
    assert text == f"{said} (line 89 of test_smoke_test.py)"
    text = message(model(lambda t, x, u, p: (x.v, np.zeros(7))), [dry])
    assert text.startswith("model arm: rate of v has shape (7,), expected a number or one value a")
    # All that use the model say the same.
    faulty, planned = model(lambda t, x, u, p: (x.v, x.nope)), records()
    for use in (fit_model, lambda model, records: plan(model, [dry], records)):
        with pytest.raises(InvalidParameter) as error:
            use(faulty, planned)
        assert str(error.value) == f"{said} (line 95 of test_smoke_test.py)"


def test_a_model_that_gives_no_numbers_is_told():
    text = message(model(lambda t, x, u, p: (x.v + np.nan, -x.q)), [])
    assert "at the beginning of record" in text


def test_what_fails_for_some_parameters_should_be_nan():
    text = message(model(lambda t, x, u, p: (x.v, math.sqrt(-1.0))), [])
    assert "raises ValueError" in text
    assert "return NaN for undefined values" in text


def test_what_a_callable_may_not_do_is_told():
    nothing = rate("nothing", lambda t, x, u, p, size, shape: {"v": np.where(size == 0, 0, np.nan)})
    other = Effect(name="other", component="f", excite=lambda r, size, s: {"g": r.inputs["f"]})
    text = message(model(), [nothing, other])
    assert "nothing: at magnitude 1 the outputs of the model are not finite" in text
    assert "other: its excite changes 'g', which is no input of the record; known are f" in text
    alike = replace(nothing, name="alike", hidden=(State(name="q", hidden=True),))
    assert "its hidden state 'q' has the name of a state of model arm" in message(model(), [alike])


def test_a_sensor_effect_may_change_its_outputs_in_place():
    seen = []
    for law in (
        lambda r, y, w, size, shape: np.add(y, size[:, None, None], out=y),
        lambda r, y, w, size, shape: y + size[:, None, None],
    ):
        effect = Effect(name="lift", component="q", scale=0.1, kind="sensor", observe=law)
        report = diagnose(model(), [effect], records(), options=Options(bootstrap=0))
        seen.append(report.which.effects[0].magnitude)
    assert seen[0] == seen[1]


def test_later_shapes_are_tried_as_well():
    magnet = rate("magnet", lambda t, x, u, p, size, shape: {"v": size / shape["far"]})
    text = message(model(), [replace(magnet, shapes=({"far": 1.0}, None))])
    assert "magnet: its rate raises TypeError" in text


def test_an_effect_that_is_not_the_model_at_size_zero_is_told():
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
    assert "bias: at magnitude zero it changes the model" in text
    assert "lift: at magnitude zero it changes the model" in text
    assert "more: at magnitude zero it changes the input f" in text
    assert "it is called with whole arrays: use np.where" in text


def test_a_regressor_that_raises_is_told_with_its_effect():
    line = LinearModel(output="q", columns={"k": lambda r: r.inputs["f"]},
                       parameters=[Parameter(name="k", value=1.0, sd=0.5)])  # fmt: skip
    wrong = Effect(name="square", component="q", regressor=lambda r, shape: r.inputs["nix"] ** 2)
    text = message(line, [wrong])
    assert "square: its regressor raises KeyError: 'nix'" in text


def test_names_that_are_none_are_told_before_the_fit():
    with pytest.raises(InvalidParameter, match="inertia 'M' is no parameter; known are k"):
        OdeModel(
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
