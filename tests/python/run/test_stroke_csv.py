"""Strokes from CSV: units in the header, and every fault with its line."""

import tracemalloc

import pytest

import feltmb


@pytest.fixture
def csv(tmp_path):
    def write(text, name="record.csv"):
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


def table(n=30, step=0.001, header="time [s],force [N]"):
    return header + "\n" + "".join(f"{i * step:.6f},{0.1 * i:.3f}\n" for i in range(n))


def message_of(path):
    with pytest.raises(feltmb.DataError) as caught:
        feltmb.load_stroke(path)
    return str(caught.value)


def test_force(csv):
    stroke = feltmb.load_stroke(csv(table()))
    assert stroke.kind == "force"
    assert stroke.name == "record"
    assert stroke.duration == pytest.approx(0.029)
    assert stroke.at(0.010) == pytest.approx(1.0)


def test_units_of_the_header_are_converted(csv):
    stroke = feltmb.load_stroke(csv("time [ms],displacement [mm]\n0,0\n50,5\n100,10\n"))
    assert stroke.kind == "motion"
    assert stroke.duration == pytest.approx(0.1)
    assert stroke.at([0.05, 0.1]) == pytest.approx([0.005, 0.010])
    assert feltmb.load_stroke(csv("time [s],force [mN]\n0,0\n1,500\n")).at(1.0) == 0.5


@pytest.mark.parametrize(
    ("column", "kind", "value"),
    [
        ("key displacement [mm]", "key_motion", 1e-3),
        ("torque [N mm]", "torque", 1e-3),
        ("motor angle [deg]", "motor_motion", 0.017453292519943295),
    ],
)
def test_other_inputs(csv, column, kind, value):
    stroke = feltmb.load_stroke(csv(f"time [s],{column}\n0,0\n1,1\n"))
    assert stroke.kind == kind
    assert stroke.at(1.0) == pytest.approx(value)


@pytest.mark.parametrize(
    "text",
    [
        "# a comment\ntime [s],force [N]\n\n0,0\n# more\n1,2\n",
        "time [s],force [N]\r\n0,0\r\n1,2\r\n",
        b"\xef\xbb\xbftime [s],force [N]\n0,0\n1,2\n",
        " Time [s] , Force [N] \n 0 , 0 \n 1 , 2 \n",
        "time [s],force [N]\n0,0\n1,2e0",
    ],
)
def test_harmless_variations(csv, text):
    stroke = feltmb.load_stroke(csv(text))
    assert stroke.time == (0.0, 1.0)
    assert stroke.value == (0.0, 2.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,force [N]\n0,0\n1,1\n", "column time states no unit; write 'time [s]'"),
        ("time [s],force\n0,0\n1,1\n", "column force states no unit; write 'force [N]'"),
        ("time [kg],force [N]\n0,0\n1,1\n", "unit 'kg' does not measure"),
        ("time [s],force [mm]\n0,0\n1,1\n", "unit 'mm' does not measure this quantity"),
        ("time [s],displacement [N]\n0,0\n1,1\n", "expected a unit of m"),
        ("time [s],speed [m/s]\n0,0\n1,1\n", "expected a column force [N], torque"),
        ("clock [s],force [N]\n0,0\n1,1\n", "expected a column time [s]; there are clock, force"),
        ("0,0\n1,1\n2,2\n", "line 1 holds numbers, expected the names of the columns"),
        ("", "0 lines, expected a header"),
        ("time [s],force [N]\n", "1 line, expected a header and at least 2 samples"),
        ("time [s],force [N]\n0,1\n", "2 lines, expected a header and at least 2 samples"),
        ("time [s],force [N]\n0,0\n1,nan\n", "line 3: force = nan, expected a finite number"),
        ("time [s],force [N]\n0,0\n1,\n", "line 3: force = nan, expected a finite number"),
        ("time [s],force [N]\n0,0\ninf,1\n", "line 3: time = inf, expected a finite number"),
        ("time [s],force [N]\n0,0\n1,1\n2,1,1\n", "line 4: 3 cells, expected 2"),
        ("time [s],force [N]\n0,0\n1,1\n0.5,2\n", "line 4: time 0.5 s does not follow 1 s"),
        ("time [s],force [N]\n0,0\n1,1\n1,2\n", "line 4: time 1 s does not follow 1 s"),
        ("time [s],force [N]\n0,0\n0,0\n", "line 3: time 0 s does not follow 0 s"),
    ],
)
def test_one_fault(csv, text, message):
    text = message_of(csv(text))
    assert message in text
    assert "record.csv: " in text
    assert "faults" not in text


