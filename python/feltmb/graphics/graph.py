"""Linear graph of a mechanism, thesis section 4.1.2 and Fig. 4.3.

Nodes are points: the datum of the ground, the center of mass of each body, and the points at which
joints, springs, contacts, straps, string and finger act. Edges are elements; each has one relation
between its through variable (force, torque) and its across variable (displacement). The topology,
i.e. which elements connect which points, is the incidence matrix. It does not depend on the
mechanics of the elements.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter

if TYPE_CHECKING:
    from feltmb.mechanism import Action

    Array = npt.NDArray[np.float64]

__all__ = ["EDGE_KINDS", "Edge", "LinearGraph", "Node", "graph"]

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
    """

    name: str
    kind: str
    tail: str
    head: str
    label: str = ""
    detail: str = ""


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

#: Edge kind -> color and line.
_EDGE_LOOK = {
    "joint": ("#222222", "solid"),
    "body_fixed_vector": ("#999999", "solid"),
    "string": ("#56B4E9", "solid"),
    "body": ("#C8C8C8", "dashed"),
    "spring": ("#009E73", "solid"),
    "strap": ("#CC79A7", "solid"),
    "contact": ("#D55E00", "solid"),
    "applied_force": ("#0072B2", "solid"),
}


@dataclass(frozen=True)
class LinearGraph:
    """Nodes and edges; ``nodes[0]`` is the datum."""

    name: str
    nodes: tuple[Node, ...]
    edges: tuple[Edge, ...]

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
            color, style = _EDGE_LOOK[edge.kind]
            label = "" if edge.kind == "body_fixed_vector" else edge.label
            lines.append(
                f"  {_quoted(edge.tail)} -> {_quoted(edge.head)} [color={_quoted(color)}, "
                f"style={style}, penwidth={2.2 if j in inside else 1.0}, label={_quoted(label)}];"
            )
        return "\n".join([*lines, "}"]) + "\n"


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", " ") + '"'


class _Builder:
    """Nodes and edges of a mechanism, part by part."""

    def __init__(self, action: Action):
        self.config = action.config
        self.nodes: dict[str, Node] = {DATUM: Node(DATUM, "datum", DATUM)}
        self.edges: list[Edge] = []
        self.joint_ends: dict[str, tuple[str, str]] = {}  # by coordinate
        string = self.config.string
        modal = string is not None and string.kind == "modal"
        self.lines = [string.surface, *string.other_surfaces] if string and modal else []

    def point(self, body: str, point: str, kind: str) -> str:
        """Node of a point of a body; a rigid arm connects it to the center of mass (or datum)."""
        name = f"{body}:{point}"
        if name not in self.nodes:
            self.nodes[name] = Node(name, kind, body)
            self.edges.append(
                Edge(f"arm {name}", "body_fixed_vector", body, name, f"{body} to {point}")
            )
        return name

    def bodies(self) -> None:
        for name, body in self.config.bodies.items():
            self.nodes[name] = Node(name, "mass_center", name)
            beam = "beam" if body.rigid else "flexible beam"
            text = body.label or name.replace("_", " ")
            detail = beam if body.kind == "beam" else ""
            self.edges.append(Edge(f"body {name}", "body", DATUM, name, text, detail))

    def joints(self) -> None:
        for name, body in self.config.bodies.items():
            tail = self.point(body.parent, f"joint {name}", "joint")
            head = self.point(name, "joint", "joint")
            what = body.coordinate or body.joint
            self.edges.append(Edge(f"joint {name}", "joint", tail, head, what, body.joint))
            if body.coordinate:
                self.joint_ends[body.coordinate] = (tail, head)

    def springs_and_straps(self) -> None:
        for name, spring in self.config.springs.items():
            if spring.enabled and spring.coordinate in self.joint_ends:
                tail, head = self.joint_ends[spring.coordinate]
                text = spring.label or name.replace("_", " ")
                self.edges.append(Edge(f"spring {name}", "spring", tail, head, text, "torsion"))
        for name, strap in self.config.straps.items():
            if strap.enabled:
                tail = self.point(strap.body_a, f"strap {name}", "strap")
                head = self.point(strap.body_b, f"strap {name}", "strap")
                text = name.replace("_", " ")
                self.edges.append(Edge(f"strap {name}", "strap", tail, head, text))

    def string(self) -> None:
        for line in self.lines:
            struck = self.lines[0]
            anchor = self.point(self.config.surfaces[struck].body, struck, "string")
            under = self._of_string(line)
            self.nodes[under] = Node(under, "string", "string")
            name = "string" if line == struck else f"string {line}"
            self.edges.append(Edge(name, "string", anchor, under, "string"))

    def contacts(self) -> None:
        for key, contact in self.config.contacts.items():
            if contact.enabled:
                tail, head = (self._touched(surface) for surface in contact.surfaces)
                text = contact.label or f"contact {int(key)}"
                self.edges.append(Edge(f"contact {int(key)}", "contact", tail, head, text))

    def finger(self) -> None:
        if self.config.finger is not None:
            head = self.point(self.config.finger.body, "finger", "finger")
            self.edges.append(Edge("finger", "applied_force", DATUM, head, "finger force"))

    def _of_string(self, surface: str) -> str:
        return "string:strike point" if surface == self.lines[0] else f"string:{surface}"

    def _touched(self, surface: str) -> str:
        if surface in self.lines:
            return self._of_string(surface)
        return self.point(self.config.surfaces[surface].body, surface, "contact")


@checked
def graph(action: Action) -> LinearGraph:
    """Linear graph of a mechanism: its topology, without parts that are switched off.

    Every body is an edge from the datum to its center of mass. Every joint, contact, spring and
    strap is an edge between points. Every point of a body has an arm to its center of mass, and
    points of the ground have arms from the datum. A modal string connects the ground to the point
    of the string below the hammer, and to the points of its other surfaces.
    """
    b = _Builder(action)
    b.bodies()
    b.joints()
    b.springs_and_straps()
    b.string()
    b.contacts()
    b.finger()
    return LinearGraph(action.name, tuple(b.nodes.values()), tuple(b.edges))
