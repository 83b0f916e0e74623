"""The fewest parameters that explain a fit, and what is left without a change."""

import math
from dataclasses import replace

import numpy as np
import pytest

from unmodeled import Effect, Parameter, Record, Sensor, Verdict, diagnose
from unmodeled.fit import LinearModel
from unmodeled.search import changes
from unmodeled.search.changes import _Fits, smallest
from unmodeled.search.progress import Stop

from .conftest import spring_record


def posterior(columns, truth, noise=0.1, seed=0):
    """Estimates and covariance of a linear fit with standard normal priors."""
    measured = columns @ truth + noise * np.random.default_rng(seed).normal(size=len(columns))
    covariance = np.linalg.inv(columns.T @ columns / noise**2 + np.eye(columns.shape[1]))
    return covariance @ columns.T @ measured / noise**2, covariance


@pytest.mark.parametrize("changed", [{}, {3: 1.5}, {3: 1.5, 8: -2.0}])
def test_the_fewest_unknowns_are_those_that_changed(changed):
    columns = np.random.default_rng(1).normal(size=(60, 10))
    columns += 3.0 * columns[:, :1]  # all of them act alike: the fit spreads a change over them
    truth = np.array([changed.get(k, 0.0) for k in range(10)])
    found = smallest(*posterior(columns, truth), range(10), 0.9)
    assert {group[0] for group in found} == set(changed)
    assert all(len(group) == 1 for group in found)


def test_parallel_unknowns_are_equivalents():
    columns = np.random.default_rng(1).normal(size=(60, 6))
    columns[:, 5] = columns[:, 2]
    (group,) = smallest(*posterior(columns, np.eye(6)[2]), range(6), 0.9)
    assert sorted(group) == [2, 5]


def test_all_unknowns_may_have_changed():
    columns = np.random.default_rng(1).normal(size=(60, 2))
    found = smallest(*posterior(columns, np.array([1.0, -2.0])), range(2), 0.9)
    assert sorted(found) == [[0], [1]]
    (only,) = smallest(*posterior(columns[:, :1], np.array([1.0])), range(1), 0.9)
    assert only == [0]


def test_an_unknown_that_must_stay_is_no_answer():
    columns = np.random.default_rng(1).normal(size=(60, 6))
    assert smallest(*posterior(columns, 2.0 * np.eye(6)[2]), [0, 1, 3, 4, 5], 0.9) == []


def machine(twice=False, **truth):
    """y = a u + b u^2 + c u^3; the records have other numbers; ``twice``: d does what a does."""
    names = ["a", "b", "c", "d"] if twice else ["a", "b", "c"]
    powers = {"a": 1, "b": 2, "c": 3, "d": 1}
    values = dict.fromkeys(names, 1.0)

    parameters = [Parameter(name=n, value=v, sd=0.1, label=f"The {n}") for n, v in values.items()]
    columns = {n: lambda r, power=powers[n]: r.inputs["u"] ** power for n in names}
    model = LinearModel(output="y", columns=columns, parameters=parameters)
    rng, records = np.random.default_rng(3), []
    for k in range(4):
        u = np.sin(np.linspace(0.0, 6.0 + k, 200))
        y = sum((values | truth)[n] * u ** powers[n] for n in names)
        records.append(
            Record(
                name=f"r{k}",
                time=np.linspace(0.0, 1.0, 200),
                inputs={"u": u},
                outputs={"y": y + 0.01 * rng.normal(size=200)},
                sensors={"y": Sensor(name="y", sigma=0.01)},
            )
        )
    return model, records


def constant(records, size=0.3):
    """The records of a machine with a constant, and the effect that is one."""
    more = Effect(name="more", component="c", regressor=lambda r, _: np.ones(r.time.size))
    return [replace(r, outputs={"y": r.outputs["y"] + size}) for r in records], more


def test_a_parameter_within_its_tolerance_is_the_answer():
    model, records = machine(b=1.15)
    report = diagnose(model, [], records, hold_out=["r3"])
    assert report.verdict is Verdict.CALIBRATED
    (change,) = report.changes
    assert (change.name, change.tier, change.within, change.held_out) == ("b", "fitted", True, True)
    assert change.low < 0.15 < change.high
    # Without it, 0.15 u^2 is missing; a and c cannot stand for it.
    u = records[3].inputs["u"]
    motion = np.std(np.concatenate([r.outputs["y"] for r in records[:3]]))
    assert change.takes == pytest.approx(0.15 * np.sqrt(np.mean(u**4)) / motion, rel=0.1)


