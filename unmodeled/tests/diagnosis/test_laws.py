"""The evidence of a change in the coordinates of its law, the motions, and their figures."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pytest

from unmodeled import Effect, Options
from unmodeled.library import dry_friction, hysteresis, sensor_fault, viscous_friction
from unmodeled.models import Jobs
from unmodeled.pictures.curves import Axis, Law, Line, Points, thinned
from unmodeled.pictures.laws import law_of, laws
from unmodeled.pictures.motions import motions_of
from unmodeled.report.figures import answer, axis_unit, evidence, motion, raised
from unmodeled.search.fit import fit_sets
from unmodeled.search.linear import theta_at
from unmodeled.search.problem import Member, rms_of
from unmodeled.search.records import prepare, ready_records
from unmodeled.search.result import Change
from unmodeled.search.search import model_alone, search, start_from

from .conftest import spring_record
from .models import MASS, NOMINAL, record, records

FRICTION = 0.08  # N


def change_of(name, size, unit, half=0.1):
    """The change of an effect with an interval of this half width, as a share of its size."""
    ends = sorted(((1.0 - half) * size, (1.0 + half) * size))
    return Change(
        name=name, title=name, component="mass", kind="force", tier="named", unit=unit, size=size,
        low=ends[0], high=ends[1], tabulated=0.0, relative=False, user_unit=None,
        tolerances=math.nan, probability=1.0,
    )  # fmt: skip


def law(effect, runs, model=NOMINAL):
    """The evidence of an effect that is fitted alone, right or wrong."""
    problem = prepare(ready_records(model, runs), (effect,), (), Options())
    index = next(i for i, c in enumerate(problem.causes) if c.effect is effect)
    fitted = search(problem, Options()).sets[(index,)]
    size = effect.scale * fitted.point.x[len(problem.free)]
    change = change_of(effect.name, size, effect.unit)
    return law_of(problem, fitted, dataclasses.replace(change, subject=effect.about))


def leaves(law):
    """Mean distance of the points from the law, in their standard deviations."""
    line = law.lines[0]
    order = np.argsort(line.x, kind="stable")
    apart = [
        (p.y - np.interp(p.x, line.x[order], line.y[order])) / p.sd
        for p in law.points
    ]  # fmt: skip
    return float(np.sqrt(np.mean(np.concatenate(apart) ** 2)))


@pytest.fixture(scope="module")
def rubbing():
    return records(1, dry=FRICTION)


@pytest.fixture(scope="module")
def friction(rubbing):
    return law(dry_friction(MASS, scale=0.1, speed=0.3), rubbing)


def test_friction_is_shown_as_the_force_at_the_speeds_of_each_record(friction):
    assert (friction.kind, friction.x, friction.y) == (
        "law", Axis("speed", "m/s"), Axis("resisting force", "N")
    )  # fmt: skip
    assert [p.label for p in friction.points] == ["soft", "middle", "hard"]
    for p in friction.points:
        assert {*np.sign(p.x)} == {-1.0, 1.0}
        fast = np.abs(p.x) > 0.05
        assert np.abs(p.y - FRICTION * np.sign(p.x))[fast] == pytest.approx(0.0, abs=0.03)
    assert leaves(friction) < 2.0


def test_the_interval_of_a_law_is_that_of_its_size(friction):
    line = friction.lines[0]
    assert line.high[-1] == pytest.approx(1.1 * line.y[-1])
    assert line.low[-1] == pytest.approx(0.9 * line.y[-1])


def test_points_leave_a_wrong_law(rubbing, friction):
    """A damper that imitates the dry friction has a straight line, and the points have a step."""
    wrong = law(viscous_friction(MASS, scale=0.5), rubbing)
    assert leaves(wrong) > 3.0 * leaves(friction)
    line = wrong.lines[0]
    slow = [
        abs(y) for p in wrong.points for x, y, sd in zip(p.x, p.y, p.sd, strict=True)
        if abs(x) < 0.04 and sd < 0.02
    ]  # fmt: skip
    assert np.median(slow) > 1.5 * abs(np.interp(0.04, line.x, line.y))


def test_a_law_of_one_record_is_shown_beside_a_record_without_it():
    runs = [record("without", 1.0, 3), record("with", 1.0, 4, dry=FRICTION)]
    effect = dry_friction(MASS, scale=0.1, speed=0.3)
    problem = prepare(ready_records(NOMINAL, runs), (effect,), (), Options())
    index = next(i for i, c in enumerate(problem.causes)
                 if c.effect is effect and c.scope.records == ("with",))  # fmt: skip
    fitted = fit_sets(problem, [start_from(problem, (Member(index, effect.shapes[0]),),
                                           model_alone(problem))])[0]  # fmt: skip
    change = change_of(problem.causes[index].name, FRICTION, "N")
    found = law_of(problem, fitted, dataclasses.replace(change, subject=effect.about))
    rest, own = found.points
    assert [p.label for p in found.points] == ["without", "with"]
    assert np.median(np.abs(rest.y)) < 0.3 * FRICTION
    assert np.median(np.abs(own.y)) == pytest.approx(FRICTION, rel=0.2)
    assert np.abs(found.lines[0].y).max() == pytest.approx(FRICTION, rel=0.2)


def test_hysteresis_is_a_loop_over_the_travel():
    """Dry friction has two branches there, one in each direction."""
    runs = [record("middle", 1.0, 4, dry=FRICTION, samples=300)]
    loop = law(hysteresis(MASS, scale=0.1, travel=0.03), runs)
    assert (loop.kind, loop.x) == ("loop", Axis("position", "m"))
    for p in loop.points:
        way = 1.0 if p.label.endswith("rising") else -1.0
        assert np.median(p.y) == pytest.approx(way * FRICTION, rel=0.4)


def test_a_saturation_is_shown_as_reading_against_truth():
    level = 0.02
    runs = [
        dataclasses.replace(r, outputs={"q": np.minimum(r.outputs["q"], level)})
        for r in records(1)[1:]
    ]
    fault = sensor_fault(("q",), "q", "saturation", record=runs[1])
    found = law(fault, runs)
    assert (found.x, found.y) == (Axis("true q", "m"), Axis("reading", "m"))
    for p in found.points:
        assert p.y == pytest.approx(np.minimum(p.x, level), abs=2e-3)
        assert p.x.max() > 1.2 * level


def test_a_late_sensor_is_shown_over_time_with_and_without():
    late = 0.02
    runs = [
        dataclasses.replace(r, outputs={"q": np.interp(r.time - late, r.time, r.outputs["q"])})
        for r in records(1)[:2]
    ]
    found = law(sensor_fault(("q",), "q", "delay", record=runs[0]), runs)
    without, own = found.lines
    assert (found.kind, without.label, own.label) == ("step", "without", "with")
    (cloud,) = found.points
    apart = [np.std(cloud.y - np.interp(cloud.x, x.x, x.y)) for x in (without, own)]
    assert apart[1] < 0.1 * apart[0]


def test_a_part_of_a_measured_force_is_shown_against_its_input(spring):
    runs = [spring_record(n, c, hardening=800.0) for n, c in (("a", 2), ("b", 5))]
    cubic = Effect(
        name="hardening", component="spring", unit="N/m^3", scale=1000.0,
        regressor=lambda r, _: r.inputs["x"] ** 3,
    )  # fmt: skip
    found = law(cubic, runs, spring)
    assert (found.x.label, found.y) == ("x", Axis("force", "N"))
    for p in found.points:
        assert p.y == pytest.approx(800.0 * p.x**3, abs=0.3)


def test_a_parameter_is_shown_by_its_likelihood_and_in_each_record(rubbing):
    problem = prepare(ready_records(NOMINAL, records(1)), (), (), Options())
    alone = model_alone(problem)
    k = [p.name for p in NOMINAL.parameters].index("k")
    moved = float(problem.unit[k] * alone.point.x[k])
    one = dataclasses.replace(
        change_of("k", moved, "N/m"), kind="parameter", tabulated=100.0, low=moved - 0.2,
        high=moved + 0.2,
    )  # fmt: skip
    found = law_of(problem, alone, one)
    curve, as_it_is = found.lines
    assert found.kind == "likelihood"
    assert curve.x[np.argmax(curve.y)] == pytest.approx(96.0, abs=0.3)
    assert as_it_is.x[0] == 100.0
    for p in found.points:
        assert p.x[0] == pytest.approx(96.0, abs=5.0 * p.sd[0] + 0.1)


def test_an_equivalent_that_the_set_has_stands_for_a_change(moved):
    problem, best, _ = moved
    other = dataclasses.replace(
        change_of("viscous friction mass", 1.0, "N s/m"),
        equivalents=(change_of("dry friction mass", 0.08, "N"),),
    )
    assert [x.name for x in laws(problem, best, [other])] == ["dry friction mass"]
    found = motions_of(problem, best, best, [other])
    assert found.changes == found.labels == ("dry friction mass",)


def test_an_error_of_each_record_is_shown_by_record():
    one = dataclasses.replace(
        change_of("offset in each record", 2.0, "m"), by_record=(1.0, 2.6), records=("a", "b")
    )
    problem = prepare(ready_records(NOMINAL, records(1)), (), (), Options())
    found = law_of(problem, model_alone(problem), one)
    assert [(p.label, *p.y) for p in found.points] == [("a", 1.0), ("b", 2.6)]


@pytest.fixture(scope="module")
def moved(rubbing):
    effect = dry_friction(MASS, scale=0.1, speed=0.3)
    problem = prepare(ready_records(NOMINAL, rubbing), (effect,), (), Options())
    sets = search(problem, Options()).sets
    best = sets[next((i,) for i, c in enumerate(problem.causes) if c.effect is effect)]
    changes = [change_of(effect.name, 0.08, "N"), change_of("k", -4.0, "N/m")]
    return problem, best, motions_of(problem, sets[()], best, changes, {"hard"})


def test_motions_are_measured_as_it_is_and_with_the_changes(moved):
    problem, _, found = moved
    assert [(m.record, m.channel, m.unit, m.held_out) for m in found.whole] == [
        ("soft", "q", "m", False), ("middle", "q", "m", False), ("hard", "q", "m", True)
    ]  # fmt: skip
    for m, o in zip(found.whole, problem.fit, strict=True):
        measured = np.interp(m.time, o.record.time, o.record.outputs["q"])
        assert m.measured == pytest.approx(measured, abs=1e-12)
        before, after = (np.std(m.measured - x) for x in (m.tabulated, m.changed))
        assert after < 0.1 * before
        assert after < 3e-4  # the noise is 1e-4
    # The part belongs to the record in which the changes take away most.
    gains = {m.record: np.mean((m.measured - m.tabulated) ** 2) for m in found.whole}
    assert found.chosen.record == max(gains, key=gains.__getitem__)


def test_all_subsets_of_the_changes_are_simulated_at_their_sizes(moved):
    problem, best, found = moved
    assert found.changes == ("dry friction mass", "k")
    by_kept = {a.kept: a for a in found.alternatives}
    assert {*by_kept} == {(True, True), (True, False), (False, True), (False, False)}
    for curve, m in zip(by_kept[True, True].curves, (found.chosen, *found.whole), strict=True):
        assert curve == pytest.approx(m.changed, abs=1e-9)
    both, no_friction = by_kept[True, True].left["q"], by_kept[False, True].left["q"]
    assert both == pytest.approx(rms_of(problem.fit, best.residuals)[0])
    # Without the friction, but with the other numbers of the answer: an independent simulation.
    theta = theta_at(problem, best.point.x)
    local = zip(problem.fit[0].local, best.point.local[0], strict=True)
    start = np.array([[q.mean + q.scale * v for q, v in local if q.kind == "start"]])
    jobs = Jobs(theta=theta[None], starts=start)
    alone = problem.model.simulate(problem.fit[0].record, jobs)[0, :, 0]
    shown = np.interp(found.whole[0].time, problem.fit[0].record.time, alone)
    assert by_kept[False, True].curves[1] == pytest.approx(shown, abs=1e-4)
    assert no_friction > 20.0 * both


def test_few_points_keep_the_extremes():
    y = np.random.default_rng(0).standard_normal(20_000)
    z = np.sin(np.arange(20_000) / 300.0)
    y[7_777] = 9.0
    kept = thinned([y, z])
    assert len(kept) <= 600
    assert y[kept].max() == 9.0
    assert z[kept].min() == z.min()
    assert [*thinned([y[:50]])] == [*range(50)]


@pytest.mark.parametrize(
    ("most", "unit", "factor", "name"),
    [
        (2e-5, "m", 1e6, "\N{MICRO SIGN}m"),
        (2e-4, "m", 1e3, "mm"),
        (4e-5, "N", 1e6, "\N{MICRO SIGN}N"),
        (3e4, "N m/rad", 1e-3, "kN m/rad"),
        (0.02, "rad/s^2", 1e3, "mrad/s^2"),
        (3e-7, "1", 1e9, "10\N{SUPERSCRIPT MINUS}\N{SUPERSCRIPT NINE}"),
        (1e-4, "1/s", 1e6, "10\N{SUPERSCRIPT MINUS}\N{SUPERSCRIPT SIX} 1/s"),
        (2.0, "N", 1.0, "N"),
        (1.8e3, "s", 1.0 / 60.0, "min"),
        (90_000.0, "s", 1.0 / 3600.0, "h"),
        (0.0, "N", 1.0, "N"),
    ],
)
def test_axes_have_units_with_few_digits(most, unit, factor, name):
    assert axis_unit(np.array([0.0, -most, math.nan]), unit=unit) == (
        pytest.approx(factor), name
    )  # fmt: skip


def test_powers_of_units_are_raised():
    two, minus = "\N{SUPERSCRIPT TWO}", "\N{SUPERSCRIPT MINUS}"
    assert raised("degC s") == "\N{DEGREE SIGN}C s"
    assert raised("N s^2/m^-2") == f"N s{two}/m{minus}{two}"


def test_figures_have_units_on_their_axes_and_no_powers_of_ten(moved, friction):
    small = [Line("law", *(1e-6 * np.arange(3.0),) * 4)]
    tiny = Law("a", "a $b$", "law", Axis("x", "m"), Axis("y", "N"), (), tuple(small))
    bars = Law("c", "c", "records", Axis("record", ""), Axis("offset", "m"),
               (Points("one", *(np.ones(1),) * 3),), ())  # fmt: skip
    for figure in (evidence([friction, tiny, bars]), motion(moved[2])):
        figure.draw_without_rendering()
        for ax in figure.axes:
            if not ax.get_visible():
                continue
            assert not ax.xaxis.get_offset_text().get_text()
            assert not ax.yaxis.get_offset_text().get_text()
            assert "[" in ax.get_ylabel()
            assert len(ax.get_ylabel().partition(" [")[0].split()) <= 3
            assert ax.get_legend() is None


def test_the_values_on_the_axis_of_a_likelihood_do_not_touch():
    grid = np.linspace(0.0486, 0.0634, 401)
    bell = np.exp(-0.5 * ((grid - 0.056) / 2e-5) ** 2)
    lines = (Line("likelihood", grid, *(bell,) * 3), Line("as it is", *(np.full(1, 0.05),) * 4))
    one = Law("r", "r", "likelihood", Axis("value", "ohm"), Axis("likelihood", "1"), (), lines)
    figure = answer(None, [one] * 3)
    figure.draw_without_rendering()
    for ax in figure.axes:
        seen = [x.get_window_extent() for x in ax.get_xticklabels() if ax.get_visible()]
        seen = sorted((box for box in seen if box.width), key=lambda box: box.x0)
        assert all(a.x1 + 2.0 < b.x0 for a, b in itertools.pairwise(seen))
