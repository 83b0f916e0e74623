"""What broke when strangers attacked the program: files that lead elsewhere, hang, or shout."""

import contextlib
import json
import math
import os
import socket
import subprocess
import sys
import tracemalloc
import warnings
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
from click.testing import CliRunner

import feltmb
from feltmb.cli import cli
from feltmb.cli import main as package_main
from feltmb.data import columns, read_record
from feltmb.fiber import read_compression
from feltmb.files import access as files
from feltmb.files import hdf5
from feltmb.graphics.viewer import read_curves
from feltmb.run.batch import simulate_many
from feltmb.run.stroke import load_stroke
from feltmb.run.study.model import Study
from feltmb.units.quantity import parse_scalar

DATA = Path(__file__).parents[2] / "data"


@pytest.fixture(scope="module")
def pendulum():
    return feltmb.load_action(DATA / "pendulum.toml")


@pytest.fixture(scope="module")
def saved(pendulum, tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    return feltmb.simulate(pendulum, "staccato", 0.001).save(folder / "run.nc").read_bytes()


@pytest.fixture
def run_file(saved, tmp_path):
    path = tmp_path / "run.nc"
    path.write_bytes(saved)
    return path


def refused(call, *parts):
    with pytest.raises(feltmb.InvalidParameter) as caught:
        call()
    for part in parts:
        assert part in str(caught.value)
    return str(caught.value)


# ---------------------------------------------------------------- HDF5 that leads elsewhere


def elsewhere(tmp_path, count):
    """A file of someone else, as raw numbers and as HDF5."""
    (tmp_path / "secret.bin").write_bytes(np.full(count, 42.0).tobytes())
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["x"] = np.full(count, 42.0)


def external_link(file, name, _count, folder):
    file[name] = h5py.ExternalLink(str(folder / "secret.h5"), "x")


def external_storage(file, name, count, folder):
    file.create_dataset(name, (count,), "f8", external=[(str(folder / "secret.bin"), 0, 8 * count)])


def virtual_dataset(file, name, count, folder):
    layout = h5py.VirtualLayout((count,), "f8")
    layout[:] = h5py.VirtualSource(str(folder / "secret.h5"), "x", (count,))
    file.create_virtual_dataset(name, layout)


def soft_link(file, name, count, folder):
    external_link(file, "door", count, folder)
    file[name] = h5py.SoftLink("/door")


def group(file, name, _count, _folder):
    file.create_group(name)


def reference(file, name, count, _folder):
    file.create_dataset(name, (count,), h5py.ref_dtype)


WAYS_OUT = [external_link, external_storage, virtual_dataset, soft_link, group, reference]


@pytest.mark.parametrize("way", WAYS_OUT)
def test_a_saved_run_reads_no_other_file(run_file, tmp_path, way):
    # validated "ok", and showed the numbers of the other file
    with h5py.File(run_file, "a") as file:
        name = next(n for n in file if n.endswith(".angle"))
        count = file[name].size
        elsewhere(tmp_path, count)
        del file[name]
        way(file, name, count, tmp_path)
    refused(lambda: feltmb.load_run(run_file), "is no complete run")


@pytest.mark.parametrize("way", WAYS_OUT)
def test_a_record_reads_no_other_file(tmp_path, way):
    elsewhere(tmp_path, 9)
    with h5py.File(tmp_path / "a.nc", "w") as file:
        file["time"] = np.arange(9.0)
        way(file, "q", 9, tmp_path)
    (tmp_path / "a.toml").write_text("[outputs.q]\n")
    refused(lambda: read_record(tmp_path / "a.nc"), "no column 'q'", "left out: ", "q (")


def test_attributes_that_are_references_are_no_text(run_file):
    with h5py.File(run_file, "a") as file:
        name = next(n for n in file if n.endswith(".angle"))
        file[name].attrs["units"] = file[name].ref
        file.attrs["message"] = file[name].regionref[:]
    refused(lambda: feltmb.load_run(run_file), "'message' is missing")


def test_there_is_one_reader_of_hdf5():
    users = [
        str(p.relative_to(DATA.parents[1]))
        for p in sorted(Path(feltmb.__file__).parent.rglob("*.py"))
        if "h5py" in p.read_text() and p.name not in ("hdf5.py", "netcdf.py")
    ]
    assert not users


def bomb(path, stored, claimed):
    """One chunk that says it holds 80 bytes and unpacks to far more."""
    with h5py.File(path, "w") as file:
        file["time"] = np.arange(10.0)
        q = file.create_dataset("q", (10,), "f8", chunks=(10,), compression="gzip")
        q.id.write_direct_chunk((0,), zlib.compress(bytes(stored), 9))
        assert q.id.get_chunk_info(0).size < claimed


def test_a_packed_bomb_is_found_before_the_library_unpacks_it(tmp_path):
    # 400 kB became 400 MB of memory, 4 MB 4 GB
    bomb(tmp_path / "a.nc", 20_000_000, 30_000)
    (tmp_path / "a.toml").write_text("[outputs.q]\n")
    tracemalloc.start()
    try:
        refused(lambda: read_record(tmp_path / "a.nc"), "unpacks to more than its 80 bytes")
        assert tracemalloc.get_traced_memory()[1] < 5_000_000
    finally:
        tracemalloc.stop()


def test_a_chunk_larger_than_the_limit_is_refused(tmp_path):
    with h5py.File(tmp_path / "a.nc", "w") as file:
        file["time"] = np.arange(10.0)
        q = file.create_dataset(
            "q", (10,), "f8", chunks=(30_000_000,), maxshape=(None,), compression="gzip"
        )
        q.id.write_direct_chunk((0,), zlib.compress(bytes(80)))
    (tmp_path / "a.toml").write_text("[outputs.q]\n")
    refused(lambda: read_record(tmp_path / "a.nc"), "claims more than")


def test_a_mat_file_that_unpacks_to_more_than_it_says(tmp_path):
    packed = zlib.compress(bytes(200_000_000), 9)
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    body = np.array([15, len(packed)], "<u4").tobytes() + packed
    (tmp_path / "a.mat").write_bytes(head + body)
    (tmp_path / "a.toml").write_text("[outputs.q]\n")
    refused(lambda: read_record(tmp_path / "a.mat"), "cannot be read as MAT: unpacks to more than")


def test_heaps_that_overlap_cost_no_more_than_the_file_is_long(monkeypatch):
    # every header of thousands had its own walk to the end: a minute for 1 MB
    count = 3000
    one = b"GCOL\x01\x00\x00\x00" + (0).to_bytes(8, "little")
    data = bytearray(one * count + bytes(16) * 2000)
    for i in range(count):
        at = 16 * i
        data[at + 8 : at + 16] = (len(data) - at).to_bytes(8, "little")
    steps = 0
    unpack = hdf5.struct.unpack_from

    def counted(*given):
        nonlocal steps
        steps += 1
        return unpack(*given)

    monkeypatch.setattr(hdf5.struct, "unpack_from", counted)
    with pytest.raises(ValueError, match="global heap"):
        hdf5._check_heaps(bytes(data))
    assert steps <= 2 * len(data) // 16


# ---------------------------------------------------------------- what is no file


def fifo(path):
    os.mkfifo(path)


def listening(path):
    server = socket.socket(socket.AF_UNIX)
    server.bind(str(path))
    server.close()


def device(path):
    path.symlink_to("/dev/zero")


def folder(path):
    path.mkdir()


READERS = {
    ".toml": [
        feltmb.load_action,
        load_stroke,
        feltmb.load_targets,
        files.read_toml,
        lambda p: feltmb.load_action(extending(p)),
        lambda p: feltmb.load_action(with_felt(p)),
    ],
    ".csv": [
        load_stroke,
        lambda p: read_compression(p, v_f0=0.1, area=1e-4),
        read_curves,
        lambda p: read_record(p, outputs=["q"]),
    ],
    ".nc": [feltmb.load_run, lambda p: read_record(p, outputs=["q"])],
    ".mat": [lambda p: read_record(p, outputs=["q"])],
    ".npz": [files.read_npz],
    ".json": [files.read_json],
}


def extending(path):
    other = path.parent / "mine.toml"
    other.write_text(f'schema = 1\nname = "a"\nextends = "{path.name}"\n')
    return other


def with_felt(path):
    other = path.parent / "mine.toml"
    other.write_text(f'schema = 1\n[contacts.01]\nmicromechanical = {{ felt = "{path.name}" }}\n')
    return other


@pytest.mark.parametrize("make", [fifo, listening, device, folder])
@pytest.mark.parametrize(
    ("suffix", "reader"), [(s, r) for s, readers in READERS.items() for r in readers]
)
def test_what_is_no_file_is_refused_at_once(tmp_path, monkeypatch, suffix, reader, make):
    # a pipe was waited for for ever, a device filled the memory
    monkeypatch.chdir(tmp_path)  # names of sockets are short
    path = Path(f"given{suffix}")
    make(path)
    refused(lambda: reader(path))


def test_a_pipe_that_takes_the_place_of_a_file(tmp_path, monkeypatch):
    # between the look at the file and its opening
    path = tmp_path / "a.toml"
    os.mkfifo(path)
    monkeypatch.setattr(Path, "is_file", lambda _: True)
    refused(lambda: files.read_toml(path), "is a device or a pipe")


def test_files_of_the_system_that_state_no_size():
    if not Path("/proc/self/status").exists():
        pytest.skip("no /proc")
    refused(lambda: files.read_toml(Path("/proc/self/status")), "longer than the 0 bytes")


@pytest.mark.parametrize(
    ("reader", "suffix", "limit"),
    [
        (files.read_toml, ".toml", files.LARGEST_TOML),
        (load_stroke, ".csv", files.LARGEST_TABLE),
        (lambda p: read_compression(p, v_f0=0.1, area=1e-4), ".csv", files.LARGEST_TABLE),
        (lambda p: read_record(p, outputs=["q"]), ".csv", files.LARGEST_TABLE),
        (lambda p: read_record(p, outputs=["q"]), ".mat", columns.LARGEST_MAT),
        (feltmb.load_run, ".nc", hdf5.LARGEST_FILE),
    ],
)
def test_files_beyond_their_limit_are_not_read(tmp_path, reader, suffix, limit):
    path = tmp_path / f"a{suffix}"
    with path.open("wb") as file:
        file.truncate(limit + 1)  # takes no room on the disk
    refused(lambda: reader(path), str(limit))


@pytest.mark.parametrize("name", ["../base.toml", "/etc/passwd.toml", "a/../../base.toml"])
def test_references_stay_beside_their_file(tmp_path, name):
    (tmp_path / "base.toml").write_text((DATA / "pendulum.toml").read_text())
    inner = tmp_path / "inner"
    inner.mkdir()
    (inner / "mine.toml").write_text(f'schema = 1\nname = "a"\nextends = "{name}"\n')
    refused(lambda: feltmb.load_action(inner / "mine.toml"), "extends", "in the folder of this")
    (inner / "felt.toml").write_text(f'schema = 1\n[contacts.01]\nlaw = {{ felt = "{name}" }}\n')
    refused(lambda: feltmb.load_action(inner / "felt.toml"), "felt", "in the folder of this")


def test_extends_may_lead_to_a_folder_below(tmp_path):
    (tmp_path / "below").mkdir()
    (tmp_path / "below" / "base.toml").write_text((DATA / "pendulum.toml").read_text())
    mine = tmp_path / "mine.toml"
    mine.write_text('schema = 1\nname = "mine"\nextends = "below/base.toml"\n')
    assert feltmb.load_action(mine).name == "mine"


def test_files_that_extend_one_another_without_end(tmp_path):
    # RecursionError
    for i in range(60):
        (tmp_path / f"{i}.toml").write_text(f'schema = 1\nname = "a"\nextends = "{i + 1}.toml"\n')
    refused(lambda: feltmb.load_action(tmp_path / "0.toml"), "more than 20 files")


def test_a_run_cannot_name_a_file_of_published_numbers(pendulum):
    from feltmb.run.published import compare_with_published

    run = feltmb.simulate(pendulum, "staccato", 0.001)
    run.provenance["action"] = "../../../tests/data/pendulum"
    assert compare_with_published(run) == []


def test_a_run_cannot_name_a_felt_in_a_file(pendulum):
    from feltmb.graphics.plot.readings import run_action

    run = feltmb.simulate(pendulum, "staccato", 0.001)
    run.provenance["toml"] = '[contacts.01]\nmicromechanical = { felt = "/etc/x.toml" }\n'
    refused(lambda: run_action(run), "a saved run names no file")


# ---------------------------------------------------------------- time that grows with the length


@pytest.mark.parametrize(
    "head",
    [
        *(" " * 100_000, "[" * 100_000, "a" + " " * 100_000 + "b", "[ " * 50_000, "(" * 100_000),
        *("a [" + " " * 100_000, " ]" * 50_000, "a\t" * 30_000),
    ],
    ids=range(8),
)
@pytest.mark.parametrize("reader", READERS[".csv"])
def test_headings_cost_time_with_their_length(tmp_path, reader, head):
    # cubic in a regular expression: 2000 spaces took minutes, 100 000 would take years
    path = tmp_path / "a.csv"
    path.write_text(f"time [s],{head}\n0,1\n1,2\n2,3\n")
    with contextlib.suppress(feltmb.InvalidParameter):
        reader(path)


def test_numbers_with_units_cost_time_with_their_length():
    # \d+\.?\d* went back over all digits at each of them
    for text in ("1" * 200_000 + "\nx", "1" * 200_000 + "x", " " * 200_000 + "x"):
        with pytest.raises(ValueError, match=r"."):
            parse_scalar(text, "m")
    assert parse_scalar(" 1.5e1 mm ", "m") == pytest.approx(0.015)


def test_dotted_keys_are_counted_before_they_are_read(tmp_path):
    # 20 kB of a.a.a. took minutes, 100 kB hours
    path = tmp_path / "a.toml"
    for text in ("a." * 500_000 + "b = 1", "[" + "'a'." * 500_000 + "b]", 'x = {"a" . ' * 9 + "a."):
        path.write_text(text)
        refused(lambda: files.read_toml(path))
    path.write_text("a" + ".b" * 49 + " = 'x" + ".y" * 100 + "' # " + "z." * 100 + "\n")
    assert list(files.read_toml(path)) == ["a"]


def test_memory_of_a_table_is_a_few_times_its_numbers(tmp_path):
    # each cell was a text of 50 bytes and more, all at once
    rows, width = 20_000, 20
    path = tmp_path / "a.csv"
    head = ",".join(["time", *(f"c{i}" for i in range(width - 1))])
    path.write_text(head + "\n" + "".join(f"{i}" + ",1" * (width - 1) + "\n" for i in range(rows)))
    tracemalloc.start()
    try:
        found = columns.read_columns(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert found.values["c3"].size == rows
    assert peak < 3 * 8 * rows * width + path.stat().st_size


def test_arrays_of_a_packed_file_are_limited(tmp_path):
    np.savez_compressed(tmp_path / "a.npz", x=np.zeros(2_000_000))
    refused(lambda: files.read_npz(tmp_path / "a.npz", most=10_000_000), "the limit is 10000000")
    assert files.read_npz(tmp_path / "a.npz")["x"].size == 2_000_000


# ---------------------------------------------------------------- names that command a terminal

ODD = "a\x1b]0;owned\x07b\x9bc\u202ed"


@pytest.mark.parametrize("odd", ["\x1b", "\x9b", "\u202e", "\u2066", "\x7f", "\r", "\u200f"])
def test_names_with_control_characters_are_refused(tmp_path, odd):
    text = (DATA / "pendulum.toml").read_text()
    path = tmp_path / "a.toml"
    code = f"\\u{ord(odd):04x}"
    for change in (
        text.replace('name = "', f'name = "{code}', 1),
        text + f'\n[points."p{code}"]\nbody = "arm"\npoint = [0.0, 0.0]\n',
        text + f'\n[points.p]\nbody = "arm"\npoint = [0.0, 0.0]\nlabel = "{code}"\n',
    ):
        assert change != text
        path.write_text(change)
        said = refused(lambda: feltmb.load_action(path), f"U+{ord(odd):04X}")
        assert odd not in said


def test_messages_are_printable_and_short():
    error = feltmb.InvalidParameter(f"file {ODD * 100_000}: bad\nsecond line")
    said = str(error)
    assert said.isprintable() or set(said) - {"\n"} <= {c for c in said if c.isprintable()}
    assert len(said) < 5000
    assert "cut" in said
    assert str(feltmb.InvalidParameter("short\ttext\nof two lines é")).endswith("lines é")


def test_the_end_of_a_long_line_is_kept():
    said = str(feltmb.DataError(f"{'a' * 3000}: there is no such file"))
    assert said.endswith(": there is no such file")
    assert len(said) < 1100


@pytest.mark.parametrize(
    "words",
    [
        ["validate", "{file}"],
        ["show", "{file}"],
        ["stroke", "{file}", "piano"],
        ["stroke", "steinway45", "{file}"],
        ["validate", "{run}"],
        ["plot", "{run}", "--compare", ODD],
        ["gap", "diagnose", ODD, "{file}"],
        ["felt", "show", ODD],
        ["list", ODD],
        [ODD],
    ],
)
def test_no_command_prints_control_characters(tmp_path, run_file, words):
    path = tmp_path / f"{ODD.replace('/', '')}.toml"
    path.write_text('schema = 1\nname = "\\u001b\\u009b\\u202e"\n"\\u001b[2J" = 1\n')
    with h5py.File(run_file, "a") as file:
        for key, value in {"message": ODD, "status": ODD}.items():
            del file.attrs[key]
            file.attrs[key] = ODD + value
        told = json.loads(file.attrs["provenance"]) | {"action": ODD}
        file.attrs["provenance"] = json.dumps(told)
    words = [w.format(file=path, run=run_file) if "{" in w else w for w in words]
    done = subprocess.run(
        [sys.executable, "-m", "feltmb", *words], capture_output=True, cwd=tmp_path, check=False
    )
    said = (done.stdout + done.stderr).decode()
    for letter in ODD + "\x1b\x9b\u202e":
        assert letter.isprintable() or letter not in said, said


def test_tables_and_lines_are_printed_at_one_place():
    folder = Path(feltmb.__file__).parent / "cli"
    direct = [
        p.name
        for p in folder.rglob("*.py")
        if p.name not in ("common.py", "messages.py", "tables.py", "__init__.py")
        and ("click.echo(" in p.read_text() or "import Console" in p.read_text())
    ]
    assert not direct


def test_tables_show_escapes(capsys):
    from feltmb.cli.common import console, new_table, say

    table = new_table(ODD, ODD)
    table.add_row(ODD)
    console().print(table)
    console().print(ODD)
    say(ODD)
    said = capsys.readouterr().out
    assert all(c.isprintable() or c == "\n" for c in said)
    assert "\\u001b" in said


# ---------------------------------------------------------------- sizes


def chain(count, **more):
    return {
        "schema": 1,
        "name": "chain",
        "bodies": {
            f"b{i}": {
                "parent": f"b{i - 1}" if i else "ground",
                "coordinate": f"q{i}",
                "position": [0.0, -0.1] if i else [0.0, 0.0],
                "angle": 0.05 if i else 0.3,
                "mass": 0.1,
                "center_of_mass": [0.0, -0.05],
                "inertia": 1e-4,
            }
            for i in range(count)
        },
        **more,
    }


@pytest.mark.parametrize("sprung", [False, True])
@pytest.mark.parametrize("count", [25, 60])
def test_chains_come_to_rest_in_some_hundred_steps(count, sprung):
    # steps that the softest direction held up: 20000 for 100 bodies, and no rest then
    springs = {
        f"s{i}": {"coordinate": f"q{i}", "stiffness": 2.0, "rest_angle": 0.1} for i in range(count)
    }
    action = feltmb.Action(chain(count, **({"springs": springs} if sprung else {})))
    assert action.rest_iterations < 8 * count
    if not sprung:  # it hangs straight down
        turns = np.cumsum(action.rest_pose) + 0.3 + 0.05 * np.arange(count)
        np.testing.assert_allclose(turns, 0.0, atol=1e-9)


def test_thousands_of_points_are_checked_in_one_pass():
    # each name was counted in all of them: 2.7 s for 4000 points, and 60 times that for these
    from feltmb.mechanism.checking import _output_faults

    outputs = [f"p{i}.{axis}" for i in range(30_000) for axis in ("x", "y", "vx", "vy")]
    assert _output_faults(outputs) == []
    told = _output_faults([*outputs, "p1.x", "time", "x/y.x", "x/y.y", "x/y.vx"])
    assert len(told) == 5


# ---------------------------------------------------------------- sweeps that go on


def sweep_into(folder, pendulum, **more):
    return feltmb.sweep(
        pendulum, "staccato", {"arm.mass": [0.02, 0.03]}, options={"duration": 0.002},
        folder=folder, progress=False, jobs=1, **more,
    )  # fmt: skip


def change_number(path):
    found = json.loads(path.read_text())
    found["numbers"] = {k: v + 1.0 for k, v in found["numbers"].items()}
    path.write_text(json.dumps(found))


def change_run(path):
    with h5py.File(path.with_suffix(".nc"), "a") as file:
        name = next(n for n in file if n.endswith(".angle"))
        file[name][:] = 1.0


def cut(path):
    path.write_text(path.read_text()[:100])


@pytest.mark.parametrize("damage", [change_number, change_run, cut])
def test_a_member_that_was_edited_is_computed_anew(pendulum, tmp_path, damage):
    # a sweep that was resumed believed any number
    first = sweep_into(tmp_path, pendulum, summary_only=False)
    whole = {p.name: p.read_bytes() for p in tmp_path.glob("*.nc")}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = sweep_into(tmp_path, pendulum, summary_only=False)
    assert again.table.equals(first.table)
    damage(sorted(tmp_path.glob("*.json"))[0])
    with pytest.warns(RuntimeWarning, match="computed again"):
        repeated = sweep_into(tmp_path, pendulum, summary_only=False)
    assert repeated.table.equals(first.table)
    assert sorted(whole) == sorted(p.name for p in tmp_path.glob("*.nc"))


# ---------------------------------------------------------------- models that end the program


def test_a_model_that_ends_the_program(tmp_path):
    # ended with code 0 and no word
    model = tmp_path / "model.py"
    model.write_text("import sys\nsys.exit(0)\n")
    (tmp_path / "a.csv").write_text("t,q\n0,1\n1,2\n")
    for words in (["gap", "diagnose"], ["fit"]):
        done = subprocess.run(
            [sys.executable, "-m", "feltmb", *words, "model.py", "a.csv"],
            capture_output=True, text=True, cwd=tmp_path, check=False,
        )  # fmt: skip
        assert done.returncode == 2
        assert "model.py: ends the program (exit code 0)" in done.stderr


def test_a_model_that_ends_the_program_later(tmp_path, monkeypatch, capsys):
    from feltmb import cli as package

    script = tmp_path / "late.py"
    script.write_text("import sys\ndef stop(*a, **k):\n    sys.exit(0)\n")
    space: dict[str, object] = {}
    exec(compile(script.read_text(), str(script), "exec"), space)
    monkeypatch.setattr(package.cli, "main", space["stop"])
    with pytest.raises(SystemExit) as end:
        package.main(["list"])
    assert end.value.code == 1
    assert "late.py, line 3: ends the program (exit code 0)" in capsys.readouterr().err


def test_no_command_ends_the_program_itself():
    folder = Path(feltmb.__file__).parent
    own = [p.name for p in folder.rglob("*.py") if "sys.exit(" in p.read_text()]
    assert own == ["__init__.py"]  # of the command line: its end


def test_commands_with_codes_of_their_own_still_end_with_them(capsys):
    with pytest.raises(SystemExit) as end:
        package_main(["fiber", "law", "van_wyk", "-p", "nothing=1"])
    assert end.value.code == 2
    assert "ends the program" not in capsys.readouterr().err


# ---------------------------------------------------------------- options

WRONG = [
    (name, value)
    for name, values in {
        "max_wall": (0, -1.0, math.nan, math.inf, "1", True, 10**400),
        "max_step": (0.0, -1e-3, math.nan, math.inf, "1"),
        "max_order": (0, -1, 6, 1.5, math.nan, "2", True),
    }.items()
    for value in values
]


@pytest.mark.parametrize(("name", "value"), WRONG)
def test_limits_are_refused_alike_everywhere(pendulum, name, value):
    stroke = load_stroke("staccato")
    options = {name: value}
    refused(lambda: feltmb.simulate(pendulum, stroke, 0.001, **options), name)
    refused(lambda: simulate_many([(pendulum, stroke)], lambda *_: True, **options), name)
    refused(lambda: feltmb.sweep(pendulum, stroke, {}, options=options, progress=False), name)
    if value != 10**400:  # that is refused by the sweep as a whole
        found = feltmb.sweep(pendulum, stroke, {f"options.{name}": [value]}, progress=False)
        assert found.table["status"].tolist() == ["failed"]
        assert name in found.table["error"][0]
    raw = {"schema": 1, "name": "a", "title": "a", "base": {
        "action": "steinway45", "strokes": ["piano"], "options": {name: value}}}  # fmt: skip
    if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300:
        refused(lambda: Study.from_dict(raw), name)


@pytest.mark.parametrize("value", ["0", "-1", "nan", "inf"])
def test_limits_of_the_command_line(value):
    done = CliRunner().invoke(cli, ["stroke", "steinway45", "piano", "--max-wall", value])
    assert done.exit_code == 2
    assert "--max-wall" in done.output


def test_unknown_options_of_a_batch_are_told(pendulum):
    # TypeError in a thread
    stroke = load_stroke("staccato")
    refused(lambda: simulate_many([(pendulum, stroke)], lambda *_: True, rtoll=1), "rtoll")


@pytest.mark.parametrize("name", ["../outside.mech", "/outside.mech", "sub/../../x"])
def test_extends_of_any_ending_stays_beside_its_file(tmp_path, name):
    (tmp_path / "inner").mkdir()
    (tmp_path / "outside.mech").write_text("schema = 1")
    path = tmp_path / "inner" / "a.toml"
    path.write_text(f'schema = 1\nname = "a"\nextends = "{name}"\n')
    refused(lambda: feltmb.load_action(path), "in the folder of this file or below")


def test_a_closed_pipe_is_no_fault(tmp_path):
    code = "import sys, feltmb.cli; feltmb.cli.main(['list'])"
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=tmp_path
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        told = process.stderr.read().decode()
    assert "ends the program" not in told
    assert process.returncode == 0


@pytest.mark.parametrize(
    ("heading", "rows", "said"),
    [
        ("v_f [-],pressure [kPa]", {9: "1e300,1440.0"}, "line 11: v_f = 1e+300"),
        ("v_f [-],pressure [kPa]", {3: "0.13,-1e300"}, "line 5: pressure = -1e+303 Pa"),
        ("v_f [-],pressure [MPa]", {3: "0.13,1e305"}, "holds a value beyond 1.8e308 Pa"),
    ],
)
def test_values_that_no_test_has_are_refused(tmp_path, heading, rows, said):
    """Their products were not finite."""
    path = tmp_path / "felt.csv"
    lines = [rows.get(i, f"{0.1 + 0.01 * i:g},{10.0 * i * i:g}") for i in range(12)]
    path.write_text("\n".join([heading, *lines, ""]))
    refused(lambda: read_compression(path, v_f0=0.1, area=1e-4), said)
