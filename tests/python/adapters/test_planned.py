"""Files of planned strokes: what `feltmb stroke` reads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import feltmb
from feltmb.adapters import finger_limits, mechanism_model
from feltmb.extension import write_stroke
from feltmb.run.stroke import load_stroke
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
def test_a_planned_force_is_a_stroke(model, family, tmp_path):
    profile = profile_of(model, family)
    experiment = designed(profile, "force")
    (stroke_file,) = write_stroke(experiment, tmp_path / "1", {"force": "N"}, force=False)
    assert stroke_file.name == "1.toml"
    stroke = load_stroke(stroke_file)
    assert stroke.kind == "force"
    assert stroke.duration == pytest.approx(profile.end, abs=1e-7)
    time = np.linspace(0.0, profile.end, 400)
    # A monotone cubic through the knots follows the smooth steps.
    assert np.abs(stroke.at(time) - profile.at(time)).max() < 0.02 * np.ptp(profile.at(time))
    assert feltmb.simulate("steinway45", stroke, duration=0.02).status == "done"
    with pytest.raises(feltmb.Error, match="exists"):
        write_stroke(experiment, tmp_path / "1", {"force": "N"}, force=False)


def test_a_planned_motion_is_smooth(model, tmp_path):
    experiment = designed(profile_of(model, "step"), "displacement", 1e-3)
    (path,) = write_stroke(experiment, tmp_path / "2", {"displacement": "m"}, force=True)
    stroke = load_stroke(path)
    assert stroke.kind == "key_motion"
    assert stroke.as_dict()["interpolation"] == "spline"


def test_other_inputs_have_no_stroke(model, tmp_path):
    experiment = designed(profile_of(model, "pulse"), "u")
    assert write_stroke(experiment, tmp_path / "3", {"u": "V"}, force=True) == []
