"""Draws the pictures of docs/img that no command of a page draws.

    python tools/make_pictures.py                    all
    python tools/make_pictures.py mechanism.png      one

docs/img/gallery is of tools/make_gallery.py, architecture.svg of tools/make_architecture.py,
docs/img/tutorial and docs/img/howto of tools/docs_pages.py; peers.png and cost_against_size.png are
of bench (bench/README.md). The page of the viewer needs Chromium.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))

from docs_pages import ROOT, screenshot, small_png

FOLDER = ROOT / "docs" / "img"


def forte_overview() -> Any:
    """A loud stroke on one page."""
    import feltmb
    from feltmb.graphics import plot

    return plot.overview(feltmb.simulate("steinway45", "forte"))


def mechanism() -> Any:
    """The upright action at rest."""
    import feltmb
    from feltmb.graphics import plot

    return plot.mechanism(feltmb.load_action("steinway45"))


def regulation_terms() -> Any:
    """Blow, dip, lost motion, let-off, aftertouch and checking, as they are measured."""
    import numpy as np

    import feltmb
    from feltmb.graphics.plot.drawing import draw_bodies, draw_fixed, draw_joints
    from feltmb.graphics.plot.poses import bent_beams, body_poses, to_ground
    from feltmb.graphics.plot.shapes import scene, view_box
    from feltmb.run.quasistatic import simulated_press
    from unmodeled.figure import Figure

    action = feltmb.load_action("steinway45_leaded")
    surfaces = action.config.surfaces
    press, played = simulated_press(action), feltmb.simulate(action, "piano")

    def pose(run: Any, row: int) -> Any:
        return np.array([float(run[name][row]) for name in action.coordinates])

    panels = (
        ("at rest", action.rest_pose),
        ("at the let-off, slow press", pose(press.run, int(press.gap[: press.turn].argmin()))),
        ("in check, after a moderate blow", pose(played, -1)),
    )
    figure = Figure(figsize=(15.0, 5.0), layout="constrained")
    drawn = scene(action, [q for _, q in panels])
    limits = view_box(action, drawn, [q for _, q in panels])
    limits = np.add(limits[0], (-0.03, -0.03)), np.add(limits[1], (0.02, 0.0))
    for axes, (title, q) in zip(figure.subplots(1, 3), panels, strict=True):
        poses, bent = body_poses(action, q), bent_beams(action, q)
        axes.set(xlim=(limits[0][0], limits[1][0]), ylim=(limits[0][1], limits[1][1]))
        axes.set_aspect("equal")
        axes.set_axis_off()
        axes.set_title(title, fontsize=13)
        draw_fixed(axes, action, drawn, limits)
        draw_bodies(axes, action, drawn, poses, bent)
        draw_joints(axes, action, drawn, poses)

        def at(name: str, poses: Any = poses) -> Any:
            return to_ground(poses[surfaces[name].body], np.array([surfaces[name].point]))[0]

        def leader(text: str, to: Any, label: Any, axes: Any = axes) -> None:
            arrow = {"arrowstyle": "->", "color": "#b45f06", "lw": 1.2}
            look = {"color": "#b45f06", "fontsize": 12, "ha": "center", "annotation_clip": False}
            axes.annotate(text, to, label, arrowprops=arrow, **look)

        nose, string = at("Hp2"), surfaces["Gp6"]
        normal = np.array(string.normal)
        nose = nose - normal * surfaces["Hp2"].radius
        foot = nose - normal * float(np.dot(nose - string.point, normal))
        gap = 1e3 * float(np.dot(nose - foot, normal))
        axes.annotate("", foot, nose, arrowprops={"arrowstyle": "<->", "color": "#b45f06"})
        word = {"at rest": "blow"}.get(title, "let-off" if "let-off" in title else "checking")
        leader(f"{word} {gap:.1f} mm", 0.5 * (nose + foot), np.add(foot, (0.13, 0.035)))
        if "check" not in title:
            top = np.add(surfaces["Gp3"].point, (0.0, surfaces["Gp3"].radius))
            key = at("Kp4")
            left = 1e3 * float(key[1] - top[1])
            word = "dip" if title == "at rest" else "aftertouch"
            leader(
                f"{word} {left:.1f} mm:\nkey to punching",
                (key + top) / 2,
                np.add(top, (-0.01, 0.11)),
            )
        if title == "at rest":
            leader("lost motion 0.1 mm:\njack to butt", at("Jp2"), np.add(at("Jp2"), (0.17, 0.06)))
    return figure


def felt_identification() -> Any:
    """A felt identified from its own loop with a scatter of 0.5 % of the largest pressure."""
    import numpy as np

    from feltmb.felt import identify, load_material
    from feltmb.felt.plot import plot_identification

    felt = load_material("synthetic_soft_red")
    v = np.linspace(felt.v_f0, felt.end, 130)[1:]
    loop = [felt.pressure("loading", v), felt.pressure("unloading", v)[::-1]]
    pressure = np.concatenate(loop)
    pressure += 0.005 * pressure.max() * np.random.default_rng(1).normal(size=pressure.size)
    v = np.concatenate([v, v[::-1]])
    found = identify(v, pressure, material=felt, loading=np.arange(v.size) < v.size // 2)
    return plot_identification(found)


def felt_audit_hammer() -> Any:
    """The printed curves of the hammer on the string."""
    import feltmb
    from feltmb.felt import audit
    from feltmb.felt.plot import plot_audit

    action = feltmb.load_action("steinway45").with_values({"contacts.06.law": "printed"})
    return plot_audit(audit(action.config.contacts["06"], name="steinway45:06"))


def actuator_dampers() -> Any:
    """Figure 5.11 of the thesis."""
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "bench"))
    from thesis_studies.actuator import figure, simulate

    return figure(simulate(), "5.11")


def actuator_input() -> Any:
    """The effect of a wrong capstan with force and with motion input."""
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "bench"))
    from thesis_studies.findings import Study

    return Study("input").run().figure("timing")


def view_two() -> str:
    """Page of two strokes in the browser, at the impact of the loud one."""
    import feltmb
    from feltmb.graphics.viewer import page

    runs = [feltmb.simulate("steinway45", stroke) for stroke in ("forte", "piano")]
    return page(runs, align="string_contact_on", at=0.0932)


#: Picture -> function: it returns a figure, or the text of a page for a screenshot.
PICTURES: dict[str, Callable[[], Any]] = {
    f"{draw.__name__}.png": draw
    for draw in (
        forte_overview,
        mechanism,
        regulation_terms,
        felt_identification,
        felt_audit_hammer,
        actuator_dampers,
        actuator_input,
        view_two,
    )
}


def main() -> None:
    """Draw the requested pictures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="PICTURE", help=", ".join(PICTURES))
    names = parser.parse_args().names or list(PICTURES)
    unknown = [name for name in names if name not in PICTURES]
    if unknown:
        parser.error(f"no picture {', '.join(unknown)}; there are {', '.join(PICTURES)}")
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            made = PICTURES[name]()
            drawn = Path(folder) / name
            if isinstance(made, str):
                html = drawn.with_suffix(".html")
                html.write_text(made, encoding="utf-8")
                drawn = screenshot(html, "1240,800")
            else:
                made.savefig(drawn, dpi=150)
            small_png(drawn, FOLDER / name, width=1300, colors=256)
            print(name, flush=True)


if __name__ == "__main__":
    main()
