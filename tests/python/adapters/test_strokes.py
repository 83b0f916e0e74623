"""Whole strokes as a model: derivatives, variation from stroke to stroke, configurations."""

import numpy as np
import pytest

import feltmb
from blind.refined import KINDS, refined
from feltmb.adapters import load_library, mechanism_model
from feltmb.adapters.changes import Configurations, changed_config
from feltmb.adapters.derivatives import POINTS
from feltmb.adapters.model import resolve
from unmodeled import Options
from unmodeled.data import Record, Sensor
from unmodeled.errors import InvalidParameter
from unmodeled.fit import Candidate, Jobs, SensitivityRequest
from unmodeled.fit.observe import observe, observed_sensitivities
from unmodeled.search.records import prepare, ready_records
from unmodeled.search.variation import varies, with_variation

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


def without_tolerances(adapter):
    """The model without parameters and effects, and the record."""
    rough, _, record = adapter
    model, _ = mechanism_model(
        rough.action, channels=["key", "whippen", "hammer"], library=rough.library,
        tolerances=[], effects=[], rtol=1e-7, workers=1, variation=None,
    )  # fmt: skip
    return model, record


def at(theta):
    """One simulation at these parameters."""
    return Jobs(theta=theta[None], starts=np.zeros((1, 0)))


def asked(record, theta, **fields):
    return SensitivityRequest(record, theta, np.zeros(0), **fields)


def test_a_row_of_configurations_is_that_of_single_ones():
    action = feltmb.load_action("steinway45")
    library = load_library(action)
    rng = np.random.default_rng(1)
    configurations = Configurations(action.config)
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
        ours = configurations.of(entries).model_dump(mode="json")
        assert_close(ours, changed_config(action.config, entries).model_dump(mode="json"))
    zero = [(e, 0.0, None) for e in library.tolerances]
    assert configurations.of(zero) is action.config


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
    theta = np.full(len(model.parameters), 1e-8)
    passes = model.derivatives.passes
    (s,) = model.sensitivities([asked(record, theta)])
    assert model.derivatives.passes == passes + 1
    (again,) = model.sensitivities([asked(record, theta, candidates=candidates)])
    assert model.derivatives.passes == passes + 2  # the candidates
    assert np.array_equal(again.d_theta, s.d_theta)
    model.sensitivities([asked(record, theta, candidates=candidates)])
    assert model.derivatives.passes == passes + 2
    model.sensitivities([asked(record, theta + 1e-9)])
    assert model.derivatives.passes == passes + 3


def test_requests_of_one_call_share_a_point_also_if_others_are_between(adapter):
    model, _, record = adapter
    short, theta = record.cut(0, 20), np.full(len(model.parameters), 2e-8)
    others = [asked(short, theta + k * 1e-9, by_theta=(0,)) for k in range(1, 1 + POINTS)]
    first = asked(short, theta, by_theta=(0,))
    passes = model.derivatives.passes
    found = model.sensitivities([first, *others, first])
    assert model.derivatives.passes == passes + 1 + POINTS
    assert np.array_equal(found[0].d_theta, found[-1].d_theta)


def creeping(adapter, workers):
    """A model with effects that add states of laws, and its candidates."""
    rough, _, _ = adapter
    model, effects = mechanism_model(
        rough.action, channels=["key", "whippen", "hammer"], library=rough.library,
        tolerances=["felt.03"], effects=["felt_relaxation.0[34]", "pivot_compliance.whippen"],
        rtol=1e-8, workers=workers,
    )  # fmt: skip
    return model, tuple(Candidate(e, s) for e in effects for s in e.shapes)


def test_effects_with_states_of_laws_are_in_a_pass_for_each_of_their_shapes(adapter):
    _, _, record = adapter
    model, candidates = creeping(adapter, 1)
    theta = np.zeros(1)
    (s,) = model.sensitivities([asked(record, theta, by_theta=(), candidates=candidates)])
    assert model.derivatives.passes == 2
    for k, candidate in enumerate(candidates[:4]):
        size = 0.02 * candidate.effect.scale
        moved = model.simulator.motion(record, theta, (candidate,), np.array([size]))
        found = (moved - s.outputs) / size
        apart = np.abs(s.d_candidates[..., k] - found).max()
        assert apart < 0.05 * np.abs(found).max(), candidate.name


def test_results_do_not_depend_on_the_number_of_threads(adapter):
    _, _, record = adapter
    records = (record, record.with_inputs({"force": 1.01 * record.inputs["force"]}))
    results = []
    for workers in (1, 3):
        model, candidates = creeping(adapter, workers)
        points = [(r, np.array([x])) for r in records for x in (0.0, 0.1, 0.1)]
        requests = [asked(r, x, candidates=candidates[-1:]) for r, x in points]
        found = model.sensitivities([*requests, asked(record, np.zeros(1), candidates=candidates)])
        results.append(
            [
                *(s.d_theta for s in found),
                *(s.d_candidates for s in found),
                *model.simulate_all([(r, at(x)) for r, x in points]),
            ]
        )
    assert all(np.array_equal(a, b) for a, b in zip(*results, strict=True))


