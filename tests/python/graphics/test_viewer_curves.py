"""Tables of measured curves that nobody intended."""

import numpy as np
import pytest
from click.testing import CliRunner

from feltmb.cli.runs import view as command
from feltmb.graphics.viewer import read_curves, read_each_run
from unmodeled.data import ReadOptions, read_record
from unmodeled.errors import DataError


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


CAMERA = "frame,Load (N),Marker 3 Y\n" + "".join(
    f"{10 * i},{0.5 * i},{612 + 2 * i}\n" for i in range(8)
)
SHEET = """
name = "from the camera"
time = "frame"
frame_rate = 1000
[inputs.force]
column = "Load"
[outputs."key_front.y"]
column = "Marker 3 Y"
unit = "px"
scale = "0.5 mm"
origin = "start"
"""


@pytest.fixture
def camera(tmp_path):
    path = tmp_path / "camera.csv"
    path.write_text(CAMERA)
    return path


def test_the_toml_file_beside_a_table_is_used_as_for_a_record(camera):
    with pytest.raises(DataError, match="expected a column time"):
        read_curves(camera)
    camera.with_suffix(".toml").write_text(SHEET)
    curves, record = read_curves(camera), read_record(camera)
    assert curves.name == "from the camera"
    np.testing.assert_allclose(curves.time, 0.01 * np.arange(8))
    np.testing.assert_allclose(curves.values["key_front.y"], -1e-3 * np.arange(8), atol=1e-15)
    np.testing.assert_array_equal(curves.values["key_front.y"], record.outputs["key_front.y"])
    np.testing.assert_array_equal(curves.values["force"], record.inputs["force"])
    assert curves.units == {"force": "N", "key_front.y": "m"}
    assert curves.notes == record.notes


def test_known_errors_of_a_sensor_are_removed(camera):
    camera.with_suffix(".toml").write_text(SHEET + "gain = 2.0\noffset = 1e-3\ndelay = 0.02\n")
    y = read_curves(camera).values["key_front.y"]
    # reading(t) = 2 truth(t - 20 ms) + 1 mm, two samples late; the last two are unknown.
    expected = (-1e-3 * np.arange(2, 8) - 1e-3) / 2.0
    np.testing.assert_allclose(y[:-2], expected, atol=1e-15)
    assert np.all(np.isnan(y[-2:]))


def test_options_read_a_table_without_a_toml_file(camera):
    options = ReadOptions(
        columns={"key_front.y": "Marker 3 Y"}, scales={"": "0.5mm"}, units={"": "px"},
        origins={"": "start"}, frame_rate=1000.0,
    )  # fmt: skip
    y = read_curves(camera, options).values["key_front.y"]
    np.testing.assert_allclose(y, -1e-3 * np.arange(8), atol=1e-15)


def test_each_run_of_a_file_is_shown(tmp_path):
    path = tmp_path / "runs.csv"
    path.write_text("time [s],run,u [m]\n0,1,1\n1,1,2\n2,1,3\n0,2,1\n1,2,2\n2,2,4\n")
    path.with_suffix(".toml").write_text('run = "run"\n[outputs.u]\n')
    assert [c.values["u"][-1] for c in read_each_run(path)] == [3.0, 4.0]
    with pytest.raises(DataError, match="holds 2 runs, expected one"):
        read_curves(path)
    result = CliRunner().invoke(command, [str(path), "-o", str(tmp_path / "runs.html")])
    assert result.exit_code == 0, result.output
    assert all(name in (tmp_path / "runs.html").read_text() for name in ("runs-1", "runs-2"))


def test_a_stroke_of_the_same_name_describes_no_data(tmp_path):
    path = tmp_path / "push.csv"
    path.write_text("time [s],u [V]\n0,1\n1,2\n2,3\n")
    path.with_suffix(".toml").write_text('schema = 1\nname = "push"\n[pulse]\nforce = "4 N"\n')
    assert list(read_curves(path).values["u"]) == [1.0, 2.0, 3.0]
    assert list(read_record(path).outputs["u"]) == [1.0, 2.0, 3.0]


def test_the_command_reads_with_the_options_of_gap_check(camera, tmp_path):
    page = tmp_path / "page.html"
    arguments = ["--column", "key_front.y=Marker 3 Y", "--unit", "px", "--scale", "0.5mm"]
    arguments += ["--frame-rate", "1000", "-o", str(page)]
    result = CliRunner().invoke(command, [str(camera), *arguments])
    assert result.exit_code == 0, result.output
    assert "key_front.y" in page.read_text()
