"""Exact derivatives of a mechanism's records: every tolerance and effect of the libraries."""

import numpy as np
import pytest

import feltmb
from feltmb import _core
from feltmb.adapters import load_library, mechanism_model
from feltmb.adapters.forward import can_differentiate, forward_sensitivities
from feltmb.data import Record
from feltmb.fit import Candidate

END = 0.11  # s, shortly after the impact
#: One of each kind: what it changes is found in another way.
SAMPLE = (
    "coulomb_friction.butt", "stribeck_friction.jack", "felt_stiffness.0[47]", "felt_hysteresis.04",
    "felt_thickness.0[35]", "contact_friction.06", "transition_speed.08", "compliance.shank",
    "damping.wire", "spring_preload.butt_spring", "strap_slack.bridle_strap", "string_impedance",
    "string_damping", "strike_point", "gravity_misalignment", "point_offset_x.hammer_tip",
    "load_cell_mass", "let_off_button", "backcheck_wire_angle", "hammer_air_drag",
)  # fmt: skip


def columns_of(monkeypatch, mechanism, stroke, effects, whole):
    """All columns of three segments, short of and past the impact; work in right-hand sides."""
    core, work = _core.sensitivities, []

    def call(base, profile, motion, parameters, windows, options, *more):
        options.whole_models = whole
        found = core(base, profile, motion, parameters, windows, options, *more)
        work.append(sum(r.counts["rhs"] for r in found))
        return found

    action = feltmb.load_action(mechanism)
    model, known = mechanism_model(
        action, library=load_library(action), effects=effects, shooting="multiple",
        derivatives="forward", workers=1,
    )  # fmt: skip
    time = np.arange(0.0, END, 5e-4)
    values = feltmb.load_stroke(stroke).at(time)
    zeros = {o: np.zeros(time.size) for o in model.outputs}
    record = Record(name=stroke, time=time, inputs={"force": values}, outputs=zeros)
    cuts = np.array([0, 80, 150, time.size - 1], dtype=np.intp)
    segments = np.column_stack([cuts[:-1], cuts[1:]])
    candidates = [Candidate(e, s) for e in known for s in e.shapes]
    candidates = tuple(c for c in candidates if can_differentiate(c))
    with monkeypatch.context() as patch:
        patch.setattr(_core, "sensitivities", call)
        s = forward_sensitivities(
            model, record, np.zeros(len(model.parameters)), segments,
            model.guess(record, segments), (), np.zeros(0),
            by_theta=range(len(model.parameters)), by_starts=False, candidates=candidates,
        )  # fmt: skip
    scales = np.array([p.size for p in model.parameters] + [c.effect.scale for c in candidates])
    names = [p.name for p in model.parameters] + [c.name for c in candidates]
    outputs = np.concatenate([s.d_theta, s.d_candidates], axis=-1) * scales
    ends = np.concatenate([s.d_theta_ends, s.d_candidates_ends], axis=-1) * scales
    ends /= np.array([x.scale for x in model.states()])[:, None]
    return names, outputs, ends, work[0]


def compare(monkeypatch, mechanism, stroke, effects):
    names, got, got_ends, quick = columns_of(monkeypatch, mechanism, stroke, effects, False)
    _, want, want_ends, slow = columns_of(monkeypatch, mechanism, stroke, effects, True)
    for j, name in enumerate(names):
        for w in range(len(want)):
            # Rounding moves the steps, whose local error is 1e-3; no camera sees 1e-8 m.
            room = 1e-3 * np.abs(want[w, ..., j]).max() + 1e-8
            assert np.abs(got[w, ..., j] - want[w, ..., j]).max() < room, (name, w)
            room = 1e-3 * np.abs(want_ends[w, :, j]).max() + 1e-4
            assert np.abs(got_ends[w, :, j] - want_ends[w, :, j]).max() < room, (name, w)
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
