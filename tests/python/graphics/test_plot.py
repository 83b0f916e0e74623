"""Pictures: what is plotted is what the run holds, and labels can be read."""

import dataclasses
import itertools
import re
import subprocess
import sys
from pathlib import Path

import matplotlib
import numpy as np
import pytest

import feltmb
from feltmb import Action, InvalidParameter, _core, plot
from feltmb.cli import main
from feltmb.graphics.plot.poses import bent_beams, point_at

NUMERIC = ("forte", "piano")

#: Every picture of the loud stroke; of the soft one those whose labels depend on the times.
DRAWN = [("forte", picture) for picture in plot.PICTURES] + [
    ("piano", picture) for picture in ("overview", "motion", "energy", "finger_force")
]

#: Two bodies that know nothing of pianos: a pendulum with a welded rod meets a round stop.
PENDULUM = {
    "schema": 1,
    "name": "pendulum $1 <b>",
    "bodies": {
        "arm": {
            "coordinate": "arm.angle",
            "position": [0.0, 0.0],
            "mass": 0.2,
            "center_of_mass": [0.2, 0.0],
            "inertia": 1e-3,
        },
        "rod": {
            "kind": "beam",
            "parent": "arm",
            "joint": "weld",
            "position": [0.3, 0.0],
            "angle": 0.5,
            "length": 0.2,
            "density": 700.0,
            "area": 3e-5,
        },
    },
    "surfaces": {
        "stop": {"body": "ground", "kind": "circle", "point": [0.25, -0.3], "radius": 0.05},
        "face": {"body": "arm", "kind": "line", "point": [0.25, -0.01], "normal": [0.0, -1.0]},
    },
    "contacts": {
        "01": {
            "label": "arm - stop $",
            "surfaces": ["stop", "face"],
            "law": "hunt_crossley",
            "hunt_crossley": {"stiffness": 1e6, "exponent": 1.5, "damping": 0.5},
        }
    },
    "points": {"tip": {"body": "rod", "point": [0.2, 0.0]}},
    "start_pose": {"arm.angle": -0.8},
}


@pytest.fixture(scope="module")
def runs(action):
    return {name: feltmb.simulate(action, name) for name in NUMERIC}


@pytest.fixture(scope="module")
def pendulum():
    return Action(PENDULUM, "pendulum")


@pytest.fixture(scope="module")
def swing(pendulum):
    start = feltmb.simulate(pendulum, feltmb.ramp_stroke(0.0), 0.01)
    lifted = start.end_state.copy()
    lifted[0] += 0.4
    start = dataclasses.replace(start, end_state=lifted)
    return feltmb.simulate(pendulum, feltmb.ramp_stroke(0.0), 0.5, start=start)


@pytest.fixture(scope="module")
def figures(runs):
    out = {}
    for name, picture in DRAWN:
        out[name, picture] = plot.PICTURES[picture](runs[name])
        out[name, picture].canvas.draw()
    return out


def reduced(run, keep):
    """The run with only those outputs whose names match."""
    columns = [i for i, name in enumerate(run.names) if re.fullmatch(keep, name)]
    return dataclasses.replace(
        run,
        names=tuple(run.names[i] for i in columns),
        units=tuple(run.units[i] for i in columns),
        long_names=tuple(run.long_names[i] for i in columns),
        values=run.values[:, columns],
        eta=run.eta[:, :0],
    )


def lines(ax):
    return {line.get_label(): np.asarray(line.get_xydata()) for line in ax.get_lines()}


# --- numbers -------------------------------------------------------------------------------------


def test_motion_plots_the_displacements_of_the_run_in_millimeters(figures, runs):
    run = runs["forte"]
    for ax in figures["forte", "motion"].axes:
        drawn = lines(ax)
        for label, output, factor in (
            ("key front, dy", "key_front.y", 1.0),
            ("whippen, dy", "whippen.y", 1.0),
            ("4 × key lift", "key_balance.y", 4.0),
            ("hammer tip, dx", "hammer_tip.x", 1.0),
            ("hammer tip, dy", "hammer_tip.y", 1.0),
        ):
            np.testing.assert_allclose(drawn[label][:, 0], 1e3 * run.time)
            want = 1e3 * factor * (run[output] - run[output][0])
            np.testing.assert_allclose(drawn[label][:, 1], want, atol=1e-12)


