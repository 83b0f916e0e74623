"""A simulator of one's own: a function of whole records, asked as a black box."""

import importlib.util
import math
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from unmodeled import (
    Effect,
    Exposed,
    Parameter,
    Record,
    Sensor,
    Simulator,
    Verdict,
    diagnose,
    fit_model,
    library,
)
from unmodeled.errors import InvalidParameter
from unmodeled.fit import SensitivityRequest
from unmodeled.fit.simulator import choose_step, noise_of_function
from unmodeled.models import Candidate, Jobs
from unmodeled.models.model import difference_offsets

ROOT = Path(__file__).resolve().parents[3]
TIME = np.arange(400) * 5e-3


def decay(time, inputs, parameters):
    """First-order answer to a step, with a drift that the model lacks."""
    p = parameters
    rise = 1.0 - np.exp(-time / p["tau"])
    return {"y": p["gain"] * inputs["u"] * rise + p["drift"] * time}


def model(function=decay, **fields):
    fields = {
        "name": "lag",
        "parameters": [
            Parameter(name="gain", value=2.0, sd=0.2, lower=0.1),
            Parameter(name="tau", value=0.4, sd=0.05, unit="s", lower=0.01),
        ],
        "inputs": ["u"],
        "outputs": {"y": "m"},
        "unknown": {"drift": Exposed(scale=0.1, unit="m/s", component="floor", sign=1)},
        **fields,
    }
    return Simulator(function, **fields)


def record(name="r", level=1.0, drift=0.0, seed=0, role="fit"):
    inputs = {"u": np.full(TIME.size, level)}
    clean = decay(TIME, inputs, {"gain": 2.1, "tau": 0.38, "drift": drift})["y"]
    noise = 1e-3 * np.random.default_rng(seed).standard_normal(TIME.size)
    return Record(
        name=name,
        time=TIME,
        inputs=inputs,
        outputs={"y": clean + noise},
        sensors={"y": Sensor(name="y", unit="m", sigma=1e-3)},
        role=role,
    )


def records(drift):
    return [
        record("low", 0.5, drift, 1),
        record("high", 1.0, drift, 2),
        record("proof", 0.8, drift, 3, "held_out"),
    ]


def columns(m, r, *candidates):
    request = SensitivityRequest(r, np.array([2.0, 0.4]), np.zeros(0), candidates=candidates)
    return m.sensitivities([request])[0]


def jobs_at(*theta, included=(), magnitudes=()):
    rows = np.array(theta)
    return Jobs(
        theta=rows,
        starts=np.zeros((len(rows), 0)),
        included=included,
        magnitudes=np.tile(magnitudes, (len(rows), 1)),
    )


def test_equal_runs_are_computed_once():
    m, r, jobs = model(), record(), jobs_at([2.0, 0.4], [2.0, 0.4])
    whole = decay(TIME, r.inputs, {"gain": 2.0, "tau": 0.4, "drift": 0.0})["y"]
    for run in m.simulate(r, jobs):
        np.testing.assert_array_equal(run[:, 0], whole)
    assert m.simulations == 1
    m.simulate(r, jobs)
    assert m.simulations == 1  # kept by its content
    m.simulate(record("the same run by another name"), jobs)
    assert m.simulations == 1
    m.simulate(record(level=0.5), jobs)
    assert m.simulations == 2


def test_derivatives_are_those_of_the_function():
    m, r = model().ready([record()]).model, record()
    s = columns(m, r, Candidate(m.effects[0]))
    rise = 1.0 - np.exp(-TIME / 0.4)
    by_tau = -2.0 * np.exp(-TIME / 0.4) * TIME / 0.4**2
    for c, wanted in ((s.d_theta[..., 0], rise), (s.d_theta[..., 1], by_tau)):
        np.testing.assert_allclose(c[:, 0], wanted, atol=0.02 * np.max(np.abs(wanted)))
    np.testing.assert_allclose(s.d_candidates[:, 0, 0], TIME, rtol=1e-6, atol=1e-12)


