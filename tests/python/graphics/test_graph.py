"""The linear graph: its matrices obey the rules of graphs, its elements are those of the file."""

import re

import numpy as np
import pytest

from feltmb import Action, InvalidParameter, graph


@pytest.fixture(scope="module")
def linear(action):
    return graph.graph(action)


def _of_kind(made, kind):
    return [e for e in made.edges if e.kind == kind]


def test_incidence_has_one_start_and_one_end_for_an_edge(linear):
    matrix = linear.incidence
    assert matrix.shape == (len(linear.nodes), len(linear.edges))
    np.testing.assert_array_equal(matrix.sum(axis=0), 0.0)
    np.testing.assert_array_equal(np.abs(matrix).sum(axis=0), 2.0)
    assert np.linalg.matrix_rank(matrix) == len(linear.nodes) - 1
    names = [node.name for node in linear.nodes]
    assert len(set(names)) == len(names)
    for j, edge in enumerate(linear.edges):
        assert names[int(np.argmax(matrix[:, j]))] == edge.tail
        assert names[int(np.argmin(matrix[:, j]))] == edge.head


def test_tree_spans_and_holds_the_joints(linear):
    assert len(linear.tree) == len(linear.nodes) - 1
    # Independent of how it was chosen: without the datum its incidence matrix is invertible.
    sub = linear.incidence[1:, list(linear.tree)]
    assert abs(round(np.linalg.det(sub))) == 1
    kinds = {linear.edges[j].kind for j in linear.tree}
    assert kinds == {"joint", "body_fixed_vector", "string"}
    assert all(
        j in linear.tree
        for j, e in enumerate(linear.edges)
        if e.kind in ("joint", "body_fixed_vector")
    )


def test_joints_in_the_tree_are_the_coordinates(linear, action):
    moving = [
        linear.edges[j]
        for j in linear.tree
        if linear.edges[j].kind == "joint" and linear.edges[j].detail != "weld"
    ]
    bodies = action.config.bodies.values()
    assert [edge.label for edge in moving] == [b.coordinate for b in bodies if b.coordinate]
    assert [edge.label for edge in moving] == list(action.coordinates[:6])
    assert [edge.detail for edge in moving] == ["prismatic"] + 5 * ["revolute"]


def test_elements_are_those_of_the_file(linear, action):
    config = action.config
    bodies = _of_kind(linear, "body")
    assert {e.head for e in bodies} == set(config.bodies)
    assert {e.tail for e in bodies} == {"ground"}
    assert {e.name for e in _of_kind(linear, "contact")} == {f"contact {n}" for n in range(1, 16)}
    assert len(_of_kind(linear, "joint")) == len(config.bodies)
    assert len(_of_kind(linear, "spring")) == 3
    assert len(_of_kind(linear, "strap")) == 1
    (finger,) = _of_kind(linear, "applied_force")
    assert (finger.tail, finger.head) == ("ground", "key:finger")
    # One rigid arm for each point that is no center of mass and no point of the string.
    points = [n for n in linear.nodes if ":" in n.name and n.body != "string"]
    arms = _of_kind(linear, "body_fixed_vector")
    assert sorted(e.head for e in arms) == sorted(n.name for n in points)
    for node, arm in zip(sorted(points, key=lambda n: n.name),
                         sorted(arms, key=lambda e: e.head), strict=True):  # fmt: skip
        assert arm.tail == node.body
    spring = next(e for e in linear.edges if e.name == "spring jack_spring")
    joint = next(e for e in linear.edges if e.name == "joint jack")
    assert (spring.tail, spring.head) == (joint.tail, joint.head)


def test_what_is_switched_off_is_no_element(action):
    on = graph.graph(
        action.with_values({"contacts.16.enabled": True, "contacts.06.enabled": False})
    )
    names = {e.name for e in _of_kind(on, "contact")}
    assert "contact 16" in names
    assert "contact 6" not in names
    off = graph.graph(action.with_values({"straps.bridle_strap.enabled": False}))
    assert _of_kind(off, "strap") == []
    assert not [n for n in off.nodes if n.kind == "strap"]


def test_a_rigid_stop_is_a_point_of_the_ground(action):
    stop = graph.graph(action.with_values({"string.kind": "rigid_stop"}))
    assert _of_kind(stop, "string") == []
    contact = next(e for e in stop.edges if e.name == "contact 6")
    assert {contact.tail, contact.head} == {"head:Hp2", "ground:Gp6"}
    assert len(stop.tree) == len(stop.nodes) - 1


def test_a_graph_in_two_parts_has_no_tree(linear):
    lonely = graph.LinearGraph(
        "x", (*linear.nodes, graph.Node("far", "joint", "far")), linear.edges
    )
    with pytest.raises(InvalidParameter, match="not connected"):
        _ = lonely.tree


def test_dot_names_every_node_and_edge_and_quotes(action, linear):
    text = linear.to_dot()
    found = re.findall(r'^  "([^"]+)" -> "([^"]+)" \[', text, flags=re.MULTILINE)
    assert found == [(e.tail, e.head) for e in linear.edges]
    nodes = re.findall(r'^  "([^"]+)" \[fillcolor', text, flags=re.MULTILINE)
    assert nodes == [n.name for n in linear.nodes]
    assert text.count("penwidth=2.2") == len(linear.tree)
    raw = action.raw
    raw["contacts"]["01"]["label"] = 'say "a" \\ b\nc'
    quoted = graph.graph(Action(raw)).to_dot()
    assert r'label="say \"a\" \\ b c"' in quoted


def test_a_mechanism_of_one_body():
    raw = {
        "schema": 1,
        "name": "pendulum",
        "bodies": {
            "arm": {
                "coordinate": "arm.angle",
                "mass": 1.0,
                "center_of_mass": [0.0, -1.0],
                "inertia": 0.1,
            }
        },
    }
    tiny = graph.graph(Action(raw))
    assert [n.name for n in tiny.nodes] == ["ground", "arm", "ground:joint arm", "arm:joint"]
    (chord,) = set(range(len(tiny.edges))) - set(tiny.tree)
    assert tiny.edges[chord].kind == "body"