def test_equivalent_parameters_are_one_change():
    model, records = machine(twice=True, a=1.15)
    report = diagnose(model, [], records, hold_out=())
    (change,) = report.changes
    assert {change.name, *(e.name for e in change.equivalents)} == {"a", "d"}
    assert change.size == pytest.approx(0.15, abs=0.01)


def test_nothing_changed_nothing_is_listed():
    model, records = machine()
    report = diagnose(model, [], records, hold_out=["r3"])
    assert report.changes == ()
    assert report.changed == ()
    assert report.summary().startswith("No cause is missing: ")


def test_a_cause_that_takes_nothing_away_is_not_listed():
    model, records = machine(b=1.15)
    slope = Effect(name="more", component="c", regressor=lambda r, _: r.inputs["u"] ** 4)
    report = diagnose(model, [slope], records, hold_out=["r3"])
    assert [c.name for c in report.changes] == ["b"]


def test_all_changes_of_a_kind_leave_the_same():
    """Effects are taken out of the set, parameters out of a fit of the listed ones alone."""
    model, records = machine(a=0.8, b=1.2)
    records, more = constant(records)
    nothing = Effect(name="nothing", component="c", regressor=lambda r, _: np.cos(40.0 * r.time))
    report = diagnose(model, [nothing, more], records, hold_out=["r3"])
    found = {c.name: c for c in report.changes}
    assert {c.name: c.tier for c in report.changes} == {
        "more": "named",
        "a": "fitted",
        "b": "fitted",
    }
    assert all(c.held_out for c in report.changes)
    assert found["a"].after == found["b"].after
    (c,) = report.channels
    assert found["more"].after == pytest.approx(c.share(c.held_out_explained), rel=1e-9)


def test_what_the_model_does_not_allow_comes_before_parameters_within_their_tolerances():
    model, records = machine(a=0.85, b=1.2)
    records, more = constant(records, 0.05)
    report = diagnose(model, [more], records, hold_out=["r3"])
    effect, *others = report.changes
    assert [effect.name, *sorted(c.name for c in others)] == ["more", "a", "b"]
    assert all(c.within and c.takes > effect.takes for c in others)
    assert "and 1 more parameter differs within its tolerance: with all 3" in report.summary()


def test_without_a_single_cause_the_calibrated_model_remains():
    """b takes up a part of a constant; what it can take up is not taken away by the constant."""
    model, records = machine()
    records, more = constant(records)
    report = diagnose(model, [more], records, hold_out=["r3"])
    (change,) = report.changes
    (c,) = report.channels
    assert change.before == pytest.approx(c.share(c.held_out_calibrated), rel=1e-9)
    assert change.after == pytest.approx(c.share(c.held_out_explained), rel=1e-9)
    assert change.before * c.motion < 0.25  # all of it would be 0.3


def test_without_one_of_two_causes_least_squares_of_the_rest_remain():
    model, records = machine()
    waves = [
        Effect(name=name, component="c", regressor=lambda r, _, w=w: np.cos(w * r.time))
        for name, w in (("slow", 9.0), ("fast", 40.0))
    ]
    records = [
        replace(r, outputs={"y": r.outputs["y"] + sum(0.2 * e.regressor(r, None) for e in waves)})
        for r in records
    ]
    found = {c.name: c for c in diagnose(model, waves, records, hold_out=()).changes}
    assert set(found) == {"slow", "fast"}
    y = np.concatenate([r.outputs["y"] for r in records])
    motion = np.sqrt(np.mean([np.var(r.outputs["y"]) for r in records]))
    u = np.concatenate([r.inputs["u"] for r in records])
    for lost, kept in (("slow", waves[1]), ("fast", waves[0])):
        wave = np.concatenate([kept.regressor(r, None) for r in records])
        columns = np.column_stack([u, u**2, u**3, wave])
        left = y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0]
        assert found[lost].before * motion == pytest.approx(np.sqrt(np.mean(left**2)), rel=1e-3)


def test_an_effect_is_listed_also_if_parameters_can_imitate_it():
    """Without it, fitted parameters leave little; it is listed by what the model misses of it."""
    model, records = machine()
    fifth = Effect(name="more", component="c", regressor=lambda r, _: r.inputs["u"] ** 5)
    records = [
        replace(r, outputs={"y": r.outputs["y"] + 0.1 * r.inputs["u"] ** 5}) for r in records
    ]
    report = diagnose(model, [fifth], records, hold_out=["r3"])
    (change,), (c,) = report.changes, report.channels
    assert change.before == pytest.approx(c.share(c.held_out_calibrated), rel=1e-9)
    assert change.before < 0.01
    missed = np.sqrt(np.mean((0.1 * records[3].inputs["u"] ** 5) ** 2))
    assert change.takes * c.motion == pytest.approx(missed, rel=0.02)


