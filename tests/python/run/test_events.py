"""Names of events: rules against lists of contact changes, and the order in a real stroke."""

import itertools

from feltmb.mechanism import NamedEvent
from feltmb.run.events import Change, name_events


def closes(time, contact):
    return Change(time, contact, None, True)


def opens(time, contact):
    return Change(time, contact, None, False)


def rule(**values):
    return NamedEvent(**values)


CHANGES = [
    closes(0.1, 9),
    opens(0.2, 4),
    Change(0.25, None, "key_start", True),
    closes(0.3, 4),
    opens(0.4, 4),
    closes(0.5, 6),
    opens(0.502, 6),
    closes(0.503, 6),
    opens(0.504, 6),
    opens(0.6, 4),
    closes(0.7, 13),
    closes(0.8, 6),
    opens(0.9, 6),
]
RULES = {
    "damper": rule(contact=9, change="closes"),
    "on": rule(contact=6, change="closes"),
    "off": rule(contact=6, change="opens", which="last", after="on", within=6e-3),
    "let_off": rule(contact=4, change="opens", which="last", before="on"),
    "check": rule(contact=[8, 13, 14], change="closes", after="off"),
    "key_start": rule(point="key_front", travel=1e-4),
}


def test_rules():
    assert name_events(CHANGES, RULES) == {
        "damper": 0, "on": 5, "off": 8, "let_off": 4, "check": 10, "key_start": 2,
    }  # fmt: skip


def test_order_of_the_rules_does_not_matter():
    backward = dict(reversed(RULES.items()))
    assert name_events(CHANGES, backward) == name_events(CHANGES, RULES)


def test_what_depends_on_an_absent_event_is_absent():
    without = [c for c in CHANGES if c.contact != 6]
    assert set(name_events(without, RULES)) == {"damper", "key_start"}
    assert name_events([], RULES) == {}


def test_rules_that_refer_to_each_other_do_not_hang():
    rules = {
        "a": rule(contact=4, change="opens", after="b"),
        "b": rule(contact=4, change="closes", after="a"),
        "c": rule(contact=9, change="closes"),
    }
    assert name_events(CHANGES, rules) == {"c": 0}


def test_events_of_a_stroke(run_of):
    run = run_of("piano", rtol=1e-8)
    table = run.events
    assert list(table["time"]) == sorted(table["time"])
    order = ["key_start", "damper_start", "jack_toe", "let_off", "string_contact_on",
             "key_landing", "string_contact_off", "check"]  # fmt: skip
    named = [e for e in table["event"] if e in order]
    assert named == order
    for name in order:
        assert run.event_time(name) == run.summary[f"{name}_time"]
    assert run.event_time("nothing") is None


def test_gaps_and_speeds_at_events(run_of):
    run = run_of("piano", rtol=1e-8)
    table = run.events.set_index("event")
    on = table.loc["string_contact_on"]
    assert abs(on["gap06"]) < 1e-9
    assert on["approach06"] == run.summary["impact_speed"]
    assert on["change"] == "closes"
    assert table.loc["let_off", "gap06"] == run.summary["let_off_gap"]
    assert table.loc["key_start", "change"] == "passes"
    i = run.time.searchsorted(on["time"])
    assert abs(on["hammer.angle.rate"] - run["hammer.angle.rate"][i - 1]) < 0.05


def test_every_contact_opens_and_closes_in_turn(run_of):
    table = run_of("staccato", rtol=1e-8).events
    for _, part in table[table["change"] != "passes"].groupby("contact"):
        changes = list(part["change"])
        assert all(a != b for a, b in itertools.pairwise(changes))


def test_contact_is_closed_between_its_events(run_of):
    run = run_of("piano", rtol=1e-8)
    force = run["contact06.force"]
    on, off = run.event_time("string_contact_on"), run.event_time("string_contact_off")
    inside = (run.time > on + 1e-4) & (run.time < off - 1e-4)
    assert (force[inside] > 0).all()
    assert (force[(run.time < on) | (run.time > off)] == 0).all()
