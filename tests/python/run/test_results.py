"""Runs: names and units of the data, saving, loading, never overwriting, nothing left behind."""

import h5py
import numpy as np
import pytest

import feltmb
from feltmb.run.sound import difference, sampled
from unmodeled.files import write_file


@pytest.fixture(scope="module")
def action(rigid):
    """Rigid members: these tests are not about the members."""
    return rigid


@pytest.fixture(scope="module")
def run(action):
    return feltmb.simulate(action, "forte", duration=0.11)


def same(a, b):
    assert a.names == b.names
    assert a.units == b.units
    assert a.long_names == b.long_names
    for name in ("time", "values", "eta", "end_state"):
        assert np.array_equal(getattr(a, name), getattr(b, name)), name
    for name in ("event_table", "summary", "energy", "stats", "provenance", "coordinates",
                 "status", "message"):  # fmt: skip
        assert getattr(a, name) == getattr(b, name), name


def test_public_names(run, action):
    expected = ["key.lift", "key.angle", "whippen.angle", "jack.angle", "hammer.angle",
                "damper.angle", "finger.force", "string.strike"]  # fmt: skip
    for point in ("hammer_tip", "key_front", "key_back", "whippen", "backcheck"):
        expected += [f"{point}.{c}" for c in ("x", "y", "vx", "vy")]
    for number in range(1, 17):
        expected += [f"contact{number:02d}.{q}" for q in ("force", "compression", "rate")]
    assert set(expected) <= set(run.data.data_vars)
    for name, variable in run.data.data_vars.items():
        assert variable.dims == ("time",)
        assert variable.attrs["units"], name
        assert variable.attrs["long_name"], name
    assert run.data["time"].attrs["units"] == "s"
    assert run.data["hammer.angle"].attrs["units"] == "rad"
    assert run.data["key.lift"].attrs["units"] == "m"
    assert run.coordinates == action.coordinates


def test_samples(run):
    assert run.time[0] == 0.0
    assert run.time[-1] == 0.11
    assert np.diff(run.time) == pytest.approx(1e-4)
    assert np.all(np.isfinite(run.values))


def test_last_sample_is_the_end_even_off_the_grid(action):
    run = feltmb.simulate(action, "forte", duration=0.01234, output_rate=1000.0)
    assert run.time[-1] == 0.01234
    assert len(run.time) == 14


def test_speeds_of_points_are_the_derivative_of_their_places(run):
    for point in ("hammer_tip", "key_front", "backcheck"):
        for c in "xy":
            slope = np.gradient(run[f"{point}.{c}"], run.time)
            speed = run[f"{point}.v{c}"]
            assert np.max(np.abs(slope - speed)[1:-1]) < 0.03 * np.max(np.abs(speed)) + 1e-3


def test_summary_names(run):
    assert {"impact_speed", "rebound_speed", "max_impact_force", "impact_duration",
            "key_travel"} <= set(run.summary)  # fmt: skip
    assert run.summary["rebound_speed"] > 0
    assert run.summary["impact_speed"] > 0


def test_impact_speed_is_that_of_the_nose_of_the_hammer(run):
    i = np.searchsorted(run.time, run.summary["impact_time"])
    assert -run["hammer_tip.vx"][i - 1] == pytest.approx(run.summary["impact_speed"], rel=0.02)


def test_getitem_and_near_names(run):
    assert "hammer.angle" in run
    assert run.unit("finger.force") == "N"
    with pytest.raises(
        feltmb.InvalidParameter, match=r"no output 'hammer\.angel'; near are hammer\.angle"
    ):
        run["hammer.angel"]


def test_round_trip(run, tmp_path):
    path = run.save(tmp_path / "run.nc")
    same(feltmb.load_run(path), run)
    again = feltmb.load_run(path)
    again.save(tmp_path / "again.nc")
    same(feltmb.load_run(tmp_path / "again.nc"), run)