def test_the_striker_speed_points_toward_the_string_and_marks_impact(figures, runs):
    run = runs["forte"]
    ax = figures["forte", "striker_speed"].axes[0]
    np.testing.assert_array_equal(lines(ax)["hammer tip"][:, 1], -run["hammer_tip.vx"])
    impact = run.event_time("string_contact_on")
    marks = [line.get_xydata()[0] for line in ax.get_lines() if line.get_marker() == "o"]
    assert marks[0][0] == pytest.approx(1e3 * impact)
    assert marks[0][1] == pytest.approx(run.summary["impact_speed"], rel=0.05)
    assert marks[0][1] > 0 > marks[1][1]


def test_contact_forces_show_every_loaded_contact_with_its_peak(figures, runs):
    run = runs["forte"]
    axes = [ax for ax in figures["forte", "contact_forces"].axes if ax.get_visible()]
    loaded = [n for n in range(1, 17) if run[f"contact{n:02d}.force"].max() > 1e-6]
    assert len(axes) == len(loaded) == 15
    for ax, number in zip(axes, loaded, strict=True):
        force = run[f"contact{number:02d}.force"]
        assert ax.get_title(loc="left").startswith(f"{number} ")
        np.testing.assert_array_equal(ax.get_lines()[0].get_ydata(), force)
        texts = " ".join(text.get_text() for text in ax.texts)
        assert f"peak {force.max():.3g} N" in texts
        low, high = ax.get_xlim()
        if force.argmax() > 0 and force[0] < 0.99 * force.max():
            assert low <= 1e3 * run.time[force.argmax()] <= high


def test_string_picture_is_the_displacement_of_the_run(figures, runs):
    run = runs["forte"]
    ax = figures["forte", "string"].axes[2]
    image = ax.get_images()[0]
    shown = np.asarray(image.get_array())
    left, right, _, top = image.get_extent()
    keep = (run.time >= 1e-3 * left - 1e-9) & (run.time <= 1e-3 * right + 1e-9)
    want = run.string_displacement(np.linspace(0.0, 0.6315, shown.shape[0]))[keep]
    np.testing.assert_allclose(shown, 1e3 * want.T)
    assert top == pytest.approx(631.5)


def test_energy_sums_and_finger_work_agree_with_the_ledger(figures, runs):
    run = runs["forte"]
    axes = figures["forte", "energy"].axes
    drawn = lines(axes[0])
    names = [n for n in run.names if n.startswith("energy.")]
    total = sum(run[n] - run[n][0] for n in names)
    np.testing.assert_allclose(drawn["sum stored"][:, 1], 1e3 * total, atol=1e-9)
    assert drawn["finger work"][-1, 1] == pytest.approx(1e3 * run.energy["work_in"], rel=1e-3)
    bars = sum(patch.get_width() for patch in axes[1].patches)
    assert bars == pytest.approx(1e3 * run.energy["dissipated_total"], rel=1e-9)
    assert f"{run.energy['residual_relative']:.1e}" in axes[1].get_title(loc="left")


def test_energy_without_ledger_shows_the_stored_parts_only(action):
    run = feltmb.simulate(action, "forte", 0.12, ledger=False)
    figure = plot.energy(run)
    assert len(figure.axes) == 1
    assert "sum stored" in lines(figure.axes[0])


