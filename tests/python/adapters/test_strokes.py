"""Whole strokes as a model: derivatives, run-to-run variability, configurations in a row."""

import numpy as np
import pytest

import feltmb
from feltmb.adapters import load_library, mechanism_model
from feltmb.adapters.refined import KINDS, refined
from feltmb.adapters.resolve import resolve
from feltmb.adapters.shifter import Shifter
from feltmb.adapters.variants import changed_config
from feltmb.data import Record, Sensor
from feltmb.errors import InvalidParameter
from feltmb.fit import Candidate, Jobs, SensitivityRequest
from feltmb.fit.observe import observe_jobs, observed_sensitivities

LENGTH = 0.085  # up to shortly before the impact


@pytest.fixture(scope="module")
def adapter():
    action = feltmb.load_action("steinway45")
    tolerances = ["let_off_button", "capstan_height", "mass.head", "felt.03", "joint_friction.butt"]
    library = load_library(action)
    model, effects = mechanism_model(
        action,
        channels=["key", "whippen", "hammer"],
        library=library,
        tolerances=tolerances,
        effects=[
            "coulomb_friction.butt",
            "viscous_friction.butt",
            "pivot_clearance.whippen",
            "camera_skew",
            "input_delay",
        ],
        rtol=1e-7,
        workers=1,
    )
    time = np.arange(0.0, LENGTH, 5e-4)
    stroke = feltmb.load_stroke("forte")
    record = Record(
        name="forte",
        time=time,
        inputs={"force": stroke.at(time)},
        outputs={o: np.zeros(time.size) for o in model.outputs},
        sensors={o: Sensor(name=o, unit="m", sigma=2e-5) for o in model.outputs},
        input_sigma={"force": 0.01},
    )
    return model, effects, record


def whole(record):
    return np.array([[0, record.samples - 1]], dtype=np.intp)


def test_a_row_of_configurations_is_that_of_single_ones():
    action = feltmb.load_action("steinway45")
    library = load_library(action)
    rng = np.random.default_rng(1)
    shifter = Shifter(action.config)
    theta = np.zeros(len(library.tolerances))
    for turn in range(12):
        theta[rng.integers(theta.size, size=3)] = rng.standard_normal(3)
        if turn == 8:
            theta[:] = 0.0
        entries = [
            (e, v * e.magnitude, None) for e, v in zip(library.tolerances, theta, strict=True)
        ]
        extra = library.effects[int(rng.integers(len(library.effects)))]
        entries.append((extra, 0.3 * extra.magnitude, extra.shapes[0]))
        ours = shifter.config(entries, {}).model_dump(mode="json")
        assert_close(ours, changed_config(action.config, entries, {}).model_dump(mode="json"))
    zero = [(e, 0.0, None) for e in library.tolerances]
    assert shifter.config(zero, {}) is action.config


def assert_close(a, b):
    if isinstance(a, dict):
        assert a.keys() == b.keys()
        for k in a:
            assert_close(a[k], b[k])
    elif isinstance(a, list):
        assert len(a) == len(b)
        for x, y in zip(a, b, strict=True):
            assert_close(x, y)
    elif isinstance(a, float):
        assert a == pytest.approx(b, rel=1e-13)
    else:
        assert a == b


def test_one_pass_a_point_and_only_what_is_missing_later(adapter):
    model, effects, record = adapter
    candidates = tuple(Candidate(e, s) for e in effects for s in e.shapes)
    theta = np.zeros(len(model.parameters))
    none = np.zeros((1, 0))
    model.forget()
    before = model.derivatives.passes
    s = model.sensitivities([SensitivityRequest(record, theta, whole(record), none)])[0]
    assert model.derivatives.passes == before + 1
    again = model.sensitivities(
        [SensitivityRequest(record, theta, whole(record), none, candidates=candidates)]
    )[0]
    assert model.derivatives.passes == before + 2  # the candidates
    assert np.array_equal(again.d_theta, s.d_theta)
    model.sensitivities(
        [SensitivityRequest(record, theta, whole(record), none, candidates=candidates)]
    )[0]
    assert model.derivatives.passes == before + 2
    model.sensitivities([SensitivityRequest(record, theta + 1e-9, whole(record), none)])[0]
    assert model.derivatives.passes == before + 3
    model.forget()
    model.sensitivities([SensitivityRequest(record, theta, whole(record), none)])[0]
    assert model.derivatives.passes == before + 4


def test_an_effect_that_is_a_tolerance_has_its_column(adapter):
    """What is not linear in either must not look like a trace that only the effect has."""
    model, _, record = adapter
    from feltmb.adapters.effects import effect_of

    entry = model.library.effect("capstan_height")
    assert model.simulator.alias(entry) is not None
    effect = effect_of(entry, model.outputs, model.library.channels)
    s = model.sensitivities([SensitivityRequest(
            record, np.zeros(len(model.parameters)), whole(record), np.zeros((1, 0)),
            candidates=(Candidate(effect),),
        )])[0]  # fmt: skip
    place = [p.name for p in model.parameters].index("capstan_height")
    ours, theirs = s.d_candidates[0, ..., 0], s.d_theta[0, ..., place]
    assert np.abs(theirs).max() > 0.0
    assert np.array_equal(ours, theirs)


