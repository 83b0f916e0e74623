"""One test a bug that was found in use; the comment says how it showed."""

import dataclasses
import importlib.metadata
import signal
import subprocess
import sys
import threading
import tomllib
from importlib import resources
from pathlib import Path

import h5py
import numpy as np
import pytest

import feltmb
from feltmb.cli import main
from feltmb.contact import law
from feltmb.files import check_writable, write_text
from feltmb.mechanism import Action
from feltmb.run.study import load_study
from feltmb.run.study.expression import Formula


@pytest.fixture(scope="module")
def pendulum():
    """The mechanism that ``feltmb new`` writes."""
    text = (resources.files("feltmb") / "params" / "template.toml.txt").read_text("utf-8")
    return Action(tomllib.loads(text), "template.toml")


def refused(call, *parts):
    """Message of the InvalidParameter that ``call`` raises."""
    with pytest.raises(feltmb.InvalidParameter) as caught:
        call()
    for part in parts:
        assert part in str(caught.value)
    return str(caught.value)


# ---------------------------------------------------------------- numbers and units


def test_integer_beyond_floats(pendulum):
    # OverflowError: int too large to convert to float
    refused(lambda: pendulum.with_values({"bodies.hammer.mass": 10**400}), "finite number")
    refused(
        lambda: pendulum.with_values({"bodies.hammer.center_of_mass": [10**400, 0]}),
        "finite number",
    )


def test_integer_of_thousands_of_digits(tmp_path):
    # ValueError: Exceeds the limit (4300 digits) for integer string conversion
    path = tmp_path / "digits.toml"
    path.write_text("schema = " + "1" * 5000)
    refused(lambda: feltmb.load_action(path), "digits.toml")
    refused(
        lambda: Action({"name": "x"}).with_values(
            dict([feltmb.mechanism.parse_setting("schema=" + "1" * 5000)])
        )
    )


def test_power_of_a_unit_beyond_floats(pendulum):
    # OverflowError: (34, 'Numerical result out of range')
    refused(
        lambda: pendulum.with_values({"bodies.hammer.mass": "1 kHz^999"}),
        "bodies.hammer.mass",
        "expected a unit of kg",
    )


def test_digits_that_are_no_numbers(action, pendulum):
    # ValueError: invalid literal for int() with base 10: '²²'
    refused(lambda: action.with_values({"surfaces.Gp3.point.²": 1.0}), "point.²")
    raw = pendulum.raw
    raw["contacts"]["²²"] = raw["contacts"]["01"]
    refused(lambda: Action(raw), "contacts.²²: expected a number of two digits")


def test_byte_order_mark_of_a_mechanism(pendulum, tmp_path):
    # "is no TOML: Invalid statement (at line 1, column 1)", while CSV files may begin with one
    path = tmp_path / "marked.toml"
    path.write_text("\ufeff" + pendulum.to_toml(), encoding="utf-8")
    assert feltmb.load_action(path).hash == pendulum.hash


# ---------------------------------------------------------------- files and with_values


def test_dotted_keys_nested_deeply(tmp_path):
    # RecursionError from copy.deepcopy
    path = tmp_path / "deep.toml"
    path.write_text("a." * 3000 + "b = 1\n")
    refused(lambda: feltmb.load_action(path), "deep.toml", "nested too deeply")


def test_faults_without_end_are_cut(pendulum):
    # 400000 lines of message for as many unknown keys
    text = refused(lambda: Action(pendulum.raw | {f"k{i}": 1 for i in range(3000)}))
    assert "3000 faults" in text
    assert len(text.splitlines()) < 150


def test_values_of_numpy_reach_the_file(pendulum):
    # ConvertError of tomlkit after the simulation: int64 is no TOML item
    values = {"bodies.hammer.mass": np.float64(0.013), "contacts.02.enabled": np.bool_(False)}
    other = pendulum.with_values(values | {"surfaces.pad.point": np.array([0.0, 0.059])})
    assert "13.0" in other.to_toml()
    assert other.config.surfaces["pad"].point == pytest.approx((0.0, 0.059))


def test_none_is_no_value_of_a_file(pendulum):
    # accepted, then ConvertError of tomlkit after the simulation
    refused(lambda: pendulum.with_values({"bodies.hammer.length": None}), "length: got None")


@pytest.mark.parametrize("values", [None, 5, "string.modes=80", [("a", 1)], {1: 2}])
def test_with_values_wants_paths(pendulum, values):
    # AttributeError: 'int' object has no attribute 'items'
    refused(lambda: pendulum.with_values(values), "with_values", "expected")


def test_tables_below_values_of_extends(tmp_path):
    # [values] string.modes = 80 replaced the whole string: "string.surface: is missing", ...
    path = tmp_path / "mine.toml"
    path.write_text(
        'schema = 1\nname = "mine"\nextends = "steinway45"\n[values]\nstring.modes = 80\n'
    )
    refused(lambda: feltmb.load_action(path), '"string.modes" = ...')


# ---------------------------------------------------------------- references