def test_steps_grow_with_the_noise_of_the_function():
    def rough(time, inputs, parameters):
        y = decay(time, inputs, parameters)["y"]
        return {"y": y + 1e-4 * np.sin(1e9 * y)}  # repeatable, but not smooth

    far = []
    for function in (decay, rough):
        seen = []

        def watched(time, inputs, parameters, function=function, seen=seen):
            seen.append(parameters["tau"])
            return function(time, inputs, parameters)

        m = model(watched, workers=1).ready([record()]).model
        seen.clear()
        s = columns(m, record())
        far.append(max(abs(tau - 0.4) for tau in seen))
    assert far[1] > 10.0 * far[0]
    rise = 1.0 - np.exp(-TIME / 0.4)
    np.testing.assert_allclose(s.d_theta[:, 0, 0], rise, atol=0.03)


def test_noise_is_found_under_a_trend():
    generator = np.random.default_rng(3)
    along = np.arange(7)[:, None] * 1e-3
    smooth = np.sin(along + np.linspace(0.0, 6.0, 300))
    noisy = smooth + 1e-6 * generator.standard_normal(smooth.shape)
    assert noise_of_function(noisy) == pytest.approx(1e-6, rel=0.2)
    assert noise_of_function(smooth) < 1e-14


def test_a_bent_function_with_noise_is_differentiated_from_both_sides():
    def f(x):
        return np.exp(20.0 * np.array([x, x]))

    step = choose_step(f(0.0), f(0.1), f(-0.1), 0.1, 1e-2, 1.0, True)
    assert step.central
    straight = choose_step(*(np.array([x, x]) for x in (0.0, 0.1, -0.1)), 0.1, 1e-9, 1.0, True)
    assert not straight.central


def test_a_forward_step_has_the_smallest_error():
    """2 sqrt(noise / f''), whatever the step of the trials."""
    for h in (0.1, 0.02):
        values = (np.full(2, x + x**2) for x in (0.0, h, 2.0 * h))
        step = choose_step(*values, h, 2e-10, 1.0, False)
        assert not step.central
        assert step.size == pytest.approx(2.0 * math.sqrt(2e-10 / 2.0), rel=1e-6)


def test_at_a_limit_the_step_goes_to_the_free_side():
    seen = []

    def f(time, inputs, parameters):
        seen.append(parameters["gain"])
        return decay(time, inputs, parameters)

    gain = Parameter(name="gain", value=2.0, sd=0.2, upper=2.0)
    tau = Parameter(name="tau", value=0.4, sd=0.0)
    m = model(f, parameters=[gain, tau], workers=1).ready([record()]).model
    columns(m, record())
    assert max(seen) <= 2.0 < max(seen) + 0.1


@pytest.mark.parametrize("platform", ["linux", "darwin"])
def test_processes_give_what_one_process_gives(platform, monkeypatch):
    # A spawned process finds this module where its parent does.
    monkeypatch.syspath_prepend(ROOT)
    if platform == "linux" and sys.platform != "linux":
        pytest.skip("forks")
    monkeypatch.setattr("unmodeled.fit.running.sys.platform", platform)
    jobs = jobs_at([2.0, 0.4], [2.1, 0.4], [2.0, 0.5])
    one = model(workers=1).ready([record()]).model
    two = model(math_function, workers=2).ready([record()]).model
    np.testing.assert_array_equal(two.simulate(record(), jobs), one.simulate(record(), jobs))
    assert two.simulations == one.simulations


def math_function(time, inputs, parameters):
    return decay(time, inputs, parameters)


def test_what_cannot_be_pickled_runs_in_one_process_and_says_so(monkeypatch):
    monkeypatch.setattr("unmodeled.fit.running.sys.platform", "darwin")
    ready = model(lambda t, u, p: decay(t, u, p), workers=2).ready([record()])
    assert any("cannot be pickled" in n for n in ready.notes)
    assert np.all(np.isfinite(ready.model.simulate(record(), jobs_at([2.0, 0.4], [2.1, 0.4]))))


def broken(change):
    def f(time, inputs, parameters):
        return change(decay(time, inputs, parameters), parameters)

    return f


