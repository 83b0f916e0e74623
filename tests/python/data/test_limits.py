"""Tables, headings and arrays: time and memory grow with the size of a file."""

import contextlib
import tracemalloc

import numpy as np
import pytest
from calls import refused
from readers import READERS

import feltmb
from unmodeled.data import columns
from unmodeled.files import access as files
from unmodeled.units.quantity import parse_scalar


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
