"""What a mechanism makes of records before a fit: useful part, noise, smooth motion."""

import math
from dataclasses import replace

import numpy as np
import pytest

import feltmb
from feltmb.adapters import mechanism_model
from feltmb.adapters.model import resolve
from feltmb.adapters.records import driven as driven_by_force
from feltmb.adapters.records import first_turn
from unmodeled import Options, diagnose
from unmodeled.data import Record, Sensor
from unmodeled.data.smoothing import smooth_record
from unmodeled.errors import DataError, InvalidParameter
from unmodeled.files import check_suffix
from unmodeled.fit import Jobs, including
from unmodeled.loading import load_model
from unmodeled.models.writing import suffixes, write
from unmodeled.search.records import prepare, ready_records, split_records
from unmodeled.search.variation import with_variation

ACTION = feltmb.load_action("steinway45")
FEW = {"tolerances": "let_off_button,felt.03", "channels": "key,hammer", "effects": "camera_skew"}


def at(theta):
    """One simulation at these parameters."""
    return Jobs(theta=theta[None], starts=np.zeros((1, 0)))


@pytest.fixture(scope="module")
def forte():
    """The model's own forte stroke, to its end."""
    run = feltmb.simulate(ACTION, feltmb.load_stroke("forte"), rtol=1e-7, ledger=False)
    time = np.arange(0.0, 0.3, 1e-3)
    outputs = {
        name: np.interp(time, run.time, run[name]) - run[name][0]
        for name in ("key_front.y", "hammer_tip.x")
    }
    return Record(
        name="forte",
        time=time,
        inputs={"force": feltmb.load_stroke("forte").at(time)},
        outputs=outputs,
        sensors={o: Sensor(name=o, unit="m", sigma=2e-5) for o in outputs},
        input_sigma={"force": 0.01},
    )


def test_the_first_turn_is_that_of_the_first_impact():
    time = np.linspace(0.0, 0.4, 401)
    there = np.interp(time, [0.0, 0.1, 0.2, 0.3, 0.4], [0.0, 0.04, 0.01, 0.05, 0.0])
    assert first_turn(time, -there) == pytest.approx(0.1, abs=0.0015)
    there[95:106] = np.nan  # the camera missed it
    assert first_turn(time, there) == pytest.approx(0.1, abs=0.01)
    bad = np.interp(time, [0.0, 0.1, 0.2, 0.3, 0.4], [0.0, 0.04, 0.01, 0.05, 0.0])
    bad[70] = 0.0  # a lost marker
    bad[5:7] = 1.0  # a glitch
    assert first_turn(time, bad) == pytest.approx(0.1, abs=0.002)
    assert first_turn(time, np.minimum(there, 5e-4)) is None  # hardly moves
    assert first_turn(time[:90], there[:90]) is None  # on its way
    assert first_turn(time, np.full(401, np.nan)) is None


def test_records_end_shortly_after_the_impact(forte):
    model, _ = resolve("steinway45", FEW)
    ready = model.ready([forte])
    turn = forte.time[np.argmax(np.abs(forte.outputs["hammer_tip.x"]))]
    assert ready.records[0].time[-1] == pytest.approx(turn + 0.01, abs=2e-3)
    assert "samples after" in ready.notes[0]
    # Without a camera on the hammer the model says when.
    blind = Record(
        name="forte",
        time=forte.time,
        inputs=forte.inputs,
        outputs={"key_front.y": forte.outputs["key_front.y"]},
        sensors={"key_front.y": forte.sensors["key_front.y"]},
    )
    assert model.ready([blind]).records[0].time[-1] == pytest.approx(turn + 0.01, abs=1.5e-3)
    for until, last in (("0.02", turn + 0.02), ("end", forte.time[-1])):
        other, _ = resolve("steinway45", {**FEW, "until": until})
        assert other.ready([forte]).records[0].time[-1] == pytest.approx(last, abs=2e-3)