def test_a_loop_with_too_few_samples_says_so(action):
    """At 10 kHz the jack leather and the string are polygons; `--plot` takes 40 kHz."""
    run = feltmb.simulate(action, "forte", 0.12)
    coarse = plot.loops(run)
    assert "Samples every 0.1 ms are few for contacts 4, 6" in coarse.get_supxlabel()
    assert plot.picture_rate(0.12, 1e4) == 40e3
    assert plot.picture_rate(10.0, 1e4) == 20e3
    assert plot.picture_rate(1e3, 1e4) == 1e4
    fine = feltmb.simulate(action, "forte", 0.12, output_rate=plot.picture_rate(0.12, 1e4))
    assert plot.loops(fine).get_supxlabel() == ""
    # Between the samples nothing is invented: the points of 10 kHz are among those of 40 kHz.
    few, many = (dict(lines(plot.loops(r, [6]).axes[0]))["run"] for r in (
        run, fine))  # fmt: skip
    np.testing.assert_allclose(few, many[::4], rtol=1e-6, atol=1e-9)


def test_stroke_with_plots_has_more_samples(tmp_path, monkeypatch):
    from click.testing import CliRunner

    from feltmb.cli.stroke import command

    monkeypatch.setattr(plot, "save_all", lambda *_, **__: [])  # the samples are asked for
    for options, rate in (([], 1e4), (["--plot"], 4e4), (["--plot", "--output-rate", "5e3"], 5e3)):
        out = tmp_path / f"{rate:g}.nc"
        arguments = ["steinway45", "forte", "--duration", "0.01", "-o", str(out), *options]
        assert CliRunner().invoke(command, arguments).exit_code == 0
        assert feltmb.load_run(out).provenance["options"]["output_rate"] == rate


def test_loops_lie_over_the_curves_of_their_laws(runs, action):
    run = runs["forte"]
    figure = plot.loops(run, [6])
    drawn = lines(figure.axes[0])
    contact = action.config.contacts["06"]
    # Driven alone as fast as in the strike, the law is on its curves but for the turn.
    for label, curve in (
        ("law alone, pressed", contact.loading),
        ("law alone, released", contact.unloading),
    ):
        e = 1e-3 * drawn[label][:, 0]
        want = np.maximum(curve.a * e * np.exp(curve.b * e) + curve.c * e, 0.0)
        close = np.abs(drawn[label][:, 1] - want) < 0.01 * want.max()
        assert np.mean(close) > 0.9
    x, y = drawn["run"].T
    touching = np.isfinite(y)
    np.testing.assert_array_equal(y[touching], run["contact06.force"][touching])
    np.testing.assert_allclose(1e-3 * x, run["contact06.compression"])
    with pytest.raises(InvalidParameter, match="no contact 99"):
        plot.loops(run, [99])


def test_compare_overlays_in_units_of_the_reader(runs):
    pair = list(runs.values())
    figure = plot.compare([*pair, pair[0]], ["hammer.angle", "contact06.force"])
    for ax, name, factor in zip(
        figure.axes, ("hammer.angle", "contact06.force"), (180.0 / np.pi, 1.0), strict=True
    ):
        for line, run in zip(ax.get_lines(), [*pair, pair[0]], strict=True):
            np.testing.assert_allclose(line.get_ydata(), factor * run[name])
    (legend,) = figure.legends
    assert len({text.get_text() for text in legend.get_texts()}) == 3
    with pytest.raises(InvalidParameter, match=r"hammer_tip\.vx"):
        plot.compare(pair, ["hammer_tip.v"])
    with pytest.raises(InvalidParameter, match="0 runs"):
        plot.compare([], ["hammer.angle"])
    with pytest.raises(InvalidParameter, match="got 1 labels, expected one for each of the 2 runs"):
        plot.compare(pair, ["hammer.angle"], ["one"])


