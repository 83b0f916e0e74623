"""Saved runs with damaged tables, arrays and texts; starts and interruptions."""

import json
import signal
import sys
import threading
import tomllib
from importlib import resources

import h5py
import pytest
from calls import refused, short_strike, stroke_command

import feltmb
from feltmb.graphics.animate import animate
from feltmb.mechanism import Action


@pytest.fixture(scope="module")
def pendulum():
    """The mechanism that ``feltmb new`` writes."""
    text = (resources.files("feltmb") / "params" / "template.toml.txt").read_text("utf-8")
    return Action(tomllib.loads(text), "template.toml")


def test_interrupted_jobs_keep_what_was_finished(tmp_path, monkeypatch):
    # strokes finished by the other threads were lost if the first was still running
    strikes = [short_strike(tmp_path / f"{n}.toml", n) for n in ("long", "short")]
    short_done = threading.Event()
    simulate = feltmb.simulate

    def interrupted(action, stroke, *args, **kwargs):
        if stroke.name == "long":
            short_done.wait(20)
            raise KeyboardInterrupt
        run = simulate(action, stroke, *args, **kwargs)
        short_done.set()
        return run

    monkeypatch.setattr(sys.modules["feltmb.run.simulate"], "simulate", interrupted)
    out = tmp_path / "out"
    assert stroke_command("steinway45", *strikes, "--out", out, "--jobs", 2) == 130
    assert [p.name for p in out.iterdir()] == ["short.nc"]


@pytest.mark.parametrize(
    ("attribute", "value"),
    [
        ("stats", "{}"),
        ("provenance", "[]"),
        ("events", '{"event": [1], "time": []}'),
        # passed; the plots and the viewer failed on them with a traceback
        ("events", '{"event": ["a"], "time": ["x"]}'),
        ("events", '{"event": 1}'),
        ("summary", '{"impact_speed": "x"}'),
        ("provenance", '{"stroke": 3}'),
        ("coordinate_names", "1"),
        ("stats", '{"reached": "1"}'),
        ("stats", "[" * 3000),
        ("feltmb_format", [1.0, 1.0]),  # ValueError: truth value of an array
        ("feltmb_format", []),
    ],
)
def test_runs_with_damaged_tables(pendulum, tmp_path, attribute, value):
    # read without complaint; KeyError, AttributeError, ValueError when they were used
    path = feltmb.simulate(pendulum, "staccato", 0.001).save(tmp_path / "run.nc")
    with h5py.File(path, "a") as file:
        file.attrs[attribute] = value
    refused(lambda: feltmb.load_run(path), "run")


@pytest.mark.parametrize(
    ("name", "values"),
    [("string.eta", [1.0, 2.0]), ("time", 3.0), ("end_state", "x"), ("arm.angle", [[1.0]])],
)
def test_runs_with_damaged_arrays(pendulum, tmp_path, name, values):
    # IndexError of h5netcdf, ValueError of xarray
    path = feltmb.simulate(pendulum, "staccato", 0.001).save(tmp_path / "run.nc")
    with h5py.File(path, "a") as file:
        name = name if name in file else next(n for n in file if n.endswith(".angle"))
        del file[name]
        file[name] = values
    refused(lambda: feltmb.load_run(path), "is no complete run")


def test_a_run_beyond_reason_is_refused_before_it_is_read(pendulum, tmp_path):
    # a file of some kB that unpacks to more memory than there is
    path = feltmb.simulate(pendulum, "staccato", 0.001).save(tmp_path / "run.nc")
    with h5py.File(path, "a") as file:
        file.create_dataset("large", shape=(10**12,), chunks=(10**6,), dtype="f8")
    refused(lambda: feltmb.load_run(path), "the limit of a run is 100000000")


def test_text_that_is_none_in_a_run(pendulum, tmp_path):
    # UnicodeEncodeError when it was printed or saved again
    path = feltmb.simulate(pendulum, "staccato", 0.001).save(tmp_path / "run.nc")
    with h5py.File(path, "a") as file:
        del file.attrs["status"]
        file.attrs["status"] = b"\xff"
    run = feltmb.load_run(path)
    run.status.encode("utf-8")
    run.save(tmp_path / "again.nc")


@pytest.mark.parametrize(
    "text",
    [
        "a" + ".a" * 200_000 + "=1",  # hung
        "contacts = 5\n[reading]\nstrike_contact = 6\n",  # tracebacks of the plots
        "[contacts.06]\nsurfaces = 5\n[reading]\nstrike_contact = 6\n",
        None,  # another mechanism
    ],
)
def test_another_text_in_the_place_of_the_mechanism(pendulum, tmp_path, text):
    """Pictures of the run do without it; what needs the mechanism is refused."""
    run = feltmb.simulate("steinway45", "staccato", duration=0.02)
    path = run.save(tmp_path / "run.nc")
    with h5py.File(path, "a") as file:
        table = json.loads(file.attrs["provenance"])
        file.attrs["provenance"] = json.dumps(table | {"toml": text or pendulum.to_toml()})
    loaded = feltmb.load_run(path)
    assert loaded.plot().axes
    feltmb.view(loaded, tmp_path / "run.html")
    with pytest.raises(feltmb.Error) as error:
        animate(loaded, tmp_path / "run.gif")
    assert len(str(error.value)) < 2000


def test_damaged_metadata_of_hdf5(tmp_path, monkeypatch):
    # RuntimeError: Link iteration failed (incorrect metadata checksum after all read attempts)
    def fail(*_args, **_options):
        raise RuntimeError("Link iteration failed")

    monkeypatch.setattr(h5py, "File", fail)
    (tmp_path / "run.nc").write_bytes(b"something")
    refused(lambda: feltmb.load_run(tmp_path / "run.nc"), "is no NetCDF file", "Link iteration")
    (tmp_path / "run.nc").write_bytes(b"")
    refused(lambda: feltmb.load_run(tmp_path / "run.nc"), "is no NetCDF file", "is empty")


@pytest.mark.parametrize(
    "options",
    [
        {"slowness": float("nan")},
        {"slowness": 1e15},
        {"rate": 2**33},
        {"position": float("nan")},
    ],
)
def test_sounds_out_of_range(run_of, tmp_path, options):
    # ValueError, MemoryError, struct.error; a NaN was written as a sound
    refused(lambda: run_of("forte").write_wav(tmp_path / "x.wav", **options))


def test_restart_from_something_else(action, pendulum):
    # AttributeError: 'str' object has no attribute 'coordinates'
    refused(lambda: feltmb.simulate(action, "forte", start="run.nc"), "expected a Run or a mapping")
    # accepted in silence
    first = feltmb.simulate(pendulum, "staccato", 0.001)
    other = pendulum.with_values({"bodies.hammer.mass": 0.013})
    warnings = feltmb.simulate(other, "staccato", 0.001, start=first).stats["warnings"]
    assert "with other parameters" in warnings[0]


def test_samples_beyond_the_memory(action):
    # up to 5e7 samples were allowed, whatever their number of columns: 42 GB for this one
    refused(lambda: feltmb.simulate(action, "forte", output_rate=1e8), "samples of ", "limit")


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no timers of the system")
def test_errors_of_signal_handlers_come_through(action):
    # any error of a handler became KeyboardInterrupt
    def expire(*_arguments):
        raise TimeoutError("time is up")

    before = signal.signal(signal.SIGALRM, expire)
    signal.setitimer(signal.ITIMER_REAL, 0.1)
    try:
        with pytest.raises(TimeoutError, match="time is up"):
            feltmb.simulate(action, "repeated", rtol=1e-12)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
