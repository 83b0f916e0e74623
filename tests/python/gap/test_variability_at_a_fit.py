"""Run-to-run variability whose directions depend on the parameters of the machine."""

import copy

import numpy as np
import pytest
from feltmb.fit.solve import FitSettings, fit_problem, polish, with_variability

from feltmb import gap
from feltmb.data import Record, Sensor
from feltmb.files import Store
from feltmb.fit import VARIABILITY, Effect, Model, Parameter, Simulated, including
from feltmb.fit.model import Candidate
from feltmb.gap.score import score_fit

TIME = np.linspace(0.0, 1.0, 400)
SIGMA, TABULATED, TRUE = 0.01, 0.45, 0.55
ECHO = Effect(name="echo", component="bell", unit="1", scale=1.0)
CHIRP = Effect(name="chirp", component="bell", unit="1", scale=1.0)


def pulse(when):
    """A pulse at a time, which the parameter of the model shifts."""
    return np.exp(-(((TIME - when) / 0.03) ** 2))


def ringing(when):
    """A vibration that begins at that time."""
    return np.where(when < TIME, 0.8 * SIGMA * np.sin(90.0 * (TIME - when)), 0.0)


class Bell(Model):
    """y = pulse(when) + z ringing(when of the fit at which the variability was computed)."""

    name, outputs, units, from_rest = "bell", ("y",), {"y": "m"}, True
    parameters = (
        Parameter(name="when", value=TABULATED, sd=0.05),
        Parameter(name="variability", value=0.0, sd=1.0, component=VARIABILITY),
    )
    computed_at = TABULATED, (), ()

    def states(self, included=()):  # noqa: ARG002
        return ()

    def accepts(self, effect):  # noqa: ARG002
        return True

    def simulate(self, record, jobs):  # noqa: ARG002
        outputs = np.zeros((jobs.count, jobs.longest, 1))
        for b, (first, last) in enumerate(jobs.segments):
            when, z = jobs.theta[b]
            y = pulse(when) + z * ringing(self.computed_at[0])
            for candidate, size in zip(jobs.included, jobs.magnitudes[b], strict=True):
                y = y + size * (ringing(TRUE) if candidate.name == "echo" else 0.1 * TIME)
            outputs[b, : last - first + 1, 0] = y[first : last + 1]
        return Simulated(outputs=outputs, ends=np.zeros((jobs.count, 0)))


class Rung(Bell):
    """The same model, whose variability can be computed at other parameters."""

    def with_variability_at(self, theta, included, magnitudes):
        out = copy.copy(self)
        out.computed_at = float(theta[0]), tuple(t.name for t in included), tuple(magnitudes)
        return out


def made(name, seed, *, beside=0.0, role="fit"):
    rng = np.random.default_rng(seed)
    y = pulse(TRUE) + 1.5 * ringing(TRUE) + beside + SIGMA * rng.standard_normal(TIME.size)
    return Record(
        name=name, time=TIME, inputs={}, outputs={"y": y}, role=role,
        sensors={"y": Sensor(name="y", unit="m", sigma=SIGMA)},
    )  # fmt: skip


@pytest.fixture
def record():
    return made("r", 4)


def score(fit, effect):
    """Score of an effect at a fit: about 1 if the fit lacks nothing."""
    return float(score_fit(fit, (Candidate(effect),)).singles()[0])


def test_a_fit_has_the_variability_of_its_own_parameters(record):
    stale, fit = gap.fit_model(Bell(), [record]), gap.fit_model(Rung(), [record])
    assert fit.problem.model.computed_at[0] == pytest.approx(TRUE, abs=0.002)
    assert fit.point.theta == pytest.approx([TRUE, 1.5], abs=0.3)
    # What the old direction leaves looks like an effect that vibrates in the same way.
    assert stale.explains
    assert score(stale, ECHO) > 30.0
    assert score(fit, ECHO) < 4.0
    assert fit.chi2 < stale.chi2 - 30.0


def test_stored_fits_of_another_variability_are_not_used(record, tmp_path):
    """At the start, both versions have the same sum of squares, but not the same derivatives."""
    problem = gap.fit_model(Bell(), [record]).problem
    found = []
    for at in (TABULATED, TRUE):
        model = Rung()
        model.computed_at = at, (), ()
        own = type(problem)(model, problem.segmented_records, store=Store(tmp_path))
        start = own.start(theta=np.array([TRUE, 0.0]))
        found.append(polish(own, start, 1.0, FitSettings()).cost)
    assert found[1] < found[0] - 30.0


def test_a_fit_that_explains_nothing_is_not_repeated():
    fit = gap.fit_model(Rung(), [made("r", 4, beside=3.0 * TIME**2)])
    assert not fit.explains
    assert fit.problem.model.computed_at == (TABULATED, (), ())


def test_the_variability_is_that_with_the_effects_of_the_fit(record):
    chirp = Candidate(CHIRP)
    problem = gap.fit_model(Bell(), [record]).problem
    problem = type(problem)(Rung(), problem.segmented_records).with_candidates((chirp,))
    fit = with_variability(fit_problem(problem), FitSettings())
    _, names, sizes = fit.problem.model.computed_at
    assert names == ("chirp",)
    assert sizes == pytest.approx(fit.point.magnitudes, abs=0.3)
    # A model that is derived from another one passes its effects on.
    derived = including(Rung(), [chirp], [0.2])
    moved = derived.with_variability_at(np.array([0.5, 0.0, 0.3]), (), np.zeros(0))
    assert moved._base.computed_at == (0.5, ("chirp",), (0.3,))
    plain = including(Bell(), [chirp], [0.2])
    assert plain.with_variability_at(np.array([0.5, 0.0, 0.3]), (), np.zeros(0)) is plain


def test_a_search_uses_the_variability_at_its_best_set():
    """The model alone explains nothing; with the effect, the rest would look like another one."""
    records = [made("r", 4, beside=0.2 * TIME), made("s", 5, beside=0.2 * TIME, role="held_out")]
    report = gap.diagnose(Rung(), [CHIRP, ECHO], records, options=gap.Options(bootstrap=0))
    assert report.named == ("chirp",)
    when, names, _ = report.fit.problem.model.computed_at
    assert when == pytest.approx(TRUE, abs=0.002)
    assert "chirp" in names


def test_the_variability_of_a_fit_can_be_that_of_another_one(record):
    problem = gap.fit_model(Rung(), [record]).problem
    fit = fit_problem(problem, FitSettings(restarts=0))
    chirp = problem.with_candidates((Candidate(CHIRP),))
    near = polish(chirp, chirp.start(theta=fit.point.theta), 1.0, FitSettings())
    assert near.explains
    found = with_variability(fit, FitSettings(), near=near)
    assert found.problem.model.computed_at == (
        near.point.theta[0],
        ("chirp",),
        tuple(near.point.magnitudes),
    )
    assert not found.included
    assert found.converged