def test_check_contact_that_does_not_exist(action):
    # KeyError: 'contact99.force' after the simulation
    refused(
        lambda: action.with_values({"reading.check_contacts": [8, 99]}),
        "reading.check_contacts: there is no contact 99",
    )


def test_events_that_wait_for_one_another(action):
    # accepted; none of them ever happened
    refused(
        lambda: action.with_values({"events.string_contact_on.after": "check"}),
        "events.check: waits for itself",
    )


# ---------------------------------------------------------------- files that are written


def test_full_disk_leaves_a_message(tmp_path):
    # HDF5 failed while it closed the file, and the process died of a segmentation fault (139)
    pytest.importorskip("resource")
    code = (
        "import resource, feltmb\n"
        "run = feltmb.simulate('steinway45', 'forte', 0.05)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (20000, 20000))\n"
        "try:\n"
        f"    run.save({str(tmp_path / 'run.nc')!r})\n"
        "except feltmb.FeltmbError as error:\n"
        "    print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "run.nc: cannot be written: " in done.stdout
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["a" * 5000, "a" * 5000 + ".toml"])
def test_names_longer_than_names_of_files(name, tmp_path):
    # OSError: [Errno 36] File name too long
    refused(lambda: feltmb.load_action(name), "mechanism")
    refused(lambda: feltmb.load_stroke(name), "stroke")
    refused(lambda: feltmb.load_run(name), "there is no such file")
    refused(lambda: feltmb.load_targets(name), "targets")
    refused(lambda: load_study(name), "study")
    with pytest.raises(feltmb.FeltmbError, match="cannot be written"):
        check_writable(tmp_path / name, force=False)


def test_name_as_long_as_a_name_may_be(tmp_path):
    # the name of the temporary file was longer, and refused
    assert write_text(tmp_path / ("a" * 250 + ".txt"), "x").read_text() == "x"


def test_folder_that_is_a_file_is_seen_before_long_work(tmp_path):
    # found after the simulation: "cannot be written: File exists"
    (tmp_path / "file").touch()
    with pytest.raises(feltmb.FeltmbError, match="is a file, expected a folder"):
        check_writable(tmp_path / "file" / "run.nc", force=False)


def test_devices_are_not_replaced():
    # --out /dev/null --force put a file in the place of the device
    with pytest.raises(feltmb.FileExists, match="is a device"):
        check_writable(Path("/dev/null"), force=True)


# ---------------------------------------------------------------- feltmb stroke


def stroke_command(*arguments):
    """Run ``feltmb stroke`` and return its exit code."""
    with pytest.raises(SystemExit) as caught:
        main(["stroke", *map(str, arguments)])
    return caught.value.code


def short_strike(path, name):
    path.write_text(f'schema = 1\nname = "{name}"\nduration = 0.002\n[ramp]\nforce = 1.0\n'
                    "start = 0.0\nramp = 0.001\n")  # fmt: skip
    return path


def test_name_of_a_stroke_does_not_leave_the_folder(tmp_path):
    # name = "../../outside" wrote outside of --out
    strike = short_strike(tmp_path / "blow.toml", "../../outside")
    (tmp_path / "a").mkdir()
    assert stroke_command("steinway45", strike, "--out", tmp_path / "a" / "b") == 0
    assert [p.name for p in tmp_path.rglob("*.nc")] == ["_.._outside.nc"]
    assert (tmp_path / "a" / "b" / "_.._outside.nc").is_file()


def test_strokes_whose_numbered_names_meet(tmp_path):
    # a, a, a_1 gave a_1.nc twice; the last was refused after its simulation
    names = ["a", "a", "a_1"]
    strikes = [short_strike(tmp_path / f"{i}.toml", name) for i, name in enumerate(names)]
    assert stroke_command("steinway45", *strikes, "--out", tmp_path / "out") == 0
    assert len(list((tmp_path / "out").glob("*.nc"))) == 3


def test_existing_plots_are_seen_before_the_simulation(tmp_path, capsys):
    # the run was simulated and written, then the plots were refused
    (tmp_path / "run_overview.png").touch()
    strike = short_strike(tmp_path / "blow.toml", "blow")
    assert stroke_command("steinway45", strike, "--out", tmp_path / "run.nc", "--plot") == 2
    assert "run_overview.png: exists already" in capsys.readouterr().err
    assert not (tmp_path / "run.nc").exists()


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


# ---------------------------------------------------------------- outputs and saved runs


@pytest.mark.parametrize("name", ["time", "tip.x", "energy.kinetic", "contact01.force", "a/b"])
def test_names_of_outputs_that_collide(pendulum, name):
    # ValueError of xarray after the simulation, or an output silently replaced by another
    raw = pendulum.raw
    raw["bodies"]["hammer"]["coordinate"] = name
    raw["springs"]["return_spring"]["coordinate"] = name
    raw["start_pose"] = {name: 0.1}
    refused(lambda: Action(raw), f"output {name!r}")


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