def nan_late(y, _):
    y["y"][30:] = math.nan
    return y


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda y, p: {"y": y["y"][:-1]}, r"output y has shape \(399,\), expected .* \(400,\)"),
        (lambda y, p: {"z": y["y"]}, "returned no output y; there is z"),
        (lambda y, p: y["y"], "returned ndarray, expected a dictionary"),
        (lambda y, p: {"y": ["a"] * 400}, "output y holds no numbers"),
        (lambda y, p: p["mass"], "raises KeyError: 'mass'"),
        (nan_late, r"returns nan for y at t = 0.15 s, sample 30"),
    ],
)
@pytest.mark.parametrize("workers", [1, 2])
def test_a_bad_function_is_one_message_with_record_time_and_parameters(change, told, workers):
    with pytest.raises(InvalidParameter, match=told) as caught:
        fit_model(model(broken(change), workers=workers), [record("first run")])
    text = str(caught.value)
    assert text.startswith("model lag: its ")
    assert "record first run, 400 samples from 0 to 1.995 s; parameters gain = 2, tau = 0.4" in text


@pytest.mark.parametrize("silent", [False, True])
def test_a_trial_far_off_may_fail(silent):
    def fragile(time, inputs, parameters):
        found = decay(time, inputs, parameters)
        if parameters["tau"] < 0.37:
            if not silent:
                raise RuntimeError("solver gave up")
            found["y"][7] = np.nan
        return found

    fault = "returns nan for y at t = 0.035 s" if silent else "raises RuntimeError: solver gave up"
    with pytest.warns(RuntimeWarning, match=f"{fault}.*tau = 0") as told:
        report = fit_model(
            model(fragile, parameters=[*model().parameters[:1], TAU_FAR]),
            [record(), record("b", 2.0)],
        )
    assert len(told) == 1
    assert report.worst.explained == pytest.approx(1e-3, rel=0.1)


TAU_FAR = Parameter(name="tau", value=0.9, sd=0.5, unit="s", lower=0.01)


def test_faults_of_the_description_are_told_together():
    with pytest.raises(InvalidParameter, match="'gain' is used twice; workers = 0"):
        model(unknown={"gain": Exposed(scale=1.0)}, workers=0)
    with pytest.raises(InvalidParameter, match="model lag needs the input u"):
        model().ready([Record(name="r", time=TIME, inputs={}, outputs={"y": TIME})])


def test_an_effect_may_act_on_any_parameter():
    shift = Effect(name="slow valve", component="valve", unit="s", scale=0.1, data="tau")
    m = model(unknown={"drift": Effect(name="drift of floor", component="floor", scale=0.1)})
    assert m.accepts(shift)
    assert not m.accepts(Effect(name="x", component="y", data="unknown"))
    r, both = record(), (Candidate(shift), Candidate(m.effects[0]))
    jobs = jobs_at([2.0, 0.4], included=both, magnitudes=[0.05, 0.2])
    wanted = decay(TIME, r.inputs, {"gain": 2.0, "tau": 0.4 + 0.05, "drift": 0.2})["y"]
    np.testing.assert_allclose(m.simulate(r, jobs)[0, :, 0], wanted)


@pytest.mark.slow
def test_a_neutral_value_need_not_be_zero():
    def f(time, inputs, parameters):
        return decay(time, inputs, {**parameters, "drift": parameters["slope"] - 1.0})

    m = model(f, unknown={"slope": Exposed(scale=0.1, neutral=1.0, sign=1, upper=3.0)})
    assert m.effects[0].bounds == (0.0, 2.0)
    report = diagnose(m, m.effects, records(0.05))
    (named,) = report.named
    assert named.cause == "slope"
    assert named.magnitude == pytest.approx(0.05, rel=0.03)


@pytest.mark.slow
def test_without_the_cause_nothing_is_named():
    m = model()
    report = diagnose(m, [*m.effects, *library.for_sensor(m.outputs, "y", record())], records(0.0))
    assert report.verdict in (Verdict.NO_GAP, Verdict.CALIBRATED)


def test_a_function_that_draws_lots_is_told():
    generator = np.random.default_rng(0)

    def f(time, inputs, parameters):
        y = decay(time, inputs, parameters)["y"]
        return {"y": y + 1e-5 * generator.standard_normal(y.size)}

    notes = model(f, workers=1).ready([record()]).notes
    assert any("two runs with the same arguments differ" in n for n in notes)


def test_a_parameter_without_influence_is_told():
    m = model(
        unknown={"drifft": Exposed(scale=0.1)},
        function=lambda t, u, p: decay(t, u, {**p, "drift": 0.0}),
    )
    assert any("drifft changes no output" in n for n in m.ready([record()]).notes)