def test_what_is_ready_stays_as_it_is(forte):
    model, _ = resolve("steinway45", FEW)
    once = model.ready([forte])
    twice = once.model.ready(once.records)
    assert twice.model is once.model
    assert twice.notes == ()
    assert twice.records[0].samples == once.records[0].samples


def test_a_single_record_is_held_out_in_blocks_without_being_cut(forte):
    model, _ = resolve("steinway45", FEW)
    ready = model.ready([forte])
    (fit,), (held,) = split_records(ready.records, None)
    for name, values in ready.records[0].outputs.items():
        seen = [np.isfinite(r.outputs[name]) for r in (fit, held)]
        assert np.array_equal(seen[0], ~seen[1])
        assert 0.4 < np.mean(seen[0]) < 0.7
        assert np.array_equal(fit.outputs[name][seen[0]], values[seen[0]])


@pytest.mark.parametrize("rate", [500.0, 1000.0, 4000.0])
def test_smoothing_takes_noise_and_leaves_the_stroke(rate):
    """Eleven samples at 1 kHz took a staccato stroke with them: 0.2 mm of it."""
    time = np.arange(0.0, 0.1, 1.0 / rate)
    down = 9e-3 / (1.0 + np.exp(-(time - 0.04) / 2.5e-3))
    noise = 2e-6
    noisy = down + noise * np.random.default_rng(2).standard_normal(time.size)
    smooth = smooth_record(time, noisy, noise)
    assert 0.5 * noise < np.std(smooth - noisy) < 1.05 * noise
    wrong = [np.sqrt(np.mean((x - down) ** 2)) for x in (smooth, noisy)]
    bend = [np.sqrt(np.mean(np.diff(x - down, 2) ** 2)) for x in (smooth, noisy)]
    assert wrong[0] < 0.8 * wrong[1]
    if rate > 2000.0:
        assert wrong[0] < 0.5 * wrong[1]
        assert bend[0] < 0.05 * bend[1]  # it is the second derivative that drives
    # It follows the record: a small change of it is a small change of what is left.
    moved = smooth_record(time, noisy + 0.1 * noise * np.cos(300.0 * time), noise)
    assert np.max(np.abs(moved - smooth)) < 0.3 * noise


@pytest.mark.parametrize("even", [True, False])
def test_smoothing_is_strongest_where_a_motion_is_quiet(even):
    """One penalty for the whole record left the noise of its kinks at rest."""
    generator = np.random.default_rng(8)
    time = np.sort(generator.uniform(0.0, 0.2, 400)) if not even else np.arange(400) * 5e-4
    noise = 1e-6
    # At rest, then a constant acceleration of 2 m/s^2, then a knock that ends within 1 ms.
    down = np.maximum(time - 0.08, 0.0) ** 2 + 2e-5 * np.tanh((time - 0.17) / 5e-4)
    smooth = smooth_record(time, down + noise * generator.standard_normal(time.size), noise)
    wrong = (smooth - down) / noise
    parts = [wrong[(time > a) & (time < b)] for a, b in ((0.0, 0.07), (0.09, 0.15), (0.16, 0.18))]
    rms = [float(np.sqrt(np.mean(p**2))) for p in parts]
    assert rms[0] < 0.3
    assert rms[1] < 0.3
    assert rms[2] < 1.0
    # A straight line is left as it is, whatever its slope.
    line = 0.3 + 0.7 * time
    assert np.max(np.abs(smooth_record(time, line, noise) - line)) < 1e-3 * noise


@pytest.mark.parametrize("apart", [1e-3, 1e-6, 1e-11])
def test_smoothing_accepts_samples_that_nearly_coincide(apart):
    """Bursts of a serial port, or random times, made the matrix singular to rounding."""
    generator, noise = np.random.default_rng(3), 1e-6
    time = np.arange(400) * 5e-4
    burst = time.copy()
    burst[2::4] = time[1::4] + apart * 5e-4
    pair = time.copy()
    pair[240] = time[239] + apart * 5e-4
    for at, most in ((time, 0.3), (pair, 0.4), (burst, 0.8)):
        down = np.maximum(at - 0.08, 0.0) ** 2
        smooth = smooth_record(at, down + noise * generator.standard_normal(at.size), noise)
        assert np.sqrt(np.mean((smooth - down) ** 2)) < most * noise


