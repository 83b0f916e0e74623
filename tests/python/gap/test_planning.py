"""Plan against closed forms and against what a diagnosis then finds."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from feltmb.errors import InvalidParameter
from feltmb.gap import Effect, LinearModel, Parameter, Record, Sensor, noncentrality, plan

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


def test_noncentrality_is_the_norm_of_the_projected_column():
    u = np.linspace(-1.0, 1.0, 200)
    square = effect("square", lambda u: u**2)
    cube = effect("cube", lambda u: u**3)
    one = planned("a", u)
    assert noncentrality(NOMINAL, square, 2.0, [one]) == pytest.approx(
        2.0 * np.linalg.norm(u**2) / 0.1, rel=1e-6
    )
    rest = u**3 - u * (u @ u**3) / (u @ u)
    assert noncentrality(NOMINAL, cube, 1.0, [one]) == pytest.approx(
        np.linalg.norm(rest) / 0.1, rel=1e-6
    )


def test_what_the_parameters_imitate_is_not_seen():
    u = np.linspace(-1.0, 1.0, 200)
    found = plan(
        NOMINAL,
        [effect("slope too", lambda u: 2.0 * u), effect("square", lambda u: u**2)],
        [planned("a", u)],
    )
    assert found.unseen == ("slope too",)
    rows = {r.effect: r for r in found.effects}
    assert rows["slope too"].smallest == np.inf
    assert rows["square"].smallest == pytest.approx(3.7 * 0.1 / np.linalg.norm(u**2), rel=1e-6)
    assert rows["square"].surviving == pytest.approx(1.0)


def test_a_further_record_separates_what_is_alike():
    small, large = np.linspace(0.0, 0.2, 100), np.linspace(-1.0, 1.0, 100)
    effects = [effect("square", lambda u: u**2), effect("even", lambda u: np.abs(u) * u)]
    found = plan(NOMINAL, effects, [planned("a", small)], experiments=[planned("b", large)])
    assert found.classes == (("even", "square"),)  # the same for u >= 0
    assert found.experiments[0].name == "b"
    assert found.experiments[0].worst < 0.05


def test_planned_size_is_found():
    data = models.records(5)[:2]
    lam = noncentrality(models.NOMINAL, models.DRY, 1.0, data)
    found = plan(models.NOMINAL, models.EFFECTS, data)
    row = next(r for r in found.effects if r.effect == "dry friction")
    assert row.smallest == pytest.approx(3.7 / lam, rel=1e-6)


def test_unknown_channel_is_said():
    with pytest.raises(InvalidParameter, match="channels: z is no output"):
        plan(models.NOMINAL, models.EFFECTS, models.records(5)[:1], channels=["z"])
    with pytest.raises(InvalidParameter, match="no planned records"):
        plan(models.NOMINAL, models.EFFECTS, [])
    one = replace(models.records(5)[0], inputs={})
    with pytest.raises(InvalidParameter, match="needs the input f"):
        plan(models.NOMINAL, models.EFFECTS, [one])