def test_a_camera_that_lags_and_a_force_sensor_that_leads_show_the_same(adapter):
    model, effects, record = adapter
    camera, force = (
        next(e for e in effects if e.name == n) for n in ("camera_skew", "input_delay")
    )
    theta, none = np.zeros(len(model.parameters)), np.zeros(0)

    def shown(effect, size):
        return observe(model, record, theta, none, (Candidate(effect),), np.array([size]))

    still, lag, lead = shown(camera, 0.0), shown(camera, 6e-4), shown(force, -6e-4)
    assert np.max(np.abs(still - lag)) > 1e-3
    assert np.max(np.abs(lead - lag)) < 4e-6  # a fifth of the noise of a camera


def test_the_modes_of_a_record_hold_the_noise_of_its_input(adapter):
    """Replays with noisy input differ as much as the modes say."""
    model, record = without_tolerances(adapter)
    problem = prepare(ready_records(model, [record]), (), (), Options())
    assert varies(problem)
    modes = with_variation(problem).fit[0].modes / 2e-5
    rng = np.random.default_rng(3)
    (kept,) = model.ready([record]).records
    base = model.simulate(kept, at(np.zeros(0)))[0]
    magnitudes = []
    for _ in range(12):
        noisy = kept.inputs["force"] + 0.01 * rng.standard_normal(kept.samples)
        y = model.simulate(kept.with_inputs({"force": noisy}), at(np.zeros(0)))[0]
        magnitudes.append(np.sum(((y - base) / 2e-5) ** 2))
    assert np.mean(magnitudes) == pytest.approx(np.sum(modes**2), rel=0.5)


def test_felt_and_friction_vary_from_stroke_to_stroke(adapter):
    model, _, _ = adapter
    assert {p.name: p.process_sd for p in model.parameters} == {
        "let_off_button": 0.0,
        "capstan_height": 0.0,
        "mass.head": 0.0,
        "felt.03": 0.01,
        "joint_friction.butt": 0.01,
    }
    other, _ = resolve("steinway45", {"variation": "0.02", "tolerances": "felt.03"})
    assert other.parameters[0].process_sd == 0.02
    none, _ = resolve("steinway45", {"variation": "none", "tolerances": "felt.03"})
    assert none.parameters[0].process_sd == 0.0


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
        ({"variation": "many"}, "got 'many', expected a number, or none"),
        ({"variation": "0.9"}, "variation = 0.9, expected 0 to 0.5"),
    ],
)
def test_faults_of_the_variability(settings, message):
    with pytest.raises(InvalidParameter, match=message):
        resolve("steinway45", settings)


def test_derivatives_by_the_input_are_exact_and_in_the_same_pass(adapter, monkeypatch):
    """Delay of the input, and noise at one knot, against differences of tight runs."""
    monkeypatch.setattr("feltmb.adapters.derivatives.TOLERANCE", 1e-5)
    rough, effects, record = adapter
    model, _ = mechanism_model(
        rough.action, channels=["key", "whippen", "hammer"], library=rough.library,
        tolerances=["felt.03"], effects=["input_delay"], rtol=1e-10, workers=1,
    )  # fmt: skip
    delay = Candidate(next(e for e in effects if e.name == "input_delay"))
    hat = np.maximum(0.0, 1.0 - np.abs(record.time - 0.03) / 0.008)
    theta = np.zeros(1)
    request = asked(record, theta, candidates=(delay,), input_changes=({"force": 0.1 * hat},))
    passes = model.derivatives.passes
    (s,) = observed_sensitivities(model, [request])
    assert model.derivatives.passes == passes + 1
    (included,) = observed_sensitivities(
        model, [asked(record, theta, included=(delay,), magnitudes=np.array([1e-3]))]
    )

    def late(size):
        return observe(model, record, theta, np.zeros(0), (delay,), np.array([size]))

    def pushed(size):
        changed = record.with_inputs({"force": record.inputs["force"] + size * hat})
        return model.simulate(changed, at(theta))[0]

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
    theta = np.zeros(len(model.parameters))
    (found,) = model.sensitivities([asked(thin, theta)])
    (every,) = model.sensitivities([asked(record, theta)])
    assert np.abs(found.outputs - model.simulate(thin, at(theta))[0]).max() < 1e-7
    for column in range(theta.size):
        want = every.d_theta[kept][..., column]
        error = np.abs(found.d_theta[..., column] - want).max()
        assert error <= 0.02 * np.abs(want).max(), model.parameters[column].name


def test_an_identity_has_no_delay(adapter):
    """The record of a run, asked for at its own times, is the answer of the model to its force."""
    model, record = without_tolerances(adapter)
    stroke = feltmb.load_stroke("forte")
    rate = 1.0 / (record.time[1] - record.time[0])
    run = feltmb.simulate(
        model.action, stroke, duration=record.time[-1], output_rate=rate, rtol=1e-7
    )
    own = np.column_stack([run[name] for name in model.outputs])[: record.samples]
    y = model.simulate(record, at(np.zeros(0)))[0]
    own = own - own[0]  # the channels of a camera are changes
    late = np.abs(np.gradient(own, record.time, axis=0)).max(axis=0) * 1e-5
    assert np.all(np.abs(y - own).max(axis=0) < late)  # less than 10 us, a fiftieth of a sample
