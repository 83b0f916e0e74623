"""A model that includes an effect: the same machine, the effect one more parameter."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from blind.key_hammer import KeyHammer, effects
from feltmb.cli import main
from feltmb.data import Record, read_records
from feltmb.errors import InvalidParameter
from feltmb.fit import SensitivityRequest
from feltmb.gap import Candidate, Jobs, Options, Verdict, diagnose, including, library

HERE = Path(__file__).parent
EXAMPLES = HERE.parents[2] / "examples" / "gap"


def load(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


models = load(HERE / "models.py")
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
    segments = np.array([[0, 60], [60, 239]])
    theta = np.array([p.value for p in model.parameters])
    starts = np.zeros((2, 5))
    starts[1, :4] = [9.7e-3, 40e-3, 0.1, 1.0]
    plain = model.simulate(
        record, Jobs.at_point(theta, segments, starts, (Candidate(CREEP),), np.array([3e-5]))
    )
    same = included.simulate(
        record, Jobs.at_point(np.append(theta, 3e-5), segments, starts, (), np.zeros(0))
    )
    np.testing.assert_array_equal(same.outputs, plain.outputs)
    np.testing.assert_array_equal(same.ends, plain.ends)

    # With another candidate: columns go where they belong, in the order asked for.
    both = model.sensitivities(
        [
            SensitivityRequest(
                record,
                theta,
                segments,
                starts,
                (Candidate(CREEP), Candidate(DRAG)),
                np.array([3e-5, 1e-3]),
            )
        ]
    )[0]
    mine = included.sensitivities(
        [
            SensitivityRequest(
                record,
                np.append(theta, 3e-5),
                segments,
                starts,
                (Candidate(DRAG),),
                np.array([1e-3]),
                by_theta=[len(theta), 2],
            )
        ]
    )[0]
    np.testing.assert_array_equal(mine.d_theta[..., 0], both.d_magnitudes[..., 0])
    np.testing.assert_array_equal(mine.d_theta[..., 1], both.d_theta[..., 2])
    np.testing.assert_array_equal(mine.d_magnitudes[..., 0], both.d_magnitudes[..., 1])


@pytest.mark.parametrize(
    "flag",
    ["chaotic", "from_rest", "variability_has_input_noise", "variability_is_tabulated"],
)
def test_flags_are_those_of_the_model(flag):
    model = KeyHammer()
    for value in (True, False):
        setattr(model, flag, value)
        assert getattr(including(model, [CREEP], [3e-5]), flag) is value


def test_with_the_effect_included_there_is_no_gap():
    data = models.records(1, dry=6e-3)
    options = Options(bootstrap=0)
    assert diagnose(models.NOMINAL, models.EFFECTS, data, options=options).named == (
        "dry friction",
    )
    model = including(models.NOMINAL, [models.DRY])
    report = diagnose(model, [models.CUBIC], data, options=options)
    assert report.verdict == Verdict.CALIBRATED
    fitted = {i.name: i for i in report.fit.intervals()}["dry friction"]
    assert fitted.low < 6e-3 < fitted.high


def test_faults_are_told_together():
    gain = library.sensor_gain(["q"], "q")
    with pytest.raises(InvalidParameter) as caught:
        including(models.NOMINAL, [CREEP, gain], [1.0])
    text = str(caught.value)
    assert "1 magnitudes for 2 effects" in text
    assert "cannot simulate bed_creep" in text
    assert "correct the records" in text


def run(*arguments):
    with pytest.raises(SystemExit) as stop:
        main([str(a) for a in arguments])
    return stop.value.code


def test_command_line(capsys):
    data = [str(p) for p in sorted((EXAMPLES / "data").glob("emps_*.csv"))]
    model = str(EXAMPLES / "emps.py")
    names = ["--include", "dry friction", "--include", "constant force"]
    assert run("gap", "diagnose", model, *data, *names) == 0
    out = capsys.readouterr().out
    assert "dry friction" not in out.split("how far")[0].split("which")[-1]
    assert run("gap", "diagnose", model, *data, "--include", "rust") == 2
    assert "no such effect; there are dry friction" in capsys.readouterr().err


@pytest.mark.slow
def test_silverbox_with_what_it_lacked():
    module = load(EXAMPLES / "silverbox.py")
    records = read_records(sorted((EXAMPLES / "data").glob("silverbox_*.nc")))
    known = {e.name: e for e in module.effects}
    included = ["cubic stiffness mass", "quadratic stiffness mass"]
    model = including(module.model, [known[n] for n in included])
    rest = [e for e in module.effects if e.name not in included]
    before = diagnose(module.model, module.effects, records)
    after = diagnose(model, rest, records)
    gap = [r.how_far.rows[0].before for r in (before, after)]
    assert gap[1] < 0.8 * gap[0]
    if after.named:
        assert after.how_far.rows[0].before - after.how_far.rows[0].after < 0.5 * gap[0]
