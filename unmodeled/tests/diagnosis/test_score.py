"""First-order scores of a linear model against least squares."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from unmodeled import Effect, LinearModel, Parameter, Sensor
from unmodeled.search.fit import Start, empty_point, fit_sets
from unmodeled.search.linear import EvaluationRequest, evaluate
from unmodeled.search.options import Options
from unmodeled.search.problem import Member
from unmodeled.search.records import prepare, ready_records
from unmodeled.search.score import ALIKE, by_record, directions, equivalents, pairs, scores
from unmodeled.search.search import start_from

from .conftest import SIGMA, spring_record


def law(name, power, scale, **what):
    return Effect(
        name=name,
        component="spring",
        unit=f"N/m^{power}",
        scale=scale,
        regressor=lambda r, _: r.inputs["x"] ** power,
        **what,
    )


CUBIC, EVEN, FIFTH = law("cubic", 3, 1e3), law("even", 2, 1e2), law("fifth", 5, 1e5)
WRONG_SIGN = law("one-sided", 3, 1e3, sign=-1)


def fitted(effects, *members, records=None, sd=10.0):
    """A set of effects, by name, fitted to springs; the problem, and its causes by name."""
    model = LinearModel(
        name="spring",
        output="force",
        columns={"k": lambda r: r.inputs["x"]},
        parameters=[Parameter(name="k", value=95.0, sd=sd, unit="N/m")],
    )
    records = records or [spring_record("fit", 2, hardening=2000.0, preload=0.0, seed=5)]
    problem = prepare(ready_records(model, records), effects, (), Options())
    at = {c.name: i for i, c in enumerate(problem.causes)}
    own = tuple(sorted((Member(at[n]) for n in members), key=lambda m: m.cause))
    (found,) = fit_sets(problem, [Start(own, (empty_point(problem, own, problem.fit),))])
    return problem, found, at


def left(record, *powers):
    """Residual squares of least squares by a slope and powers, and their coefficients."""
    x = record.inputs["x"]
    columns = np.column_stack([x, *(x**p for p in powers)])
    size, *_ = np.linalg.lstsq(columns, record.outputs["force"], rcond=None)
    return float(((record.outputs["force"] - columns @ size) ** 2).sum()), size[1:]


def test_the_score_of_a_cause_is_what_least_squares_gains():
    problem, alone, at = fitted([CUBIC, EVEN], sd=1e3)
    seen = {s.cause: s for s in scores(problem, alone, directions(problem, alone))}
    (record,) = (o.record for o in problem.fit)
    base, _ = left(record)
    for effect, power in ((CUBIC, 3), (EVEN, 2)):
        after, size = left(record, power)
        gain = 0.5 * (base - after) / (SIGMA * alone.noise[0]) ** 2
        found = seen[at[effect.name]]
        assert found.gain == pytest.approx(gain, rel=0.02, abs=0.02)
        assert found.step * effect.scale == pytest.approx(size[0], rel=0.02)


def test_a_slope_of_the_wrong_sign_excludes_no_cause_but_begins_at_its_size():
    problem, alone, at = fitted([CUBIC, WRONG_SIGN])
    seen = {s.cause: s for s in scores(problem, alone, directions(problem, alone))}
    right, wrong = seen[at["cubic"]], seen[at["one-sided"]]
    assert wrong.gain == pytest.approx(right.gain)
    assert right.columns
    assert right.step > 0.0
    assert wrong.columns == ()
    assert wrong.step == 0.0  # the permitted value that is nearest to one expected magnitude


def test_a_pair_is_scored_as_by_orthogonal_least_squares():
    """Two laws that take away all but the noise together."""
    record = spring_record("fit", 2, seed=5)
    x = record.inputs["x"]
    force = record.outputs["force"] + 1e3 * x**3 + 60.0 * x**2
    record = replace(record, outputs={"force": force})
    problem, alone, at = fitted([CUBIC, EVEN, FIFTH], records=[record], sd=1e3)
    seen = directions(problem, alone)
    ranked = scores(problem, alone, seen)
    (first, *_) = pairs(problem, alone, seen, ranked)
    gains = {}
    for one, other in ((3, 5), (2, 3), (2, 5)):
        after, size = left(record, one, other)
        gains[after] = {one: size[0], other: size[1]}
    best = gains[min(gains)]
    names = {at["even"]: 2, at["cubic"]: 3, at["fifth"]: 5}
    assert {names[s.cause] for s in first} == {*best}
    for s in first:
        scale = problem.causes[s.cause].effect.scale
        assert s.step * scale == pytest.approx(best[names[s.cause]], rel=0.05)
        assert s.columns == ()


def test_a_pair_is_tried_only_if_it_halves_what_one_cause_leaves():
    records = [spring_record("fit", 2, hardening=2000.0, foreign=1.0, seed=5)]
    problem, alone, _ = fitted([CUBIC, EVEN, FIFTH], records=records)
    seen = directions(problem, alone)
    assert pairs(problem, alone, seen, scores(problem, alone, seen)) == []


def test_equivalents_have_a_parallel_column():
    gain = Effect(
        name="gain", component="spring", unit="1", scale=1.0,
        regressor=lambda r, _: 50.0 * r.inputs["x"] ** 3 + 1e-3 * r.inputs["x"] ** 2,
    )  # fmt: skip
    problem, both, at = fitted([CUBIC, EVEN, gain], "cubic")
    seen = directions(problem, both)
    (found,) = equivalents(problem, both, seen, at["cubic"])
    score, cosine = found
    assert score.cause == at["gain"]
    assert ALIKE < cosine <= 1.0
    size = 1e3 * both.point.x[1]
    assert 50.0 * score.step == pytest.approx(size, rel=0.02)


def test_the_size_in_each_record_is_that_of_the_record():
    records = [
        spring_record(f"r{k}", 2 + k, hardening=size, seed=k)
        for k, size in enumerate((1000.0, 2000.0, 3000.0))
    ]
    problem, one, _ = fitted([CUBIC, EVEN], "cubic", records=records)
    values, covariance = by_record(problem, one, 1)
    sd = np.sqrt(np.diag(covariance))
    assert values[1] - values[0] == pytest.approx(1.0, abs=4.0 * sd[0])
    assert values[2] - values[1] == pytest.approx(1.0, abs=4.0 * sd[0])
    assert np.all(sd < 0.4)
    assert np.all(np.linalg.eigvalsh(covariance) > 0.0)


def test_a_larger_set_begins_with_the_derivatives_that_are_known():
    """Those of the smaller set and of the score are those of the larger set, without a run."""
    problem, alone, at = fitted([CUBIC, EVEN, WRONG_SIGN], sd=1e3)
    seen = {s.cause: s for s in scores(problem, alone, directions(problem, alone))}
    members = (Member(at["even"]),)
    start = start_from(problem, members, alone, (seen[at["even"]],))
    (point, *_) = start.points
    assert point.x == pytest.approx([alone.point.x[0], 0.0])
    (known,) = start.known
    (exact,) = evaluate(problem, [EvaluationRequest(members, point, problem.fit)])[0]
    assert known.residual == pytest.approx(exact.residual)
    assert known.by_global == pytest.approx(exact.by_global, rel=1e-5, abs=1e-9)
    # A magnitude of the wrong sign has no derivative, and a large one begins at its size.
    wrong = seen[at["one-sided"]]
    assert start_from(problem, (Member(at["one-sided"]),), alone, (wrong,)).known == ()
    far = replace(seen[at["even"]], step=3.0)
    start = start_from(problem, members, alone, (far,))
    assert start.known == ()
    assert start.points[0].x[1] == 3.0
    # A released parameter adds no unknown, so that the derivatives stay.
    released = start_from(problem, (Member(at["k"]),), alone, (seen[at["k"]],))
    assert released.known[0].by_global == pytest.approx(alone.linears[0].by_global)


def test_a_model_that_is_far_off_is_also_left_from_the_tabulated_parameters():
    records = [spring_record("fit", 2, foreign=8.0, seed=5)]
    problem, alone, at = fitted([CUBIC, EVEN], records=records)
    poor = replace(alone)
    poor.__dict__["effective"] = 0.1
    score = next(s for s in scores(problem, alone, directions(problem, alone))
                 if s.cause == at["cubic"])  # fmt: skip
    points = start_from(problem, (Member(at["cubic"]),), poor, (score,)).points
    assert [p.x[0] for p in points] == pytest.approx([alone.point.x[0], 0.0])
    assert abs(points[1].x[1]) == 1.0
    poor.__dict__["effective"] = 0.9
    assert len(start_from(problem, (Member(at["cubic"]),), poor, (score,)).points) == 1


def test_the_score_of_an_error_of_each_record_has_the_prior_of_its_size():
    """Offsets of two records by least squares with a standard normal prior, all else fixed."""
    records = [
        replace(
            spring_record(n, 2, preload=p),
            sensors={"force": Sensor(name="force", unit="N", sigma=2.0)},
        )
        for n, p in (("a", 1.0), ("b", -1.0))
    ]
    problem, found, at = fitted((), records=records)
    (cause,) = [i for n, i in at.items() if n.startswith("offset")]
    scale, gain = problem.causes[cause].local.scale, 0.0
    for o, linear in zip(problem.fit, found.linears, strict=True):
        residual = linear.residual[:, 0] / found.noise[0]
        column = np.full(residual.size, scale / o.sd[0, 0] / found.noise[0])
        gain += 0.5 * (column @ residual) ** 2 / (column @ column + 1.0)
        assert column @ column < 30.0  # the prior matters
    seen = directions(problem, found)
    (score,) = [s for s in scores(problem, found, seen) if s.cause == cause]
    assert score.gain == pytest.approx(gain, rel=1e-6)