def test_measure_of_a_regulation_that_is_no_text(tmp_path):
    # TypeError: unhashable type: 'dict'
    path = tmp_path / "a.toml"
    path.write_text('schema = 1\nname = "a"\n[[steps]]\nmeasure = { a = 1 }\n')
    refused(lambda: feltmb.load_targets(path), "a.toml: ", "measure")


def test_long_words_of_a_file_are_cut_in_the_message(tmp_path):
    # messages of 5000 letters
    path = tmp_path / "a.toml"
    path.write_text(f'schema = 1\nname = "a"\n{"b" * 5000} = 1\n')
    for read in (feltmb.load_action, feltmb.load_stroke, feltmb.load_targets):
        assert len(refused(lambda read=read: read(path))) < 3000


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


def test_force_without_end(pendulum):
    # accelerations of NaN
    refused(lambda: feltmb.evaluate(pendulum, [0.0], [0.0], float("inf")), "finger_force")


def test_picture_of_unknown_kind(tmp_path, capsys):
    # ValueError: Format 'abc' is not supported
    with pytest.raises(SystemExit) as caught:
        main(["show", "steinway45", "--plot", str(tmp_path / "x.abc")])
    assert caught.value.code == 2
    assert "expected .png, .pdf or .svg" in capsys.readouterr().err


def test_samples_beyond_the_memory(action):
    # up to 5e7 samples were allowed, whatever their number of columns: 42 GB for this one
    refused(lambda: feltmb.simulate(action, "forte", output_rate=1e8), "samples of ", "limit")


def test_faults_of_limits_name_the_limit(pendulum):
    # "max_step [s] and max_wall [s] must be >= 0, max_steps >= 1" for any of the three
    refused(lambda: feltmb.simulate(pendulum, "staccato", max_wall=-1.0), "max_wall = -1 s")
    refused(lambda: feltmb.simulate(pendulum, "staccato", max_step=-1.0), "max_step = -1 s")


def test_writing_leaves_the_umask_alone(tmp_path, monkeypatch):
    # the umask was set to 0 and back: another thread could write, or keep it, in between
    monkeypatch.setattr("os.umask", lambda mask: pytest.fail(f"umask set to {mask}"))
    path = write_text(tmp_path / "x.txt", "x")
    (tmp_path / "y.txt").touch()
    assert path.stat().st_mode == (tmp_path / "y.txt").stat().st_mode


def test_word_of_a_formula_beyond_floats():
    # OverflowError: int too large to convert to float
    refused(lambda: Formula(f"peak({10**400})"), "is no formula")


def test_list_names_the_studies(capsys):
    # feltmb list said nothing of them
    with pytest.raises(SystemExit):
        main(["list"])
    listed = capsys.readouterr().out
    assert all(name in listed for name in feltmb.packaged_studies())


# ---------------------------------------------------------------- strokes, laws, signals


def test_oscillating_stroke_is_not_shifted():
    # the ramp came later, its oscillation did not: another stroke
    stroke = feltmb.ramp_stroke(5.0, oscillation=(0.5, 30.0))
    refused(lambda: stroke.shifted(0.01), "oscillates and cannot be shifted")


def test_oscillation_that_is_no_number():
    # accepted; the solver failed later: "the right-hand side failed at the start"
    stroke = feltmb.load_stroke("forte")
    refused(lambda: dataclasses.replace(stroke, oscillation_amplitude=float("nan")), "oscillation")


def test_curve_of_a_law_that_is_a_number():
    # TypeError: object of type 'int' has no len()
    refused(lambda: law("mean", loading=5, unloading=(1.0, 2.0, 3.0)), "loading = 5, expected")


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


def test_version_without_an_installed_package(capsys, monkeypatch):
    # RuntimeError: 'feltmb' is not installed, from a folder of sources
    def absent(name):
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr("importlib.metadata.version", absent)
    with pytest.raises(SystemExit) as caught:
        main(["--version"])
    assert caught.value.code == 0
    assert feltmb.__version__ in capsys.readouterr().out


def test_sequence_holds_what_a_stroke_holds():
    # Two held ramps in sequence fell linearly from one to the next.
    ramp = feltmb.ramp_stroke(5.0, 0.05, 0.1, duration=0.3)
    both = feltmb.sequence(ramp, ramp)
    assert both.at([0.15, 0.2, 0.299, 0.301, 0.34, 0.45]).tolist() == pytest.approx(
        [5.0, 5.0, 5.0, 0.0, 0.0, 5.0]
    )


def test_unreachable_pose_is_bad_input(tmp_path, capsys):
    # `feltmb stroke` exited with 1, `feltmb validate` with 2.
    action = feltmb.load_action("steinway45")
    text = feltmb.Action(
        {
            **action.raw,
            "contacts": {k: {**c, "enabled": False} for k, c in action.raw["contacts"].items()},
        }
    ).to_toml()
    path = tmp_path / "falls.toml"
    path.write_text(text)
    with pytest.raises(SystemExit) as stop:
        main(["stroke", str(path), "piano"])
    assert stop.value.code == 2
    assert "no rest pose" in capsys.readouterr().err