def test_nothing_is_warned_of_where_nothing_fails():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fit_model(model(workers=2), [record()])


@pytest.mark.slow
def test_the_page_names_the_friction_with_its_size():
    """Within 3 %, in a bounded number of simulations; the values are those of the page."""
    spec = importlib.util.spec_from_file_location("docs_pages", ROOT / "tools" / "docs_pages.py")
    tool = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = tool
    spec.loader.exec_module(tool)
    page = ROOT / "docs" / "howto" / "diagnose_your_own_simulator.md"
    scope = {"__name__": "page"}
    for block in tool.blocks(page):
        if block.kind == "python" and "not run" not in block.notes:
            exec("\n".join(block.text), scope)
    report = scope["report"]
    (named,) = report.named
    assert named.cause == "dry_friction"
    assert named.magnitude == pytest.approx(scope["truth"]["dry_friction"], rel=0.03)
    assert report.worst.explained < 0.01 * report.worst.tabulated
    assert scope["model"].simulations < 1500


def ring(time, inputs, parameters):
    """An oscillation of many periods: another frequency is another local minimum of a plain fit."""
    w = parameters["rate"] * inputs["u"]
    return {"y": np.exp(-0.3 * time) * np.sin(w * time) + parameters["offset"]}


def test_a_fit_finds_a_frequency_that_is_half_a_period_off_at_the_end():
    time = np.arange(600) * 5e-3

    def measured(name, u, seed):
        inputs = {"u": np.full(time.size, u)}
        clean = ring(time, inputs, {"rate": 28.0, "offset": 0.0})["y"]
        noise = 1e-2 * np.random.default_rng(seed).standard_normal(time.size)
        sensors = {"y": Sensor(name="y", sigma=1e-2)}
        return Record(
            name=name, time=time, inputs=inputs, outputs={"y": clean + noise}, sensors=sensors
        )

    parameters = [
        Parameter(name="rate", value=27.0, sd=1.0),
        Parameter(name="offset", value=0.0, sd=0.1),
    ]
    m = Simulator(ring, parameters=parameters, inputs=["u"], outputs=["y"], workers=1)
    report = fit_model(m, [measured("a", 1.0, 1), measured("b", 1.3, 2)])
    assert report.worst.explained == pytest.approx(1e-2, rel=0.1)
    assert report.parameters[0].value == pytest.approx(28.0, abs=0.05)
    assert m.simulations < 200


def test_the_noise_of_a_function_is_told_where_it_matters():
    """One of the last digits has no effect on a result."""
    assert not any("numerical noise" in n for n in model().ready([record()]).notes)

    def steady(time, inputs, parameters):  # the mean of equal numbers is rounded
        p = parameters
        return {"y": np.full(len(time), 0.1 + p["tau"] / 3.0), "z": np.full(len(time), p["gain"])}

    constant = replace(record(), outputs={n: np.ones(TIME.size) for n in "yz"}, sensors={})
    ready = model(steady, outputs={"y": "m", "z": "m"}).ready([constant])
    assert "numerical noise is 2e-16 of" in ready.notes[0]

    def rounded(time, inputs, parameters):
        return {"y": np.round(decay(time, inputs, parameters)["y"], 4)}

    (note,) = [n for n in model(rounded).ready([record()]).notes if "spread of its outputs" in n]
    assert "of 3 parameters" in note
    assert "others" not in note


@pytest.mark.parametrize(
    ("at", "low", "high", "changes"),
    [
        (0.0, -1.0, 1.0, [0.5, -0.5]),
        (1.0, 0.0, 1.5, [0.5, -0.5]),
        (1.2, 0.0, 1.5, [-0.5, -1.0]),
        (0.2, 0.0, 1.5, [0.5, 1.0]),
        (0.2, 0.0, 1.2, [0.5, 1.0]),
    ],
)
def test_differences_of_second_order_stay_within_limits(at, low, high, changes):
    found = difference_offsets(at, 0.5, low, high)
    assert [c for c, _ in found] == changes
    assert all(low <= at + c <= high for c in changes)
    slope = sum(w * ((at + c) ** 2 - at**2) for c, w in found)
    assert slope == pytest.approx(2.0 * at)  # exact for a parabola
