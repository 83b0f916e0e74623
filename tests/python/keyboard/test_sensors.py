"""Sensors of keyboards: samples, truth, score of algorithms, labeled sets, MIDI."""

import itertools
import math
import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from calls import command, refusal, refused

import feltmb
from feltmb.cli.keyboard import command as keyboard
from feltmb.keyboard import (
    Sensor,
    VelocityCurve,
    labeled_strokes,
    load_algorithm,
    load_sensor,
    play,
    read_midi,
    read_set,
    score,
    sensed,
    write_midi,
    write_set,
)
from feltmb.keyboard.algorithms import largest_derivative, model_based
from feltmb.keyboard.gestures import Inversion, Press, gesture, random_gestures, run_all, truth_of
from feltmb.keyboard.midi import MidiNote
from feltmb.keyboard.scoring import LEVELS, Score, level_of
from feltmb.keyboard.strokes import Labeled
from feltmb.keyboard.velocity import measured_curve, read_curve
from unmodeled.errors import Error


@pytest.fixture(scope="module")
def grand():
    return feltmb.load_action("grand_action")


@pytest.fixture(scope="module")
def few():
    """A setup and 8 labeled records of the default sensor."""
    setup, records = labeled_strokes(count=8, seed=3)
    return setup, list(records)


def sensor(**changes):
    return Sensor.model_validate({"schema": 1, "name": "s", "noise": 0.0, "bits": 20, **changes})


# ---------------------------------------------------------------- sensor


def test_counts_give_the_travel_back():
    made = sensor(travel=[0.0, 0.5, 1.1], reading=[0.1, 0.2, 1.0])
    time = np.linspace(0.0, 0.1, 1001)
    counts = made.sample(time, {"hammer": 10.0 * time}, np.random.default_rng(0))
    assert len(counts) == round(0.1 * made.rate)
    np.testing.assert_allclose(made.followed(counts["hammer"]), 10.0 * counts.index, atol=2e-5)


def test_tolerances_are_those_of_each_unit():
    made = sensor(shift=0.01, gain=0.05)
    time = np.array([0.0, 1e-3, 2e-3])
    units = [
        made.followed(made.sample(time, {"hammer": np.full(3, 0.8)}, rng)["hammer"])[0]
        for rng in map(np.random.default_rng, range(300))
    ]
    assert np.mean(units) == pytest.approx(0.8, abs=0.01)
    assert np.std(units) == pytest.approx(math.hypot(0.01, 0.8 * 0.05), rel=0.15)


def test_a_curve_that_falls_again_has_two_branches():
    made = sensor(travel=[0.0, 0.6, 1.1], reading=[0.0, 1.0, 0.2], high=1.2)
    assert "not monotonic" in made.notes[0]
    assert "0 to 0.6 and 0.6 to 1.1" in made.notes[0]
    one, two = made.travel_of(np.array([round(0.5 / 1.2 * (2**20 - 1))]))
    assert one[0] == pytest.approx(0.3, abs=1e-4)
    assert two[0] == pytest.approx(0.9125, abs=1e-4)
    time = np.linspace(0.0, 0.1, 1001)
    there = np.sin(np.pi * time / 0.1)  # to the string and back
    counts = made.sample(time, {"hammer": there}, np.random.default_rng(0))
    wanted = np.sin(np.pi * counts.index / 0.1)
    assert np.abs(made.followed(counts["hammer"]) - wanted).max() < 0.02


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("travel = [0, 1, 0.5]\nreading = [0, 0.5, 1]", ["expected increasing numbers"]),
        ("travel = [0, 1]\nreading = [0, 0.5, 1]", ["2 travels and 3 readings"]),
        ("travel = [0.2, 1]\nreading = [0, 1]", ["got 0.2 to 1, expected from 0"]),
        ("reading = [0.5, 0.5]", ["expected a curve"]),
        ("low = 1\nhigh = 0", ["high: got 0, expected above low"]),
        ("bits = 2\nrate = '3 mm'", ["bits", "rate"]),
        ("at = 'pedal'", ["at"]),
    ],
)
def test_bad_sensors_are_refused(tmp_path, text, parts):
    path = tmp_path / "s.toml"
    path.write_text(f'schema = 1\nname = "s"\n{text}\n')
    refused(lambda: load_sensor(path), str(path), *parts)