def test_without_a_parameter_no_other_one_stands_for_it():
    """c could replace most of a; the answer is that a has changed, and c has not."""
    model, records = machine(a=1.2)
    report = diagnose(model, [], records, hold_out=["r3"])
    (change,) = report.changes
    left = np.sqrt(np.mean((0.2 * records[3].inputs["u"]) ** 2) + 0.01**2)
    assert change.name == "a"
    assert change.before * report.channels[0].motion == pytest.approx(left, rel=0.01)
    assert "; with the listed parameters alone, in held-out records, " in " ".join(
        report.text().split()
    )


def test_what_acts_in_the_held_out_records_only_is_told():
    model, records = machine()
    (late,), _ = constant(records[3:])
    report = diagnose(model, [], [*records[:3], late], hold_out=["r3"])
    (c,) = report.channels
    assert c.fitted_explained == pytest.approx(0.01, rel=0.1)
    told = f"{100.0 * c.share(c.held_out_explained):.2g} % of y remains in the held-out records, "
    told += f"and {100.0 * c.share(c.fitted_explained):.2g} % in the fitted ones: something acts in"
    assert told in report.text(300)


@pytest.mark.parametrize(("step", "listed"), [("without_listed", ["a", "b"]), ("alike", [])])
def test_at_the_limit_of_time_all_parameters_are_told_or_none(monkeypatch, step, listed):
    """A part of the parameters does not explain the fit."""
    calls = []

    def limited(self, *given, **options):
        calls.append(1)
        if len(calls) > 1:
            raise Stop
        return own(self, *given, **options)

    own = getattr(changes._Fits, step)
    monkeypatch.setattr(changes._Fits, step, limited)
    model, records = machine(a=0.85, b=1.2)
    report = diagnose(model, [], records, hold_out=["r3"])
    assert sorted(c.name for c in report.changes) == listed
    assert report.complete is bool(listed)
    assert listed or report.summary().startswith("No cause was found before the search ended")
    assert all(math.isnan(c.takes) for c in report.changes)


def test_a_change_is_told_where_it_is_seen_best():
    """In a channel of noise, the share that a change takes away is one of chance."""
    model, records = machine(b=1.15)
    report = diagnose(model, [], records, hold_out=["r3"])
    (c,), (left,) = report.channels, report.without
    noise = replace(c, name="noise", motion=1.0, noise=0.4, good_enough=0.01)
    there = replace(left, before=(*left.before, 0.5), after=(*left.after, 0.4), held_out=None)
    (change,) = replace(report, channels=(c, noise), without=(there,)).changes
    assert change.channel == "y"


def test_of_two_parameters_that_replace_each_other_one_is_told(monkeypatch):
    """The prior prefers a part of each; without one of them, nothing that matters is missing."""
    _, records = machine(a=2.0)
    columns = {
        "a": lambda r: r.inputs["u"],
        "d": lambda r: r.inputs["u"] + 0.011 * np.cos(40.0 * r.time),
        "b": lambda r: r.inputs["u"] ** 2,
        "c": lambda r: r.inputs["u"] ** 3,
    }
    values = {"a": 1.0, "b": 1.0, "c": 1.0, "d": 0.0}
    parameters = [Parameter(name=n, value=v, sd=0.1) for n, v in values.items()]
    model = LinearModel(output="y", columns=columns, parameters=parameters)
    monkeypatch.setattr("unmodeled.search.search._climb", lambda *_: None)  # no cause is named
    report = diagnose(model, [], records, hold_out=["r3"])
    (change,) = report.changes
    assert change.name == "a"
    assert change.size == pytest.approx(1.0, abs=0.02)


def test_an_effect_is_counted_before_parameters_are_dropped(spring, causes, monkeypatch):
    """Else it could take up what they did, and would seem to matter."""
    order = []
    for name in ("without_causes", "drop"):
        real = getattr(_Fits, name)
        monkeypatch.setattr(
            _Fits, name, lambda *a, real=real, name=name: [order.append(name), real(*a)][1]
        )
    records = [spring_record(f"r{k}", 2 + k, seed=k, hardening=3000.0) for k in range(3)]
    assert diagnose(spring, causes, records).changes
    assert order == ["without_causes", "drop"]