@pytest.mark.parametrize(
    "text",
    [
        "time [s];force [N]\n0;0\n0,5;1,5\n1;2\n",
        "force [N],time [s]\n0,0\n1.5,0.5\n2,1\n",
        "Rig 3, 12 May\nTime (s)\tKraft (N)\tkey [mm]\n0\t0\t0\n0.5\t1.5\t3\n1\t2\t9\n",
        "time,force,key_front.y\ns,N,mm\n0,0,0\n0.5,1.5,\n1,2,9\n",
        "time [s],force [N],remark,torque [N m]\n0,0,ok,0\n0.5,1.5,ok,x\n1,2,late,9\n",
        "Uhrzeit;Kraft [N]\n23:59:59,5;0\n00:00:00,0;1,5\n00:00:00,5;2\n",
        "Timestamp,Load [N]\n2026-05-01 12:00:00.5,0\n2026-05-01 12:00:01,1.5\n"
        "2026-05-01 12:00:01.5,2\n",
        "Date,Time,Load [N]\n11/05/2026,1:00:00 PM,0\n11/05/2026,1:00:00.5 PM,1.5\n"
        "11/05/2026,1:00:01 PM,2\n",
        "Calibration,1.02,0.98\ntime [s],force [N],x [mm]\n0,0,0\n0.5,1.5,3\n1,2,9\n",
    ],
)
def test_a_measured_record_is_a_stroke(csv, text):
    """Separators, decimal commas, times of day, lines beside the header, and other columns."""
    stroke = feltmb.load_stroke(csv(text))
    assert stroke.kind == "force"
    assert stroke.time == (0.0, 0.5, 1.0)
    assert stroke.value == (0.0, 1.5, 2.0)


def test_gap(csv):
    lines = table(60).splitlines()
    text = "\n".join(lines[:20] + lines[40:]) + "\n"
    assert "line 21: gap of 0.021 s before 0.039 s; the usual step is 0.001 s" in message_of(
        csv(text)
    )


def test_all_faults_at_once_with_lines(csv):
    text = message_of(csv("time [s],force [kg]\n0,0\nx,1\n2,y\n3\n"))
    assert "4 faults" in text
    for part in (
        "unit 'kg'",
        "line 3: time = 'x', expected a number",
        "line 4: force = 'y', expected a number",
        "line 5: 1 cells, expected 2",
    ):
        assert part in text


def test_many_faults_are_cut(csv):
    text = message_of(csv("time [s],force [N]\n" + "x,1\n2,2\n3,3\n" * 300))
    assert "300 faults" in text
    assert "... and 280 more" in text
    assert len(text.splitlines()) == 22


def test_reversed_time(csv):
    lines = table(30).splitlines()
    text = "\n".join([lines[0], *reversed(lines[1:])]) + "\n"
    assert "29 faults" in message_of(csv(text))


def test_files_that_cannot_be_read(csv, tmp_path):
    message = message_of(csv(b"time [s],force [N]\n0,\xff\n1,2\n2,2\n"))
    assert "line 2: force = 'ÿ', expected a number" in message
    with pytest.raises(feltmb.DataError, match="there is no such file"):
        feltmb.read_stroke_csv(tmp_path / "nothing.csv")


def test_a_file_beyond_the_limit_is_not_read(tmp_path):
    path = tmp_path / "long.csv"
    with path.open("wb") as file:
        file.truncate(201_000_000)  # sparse: takes no room
    tracemalloc.start()
    with pytest.raises(feltmb.DataError, match="201000000 bytes; the limit is 200000000 bytes"):
        feltmb.read_stroke_csv(path)
    assert tracemalloc.get_traced_memory()[1] < 10_000_000
    tracemalloc.stop()


def test_very_long_line_is_a_fault(csv):
    assert "field larger" in message_of(csv("x" * 300_000 + ",force [N]\n0,0\n1,1\n"))


def test_record_of_a_stroke_gives_the_stroke(csv, rigid):
    """A sampled ramp strikes like the ramp."""
    forte = feltmb.load_stroke("forte")
    rows = [f"{i * 1e-3:.6f},{float(forte.at(i * 1e-3)):.9g}" for i in range(200)]
    stroke = feltmb.load_stroke(csv("time [s],force [N]\n" + "\n".join(rows) + "\n"))
    run = feltmb.simulate(rigid, stroke)
    speed = feltmb.simulate(rigid, forte).summary["impact_speed"]
    assert run.summary["impact_speed"] == pytest.approx(speed, rel=1e-3)
