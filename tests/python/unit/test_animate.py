"""Moving pictures: what moves is the run, and no text of a file gets out of its place."""

import html.parser
import itertools
import json
import re

import numpy as np
import pytest

import feltmb
from feltmb import Action, FileExists, InvalidParameter, plot
from feltmb.animate import _Film, _times, animate
from feltmb.plot.poses import to_ground

EVIL = "</script><script>alert('1')</script>&<b>"


@pytest.fixture(scope="module")
def action():
    return feltmb.load_action("steinway45")


@pytest.fixture(scope="module")
def run(action):
    return feltmb.simulate(action, "forte")


class Page(html.parser.HTMLParser):
    """Tags, and the text of each script and of the heading."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.scripts, self.heading = [], [], ""
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
        elif self._in == "h1":
            self.heading += data


@pytest.fixture(scope="module")
def page(run, tmp_path_factory):
    path = animate(run, tmp_path_factory.mktemp("html") / "forte.html", window=(0.08, 0.11))
    return Page(path.read_text(encoding="utf-8")), path


def test_html_holds_the_motion_of_the_run(page, run, action):
    data = json.loads(page[0].scripts[0])
    time = 1e-3 * np.array(data["time"])
    assert time[0] == pytest.approx(0.08)
    assert time[-1] == pytest.approx(0.11, abs=2 * (time[1] - time[0]))
    bodies = ["ground", *action.config.bodies]
    for i in (0, len(time) // 2, len(time) - 1):
        q = [np.interp(time[i], run.time, run[name]) for name in action.coordinates]
        want = plot.body_poses(action, q)
        for name, (x, y, angle) in zip(bodies, data["poses"][i], strict=True):
            np.testing.assert_allclose([1e-3 * x, 1e-3 * y, angle], want[name], atol=2e-5)
    np.testing.assert_allclose(
        data["speed"], -np.interp(time, run.time, run["hammer_tip.vx"]), atol=1e-3
    )
    assert {c["number"] for c in data["contacts"]} == set(range(1, 16))
    for contact in data["contacts"]:
        force = np.interp(time, run.time, run[f"contact{contact['number']:02d}.force"])
        np.testing.assert_allclose(contact["force"], force, atol=0.02)
    # The string bends away from the hammer, to negative x, by what the run says.
    strike = np.interp(time, run.time, run["string.strike"])
    deepest = int(np.argmax(strike))
    bulge = np.array(data["string"][0])[:, 0] - np.array(data["string"][deepest])[:, 0]
    assert 1e-3 * bulge.max() == pytest.approx(strike.max(), rel=0.05)


def test_html_beams_end_where_the_next_body_begins(page):
    data = json.loads(page[0].scripts[0])
    action = feltmb.load_action("steinway45")
    bodies = ["ground", *action.config.bodies]
    child = {b.parent: n for n, b in action.config.bodies.items()}
    assert {bodies[beam["b"]] for beam in data["beams"]} == {"shank", "wire"}
    for beam in data["beams"]:
        name = bodies[beam["b"]]
        for i in (0, len(data["time"]) // 3, len(data["time"]) - 1):
            end = np.array([beam["line"][i][-1]])
            here = to_ground(data["poses"][i][beam["b"]], end)[0]
            there = data["poses"][i][bodies.index(child[name])][:2]
            np.testing.assert_allclose(here, there, atol=5e-3)


def test_html_shapes_are_those_of_the_drawing(page, run):
    data = json.loads(page[0].scripts[0])
    film = _Film(run, plot.run_action(run), 1e-3 * np.array(data["time"]))
    assert len(data["shapes"]) == len(film.scene.shapes)
    for given, shape in zip(data["shapes"], film.scene.shapes, strict=True):
        assert given["r"] == shape.role
        low, high = 1e3 * shape.points.min(axis=0), 1e3 * shape.points.max(axis=0)
        points = np.array(given["p"])
        np.testing.assert_allclose(points.min(axis=0), low, atol=0.03)
        np.testing.assert_allclose(points.max(axis=0), high, atol=0.03)


def test_html_is_one_file_that_loads_nothing(page):
    parsed, path = page
    text = path.read_text(encoding="utf-8")
    assert "http" not in re.sub(r'http-equiv="', "", text)
    assert not re.search(r"://|url\(|fetch|import|XMLHttp|WebSocket|eval", parsed.scripts[1])
    for _, attributes in parsed.tags:
        assert not {"src", "href", "action", "data"} & set(attributes)
    policy = [a["content"] for t, a in parsed.tags if t == "meta" and "http-equiv" in a]
    assert policy
    assert "default-src 'none'" in policy[0]
    assert path.stat().st_size < 4e6


def test_html_escapes_the_texts_of_files(action, tmp_path):
    raw = action.raw
    raw["name"] = EVIL
    raw["contacts"]["06"]["label"] = EVIL
    stroke = feltmb.ramp_stroke(25.0, 0.001, 0.02, duration=0.05, name=EVIL)
    run = feltmb.simulate(Action(raw), stroke, 0.05)
    path = animate(run, tmp_path / "evil.html")
    text = path.read_text(encoding="utf-8")
    parsed = Page(text)
    assert len(parsed.scripts) == 2
    assert "b" not in {tag for tag, _ in parsed.tags}
    assert parsed.heading == f"{EVIL} · {EVIL}"
    labels = {c["number"]: c["label"] for c in json.loads(parsed.scripts[0])["contacts"]}
    assert labels[6] == EVIL
    assert "alert('1')</script>" not in text
    plot.contact_forces(run).canvas.draw()
    plot.mechanism(plot.run_action(run)).canvas.draw()


def test_gif_has_the_asked_pictures_at_the_asked_speed(run, tmp_path):
    from PIL import Image

    told = []
    path = animate(
        run, tmp_path / "a.gif", fps=20, slowness=40, window=(0.085, 0.105), progress=told.append
    )
    with Image.open(path) as image:
        assert image.n_frames == 17  # 20 ms, 40 times slower, 20 a second, and the last
        assert image.info["duration"] == 50
        assert image.info["loop"] == 0
        pictures = []
        for i in range(image.n_frames):
            image.seek(i)
            pictures.append(np.asarray(image.convert("RGB")).astype(int))
    assert told[-1] == 1.0
    assert len(told) == 17
    first = pictures[0]
    assert tuple(first[first.shape[0] // 2, -3]) == (255, 255, 255)
    ink = float(np.mean(first.min(axis=2) < 200))
    assert 0.01 < ink < 0.4
    for a, b in itertools.pairwise(pictures):
        changed = float(np.mean(np.abs(a - b).max(axis=2) > 40))
        assert 0.0005 < changed < 0.2


def test_gif_of_the_forte_stroke_is_small(run, tmp_path):
    assert animate(run, tmp_path / "forte.gif").stat().st_size < 4e6


def test_forces_point_into_the_bodies_that_move(run, action):
    film = _Film(run, action, _times(0.088, 0.12, 2e-4))

    def arrows(number):
        i = int(np.argmax(film.forces[number]))
        film_of_one = film.contacts
        film.contacts, finger, film.finger = [number], film.finger, None
        try:
            return [head - tail for tail, head in film.arrows(i, film.poses(i))]
        finally:
            film.contacts, film.finger = film_of_one, finger

    up, player = np.array([0.0, 1.0]), np.array([1.0, 0.0])
    for number in (2, 15):  # rail on key
        (arrow,) = arrows(number)
        assert arrow @ up > 0.95 * np.linalg.norm(arrow)
    (arrow,) = arrows(6)  # string on hammer
    assert arrow @ player > 0.95 * np.linalg.norm(arrow)
    (arrow,) = arrows(5)  # let-off button on jack toe
    assert arrow @ up < -0.9 * np.linalg.norm(arrow)
    for number in (3, 4, 8):  # two bodies that move: action and reaction
        first, second = arrows(number)
        np.testing.assert_allclose(first, -second)
    longest = film.arrow_length(film.largest)
    assert film.arrow_length(film.largest / 4) == pytest.approx(longest / 2)
    assert film.arrow_length(0.0) == 0.0


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("a.mp4", {}, r"expected a name in \.gif or \.html"),
        ("a.gif", {"fps": 0}, "fps = 0"),
        ("a.gif", {"fps": float("nan")}, "fps = nan"),
        ("a.html", {"slowness": -1}, "slowness = -1"),
        ("a.html", {"window": (1.0, 2.0)}, "holds nothing of the run"),
        ("a.gif", {"window": (0.1, 0.1)}, "holds nothing of the run"),
        ("a.gif", {"slowness": 1e5}, "the limit is 5000"),
    ],
)
def test_wrong_arguments_are_refused(run, tmp_path, name, options, message):
    with pytest.raises(InvalidParameter, match=message):
        animate(run, tmp_path / name, **options)
    assert not list(tmp_path.iterdir())


def test_an_existing_file_is_kept(run, tmp_path):
    path = tmp_path / "a.html"
    path.write_text("mine")
    with pytest.raises(FileExists):
        animate(run, path)
    assert path.read_text() == "mine"
    animate(run, path, force=True, window=(0.09, 0.092))
    assert path.read_text().startswith("<!DOCTYPE html>")