def test_smoothing_within_less_than_rounding_changes_nothing():
    time = np.arange(20) * 1e-3
    for noise in (1e-18, 1e-300):
        assert np.array_equal(smooth_record(time, np.sin(time), noise), np.sin(time))


@pytest.mark.parametrize(
    ("at", "time", "value", "message"),
    [
        (5, 4e-3, 0.0, "time does not increase at sample 5"),
        (5, 5e-3, np.nan, "time or value is not finite at sample 5"),
        (19, np.inf, 0.0, "time or value is not finite at sample 19"),
    ],
)
def test_faults_of_a_record_to_smooth(at, time, value, message):
    times, values = np.arange(20) * 1e-3, np.zeros(20)
    times[at], values[at] = time, value
    with pytest.raises(InvalidParameter, match=message):
        smooth_record(times, values, 1e-6)
    with pytest.raises(InvalidParameter, match="got 20 values at 19 times"):
        smooth_record(times[:-1], values, 1e-6)


def test_a_noisy_motion_drives_the_mechanism_as_the_clean_one():
    """At the true numbers a motion with noise must leave no more than that noise would."""
    model, _ = resolve("steinway45", FEW)
    time = np.arange(0.0, 0.06, 1e-3)
    down = 9e-3 * np.sin(0.5 * np.pi * np.clip((time - 0.01) / 0.045, 0.0, 1.0)) ** 2
    outputs = {o: np.zeros(time.size) for o in model.outputs}
    seen = []
    for noise in (0.0, 2e-6):
        record = Record(
            name="motion",
            time=time,
            input_mode="motion",
            inputs={"displacement": down + noise * np.random.default_rng(1).standard_normal(60)},
            input_sigma={"displacement": 2e-6 if noise else 0.0},
            outputs=outputs,
        )
        seen.append(model.simulate(record, at(np.zeros(2)))[0])
    assert np.all(np.isfinite(seen))
    assert np.max(np.abs(seen[0][:, 1])) > 5e-3  # the hammer is on its way
    assert np.sqrt(np.mean((seen[1] - seen[0]) ** 2, axis=0)) == pytest.approx(0.0, abs=2e-5)


def test_the_noise_of_a_motion_is_estimated_where_it_is_not_told():
    model, _ = resolve("steinway45", FEW)
    time = np.arange(0.0, 0.1, 5e-4)
    down = 9e-3 * np.sin(0.5 * np.pi * np.clip((time - 0.01) / 0.06, 0.0, 1.0)) ** 2
    noisy = down + 1e-5 * np.random.default_rng(1).standard_normal(time.size)
    record = Record(
        name="m",
        time=time,
        input_mode="motion",
        inputs={"displacement": noisy},
        outputs={"key_front.y": -down},
        sensors={"key_front.y": Sensor(name="key_front.y", unit="m", sigma=2e-5)},
    )
    ready = model.ready([record])
    assert ready.records[0].input_sigma["displacement"] == pytest.approx(1e-5, rel=0.2)
    assert "the noise of displacement is not specified" in ready.notes[0]
    told = replace(record, input_sigma={"displacement": 3e-6})
    assert model.ready([told]).records[0].input_sigma["displacement"] == 3e-6


