"""The contract of every effect of the action: the model at size zero, and a slope there."""

import numpy as np
import pytest

import feltmb
from feltmb.adapters import load_library, mechanism_model
from feltmb.adapters.changes import changed_config
from unmodeled.data import Record
from unmodeled.fit import Candidate
from unmodeled.fit.observe import observe

CONDITIONS = {"relative_humidity": 70.0, "cycle": 100.0}


def record_of(model, stroke, duration):
    stroke = feltmb.load_stroke(stroke)
    time = np.arange(0.0, duration, 5e-4)
    return Record(
        name=stroke.name,
        time=time,
        inputs={"force": stroke.at(time)},
        outputs={o: np.zeros(time.size) for o in model.outputs},
        conditions=CONDITIONS,
    )


@pytest.fixture(scope="module")
def adapter():
    action = feltmb.load_action("steinway45")
    channels = ["key", "key_lift", "whippen", "hammer_tip", "backcheck", "jack", "damper"]
    model, effects = mechanism_model(action, channels=channels, effects=["all"], rtol=1e-6)
    records = [record_of(model, "forte", 0.14), record_of(model, "staccato", 0.18)]
    return model, {e.name: e for e in effects}, records


def outputs(model, record, candidate=None, size=0.0):
    included = () if candidate is None else (candidate,)
    theta, sizes = np.zeros(len(model.parameters)), np.full(len(included), size)
    return observe(model, record, theta, np.zeros(0), included, sizes)


@pytest.fixture(scope="module")
def plain(adapter):
    model, _, records = adapter
    return [outputs(model, r) for r in records]


def names(which):
    library = load_library(feltmb.load_action("steinway45"))
    if which == "default":
        return [e.name for e in library.select()]
    default = {e.name for e in library.select()}
    return [e.name for e in library.effects if e.name not in default]


def check(adapter, plain, name):
    model, effects, records = adapter
    if name not in effects:  # a channel that no output of this model belongs to
        assert name.startswith(("channel_gain", "point_offset"))
        return
    effect = effects[name]
    # A force of the felt that is not used in these strokes, or a strap that stays slack in forte.
    for shape in effect.shapes:
        candidate = Candidate(effect, shape)
        moved = 0.0
        for record, base in zip(records, plain, strict=True):
            assert np.array_equal(outputs(model, record, candidate, 0.0), base)
            low, high = effect.bounds
            step = effect.step * effect.scale * (1.0 if high > 0.0 else -1.0)
            assert low <= step <= high
            slope = (outputs(model, record, candidate, step) - base) / effect.step
            assert np.all(np.isfinite(slope))
            moved = max(moved, float(np.max(np.abs(slope))))
            if moved > 1e-7:
                break
        # 0.1 um of some point for the size that one would expect to meet (most: 0.1 to 10 mm).
        assert moved > 1e-7, f"{name} moves nothing"


@pytest.mark.parametrize("name", names("default"))
def test_an_effect_is_the_model_at_zero_and_moves_it(adapter, plain, name):
    check(adapter, plain, name)


@pytest.mark.slow
@pytest.mark.parametrize("name", names("rest"))
def test_the_other_effects_too(adapter, plain, name):
    check(adapter, plain, name)


def test_zero_gives_back_the_very_same_configuration():
    action = feltmb.load_action("steinway45")
    library = load_library(action)
    entries = [(e, 0.0, s) for e in (*library.effects, *library.tolerances) for s in e.shapes]
    assert changed_config(action.config, entries, CONDITIONS) is action.config


def test_every_effect_says_what_it_is():
    for library in (load_library(feltmb.load_action("steinway45")),):
        for e in library.effects:
            assert e.component
            assert e.mechanism.endswith(".")
            assert e.remedy.endswith(".")
            assert e.magnitude > 0.0
            assert "{" not in e.name + e.component + e.mechanism + e.remedy
        assert len(library.select()) >= 40
        assert len({e.name for e in library.effects}) == len(library.effects)