def test_the_ideal_sensor_reads_the_motion(grand):
    """Travel 1 is where the hammer meets the string; its slope is the speed of the contact."""
    setup, record = sensed(grand, gesture([Press(0.4, 2.0)]), load_sensor("linear"))
    ((time, speed),) = record.truth
    travel = setup.sensor.followed(record.samples["hammer"])
    now = record.samples.index.to_numpy()
    assert np.interp(time, now, travel) == pytest.approx(1.0, abs=2e-3)
    rows = (now > time - 1e-3) & (now <= time)
    slope = setup.reach * np.polyfit(now[rows], travel[rows], 1)[0]
    assert slope == pytest.approx(speed, rel=0.01)
    assert record.plot(setup).axes[0].get_ylabel() == "counts, 16 bits"


def test_an_upright_and_a_key_sensor():
    upright = feltmb.load_action("steinway45_leaded")
    setup, record = sensed(upright, gesture([Press(0.4, 2.0)]), load_sensor("reflective"))
    assert setup.reach == pytest.approx(45.0e-3, abs=1e-3)
    assert list(record.samples) == ["hammer", "key"]
    found = model_based(record.samples, setup)
    assert found[0][0] == pytest.approx(record.truth[0][0], abs=1e-3)
    assert found[0][1] == pytest.approx(record.truth[0][1], rel=0.06)


# ---------------------------------------------------------------- velocity


def test_velocity_curves():
    curve = VelocityCurve()
    assert [curve.velocity(v) for v in (0.1, 0.25, 1.0, 2.0, 8.0, 20.0)] == [1, 2, 52, 77, 127, 127]
    assert all(curve.velocity(curve.speed(n)) == n for n in range(1, 128))
    own = VelocityCurve([0.3, 1.0, 7.0], [1, 60, 127])
    assert own.velocity(1.0) == 60
    refused(lambda: VelocityCurve([1.0, 0.5], [1, 2]), "speeds", "increasing")
    refused(lambda: VelocityCurve([0.0, 0.5], [1, 2]), "above 0")


def test_a_measured_curve_is_found_again(tmp_path):
    true = VelocityCurve([0.15, 1.0, 6.0], [5, 50, 120])
    rng = np.random.default_rng(0)
    speeds = np.exp(rng.uniform(np.log(0.15), np.log(6.0), 300))
    given = [true.velocity(v * np.exp(rng.normal(0.0, 0.03))) for v in speeds]
    path = tmp_path / "pairs.csv"
    pd.DataFrame({"speed [mm/s]": 1e3 * speeds, "velocity": given}).to_csv(path, index=False)
    found = read_curve(str(path))
    for speed in np.geomspace(0.16, 5.8, 40):
        assert abs(found.velocity(speed) - true.velocity(speed)) <= 1
    assert "5 at 0.15 m/s" in found.ends
    refused(lambda: measured_curve([1.0] * 7, [9] * 7), "got 7 speeds")
    refused(lambda: measured_curve([1.0] * 8, [0] * 8), "got 0, expected")
    refused(lambda: read_curve("Disklavier"), "is unknown", "measure pairs")
    refused(lambda: read_curve("SE290"), "is unknown", "goebl is the map")
    path.write_text("v,velocity\n1,2\n2,3\n")
    refused(lambda: read_curve(str(path)), "got the columns v, velocity")
    path.write_text("speed [m/s],velocity\n")
    refused(lambda: read_curve(str(path)), "got 0 speeds")
    path.write_text("speed [m/s],velocity\n1,2\n2,x\n")
    refused(lambda: read_curve(str(path)), "line 3")


# ---------------------------------------------------------------- strokes


def test_aimed_speeds_are_struck(grand):
    inversion = Inversion(grand)
    wanted = [0.5, 1.0, 2.0, 4.0]
    struck = []
    strokes = [gesture([Press(inversion.finger_speed(v, 2.0), 2.0)]) for v in wanted]
    run_all(grand, strokes, lambda _, run: struck.append(truth_of(run)[0][1]))
    np.testing.assert_allclose(struck, wanted, rtol=0.05)


def test_sets_are_the_same_for_the_same_seed_and_any_number_of_threads(few, tmp_path):
    setup, records = few
    known, again = labeled_strokes(count=3, seed=3, jobs=1)
    again = list(again)
    sets = [tmp_path / "one.parquet", tmp_path / "two.parquet"]
    write_set(sets[0], setup, records[:3])
    write_set(sets[1], known, again)
    assert sets[0].read_bytes() == sets[1].read_bytes()
    for one, two in zip(records[:3], again, strict=True):
        assert one.truth == two.truth
        pd.testing.assert_frame_equal(one.samples, two.samples)
    _, other = labeled_strokes(count=1, seed=4)
    assert next(other).truth != records[0].truth
    path = tmp_path / "set.parquet"
    assert write_set(path, setup, records) == 8
    known, back = read_set(path)
    assert known == setup or known.as_dict() == setup.as_dict()
    for one, two in zip(records, back, strict=True):
        assert (one.kind, one.truth) == (two.kind, two.truth)
        pd.testing.assert_frame_equal(one.samples, two.samples)
    table = pd.read_parquet(path)
    curve = VelocityCurve()
    assert all(
        list(row.velocity) == [curve.velocity(v) for v in row.strike_speed]
        for row in table.itertuples()
    )


