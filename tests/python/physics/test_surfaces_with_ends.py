"""Segments and arcs of concave circles: closed forms, exact slopes, motion past ends."""

import math

import numpy as np
import pytest

import feltmb
from feltmb import _core

BALL = 0.004

MACHINE = """
schema = 1
name = "ends"

[gravity]
value = [0.0, 0.0]
unit = "m/s^2"

[bodies.host]
coordinate = "turn"
position = [0.01, -0.02]
mass = 0.2
center_of_mass = [0.0, 0.01]
inertia = 1e-4

[bodies.sled]
joint = "prismatic"
axis = [1.0, 0.0]
coordinate = "x"
position = [0.0, 0.0]
mass = 0.05

[bodies.ball]
parent = "sled"
joint = "prismatic"
axis = [0.0, 1.0]
coordinate = "y"
position = [0.0, 0.0]
mass = 0.02
inertia = 1e-6

[springs.host]
coordinate = "turn"
stiffness = 5.0
rest_angle = 0.0

[springs.x]
coordinate = "x"
stiffness = 20.0
rest_angle = {x0}

[springs.y]
coordinate = "y"
stiffness = 20.0
rest_angle = {y0}

[surfaces.round]
body = "ball"
kind = "circle"
point = [0.0, 0.0]
radius = 0.004

[surfaces.host]
body = "{body}"
{surface}

[contacts.01]
surfaces = ["host", "round"]
law = "hunt_crossley"
hunt_crossley = {{ stiffness = 2e5, exponent = 1.5, damping = 0.3 }}
friction = {{ amplitude = 0.2, b1 = 0.0, b2 = 0.0, threshold_speed = 0.01 }}
"""

SEGMENT = 'kind = "segment"\npoint = [0.01, 0.03]\nend = [-0.02, 0.02]'
BAR = SEGMENT + "\nradius = 0.002"
ARC = (
    'kind = "concave_arc"\npoint = [0.0, 0.0]\nradius = 0.02\n'
    'arc = {{ value = [{}, {}], unit = "deg" }}'
)


def machine(tmp_path, surface, body="host", x0=0.0, y0=0.0):
    path = tmp_path / "ends.toml"
    path.write_text(MACHINE.format(surface=surface, body=body, x0=x0, y0=y0))
    return feltmb.load_action(path)


def compression(action, q):
    """By the core, and the unit normal into the ball."""
    row = feltmb.evaluate(action, q, np.zeros(3)).contacts.loc[1]
    return row["compression"], np.array([row["normal_x"], row["normal_y"]])


def in_host(q):
    """Place of the ball in the frame of the host."""
    c, s = math.cos(q[0]), math.sin(q[0])
    d = np.array([q[1] - 0.01, q[2] + 0.02])
    return np.array([c * d[0] + s * d[1], -s * d[0] + c * d[1]])


def of_segment(place, radius):
    """A line that ends has one face, a bar two."""
    a, b = np.array([0.01, 0.03]), np.array([-0.02, 0.02])
    way = (b - a) / np.linalg.norm(b - a)
    along = way @ (place - a)
    if along < 0.0:
        return BALL + radius - np.linalg.norm(place - a)
    if along > np.linalg.norm(b - a):
        return BALL + radius - np.linalg.norm(place - b)
    height = np.array([-way[1], way[0]]) @ (place - a)
    return BALL + radius - (abs(height) if radius else height)


def of_arc(place, low, high):
    """Inside a concave circle, of which only an arc is there."""
    radius = 0.02
    angle = math.degrees(math.atan2(place[1], place[0]))
    if (angle - low) % 360.0 <= high - low:
        return float(np.linalg.norm(place)) + BALL - radius
    ends = [radius * np.array([math.cos(a), math.sin(a)]) for a in np.radians([low, high])]
    return BALL - min(float(np.linalg.norm(place - e)) for e in ends)


@pytest.mark.parametrize("radius", [0.0, 0.002])
def test_distance_to_a_segment(tmp_path, radius):
    """Face, ends and behind the ends; on a body that turns."""
    action = machine(tmp_path, BAR if radius else SEGMENT)
    assert action.coordinates == ("turn", "x", "y")
    generator = np.random.default_rng(1)
    parts = set()
    for q in generator.uniform([-0.6, -0.03, -0.02], [0.6, 0.04, 0.04], size=(400, 3)):
        place = in_host(q)
        got, normal = compression(action, q)
        assert got == pytest.approx(of_segment(place, radius), abs=1e-12)
        assert np.linalg.norm(normal) == pytest.approx(1.0)
        way = np.array([-0.03, -0.01]) / math.hypot(0.03, 0.01)
        along = way @ (place - [0.01, 0.03])
        parts.add(-1 if along < 0 else 1 if along > math.hypot(0.03, 0.01) else 0)
    assert parts == {-1, 0, 1}