def test_compare_names_runs_of_one_mechanism_by_their_files(rigid, tmp_path, monkeypatch):
    """They were "steinway45 · stroke piano (1)" and "(2)"."""
    figures = []
    original = plot.compare

    def kept(*args):
        figures.append(original(*args))
        return figures[-1]

    monkeypatch.setattr(plot, "compare", kept)
    run = feltmb.simulate(rigid, "piano", 0.01)
    paths = [tmp_path / f"{n}.nc" for n in ("before", "_after", "a/run", "b/run", "cost_$5")]
    for path in paths:
        path.parent.mkdir(exist_ok=True)
        run.save(path)
    words = [*map(str, paths), str(paths[0]), "--compare", "hammer.angle", "-o", str(tmp_path)]
    with pytest.raises(SystemExit, match="0"):
        main(["plot", *words])
    (legend,) = figures[0].legends
    told = [text.get_text() for text in legend.get_texts()]
    assert told == [
        f"{paths[0]} (1)",
        " _after",
        str(paths[2]),
        str(paths[3]),
        r"cost_\$5",
        f"{paths[0]} (6)",
    ]
    colors = [line.get_color() for line in figures[0].axes[0].get_lines()]
    assert [handle.get_color() for handle in legend.legend_handles] == colors
    assert len(set(colors)) == len(paths) + 1


def test_finger_of_a_motion_stroke_shows_what_was_prescribed(action):
    stroke = feltmb.motion_stroke([0.0, 0.02, 0.2], [0.0, 0.0, 0.004], duration=0.2)
    run = feltmb.simulate(action, stroke)
    drawn = lines(plot.finger_force(run).axes[1])
    np.testing.assert_allclose(drawn["finger, prescribed"][:, 1], 1e3 * stroke.at(run.time))


# --- reading -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("stroke", "picture"), DRAWN)
def test_texts_do_not_overlap_and_lie_on_the_page(figures, stroke, picture):
    figure = figures[stroke, picture]
    renderer = figure.canvas.get_renderer()
    page = figure.bbox
    hidden = undrawn_tick_labels(figure)
    boxes = []
    for text in figure.findobj(matplotlib.text.Text):
        if not text.get_visible() or not text.get_text().strip():
            continue
        if text.axes is not None and not text.axes.get_visible():
            continue
        if text in hidden:
            continue
        box = text.get_window_extent(renderer)
        boxes.append((text.get_text(), box))
        assert box.x0 >= page.x0 - 1, text.get_text()
        assert box.x1 <= page.x1 + 1, text.get_text()
        assert box.y0 >= page.y0 - 1, text.get_text()
        assert box.y1 <= page.y1 + 1, text.get_text()
    assert len(boxes) > 4
    for (name_a, a), (name_b, b) in itertools.combinations(boxes, 2):
        over_x = min(a.x1, b.x1) - max(a.x0, b.x0)
        over_y = min(a.y1, b.y1) - max(a.y0, b.y0)
        assert over_x < 1.5 or over_y < 1.5, f"{name_a!r} and {name_b!r} overlap"


def undrawn_tick_labels(figure):
    """Labels of ticks outside of the limits exist but are not drawn."""
    out = set()
    for ax in figure.axes:
        for axis, (low, high) in ((ax.xaxis, ax.get_xlim()), (ax.yaxis, ax.get_ylim())):
            shown = ax.get_visible() and ax.axison
            for tick in [*axis.get_major_ticks(), *axis.get_minor_ticks()]:
                if not shown or not min(low, high) <= tick.get_loc() <= max(low, high):
                    out |= {tick.label1, tick.label2}
    return out


def test_every_plot_of_data_names_quantity_and_unit(figures):
    units = {"ms", "mm", "N", "m/s", "mJ"}
    for (_, picture), figure in figures.items():
        if picture == "mechanism":
            continue
        labels = [ax.get_ylabel() for ax in figure.axes] + [ax.get_xlabel() for ax in figure.axes]
        found = [re.search(r"\[(.+)\]$", label) for label in labels if label]
        assert found
        assert {f and f.group(1) for f in found} <= units, labels


def test_events_stand_at_their_times(figures, runs):
    run = runs["piano"]
    ax = figures["piano", "motion"].axes[1]
    at = {
        round(float(line.get_xdata()[0]), 6)
        for line in ax.get_lines()
        if len(line.get_xdata()) == 2 and line.get_xdata()[0] == line.get_xdata()[1]
    }
    names = {text.get_text() for text in ax.texts}
    for event in ("damper_start", "let_off", "string_contact_on", "check"):
        assert round(1e3 * run.event_time(event), 6) in at
        assert event.replace("_", " ") in names