def test_a_set_without_parquet_has_the_same_records(few, tmp_path, monkeypatch):
    setup, records = few
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    refused(lambda: write_set(tmp_path / "a.parquet", setup, records), "a file .jsonl needs none")
    path = tmp_path / "set.jsonl"
    assert write_set(path, setup, iter(records)) == 8
    known, back = read_set(path)
    assert known.as_dict() == setup.as_dict()
    for one, two in zip(records, back, strict=True):
        assert (one.kind, one.truth) == (two.kind, two.truth)
        pd.testing.assert_frame_equal(one.samples, two.samples)
    path.write_text("{}\n")
    refused(lambda: read_set(path), "is no set of labeled strokes")


def test_scores_are_shown_also_if_the_picture_cannot_be_written(few, tmp_path, monkeypatch, capsys):
    setup, records = few
    write_set(tmp_path / "set.jsonl", setup, records)
    picture = tmp_path / "score.png"
    arguments = ["score", "largest_derivative", "--set", tmp_path / "set.jsonl", "--plot", picture]

    def run():
        keyboard.main([str(a) for a in arguments], standalone_mode=False)

    picture.write_text("mine")
    with pytest.raises(Error, match="exists already"):  # before anything is computed
        run()
    assert "ppp" not in capsys.readouterr().out
    picture.unlink()

    plain = Score.plot

    def drawn(self):
        picture.write_text("of somebody else")
        return plain(self)

    monkeypatch.setattr(Score, "plot", drawn)
    with pytest.raises(Error, match="exists already"):
        run()
    assert "largest_derivative" in capsys.readouterr().out
    assert picture.read_text() == "of somebody else"


def test_kinds_and_levels_are_all_there(grand):
    """Of the gestures that a set is made of; speeds are even over the logarithm."""
    made = list(random_gestures(Inversion(grand), 2000, 0))
    kinds = pd.Series([g.kind for g in made]).value_counts(normalize=True)
    assert kinds["struck"] == pytest.approx(0.3, abs=0.05)
    assert set(kinds.index) == {"struck", "pressed", "staccato", "repeated", "half return"}
    levels = pd.Series([level_of(v) for g in made for v in g.aimed]).value_counts()
    assert set(levels.index) == set(LEVELS)
    assert levels.min() > 100
    returns = [p.back for g in made for p in g.presses if g.kind == "half return"]
    assert 0.5 <= min(returns) <= max(returns) <= 0.75


def test_bad_calls_and_files_are_refused(tmp_path):
    refused(lambda: labeled_strokes(count=0), "count = 0")
    refused(lambda: labeled_strokes(sensor="ear"), "ear")
    path = tmp_path / "x.parquet"
    path.write_text("x")
    refused(lambda: read_set(path), "is no set of labeled strokes")
    refused(lambda: read_set(tmp_path / "none.parquet"), "there is no such file")


# ---------------------------------------------------------------- score


def fake(*truth, kind="struck"):
    samples = pd.DataFrame({"hammer": [0, 0]}, index=pd.Index([0.0, 1.0], name="time"))
    return Labeled(kind, samples, truth)


def test_the_score_counts():
    records = [
        fake((0.1, 1.0), (0.2, 0.1), (0.3, 3.0)),  # the second is too faint to count
        fake((0.1, 5.0)),
    ]
    told = iter([[(0.101, 1.1), (0.2, 0.1), (0.7, 2.0)], [(0.1, 4.5), (0.112, 4.9)]])
    result = score(lambda *_: next(told), records, None)
    table = result.table
    assert table.loc["all", ["strikes", "missed", "false"]].tolist() == [3, 1, 2]
    assert table.at["p", "speed_mean"] == pytest.approx(10.0)
    assert table.at["p", "time_rms"] == pytest.approx(1.0)
    assert table.at["f", "missed"] == 1
    assert table.at["fff", "speed_rms"] == pytest.approx(10.0)
    assert result.false["speed"].tolist() == [2.0, 4.9]
    assert len(result.plot().axes) == 3


def nothing(*_):
    return None


def throwing(*_):
    raise ZeroDivisionError("a division")


