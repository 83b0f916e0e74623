"""Let-off and thrown-off hammers: the names of events by the order of contact changes."""

import io

import pytest
from rich.console import Console

from feltmb import load_action
from feltmb.cli.stroke import strike_tables, summary_table
from feltmb.run.events import Change, name_events
from feltmb.run.results import let_off_words
from unmodeled.errors import InvalidParameter

RULES = load_action("steinway45").config.events


TOE, BUTT, STRING = 5, 4, 6


def _named(*changes):
    listed = [Change(t, contact, None, closes) for t, contact, closes in changes]
    return {name: listed[i].time for name, i in name_events(listed, RULES).items()}


def test_let_off_needs_the_toe_at_the_button_before():
    found = _named((0.1, TOE, True), (0.2, BUTT, False), (0.3, STRING, True))
    assert found["let_off"] == 0.2
    assert "free_flight" not in found


def test_a_hammer_that_leaves_before_the_toe_is_thrown_off():
    found = _named((0.1, BUTT, False), (0.2, TOE, True), (0.3, STRING, True))
    assert found["free_flight"] == 0.1
    assert "let_off" not in found
    # The toe may never meet the button.
    assert _named((0.1, BUTT, False), (0.3, STRING, True))["free_flight"] == 0.1


def test_a_hammer_that_the_jack_catches_again_is_let_off_after_the_toe():
    found = _named(
        (0.1, BUTT, False), (0.2, TOE, True), (0.25, BUTT, True), (0.28, BUTT, False),
        (0.3, STRING, True),
    )  # fmt: skip
    assert found["let_off"] == 0.28
    assert "free_flight" not in found


def test_neither_where_the_jack_pushes_until_the_string():
    found = _named((0.1, TOE, True), (0.3, STRING, True), (0.4, BUTT, False))
    assert not {"let_off", "free_flight"} & set(found)


@pytest.mark.parametrize(
    ("stroke", "words"),
    [
        ("piano", ""),
        ("forte", "no let-off before hammer strikes"),
        ("staccato", "no let-off: thrown off"),
        ("repeated", "no let-off: thrown off"),
    ],
)
def test_runs_without_a_let_off_say_so(run_of, stroke, words):
    run = run_of(stroke, flexible=True)
    assert let_off_words(run.summary) == words
    several = strike_tables(run, stroke)
    shown = "\n".join(_text(table) for table in (*several, summary_table(run, stroke)))
    assert ("hammer - string distance at let-off" in shown) == (not words)
    if words.endswith("thrown off"):
        assert run.summary["free_flight_time"] < run.summary["jack_toe_time"]
    if words and several:
        line = next(line for line in shown.splitlines() if line.strip().startswith("let-off"))
        assert line.split()[1] == "thrown"
    elif words:
        assert words in shown


def test_an_event_that_waits_for_itself_through_unless_is_refused():
    action = load_action("steinway45")
    with pytest.raises(InvalidParameter, match=r"events\.let_off: waits for itself"):
        action.with_values({"events.let_off.unless": "free_flight"})


def _text(table, width=80):
    stream = io.StringIO()
    Console(file=stream, width=width, highlight=False, markup=False, emoji=False).print(table)
    return stream.getvalue()