def test_a_variant_of_a_mechanism_takes_its_library():
    model, _ = resolve("steinway45_printed", {"until": "0.02"})
    assert model.until.after_turn == 0.02
    assert model.library.name == "steinway45"


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"rtol": "0"}, "rtol = 0.0"),
        ({"library": "mechanism", "until": "0.01"}, "does not specify the reversal of a stroke"),
        ({"until": "soon"}, "got 'soon', expected a number, or end"),
        ({"until": "-1"}, "until = -1"),
        ({"until": "nan"}, "until = nan"),
        ({"variation": "2"}, "variation = 2"),
        ({"shooting": "multiple"}, "--set shooting: expected channels"),
    ],
)
def test_faults_of_the_settings(settings, message):
    with pytest.raises(InvalidParameter, match=message):
        resolve("steinway45", settings)


def test_faults_in_python():
    with pytest.raises(InvalidParameter, match=r"until = -1\.0 s"):
        mechanism_model(ACTION, until=-1.0)
    assert mechanism_model(ACTION, until=math.inf)[0].until is None


def test_the_noise_of_a_force_is_estimated_where_nothing_is_said(forte):
    model, _ = resolve("steinway45", FEW)
    random = np.random.default_rng(2)
    force = forte.inputs["force"] + 5e-3 * random.standard_normal(forte.samples)
    noisy = replace(forte, inputs={"force": force}, input_sigma={})
    ready = model.ready([noisy])
    assert ready.records[0].input_sigma["force"] == pytest.approx(5e-3, rel=0.25)
    assert any("noise of force" in note for note in ready.notes)
    told = model.ready([replace(noisy, input_sigma={"force": 0.02})])
    assert told.records[0].input_sigma["force"] == 0.02
    exact = model.ready([replace(forte, input_sigma={})])
    assert exact.records[0].input_sigma.get("force", 0.0) < 1e-4
    assert not any("noise of force" in note for note in exact.notes)


def test_what_was_made_part_of_a_model_is_written_with_it(tmp_path):
    """`--include EFFECT -o FILE` was refused."""
    model, effects = resolve("steinway45", {**FEW, "effects": "capstan_height"})
    whole = including(model, effects, [2e-4])
    path = tmp_path / "found.toml"
    check_suffix(path, *suffixes(whole))
    theta = np.append(np.zeros(len(model.parameters)), 3e-4)
    write(whole, path, theta, (), np.zeros(0), provenance="a test")
    point = feltmb.load_action(path).config.surfaces["Kp2"].point[1]
    assert point - ACTION.config.surfaces["Kp2"].point[1] == pytest.approx(3e-4)
    assert "a test" in path.read_text()


@pytest.fixture(scope="module")
def driven():
    """A stroke by its motion: displacement of the key, force of the finger; and the true force."""
    stroke = feltmb.load_stroke("piano")
    run = feltmb.simulate(ACTION, stroke, duration=0.3, rtol=1e-8, ledger=False)
    time = np.arange(600) * 5e-4
    down = np.interp(time, run.time, run["finger.displacement"])
    force = np.interp(time, run.time, run["finger.force"])
    tip = np.interp(time, run.time, run["hammer_tip.x"]) - run["hammer_tip.x"][0]
    random = np.random.default_rng(4)
    sensors = {
        "finger.force": Sensor(name="finger.force", unit="N", sigma=5e-3),
        "hammer_tip.x": Sensor(name="hammer_tip.x", unit="m", sigma=5e-5),
    }
    outputs = {"finger.force": force + 5e-3 * random.standard_normal(time.size)}
    record = Record(
        name="piano",
        time=time,
        input_mode="motion",
        inputs={"displacement": down + 5e-6 * random.standard_normal(time.size)},
        outputs={**outputs, "hammer_tip.x": tip + 5e-5 * random.standard_normal(time.size)},
        sensors=sensors,
        input_sigma={"displacement": 5e-6},
    )
    return record, force


FORCE = {"tolerances": "let_off_button,felt.03", "channels": "force,hammer_tip.x"}


@pytest.fixture(scope="module")
def incomplete(driven):
    """The same stroke; the first sample of the force is missing, so that it cannot drive."""
    record, force = driven
    measured = record.outputs["finger.force"].copy()
    measured[0] = np.nan
    return replace(record, outputs={**record.outputs, "finger.force": measured}), force


