"""Exact derivatives of a mechanism's records: every tolerance and effect of the libraries."""

import numpy as np
import pytest

import feltmb
from feltmb import _core
from feltmb.adapters import load_library, mechanism_model
from feltmb.adapters.derivatives import added_states, forward_sensitivities
from unmodeled.data import Record
from unmodeled.fit import Candidate, Jobs, SensitivityRequest

END = 0.11  # s, shortly after the impact
#: One of each kind: what it changes is found in another way.
SAMPLE = (
    "coulomb_friction.butt", "stribeck_friction.jack", "felt_stiffness.0[47]", "felt_hysteresis.04",
    "felt_thickness.0[35]", "contact_friction.06", "transition_speed.08", "compliance.shank",
    "damping.wire", "spring_preload.butt_spring", "strap_slack.bridle_strap", "string_impedance",
    "string_damping", "strike_point", "gravity_misalignment", "point_offset_x.hammer_tip",
    "load_cell_mass", "key_lead", "let_off_button", "backcheck_wire_angle", "hammer_air_drag",
)  # fmt: skip


def columns_of(monkeypatch, mechanism, stroke, effects, whole):
    """All columns of a stroke until shortly past the impact; work in right-hand sides."""
    core, work = _core.sensitivities, []

    def call(base, profile, parameters, segments, options):
        options.whole_models = whole
        found = core(base, profile, parameters, segments, options)
        work.append(sum(r.counts["rhs"] for r in found))
        return found

    action = feltmb.load_action(mechanism)
    model, known = mechanism_model(
        action, library=load_library(action), effects=effects, rtol=1e-9, workers=1
    )
    time = np.arange(0.0, END, 5e-4)
    values = feltmb.load_stroke(stroke).at(time)
    zeros = {o: np.zeros(time.size) for o in model.outputs}
    record = Record(name=stroke, time=time, inputs={"force": values}, outputs=zeros)
    candidates = [Candidate(e, s) for e in known for s in e.shapes]
    candidates = tuple(c for c in candidates if not added_states(model.simulator, record, c))
    count = len(model.parameters)
    request = SensitivityRequest(
        record, np.zeros(count), np.zeros(0), by_theta=range(count), candidates=candidates
    )
    with monkeypatch.context() as patch:
        patch.setattr(_core, "sensitivities", call)
        columns = forward_sensitivities(model.simulator, request, tolerance=2e-6)
    scales = np.array([p.size for p in model.parameters] + [c.effect.scale for c in candidates])
    names = [p.name for p in model.parameters] + [c.name for c in candidates]
    return names, columns * scales, work[0]


def compare(monkeypatch, mechanism, stroke, effects):
    names, got, quick = columns_of(monkeypatch, mechanism, stroke, effects, False)
    _, want, slow = columns_of(monkeypatch, mechanism, stroke, effects, True)
    for j, name in enumerate(names):
        for part in (slice(0, 80), slice(80, 150), slice(150, None)):
            # Rounding moves the steps, and with them the error; no camera sees 1e-8 m.
            room = 1e-3 * np.abs(want[part, :, j]).max() + 1e-8
            assert np.abs(got[part, :, j] - want[part, :, j]).max() < room, (name, part)
    return quick / slow


@pytest.mark.slow
def test_what_an_effect_touches_is_all_that_it_touches(monkeypatch):
    """Forces of changed parts, against whole right-hand sides of the shifted mechanisms."""
    assert compare(monkeypatch, "steinway45", "forte", SAMPLE) < 0.5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mechanism", "stroke"), [("steinway45", "forte"), ("steinway45_felt", "piano")]
)
def test_what_any_effect_of_the_library_touches(monkeypatch, mechanism, stroke):
    compare(monkeypatch, mechanism, stroke, ["all"])


#: Shortly before the hammer meets the string [s]. Other packaged strokes of a force begin as these.
BEFORE = {"forte": 0.0915, "piano": 0.235, "staccato": 0.047}


