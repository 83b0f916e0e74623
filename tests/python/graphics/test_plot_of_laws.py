"""Pictures of a run: the law in use, the moment of impact."""

import tomllib

import numpy as np
import pytest

import feltmb
from feltmb import plot, simulate
from feltmb.mechanism import Action, core_law, load_action
from feltmb.run.stroke import load_stroke


def test_the_mechanism_of_a_run_is_drawn_at_impact(template):
    from feltmb.graphics.plot.portrait import moment_of_run

    action = feltmb.load_action(template)
    run = feltmb.simulate(action, "press_release")
    title = moment_of_run(run).texts[0].get_text()
    assert f"at impact, {1e3 * run.summary['impact_time']:.1f}" in title
    still = feltmb.simulate(action, feltmb.ramp_stroke(0.1, duration=0.02))
    assert "impact_time" not in still.summary
    assert "farthest from its start" in moment_of_run(still).texts[0].get_text()


LAWS = {
    "hunt_crossley": {"hunt_crossley": {"stiffness": 2e6, "exponent": 1.5, "damping": 0.5}},
    "stulov": {"stulov": {"stiffness": 2e6, "exponent": 1.5, "amplitude": 0.5, "time": 1e-3}},
    "micromechanical": {
        "micromechanical": {
            "felt": "synthetic_hammer",
            "thickness": "6 mm",
            "area": {"kind": "circle_on_layer", "width": "9 mm"},
        }
    },
    "mean": {},
    "felt_memory": {},
}


@pytest.mark.parametrize(
    ("law", "inherited"),
    [(law, True) for law in LAWS] + [(law, False) for law in LAWS if LAWS[law]],
)
def test_the_law_in_use_is_drawn(template, law, inherited):
    """With or without curves that another law of the base file had."""
    raw = tomllib.loads(template.read_text(encoding="utf-8"))
    contact = raw["contacts"]["01"]
    contact.update({"law": law, **LAWS[law]})
    if not inherited:
        del contact["loading"], contact["unloading"]
    run = feltmb.simulate(Action(raw), "press_release", 0.6)
    ax = plot.loops(run, [1]).axes[0]
    drawn = {line.get_label(): line for line in ax.get_lines()}
    pressed = drawn["law alone, pressed"]
    deepest = float(run["contact01.compression"].max())
    assert pressed.get_xdata()[-1] == pytest.approx(1e3 * deepest)
    if law in ("hunt_crossley", "mean"):  # the same number by the law's own static force
        made = core_law(Action(raw).config.contacts["01"])
        static = float(np.asarray(made.force(np.array([deepest])))[0])
        assert pressed.get_ydata()[-1] == pytest.approx(static, rel=0.2)


@pytest.fixture(scope="module")
def strokes():
    action = load_action("steinway45").with_values({"shank.rigid": True, "wire.rigid": True})
    return {n: simulate(action, load_stroke(n), duration=0.15) for n in ("staccato", "forte")}


def test_labels_stay_beside_their_panels(strokes):
    figure = plot.overview(strokes["forte"])
    figure.canvas.draw()
    for ax in figure.axes:
        label = ax.yaxis.label.get_window_extent()
        assert label.height <= ax.get_window_extent().height
