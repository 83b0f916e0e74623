"""A model that includes an effect: the same machine, the effect one more parameter."""

from dataclasses import replace

import numpy as np
import pytest

from unmodeled import Verdict, diagnose, including, library
from unmodeled.data import Record
from unmodeled.errors import Error, InvalidParameter
from unmodeled.fit import SensitivityRequest
from unmodeled.models import Candidate, Jobs

from ..diagnosis import models

try:
    from blind.key_hammer import KeyHammer, effects
except Error as missing:  # its machine is compiled
    pytest.skip(str(missing), allow_module_level=True)

CREEP = next(e for e in effects() if e.name == "bed_creep")
DRAG = next(e for e in effects() if e.name == "hammer_drag")


def stroke():
    time = np.arange(240) * 0.5e-3
    force = 6.0 * np.clip((time - 0.01) / 0.02, 0.0, 1.0)
    zero = {c: 0.0 * time for c in ("key", "hammer")}
    return Record(name="s", time=time, inputs={"finger": force}, outputs=zero)


def test_it_is_the_model_with_the_candidate():
    model, record = KeyHammer(), stroke()
    included = including(model, [CREEP], [3e-5])
    assert included.parameters[-1].name == "bed_creep"
    assert [s.name for s in included.states()][-1] == "bed_set"
    assert not any(s.hidden for s in included.states())
    theta = np.array([p.value for p in model.parameters])
    start = np.array([9.7e-3, 40e-3, 0.1, 1.0, 0.0])
    plain = Jobs(
        theta=theta[None],
        starts=start[None],
        included=(Candidate(CREEP),),
        magnitudes=np.array([[3e-5]]),
    )
    same = Jobs(theta=np.append(theta, 3e-5)[None], starts=start[None])
    np.testing.assert_array_equal(included.simulate(record, same), model.simulate(record, plain))
    np.testing.assert_array_equal(included.motion(record, same), model.motion(record, plain))

    # With another candidate: columns go where they belong, in the order asked for.
    (both,) = model.sensitivities(
        [
            SensitivityRequest(
                record,
                theta,
                start,
                (Candidate(CREEP), Candidate(DRAG)),
                np.array([3e-5, 1e-3]),
            )
        ]
    )
    (mine,) = included.sensitivities(
        [
            SensitivityRequest(
                record,
                np.append(theta, 3e-5),
                start,
                (Candidate(DRAG),),
                np.array([1e-3]),
                by_theta=[len(theta), 2],
            )
        ]
    )
    np.testing.assert_array_equal(mine.d_theta[..., 0], both.d_magnitudes[..., 0])
    np.testing.assert_array_equal(mine.d_theta[..., 1], both.d_theta[..., 2])
    np.testing.assert_array_equal(mine.d_magnitudes[..., 0], both.d_magnitudes[..., 1])


def test_with_the_effect_included_there_is_no_gap():
    data = models.records(1, dry=6e-3)
    ((missing,),) = diagnose(models.NOMINAL, models.EFFECTS, data).small  # the damping imitates it
    assert missing.cause == "dry friction"
    model = including(models.NOMINAL, [models.DRY])
    report = diagnose(model, [models.CUBIC], data)
    assert report.verdict is Verdict.CALIBRATED
    fitted = next(p for p in report.parameters if p.name == "dry friction")
    assert fitted.low < 6e-3 < fitted.high


def test_faults_are_told_together():
    gain = library.sensor_fault(["q"], "q", "gain")
    with pytest.raises(InvalidParameter) as caught:
        including(models.NOMINAL, [CREEP, gain], [1.0])
    text = str(caught.value)
    assert "1 magnitudes for 2 effects" in text
    assert "cannot simulate bed_creep" in text
    assert "correct the records" in text


def test_limits_of_a_model_that_includes_effects_are_kept():
    model = including(models.NOMINAL, [models.CUBIC])
    held = {p.name: replace(p, lower=0.5 * p.value, upper=100.0) for p in model.parameters}
    for one in (
        model.with_parameters(held),
        model.with_parameters(held).ready(models.records(1)).model,
    ):
        limits = {p.name: (p.lower, p.upper) for p in one.parameters if p.name in held}
        assert limits == {n: (p.lower, p.upper) for n, p in held.items()}
    with pytest.raises(InvalidParameter, match="rust: no parameter of"):
        model.with_parameters({"rust": model.parameters[0]})


def test_faults_of_priors_of_included_effects():
    with pytest.raises(InvalidParameter, match="2 standard deviations for 1 effects"):
        including(models.NOMINAL, [models.DRY], [0.0], [1.0, 2.0])
    with pytest.raises(InvalidParameter, match="a standard deviation of 0, expected > 0"):
        including(models.NOMINAL, [models.DRY], [0.0], [0.0])
    with pytest.raises(InvalidParameter, match=r"dry friction = -1, expected a value in \[0, inf"):
        including(models.NOMINAL, [models.DRY], [-1.0])