#: Steps of differences as shares of the scale: small ones drown in the noise of the integrator,
#: large ones meet what is not linear, such as a contact that only just closes.
STEPS = (5e-3, 5e-4, 2e-2, 2e-3)
ENOUGH = 1e-4


def richardson(model, record, included, place, step):
    """Column by a parameter (place) or by an effect, from four tight runs."""

    def at(size):
        theta = np.zeros(len(model.parameters))
        sizes = np.zeros(len(included))
        if included:
            sizes[:] = size
        else:
            theta[place] = size
        jobs = Jobs(
            theta=theta[None],
            starts=np.zeros((1, 0)),
            included=included,
            magnitudes=sizes[None],
        )
        return model.simulate(record, jobs)[0]

    def central(h):
        return (at(h) - at(-h)) / (2.0 * h)

    return (4.0 * central(step) - central(2.0 * step)) / 3.0


def agreement(monkeypatch, stroke, effects, tolerances, tolerance=2e-6, rtol=1e-11):
    """Largest errors of columns against differences, relative to the largest of the column."""
    monkeypatch.setattr("feltmb.adapters.derivatives.TOLERANCE", tolerance)
    monkeypatch.setattr("feltmb.adapters.derivatives.ROUGH", tolerance)
    action = feltmb.load_action("steinway45")
    library = load_library(action)
    model, known = mechanism_model(
        action, library=library, effects=effects, rtol=rtol, workers=1, variation=None,
        tolerances=tolerances,
    )  # fmt: skip
    loaded = feltmb.load_stroke(stroke)
    time = np.arange(0.0, BEFORE[stroke], 5e-4)
    zeros = {o: np.zeros(time.size) for o in model.outputs}
    record = Record(name=stroke, time=time, inputs={"force": loaded.at(time)}, outputs=zeros)
    candidates = [Candidate(e, s) for e in known for s in e.shapes]
    candidates = tuple(
        c for c in candidates
        if not added_states(model.simulator, record, c) and c.effect.bounds[0] < 0.0
        and c.effect.data.condition is None
    )  # fmt: skip
    request = SensitivityRequest(
        record, np.zeros(len(model.parameters)), np.zeros(0), candidates=candidates
    )
    (s,) = model.sensitivities([request])
    wanted = [(p.name, (), i, p.size, s.d_theta[..., i]) for i, p in enumerate(model.parameters)]
    wanted += [
        (c.name, (c,), -1, c.effect.scale, s.d_candidates[..., i]) for i, c in enumerate(candidates)
    ]
    found = {}
    for name, included, place, scale, column in wanted:
        found[name] = np.inf
        for step in STEPS:
            by_runs = richardson(model, record, included, place, step * scale)
            # 1 nm is what tight runs repeat to.
            size = max(np.abs(by_runs).max(), 1e-5 / scale)
            found[name] = min(found[name], float(np.abs(column - by_runs).max() / size))
            if found[name] < ENOUGH:
                break
    return found


def test_a_sample_of_columns_by_differences(monkeypatch):
    """Short of the strike, where the force is that of felt and friction of all contacts."""
    effects = ["compliance.wire", "let_off_button", "pivot_position_y.butt", "center_of_mass_x.key"]
    found = agreement(monkeypatch, "forte", effects, ["mass.head", "felt.03"])
    assert len(found) == 6
    assert max(found.values()) < ENOUGH, found


@pytest.mark.slow
@pytest.mark.parametrize("stroke", BEFORE)
def test_all_columns_by_differences(monkeypatch, stroke):
    """As far as differences of tight runs can tell: some columns move a point by 0.1 um only."""
    found = agreement(monkeypatch, stroke, ["all"], ["all"])
    errors = np.array(list(found.values()))
    assert errors.size > 140
    assert np.quantile(errors, 0.85) < ENOUGH
    assert errors.max() < 2e-3, max(found, key=found.get)
