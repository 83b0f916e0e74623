"""Tempered fits: closed forms of a linear model, and an effect that a parameter has taken up."""

from dataclasses import replace

import numpy as np
import pytest

from feltmb.data import Record, Sensor
from feltmb.fit import Candidate, Effect, Parameter
from feltmb.fit.linear import LinearModel
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import Noise, segment_record
from feltmb.fit.solve import FitSettings, finish, fit_problem, polish
from feltmb.gap import Exposed, SimulatorModel, refine
from feltmb.gap.score import all_candidates, score_fit
from feltmb.gap.search import search

SETTINGS = FitSettings(decrement=1e-10)
X = np.linspace(-1.0, 1.0, 101)


def problem_of(model, time, y, sigma, **inputs):
    """A record of one output with white noise of a known size, and the model."""
    record = Record(
        name="run",
        time=time,
        inputs=inputs,
        outputs={"y": y},
        sensors={"y": Sensor(name="y", unit=model.units.get("y", ""), sigma=sigma)},
    )
    return Problem(model, (segment_record(model, record, {"y": Noise(sigma)}, None),))


def line(x, y, sigma, *, sd=0.2):
    """A straight line through data; the slope is 1 with this prior."""
    model = LinearModel(
        output="y",
        columns={"slope": lambda r: r.inputs["x"]},
        parameters=[Parameter(name="slope", value=1.0, sd=sd)],
        name="line",
    )
    return problem_of(model, np.arange(x.size) * 0.01, y, sigma, x=x)


def cubic_line(**prior):
    """A line fitted to a cubic with noise of 0.01, the cubic as a candidate, and the data."""
    y = 1.3 * X + 0.1 * X**3 + 0.01 * np.random.default_rng(1).standard_normal(X.size)
    cubic = Effect(name="cubic", component="spring", scale=0.1, regressor=lambda _r, _s: X**3)
    return fit_problem(line(X, y, 0.01, **prior), SETTINGS), Candidate(cubic, cubic.shapes[0]), y


def test_a_tempered_fit_is_that_to_records_with_more_noise():
    fit, _, y = cubic_line()
    mild = refine.tempered(fit, SETTINGS)
    sigma = 0.01 * refine.TEMPERED[0]
    slope = 1.0 + (X @ (y - X)) / (X @ X + (sigma / 0.2) ** 2)
    assert mild.point.theta[0] == pytest.approx(slope, rel=1e-9)
    assert abs(slope - fit.point.theta[0]) > 1e-3  # the noise matters
    own = np.sum(((y - slope * X) / 0.01) ** 2) + ((slope - 1.0) / 0.2) ** 2
    assert mild.cost == pytest.approx(own, rel=1e-9)


def test_scores_of_a_linear_model_are_those_of_the_fit():
    fit, cubic, _ = cubic_line()
    mild = refine.tempered(fit, SETTINGS)
    at, there = score_fit(fit, (cubic,)), score_fit(mild, (cubic,))
    assert there.singles() == pytest.approx(at.singles(), rel=1e-8)
    assert there.one_step() == pytest.approx(at.one_step(), rel=1e-8)


def test_an_annealed_effect_ends_at_the_minimum():
    fit, cubic, y = cubic_line()
    mild = refine.tempered(fit, SETTINGS)
    annealed = refine.annealed(mild, (cubic,), np.zeros(1), SETTINGS)
    columns = np.vstack([np.stack([X, X**3], axis=1) / 0.01, [[1.0 / 0.2, 0.0]]])
    right = np.append(y / 0.01, 1.0 / 0.2)
    slope, size = np.linalg.lstsq(columns, right, rcond=None)[0]
    assert annealed.point.theta[0] == pytest.approx(slope, rel=1e-8)
    assert annealed.point.magnitudes[0] == pytest.approx(size, rel=1e-8)
    assert annealed.converged


