"""The page of feltmb view holds the run, and no text of a file gets out of its place."""

import base64
import dataclasses
import hashlib
import html.parser
import itertools
import json
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import feltmb
from feltmb import Action, DataError, FileExists, InvalidParameter
from feltmb.cli import main
from feltmb.graphics.film import Film
from feltmb.graphics.plot.poses import (
    bent_beams,
    body_poses,
    contact_rows,
    poses_along,
    to_body,
    to_ground,
)
from feltmb.graphics.plot.readings import run_action
from feltmb.graphics.viewer import Curves, assets, fragment, page, read_curves, view
from feltmb.graphics.viewer.packing import MISSING, json_text, pack_columns, pack_points, pack_times
from feltmb.graphics.viewer.thinning import extremes, knots, thin_outline

EVIL = "</script><script>alert('1')</script>&<b>\u2028"


class Parsed(html.parser.HTMLParser):
    """Tags, and the text of each script and of the title."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.scripts, self.title = [], [], ""
        self._in = None
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self._in = tag
        if tag == "script":
            self.scripts.append("")

    def handle_endtag(self, _tag):
        self._in = None

    def handle_data(self, data):
        if self._in == "script":
            self.scripts[-1] += data
        elif self._in == "title":
            self.title += data


def unpack(packed):
    """What the page reads of packed columns: (n, m)."""
    data, n, m = base64.b64decode(packed["data"]), packed["n"], packed["m"]
    low, step = np.frombuffer(data, "<f8", 2 * m).reshape(2, m)
    whole = np.frombuffer(data[16 * m :], "<i2").reshape(-1, n)
    out, k = np.empty((n, m)), 0
    for j in range(m):
        if step[j] == 0.0:
            out[:, j] = low[j]
            continue
        column = low[j] + step[j] * (whole[k].astype(float) + 32767)
        out[:, j] = np.where(whole[k] == MISSING, np.nan, column)
        k += 1
    assert k == len(whole)
    return out


def in_page(packed):
    return json.loads(json_text(packed))


def unpack_times(packed):
    return packed["first"] + np.frombuffer(base64.b64decode(packed["data"]), "<f4").astype(float)


def unpack_points(packed):
    every = np.frombuffer(base64.b64decode(packed["data"]), "<f4").reshape(-1, 2)
    return np.split(every, np.cumsum(packed["counts"])[:-1])


def data_of(text):
    return json.loads(Parsed(text).scripts[0])


@pytest.fixture(scope="module")
def shown(forte):
    return page(forte)


@pytest.fixture(scope="module")
def data(shown):
    return data_of(shown)


# ---------------------------------------------------------------- numbers


@given(
    st.lists(
        st.one_of(st.floats(-1e300, 1e300), st.just(np.nan), st.just(np.inf), st.just(0.25)),
        min_size=1,
        max_size=60,
    )
)
def test_packed_columns_come_back(values):
    column = np.array(values)
    packed = pack_columns(np.column_stack([column, np.full(len(column), 3.5)]))
    back = unpack(json.loads(json_text(packed)))
    good = np.isfinite(column)
    np.testing.assert_array_equal(np.isfinite(back[:, 0]), good)
    if good.any():
        span = column[good].max() / 65534 - column[good].min() / 65534
        scale = np.abs(column[good]).max()
        assert np.abs(back[good, 0] - column[good]).max() <= 0.51 * span + 2e-8 * scale
    np.testing.assert_array_equal(back[:, 1], 3.5)
    assert len(packed["data"]) <= 32 + 2 * len(column)  # constants have no integers


def test_packed_times_come_back():
    time = 1e6 + np.cumsum(np.random.default_rng(0).uniform(1e-3, 1.0, 5000))
    np.testing.assert_allclose(unpack_times(in_page(pack_times(time))) - 1e6, time - 1e6, rtol=1e-6)


@given(
    st.lists(st.floats(-1, 1), min_size=2, max_size=120),
    st.floats(1e-4, 0.5),
    st.integers(0, 2**32 - 1),
)
def test_what_is_left_out_of_a_curve_lies_near_the_line(values, tolerance, seed):
    y = np.column_stack([values, np.roll(values, 1)])
    time = np.cumsum(np.random.default_rng(seed).uniform(0.1, 1.0, len(values)))
    kept = knots(time, y, tolerance, 10_000)
    assert kept[0] == 0
    assert kept[-1] == len(values) - 1
    for k in range(2):
        line = np.interp(time, time[kept], y[kept, k])
        assert np.abs(line - y[:, k]).max() <= tolerance * (1 + 1e-9)
    assert len(knots(time, y, 0.0, 10)) <= 10


def test_the_worst_place_is_refined_first_when_samples_run_out():
    time = np.linspace(0, 1, 1001)
    y = 0.01 * np.sin(200 * time) + np.where(np.abs(time - 0.5) < 0.002, 1.0, 0.0)
    kept = knots(time, y[:, None], 0.0, 12)
    assert np.interp(0.5, time[kept], y[kept]) == pytest.approx(1.0, abs=0.02)


def test_extremes_are_kept():
    y = np.random.default_rng(3).normal(size=100_000)
    kept = extremes(y, 500)
    assert len(kept) <= 502
    assert y[kept].min() == y.min()
    assert y[kept].max() == y.max()


# ---------------------------------------------------------------- what the page holds


def test_every_curve_is_that_of_the_run(data, forte):
    from unmodeled.style import reader_unit

    (run,) = data["runs"]
    assert [o["name"] for o in run["outputs"]] == [*forte.names, "hammer_tip.speed"]
    for output in run["outputs"]:
        # The hammer flies against the x axis: its speed has the sign of the impact speed.
        sign, name = (
            (-1.0, "hammer_tip.vx") if output["name"].endswith(".speed") else (1.0, output["name"])
        )
        factor, unit = reader_unit(forte.unit(name))
        assert output["unit"] == unit
        want = sign * factor * forte[name]
        got = np.interp(
            1e3 * forte.time, unpack_times(output["time"]), unpack(output["value"])[:, 0]
        )
        assert np.abs(got - want).max() <= 4e-4 * np.ptp(want) + 1e-12, output["name"]


def test_poses_between_the_pictures_are_those_of_the_run(data, forte, action):
    stage = data["runs"][0]["stage"]
    time, poses = unpack_times(stage["time"]), unpack(stage["poses"])
    bodies = ["ground", *action.config.bodies]
    worst_place = worst_turn = 0.0
    for i in np.unique(np.linspace(0, len(forte.time) - 1, 301).astype(int)):
        want = body_poses(action, [forte[name][i] for name in action.coordinates])
        here = [np.interp(1e3 * forte.time[i], time, column) for column in poses.T]
        for k, body in enumerate(bodies):
            x, y, angle = here[3 * k : 3 * k + 3]
            worst_place = max(worst_place, abs(1e-3 * x - want[body][0]))
            worst_place = max(worst_place, abs(1e-3 * y - want[body][1]))
            worst_turn = max(worst_turn, abs(angle - want[body][2]))
    assert worst_place < 1e-4  # m: a third of a line's width
    assert worst_turn < 1e-3
    assert len(time) < 0.5 * len(forte.time)


def test_forces_of_the_arrows_are_those_of_the_run(data, forte):
    stage = data["runs"][0]["stage"]
    time, forces = 1e-3 * unpack_times(stage["time"]), unpack(stage["forces"])
    assert set(stage["numbers"]) == {c["number"] for c in stage["look"]["contacts"]}
    assert set(stage["numbers"]) == set(range(1, 16))
    for k, number in enumerate(stage["numbers"]):
        want = np.maximum(np.interp(time, forte.time, forte[f"contact{number:02d}.force"]), 0)
        np.testing.assert_allclose(forces[:, k], want, atol=1e-4 * stage["largest"])
        # Between the pictures an arrow is not off by more than a twentieth of the longest.
        at_all = np.interp(forte.time, time, forces[:, k])
        full = np.maximum(forte[f"contact{number:02d}.force"], 0)
        off = np.abs(np.sqrt(at_all) - np.sqrt(full)) / np.sqrt(stage["largest"])
        assert off.max() < 0.2, number
    np.testing.assert_allclose(
        unpack(stage["finger"])[:, 0],
        np.interp(time, forte.time, forte["finger.force"]),
        atol=1e-3,
    )


def test_the_string_vibrates_as_in_the_run(data, forte):
    stage = data["runs"][0]["stage"]
    modes, packed = stage["modes"], stage["look"]["string"]["shapes"]
    time, eta = unpack_times(modes["time"]), unpack(modes["eta"])
    shapes = unpack(packed)[:, modes["which"]]
    y = np.linspace(0, forte.provenance["string"]["length"], packed["n"])
    w = 1e3 * forte.string_displacement(y)
    after = forte.time > 1e-3 * time[1]
    assert np.all(np.abs(w[~after]) < 1e-4)
    assert time[1:-1] == pytest.approx(1e3 * forte.time[after][:-1], abs=1e-3) or len(time) > 3000
    some = np.searchsorted(1e3 * forte.time, time[1:-1] - 1e-3)
    assert np.abs(eta[1:-1] @ shapes.T - w[some]).max() < 2e-3 * np.abs(w).max()
    assert modes["largest"] == pytest.approx(np.abs(w).max(), rel=1e-3)


def test_points_come_back_line_by_line():
    lines = [np.zeros((0, 2)), np.array([[0.1, -650.25]]), np.arange(8.0).reshape(4, 2)]
    back = unpack_points(in_page(pack_points(lines)))
    assert [len(line) for line in back] == [0, 1, 4]
    for a, b in zip(lines, back, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-7)
    assert pack_points([]) == {"counts": [], "data": b""}


def test_poses_along_are_those_of_each_pose(forte):
    action = run_action(forte)
    q = np.column_stack([forte[name] for name in action.coordinates])[::400]
    way = poses_along(action, q)
    point = np.array([[0.01, -0.02]])
    for i, pose in enumerate(q):
        poses, rows, beams = (f(action, pose) for f in (body_poses, contact_rows, bent_beams))
        assert {n: tuple(v[i]) for n, v in way.bodies.items()} == poses
        assert {n: tuple(v[i]) for n, v in way.contacts.items()} == {
            n: row[:4] for n, row in rows.items()
        }
        for name, line in beams.items():
            np.testing.assert_array_equal(way.beams[name][i], line)
        x, y = way.to_ground("shank", point)[:, i, 0]
        assert (x, y) == pytest.approx(to_ground(poses["shank"], point)[0], abs=1e-15)
        back = way.to_body("shank", np.full((len(q), 2), [x, y]))[i]
        assert back == pytest.approx(to_body(poses["shank"], np.array([[x, y]]))[0], abs=1e-15)
    with pytest.raises(InvalidParameter, match="move_through"):
        poses_along(action, q[:, 1:])


def test_shapes_are_those_of_the_drawing(data, forte):
    stage = data["runs"][0]["stage"]
    drawn = Film(forte, run_action(forte), 1e-3 * unpack_times(stage["time"])).scene
    look = stage["look"]
    assert len(look["shapes"]) == len(drawn.shapes)
    by_role = [s.role for s in drawn.shapes]
    assert [s["role"] for s in look["shapes"]] == by_role
    outlines = unpack_points(look["outlines"])
    for points, shape in zip(outlines, drawn.shapes, strict=True):
        if shape.role == "wood":
            np.testing.assert_allclose(
                points.min(axis=0), 1e3 * shape.points.min(axis=0), atol=0.03
            )


def test_beams_end_where_the_next_body_begins(data, action):
    stage = data["runs"][0]["stage"]
    poses = unpack(stage["poses"])
    bodies = ["ground", *action.config.bodies]
    child = {b.parent: n for n, b in action.config.bodies.items()}
    beams = stage["look"]["beams"]
    assert {bodies[b["body"]] for b in beams} == {"shank", "wire"}
    for beam, packed in zip(beams, stage["lines"], strict=True):
        line, k = unpack(packed), beam["body"]
        for i in (0, len(line) // 3, len(line) - 1):
            here = to_ground(tuple(poses[i, 3 * k : 3 * k + 3]), line[i, -2:][None, :])[0]
            n = bodies.index(child[bodies[k]])
            np.testing.assert_allclose(here, poses[i, 3 * n : 3 * n + 2], atol=0.02)


def test_events_and_panels(data, forte):
    (run,) = data["runs"]
    times = dict((name, t) for t, name in run["events"])
    assert times["string contact on"] == pytest.approx(
        1e3 * forte.event_time("string_contact_on"), abs=1e-3
    )
    names = [n for p in data["panels"] for n in p["outputs"]]
    assert {"hammer_tip.speed", "contact06.force", "finger.force", "string.strike"} <= set(names)
    labels = {o["name"]: o["label"] for o in run["outputs"]}
    assert labels["contact06.force"] == "6 hammer - string"


def test_a_stroke_is_small_and_two_are_too(shown, forte, piano):
    assert len(shown.encode()) < 1.5e6
    assert len(page([forte, piano]).encode()) < 3e6


# ---------------------------------------------------------------- one file, safe


def test_it_is_one_file_that_loads_nothing(shown):
    parsed = Parsed(shown)
    assert not re.search(r"https?:|url\(|@import", shown)
    reach = r"fetch|import\(|XMLHttp|WebSocket|eval\(|innerHTML|Function\(|document\.write"
    assert not re.search(reach, parsed.scripts[1])
    for _, attributes in parsed.tags:
        assert not {"src", "href", "action", "data", "onload"} & set(attributes)
    (policy,) = [a["content"] for t, a in parsed.tags if t == "meta" and "http-equiv" in a]
    assert policy.startswith("default-src 'none'; script-src 'sha256-")
    digest = base64.b64encode(hashlib.sha256(parsed.scripts[1].encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}';" in policy  # only our script runs, whatever else is in


def test_texts_of_files_stay_texts(action):
    raw = action.raw
    printable = EVIL.replace("\u2028", "")  # refused in a mechanism
    raw["name"] = printable
    raw["contacts"]["06"]["label"] = printable
    stroke = feltmb.ramp_stroke(25.0, 0.001, 0.02, duration=0.05, name=EVIL)
    run = feltmb.simulate(Action(raw), stroke, 0.05)
    measured = Curves(EVIL, [0.0, 1.0], {EVIL: [0.0, 1.0]}, {EVIL: EVIL})
    text = page([run, measured])
    parsed = Parsed(text)
    assert len(parsed.scripts) == 2
    assert "b" not in {tag for tag, _ in parsed.tags}
    assert EVIL in parsed.title
    assert "alert('1')</script>" not in text
    data = json.loads(parsed.scripts[0])
    assert data["runs"][1]["name"] == EVIL
    assert data["runs"][1]["outputs"][0]["unit"] == EVIL


def test_the_same_run_gives_the_same_bytes(forte, shown):
    assert page(forte) == shown


def test_several_viewers_share_one_script(forte, piano):
    parts = fragment(forte, window=(0.08, 0.1)), fragment([forte, piano], window=(0.08, 0.1))
    assert all(p.count("<script") == 1 and p.startswith('<div class="feltmb-view"') for p in parts)
    assert assets().count("<script>") == 1
    assert data_of(parts[1])["runs"][1]["name"] == "steinway45 · piano"


# ---------------------------------------------------------------- several runs, curves, faults


def test_names_are_told_apart(forte):
    names = [r["name"] for r in data_of(fragment([forte, forte], window=(0.08, 0.1)))["runs"]]
    assert names == ["steinway45 · forte (1)", "steinway45 · forte (2)"]


def test_a_run_without_its_mechanism_still_shows_its_curves(forte):
    bare = dataclasses.replace(forte, provenance={"action": "x"})
    (run,) = data_of(fragment(bare))["runs"]
    assert run["stage"] is None
    assert "does not hold the parameters" in run["note"]
    assert len(run["outputs"]) == len(forte.names)


def test_a_run_with_holes_still_shows_its_curves(forte):
    values = forte.values.copy()
    values[100:200, 0] = np.nan
    (run,) = data_of(fragment(dataclasses.replace(forte, values=values)))["runs"]
    assert "no finite numbers" in run["note"]
    output = run["outputs"][0]
    time, column = unpack_times(output["time"]), unpack(output["value"])[:, 0]
    hole = (time >= 1e3 * forte.time[100] - 1e-6) & (time <= 1e3 * forte.time[199] + 1e-6)
    assert np.all(np.isnan(column) == hole)


def test_measured_curves_are_shown_in_the_units_of_the_run(tmp_path, forte):
    path = tmp_path / "rig.csv"
    path.write_text(
        "# of the rig\ntime [ms],hammer_tip.vx [mm/s],voltage [V]\n80,-1500,2\n90,,2.5\n95,200,1\n"
    )
    measured = read_curves(path)
    np.testing.assert_allclose(measured.time, [0.08, 0.09, 0.095])
    np.testing.assert_allclose(measured.values["hammer_tip.vx"], [-1.5, np.nan, 0.2])
    data = data_of(fragment([forte, measured]))
    second = data["runs"][1]
    assert second["name"] == "rig"
    assert [(o["name"], o["unit"]) for o in second["outputs"]] == [
        ("hammer_tip.vx", "m/s"),
        ("voltage", "V"),
    ]
    assert any(p["outputs"] == ["hammer_tip.vx"] for p in data["panels"])


@pytest.mark.parametrize(
    ("text", "faults"),
    [
        ("", ["expected a header"]),
        ("a,b\n1,2\n2,3\n", ["expected a column time [s]; there are a, b"]),
        ("time [ms],b,b\n1,2,3\n2,3,4\n", ["there is no curve"]),  # of one name
        (
            "time [mm],b [mm]\n1,x\n2,2\n3\n4,4\n",
            ["line 2: b = 'x'", "line 4: 1 cells", "time: unit 'mm'"],
        ),
        ("time [s],b\n1,2\n", ["2 lines, expected a header and at least 2 samples"]),
        (
            "time [s],b\n1,2\n1,3\n0,3\n",
            ["line 3: time does not grow", "line 4: time does not grow"],
        ),
        ("time [mm],b\n1,2\n2,3\n", ["column time: unit 'mm', expected a unit of time"]),
    ],
)
def test_all_faults_of_a_table_are_told_at_once(tmp_path, text, faults):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(DataError) as caught:
        read_curves(path)
    for fault in faults:
        assert fault in str(caught.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"slowness": 0}, "slowness = 0"),
        ({"slowness": float("nan")}, "slowness: got nan"),
        ({"window": (1.0, 2.0)}, "holds nothing"),
        ({"align": "nope"}, "no event 'nope'.*string_contact_on"),
        ({"names": ["a", "b"]}, "2 names of 1 runs"),
        ({"at": float("inf")}, "at: got inf"),
    ],
)
def test_wrong_arguments_are_refused(forte, tmp_path, options, message):
    with pytest.raises(InvalidParameter, match=message):
        view(forte, tmp_path / "a.html", **options)
    with pytest.raises(InvalidParameter, match=r"cannot write \.pdf, expected \.html"):
        view(forte, tmp_path / "a.pdf")
    with pytest.raises(InvalidParameter, match="got 7 runs"):
        view([forte] * 7, tmp_path / "a.html")
    assert not list(tmp_path.iterdir())


def test_the_command_writes_the_page_and_keeps_what_is_there(root, tmp_path):
    small = feltmb.load_action(root / "tests" / "data" / "pendulum.toml")
    for name in ("piano", "forte"):
        feltmb.simulate(small, name, 0.2).save(tmp_path / f"{name}.nc")

    def call(*arguments):
        with pytest.raises(SystemExit) as end:
            main(["view", *map(str, arguments)])
        return end.value.code

    files = tmp_path / "forte.nc", tmp_path / "piano.nc"
    assert call(*files, "--align", "head_away") == 0
    path = tmp_path / "forte.html"
    data = data_of(path.read_text(encoding="utf-8"))
    assert [r["name"] for r in data["runs"]] == ["forte", "piano"]  # the files
    # Files with one name in two folders have their folders.
    (tmp_path / "before").mkdir()
    before = feltmb.load_run(files[0]).save(tmp_path / "before" / "forte.nc")
    assert call(files[0], before, "-o", tmp_path / "two.html") == 0
    two = data_of((tmp_path / "two.html").read_text(encoding="utf-8"))
    assert [r["name"] for r in two["runs"]] == [str(files[0]), str(before)]
    assert call(files[0], "-o", tmp_path / "one.html") == 0
    one = data_of((tmp_path / "one.html").read_text(encoding="utf-8"))
    assert [r["name"] for r in one["runs"]] == ["pendulum · forte"]
    assert data["align"] == "head away"
    path.write_text("mine")
    with pytest.raises(FileExists):
        view(feltmb.load_run(files[0]), path)
    assert call(*files) == 2
    assert path.read_text() == "mine"


def test_what_a_thinned_outline_leaves_out_lies_near_what_remains():
    rng = np.random.default_rng(2)
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    outlines = [np.cumsum(rng.normal(size=(n, 2)), axis=0) for n in (1, 2, 3, 40, 150)]
    outlines += [np.column_stack([np.cos(angle), np.sin(angle)])]
    for outline in outlines:
        for tolerance in (1e-3, 0.3, 3.0):
            kept = thin_outline(outline, tolerance)
            index = [int(np.flatnonzero((outline == p).all(axis=1))[0]) for p in kept]
            index[-1] = len(outline) - 1
            assert index[0] == 0
            for a, b in itertools.pairwise(index):
                d = outline[b] - outline[a]
                off = outline[a : b + 1] - outline[a]
                share = np.clip(off @ d / max(float(d @ d), 1e-30), 0.0, 1.0)
                assert np.hypot(*(off - share[:, None] * d).T).max() <= tolerance
    assert len(thin_outline(outlines[-1], 1e-3)) < 80
    assert len(thin_outline(np.column_stack([angle, 2.0 * angle]), 1e-9)) == 2
