"""Pictures and tables of machines that are no piano: names, units, legends, texts on the page."""

import itertools
import logging
import warnings

import matplotlib
import numpy as np
import pytest

import feltmb
from feltmb import Action, plot
from feltmb.cli.stroke import strike_tables, summary_table
from feltmb.graphics.animate import animate
from feltmb.graphics.viewer import fragment

#: A drum pedal: one contact, no string.
PEDAL = {
    "schema": 1,
    "name": "a_drum_pedal_with_a_long_name_and_a_beater_of_felt",
    "bodies": {
        "beater": {
            "coordinate": "beater.angle",
            "position": [0.0, 0.0],
            "mass": 0.12,
            "center_of_mass": [0.0, 0.16],
            "inertia": 2e-4,
        },
    },
    "surfaces": {
        "felt": {"body": "beater", "kind": "circle", "point": [0.0, 0.2], "radius": 0.025},
        "skin": {"body": "ground", "kind": "line", "point": [0.1, 0.0], "normal": [-1.0, 0.0]},
    },
    "contacts": {
        "01": {
            "label": "beater of hard felt with a wooden core - head of the drum",
            "surfaces": ["felt", "skin"],
            "law": "hunt_crossley",
            "hunt_crossley": {"stiffness": 2e5, "exponent": 1.5, "damping": 0.3},
        },
    },
    "springs": {"back": {"coordinate": "beater.angle", "stiffness": 2.0, "rest_angle": 0.5}},
    "finger": {"body": "beater", "point": [0.0, 0.04], "direction": [1.0, 0.0]},
    "points": {"tip": {"body": "beater", "point": [0.025, 0.2]}},
    "start_pose": {"beater.angle": 0.5},
    "events": {
        "hit": {"contact": 1, "change": "closes"},
        "half_way": {"label": "half the way", "point": "tip", "direction": [1.0, 0.0],
                     "travel": 0.05},
    },
    "reading": {
        "strike_contact": 1,
        "key_point": "tip",
        "striker": {"point": "tip", "direction": [1.0, 0.0]},
        "views": {"mixed": {"title": "tip, angle and force", "curves": [
            {"output": "tip.x", "label": "the tip"}, "beater.angle", "contact01.force"]}},
    },
}  # fmt: skip

#: A key on a punching and a back rail: wide and flat, without points, string and reading.
KEY = {
    "schema": 1,
    "name": "plain_key",
    "bodies": {
        "key": {
            "coordinate": "key.angle",
            "position": [0.0, 0.0],
            "mass": 0.1,
            "center_of_mass": [-0.02, 0.0],
            "inertia": 1.5e-3,
        },
    },
    "surfaces": {
        "front": {"body": "key", "kind": "circle", "point": [0.2, -0.005], "radius": 0.005},
        "punching": {"body": "ground", "kind": "line", "point": [0.2, -0.02], "normal": [0, 1]},
        "back": {"body": "key", "kind": "circle", "point": [-0.15, -0.005], "radius": 0.005},
        "rail": {"body": "ground", "kind": "line", "point": [-0.15, -0.01], "normal": [0, 1]},
    },
    "contacts": {
        f"{n:02d}": {
            "label": label,
            "surfaces": surfaces,
            "law": "hunt_crossley",
            "hunt_crossley": {"stiffness": 2e6, "exponent": 1.5, "damping": 0.5},
        }
        for n, label, surfaces in (
            (1, "key - punching", ["front", "punching"]),
            (2, "key - back rail", ["back", "rail"]),
        )
    },
    "finger": {"body": "key", "point": [0.195, 0.0], "direction": [0.0, -1.0]},
}

PIANO = ("hammer", "string", "piano", "let-off")


@pytest.fixture(scope="module", params=["pedal", "key"])
def run(request):
    action = Action({"pedal": PEDAL, "key": KEY}[request.param])
    return feltmb.simulate(action, feltmb.ramp_stroke(25.0, 0.05, 0.09, duration=0.4))


@pytest.fixture(scope="module")
def pedal():
    stroke = feltmb.ramp_stroke(25.0, 0.05, 0.09, duration=0.4)
    return feltmb.simulate(Action(PEDAL), stroke)


@pytest.fixture(scope="module")
def figures(run):
    made = {}
    for name, draw in plot.PICTURES.items():
        try:
            made[name] = draw(run)
        except feltmb.InvalidParameter:
            continue
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for figure in made.values():
            figure.canvas.draw()
    return made


def texts(figure):
    """Visible texts of a figure without the labels of ticks, which may lie outside the limits."""
    found = figure.findobj(lambda a: isinstance(a, matplotlib.text.Text) and a.get_visible())
    ticks = {t for ax in figure.axes for t in ax.get_xticklabels() + ax.get_yticklabels()}
    return [t for t in found if t.get_text().strip() and t not in ticks]


def test_every_picture_that_has_data_is_drawn(run, figures):
    wanted = set(plot.PICTURES) - {"string"}
    if not run.strike_list:
        wanted -= {"striker_speed"}
    assert set(figures) == wanted


def test_texts_lie_on_the_page(figures):
    for name, figure in figures.items():
        page = figure.bbox
        for text in texts(figure):
            box = text.get_window_extent()
            if text.axes is not None and not text.get_clip_on() and box.width == 0:
                continue
            inside = (
                box.x0 >= page.x0 - 1
                and box.x1 <= page.x1 + 1
                and box.y0 >= page.y0 - 1
                and box.y1 <= page.y1 + 1
            )
            assert inside, (name, text.get_text())