@pytest.mark.parametrize(
    ("algorithm", "part"),
    [
        (nothing, "returned None, expected a list of (time in s, speed in m/s)"),
        (throwing, "ZeroDivisionError: a division, test_sensors.py:"),
        (lambda *_: [(1.0, math.nan)], "expected finite numbers"),
        (lambda *_: [1.0], "expected a list of"),
    ],
)
def test_an_algorithm_that_fails_is_told(algorithm, part):
    with pytest.raises(Error, match="failed in the first 2 records") as caught:
        score(algorithm, [fake((0.1, 1.0))] * 2, None)
    assert part in str(caught.value)


def test_an_algorithm_that_fails_once_misses_that_record():
    calls = itertools.count()

    def sometimes(*_):
        if next(calls) == 1:
            raise ValueError("no")
        return [(0.1, 1.0)]

    result = score(sometimes, [fake((0.1, 1.0))] * 3, None)
    assert len(result.failures) == 1
    assert "record 2: ValueError: no" in result.failures[0]
    assert result.table.at["all", "missed"] == 1
    refused(lambda: score(sometimes, [], None), "got no record")


PROGRAM = """
import csv, json, sys
rows = list(csv.DictReader(open(sys.argv[1])))
assert json.load(open(sys.argv[2]))["sensor"]["bits"] == 12
top = max(rows, key=lambda row: int(row["hammer"]))
print("time,speed")
print(top["time"], 1.0, sep=",")
"""


def test_functions_and_programs_of_the_user(tmp_path, few):
    setup, records = few
    file = tmp_path / "mine.py"
    file.write_text("def find(samples, setup):\n    return [(samples['hammer'].idxmax(), 1.0)]\n")
    name, function = load_algorithm(f"{file}:find")
    own = score(function, records[:3], setup, name=name)
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    _, called = load_algorithm(f"{sys.executable} {program}")
    pd.testing.assert_frame_equal(own.strikes, score(called, records[:3], setup).strikes)
    refused(lambda: load_algorithm(f"{file}:fnd"), "there is no function", "near are find")
    refused(lambda: load_algorithm("modelbased"), "expected largest_derivative or model_based")
    refused(lambda: load_algorithm(f"{tmp_path}/no.py:f"), "there is no such file")
    program.write_text("raise SystemExit('sensor broken')")
    with pytest.raises(Error, match="exit code 1: sensor broken"):
        score(called, records[:2], setup)


STREAMED = """
import sys
known, at, top = {}, 0, (-1, 0)
for line in sys.stdin:
    if line.startswith("# rate="):
        known = dict(word.split("=") for word in line[2:].split())
    elif line[0].isdigit():
        top = max(top, (int(line.split(",")[0]), -at))
        at += 1
print("time,speed")
print(float(known["start"]) - top[1] / float(known["rate"]), 1.0, sep=",")
"""


def test_a_program_reads_a_stream_of_counts(tmp_path, few):
    setup, records = few
    program = tmp_path / "program.py"
    program.write_text(STREAMED)
    _, called = load_algorithm(f"stream:{sys.executable} {program}")
    found = score(called, records[:3], setup).strikes
    own = score(lambda s, _: [(s["hammer"].idxmax(), 1.0)], records[:3], setup).strikes
    pd.testing.assert_frame_equal(found, own)
    refused(lambda: load_algorithm("stream:no_such"), "there is no program no_such")


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_the_example_of_firmware_finds_the_speed(tmp_path, root):
    source, program = root / "examples" / "firmware" / "two_gates.c", tmp_path / "two_gates"
    subprocess.run(["cc", "-O2", "-Wall", "-Werror", source, "-o", program], check=True, timeout=60)
    setup, records = labeled_strokes(sensor="linear", count=4, kinds=["struck", "aftertouch"])
    _, called = load_algorithm(f"stream:{program}")
    strikes = score(called, records, setup).strikes
    loud = strikes[strikes["speed"] > 1.25]
    assert len(loud) >= 2
    assert loud["speed_error"].abs().max() < 0.05
    assert loud["time_error"].abs().max() < 1e-4


def test_strokes_from_within_the_aftertouch_seldom_strike(grand):
    gestures = list(random_gestures(Inversion(grand), 6, 2, ["aftertouch"]))
    strikes = []
    run_all(grand, (g.stroke for g in gestures), lambda _, run: strikes.append(len(truth_of(run))))
    presses = [len(g.presses) for g in gestures]
    assert sum(presses) >= 12
    assert len(gestures) <= sum(strikes) <= len(gestures) + 2
    refused(lambda: list(random_gestures(Inversion(grand), 1, 0, ["after"])), "near are aftertouch")