def test_a_camera_that_lags_and_a_force_sensor_that_leads_show_the_same(adapter):
    """Their traces mirror each other, wherever the record is cut into segments of output."""
    model, effects, record = adapter
    segments = np.array([[0, 110], [110, 140], [140, record.samples - 1]], dtype=np.intp)
    camera, force = (
        next(e for e in effects if e.name == n) for n in ("camera_skew", "input_delay")
    )
    theta, states = np.zeros(len(model.parameters)), np.zeros((3, 0))

    def shown(effect, size):
        included = (Candidate(effect),)
        jobs = Jobs.at_point(theta, segments, states, included, np.array([size]))
        outputs = observe_jobs(model, record, jobs).outputs
        parts = zip(outputs, segments[:, 1] - segments[:, 0] + 1, strict=True)
        return np.concatenate([y[:length] for y, length in parts])

    still, lag, lead = shown(camera, 0.0), shown(camera, 6e-4), shown(force, -6e-4)
    assert np.max(np.abs(still - lag)) > 1e-3
    assert np.max(np.abs(lead - lag)) < 4e-6  # a fifth of the noise of a camera


def test_the_variability_is_linear_and_belongs_to_its_record(adapter):
    model, _, record = adapter
    with_variability = model.with_variability([record], 0.01)
    extra = len(with_variability.parameters) - len(model.parameters)
    assert extra == with_variability.variabilities["forte"].columns.shape[2] >= 2
    assert all(p.sd == 1.0 and p.name.startswith("variability.forte.") for p in
               with_variability.parameters[-extra:])  # fmt: skip
    none = np.zeros((1, 0))
    theta = np.zeros(len(with_variability.parameters))
    s = with_variability.sensitivities([SensitivityRequest(record, theta, whole(record), none)])[0]
    moved = theta.copy()
    moved[-extra:] = np.linspace(-1.0, 2.0, extra)
    y = with_variability.simulate(
        record, Jobs.at_point(moved, whole(record), none, (), np.zeros(0))
    )
    expected = s.outputs[0] + s.d_theta[0, ..., -extra:] @ moved[-extra:]
    assert np.allclose(y.outputs[0], expected, rtol=0.0, atol=1e-15)
    other = Record(
        name="other", time=record.time, inputs=record.inputs, outputs=record.outputs
    )  # fmt: skip
    y = with_variability.simulate(other, Jobs.at_point(moved, whole(record), none, (), np.zeros(0)))
    assert np.array_equal(y.outputs[0], s.outputs[0])


def test_the_variability_holds_the_noise_of_the_input(adapter):
    """Replays with noisy input depart as much as run-to-run variability says."""
    model, _, record = adapter
    variability = model.with_variability([record], 0.0).variabilities["forte"].columns / 2e-5
    assert variability.shape[2] >= 1
    rng = np.random.default_rng(3)
    none, theta = np.zeros((1, 0)), np.zeros(len(model.parameters))
    jobs = Jobs.at_point(theta, whole(record), none, (), np.zeros(0))
    base = model.simulate(record, jobs).outputs[0]
    magnitudes = []
    for _ in range(12):
        noisy = record.inputs["force"] + 0.01 * rng.standard_normal(record.samples)
        y = model.simulate(record.with_inputs({"force": noisy}), jobs).outputs[0]
        magnitudes.append(np.sum(((y - base) / 2e-5) ** 2))
    assert np.mean(magnitudes) == pytest.approx(np.sum(variability**2), rel=0.8)


def test_the_variability_at_other_parameters_is_that_of_the_motion_there(adapter):
    """The motion of a mechanism with more beam shapes, at parameters far from the tabulated ones.

    The difference to the motion of the model is one direction of the variability. It is computed
    here by another model.
    """
    model, _, record = adapter
    time = np.arange(0.0, 0.105, 5e-4)  # the impact is later at these parameters
    stroke = feltmb.load_stroke("forte")
    record = Record(
        name="forte", time=time, inputs={"force": stroke.at(time)}, sensors=record.sensors,
        outputs={o: np.zeros(time.size) for o in model.outputs},
    )  # fmt: skip
    theta = 3.0 * np.array([p.sd for p in model.parameters])
    tabulated = model.with_variability([record], 0.0)
    there = tabulated.with_variability_at(
        np.append(theta, np.ones(len(tabulated.parameters) - theta.size)), (), np.zeros(0)
    )
    assert there.parameters == tabulated.parameters
    library = load_library(model.action)
    resolved, _ = mechanism_model(
        refined(model.action, ("shapes",)), channels=["key", "whippen", "hammer"], library=library,
        tolerances=[p.name for p in model.parameters], effects=[],
        rtol=1e-7, workers=1,
    )  # fmt: skip
    jobs = Jobs.at_point(theta, whole(record), np.zeros((1, 0)), (), np.zeros(0))
    difference = (resolved.simulate(record, jobs).outputs - model.simulate(record, jobs).outputs)[0]

    def left(seen):
        columns = seen.variabilities["forte"].columns.reshape(difference.size, -1)
        found = np.linalg.lstsq(columns, difference.ravel(), rcond=None)[0]
        return np.linalg.norm(difference.ravel() - columns @ found) / np.linalg.norm(difference)

    assert left(there) < 1e-6
    assert left(tabulated) > 0.1