#: Present names of the numbers of a strike -> those of earlier versions.
EARLIER = {
    "max_impact_force": "max_string_force",
    "sampled_impact_force": "sampled_string_force",
    "impact_duration": "string_contact_duration",
}


def test_a_run_with_names_of_earlier_versions(run, tmp_path):
    path = run.save(tmp_path / "run.nc")
    with h5py.File(path, "r+") as file:
        for key in ("summary", "strikes"):
            text = file.attrs[key]
            for now, before in EARLIER.items():
                text = text.replace(now, before)
            file.attrs[key] = text
        assert "max_string_force_time" in file.attrs["summary"]
    same(feltmb.load_run(path), run)


@pytest.mark.parametrize("values", [{"string.kind": "rigid_stop"}, {"string.modes": 1}])
def test_round_trip_without_a_modal_string(action, tmp_path, values):
    run = feltmb.simulate(action.with_values(values), "forte", duration=0.02)
    same(feltmb.load_run(run.save(tmp_path / "run.nc")), run)


def test_round_trip_without_ledger_and_events(action, tmp_path):
    run = feltmb.simulate(action, "forte", duration=0.02, ledger=False, events=False)
    same(feltmb.load_run(run.save(tmp_path / "run.nc")), run)


def test_round_trip_of_a_run_with_many_events(run_of, tmp_path):
    """The table of events is larger than an attribute of HDF5 used to be (64 kB)."""
    run = run_of("repeated", rtol=1e-7)
    assert len(run.events) > 100
    same(feltmb.load_run(run.save(tmp_path / "run.nc")), run)


def test_round_trip_of_another_mechanism(pendulum, tmp_path):
    run = feltmb.simulate(pendulum, feltmb.pulse_stroke(0.5, duration=0.3))
    same(feltmb.load_run(run.save(tmp_path / "run.nc")), run)


def test_never_overwritten_without_force(run, tmp_path):
    path = run.save(tmp_path / "run.nc")
    before = path.read_bytes()
    with pytest.raises(feltmb.FileExists, match="exists already"):
        run.save(path)
    assert path.read_bytes() == before
    run.save(path, force=True)
    (tmp_path / "folder.nc").mkdir()
    with pytest.raises(feltmb.FileExists, match="is a folder"):
        run.save(tmp_path / "folder.nc", force=True)