def test_a_measured_force_drives_a_record_of_a_motion(driven, incomplete):
    """Under a motion of 5 um of noise, a quarter of the force was used, with 0.5 N of noise."""
    record, _ = driven
    model, _ = resolve("steinway45", {**FORCE, "effects": "camera_skew"})
    ready = model.ready([record])
    own, (kept,) = ready.model, ready.records
    n = kept.samples
    assert kept.input_mode == "force"
    np.testing.assert_array_equal(kept.inputs["force"], record.outputs["finger.force"][:n])
    assert kept.input_sigma == {"force": 5e-3}
    np.testing.assert_array_equal(
        kept.outputs["finger.displacement"], record.inputs["displacement"][:n]
    )
    assert kept.sensors["finger.displacement"].sigma == 5e-6
    assert "finger.force" not in kept.outputs
    (note,) = [w for w in ready.notes if "is measured beside the motion" in w]
    assert note.startswith("piano: finger.force")
    assert set(kept.outputs) == {"finger.displacement", "hammer_tip.x"}
    # The tabulated model, which is the machine, explains the motion within the noise of the force.
    base = own.simulator.whole(kept, own.simulator.base)
    at_finger = own.outputs.index("finger.displacement")
    left = (kept.outputs["finger.displacement"] - base[:, at_finger]) / 5e-6
    problem = with_variation(prepare(ready_records(own, [kept]), (), (), Options()))
    columns = problem.fit[0].modes[:n, problem.channels.index(at_finger)] / 5e-6
    unit = np.eye(columns.shape[1])
    z = np.linalg.solve(columns.T @ columns + unit, columns.T @ left)
    cost = np.sum((left - columns @ z) ** 2) + z @ z
    assert cost == pytest.approx(left.size, abs=4.0 * np.sqrt(2.0 * left.size))
    # A ready record and an incomplete force stay as they are.
    for other in (kept, kept.cut(0, 100)):
        assert driven_by_force([other]) == ((other,), ())
    others, (why,) = driven_by_force([record, incomplete[0]])
    assert others == (record, incomplete[0])
    assert "cannot drive the model (piano: 1 of 600 samples are missing)" in why
    # The force that drives is no output, although the file has the column once for both.
    force = {"force": record.outputs["finger.force"]}
    both = replace(record, input_mode="force", inputs=force, input_sigma={"force": 5e-3})
    (single,), (note,) = driven_by_force([both])
    assert set(single.outputs) == {"hammer_tip.x"}
    assert "finger.force drives the model and is therefore not compared" in note
    (same,) = model.ready([both]).records
    assert set(same.outputs) == {"hammer_tip.x"}


def test_a_file_with_motion_and_force_is_driven_by_the_force(driven, tmp_path):
    """Units of the inputs named the displacement, which was no input any more."""
    record, _ = driven
    columns = {
        "time [s]": record.time,
        "displacement [mm]": 1e3 * record.inputs["displacement"],
        "finger.force [N]": record.outputs["finger.force"],
        "hammer_tip.x [mm]": 1e3 * record.outputs["hammer_tip.x"],
    }
    table = np.column_stack(list(columns.values()))
    path = tmp_path / "piano.csv"
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")
    sheet = 'name = "piano"\ninput_mode = "motion"\ntime = "time"\n[inputs.displacement]\n'
    sheet += 'unit = "mm"\nsigma = 5e-6\n[outputs."finger.force"]\nunit = "N"\n'
    (tmp_path / "piano.toml").write_text(sheet + '[outputs."hammer_tip.x"]\nunit = "mm"\n')
    adapter = load_model("steinway45", {"channels": "hammer_tip.x,force"})
    (read,) = adapter.read([path])
    (kept,) = adapter.model.ready([read]).records
    assert (kept.input_mode, kept.input_units) == ("force", {"force": "N"})
    assert kept.sensors["finger.displacement"].sigma == 5e-6
    np.testing.assert_allclose(
        kept.outputs["finger.displacement"],
        record.inputs["displacement"][: kept.samples],
        atol=1e-10,
    )
    assert set(kept.outputs) == {"finger.displacement", "hammer_tip.x"}


