"""Plan against closed forms and against what a diagnosis then finds."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from feltmb.errors import InvalidParameter
from feltmb.gap import Effect, LinearModel, Parameter, Record, Sensor, plan
from feltmb.gap.criteria import DETECTABLE

HERE = Path(__file__).parent
spec = importlib.util.spec_from_file_location("gap_models", HERE / "models.py")
models = importlib.util.module_from_spec(spec)
spec.loader.exec_module(models)

NOMINAL = LinearModel(
    output="y",
    columns={"slope": lambda r: r.inputs["u"]},
    parameters=[Parameter(name="slope", value=1.0)],
)


def effect(name, column):
    return Effect(name=name, component="c", regressor=lambda r, s: column(r.inputs["u"]))


def planned(name, u):
    n = u.size
    return Record(
        name=name,
        time=np.arange(n) * 0.01,
        inputs={"u": u},
        outputs={"y": np.zeros(n)},
        sensors={"y": Sensor(name="y", sigma=0.1)},
    )


def test_smallest_magnitude_is_that_of_the_projected_column():
    u = np.linspace(-1.0, 1.0, 200)
    found = plan(NOMINAL, [effect("cube", lambda u: u**3)], [planned("a", u)])
    rest = u**3 - u * (u @ u**3) / (u @ u)
    (row,) = found.effects
    assert row.smallest == pytest.approx(DETECTABLE * 0.1 / np.linalg.norm(rest), rel=1e-6)
    assert row.surviving == pytest.approx(np.linalg.norm(rest) / np.linalg.norm(u**3), rel=1e-6)
    assert row.smallest_before == np.inf


def test_what_the_parameters_imitate_is_not_seen():
    u = np.linspace(-1.0, 1.0, 200)
    found = plan(
        NOMINAL,
        [effect("slope too", lambda u: 2.0 * u), effect("square", lambda u: u**2)],
        [planned("a", u)],
    )
    rows = {r.effect: r for r in found.effects}
    assert "a change of slope looks the same" in rows["slope too"].hidden
    assert rows["square"].hidden == ""
    assert rows["slope too"].smallest == np.inf
    assert rows["square"].smallest == pytest.approx(
        DETECTABLE * 0.1 / np.linalg.norm(u**2), rel=1e-6
    )
    assert rows["square"].surviving == pytest.approx(1.0)


def test_a_further_record_separates_what_is_alike():
    small, large = np.linspace(0.0, 0.2, 100), np.linspace(-1.0, 1.0, 100)
    effects = [effect("square", lambda u: u**2), effect("even", lambda u: np.abs(u) * u)]
    found = plan(NOMINAL, effects, [planned("a", small)], experiments=[planned("b", large)])
    assert found.inseparable == (("even", "square"),)  # the same for u >= 0
    (best,) = found.experiments
    assert best.name == "b"
    assert best.after > 0.95 > found.after
    assert any("separates even from square" in r or "detects 2 of 2" in r for r in best.reasons)


def test_a_further_output_is_offered_as_a_sensor():
    """What it would tell is what a plan that measures it tells."""
    one = models.records(5)[0]
    few = plan(models.NOMINAL, models.EFFECTS, [one], channels=["q"])
    assert few.experiments == ()  # the model has no other output
    two = plan(models.NOMINAL, models.EFFECTS, [one], experiments=[replace(one, name="again")])
    both = plan(models.NOMINAL, models.EFFECTS, [one, replace(one, name="again")])
    assert two.experiments[0].after == pytest.approx(both.after, rel=1e-6)


def test_unknown_channel_is_said():
    with pytest.raises(InvalidParameter, match="channels: z is no output"):
        plan(models.NOMINAL, models.EFFECTS, models.records(5)[:1], channels=["z"])
    with pytest.raises(InvalidParameter, match="no planned records"):
        plan(models.NOMINAL, models.EFFECTS, [])
    one = replace(models.records(5)[0], inputs={})
    with pytest.raises(InvalidParameter, match="needs the input f"):
        plan(models.NOMINAL, models.EFFECTS, [one])
