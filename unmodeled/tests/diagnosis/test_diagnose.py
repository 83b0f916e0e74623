"""The diagnosis of machines whose truth is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from unmodeled import Coordinate, Equations, Parameter, Record, Sensor, StartPrior, State, library
from unmodeled.diagnosis import diagnose, fit_model
from unmodeled.errors import Error
from unmodeled.models import Jobs
from unmodeled.search.held_out import Ratio
from unmodeled.search.options import Options
from unmodeled.search.progress import Stop
from unmodeled.search.result import Reason, Verdict

from .conftest import SIGMA, spring_record
from .models import DRY, MASS, NOMINAL, TRUTH, line, record


def three(**effects):
    return [
        spring_record("a", 2, **effects),
        spring_record("b", 5, **effects),
        spring_record("c", 3, role="held_out", **effects),
    ]


def test_the_true_effect_is_named_with_its_magnitude(spring, causes):
    result = diagnose(spring, causes, three(hardening=2000.0))
    assert result.verdict is Verdict.NAMED
    (named,) = result.named
    assert named.cause == "hardening"
    assert named.low < 2000.0 < named.high
    assert named.probability > 0.99
    assert len(named.by_record) == 3
    assert result.held_out_gain[2] < 0.3
    (channel,) = result.channels
    assert channel.explained == pytest.approx(channel.noise, rel=0.1)
    assert channel.calibrated > 2.0 * channel.noise
    assert result.records == ("a", "b", "c")
    assert [t.held_out for t in result.traces] == [False, False, True]
    squares = np.concatenate([t.explained**2 for t in result.traces])
    assert np.mean(squares) == pytest.approx(channel.explained**2)
    assert result.unknowns == ("k", "hardening")
    # A cubic and a linear force of the same motion are similar.
    assert -1.0 < result.correlation[0, 1] < -0.7
    assert np.diag(result.correlation) == pytest.approx(1.0)


def test_nothing_is_named_where_nothing_is_missing(spring, causes):
    result = diagnose(spring, causes, three())
    assert result.verdict in (Verdict.CALIBRATED, Verdict.NO_GAP)
    assert not result.named
    assert not result.classes
    assert result.nothing > 0.8


def test_two_effects_are_both_named(spring, causes):
    result = diagnose(spring, causes, three(hardening=2000.0, preload=0.5))
    assert {n.cause for n in result.named} == {"hardening", "preload"}


def test_effects_that_act_alike_are_one_class(spring, causes):
    other = type(causes[0])(
        name="other",
        component="spring",
        unit="N/m^3",
        scale=1000.0,
        regressor=lambda r, _: r.inputs["x"] ** 3,
    )
    result = diagnose(spring, (*causes, other), three(hardening=2000.0))
    assert result.verdict is Verdict.ONE_OF
    (group,) = result.classes
    assert {n.cause for n in group} == {"hardening", "other"}
    assert result.apart[0] in result.records


def test_a_cause_outside_the_list_is_unknown(spring, causes):
    result = diagnose(spring, causes, three(foreign=2.0))
    assert result.verdict in (Verdict.UNKNOWN, Verdict.SUPPORTED)
    assert not result.named
    assert not result.classes


def test_a_small_discrepancy_changes_neither_name_nor_coverage(spring, causes):
    result = diagnose(spring, causes, three(hardening=3000.0, foreign=0.1))
    assert [n.cause for n in result.named] == ["hardening"]
    assert result.named[0].low < 3000.0 < result.named[0].high


@pytest.mark.parametrize("factor", [1.1, 3.0])
def test_white_noise_beyond_the_stated_one_is_no_discrepancy(factor):
    rng, t = np.random.default_rng(1), np.linspace(0.0, 1.0, 1000)
    x = np.sin(4.0 * np.pi * t)
    y = x + 0.01 * factor * rng.standard_normal(t.size)
    sensors = {"y": Sensor(name="y", unit="1", sigma=0.01)}
    one = Record(name="one", time=t, inputs={"x": x}, outputs={"y": y}, sensors=sensors)
    found = fit_model(line(0.1), one).parameters[0]
    half = 1.96 * 0.01 * factor / np.sqrt(x @ x)
    assert 0.5 * (found.high - found.low) == pytest.approx(half, rel=0.25)


def test_the_starts_of_hidden_states_have_the_unit_of_their_coordinate():
    """Else the evidence of an effect with memory would depend on this unit."""

    def starts(per_meter):
        scales = {"travel": 0.1 * per_meter, "speed": 0.3 * per_meter}
        effects = library.for_coordinate(MASS, force=5.0, **scales)
        return {f"{e.name}: {s.name}": s.start_sd for e in effects for s in e.hidden}

    in_meters = starts(1.0)
    assert in_meters
    assert starts(1e3) == pytest.approx({name: 1e3 * sd for name, sd in in_meters.items()})


def test_a_parameter_far_outside_its_tolerance_is_told(spring, causes):
    narrow = spring.with_parameters({"k": Parameter(name="k", value=60.0, sd=1.0, unit="N/m")})
    result = diagnose(narrow, causes, three())
    assert [(n.cause, n.parameter) for n in result.named] == [("k", True)]
    assert result.named[0].low < 100.0 < result.named[0].high


def test_noise_that_is_not_stated_is_told(spring, causes):
    records = [
        Record(
            name=r.name,
            role=r.role,
            time=r.time,
            inputs=r.inputs,
            outputs=r.outputs,
            sensors={"force": Sensor(name="force", unit="N")},
        )
        for r in three(hardening=2000.0)
    ]
    result = diagnose(spring, causes, records)
    assert Reason.NOISE_NOT_STATED in result.reasons
    assert [n.cause for n in result.named] == ["hardening"]
    # The residual is white: it is the noise, which the records of this test state.
    (channel,), stated = result.channels, diagnose(spring, causes, three(hardening=2000.0))
    assert channel.noise == pytest.approx(stated.channels[0].noise, rel=0.2)
    assert not channel.material
    # Without the cause, most of what remains is shared by neighboring samples.
    (alone,) = diagnose(spring, (), records).channels
    assert alone.noise == pytest.approx(channel.noise, rel=0.3)
    assert alone.material


def test_good_enough_decides_what_matters(spring, causes):
    result = diagnose(spring, causes, three(foreign=2.0), options=Options(good_enough={"N": 5.0}))
    assert result.verdict is Verdict.NO_GAP


def test_the_limit_of_time_still_answers(spring, causes):
    result = diagnose(spring, causes, three(hardening=2000.0), options=Options(seconds=1e-6))
    assert Reason.NOT_COMPLETE in result.reasons
    assert not result.complete
    # What was not done is told, and the held-out records are predicted all the same.
    assert {c.name for c in causes} <= set(result.not_tried)
    assert len(result.not_tried) == result.causes
    assert result.needed >= result.seconds
    assert "causes were not tried" in result.summary()
    assert Reason.NOT_PREDICTED not in result.reasons
    assert all(np.isfinite(c.held_out_calibrated) for c in result.channels)


def test_held_out_records_after_an_interruption_are_told(spring, causes):
    stages = []

    def tell(progress):
        stages.append(progress.stage)
        if stages[-2:] == ["held_out"] * 2:  # in the first step of the stage
            raise KeyboardInterrupt

    result = diagnose(spring, causes, three(hardening=2000.0), progress=tell)
    assert Reason.INTERRUPTED in result.reasons
    assert Reason.NOT_PREDICTED in result.reasons
    assert np.isnan(result.channels[0].held_out_calibrated)


def test_faults_are_told_at_once(spring, causes):
    other = type(causes[0])(name="stiffness", component="x", rate=dict)
    with pytest.raises(Error, match=r"stiffness.*hardening"):
        diagnose(spring, (*causes, causes[0], other), three())


def test_an_offset_of_each_record_is_named_with_its_values(spring, causes):
    offsets = (0.4, -0.9, 0.6)
    records = [
        replace(r, outputs={"force": r.outputs["force"] + b})
        for r, b in zip(three(), offsets, strict=True)
    ]
    result = diagnose(spring, causes, records)
    (named,) = result.named
    assert named.cause == "offset of sensor force in each record"
    assert named.by_record == pytest.approx(offsets, abs=0.03)
    # The interval is that of the rms, as for every other magnitude: three means of 200 samples.
    rms = np.sqrt(np.mean(np.square(offsets)))
    assert named.low < rms < named.high
    assert named.high - named.low == pytest.approx(2 * 1.96 * SIGMA / np.sqrt(600), rel=0.1)
    stiffness = result.parameters[0]
    assert stiffness.low < 100.0 < stiffness.high


@pytest.mark.parametrize("stated", [0.0, 6e-3])
def test_a_late_clock_whose_uncertainty_is_stated_is_no_cause(stated):
    """All sensors are 8 ms late, two samples: one clock, not an input that is early."""
    model = Equations(
        name="oscillator",
        states=NOMINAL.states(),
        parameters=NOMINAL.parameters,
        inputs=["f"],
        rates=lambda t, x, u, p: (x.v, (u.f - p.k * x.q - p.d * x.v) / p.m),
        outputs={"q": "q", "v": "v"},
        coordinates=[MASS],
    )
    records = []
    for k in range(3):
        true = record(f"run {k}", 1.0 + 0.3 * k, k, samples=400)
        true = replace(true, inputs={"f": true.inputs["f"] * np.clip(true.time / 0.2, 0.0, 1.0)})
        jobs = Jobs(theta=TRUTH[None], starts=np.zeros((1, 2)))
        clean = model.simulate(true, jobs)[0]
        late = [clean[np.maximum(np.arange(400) - 2, 0), c] for c in range(2)]
        noise = np.random.default_rng(k)
        sensors, outputs = {}, {}
        for name, unit, sigma, y in zip("qv", ("m", "m/s"), (1e-4, 1e-3), late, strict=True):
            sensors[name] = Sensor(name=name, unit=unit, sigma=sigma, delay_sd=stated)
            outputs[name] = y + sigma * noise.standard_normal(400)
        records.append(replace(true, outputs=outputs, sensors=sensors))
    result = diagnose(model, [DRY, *library.for_input("f", records[0])], records)
    clocks = [n for n in result.notes if "q, v: one clock" in n]
    if stated:
        assert result.verdict is Verdict.CALIBRATED
        assert len(clocks) == 1
        assert "same delay_sd (0.006 s)" in clocks[0]
        for c in result.channels:
            assert c.explained < 1.1 * c.noise
    else:
        assert clocks == []
        (named,) = result.named
        assert named.cause == "delay of input f"
        assert named.magnitude == pytest.approx(-8e-3, rel=0.05)


def swing_rates(t, x, u, p):
    del t, u
    return x.v, -40.0 * np.sin(x.q) - p.d * x.v


def test_a_slow_clock_is_told_as_the_clock(causes):
    del causes
    model = Equations(
        name="swing",
        states=[State(name="q", unit="rad", scale=0.3), State(name="v", unit="rad/s", scale=2.0)],
        parameters=[Parameter(name="d", value=0.1, sd=0.05, unit="1/s")],
        inputs={},
        rates=swing_rates,
        outputs={"angle": "q"},
        coordinates=[Coordinate(name="swing", position="q", speed="v", unit="N m")],
    )
    time = np.linspace(0.0, 8.0, 401)
    records = []
    for k, start in enumerate((0.3, 0.7, 1.1)):
        true = Record(
            name=f"run {k}",
            time=1.02 * time,
            inputs={},
            outputs={"angle": np.zeros_like(time)},
            sensors={"angle": Sensor(name="angle", unit="rad", sigma=1e-3)},
            start=StartPrior(mean={"q": start, "v": 0.0}, sd={"q": 0.01, "v": 0.01}),
        )
        job = Jobs(theta=np.array([[0.12]]), starts=np.array([[start, 0.0]]))
        angle = model.simulate(true, job)[0]
        angle = angle + np.random.default_rng(k).normal(0.0, 1e-3, angle.shape)
        records.append(replace(true, time=time, outputs={"angle": angle[:, 0]}))
    effects = library.for_coordinate(model.coordinates[0], force=5.0, travel=1.0, speed=3.0)
    wanted = ("dry friction", "quadratic friction", "cubic stiffness")
    effects = [e for e in effects if e.name.startswith(wanted)]
    result = diagnose(model, effects, records)
    (named,) = result.named
    assert named.cause == "clock of the sensors"
    assert named.low < 0.02 < named.high


@pytest.mark.parametrize("stage", ["search", "held_out"])
@pytest.mark.parametrize("reason", [KeyboardInterrupt, Stop])
def test_an_interrupted_diagnosis_answers_with_what_is_done(spring, causes, stage, reason):
    seen = []

    def interrupt(progress):
        seen.append(progress.stage)
        if progress.stage == stage and seen.count(stage) == 6:
            raise reason

    result = diagnose(spring, causes, three(hardening=3000.0), progress=interrupt)
    assert Reason.NOT_COMPLETE in result.reasons
    assert (Reason.INTERRUPTED in result.reasons) is (reason is KeyboardInterrupt)
    assert not result.complete
    best = result.sets[0]
    assert best.causes == ("hardening",)


@pytest.mark.parametrize("reason", [KeyboardInterrupt, Stop])
def test_without_a_fit_there_is_no_answer(spring, causes, reason):
    def interrupt(progress):
        if progress.stage == "fit":
            raise reason

    with pytest.raises(reason) as end:
        diagnose(spring, causes, three(), progress=interrupt)
    text = "before there was an answer: nothing is kept, and the same command begins anew"
    assert str(end.value).startswith(text) or reason is Stop
    assert end.value.__suppress_context__


def test_no_function_is_told_after_it_has_stopped_the_search(spring, causes):
    told = []

    def stop(progress):
        told.append(progress.stage)
        if progress.stage == "search":
            raise Stop

    result = diagnose(spring, causes, three(hardening=3000.0), progress=stop)
    assert told[-1] == "search"
    assert told.count("search") == 1
    assert [s.causes for s in result.sets] == [()]
    assert result.verdict is Verdict.UNKNOWN


def _stopped(stage):
    """A function that is told the progress, and interrupts in the first step of a stage."""
    seen = []

    def tell(progress):
        seen.append(progress.stage)
        if seen[-2:] == [stage] * 2:
            raise KeyboardInterrupt

    return tell


def _records(*changes, last=3):
    """Records a, b and, held out, c, with what acts in each."""
    (a, b, c) = changes
    return [
        spring_record("a", 2, **a),
        spring_record("b", 5, **b),
        spring_record("c", last, role="held_out", **c),
    ]


HARD = {"hardening": 2000.0}
FOREIGN = {"foreign": 1.0}
#: Each reason: what acts in the records, number of half cycles of the held-out one, what else.
REASONS = {
    Reason.NOISE_NOT_STATED: ((HARD, HARD, HARD), 3, {}),
    Reason.DIFFERS_BETWEEN_RECORDS: (
        [{"hardening": h} for h in (7000.0, 5000.0, 6000.0)], 3, {},
    ),
    # At rest, a force remains that no model has: the mean predicts better.
    Reason.WORSE_THAN_MEAN: ((HARD, HARD, {"preload": 0.6}), 0, {}),
    # At rest, nothing is to be predicted.
    Reason.NO_HELD_OUT_GAIN: ((HARD, HARD, {}), 0, {}),
    Reason.NOT_PREDICTED: ((HARD, HARD, HARD), 3, {"progress": _stopped("held_out")}),
    Reason.CALIBRATION_PREDICTS_WORSE: ((FOREIGN, FOREIGN, {}), 3, {}),
    Reason.NOTHING_INSIDE: ((HARD, HARD, HARD), 3, {}),
    Reason.NOT_COMPLETE: ((HARD, HARD, HARD), 3, {"options": Options(seconds=1e-6)}),
    Reason.INTERRUPTED: ((HARD, HARD, HARD), 3, {"progress": _stopped("search")}),
}  # fmt: skip


@pytest.mark.parametrize("reason", Reason)
def test_each_reason_is_reached_by_a_diagnosis(spring, causes, reason):
    changes, last, options = REASONS[reason]
    records = _records(*changes, last=last)
    if reason is Reason.NOISE_NOT_STATED:
        silent = {"force": Sensor(name="force", unit="N")}
        records = [replace(r, sensors=silent) for r in records]
    if reason is Reason.CALIBRATION_PREDICTS_WORSE:
        k = Parameter(name="k", value=100.0, sd=5.0, unit="N/m")
        spring = spring.with_parameters({"k": k})
    if reason is Reason.NOTHING_INSIDE:
        causes = ["sensor force"]
    if reason is Reason.WORSE_THAN_MEAN:  # else it is told in c
        causes = [e for e in causes if e.name != "preload"]
    result = diagnose(spring, causes, records, **options)
    assert reason in result.reasons
    if reason is Reason.NO_HELD_OUT_GAIN:  # a record at rest does not refuse the right cause
        assert [n.cause for n in result.named] == ["hardening"]
    if reason is Reason.WORSE_THAN_MEAN:
        assert not result.reported
        assert result.finding("hardening").left
        assert Reason.DIFFERS_BETWEEN_RECORDS not in result.reasons


def test_a_prediction_that_is_not_better_is_told_even_if_chance_may_do_it(
    spring, causes, monkeypatch
):
    ratio = Ratio(0.1, -0.1, 0.3)
    monkeypatch.setattr("unmodeled.search.verdict.compare", lambda *_: ratio)
    result = diagnose(spring, causes, _records(HARD, HARD, HARD))
    assert [n.cause for n in result.named] == ["hardening"]
    assert Reason.NO_HELD_OUT_GAIN in result.reasons
    assert result.held_out_gain == pytest.approx(np.exp([0.1, -0.1, 0.3]))