def test_what_is_known_of_both_sensors_is_kept(driven):
    record, _ = driven
    model, _ = resolve("steinway45", {**FORCE, "effects": "camera_skew"})

    def changed(**more):
        sensor = replace(record.sensors["finger.force"], **more)
        return replace(record, sensors={**record.sensors, "finger.force": sensor})

    with pytest.raises(DataError, match="force is in mN, in the model steinway45 in N"):
        diagnose(model, (), [changed(unit="mN")])
    (coarse,), _ = driven_by_force([changed(sigma=1e-3, quantum=0.1)])
    assert coarse.input_sigma["force"] == pytest.approx(math.hypot(1e-3, 0.1 / math.sqrt(12.0)))
    (exact,), _ = driven_by_force([replace(record, input_sigma={"displacement": 0.0})])
    assert exact.sensors["finger.displacement"].sigma is None  # it is estimated
    (same,), (note,) = driven_by_force([changed(gain_sd=0.01)])
    assert same.input_mode == "motion"
    assert "piano: an input has no gain_sd" in note
    # Known errors are removed, as in an input of a file.
    measured = record.outputs["finger.force"]
    late = replace(record, outputs={**record.outputs, "finger.force": 0.1 + 2.0 * measured})
    sensor = replace(record.sensors["finger.force"], gain=2.0, offset=0.1, delay=0.01, sigma=0.01)
    late = replace(late, sensors={**record.sensors, "finger.force": sensor})
    (true,), _ = driven_by_force([late])
    assert true.input_mode == "force"
    np.testing.assert_allclose(true.inputs["force"][:-20], measured[20:], atol=1e-9)
    assert true.input_sigma == {"force": pytest.approx(5e-3)}
    # A part of a record keeps the force of the samples before it.
    (part,), _ = driven_by_force([late.cut(100, 400)])
    np.testing.assert_allclose(part.inputs["force"][:-20], measured[120:400], atol=1e-9)
    np.testing.assert_allclose(part.before.inputs["force"], measured[20:120], atol=1e-9)
    still = replace(record, outputs={**record.outputs, "finger.force": np.zeros(600)})
    assert "it is constant" in driven_by_force([still])[1][0]


def test_the_effect_of_a_wrong_force_is_the_same_in_a_record_of_its_motion(driven):
    """Gain of the force sensor: the same sensitivity as of a record with the force as input."""
    record, _ = driven
    model, effects = resolve("steinway45", {**FORCE, "effects": "input_gain"})
    ready = model.ready([record])
    (kept,) = ready.records
    (gain,) = effects
    theta = np.zeros(len(ready.model.parameters))

    def outputs(record):
        return ready.model.simulate(record, at(theta))[0]

    shown = kept.with_inputs({"force": kept.inputs["force"] / 1.02})
    moved = outputs(kept.with_inputs(gain.excite(kept, 0.02)))
    np.testing.assert_allclose(moved, outputs(shown), atol=1e-9, equal_nan=True)
    assert np.max(np.abs(moved - outputs(kept))) > 1e-5