def test_an_event_that_repeats_is_named_once(rigid):
    run = feltmb.simulate(rigid, "press_release")
    assert run.event_table["event"].count("key_start") > 1
    ax = plot.motion(run).axes[0]
    assert [text.get_text() for text in ax.texts].count("key start") == 1


# --- the mechanism -------------------------------------------------------------------------------


def poses(action, run, times):
    return [
        np.array([np.interp(t, run.time, run[name]) for name in action.coordinates]) for t in times
    ]


def test_drawn_points_are_where_the_core_has_them(action, runs):
    mechanism = action.mechanism
    for q in [action.rest_pose, *poses(action, runs["forte"], (0.08, 0.093, 0.3))]:
        found = plot.body_poses(action, q)
        for i, name in enumerate(mechanism.point_names):
            point = action.config.points[name]
            want = _core.point_position(mechanism, i, q)
            got = point_at(action, found, bent_beams(action, q), point.body, point.point)
            np.testing.assert_allclose(got, want, atol=1e-12)


def drawn_surfaces(figure):
    """Points of the drawn surfaces in the ground frame [m], from the artists themselves."""
    ax = figure.axes[0]
    out = {}
    for collection in ax.collections:
        gid = collection.get_gid() or ""
        if gid.startswith("surface:"):
            to_ground = collection.get_transform() - ax.transData
            out[gid.removeprefix("surface:")] = to_ground.transform(collection.get_segments()[0])
    for line in ax.get_lines():
        if line.get_gid() == "string":
            out["string"] = np.asarray(line.get_xydata())
    return out


def distance(a, b):
    """Least distance [m] of two polylines, one of them curved finely."""

    def points_to(p, chain):
        start, end = chain[:-1], chain[1:]
        d = end - start
        share = np.einsum("pij,ij->pi", p[:, None] - start, d) / np.maximum(
            np.einsum("ij,ij->i", d, d), 1e-30
        )
        foot = start + np.clip(share, 0, 1)[..., None] * d
        return np.linalg.norm(p[:, None] - foot, axis=2).min()

    return min(points_to(a, b), points_to(b, a))


@pytest.mark.parametrize("time", [0.0, 0.0915, 0.0935, 0.103])
def test_drawn_surfaces_are_as_far_apart_as_the_contacts_say(action, runs, time):
    (q,) = poses(action, runs["forte"], [time])
    surfaces = drawn_surfaces(plot.mechanism(action, q))
    table = feltmb.evaluate(action, q, np.zeros_like(q)).contacts
    checked = 0
    for key, contact in action.config.contacts.items():
        gap = -float(table.loc[int(key), "compression"])
        if not contact.enabled or gap <= 0:
            continue
        pair = [surfaces["string" if n in ("Gp6", "Gp9") else n] for n in contact.surfaces
                if n != "Kp1"]  # fmt: skip
        if len(pair) < 2:
            continue
        # Gp9 is another line than the string, some micrometers beside it.
        tolerance = 2e-5 if key == "10" else 4e-6
        assert distance(*pair) == pytest.approx(gap, abs=tolerance), f"contact {key}"
        checked += 1
    assert checked >= 5


def test_contact_numbers_and_bodies_are_named_on_the_drawing(action):
    figure = plot.mechanism(action)
    texts = {text.get_text() for text in figure.axes[0].texts}
    assert {str(int(k)) for k, c in action.config.contacts.items() if c.enabled} <= texts
    assert {b.label for b in action.config.bodies.values() if b.mass > 0} <= texts
    listed = {text.get_text() for text in figure.legends[0].get_texts()}
    assert {c.label for c in action.config.contacts.values() if c.enabled} <= listed