def test_refined_changes_what_it_says():
    action = feltmb.load_action("steinway45")
    fine = refined(action).config
    assert fine.string.modes == min(2 * action.config.string.modes, 200)
    assert fine.bodies["shank"].lateral_shapes == action.config.bodies["shank"].lateral_shapes + 1
    rate = action.config.contacts["04"].friction.threshold_speed
    assert fine.contacts["04"].friction.threshold_speed == pytest.approx(rate / 3.0)
    assert {k for k in KINDS if refined(action, (k,)) is not action} == set(KINDS)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"variation": "many"}, "a share from 0 to 0.5, or none"),
        ({"variation": "0.9"}, "got '0.9'"),
    ],
)
def test_faults_of_the_variability(settings, message):
    with pytest.raises(InvalidParameter, match=message):
        resolve("steinway45", settings)


def test_derivatives_by_the_input_are_exact_and_in_the_same_pass(adapter, monkeypatch):
    """Delay of the input, and noise at one knot, against differences of tight runs."""
    monkeypatch.setattr("feltmb.adapters.forward.TOLERANCE", 1e-5)
    rough, effects, record = adapter
    model, _ = mechanism_model(
        rough.action, channels=["key", "whippen", "hammer"], library=rough.library,
        tolerances=["felt.03"], effects=["input_delay"], rtol=1e-10, workers=1,
    )  # fmt: skip
    delay = Candidate(next(e for e in effects if e.name == "input_delay"))
    hat = np.maximum(0.0, 1.0 - np.abs(record.time - 0.03) / 0.008)
    at, none = np.zeros(1), np.zeros((1, 0))
    request = SensitivityRequest(
        record, at, whole(record), none, candidates=(delay,), input_changes=({"force": 0.1 * hat},)
    )
    before = model.derivatives.passes
    s = observed_sensitivities(model, [request])[0]
    assert model.derivatives.passes == before + 1
    included = observed_sensitivities(
        model, [SensitivityRequest(record, at, whole(record), none, (delay,), np.array([1e-3]))]
    )[0]

    def late(size):
        jobs = Jobs.at_point(at, whole(record), none, (delay,), np.array([size]))
        return observe_jobs(model, record, jobs).outputs

    def pushed(size):
        changed = record.with_inputs({"force": record.inputs["force"] + size * hat})
        return model.simulate(
            changed, Jobs.at_point(at, whole(record), none, (), np.zeros(0))
        ).outputs

    for found, run, place, step, scale in (
        (s.d_candidates, late, 0.0, 1e-5, 1.0),
        (included.d_magnitudes, late, 1e-3, 1e-5, 1.0),
        (s.d_inputs, pushed, 0.0, 1e-4, 0.1),
    ):
        want = scale * (run(place + step) - run(place - step)) / (2.0 * step)
        assert np.abs(found[..., 0] - want).max() < 5e-3 * np.abs(want).max()


def test_derivatives_belong_to_the_samples_of_an_uneven_clock(adapter):
    """Every second sample of a stretch is missing; the others are as in the whole record."""
    model, _, record = adapter
    kept = np.ones(record.samples, dtype=bool)
    kept[61:121:2] = False
    thin = Record(
        name="thin",
        time=record.time[kept],
        inputs={n: v[kept] for n, v in record.inputs.items()},
        outputs={n: v[kept] for n, v in record.outputs.items()},
    )
    at, none = np.zeros(len(model.parameters)), np.zeros((1, 0))
    found = model.sensitivities([SensitivityRequest(thin, at, whole(thin), none)])[0]
    every = model.sensitivities([SensitivityRequest(record, at, whole(record), none)])[0]
    run = model.simulate(thin, Jobs.at_point(at, whole(thin), none, (), np.zeros(0)))
    assert np.abs(found.outputs - run.outputs).max() < 1e-7
    for column in range(at.size):
        want = every.d_theta[0, kept, :, column]
        error = np.abs(found.d_theta[0, ..., column] - want).max()
        assert error <= 0.02 * np.abs(want).max(), model.parameters[column].name
