"""What a testing machine adds: the frame, the limit and the drift of the load cell, its speed."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from feltmb.cli.felt import command
from feltmb.felt import measured_loop, read_measured_loop, read_specimen
from feltmb.fiber import read_compression
from unmodeled.data import ReadOptions
from unmodeled.errors import DataError, InvalidParameter

TOP, SLACK, SHARE = 1e-3, 0.35e-3, 1.6
#: Loss of loading 2e8 e^2.3 with unloading of the share (e / top)^1.6.
LOSS = 1.0 - 3.3 / (3.3 + SHARE)


def loop(count=1, n=200, noise=0.05, seed=0):
    """Displacement [m] and force [N] of cycles with free parts between them."""
    up = np.linspace(-SLACK, TOP, n)
    e = np.concatenate([np.concatenate([up, up[::-1][1:]]) for _ in range(count)])
    falling = np.tile(np.arange(2 * n - 1) >= n, count)
    positive = np.maximum(e, 0.0)
    force = 2e8 * positive**2.3 * np.where(falling, (positive / TOP) ** SHARE, 1.0)
    return e + SLACK, force + noise * np.random.default_rng(seed).standard_normal(e.size)


def write(path, x, force, head="displacement [mm],force [N]", *more):
    rows = zip(1e3 * x, force, *more, strict=True)
    path.write_text(head + "\n" + "\n".join(",".join(f"{v:.7g}" for v in r) for r in rows) + "\n")
    return path


@pytest.mark.parametrize("noise", [0.0, 0.05])
@pytest.mark.parametrize("limit", [0.6, 0.9])
def test_a_load_cell_at_its_limit_is_no_law(tmp_path, limit, noise):
    x, force = loop(noise=noise)
    cut = np.minimum(force, limit * 25.0)
    with pytest.raises(InvalidParameter, match="the load cell is at its limit"):
        measured_loop(x, cut)
    path = write(tmp_path / "cut.csv", x, cut)
    with pytest.raises(DataError, match=r"cut\.csv: .*the force stays at"):
        read_measured_loop(path)
    with pytest.raises(DataError, match=r"the load cell is at its limit"):
        read_compression(path, v_f0=0.2, thickness0=6e-3, area=4e-4)


@pytest.mark.parametrize("step", [0.01, 0.5])
def test_steps_of_a_converter_are_no_limit(step):
    x, force = loop(n=1000, noise=0.0)
    assert measured_loop(x, step * np.round(force / step), zero=SLACK).loss > 0.0


def test_a_hold_at_the_largest_force_is_no_limit():
    """The force is held, and the felt creeps; then it falls at once."""
    x, force = loop()
    top = int(np.argmax(x))
    creep = x[top] + 4e-5 * (1.0 - np.exp(-np.arange(100) / 30.0))
    x = np.concatenate([x[: top + 1], creep, creep[-1] + x[top + 1 :] - x[top]])
    force = np.concatenate([force[: top + 1], np.full(100, force[top]), force[top + 1 :]])
    assert measured_loop(x, force, zero=SLACK).envelope.loading[-1] > 24.0


@pytest.mark.parametrize("seeds", [3, pytest.param(20, marks=pytest.mark.slow)])
@pytest.mark.parametrize("drift", [0.5, -0.1])
def test_a_drift_of_the_load_cell_does_not_move_the_loss(drift, seeds):
    """0 of 15 losses were within two standard uncertainties."""
    errors = []
    for seed in range(seeds):
        x, force = loop(3, seed=seed)
        found = measured_loop(x, force + drift * np.linspace(0.0, 1.0, x.size))
        (note,) = (n for n in found.notes if "the load cell drifts" in n)
        assert float(note.split("by ")[1].split(" N")[0]) == pytest.approx(drift, rel=0.25)
        errors.append((found.loss - LOSS) / found.uncertainty.loss)
        own = found.cycles[0]
        errors.append((own.loss - LOSS) / own.sd)
    assert np.mean(np.abs(errors) < 2.0) > 0.85


def test_a_load_cell_without_drift_is_left_alone():
    assert not any("drifts" in note for note in measured_loop(*loop(2)).notes)


def test_cycles_of_other_speeds_are_no_repetitions(tmp_path):
    x, force = loop(3, n=100)
    n = x.size // 3
    steps = np.repeat([0.1, 0.1, 0.001], n)
    force[2 * n :] *= 1.2  # the felt is stiffer in a fast cycle
    path = write(
        tmp_path / "speeds.csv", x, force, "displacement [mm],force [N],time [s]", np.cumsum(steps)
    )
    found = read_measured_loop(path)
    slow = (TOP + SLACK) / (100 * 0.1)
    assert [c.speed for c in found.cycles] == pytest.approx([slow, slow, 100.0 * slow], rel=0.05)
    (note,) = (text for text in found.notes if "speeds" in text)
    assert "0.135 to 13.5 mm/s" in note
    assert found.uncertainty.cycles == 2
    assert found.uncertainty.loading[-1] < 0.2
    out = CliRunner().invoke(command, ["contact", str(path)])
    assert "speed [mm/s]" in out.output
    assert not any("speeds" in text for text in measured_loop(x, force).notes)


@pytest.mark.parametrize("blank", [False, True])
def test_the_frame_of_the_machine_is_subtracted(tmp_path, blank):
    """A frame that yields by 10 um/N hides a part of the loss."""
    compliance = 1e-5
    x, force = loop(n=300, noise=0.0)
    path = write(tmp_path / "soft.csv", x + compliance * force, force)
    frame = compliance
    if blank:
        loads = np.concatenate([np.linspace(0.0, 30.0, 100), np.linspace(30.0, 0.0, 100)])
        noise = 1e-7 * np.random.default_rng(1).standard_normal(200)
        frame = write(tmp_path / "blank.csv", compliance * loads + 2e-3 + noise, loads)
    raw = read_measured_loop(path)
    found = read_measured_loop(path, frame=frame)
    assert raw.loss < LOSS - 0.03
    assert found.loss == pytest.approx(LOSS, abs=2e-3)
    assert found.envelope.closing == pytest.approx(TOP, rel=0.02)
    assert any("deflection of the frame, 0.25" in note for note in found.notes)
    told = f"{1e6 * compliance:g}um/N" if not blank else str(frame)
    out = CliRunner().invoke(command, ["contact", str(path), "--frame", told])
    assert "deflection of the frame, 0.25" in out.output
    specimen = {"v_f0": 0.2, "thickness0": 6e-3, "area": 4e-4}
    stiff = read_compression(path, frame=frame, **specimen)
    assert stiff.v_f.max() == pytest.approx(0.2 / (1.0 - (TOP + SLACK) / 6e-3), rel=1e-3)


def test_faults_of_a_frame_are_told(tmp_path):
    x, force = loop()
    path = write(tmp_path / "a.csv", x, force)
    short = write(tmp_path / "blank.csv", np.linspace(0.0, 1e-4, 20), np.linspace(0.0, 10.0, 20))
    with pytest.raises(DataError, match=r"blank record goes to 10 N, and the test to 25"):
        read_measured_loop(path, frame=short)
    with pytest.raises(DataError, match="frame = -1e-06 m/N, expected a compliance >= 0"):
        read_measured_loop(path, frame=-1e-6)
    result = CliRunner().invoke(command, ["contact", str(path), "--frame", "3N"])
    assert "--frame" in str(result.exception) or "--frame" in result.output


RAW = {
    "columns": {"displacement": "steps", "force": "counts", "time": "millis"},
    "units": {"time": "ms"},
    "scales": {"displacement": "5 um", "force": "28uN"},
}


def raw_files(folder, compliance):
    """Steps and counts without units; the counts fall in compression. Their blank record."""
    steps, count = 5e-6, 28e-6
    x, force = loop(noise=0.0)
    rows = np.column_stack([np.arange(x.size), (x + compliance * force) / steps, -force / count])
    test, blank = folder / "rig.csv", folder / "blank.csv"
    rows += [0.0, 0.0, -71350.0]
    np.savetxt(test, rows, "%.6f", ",", header="millis,steps,counts", comments="")
    loads = np.linspace(0.0, 30.0, 50)
    rows = np.column_stack([compliance * loads / steps + 600.0, -loads / count])
    np.savetxt(blank, rows, "%.6f", ",", header="steps,counts", comments="")
    return test, blank


def test_raw_readings_have_a_scale_and_the_blank_record_has_it_too(tmp_path):
    test, blank = raw_files(tmp_path, 1e-5)
    found = read_measured_loop(test, frame=blank, options=ReadOptions(**RAW))
    assert found.loss == pytest.approx(LOSS, abs=2e-3)
    assert found.envelope.closing == pytest.approx(TOP, rel=0.02)
    assert found.cycles[0].speed == pytest.approx((TOP + SLACK) / 0.2, rel=0.05)
    in_contact = ReadOptions(**RAW, origins={"force": "-71350"})
    specimen = read_specimen(test, options=in_contact)
    assert specimen.force[:50] == pytest.approx(np.zeros(50), abs=1e-6)
    assert specimen.force.max() == pytest.approx(25.1, rel=5e-3)


def test_raw_readings_on_the_command_line_and_in_a_file_of_their_own(tmp_path):
    test, blank = raw_files(tmp_path, 1e-5)
    told = ["--column", "displacement=steps,force=counts,time=millis", "--unit", "time=ms"]
    told += ["--scale", "displacement=5um,force=28uN", "--frame", str(blank), "--json"]
    by_options = CliRunner().invoke(command, ["contact", str(test), *told])
    text = 'time = "millis"\ntime_unit = "ms"\n[outputs.displacement]\ncolumn = "steps"\n'
    text += 'scale = "5um"\n[outputs.force]\ncolumn = "counts"\nscale = "28uN"\n'
    test.with_suffix(".toml").write_text(text)
    blank.with_suffix(".toml").write_text(text[text.index("[") :])
    by_file = CliRunner().invoke(command, ["contact", str(test), "--frame", str(blank), "--json"])
    assert json.loads(by_options.stdout) == json.loads(by_file.stdout)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"scales": {"force": "28uN"}}, r"steps states no unit; .*--scale displacement=SIZE"),
        ({"scales": {"displacement": "5s", "force": "28uN"}}, "scale of displacement: unit 's'"),
        ({"scales": {"displacement": "0", "force": "28uN"}}, "scale of displacement = 0"),
        ({"origins": {"force": "start"}}, "origin of force: got 'start', expected a finite number"),
        ({"origins": {"forse": "3"}}, "forse: is no quantity of a compression test"),
        ({"columns": {**RAW["columns"], "time": "clock"}}, "no column 'clock' for time"),
        ({"missing": (-9999.0,)}, "missing: is not used in a compression test"),
    ],
)
def test_faults_of_raw_readings_are_told(tmp_path, changed, message):
    test, _ = raw_files(tmp_path, 1e-5)
    with pytest.raises(DataError, match=message):
        read_measured_loop(test, options=ReadOptions(**{**RAW, **changed}))