def test_the_noise_of_a_motion_is_carried_into_its_force(incomplete):
    """A null left 2.4 times the expected sum of squares, and its diagnosis did not end."""
    record, force = incomplete
    model, _ = resolve("steinway45", {**FORCE, "effects": "camera_skew"})
    ready = model.ready([record])
    own, (kept,) = ready.model, ready.records
    used = np.isfinite(kept.outputs["finger.force"])
    turn = first_turn(record.time, record.outputs["hammer_tip.x"])
    assert not used[kept.time > turn].any()
    assert 0.2 < np.mean(used[kept.time <= turn]) < 0.9
    # The error that the tabulated mechanism really has with this motion.
    simulated = own.simulator.whole(kept, own.simulator.base)[:, own.outputs.index("finger.force")]
    error = np.sqrt(np.mean((simulated - force[: kept.samples])[used] ** 2))
    sigma = kept.sensors["finger.force"].sigma
    assert error > 5e-3
    assert sigma == pytest.approx(math.hypot(5e-3, error), rel=0.25)
    assert kept.sensors["hammer_tip.x"].sigma == 5e-5
    (note,) = [n for n in ready.notes if "displacement has a noise of 5e-06 m" in n]
    assert "are not used" in note
    # What is ready stays as it is.
    (again,) = own.ready([kept]).records
    assert again.sensors["finger.force"].sigma == sigma
    assert np.array_equal(np.isfinite(again.outputs["finger.force"]), used)
    (fresh,) = own.ready([record]).records
    assert fresh.sensors["finger.force"].sigma == sigma


def test_the_force_of_a_key_at_rest_is_not_used(incomplete):
    record, _ = incomplete
    model, _ = resolve("steinway45", {**FORCE, "effects": "camera_skew"})
    still = record.with_inputs(
        {"displacement": 5e-6 * np.random.default_rng(1).standard_normal(record.samples)}
    )
    (kept,), notes = model.ready([still]).records, model.ready([still]).notes
    assert not np.isfinite(kept.outputs["finger.force"]).any()
    assert np.isfinite(kept.outputs["hammer_tip.x"]).all()
    assert any("100% of the samples are not used" in n for n in notes)


def test_a_planned_motion_has_the_error_of_its_force(incomplete):
    """Its input has no noise yet, but its sensor will have."""
    record, force = incomplete
    force = np.where(np.isfinite(record.outputs["finger.force"]), force, np.nan)
    model, _ = resolve("steinway45", {**FORCE, "effects": "camera_skew"})
    smooth = smooth_record(record.time, record.inputs["displacement"], 5e-6)
    planned = replace(
        record, inputs={"displacement": smooth}, outputs={**record.outputs, "finger.force": force}
    )
    sigma = [model.ready([r]).records[0].sensors["finger.force"].sigma for r in (record, planned)]
    assert sigma[1] == pytest.approx(sigma[0], rel=0.25)


def test_a_motion_without_a_noise_or_a_force_stays_as_it_is(incomplete):
    record, _ = incomplete
    model, _ = resolve("steinway45", {**FORCE, "effects": "camera_skew"})
    for other in (
        replace(record, input_sigma={"displacement": 0.0}),
        replace(
            record,
            outputs={"hammer_tip.x": record.outputs["hammer_tip.x"]},
            sensors={"hammer_tip.x": record.sensors["hammer_tip.x"]},
        ),
    ):
        (kept,) = model.ready([other]).records
        for name, sensor in kept.sensors.items():
            assert sensor.sigma == record.sensors[name].sigma
        for name, values in kept.outputs.items():
            assert np.array_equal(values, other.outputs[name][: kept.samples], equal_nan=True)


def test_tolerances_are_names_patterns_or_entries():
    names = ["let_off_button", "felt.0[12]"]
    model, _ = mechanism_model(ACTION, tolerances=names, effects=["camera_skew"])
    own = [p.name for p in model.parameters]
    assert own[:2] == ["let_off_button", "felt.02"]
    again, _ = mechanism_model(ACTION, tolerances=model.tolerances, effects=["camera_skew"])
    assert [p.name for p in again.parameters] == own
    none, _ = mechanism_model(ACTION, tolerances=[], effects=["camera_skew"])
    assert none.tolerances == ()
    for what in ("tolerances", "effects", "channels"):
        with pytest.raises(InvalidParameter, match=rf"{what}=\['key'\]"):
            mechanism_model(ACTION, **{what: "key"})
