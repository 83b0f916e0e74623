"""Recommended next steps after a residual that nothing explains."""

from types import SimpleNamespace

import pytest

from feltmb.gap import Effect, LinearModel, Parameter
from feltmb.gap.findings import ComponentRow, Verdict
from feltmb.gap.steps import next_steps

FRICTION = Effect(name="friction", component="cart", scale=1.0, regressor=lambda r, s: r.time)
GAIN = Effect(name="gain", component="cell", kind="sensor", observe=lambda *a: None)
AT_CART = ComponentRow(
    component="cart", port="f", unit="N", statistic=9.0, p=1e-9, significant=True, explained=0.94
)


def texts(
    verdict=Verdict.NAMED_RESIDUAL, *, named=(), sd=1.0, tested=(FRICTION,), remedy="", kind="force"
):
    model = LinearModel(
        output="y",
        columns={"k": lambda r: r.time},
        parameters=[Parameter(name="k", value=1.0, sd=sd)],
    )
    named = [
        SimpleNamespace(effect=n, component="cart", remedy=remedy, prior_deviations=None, kind=kind)
        for n in named
    ]
    steps = next_steps(verdict, [], [], named, [], None, [AT_CART], [], model, tested)
    return " ".join(a.text for a in steps)


def test_a_place_where_an_effect_is_named_is_no_place_to_look():
    assert "Look at cart" in texts()
    assert "94% of the gap of the model" in texts()
    assert "Look at cart" not in texts(named=["friction"])


def test_every_named_effect_has_a_step():
    of = {"verdict": Verdict.NAMED, "named": ["friction"]}
    assert texts(**of) == "friction: add it to the model, or remove its cause from the machine"
    assert texts(**of, kind="sensor") == "friction: correct the records, or add it to the model"
    assert texts(**of, remedy="oil it") == "friction: oil it"


def test_errors_of_sensors_are_recommended_if_none_was_tested():
    assert "for_sensor" in texts()
    assert "for_sensor" not in texts(tested=(FRICTION, GAIN))


def test_fixed_numbers_are_suspects():
    assert "k: fixed (sd = 0)" in texts(sd=0.0)
    assert "fixed" not in texts(sd=1.0)


@pytest.mark.parametrize("verdict", [Verdict.NO_GAP, Verdict.NAMED])
def test_nothing_is_recommended_where_nothing_is_left(verdict):
    assert texts(verdict, sd=0.0) == ""