def test_titles_do_not_cover_other_texts(figures):
    for name, figure in figures.items():
        head = next(t for t in texts(figure) if t.get_fontweight() == "bold")
        box = head.get_window_extent()
        for other in texts(figure):
            if other is not head:
                assert not box.overlaps(other.get_window_extent()), (name, other.get_text())


def test_words_of_a_piano_are_not_printed(run, figures):
    words = [t.get_text() for figure in figures.values() for t in texts(figure)]
    words += list(summary_table(run, "x").columns[0].cells)
    words += list(run.stats["warnings"])
    for word, text in itertools.product(PIANO, words):
        assert word not in text.lower(), text


def test_an_entry_of_a_legend_is_drawn(figures):
    for name, figure in figures.items():
        for ax in figure.axes:
            handles, labels = ax.get_legend_handles_labels()
            for handle, label in zip(handles, labels, strict=True):
                if isinstance(handle, matplotlib.lines.Line2D):
                    assert np.isfinite(handle.get_ydata()).sum() > 1, (name, label)
                elif isinstance(handle, matplotlib.collections.Collection):
                    paths = [p.vertices for p in handle.get_paths()]
                    assert np.ptp(np.concatenate(paths)[:, 1]) > 0, (name, label)
                else:
                    assert any(abs(bar.get_width()) > 0 for bar in handle), (name, label)


def test_bars_of_zero_have_no_row(figures, run):
    ledger = {k: v for k, v in run.energy["dissipated"].items() if v}
    axes = figures["energy"].axes
    assert len(axes) == 2
    assert len(axes[1].get_yticks()) == len({name.rpartition(".")[0] for name in ledger})


def test_an_axes_has_one_unit(pedal):
    figure = plot.overview(pedal)
    unit = {
        "the tip": ("mm", 1e3),
        "beater.angle": ("deg", 180 / np.pi),
        "contact01.force": ("N", 1),
    }
    output = {"the tip": "tip.x"}
    found = {}
    for ax in figure.axes:
        if "tip, angle" in ax.get_ylabel():
            (line,) = (x for x in ax.get_lines() if not x.get_label().startswith("_"))
            found[line.get_label()] = ax.get_ylabel(), line.get_ydata()
    assert set(found) == set(unit)
    for label, (text, values) in found.items():
        name, factor = unit[label]
        assert text.endswith(f"[{name}]")
        np.testing.assert_allclose(values, factor * pedal[output.get(label, label)], rtol=1e-12)


def test_a_motion_view_has_the_units_of_its_outputs():
    reading = {"views": {"motion": {"change": True, "curves": ["tip.y", "beater.angle"]}}}
    run = feltmb.simulate(
        Action(PEDAL | {"reading": reading}), feltmb.ramp_stroke(5.0, 0.0, 0.05, duration=0.1)
    )
    labels = [ax.get_ylabel().replace("\n", " ") for ax in plot.motion(run).axes]
    assert labels == ["displacement from start [mm]", "angle from start [deg]"]


def test_a_panel_of_the_viewer_has_one_unit(pedal):
    from feltmb.graphics.viewer.content import default_panels

    for panel in default_panels([pedal]):
        units = {pedal.unit(name) for name in panel["outputs"] if name in pedal}
        # The speed of the striker is no output of the run; it has a panel of its own.
        assert len(units) == (panel["outputs"] != ["tip.speed"])
    assert "string" not in str([p["title"] for p in default_panels([pedal])])
    assert fragment(pedal)


def test_the_animation_shows_everything_and_says_nothing(run, tmp_path, caplog, monkeypatch):
    seen = []
    from matplotlib.axes import Axes

    before = Axes.set_axis_off

    def watch(ax):
        seen.append(ax)
        before(ax)

    monkeypatch.setattr(Axes, "set_axis_off", watch)
    with caplog.at_level(logging.DEBUG), warnings.catch_warnings():
        warnings.simplefilter("error")
        animate(run, tmp_path / "run.gif", slowness=2, fps=5)
    assert not [r for r in caplog.records if r.name.startswith("matplotlib") and r.levelno >= 30]
    (ax,) = seen
    box = ax.get_window_extent()
    width, height = np.diff(ax.get_xlim())[0], np.diff(ax.get_ylim())[0]
    assert box.width / width == pytest.approx(box.height / height, rel=1e-9)
    low, high = ax.get_xlim()
    for collection in ax.collections:
        for path in collection.get_paths():
            points = (collection.get_transform() - ax.transData).transform(path.vertices)
            if len(points):
                assert low <= points[:, 0].min()
                assert points[:, 0].max() <= high


def test_the_table_names_what_the_mechanism_names(pedal):
    rows = dict(zip(*(c.cells for c in summary_table(pedal, "x").columns[:2]), strict=True))
    other = "head of the drum"
    assert f"largest {other} force" in rows
    assert float(rows["half the way"]) == pytest.approx(pedal.event_time("half_way"), abs=1e-5)
    assert "beater travel" in rows
    assert "hit" not in rows  # the impact
    assert not [text for text in rows if "key" in text]
    assert strike_tables(pedal, "x") == []


def test_the_speed_names_what_is_met(pedal):
    figure = plot.striker_speed(pedal)
    words = [t.get_text().replace("\n", " ") for t in texts(figure)]
    met = 1e3 * pedal.summary["impact_time"]
    assert any(t.startswith(f"head of the drum met at {met:.1f} ms") for t in words)
    assert "tip toward head of the drum [m/s]" in words


def test_contact_forces_of_one_contact_show_the_whole_name(pedal):
    figure = plot.contact_forces(pedal)
    figure.canvas.draw()
    head = figure.get_suptitle().replace("\n", " ").replace(" ", "")
    assert pedal.provenance["action"] in head
    assert figure.get_suptitle().count("\n") > 0
