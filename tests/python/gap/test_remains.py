"""What remains, drawn on the mechanism; numbers that cannot be told apart."""

from types import SimpleNamespace

import numpy as np
import pytest

import feltmb
from feltmb.cli.gap_curves import picture_html, remaining_by_part, remaining_picture
from feltmb.gap.spread import together

ACTION = feltmb.load_action("steinway45")


def report(*rows):
    model = SimpleNamespace(core=SimpleNamespace(action=ACTION))
    made = [
        SimpleNamespace(metric=metric, channel=channel, after=after, noise=1.0)
        for metric, channel, after in rows
    ]
    return SimpleNamespace(
        fit=SimpleNamespace(problem=SimpleNamespace(model=model)),
        how_far=SimpleNamespace(metric="open loop", rows=made),
        remaining_cells=[SimpleNamespace(channel=row.channel) for row in made if row.after > 1.1],
    )


def test_what_remains_is_shared_among_the_parts_that_show_it():
    found = report(
        ("open loop", "hammer_tip.x", 2.0),
        ("open loop", "hammer_tip.y", 2.0),
        ("open loop", "whippen.y", 3.0),
        ("open loop", "key_front.y", 0.9),
        ("events", "key_front.y", 90.0),
    )
    shares = remaining_by_part(found)
    head = ACTION.config.points["hammer_tip"].body
    whippen = ACTION.config.points["whippen"].body
    assert shares == pytest.approx({whippen: 8.0 / 14.0, head: 6.0 / 14.0})
    assert next(iter(shares)) == whippen


def test_the_parts_are_colored_in_the_picture_and_the_page():
    figure = remaining_picture(report(("open loop", "whippen.y", 3.0)))
    colors = {
        tuple(np.round(255 * c[:3]).astype(int))
        for collection in figure.axes[0].collections
        for c in collection.get_facecolors()
    }
    assert (0xD5, 0x5E, 0x00) in colors
    assert "100 %" in figure.texts[0].get_text()
    assert "data:image/png;base64," in picture_html(figure)


def test_nothing_is_drawn_where_only_noise_remains_or_there_is_no_mechanism():
    assert remaining_picture(report(("open loop", "whippen.y", 1.0))) is None
    chance = report(("open loop", "whippen.y", 1.05))  # within the scatter of noise
    assert remaining_picture(chance) is None
    bare = report(("open loop", "whippen.y", 3.0))
    bare.fit.problem.model.core = SimpleNamespace()
    assert remaining_by_part(bare) == {}


def test_numbers_that_records_hardly_tell_apart_are_listed():
    names = [SimpleNamespace(name=n) for n in "abc"]
    covariance = np.array([[4.0, 1.8, 0.0], [1.8, 1.0, 0.1], [0.0, 0.1, np.inf]])
    fit = SimpleNamespace(intervals=lambda: names, covariance=covariance)
    assert together(fit) == [("b", "a", pytest.approx(0.9))]