@pytest.mark.parametrize(("low", "high"), [(200.0, 330.0), (-40.0, 60.0), (10.0, 280.0)])
def test_distance_to_a_concave_arc(tmp_path, low, high):
    """Less and more than half a turn; the ball is held inside and passes through the gap."""
    action = machine(tmp_path, ARC.format(low, high))
    generator = np.random.default_rng(2)
    inside = 0
    for q in generator.uniform([-0.6, -0.02, -0.05], [0.6, 0.04, 0.01], size=(400, 3)):
        place = in_host(q)
        if np.linalg.norm(place) < 1e-3:
            continue
        got, _ = compression(action, q)
        assert got == pytest.approx(of_arc(place, low, high), abs=1e-12)
        angle = math.degrees(math.atan2(place[1], place[0]))
        inside += (angle - low) % 360.0 <= high - low
    assert 0.1 * 400 < inside < 0.9 * 400


@pytest.mark.parametrize("surface", [SEGMENT, BAR, ARC.format(200.0, 330.0)])
def test_a_circle_rolls_over_an_end_without_a_corner(tmp_path, surface):
    """Compression and normal go on where the face passes into the end; the slope does, too."""
    action = machine(tmp_path, surface, body="ground")
    if surface.startswith('kind = "segment"'):
        end = np.array([0.01, 0.03])
        way = np.array([-0.03, -0.01]) / math.hypot(0.03, 0.01)
        radius = BALL + (0.002 if surface == BAR else 0.0) - 1e-4
        start, across = end + radius * np.array([-way[1], way[0]]), way
    else:
        angle = math.radians(200.0)
        out = np.array([math.cos(angle), math.sin(angle)])
        start, across = (0.02 - BALL + 1e-4) * out, np.array([-out[1], out[0]])
    h = 1e-8
    seen = [compression(action, [0.0, *(start + k * h * across)]) for k in (-2, -1, 1, 2)]
    e = [s[0] for s in seen]
    assert max(e) - min(e) < 1e-10
    slopes = [(e[1] - e[0]) / h, (e[3] - e[2]) / h]
    assert abs(slopes[1] - slopes[0]) < 1e-4
    assert np.max(np.abs(seen[0][1] - seen[3][1])) < 1e-4


PLACES = {
    # surface, host, place of the ball in it at which it presses by about 0.1 mm
    "face": (SEGMENT, np.array([-0.005, 0.025]) + 0.0039 * np.array([0.01, -0.03]) / 0.0316228),
    "first end": (SEGMENT, np.array([0.01, 0.03]) + 0.0039 * np.array([0.8, 0.6])),
    "second end": (SEGMENT, np.array([-0.02, 0.02]) + 0.0039 * np.array([-0.8, -0.6])),
    "bar's end": (BAR, np.array([-0.02, 0.02]) + 0.0059 * np.array([-0.6, 0.8])),
    "arc": (ARC.format(200.0, 330.0), 0.0161 * np.array([math.cos(4.6), math.sin(4.6)])),
    "arc's end": (
        ARC.format(200.0, 330.0),
        0.02 * np.array([math.cos(math.radians(330)), math.sin(math.radians(330))])
        + 0.0039 * np.array([-0.6, 0.8]),
    ),
}


@pytest.mark.parametrize("name", PLACES)
def test_slopes_are_exact(tmp_path, name):
    """The structured Newton matrix against differences of the right-hand side."""
    surface, place = PLACES[name]
    action = machine(tmp_path, surface)
    turn = 0.3
    c, s = math.cos(turn), math.sin(turn)
    q = [turn, 0.01 + c * place[0] - s * place[1], -0.02 + s * place[0] + c * place[1]]
    assert 5e-5 < compression(action, q)[0] < 2e-4
    y = np.array([*q, 0.7, -0.02, 0.03])
    drive = _core.InputSignal(_core.Profile([0.0], [0.0], _core.Interpolation.linear))
    gamma = 2e-4
    inverse = _core.jacobian_check(action.mechanism, y, drive, 0.0, gamma)
    jacobian = np.zeros((6, 6))
    for j in range(6):
        h = 1e-7 if j >= 3 else 1e-9
        shift = np.zeros(6)
        shift[j] = h
        ahead = _core.rhs(action.mechanism, y + shift, drive, 0.0)
        back = _core.rhs(action.mechanism, y - shift, drive, 0.0)
        jacobian[:, j] = (np.asarray(ahead) - np.asarray(back)) / (2 * h)
    wanted = np.eye(6) - gamma * jacobian
    assert np.allclose(inverse @ wanted, np.eye(6), atol=2e-5)


