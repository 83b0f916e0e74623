"""Tables, headings and arrays: time and memory grow with the size of a file."""

import contextlib
import tracemalloc

import numpy as np
import pytest

import feltmb
from feltmb.data import columns, read_record
from feltmb.fiber import read_compression
from feltmb.files import access as files
from feltmb.graphics.viewer import read_curves
from feltmb.run.stroke import load_stroke
from feltmb.units.quantity import parse_scalar


def refused(call, *parts):
    with pytest.raises(feltmb.InvalidParameter) as caught:
        call()
    for part in parts:
        assert part in str(caught.value)
    return str(caught.value)


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
