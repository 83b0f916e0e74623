"""Tables of measured curves that nobody intended."""

import pytest

from feltmb.errors import DataError
from feltmb.graphics.viewer import read_curves


def test_single_carriage_returns_end_lines(tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes(b"time [s],u [V]\r0,1\r1,2\r\n2,x\n")
    with pytest.raises(DataError, match="line 4: u = 'x', expected a number"):
        read_curves(path)
    path.write_bytes(b"time [s],u [V]\r0,1\r1,2\r\n2,3\n")
    assert list(read_curves(path).time) == [0.0, 1.0, 2.0]


def test_a_cell_as_long_as_a_book_is_one_fault(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("time [s],u [V]\n0,1\n1,2\n2," + "9" * 200_000 + "\n")
    with pytest.raises(DataError, match="is no table: field larger than field limit"):
        read_curves(path)
