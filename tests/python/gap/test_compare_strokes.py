"""A model beside records before anything is fitted, and what would explain the difference."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import feltmb
import unmodeled
from feltmb.cli import main
from unmodeled.data import Record, Sensor
from unmodeled.errors import DataError

POINTS = ("key_front.y", "hammer_tip.x")


def command(*arguments):
    """Exit code of a command."""
    with pytest.raises(SystemExit) as stop:
        main([str(a) for a in arguments])
    return stop.value.code


@cache
def action():
    from feltmb.adapters import mechanism_model

    return mechanism_model(feltmb.load_action("steinway45"), channels=POINTS)[0]


@cache
def run():
    return feltmb.simulate("steinway45", "forte", duration=0.1, output_rate=2000.0)


def stroke(shift=None, *, sigma=2e-5, scale=1.0, late=0, of=None):
    """The run as a record; ``shift``: what is added to absolute coordinates, None: from rest."""
    generator = np.random.default_rng(3)
    done = run() if of is None else of
    outputs, sensors = {}, {}
    for name in POINTS:
        values = np.array(done[name])
        values = values - values[0] if shift is None else values + shift
        values = np.roll(values, late) if late else values
        values[:late] = values[late]
        outputs[name] = scale * values + sigma * generator.standard_normal(values.size)
        sensors[name] = Sensor(name=name, unit="m", sigma=sigma)
    force = np.array(done["finger.force"])
    return Record(
        name="run", time=done.time, inputs={"force": force}, outputs=outputs, sensors=sensors
    )


def kinds(model, records):
    """Kind and certainty of each hint."""
    return [(h.kind, h.sure) for h in unmodeled.check(model, records).hints]


def exchanged(r, *names):
    """The record with each channel under the name of the next one."""
    moved = dict(zip((*names[1:], names[0]), [r.outputs[n] for n in names], strict=True))
    return replace(r, outputs={**r.outputs, **moved})


def three(stiffness_sd=0.1):
    """Three outputs of one input, with the records of a model that is a tenth softer."""
    model = unmodeled.Simulator(
        lambda time, inputs, p: {
            "a": p["k"] * inputs["u"], "b": np.cumsum(inputs["u"]) * 0.02, "c": inputs["u"] ** 2
        },
        parameters=[unmodeled.Parameter(name="k", value=1.0, sd=stiffness_sd)],
        inputs={"u": "1"},
        outputs=dict.fromkeys("abc", "m"),
    )  # fmt: skip
    generator = np.random.default_rng(5)
    time = np.arange(200) * 1e-3
    records = []
    for i in range(2):
        u = np.sin((20.0 + 9.0 * i) * time)
        clean = {"a": 0.9 * u, "b": np.cumsum(u) * 0.02, "c": u**2}
        sensors = {n: Sensor(name=n, unit="m", sigma=1e-3) for n in clean}
        outputs = {n: v + 1e-3 * generator.standard_normal(time.size) for n, v in clean.items()}
        made = Record(name=f"r{i}", time=time, inputs={"u": u}, outputs=outputs, sensors=sensors,
                      role="held_out" if i else "fit")  # fmt: skip
        records.append(made)
    return model, records


def test_a_model_that_is_right_leaves_the_noise():
    found = unmodeled.check(action(), stroke(0.0))
    assert [r.channel for r in found.rows] == list(POINTS)
    for row in found.rows:
        assert row.in_noise == pytest.approx(1.0, abs=0.2)
        assert row.factor == pytest.approx(1.0, abs=0.01)
        assert row.correlation > 0.999
        assert np.isnan(row.delay)
    assert found.hints == ()
    assert any("absolute coordinates" in n for n in found.notes)
    assert list(found.frame["channel"]) == list(POINTS)
    figure = found.plot()
    assert len(figure.axes) == 2 * len(POINTS)
    assert [line.get_label() for line in figure.axes[0].lines] == ["record", "model"]


@pytest.mark.parametrize("seed", range(4))
def test_a_noisy_start_is_that_of_an_absolute_coordinate_if_no_noise_is_stated(seed):
    """A first sample a little beside rest made a coordinate a displacement of 34 mm."""
    record = stroke(0.0, sigma=1e-9)
    random = np.random.default_rng(seed)
    record = replace(
        record,
        outputs={n: v + 2e-4 * random.standard_normal(v.size) for n, v in record.outputs.items()},
        sensors={n: replace(s, sigma=None) for n, s in record.sensors.items()},
    )
    found = unmodeled.check(action(), record)
    assert sum("absolute coordinates" in n for n in found.notes) == 1
    assert not any("first value" in n or "starts neither" in n for n in found.notes)
    for row in found.rows:
        assert row.rms == pytest.approx(2e-4, rel=0.2)


def test_a_mechanism_in_a_wrong_unit_and_a_late_clock_are_seen():
    scaled = unmodeled.check(action(), stroke(scale=1e-3, sigma=1e-8))
    for row in scaled.rows:
        assert row.factor == pytest.approx(1e-3, rel=0.01)
    assert [(h.kind, h.channels) for h in scaled.hints] == [("unit", POINTS)]
    late = unmodeled.check(action(), stroke(late=8))  # samples of 0.5 ms
    for row in late.rows:
        assert row.delay == pytest.approx(4e-3, abs=3e-4)
    assert [h.kind for h in late.hints] == ["delay"]


def test_a_lighter_hammer_is_not_called_early():
    """It moves earlier, but no delay explains it: shifting the record would spoil it."""
    light = feltmb.load_action("steinway45").with_values({"bodies.head.mass *=": 0.85})
    other = feltmb.simulate(light, "forte", duration=0.1, output_rate=2000.0)
    found = unmodeled.check(action(), stroke(of=other))
    assert all(row.delay < -1e-4 for row in found.rows)
    assert not found.hints


def test_a_clock_of_a_stroke_in_a_wrong_unit_is_found_before_a_long_simulation():
    wrong = stroke(0.0)
    with pytest.raises(DataError, match="--unit time=ms"):
        unmodeled.check(action(), replace(wrong, time=1e3 * wrong.time))


def test_exchanged_columns_are_told():
    assert kinds(action(), stroke()) == []
    (hint,) = unmodeled.check(action(), exchanged(stroke(), *POINTS)).hints
    assert (hint.kind, set(hint.channels)) == ("exchange", set(POINTS))
    model, records = three()
    (hint,) = unmodeled.check(model, [exchanged(r, *"abc") for r in records]).hints
    assert hint.text.startswith("a looks like c, b looks like a, c looks like b")
    with pytest.raises(DataError, match="are the columns exchanged"):
        unmodeled.diagnose(model, [], [exchanged(r, *"abc") for r in records])


def test_the_command_prints_numbers_and_draws_a_picture(tmp_path, capsys):
    path, picture = tmp_path / "run.csv", tmp_path / "run.png"
    assert command("stroke", "steinway45", "forte", "--duration", "0.1", "-o", path) == 0
    capsys.readouterr()
    given = ["gap", "check", "steinway45", path]
    assert command(*given, "--json", "-o", picture) == 0
    found = json.loads(capsys.readouterr().out)
    assert {r["channel"] for r in found["rows"]} > set(POINTS)
    assert all(r["rms"] < 1e-6 for r in found["rows"])
    assert found["hints"] == []
    assert picture.read_bytes()[:4] == b"\x89PNG"
    assert command(*given, "-o", picture) == 2
    assert "--force" in capsys.readouterr().err