def test_an_exchanged_effect_that_reaches_what_its_start_promises_is_not_repeated(monkeypatch):
    fit, cubic, y = cubic_line()
    quintic = Effect(name="quintic", component="spring", scale=0.1, regressor=lambda _r, _s: X**5)
    base = refine.refit(fit, (cubic,), np.array([0.1]), SETTINGS)

    def never(*_, **__):
        raise AssertionError("fitted from its priors")

    monkeypatch.setattr(refine, "fit_problem", never)
    other = refine.refit(base, (Candidate(quintic, quintic.shapes[0]),), np.array([0.1]), SETTINGS)
    columns = np.vstack([np.stack([X, X**5], axis=1) / 0.01, [[1.0 / 0.2, 0.0]]])
    right = np.append(y / 0.01, 1.0 / 0.2)
    slope, size = np.linalg.lstsq(columns, right, rcond=None)[0]
    assert other.cost > base.cost  # although it is worse than the effect that it replaces
    assert other.point.theta[0] == pytest.approx(slope, rel=1e-8)
    assert other.point.magnitudes[0] == pytest.approx(size, rel=1e-8)


def test_without_a_prior_there_is_nothing_to_temper():
    fit, _, _ = cubic_line(sd=np.inf)
    assert refine.tempered(fit, SETTINGS) is None


TIME, SIGMA = np.linspace(0.0, 2.0 * np.pi, 101), 0.05
OTHERS = [f"other{k}" for k in range(12, 20)]  # more than are refitted


def coupled(time, _inputs, parameters):
    """The stiffness can replace the coupling; where it does, the coupling has no influence."""
    p = parameters
    y = p["stiffness"] * np.sin(7.0 * time)
    free = 1.0 - p["stiffness"]
    y += p["coupling"] * free * (np.sin(7.0 * time) + 0.04 * np.sin(11.0 * time))
    y += p.get("second", 0.0) * free * (np.sin(7.0 * time) + 0.04 * np.sin(10.8 * time))
    for k in range(12, 20):
        y += p[f"other{k}"] * (0.5 * np.sin(11.0 * time) + 0.87 * np.sin(k * time))
    return {"y": y}


def caught(time, inputs, parameters):
    """As ``coupled``; between two values of the stiffness, a part is caught."""
    between = 0.5 < parameters["stiffness"] < 0.95
    return {"y": coupled(time, inputs, parameters)["y"] + 0.3 * between * np.cos(3.0 * time)}


def fitted(function, *more):
    """The model without a coupling, fitted to a machine that has one; the effects."""
    model = SimulatorModel(
        function,
        name="coupled",
        parameters=[Parameter(name="stiffness", value=0.0, sd=0.3)],
        inputs=[],
        outputs={"y": "m"},
        exposed={
            **{n: Exposed(scale=1.0, sign=1, upper=2.0) for n in ("coupling", *more)},
            **{n: Exposed(scale=0.02) for n in OTHERS},
        },
    )
    made = function(TIME, {}, {"stiffness": 0.0, "coupling": 1.0, **dict.fromkeys(OTHERS, 0.0)})
    noise = SIGMA * np.random.default_rng(3).standard_normal(TIME.size)
    problem = problem_of(model, TIME, made["y"] + noise, SIGMA)
    fit = polish(problem, problem.start(theta=np.array([1.0])), 1.0, FitSettings())
    assert fit.explains
    assert fit.point.theta[0] > 0.9
    return fit, model.effects


def test_an_effect_that_a_parameter_has_taken_up_is_found(monkeypatch):
    fit, effects = fitted(coupled)
    scores = score_fit(fit, all_candidates(effects))
    singles = dict(zip((t.name for t in scores.candidates), scores.singles(), strict=True))
    assert singles["coupling"] < 1.0 < max(singles.values())
    best = search(fit, effects, FitSettings()).best
    assert best.names == ("coupling",)
    assert best.fit.point.magnitudes[0] == pytest.approx(1.0, abs=0.1)
    assert abs(best.fit.point.theta[0]) < 0.5
    monkeypatch.setattr("feltmb.gap.search.tempered", lambda *_: None)
    assert search(fit, effects, FitSettings()).best.names != ("coupling",)