def test_mechanism_refuses_a_pose_of_the_wrong_length(action):
    with pytest.raises(InvalidParameter, match="3 numbers, expected 12"):
        plot.mechanism(action, [0.0, 0.0, 0.0])


# --- other mechanisms, missing outputs -----------------------------------------------------------


def test_a_mechanism_without_hammer_key_and_string_is_drawn(pendulum, swing, tmp_path):
    written = plot.save_all(swing, tmp_path, "swing")
    assert {p.stem for p in written} == {
        f"swing_{n}"
        for n in ("overview", "motion", "contact_forces", "energy", "loops", "mechanism")
    }
    drawn = lines(plot.motion(swing).axes[0])
    np.testing.assert_allclose(
        drawn["tip, dy"][:, 1], 1e3 * (swing["tip.y"] - swing["tip.y"][0]), atol=1e-12
    )
    surfaces = drawn_surfaces(plot.mechanism(pendulum, [0.1]))
    gap = -feltmb.evaluate(pendulum, [0.1], [0.0]).contacts.loc[1, "compression"]
    assert distance(surfaces["stop"], surfaces["face"]) == pytest.approx(gap, abs=5e-6)


def test_the_motion_of_a_mechanism_without_points_is_that_of_its_coordinates():
    raw = {k: v for k, v in PENDULUM.items() if k not in ("points", "surfaces", "contacts")}
    slide = {"joint": "prismatic", "axis": [1.0, 0.0], "coordinate": "car.x", "position": [0, 0]}
    raw["bodies"] = {**raw["bodies"], "car": {**slide, "mass": 0.1}}
    raw["finger"] = {"body": "car", "point": [0.0, 0.0], "direction": [1.0, 0.0]}
    run = feltmb.simulate(Action(raw, "free"), feltmb.ramp_stroke(2.0), 0.4)
    figure = plot.overview(run)
    shown = {ax.get_ylabel(): lines(ax) for ax in figure.axes}
    assert list(shown) == ["finger force [N]", "displacement [mm]", "angle [deg]"]
    assert list(shown["displacement [mm]"]) == ["car.x"]  # not the bending of the rod
    car, arm = shown["displacement [mm]"]["car.x"], shown["angle [deg]"]["arm.angle"]
    np.testing.assert_allclose(car[:, 1], 1e3 * (run["car.x"] - run["car.x"][0]))
    np.testing.assert_allclose(arm[:, 1], np.degrees(run["arm.angle"] - run["arm.angle"][0]))
    assert np.ptp(car[:, 1]) > 1.0
    assert len(plot.motion(run).axes) == 2


@pytest.mark.parametrize("picture", [n for n in plot.PICTURES if n != "mechanism"])
def test_a_run_without_the_outputs_is_refused_clearly(runs, picture):
    run = dataclasses.replace(
        reduced(runs["forte"], r"jack\.angle"),
        provenance={"toml": runs["forte"].provenance["toml"]},
    )
    with pytest.raises(InvalidParameter, match=f"plot {picture}"):
        plot.PICTURES[picture](run)


def test_save_all_of_a_run_without_pictures_is_refused(runs, tmp_path):
    run = dataclasses.replace(reduced(runs["forte"], r"jack\.angle"), provenance={})
    with pytest.raises(InvalidParameter, match="no picture"):
        plot.save_all(run, tmp_path, "x")
    assert not list(tmp_path.iterdir())


def test_a_run_of_one_sample_is_refused(runs):
    run = runs["forte"]
    short = dataclasses.replace(run, time=run.time[:1], values=run.values[:1], eta=run.eta[:1])
    with pytest.raises(InvalidParameter, match="1 samples"):
        plot.overview(short)


# --- files and state -----------------------------------------------------------------------------


def test_no_picture_is_blank(figures):
    for (stroke, picture), figure in figures.items():
        gray = np.asarray(figure.canvas.buffer_rgba())[:, :, :3].mean(axis=2)
        ink = float(np.mean(gray < 200))
        assert 0.002 < ink < 0.5, f"{stroke} {picture}: {ink}"
        assert min(gray.shape) > 400