def test_a_ball_falls_past_the_end_of_a_segment(tmp_path):
    """On an infinite line it would lie; energy is accounted for, and so is the gradient."""
    stroke = feltmb.table_stroke([0.0, 1.0], [0.0, 0.0], interpolation="linear", duration=0.12)
    flat = 'kind = "segment"\npoint = [0.005, 0.0]\nend = [-0.03, 0.0]'
    # Drawn to the right and down, over the first end.
    action = machine(tmp_path, flat, body="ground", x0=0.03, y0=-0.01)
    start = feltmb.simulate(
        machine(tmp_path, flat, body="ground", x0=-0.01, y0=0.02), stroke, output_rate=2e3
    )
    assert start.status == "done"
    run = feltmb.simulate(action, stroke, output_rate=2e3)
    assert abs(run.energy["residual_relative"]) < 1e-4
    way = feltmb.gradient(action, stroke, ["springs.x.rest_angle"], ["x"])
    assert np.all(np.isfinite(np.asarray(way.values)))


@pytest.mark.parametrize(
    ("surface", "message"),
    [
        ('kind = "segment"\npoint = [0.0, 0.0]', r"surfaces\.host\.end: is missing"),
        ('kind = "segment"\npoint = [0.0, 0.0]\nend = [0.0, 0.0]', "is 0 m long from point to"),
        (
            'kind = "segment"\npoint = [0.0, 0.0]\nend = [0.0, 1e300]',
            "got 1e\\+300 m, expected at most",
        ),
        (
            'kind = "concave_arc"\npoint = [0.0, 0.0]\nradius = 0.02',
            r"surfaces\.host\.arc: is missing",
        ),
        (ARC.format(10.0, 5.0), "must grow by less than a turn"),
        (
            'kind = "concave_arc"\npoint = [0.0, 0.0]\nradius = 0.003\narc = [0.0, 1.0]',
            "does not fit into the concave",
        ),
        (
            'kind = "line"\npoint = [0.0, 0.0]\nnormal = [0.0, 1.0]\nend = [1.0, 0.0]',
            r"surfaces\.host\.end: kind 'line' has no end; these have: 'segment'",
        ),
    ],
)
def test_faults(tmp_path, surface, message):
    with pytest.raises(feltmb.InvalidParameter, match=message):
        machine(tmp_path, surface)


def test_drawn_as_they_are(tmp_path):
    """The outline of a segment ends where the segment does."""
    from feltmb.graphics.plot.shapes import scene

    action = machine(tmp_path, SEGMENT)
    [line] = [s.points for s in scene(action).shapes if s.name == "host" and s.role == "surface"]
    for surface in (BAR, ARC.format(200.0, 330.0)):
        assert all(np.all(np.isfinite(s.points)) for s in scene(machine(tmp_path, surface)).shapes)
    assert np.allclose(sorted(map(tuple, line)), [(-0.02, 0.02), (0.01, 0.03)])


def test_validate_warns_of_a_line_that_carries_beyond_its_body(tmp_path, capsys):
    """The ball presses on a line of the ground 50 mm from all that the ground has."""
    from feltmb.cli import main
    from feltmb.run.reach import unreached_lines

    line = 'kind = "line"\npoint = [0.0, -0.01]\nnormal = [0.0, 1.0]'
    far = machine(tmp_path, line, body="ground", x0=0.05, y0=-0.02)
    [warning] = unreached_lines(far)
    assert "contacts.01: the infinite line host carries round at rest" in warning
    assert "36.0 mm beyond all points of ground" in warning
    with pytest.raises(SystemExit) as end:
        main(["validate", str(tmp_path / "ends.toml")])
    assert end.value.code == 0
    assert "warning" in capsys.readouterr().err
    # Nearer than its radius to what is there, not touched, or with an end: nothing to say.
    assert unreached_lines(machine(tmp_path, line, body="ground", x0=0.012, y0=-0.02)) == []
    assert unreached_lines(machine(tmp_path, line, body="ground", x0=0.05, y0=0.02)) == []
    ended = 'kind = "segment"\npoint = [0.1, -0.01]\nend = [0.0, -0.01]\n'
    assert unreached_lines(machine(tmp_path, ended, body="ground", x0=0.05, y0=-0.02)) == []


@pytest.mark.parametrize("name", feltmb.packaged_actions())
def test_packaged_mechanisms_reach_what_they_carry(name):
    from feltmb.run.reach import unreached_lines

    assert unreached_lines(feltmb.load_action(name)) == []