def test_nothing_left_behind_on_failure(tmp_path):
    def write(path):
        path.write_text("half")
        raise OSError(28, "No space left on device")

    with pytest.raises(feltmb.Error, match="cannot be written: No space left on device"):
        write_file(tmp_path / "run.nc", write)
    assert list(tmp_path.iterdir()) == []

    def interrupted(path):
        path.write_text("half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_file(tmp_path / "run.nc", interrupted)
    assert list(tmp_path.iterdir()) == []


def test_a_half_written_file_is_never_listed_as_a_result(tmp_path):
    def write(path):
        path.write_text("half")  # a process killed here leaves what is there now
        assert list(tmp_path.glob("*.json")) == []

    write_file(tmp_path / "member.json", write)
    assert list(tmp_path.iterdir()) == [tmp_path / "member.json"]


def test_a_failed_write_keeps_the_old_file(tmp_path):
    path = tmp_path / "run.nc"
    path.write_text("old")

    def write(_):
        raise OSError(5, "Input/output error")

    with pytest.raises(feltmb.Error):
        write_file(path, write, force=True)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_files_that_are_no_run(tmp_path):
    with pytest.raises(feltmb.DataError, match="there is no such file"):
        feltmb.load_run(tmp_path / "nothing.nc")
    path = tmp_path / "bad.nc"
    path.write_bytes(b"not a run")
    with pytest.raises(feltmb.DataError, match=r"bad\.nc: is no NetCDF file"):
        feltmb.load_run(path)


def test_a_file_of_another_program(run, tmp_path):
    path = tmp_path / "other.nc"
    run.data.to_netcdf(path, engine="h5netcdf")
    with pytest.raises(feltmb.DataError, match="feltmb_format is None, expected 1"):
        feltmb.load_run(path)


def test_a_damaged_file(run, tmp_path):
    path = run.save(tmp_path / "run.nc")
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(feltmb.DataError):
        feltmb.load_run(path)


def test_provenance(run, action):
    assert run.provenance["hash"] == action.hash
    assert run.provenance["version"] == feltmb.__version__
    assert run.provenance["stroke"]["name"] == "forte"
    assert run.provenance["options"]["rtol"] == 1e-6
    assert run.provenance["toml"] == action.to_toml()


# --- string: displacement and sound --------------------------------------------------------------


def test_displacement_along_the_string(run):
    length = 0.6315
    y = np.linspace(0.0, length, 50)
    shape = run.string_displacement(y)
    assert shape.shape == (len(run.time), 50)
    assert np.max(np.abs(shape[:, [0, -1]])) < 1e-15
    strike = run["string.strike"]
    near = run.string_displacement(0.0694)
    assert np.max(np.abs(near - strike)) < 0.02 * np.max(np.abs(strike))
    with pytest.raises(feltmb.InvalidParameter, match="positions must lie in"):
        run.string_displacement(0.7)


def test_no_string_no_displacement(action):
    run = feltmb.simulate(action.with_values({"string.kind": "rigid_stop"}), "forte", duration=0.01)
    with pytest.raises(feltmb.InvalidParameter, match="no modal string"):
        run.string_displacement(0.1)


@pytest.mark.parametrize("position", [None, 0.3])
def test_wav(run, tmp_path, position):
    import wave

    path = run.write_wav(tmp_path / "run.wav", position=position, rate=22050, slowness=2.0)
    with wave.open(str(path), "rb") as sound:
        assert sound.getnchannels() == 1
        assert sound.getframerate() == 22050
        assert sound.getnframes() == int(0.11 * 2.0 * 22050)
        samples = np.frombuffer(sound.readframes(sound.getnframes()), "<i2")
    assert np.max(np.abs(samples)) == 32000
    with pytest.raises(feltmb.InvalidParameter, match="slowness"):
        run.write_wav(tmp_path / "other.wav", slowness=0.0)


def test_a_file_is_what_other_programs_take_for_netcdf(run, tmp_path):
    """Read by xarray: names in their order, dimensions, units; packed or not, the same numbers."""
    import xarray as xr

    for compress in (True, False):
        path = run.save(tmp_path / f"{compress}.nc", compress=compress)
        read = xr.load_dataset(path, engine="h5netcdf")
        assert list(read.data_vars)[: len(run.names)] == list(run.names)
        for name, variable in run.data.variables.items():
            assert read[name].dims == variable.dims, name
            assert read[name].attrs == variable.attrs, name
            assert np.array_equal(read[name].values, variable.values), name
        assert read["string.eta"].dims == ("time", "mode")
        assert read.attrs["status"] == "done"
        assert read.attrs["message"] == ""
        same(feltmb.load_run(path), run)
    assert (tmp_path / "True.nc").stat().st_size < (tmp_path / "False.nc").stat().st_size


def test_runs_are_saved_side_by_side(run, tmp_path):
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(4) as pool:
        paths = list(pool.map(run.save, [tmp_path / f"{i}.nc" for i in range(8)]))
    for path in paths:
        same(feltmb.load_run(path), run)


def test_samples_of_sounds_of_unequal_length_are_of_one_time():
    time = np.linspace(0.0, 1.0, 4001)
    signal = np.sin(40.0 * time)
    whole = sampled(time, signal, 1000)
    part = sampled(time[:2222], signal[:2222], 1000)
    assert whole.size == 1000
    assert np.max(np.abs(difference(whole, part)[: part.size])) < 1e-12
    slow = sampled(time, signal, 1000, 4.0)
    assert slow[: 4 * 900 : 4] == pytest.approx(whole[:900], abs=1e-12)