def test_save_all_writes_pictures_and_never_over_others(runs, tmp_path, monkeypatch):
    from PIL import Image

    few = {name: plot.PICTURES[name] for name in ("striker_speed", "string")}
    monkeypatch.setattr("feltmb.graphics.plot.files.PICTURES", few)
    kept = tmp_path / "a_string.png"
    kept.write_bytes(b"mine")
    with pytest.raises(feltmb.FileExists):
        plot.save_all(runs["piano"], tmp_path, "a")
    assert [p.name for p in tmp_path.iterdir()] == ["a_string.png"]
    assert kept.read_bytes() == b"mine"
    written = plot.save_all(runs["piano"], tmp_path, "a", force=True)
    assert {p.name for p in written} == {"a_striker_speed.png", "a_string.png"}
    for path in written:
        with Image.open(path) as image:
            assert image.format == "PNG"
            assert np.asarray(image.convert("L")).std() > 5


def test_no_global_state_of_matplotlib_is_touched():
    code = (
        "import sys, feltmb.graphics.plot, feltmb.graphics.animate, feltmb.graphics.graph\n"
        "assert not any(m.startswith('matplotlib') for m in sys.modules), 'early import'\n"
        "run = feltmb.simulate('steinway45', 'forte', 0.11)\n"
        "import matplotlib\n"
        "before = matplotlib.rcParams.copy()\n"
        "feltmb.plot.overview(run).canvas.draw()\n"
        "feltmb.plot.mechanism(feltmb.load_action('steinway45')).canvas.draw()\n"
        "assert matplotlib.rcParams.copy() == before, 'rcParams changed'\n"
        "assert 'matplotlib.pyplot' not in sys.modules, 'pyplot'\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", ["steinway45", "falling_mass", "hammer_and_string", "template"])
def test_the_scale_bar_of_a_mechanism_fits_the_drawing(name, tmp_path):
    if name == "template":
        path = tmp_path / "mine.toml"
        with pytest.raises(SystemExit):
            main(["new", str(path)])
    elif name == "steinway45":
        path = name
    else:
        path = Path(__file__).parents[3] / "examples" / "gallery" / f"{name}.toml"
    (ax,) = plot.mechanism(feltmb.load_action(path)).axes
    (bar,) = [line for line in ax.lines if line.get_gid() == "scale"]
    left, right = bar.get_xdata()
    low, high = ax.get_xlim()
    assert low < left < right < high
    assert right - left > 0.05 * (high - low)
    told = next(t.get_text() for t in ax.texts if t.get_text().endswith(" mm"))
    assert told == f"{1e3 * (right - left):g} mm"
    assert ax.get_ylim()[0] < bar.get_ydata()[0]


def test_a_run_with_several_notes_shows_each_strike():
    """The named events are those of the first notes only, which were told alone."""
    run = feltmb.simulate("steinway45", "repeated", output_rate=8e3)
    figure = plot.overview(run)
    words = [t.get_text() for ax in figure.axes for t in ax.texts]
    count = len(run.strike_list)
    assert count == 5
    assert [w for w in words if w.startswith("strike ")] == [f"strike {i}" for i in range(1, 6)]
    assert sum(w.endswith(" m/s") for w in words) == count
    (below,) = (t.get_text() for t in figure.texts if t.get_text().startswith("strike 1 at"))
    assert below.splitlines()[2].startswith("strike 3 at 236.5 ms   impact speed 1.26 m/s")
    # The last note is in all panels.
    last = 1e3 * run.strike_list[-1]["impact_time"]
    assert all(ax.get_xlim()[1] > last for ax in figure.axes)
    # A light touch of the free hammer after one note is no further note.
    bounced = feltmb.simulate("steinway45", "staccato", output_rate=8e3)
    assert len(bounced.strike_list) == 2
    words = [t.get_text() for ax in plot.overview(bounced).axes for t in ax.texts]
    assert "jack toe" in words
