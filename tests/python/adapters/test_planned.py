"""Files of planned strokes: what `feltmb stroke`, `feltmb actuator` and a controller read."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from feltmb.cli.gap_plan import write_inputs
from feltmb.cli.models import Adapter

import feltmb
from feltmb.adapters import STROKE_KINDS, finger_limits, mechanism_model
from feltmb.run.stroke import load_stroke, read_stroke_csv
from unmodeled.data import Record
from unmodeled.experiment import DesignedExperiment
from unmodeled.experiment.profiles import FAMILIES


@pytest.fixture(scope="module")
def model():
    return mechanism_model(feltmb.load_action("steinway45"), effects=["let_off_button"])[0]


def profile_of(model, family, numbers=(0.6, 0.4, 0.5, 0.3)):
    limits = finger_limits(model)
    return FAMILIES[family].make(numbers, limits.inputs["force"], limits)


def designed(profile, name, factor=1.0):
    """An experiment of a plan, as far as files need it."""
    profile = replace(profile, moves=tuple((b, d, factor * h) for b, d, h in profile.moves))
    time = np.arange(0.0, profile.end, 5e-4)
    record = Record(name="1", time=time, inputs={name: profile.at(time)}, outputs={"y": time})
    return DesignedExperiment(
        name=f"{profile.family} of {name}", cost=1.0, input=name, profile=profile,
        record=record, before=0.0, after=1.0,
    )  # fmt: skip


@pytest.mark.parametrize("family", FAMILIES)
def test_a_planned_force_is_a_stroke_and_a_torque(model, family, tmp_path):
    profile = profile_of(model, family)
    experiment = designed(profile, "force")
    asked = (experiment, tmp_path / "1", Adapter(model, (), kinds=STROKE_KINDS), {"force": "N"})
    stroke_file, torque_file = write_inputs(*asked, lever=0.2, force=False)
    assert (stroke_file.name, torque_file.name) == ("1.toml", "1_torque.csv")
    stroke, torque = load_stroke(stroke_file), read_stroke_csv(torque_file)
    assert (stroke.kind, torque.kind) == ("force", "torque")
    assert stroke.duration == pytest.approx(profile.end, abs=1e-7)
    time = np.linspace(0.0, profile.end, 400)
    # A monotone cubic through the knots follows the smooth steps.
    assert np.abs(stroke.at(time) - profile.at(time)).max() < 0.02 * np.ptp(profile.at(time))
    clock = experiment.record.time
    assert np.allclose(torque.at(clock), 0.2 * profile.at(clock), atol=1e-6)
    assert feltmb.simulate("steinway45", stroke, duration=0.02).status == "done"
    with pytest.raises(feltmb.Error, match="exists"):
        write_inputs(*asked, lever=0.2, force=False)


def test_a_planned_motion_is_smooth(model, tmp_path):
    experiment = designed(profile_of(model, "step"), "displacement", 1e-3)
    adapter, units = Adapter(model, (), kinds=STROKE_KINDS), {"displacement": "m"}
    (path,) = write_inputs(experiment, tmp_path / "2", adapter, units, force=True)
    stroke = load_stroke(path)
    assert stroke.kind == "key_motion"
    assert stroke.as_dict()["interpolation"] == "spline"


def test_other_inputs_have_no_stroke(model, tmp_path):
    experiment = designed(profile_of(model, "pulse"), "u")
    adapter, told = Adapter(model, (), kinds=STROKE_KINDS), {"lever": 0.1, "force": True}
    assert write_inputs(experiment, tmp_path / "3", adapter, {"u": "V"}, **told) == []