def test_the_model_based_algorithm_has_half_the_error(few):
    setup, records = few
    simple, better = (score(f, records, setup) for f in (largest_derivative, model_based))
    assert better.table.at["all", "speed_rms"] < 0.5 * simple.table.at["all", "speed_rms"]
    assert better.table.at["all", "strikes"] >= 8
    loud = better.strikes[better.strikes["speed"] > 0.5]
    assert loud["speed_error"].abs().max() < 0.12
    assert loud["time_error"].abs().max() < 1e-3


def test_a_fit_that_needs_a_unit_beyond_its_tolerances_is_no_strike(few):
    """So is told a hammer that turns back before the string."""
    setup, records = few
    record = next(r for r in records if len(r.truth) == 1 and r.truth[0][1] > 0.5)
    samples = record.samples * 0.92
    assert len(model_based(samples, setup)) == 1
    good = setup.sensor.model_copy(update={"gain": 0.003, "shift": 1e-4})
    assert model_based(samples, replace(setup, sensor=good)) == []


@pytest.mark.slow
def test_the_model_based_algorithm_has_half_the_error_at_every_level():
    setup, made = labeled_strokes(count=1000, seed=1)
    records = list(made)
    simple, better = (score(f, records, setup) for f in (largest_derivative, model_based))
    assert (better.table["speed_rms"] < 0.5 * simple.table["speed_rms"]).all()
    assert better.table["strikes"].min() > 30
    assert better.table.at["all", "missed"] < 0.01 * better.table.at["all", "strikes"]


# ---------------------------------------------------------------- MIDI

NOTES = [MidiNote(60, 0.5, 0.7, 30), MidiNote(64, 0.6, 0.9, 100), MidiNote(60, 0.95, 1.2, 64)]


def test_files_of_midi(tmp_path):
    path = write_midi(tmp_path / "a.mid", NOTES)
    back = read_midi(path)
    assert [(n.number, n.velocity) for n in back] == [(n.number, n.velocity) for n in NOTES]
    for one, two in zip(back, NOTES, strict=True):
        assert (one.start, one.end) == pytest.approx((two.start, two.end), abs=1e-3)
    path.write_bytes(path.read_bytes()[:20])
    refused(lambda: read_midi(path), "a.mid")
    empty = write_midi(tmp_path / "b.mid", [])
    refused(lambda: read_midi(empty), "has no note")


def test_a_file_plays_the_action(grand):
    """Velocities come back within 2, strikes at the starts of the notes."""
    played = play(grand, NOTES)
    for p in played:
        assert abs(p.velocity - p.note.velocity) <= 2
        assert p.time == pytest.approx(p.note.start, abs=2e-3)
        assert p.bounces == 0


@pytest.mark.slow
def test_a_longer_file_plays_the_action(grand, tmp_path):
    rng = np.random.default_rng(3)
    starts = 0.5 + np.cumsum(rng.uniform(0.1, 0.4, 24))
    notes = [
        MidiNote(50 + int(k % 7), float(t), float(t + rng.uniform(0.08, 0.4)), int(v))
        for k, (t, v) in enumerate(zip(starts, rng.integers(15, 112, 24), strict=True))
    ]
    played = play(grand, read_midi(write_midi(tmp_path / "a.mid", notes)))
    assert max(abs(p.velocity - p.note.velocity) for p in played) <= 2
    assert max(abs(p.time - p.note.start) for p in played) < 3e-3


# ---------------------------------------------------------------- command line


def test_commands(tmp_path):
    done = command("keyboard", "sensor", "--curve", "0.3m/s=1,7m/s=127", "-o", tmp_path / "s.csv")
    assert done.exit_code == 0, done.output
    assert "MIDI velocity" in done.output
    assert list(pd.read_csv(tmp_path / "s.csv")) == ["time", "hammer", "key"]
    path = tmp_path / "set.parquet"
    assert command("keyboard", "strokes", "--count", 4, "-o", path).exit_code == 0
    done = command("keyboard", "score", "model_based", "--set", path, "--plot", tmp_path / "p.png")
    assert done.exit_code == 0, done.output
    assert "4 records" in done.output
    assert "no such file" in refusal("keyboard", "play", tmp_path / "none.mid")
    assert "expected goebl, SPEED=VELOCITY" in refusal("keyboard", "sensor", "--curve", "3")
    done = command("keyboard", "stream", "--count", 1)
    head, *_, last = done.output.splitlines()
    assert head.startswith("# rate=8000 start=")
    assert float(last.removeprefix("# ").split(",")[1]) > 0.1
