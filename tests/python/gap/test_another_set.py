"""Held-out records refuse the set that explains the fitted records best, and confirm another."""

from __future__ import annotations

import numpy as np
import pytest

from feltmb.gap import (
    Effect,
    LinearModel,
    Options,
    Parameter,
    Record,
    Sensor,
    Verdict,
    diagnose,
)

SIGMA, COUNT = 0.02, 200
TIME = np.linspace(0.0, 1.0, COUNT)
LINE = LinearModel(
    output="y",
    columns={"gain": lambda r: r.inputs["x"]},
    parameters=[Parameter(name="gain", value=1.0, sd=0.2)],
    name="line",
)
ODD = Effect(name="odd", component="x", scale=0.5, regressor=lambda r, s: r.inputs["x"] ** 3)
#: The same for x > 0, and more probable before any data.
EVEN = Effect(
    name="even",
    component="x",
    scale=0.5,
    weight=2.0,
    regressor=lambda r, s: np.abs(r.inputs["x"]) ** 3,
)


def record(name, seed, *, sign=1.0, magnitude=0.5, role="fit"):
    x = sign * np.sin(3.0 * TIME)
    noise = SIGMA * np.random.default_rng(seed).standard_normal(COUNT)
    return Record(
        name=name,
        time=TIME,
        inputs={"x": x},
        outputs={"y": 1.1 * x + magnitude * x**3 + noise},
        sensors={"y": Sensor(name="y", sigma=SIGMA)},
        role=role,
    )


def found(*held_out):
    records = [record("a", 1), record("b", 2), *held_out]
    return diagnose(LINE, [ODD, EVEN], records, options=Options(bootstrap=0, advice=False))


def test_the_set_that_all_records_prefer_is_named():
    report = found(record("c", 3, sign=-1.0, role="held_out"))
    assert report.verdict == Verdict.NAMED
    assert report.named == ("odd",)
    (odd,) = [e for e in report.which.effects if e.effect == "odd"]
    assert odd.magnitude == pytest.approx(0.5, abs=0.05)
    assert report.which["odd"].posterior > 0.99
    assert report.which["even"].posterior < 0.01


def test_held_out_records_that_do_not_separate_them_change_nothing():
    report = found(record("c", 3, role="held_out"))
    assert report.verdict == Verdict.ONE_OF
    assert set(report.one_of) == {"odd", "even"}


def test_nothing_is_named_if_held_out_records_refuse_both():
    report = found(record("c", 3, sign=-1.0, magnitude=0.0, role="held_out"))
    assert report.verdict == Verdict.UNKNOWN
