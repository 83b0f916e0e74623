"""Linear graph of a mechanism, thesis section 4.1.2 and Fig. 4.3.

Nodes are points: the datum of the ground, the center of mass of each body, and the points at which
joints, springs, contacts, straps, string and finger act. Edges are elements; each has one relation
between its through variable (force, torque) and its across variable (displacement). The topology,
i.e. which elements connect which points, is the incidence matrix. It does not depend on the
mechanics of the elements.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt

from feltmb.arguments import checked
from feltmb.errors import InvalidParameter
from feltmb.mechanism.to_core import with_leads

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from feltmb.mechanism import Action

    Array = npt.NDArray[np.float64]

__all__ = ["EDGE_KINDS", "Edge", "LinearGraph", "Node", "draw_graph", "graph"]

DATUM = "ground"

#: Kinds of edges in the order of their priority for the tree. The coordinates of the joints then
#: describe all motion, and elements whose forces depend on motion are in the cotree.
EDGE_KINDS = (
    "joint",
    "body_fixed_vector",
    "string",
    "body",
    "spring",
    "strap",
    "contact",
    "applied_force",
)


@dataclass(frozen=True)
class Node:
    """A point.

    Attributes
    ----------
    name : str
        Unique name: the body for a center of mass, ``body:point`` for other points.
    kind : str
        ``datum``, ``mass_center``, ``joint``, ``contact``, ``strap``, ``string`` or ``finger``.
    body : str
        Body to which the point is fixed; ``string`` for the point below the hammer.
    """

    name: str
    kind: str
    body: str


@dataclass(frozen=True)
class Edge:
    """An element between two nodes, directed from ``tail`` to ``head``.

    Attributes
    ----------
    name : str
        Unique.
    kind : str
        One of ``EDGE_KINDS``.
    label : str
        Text for people.
    detail : str
        Kind of a joint (``revolute``, ``prismatic``, ``weld``); ``beam`` or ``flexible beam`` for
        such a body; else empty.
    mass, inertia : float
        Mass and inertia of a body [kg, kg m^2]; else 0.
    """

    name: str
    kind: str
    tail: str
    head: str
    label: str = ""
    detail: str = ""
    mass: float = 0.0
    inertia: float = 0.0


@dataclass(frozen=True)
class LinearGraph:
    """Nodes and edges; ``nodes[0]`` is the datum."""

    name: str
    nodes: tuple[Node, ...]
    edges: tuple[Edge, ...]

    def of_kind(self, kind: str) -> tuple[Edge, ...]:
        """Edges of one kind.

        Raises
        ------
        InvalidParameter
            The kind does not exist.
        """
        if kind not in EDGE_KINDS:
            raise InvalidParameter(
                f"graph: kind {kind!r} is unknown; kinds are {', '.join(EDGE_KINDS)}"
            )
        return tuple(e for e in self.edges if e.kind == kind)

    @cached_property
    def incidence(self) -> Array:
        """Incidence matrix (nodes, edges): +1 if an edge leaves a node, -1 if it enters it."""
        row = {node.name: i for i, node in enumerate(self.nodes)}
        matrix = np.zeros((len(self.nodes), len(self.edges)))
        for j, edge in enumerate(self.edges):
            matrix[row[edge.tail], j] += 1.0
            matrix[row[edge.head], j] -= 1.0
        return matrix

    @cached_property
    def tree(self) -> tuple[int, ...]:
        """Indices of the edges of a spanning tree, joints and rigid arms first.

        Raises
        ------
        InvalidParameter
            The graph is not connected.
        """
        order = sorted(
            range(len(self.edges)), key=lambda j: (EDGE_KINDS.index(self.edges[j].kind), j)
        )
        leader = {node.name: node.name for node in self.nodes}

        def find(name: str) -> str:
            while leader[name] != name:
                leader[name] = leader[leader[name]]
                name = leader[name]
            return name

        chosen = []
        for j in order:
            a, b = find(self.edges[j].tail), find(self.edges[j].head)
            if a != b:
                leader[a] = b
                chosen.append(j)
        if len(chosen) != len(self.nodes) - 1:
            raise InvalidParameter(f"graph of {self.name!r} is not connected; it has no tree")
        return tuple(sorted(chosen))

    @cached_property
    def cotree(self) -> tuple[int, ...]:
        """Indices of the edges that are not in the tree (chords)."""
        inside = set(self.tree)
        return tuple(j for j in range(len(self.edges)) if j not in inside)

    @cached_property
    def cutsets(self) -> Array:
        """Fundamental cutset matrix (nodes - 1, edges): one force balance for each tree edge.

        The columns of the tree are the unit matrix.
        """
        reduced = self.incidence[1:]
        matrix = np.linalg.solve(reduced[:, list(self.tree)], reduced)
        return np.asarray(np.round(matrix))

    @cached_property
    def circuits(self) -> Array:
        """Fundamental circuit matrix (chords, edges): one closed loop for each chord.

        The columns of the chords are the unit matrix.
        """
        tree, cotree = list(self.tree), list(self.cotree)
        matrix = np.zeros((len(cotree), len(self.edges)))
        matrix[:, cotree] = np.eye(len(cotree))
        # Cutsets and circuits are orthogonal.
        matrix[:, tree] = -self.cutsets[:, cotree].T
        return matrix

    def to_dot(self) -> str:
        """Text for Graphviz; tree edges are thick."""
        inside = set(self.tree)
        lines = [
            f"digraph {_quoted(self.name)} {{",
            '  graph [layout=neato, overlap=false, splines=true, fontname="sans-serif"];',
            '  node [shape=circle, width=0.12, fixedsize=true, label="", style=filled];',
            '  edge [fontname="sans-serif", fontsize=9, arrowsize=0.5];',
        ]
        for node in self.nodes:
            color, big = _NODE_LOOK[node.kind]
            text = node.name if node.kind in ("datum", "mass_center") else ""
            lines.append(
                f"  {_quoted(node.name)} [fillcolor={_quoted(color)}, tooltip={_quoted(node.name)}"
                + (f", xlabel={_quoted(text)}, width=0.2" if big else "")
                + "];"
            )
        for j, edge in enumerate(self.edges):
            color, dash, _ = _EDGE_LOOK[edge.kind]
            style = {"-": "solid", "--": "dashed", ":": "dotted"}[dash]
            label = "" if edge.kind == "body_fixed_vector" else edge.label
            lines.append(
                f"  {_quoted(edge.tail)} -> {_quoted(edge.head)} [color={_quoted(color)}, "
                f"style={style}, penwidth={2.2 if j in inside else 1.0}, label={_quoted(label)}];"
            )
        return "\n".join([*lines, "}"]) + "\n"


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", " ") + '"'


class _Builder:
    def __init__(self) -> None:
        self.nodes: dict[str, Node] = {DATUM: Node(DATUM, "datum", DATUM)}
        self.edges: list[Edge] = []

    def point(self, body: str, point: str, kind: str) -> str:
        """Node of a point of a body; a rigid arm connects it to the center of mass (or datum)."""
        name = f"{body}:{point}"
        if name not in self.nodes:
            self.nodes[name] = Node(name, kind, body)
            self.edges.append(
                Edge(f"arm {name}", "body_fixed_vector", body, name, f"{body} to {point}")
            )
        return name


def _point_of_string(surface: str, struck: str) -> str:
    return "string:strike point" if surface == struck else f"string:{surface}"


@checked
def graph(action: Action) -> LinearGraph:
    """Linear graph of a mechanism: its topology, without parts that are switched off.

    Every body is an edge from the datum to its center of mass. Every joint, contact, spring and
    strap is an edge between points. Every point of a body has an arm to its center of mass, and
    points of the ground have arms from the datum. A modal string connects the ground to the point
    of the string below the hammer, and to the points of its other surfaces.
    """
    config = action.config
    b = _Builder()
    for name in config.bodies:
        body = with_leads(config, name)
        b.nodes[name] = Node(name, "mass_center", name)
        mass, inertia = body.mass, body.inertia
        if body.kind == "beam" and body.length and body.density and body.area:
            mass = body.density * body.area * body.length
            inertia = mass * body.length**2 / 12.0
        b.edges.append(
            Edge(
                f"body {name}",
                "body",
                DATUM,
                name,
                body.label or name.replace("_", " "),
                ("beam" if body.rigid else "flexible beam") if body.kind == "beam" else "",
                mass,
                inertia,
            )
        )
    joints: dict[str, tuple[str, str]] = {}
    for name, body in config.bodies.items():
        tail = b.point(body.parent, f"joint {name}", "joint")
        head = b.point(name, "joint", "joint")
        what = body.coordinate or body.joint
        b.edges.append(Edge(f"joint {name}", "joint", tail, head, what, body.joint))
        if body.coordinate:
            joints[body.coordinate] = (tail, head)
    for name, spring in config.springs.items():
        if spring.enabled and spring.coordinate in joints:
            tail, head = joints[spring.coordinate]
            text = spring.label or name.replace("_", " ")
            b.edges.append(Edge(f"spring {name}", "spring", tail, head, text, "torsion"))
    for name, strap in config.straps.items():
        if strap.enabled:
            tail = b.point(strap.body_a, f"strap {name}", "strap")
            head = b.point(strap.body_b, f"strap {name}", "strap")
            b.edges.append(Edge(f"strap {name}", "strap", tail, head, name.replace("_", " ")))
    string = config.string if config.string is not None and config.string.kind == "modal" else None
    lines = [] if string is None else [string.surface, *string.other_surfaces]
    if string is not None:
        anchor = b.point(config.surfaces[string.surface].body, string.surface, "string")
        for line in lines:
            under = _point_of_string(line, string.surface)
            b.nodes[under] = Node(under, "string", "string")
            name = "string" if line == string.surface else f"string {line}"
            b.edges.append(Edge(name, "string", anchor, under, "string"))
    for key, contact in config.contacts.items():
        if not contact.enabled:
            continue
        ends = []
        for surface in contact.surfaces:
            if string is not None and surface in lines:
                ends.append(_point_of_string(surface, lines[0]))
            else:
                ends.append(b.point(config.surfaces[surface].body, surface, "contact"))
        text = contact.label or f"contact {int(key)}"
        b.edges.append(Edge(f"contact {int(key)}", "contact", ends[0], ends[1], text))
    if config.finger is not None:
        head = b.point(config.finger.body, "finger", "finger")
        b.edges.append(Edge("finger", "applied_force", DATUM, head, "finger force"))
    return LinearGraph(action.name, tuple(b.nodes.values()), tuple(b.edges))


# --- drawing -------------------------------------------------------------------------------------

#: Node kind -> color, and whether it is a center with a name.
_NODE_LOOK = {
    "datum": ("#222222", True),
    "mass_center": ("#222222", True),
    "joint": ("#FFFFFF", False),
    "contact": ("#D55E00", False),
    "strap": ("#CC79A7", False),
    "string": ("#56B4E9", False),
    "finger": ("#0072B2", False),
}

#: Edge kind -> color, dash, name for people.
_EDGE_LOOK: dict[str, tuple[str, Literal["-", "--", ":"], str]] = {
    "joint": ("#222222", "-", "joint"),
    "body_fixed_vector": ("#999999", "-", "rigid arm"),
    "string": ("#56B4E9", "-", "string"),
    "body": ("#C8C8C8", "--", "body (inertia, weight)"),
    "spring": ("#009E73", "-", "torsion spring"),
    "strap": ("#CC79A7", "-", "strap"),
    "contact": ("#D55E00", "-", "contact"),
    "applied_force": ("#0072B2", "-", "applied force"),
}


def _links(g: LinearGraph) -> dict[tuple[str, str], int]:
    """Number of elements that connect two bodies."""
    body = {node.name: node.body for node in g.nodes}
    count: dict[tuple[str, str], int] = {}
    for edge in g.edges:
        a, b = sorted((body[edge.tail], body[edge.head]))
        if a != b and edge.kind != "body":
            count[a, b] = count.get((a, b), 0) + 1
    return count


def _crossings(order: list[str], links: dict[tuple[str, str], int]) -> float:
    """Cost of an order of bodies on a circle: crossing and long connections."""
    place = {name: i for i, name in enumerate(order)}
    n = len(order)
    pairs = [
        (*sorted((place[a], place[b])), w)
        for (a, b), w in links.items()
        if a in place and b in place
    ]
    cost = 0.0
    for i, (a, b, w) in enumerate(pairs):
        cost += 0.3 * w * min(b - a, n - b + a)
        for c, d, v in pairs[i + 1 :]:
            if a < c < b < d or c < a < d < b:
                cost += w * v
    return cost


def _circle_order(g: LinearGraph) -> list[str]:
    """Order of the bodies around the datum with few crossings; by pairwise exchange."""
    links = _links(g)
    order = list(dict.fromkeys(n.body for n in g.nodes if n.body != DATUM))
    best = _crossings(order, links)
    better = True
    while better:
        better = False
        for i in range(len(order)):
            for j in range(len(order)):
                if i == j:
                    continue
                trial = order.copy()
                trial.insert(j, trial.pop(i))
                cost = _crossings(trial, links)
                if cost < best - 1e-9:
                    order, best, better = trial, cost, True
    return order


def _layout(g: LinearGraph) -> dict[str, tuple[float, float]]:
    """Bodies on a circle around the datum; their points are on the sides of their connections."""
    order = _circle_order(g)
    body = {node.name: node.body for node in g.nodes}
    n = max(len(order), 1)
    big = max(5.2, 0.62 * n)
    center: dict[str, tuple[float, float]] = {DATUM: (0.0, 0.0)}
    for i, name in enumerate(order):
        angle = 0.5 * math.pi - 2.0 * math.pi * i / n
        center[name] = (1.25 * big * math.cos(angle), big * math.sin(angle))
    place: dict[str, tuple[float, float]] = {}
    partner: dict[str, list[str]] = {node.name: [] for node in g.nodes}
    rank = {name: i for i, name in enumerate([DATUM, *order])}
    turn: dict[str, float] = {}
    for j, edge in enumerate(g.edges):
        if edge.kind not in ("body", "body_fixed_vector"):
            partner[edge.tail].append(edge.head)
            partner[edge.head].append(edge.tail)
            # Elements between the same two bodies have opposite orders at the two bodies.
            sign = 1.0 if rank[body[edge.tail]] < rank[body[edge.head]] else -1.0
            turn.setdefault(edge.tail, 1e-4 * sign * j)
            turn.setdefault(edge.head, -1e-4 * sign * j)
    for name, (cx, cy) in center.items():
        own = [x for x in g.nodes if x.body == name and x.name != name]
        if name == "string":
            for node in own:
                place[node.name] = (cx, cy)
            continue
        place[name] = (cx, cy)
        wanted = []
        for node in own:
            others = [center[body[p]] for p in partner[node.name] if p != DATUM]
            x = sum(o[0] - cx for o in others)
            y = sum(o[1] - cy for o in others)
            if not others or (x == 0 and y == 0):
                x, y = cx or 1.0, cy
            wanted.append((math.atan2(y, x) + turn.get(node.name, 0.0), node.name))
        radius = 2.4 if name == DATUM else 1.15
        for angle, point in _spread_angles(wanted):
            place[point] = (cx + radius * math.cos(angle), cy + radius * math.sin(angle))
    return place


def _spread_angles(wanted: list[tuple[float, str]]) -> list[tuple[float, str]]:
    """Angles close to the wanted ones, with a minimum distance on the circle."""
    if len(wanted) < 2:
        return wanted
    order = sorted(wanted)
    gap = min(0.62, 0.94 * 2.0 * math.pi / len(order))
    angles = [a for a, _ in order]
    for _ in range(400):
        moved = False
        for i in range(len(angles)):
            j = (i + 1) % len(angles)
            lap = 2.0 * math.pi if j == 0 else 0.0
            lack = gap - (angles[j] + lap - angles[i])
            if lack > 1e-6:
                angles[i] -= 0.5 * lack
                angles[j] += 0.5 * lack
                moved = True
        if not moved:
            break
    return [(a, name) for a, (_, name) in zip(angles, order, strict=True)]


@checked
def draw_graph(action: Action) -> Figure:
    """Plot the linear graph: datum in the center, bodies around it; tree edges are thick.

    Contacts are labeled with their numbers, bodies with their names.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import FancyArrowPatch

    from feltmb.style import NORMAL, SMALL, head_line, new_figure, plain_text

    g = graph(action)
    place = _layout(g)
    inside = set(g.tree)
    figure = new_figure(12.0, 9.2)
    head_line(figure, plain_text(f"Linear graph of {g.name}"))
    ax = figure.subplots()
    ax.set_axis_off()
    ax.set_aspect("equal")
    body = {node.name: node.body for node in g.nodes}
    numbered: dict[tuple[str, ...], int] = {}
    parallel: dict[tuple[str, ...], int] = {}
    for j, edge in enumerate(g.edges):
        a, b = place[edge.tail], place[edge.head]
        color, dash, _ = _EDGE_LOOK[edge.kind]
        key = tuple(sorted((edge.tail, edge.head)))
        turn = parallel.get(key, 0)
        parallel[key] = turn + 1
        # Edges of bodies are beside the straight arms and joints, springs are beside their joints.
        bend = {"body": 0.12, "spring": 0.35, "applied_force": -0.12}.get(edge.kind, 0.0)
        thick = j in inside
        ax.add_patch(
            FancyArrowPatch(
                a,
                b,
                connectionstyle=f"arc3,rad={bend + 0.2 * max(0, turn - 1)}",
                arrowstyle="-|>,head_length=2.6,head_width=1.3",
                shrinkA=4,
                shrinkB=4,
                color=color,
                linestyle=dash,
                linewidth=2.0 if thick else 1.0,
                zorder=1.0 if edge.kind == "body" else 2.0 + thick,
            )
        )
        if edge.kind == "contact":
            pair = tuple(sorted((body[edge.tail], body[edge.head])))
            share = (0.5, 0.42, 0.58)[numbered.setdefault(pair, 0) % 3]
            numbered[pair] += 1
            ax.text(
                *_along(a, b, share),
                edge.name.removeprefix("contact "),
                fontsize=SMALL,
                color=color,
                ha="center",
                va="center",
                zorder=6,
                bbox={
                    "boxstyle": "circle,pad=0.15",
                    "facecolor": "white",
                    "edgecolor": color,
                    "linewidth": 0.7,
                },
            )
    for node in g.nodes:
        color, big = _NODE_LOOK[node.kind]
        ax.plot(
            *place[node.name],
            "s" if node.kind == "datum" else "o",
            markersize=11 if node.kind == "datum" else 8 if big else 4.5,
            color=color,
            markeredgecolor="#222222",
            markeredgewidth=0.7,
            zorder=5,
        )
        if big:
            label = "ground" if node.kind == "datum" else action.config.bodies[node.body].label
            x, y = place[node.name]
            # Outside the circle of bodies, where no other body is.
            away = math.hypot(x, y) or 1.0
            blocked = any(
                (px - x) * x + (py - y) * y > 0.7 * away
                for px, py in (place[n.name] for n in g.nodes if n.body == node.body)
            )
            out = 0.0 if node.kind == "datum" else 1.7 if blocked else 0.75
            ax.text(
                x + out * x / away,
                y + out * y / away - (0.0 if out else 0.75),
                plain_text(label or node.body.replace("_", " ")),
                fontsize=NORMAL,
                ha="center" if abs(x) < 0.4 * away else "left" if x > 0 else "right",
                va="center",
                zorder=4.5,
                bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
            )
        elif node.kind == "string" and node.body == "string":
            x, y = place[node.name]
            ax.text(1.06 * x, 1.06 * y, "string", fontsize=NORMAL, ha="center", va="center")
    kinds = [k for k in EDGE_KINDS if g.of_kind(k)]
    handles = []
    for kind in kinds:
        color, dash, text = _EDGE_LOOK[kind]
        handles.append(Line2D([], [], color=color, linestyle=dash, label=text))
    handles.append(Line2D([], [], color="#555555", linewidth=2.2, label="in the tree"))
    handles.append(Line2D([], [], color="#555555", linewidth=1.0, label="in the cotree"))
    ax.margins(0.13, 0.08)
    ax.autoscale_view()
    ax.legend(
        handles=handles,
        loc="upper left",
        bbox_to_anchor=(1.0, 1.0),
        frameon=False,
        fontsize=NORMAL - 0.5,
        title=f"{len(g.nodes)} nodes, {len(g.edges)} edges,\n{len(g.tree)} in the tree",
        title_fontsize=NORMAL - 0.5,
        alignment="left",
    )
    return figure


def _along(a: tuple[float, float], b: tuple[float, float], share: float) -> tuple[float, float]:
    return a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])