def test_an_annealed_fit_does_not_end_at_the_jump_at_which_a_refit_ends():
    fit, (effect, *_) = fitted(caught)
    coupling = (Candidate(effect, effect.shapes[0]),)
    direct = refine.refit(fit, coupling, np.ones(1), FitSettings())
    assert direct.point.theta[0] > 0.94  # the jump is at 0.95
    mild = refine.tempered(fit, FitSettings())
    annealed = refine.annealed(mild, coupling, np.ones(1), FitSettings())
    assert abs(annealed.point.theta[0]) < 0.5
    assert annealed.cost < direct.cost - 30.0


def test_an_annealed_fit_above_the_model_is_not_compared_and_is_the_last(monkeypatch):
    fit, effects = fitted(coupled, "second")
    mild = refine.tempered(fit, FitSettings())
    promised = score_fit(mild, all_candidates(effects)).evidence()
    assert np.sum(promised > 5.0) == 2
    calls, said = [], []

    def astray(base, included, *_):
        calls.append([t.name for t in included])
        problem = base.problem.with_candidates(included)
        start = problem.start(theta=np.array([-2.0]), magnitudes=np.full(1, 2.0))
        return finish(problem, start, 1.0, np.zeros(0))

    monkeypatch.setattr("feltmb.gap.search.annealed", astray)
    found = search(fit, effects, FitSettings(), progress=lambda what, *_: said.append(what))
    assert len(calls) == 1
    assert all(c.fit.cost < fit.cost for c in found.sets)
    assert not any(what.startswith("refine from within") for what in said)


def test_an_effect_whose_annealed_fit_ends_badly_is_fitted_from_the_model_too(monkeypatch):
    fit, effects = fitted(coupled)
    effect = next(e for e in effects if e.name == "other13")
    sound = refine.annealed

    def astray(base, included, *more):
        if included[0].name == effect.name:
            problem = base.problem.with_candidates(included)
            start = problem.carry(fit.point, included, np.array([1e-4]))
            return finish(problem, start, 1.0, np.zeros(0))
        return sound(base, included, *more)

    # Its score at the tempered fit promises more than at the fit.
    def promising(fit, candidates, **more):
        at = score_fit(fit, candidates, **more)
        if fit.included or fit.point.theta[0] > 0.9:
            return at
        own = np.array([t.name == effect.name for t in candidates])
        return replace(at, b=np.where(own, 2.0 * at.b, at.b))

    monkeypatch.setattr("feltmb.gap.search.annealed", astray)
    monkeypatch.setattr("feltmb.gap.search.score_fit", promising)
    found = search(fit, [e for e in effects if e.name != "coupling"], FitSettings())
    alone = next(c for c in found.sets if c.names == (effect.name,))
    assert alone.fit.point.magnitudes[0] == pytest.approx(0.02, abs=0.005)


def test_an_effect_is_not_lost_beside_others_that_gain_much_more():
    # Additions are compared with the best set, not with the model alone.
    count = 20_000
    rng = np.random.default_rng(0)
    columns = np.sign(rng.standard_normal((12, count)))
    x = np.linspace(-1.0, 1.0, count)
    noise = rng.standard_normal(count)
    noise *= np.sqrt(count / (noise @ noise))  # so that the model alone explains the record
    y = x + np.array([16.0, 16.0, 15.0, 9.0]) / np.sqrt(count) @ columns[:4] + noise
    effects = [
        Effect(name=f"e{i}", component="c", scale=0.05, regressor=lambda _r, _s, c=c: c)
        for i, c in enumerate(columns)
    ]
    fit = fit_problem(line(x, y, 1.0))
    assert fit.explains
    found = search(fit, effects, FitSettings())
    assert found.best.evidence - found.model_evidence > 300.0
    assert sorted(found.best.names) == ["e0", "e1", "e2", "e3"]
