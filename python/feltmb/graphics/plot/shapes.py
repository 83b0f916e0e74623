"""Shapes of a mechanism, independent of its pose."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from feltmb.graphics.plot.outlines import (
    arc_points,
    capsule,
    dense_outline,
    round_box,
    shortest_tree,
    wrap_angle,
)
from feltmb.graphics.plot.poses import (
    Pose,
    bend,
    body_poses,
    poses_along,
    station,
    string_line,
    to_ground,
)
from feltmb.mechanism.to_core import with_leads
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter

if TYPE_CHECKING:
    from feltmb.mechanism import Action, Body, MechanismFile, Surface

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Shape:
    """A polygon or polyline fixed to a body.

    Attributes
    ----------
    body, role, name : str
        ``role`` is ``wood``, ``wire``, ``lead``, ``pad`` (the part around a contact surface),
        ``surface`` (the exact contact geometry), or ``mark``; ``name`` is the name of the surface,
        point or lead.
    points : ndarray (n, 2)
        Points in the frame of the body [m].
    closed : bool
        Whether it is a polygon instead of a polyline.
    """

    body: str
    role: str
    name: str
    points: Array
    closed: bool


@dataclass(frozen=True)
class Scene:
    """Drawing of a mechanism, independent of its pose.

    Attributes
    ----------
    shapes : tuple of Shape
        Shapes in the order of drawing.
    group : dict
        Body -> index of its group of rigidly connected bodies; ground is -1.
    unit : float
        Length [m] that is small for this mechanism.
    """

    shapes: tuple[Shape, ...]
    group: dict[str, int]
    unit: float


def _unit(action: Action, poses: Mapping[str, Pose]) -> float:
    """Size of the mechanism divided by 500: one millimeter for an upright action."""
    points = [
        to_ground(poses[s.body], np.array([s.point]))
        for s in action.config.surfaces.values()
        if s.radius is None or s.radius < 0.05
    ]
    points += [np.array([pose[:2]]) for pose in poses.values()]
    points += [to_ground(poses[p.body], np.array([p.point])) for p in action.config.points.values()]
    cloud = np.vstack(points)
    size = float(np.max(np.ptp(cloud, axis=0)))
    # A body without dimensions is at least as large as a wooden block of its mass.
    size = max(size, 4.0 * max((_side(b.mass) for b in action.config.bodies.values()), default=0.0))
    # Rounded to three digits, so that small changes do not change the drawing.
    return float(f"{size / 500.0:.3g}") if size > 0 else 1e-3


def _whole(low: float, high: float, step: float) -> tuple[float, float]:
    """Range that is extended to whole steps, so that small changes do not change the pieces."""
    return math.floor(low / step) * step, math.ceil(high / step) * step


#: Radius of a drawn lead of half an inch [m].
LEAD = 6.35e-3
#: Density of wood [kg/m^3], for the size of a mass without known dimensions.
_WOOD = 700.0


def _side(mass: float) -> float:
    """Edge length of a wooden cube [m]."""
    return float(np.cbrt(max(mass, 0.0) / _WOOD))


def _used_surfaces(action: Action) -> dict[str, Surface]:
    """Surfaces of enabled contacts."""
    names = {n for c in action.config.contacts.values() if c.enabled for n in c.surfaces}
    return {n: s for n, s in action.config.surfaces.items() if n in names}


@checked
def scene(action: Action, poses: Sequence[npt.ArrayLike] = ()) -> Scene:
    """Shapes of a mechanism.

    In the simulation, surfaces are infinite lines and complete circles. The drawing has the pieces
    near the tabulated point, and near the contact point at rest and in ``poses``.

    Parameters
    ----------
    poses
        Coordinates q [rad, m] of poses in which the drawn pieces must reach the contact points.
    """
    config = action.config
    rest = action.rest_pose
    for i, pose in enumerate(poses):
        if np.shape(pose) != np.shape(rest):
            raise InvalidParameter(
                f"scene: poses[{i}]: shape {np.shape(pose)}, expected {np.shape(rest)}: a number "
                "for each coordinate"
            )
    rest_poses = body_poses(action, rest)
    u = _unit(action, rest_poses)
    surfaces = _used_surfaces(action)
    touched = _touched(action, surfaces, np.array([rest, *poses], dtype=float))
    pieces = {
        name: _surface_piece(name, s, touched[name], body_center(action, s.body), u)
        for name, s in surfaces.items()
    }
    shapes: list[Shape] = []
    for name, piece in pieces.items():
        if surfaces[name].body == "ground" and not _is_string(action, name):
            shapes += piece.shapes
    for body in config.bodies:
        own = {n: p for n, p in pieces.items() if surfaces[n].body == body}
        shapes += _body_shapes(action, body, own, u)
        for piece in own.values():
            shapes += piece.shapes
    shapes += _leads(action)
    return Scene(tuple(shapes), body_groups(action), u)


def _touched(
    action: Action, surfaces: Mapping[str, Surface], poses: Array
) -> dict[str, list[Array]]:
    """Contact points of each surface in the poses, in the frame of its body [m]."""
    touched: dict[str, list[Array]] = {name: [] for name in surfaces}
    way = poses_along(action, poses)
    for key, contact in action.config.contacts.items():
        if contact.enabled and int(key) in way.contacts:
            points = way.contacts[int(key)][:, :2]
            for name in contact.surfaces:
                touched[name].extend(way.to_body(surfaces[name].body, points))
    return touched


def _leads(action: Action) -> Iterator[Shape]:
    """Discs of the leads."""
    config = action.config
    for name, lead in config.leads.items():
        body = lead.body or (config.finger.body if config.finger is not None else "")
        height = config.bodies[body].center_of_mass[1] if lead.height is None else lead.height
        center = np.array([lead.position, height])
        yield Shape(body, "lead", name, capsule(center, LEAD, center, LEAD), True)


def _is_string(action: Action, name: str) -> bool:
    """Whether a surface is the string, or another one on the same line (the damper's)."""
    string, surfaces = action.config.string, action.config.surfaces
    if string is None or string.surface not in surfaces:
        return False
    if name == string.surface:
        return True
    a, b = surfaces[name], surfaces[string.surface]
    if a.kind != "line" or b.kind != "line" or a.body != b.body or not a.normal or not b.normal:
        return False
    off = np.dot(np.subtract(a.point, b.point), b.normal)
    return abs(off) < 1e-3 and float(np.dot(a.normal, b.normal)) > 0.999


def body_center(action: Action, body: str) -> Array:
    """Center of mass of a body in its frame [m]; for a beam, its middle."""
    if body == "ground":
        return np.zeros(2)
    b = with_leads(action.config, body)
    return (
        np.array([0.5 * b.length, 0.0])
        if b.kind == "beam" and b.length
        else np.array(b.center_of_mass)
    )


def body_groups(action: Action) -> dict[str, int]:
    """Body -> index of its group of rigidly connected bodies; ground is -1."""
    group = {"ground": -1}
    for name, body in action.config.bodies.items():
        chain, parent = name, body
        while parent.joint == "weld" and parent.parent != "ground":
            chain = parent.parent
            parent = action.config.bodies[chain]
        if parent.joint == "weld":
            group[name] = -1
        else:
            group.setdefault(chain, len(set(group.values()) - {-1}))
            group[name] = group[chain]
    return group


#: Circles up to this radius, in units of the drawing, are drawn completely.
ROUND = 27.0


@dataclass(frozen=True)
class _Piece:
    """Drawn piece of a surface; position and thickness of the adjacent part of the body."""

    shapes: list[Shape]
    node: Array
    radius: float
    small: bool


def _surface_piece(name: str, s: Surface, touched: list[Array], center: Array, u: float) -> _Piece:
    """Piece of a surface near its tabulated point and where it was touched.

    ``center``: center of mass of the body.
    """
    depth = (4.5 if s.body == "ground" else 2.4) * u
    if s.kind == "line":
        return _line_piece(name, s, touched, depth, u)
    if s.kind == "segment":
        return _segment_piece(name, s, depth)
    if s.kind == "concave_arc":
        return _concave_arc_piece(name, s, depth)
    if s.kind == "hybrid":
        return _hybrid_piece(name, s, touched, u)
    if s.kind == "circle" and float(s.radius or 0.0) <= ROUND * u:
        return _disc_piece(name, s, u)
    return _arc_piece(name, s, touched, center, depth, u)


def _piece(
    name: str, s: Surface, block: Array, surface: Array, node: Array, radius: float
) -> _Piece:
    """Piece of a surface and the block of material behind it."""
    shapes = [
        Shape(s.body, "pad", name, block, True),
        Shape(s.body, "surface", name, surface, False),
    ]
    return _Piece(shapes, node, radius, False)


def _line_piece(name: str, s: Surface, touched: list[Array], depth: float, u: float) -> _Piece:
    """A part of an infinite line."""
    assert s.normal is not None
    p, normal = np.array(s.point), np.array(s.normal) / np.hypot(*s.normal)
    along = np.array([normal[1], -normal[0]])
    places = [0.0] + [float(along @ (t - p)) for t in touched]
    # Far from the tabulated point, the body certainly has material only at the contact.
    if len(touched) and min(abs(x) for x in places[1:]) > 60.0 * u:
        places = places[1:]
    pad = 6.5 * u
    near, far = _whole(min(places), max(places), u)
    a, b = p + along * (near - pad), p + along * (far + pad)
    block = np.array([a, b, b - normal * depth, a - normal * depth])
    node = 0.5 * (a + b) - 0.5 * depth * normal
    return _piece(name, s, block, np.array([a, b]), node, 0.5 * depth)


def _disc_piece(name: str, s: Surface, u: float) -> _Piece:
    """A small circle, drawn completely, or a point."""
    p, radius = np.array(s.point), float(s.radius or 0.0)
    if radius <= 0.05 * u:
        dot = arc_points(p, 0.4 * u, 0.0, 2.0 * math.pi)[:-1]
        return _Piece([Shape(s.body, "mark", name, dot, True)], p, 0.5 * u, True)
    ring = arc_points(p, radius, 0.0, 2.0 * math.pi)[:-1]
    made = _piece(name, s, ring, np.vstack([ring, ring[:1]]), p, radius)
    return replace(made, small=True)


def _arc_piece(
    name: str, s: Surface, touched: list[Array], center: Array, depth: float, u: float
) -> _Piece:
    """A part of a large circle, which may be concave."""
    p, radius = np.array(s.point), float(s.radius or 0.0)
    inward = math.atan2(center[1] - p[1], center[0] - p[0])
    angles = [math.atan2(t[1] - p[1], t[0] - p[0]) for t in touched]
    if s.kind == "concave" or not angles:
        angles.append(inward)
    angles = [wrap_angle(a, angles[0]) for a in angles]
    pad = 9.0 * u / radius
    low, high = _whole(min(angles), max(angles), u / radius)
    low, high = low - pad, high + pad
    if high - low >= 2.0 * math.pi:
        low, high = 0.0, 2.0 * math.pi
    arc = arc_points(p, radius, low, high)
    other = radius + depth if s.kind == "concave" else max(radius - depth, 0.0)
    band = np.vstack([arc, arc_points(p, other, high, low) if other > 0 else p[None, :]])
    middle = 0.5 * (low + high)
    node = p + 0.5 * (radius + other) * np.array([math.cos(middle), math.sin(middle)])
    return _piece(name, s, band, arc, node, 2.6 * u)


def _segment_piece(name: str, s: Surface, depth: float) -> _Piece:
    """A segment, or a bar with round ends, and the material behind it."""
    assert s.end is not None
    ends = np.array([s.point, s.end])
    way = (ends[1] - ends[0]) / np.hypot(*(ends[1] - ends[0]))
    normal = np.array([-way[1], way[0]])
    radius = float(s.radius or 0.0)
    if radius == 0.0:
        surface = ends
        block = np.vstack([ends, ends[::-1] - normal * depth])
    else:
        angle = math.atan2(normal[1], normal[0])
        first = arc_points(ends[0], radius, angle, angle + math.pi)
        last = arc_points(ends[1], radius, angle - math.pi, angle)
        block = np.vstack([first, last])
        surface = np.vstack([block, block[:1]])
    node = ends.mean(axis=0) - 0.5 * depth * normal
    return _piece(name, s, block, surface, node, 0.5 * depth)


def _concave_arc_piece(name: str, s: Surface, depth: float) -> _Piece:
    """An arc and the material around it."""
    assert s.arc is not None
    p, radius = np.array(s.point), float(s.radius or 0.0)
    low, high = s.arc
    arc = arc_points(p, radius, low, high)
    band = np.vstack([arc, arc_points(p, radius + depth, high, low)])
    middle = 0.5 * (low + high)
    node = p + (radius + 0.5 * depth) * np.array([math.cos(middle), math.sin(middle)])
    return _piece(name, s, band, arc, node, 0.5 * depth)


def _hybrid_piece(name: str, s: Surface, touched: list[Array], u: float) -> _Piece:
    """Arc with two tangent half-lines, one before its first angle and one after its second."""
    assert s.arc is not None
    p, radius = np.array(s.point), float(s.radius or 0.0)
    low, high = s.arc
    before = np.array([math.sin(low), -math.cos(low)])
    after = np.array([-math.sin(high), math.cos(high)])
    first = p + radius * np.array([math.cos(low), math.sin(low)])
    last = p + radius * np.array([math.cos(high), math.sin(high)])
    most_before = max([4.0 * u] + [float(before @ (t - first)) for t in touched])
    most_after = max([6.0 * u] + [float(after @ (t - last)) for t in touched])
    start = first + before * (_whole(0.0, most_before, u)[1] + 2.0 * u)
    end = last + after * (_whole(0.0, most_after, u)[1] + 2.0 * u)
    curve = np.vstack([start, arc_points(p, radius, low, high), end])
    depth = 5.0 * u
    block = np.vstack([curve, end + before * depth, start + after * depth])
    return _piece(name, s, block, curve, p + (before + after) * 0.5 * depth, 2.2 * u)


def _body_shapes(action: Action, name: str, pieces: Mapping[str, _Piece], u: float) -> list[Shape]:
    """Plausible outline: a rod, a block, a bar, or limbs between the known points."""
    config = action.config
    body = config.bodies[name]
    if body.kind == "beam":
        return [_rod(name, body, u)]
    straps, children = _strap_ends(config, name), _children(config, name)
    if body.mass <= 0 and not pieces and not straps:
        return []
    block = _block(action, name, children, pieces, u)
    if block is not None:
        return [Shape(name, "wood", name, block, True)]
    center = np.array(body.center_of_mass)
    massive = [np.zeros(2), *children, *(p.node for p in pieces.values() if not p.small)]
    if config.finger is not None and config.finger.body == name:
        massive.append(np.array(config.finger.point))
    bar = _bar(np.array([*massive, center]), pieces, u)
    if bar is not None:
        return [Shape(name, "wood", name, bar, True), *_on_bar(name, bar, pieces, straps, u)]
    heavy = _radius_of_mass(config, body) * u
    nodes = [(np.zeros(2), 4.2 * u), *((c, 3.8 * u) for c in children), (center, heavy)]
    nodes += [(p.node, p.radius) for p in pieces.values()]
    return _limbs(name, nodes, len(children) + 1, straps, u)


def _rod(name: str, body: Body, u: float) -> Shape:
    """Straight beam with round ends."""
    assert body.length is not None
    assert body.area is not None
    radius = math.sqrt(body.area / math.pi)
    rod = capsule(np.zeros(2), radius, np.array([body.length, 0.0]), radius)
    role = "wire" if radius < 2.0 * u else "wood"
    return Shape(name, role, name, dense_outline(rod, 4.0 * u), True)


def _strap_ends(config: MechanismFile, name: str) -> list[Array]:
    """Ends of the straps at a body."""
    ends = [
        (strap.enabled and end == name, place)
        for strap in config.straps.values()
        for end, place in ((strap.body_a, strap.point_a), (strap.body_b, strap.point_b))
    ]
    return [np.array(place) for own, place in ends if own]


def _children(config: MechanismFile, name: str) -> list[Array]:
    """Joints of the bodies on a body, but not their slides."""
    bodies = config.bodies.values()
    own = [b for b in bodies if b.parent == name and b.joint != "prismatic"]
    return [np.array(b.position) for b in own]


def _radius_of_mass(config: MechanismFile, body: Body) -> float:
    """Radius of the disc at a center of mass, in units of the drawing."""
    masses = sorted(b.mass for b in config.bodies.values() if b.mass > 0)
    median = masses[len(masses) // 2] if masses else 1.0
    return min(8.0, max(2.4, 5.5 * math.sqrt(body.mass / median)))


def _on_bar(
    name: str, bar: Array, pieces: Mapping[str, _Piece], straps: Sequence[Array], u: float
) -> Iterator[Shape]:
    """Legs from a bar to small surfaces, and wires to straps."""
    low, high = bar.min(axis=0), bar.max(axis=0)
    for piece in pieces.values():
        foot = np.clip(piece.node, low + 2.0 * u, high - 2.0 * u)
        if piece.small and np.hypot(*(piece.node - foot)) > 2.0 * u:
            radius = min(piece.radius, 3.0 * u)
            yield Shape(name, "wood", name, capsule(foot, radius, piece.node, radius), True)
    for point in straps:
        foot = np.clip(point, low, high)
        yield Shape(name, "wire", name, capsule(foot, 0.7 * u, point, 0.7 * u), True)


def _limbs(
    name: str, nodes: Sequence[tuple[Array, float]], first: int, straps: Sequence[Array], u: float
) -> list[Shape]:
    """Limbs of the shortest tree between points with radii; ``first``: the center of mass."""
    shapes: list[Shape] = []
    for a, b in shortest_tree([n for n, _ in nodes], first):
        (pa, ra), (pb, rb) = nodes[a], nodes[b]
        gap = float(np.hypot(*(pb - pa)))
        if gap > 1.5 * (ra + rb):
            # For large distances: a thin limb, with visible discs at its ends.
            ra, rb = min(ra, 3.6 * u), min(rb, 3.6 * u)
        limb = capsule(pa, max(ra, 1.2 * u), pb, max(rb, 1.2 * u))
        shapes.append(Shape(name, "wood", name, limb, True))
    for node, radius in nodes:
        if radius > 2.8 * u and len(nodes) > 1:
            shapes.append(Shape(name, "wood", name, capsule(node, radius, node, radius), True))
    for point in straps:
        near = min(nodes, key=lambda n: float(np.hypot(*(n[0] - point))))[0]
        if np.hypot(*(near - point)) > 1e-9:
            wire = capsule(near, 0.7 * u, point, 0.7 * u)
            shapes.insert(0, Shape(name, "wire", name, wire, True))
    return shapes


def _block(
    action: Action, name: str, children: Sequence[Array], pieces: Mapping[str, _Piece], u: float
) -> Array | None:
    """Block on the contact surface of a body of which only a mass and a point are known."""
    body = action.config.bodies[name]
    known = [*children, np.array(body.center_of_mass), *(p.node for p in pieces.values())]
    if body.mass <= 0 or any(float(np.hypot(*n)) > 2.0 * u for n in known):
        return None
    if any(p.radius > 1.0 * u for p in pieces.values()):
        return None
    half = 0.5 * min(max(_side(body.mass), 10.0 * u), 60.0 * u)
    away = np.zeros(2)
    surfaces = action.config.surfaces
    for contact in action.config.contacts.values():
        own = [n for n in contact.surfaces if surfaces[n].body == name]
        other = [surfaces[n].normal for n in contact.surfaces if surfaces[n].body != name]
        if contact.enabled and own and other and other[0] is not None:
            away = half * np.array(other[0]) / np.hypot(*other[0])
            break
    return round_box(away - half, away + half, 0.15 * half)


def _bar(cloud: Array, pieces: Mapping[str, _Piece], u: float) -> Array | None:
    """Straight bar through points whose arrangement is long and slender along an axis."""
    low, high = cloud.min(axis=0), cloud.max(axis=0)
    size = high - low
    if size.max() < 120.0 * u or size.min() > 0.2 * size.max():
        return None
    long = int(np.argmax(size))
    for piece in pieces.values():
        for shape in piece.shapes:
            if shape.role == "pad" and not piece.small:
                low = np.minimum(low, shape.points.min(axis=0))
                high = np.maximum(high, shape.points.max(axis=0))
    short = 1 - long
    if high[short] - low[short] < 4.0 * u:
        low[short] -= 2.0 * u
        high[short] += 2.0 * u
    low[long] -= 2.0 * u
    high[long] += 2.0 * u
    return round_box(low, high, min(1.5 * u, 0.4 * float(high[short] - low[short])))


def view_box(action: Action, drawn: Scene, qs: Sequence[npt.ArrayLike]) -> tuple[Array, Array]:
    """Corners [m] of the area that the bodies cover in the poses, with a margin."""
    low, high = np.full(2, math.inf), np.full(2, -math.inf)
    outlines: dict[str, list[Array]] = {}
    for shape in drawn.shapes:
        outlines.setdefault(shape.body, []).append(shape.points)
    bodies = {body: np.vstack(parts) for body, parts in outlines.items()}
    way = poses_along(action, np.array(qs, dtype=float))
    for body, outline in bodies.items():
        points = way.to_ground(body, outline)
        low, high = np.minimum(low, points.min((1, 2))), np.maximum(high, points.max((1, 2)))
    line = string_line(action)
    if line is not None:
        start = line[0]
        low, high = np.minimum(low, start), np.maximum(high, start)
    if not np.all(np.isfinite(low)):
        raise InvalidParameter(f"plot mechanism: {action.name!r} has nothing to draw")
    margin = 12.0 * drawn.unit
    return low - margin, high + margin


def shape_points(action: Action, shape: Shape, bent: Mapping[str, Array]) -> Array:
    """Points of a shape in the frame of its body [m], bent for a flexible beam."""
    if shape.body not in bent:
        return shape.points
    length = action.config.bodies[shape.body].length or 1.0
    x = station_of(action, shape)
    if x is None:
        return bend(shape.points, bent[shape.body], length)
    return station(shape.points, bent[shape.body], length, x)


def station_of(action: Action, shape: Shape) -> float | None:
    """Position x [m] along a beam of the cross section of a surface; None for other bodies.

    In the simulation, a surface is fixed to the cross section at its tabulated point.
    """
    if shape.role not in ("pad", "surface", "mark") or shape.name not in action.config.surfaces:
        return None
    return float(action.config.surfaces[shape.name].point[0])


def upper_right_is_free(points: Array, limits: tuple[Array, Array], share: Array) -> bool:
    """Whether the upper right corner, ``share`` of the view in x and y, has no points."""
    low, high = limits
    corner = high - share * (high - low)
    return not bool(np.any(np.all(points > corner, axis=1)))
