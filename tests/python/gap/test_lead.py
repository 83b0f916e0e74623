"""Sets of effects led along the records, where the model is far off at its tabulated numbers."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from feltmb.fit.problem import Problem
from feltmb.fit.solve import FitSettings, fit_problem
from feltmb.gap import Parameter, Record, Sensor, SimulatorModel, library
from feltmb.gap.checks import check_records
from feltmb.gap.investigate import Task
from feltmb.gap.judged_data import prepare
from feltmb.gap.lead import _Stage, lead
from feltmb.gap.options import Options
from feltmb.gap.refine import worth_of
from feltmb.gap.search import search

TIME = np.linspace(0.0, 12.0, 600)
SIGMA = 0.01
PARAMETERS = {"amplitude": (1.0, 0.1), "frequency": (5.0, 0.25), "drag": (0.1, 0.05)}


def swing(time, inputs, parameters):
    """Ten periods, so that half a period of phase is within the prior of the frequency."""
    p = parameters
    turn = p["frequency"] * time
    fade = p["amplitude"] * np.exp(-p["drag"] * time)
    return {"x": fade * np.sin(turn), "y": fade * np.cos(turn) + inputs["u"]}


def parts(*, bend=0.0, frequency=5.5):
    model = SimulatorModel(
        swing,
        name="swing",
        parameters=[Parameter(name=n, value=v, sd=s) for n, (v, s) in PARAMETERS.items()],
        inputs=["u"],
        outputs={"x": "m", "y": "m"},
        exposed={},
    )
    rng = np.random.default_rng(1)
    zero = np.zeros(TIME.size)
    made = swing(TIME, {"u": zero}, {"amplitude": 1.05, "frequency": frequency, "drag": 0.12})
    made["y"] = made["y"] + bend * made["y"] ** 2
    sensors = {n: Sensor(name=n, unit="m", sigma=SIGMA) for n in made}
    record = Record(
        name="r", time=TIME, inputs={"u": zero}, sensors=sensors,
        outputs={n: y + SIGMA * rng.standard_normal(y.size) for n, y in made.items()},
    )  # fmt: skip
    names = ["x", "y"]
    effects = [
        *(library.sensor_gain(names, n) for n in names),
        *(library.sensor_offset(names, n, unit="m", scale=0.05) for n in names),
        *(library.sensor_delay(names, n, scale=0.02) for n in names),
        *(library.sensor_bend(names, n, level=1.0) for n in names),
    ]
    segmented = prepare(model, [record], check_records([record], model.outputs), None)
    return Problem(model, segmented), effects


@pytest.fixture(scope="module")
def bent():
    problem, effects = parts(bend=0.2)
    return problem, effects, lead(problem, effects, FitSettings())


def test_the_missing_effect_is_found_before_the_model_is_led_astray(bent):
    _, _, led = bent
    best = led[0]
    assert [t.name for t in best.included] == ["nonlinearity of sensor y"]
    assert best.point.magnitudes[0] == pytest.approx(0.2, abs=0.01)
    assert best.plausible
    assert sum(not f.included for f in led) == 1


def test_a_model_that_can_explain_all_is_led_alone():
    problem, effects = parts()
    (alone,) = lead(problem, effects, FitSettings())
    assert not alone.included
    assert alone.plausible
    near, _ = parts(frequency=5.0)
    near = near.with_candidates(())
    assert lead(near, effects, FitSettings())  # far off by its other parameters still


def test_a_model_that_explains_is_not_led(monkeypatch):
    module = sys.modules["feltmb.gap.investigate"]
    led = []
    monkeypatch.setattr(module, "lead", lambda *a, **k: led.append(1) or lead(*a, **k))
    for bend, times in ((0.0, 0), (0.2, 1)):
        problem, effects = parts(bend=bend)
        task = Task(effects, Options(), FitSettings(), None, None)
        found = module._search(problem.model, problem.segmented_records, task)
        assert found.model_fit.plausible == (times == 0)
        assert len(led) == times


def test_a_search_goes_on_from_where_records_are_explained(bent):
    _, effects, led = bent
    alone = next(f for f in led if not f.included)
    found = search(alone, effects, FitSettings(restarts=0), led=led)
    assert found.best.names == ("nonlinearity of sensor y",)
    # Sets that hold it are asked from its own fit, and none of them promises anything.
    assert all(len(c.names) <= 1 for c in found.sets)


def test_only_what_explains_bounds_what_is_worth_pursuing(bent):
    problem, _, led = bent
    assert worth_of(None) == np.inf
    assert worth_of(led[0]) == pytest.approx(led[0].cost + 100.0)
    alone = fit_problem(problem, FitSettings(restarts=0, iterations=2))
    assert not alone.plausible
    assert worth_of(alone) == np.inf


def test_the_model_alone_is_repeated_once_and_only_if_nothing_explains(monkeypatch):
    repeated = []

    def counted(problem, settings, **more):
        if settings.restarts:
            repeated.append(problem.samples)
        return fit_problem(problem, settings, **more)

    monkeypatch.setattr(sys.modules["feltmb.gap.lead"], "fit_problem", counted)
    problem, effects = parts(bend=0.2)
    assert lead(problem, effects, FitSettings())[0].plausible
    assert not repeated
    (alone,) = lead(problem, [], FitSettings())
    assert not alone.plausible
    assert len(repeated) == 1


def test_a_set_that_explains_only_from_the_last_stage_on_leads_the_model_alone(monkeypatch):
    """The model alone is then started from the parameters of this set too."""
    module = sys.modules["feltmb.gap.lead"]
    starts = []

    def taken_over(fit):
        starts.append(fit.included)
        return taken(fit)

    taken = module.taken_over
    monkeypatch.setattr(module, "taken_over", taken_over)
    monkeypatch.setattr(module, "HORIZONS", ())  # one stage
    problem, effects = parts(bend=0.2, frequency=5.05)
    monkeypatch.setattr(module, "SHORTEST", 1.0)
    led = lead(problem, effects, FitSettings())
    assert [t.name for t in led[0].included] == ["nonlinearity of sensor y"]
    assert len(starts) == 1
    assert sum(not f.included for f in led) == 1


def test_the_best_set_is_one_whatever_its_evidence():
    """A record in a wrong unit left an evidence that is no number, and the search ended."""
    stage = object.__new__(_Stage)
    for values in ((np.nan,), (-np.inf, np.nan), (-np.inf, -np.inf)):
        stage.found = {(str(i),): SimpleNamespace(evidence=v) for i, v in enumerate(values)}
        (best,) = stage.best(1)
        assert best in stage.found.values()
    stage.found = {("a",): SimpleNamespace(evidence=np.nan), ("b",): SimpleNamespace(evidence=1.0)}
    assert [c.evidence for c in stage.best(2)] == [1.0]
