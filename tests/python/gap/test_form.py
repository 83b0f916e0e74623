"""The allowance for the form of a law, and the credibility of a name: two numbers of the user."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from feltmb.cli.gap import command as gap_command
from feltmb.data import Record, Sensor
from feltmb.errors import InvalidParameter
from feltmb.fit.linear import LinearModel
from feltmb.fit.model import LAWS, Candidate, Effect, Parameter
from feltmb.fit.problem import Problem
from feltmb.fit.solve import FitSettings, fit_problem
from feltmb.gap import Options, Verdict, diagnose
from feltmb.gap.checks import check_records
from feltmb.gap.decide import decide
from feltmb.gap.judged_data import prepare
from feltmb.gap.report import write_report
from feltmb.gap.spread import spread

NOISE = 0.002
LINE = LinearModel(
    output="y",
    columns={"slope": lambda record: record.inputs["u"]},
    parameters=[Parameter(name="slope", value=1.0, sd=0.1)],
    name="line",
)
CUBIC = Effect(
    name="cubic",
    component="spring",
    unit="N/m^3",
    scale=0.1,
    regressor=lambda record, shape: record.inputs["u"] ** 3,
)


def record(name, seed, force, role="fit"):
    generator = np.random.default_rng(seed)
    u = np.sin(np.linspace(0.0, 40.0, 300) + seed) * (0.6 + 0.4 * generator.random())
    return Record(
        name=name,
        time=np.arange(u.size) * 1e-3,
        inputs={"u": u},
        outputs={"y": u + force(u) + NOISE * generator.standard_normal(u.size)},
        sensors={"y": Sensor(name="y", unit="1", sigma=NOISE)},
        role=role,
    )


def records(force, seed=0):
    roles = ("fit", "fit", "fit", "held_out", "held_out")
    return [record(f"r{i}", seed + i, force, role) for i, role in enumerate(roles)]


def test_intervals_cover_what_a_law_with_an_error_of_form_explains():
    """The true force is 0.2 u^3 times 1 + e(u), where e is smooth with a standard deviation of 3 %.

    Noise alone gives 0.5 % of the magnitude, so that the interval of the fit rarely covers, neither
    that of the magnitude nor that of the slope, which takes up a part of the error.
    """
    form, truth = 0.03, np.array([1.0, 0.2])
    magnitude = truth[1]
    covered = {0.0: np.zeros(2), form: np.zeros(2)}
    cases = 120
    for seed in range(cases):
        generator = np.random.default_rng(1000 + seed)
        a, phase = generator.standard_normal(2), generator.uniform(0.0, 2.0 * math.pi)

        def force(u, a=a, phase=phase):
            error = a[0] + a[1] * math.sqrt(2.0) * np.cos(3.0 * u + phase)
            return magnitude * u**3 * (1.0 + form / math.sqrt(2.0) * error)

        fitted = [r for r in records(force, 10 * seed) if r.role == "fit"]
        segments = prepare(LINE, fitted, check_records(fitted), None)
        fit = fit_problem(Problem(LINE, segments, (Candidate(CUBIC),)), FitSettings())
        found = np.array([fit.point.theta[0], fit.point.magnitudes[0]])
        for allowed, count in covered.items():
            sd = np.sqrt(np.diag(spread(fit, allowed).total))
            count += np.abs(found - truth) <= 1.96 * sd
    assert np.all(covered[0.0] < 0.6 * cases)
    # 95 % and twice the binomial deviation of 120 cases.
    assert np.all(0.91 * cases <= covered[form])


def test_the_interval_in_the_report_contains_the_form_and_says_so(tmp_path):
    found = {
        form: diagnose(
            LINE,
            [CUBIC],
            records(lambda u: 0.2 * u**3),
            options=Options(bootstrap=0, form=form),
        )
        for form in (0.0, 0.03)
    }
    plain, wide = (r.which["cubic"] for r in found.values())
    assert found[0.0].named == found[0.03].named == ("cubic",)
    assert wide.magnitude == plain.magnitude
    assert wide.sd == pytest.approx(math.hypot(plain.sd, 0.03 * plain.magnitude))
    assert wide.high - wide.magnitude == pytest.approx(1.96 * wide.sd)
    assert f"{wide.low:.4g} to {wide.high:.4g}" in found[0.03].statement
    for form, report in found.items():
        write_report(report, tmp_path / f"{form}", force=True)
        page = (tmp_path / f"{form}" / "report.html").read_text()
        for text in (" ".join(report.text().split()), " ".join(page.split())):
            assert ("interval of its magnitude is at least ±5.9 % (--form 0.03)" in text) is (
                form > 0.0
            )


def fitted(*included):
    runs = [r for r in records(lambda u: 0.2 * u**3 + 0.05 * u**5) if r.role == "fit"]
    problem = Problem(LINE, prepare(LINE, runs, check_records(runs), None), included)
    return fit_problem(problem, FitSettings()), np.concatenate([r.inputs["u"] for r in runs])


@pytest.mark.parametrize("kind", ["kinematic", "parameter", "sensor", "input", "drift"])
def test_what_is_no_law_has_no_error_of_form(kind):
    fit, _ = fitted(Candidate(replace(CUBIC, kind=kind)))
    assert np.all(spread(fit, 0.03).by_form == 0.0)
    for law in LAWS:
        fit, _ = fitted(Candidate(replace(CUBIC, kind=law)))
        assert np.all(np.diag(spread(fit, 0.03).by_form) > 0.0)


def test_errors_of_form_are_carried_into_everything_that_compensates_them():
    """Against weighted least squares with the other laws at given magnitudes."""
    quintic = replace(
        CUBIC, name="quintic", regressor=lambda record, shape: record.inputs["u"] ** 5
    )
    fit, u = fitted(Candidate(CUBIC), Candidate(quintic))
    form, magnitudes = 0.03, fit.point.magnitudes
    columns = np.column_stack([u, u**3, u**5]) / NOISE
    normal = columns.T @ columns + np.diag([1.0 / 0.1**2, 0.0, 0.0])
    expected = np.zeros((3, 3))
    for k, magnitude in enumerate(magnitudes):
        law = 1 + k
        rest = [i for i in range(3) if i != law]
        change = np.zeros(3)
        change[law] = form * magnitude
        change[rest] = -np.linalg.solve(normal[np.ix_(rest, rest)], normal[rest, law] * change[law])
        expected += np.outer(change, change)
    assert spread(fit, form).by_form == pytest.approx(expected, rel=1e-4)


def test_calibrated_parameters_contain_the_form_of_the_named_laws():
    found = {
        form: diagnose(
            LINE,
            [CUBIC],
            records(lambda u: 0.5 * u + 0.2 * u**3),
            options=Options(bootstrap=0, form=form),
        )
        for form in (0.0, 0.03)
    }
    plain, wide = (r.calibrated[0] for r in found.values())
    assert plain.name == wide.name == "slope"
    assert wide.value == plain.value
    assert wide.sd > 2.0 * plain.sd
    assert plain.beyond
    assert wide.beyond


def test_a_name_needs_the_credibility_that_the_user_asks_for(decided):
    diagnose(LINE, [CUBIC], records(lambda u: 0.2 * u**3), options=Options(bootstrap=0))
    facts = replace(
        decided[-1], belief=replace(decided[-1].belief, none=0.0, other=0.05, sets=(0.95,))
    )
    for credibility, verdict in ((0.9, Verdict.NAMED), (0.96, Verdict.UNKNOWN)):
        decision = decide(replace(facts, options=Options(credibility=credibility)))
        assert decision.verdict == verdict
    assert "posterior 0.95, expected 0.96 at least" in decision.statement


@pytest.mark.parametrize(
    ("name", "commands"),
    [
        ("alpha", {"diagnose"}),
        ("credibility", {"diagnose", "session", "blind"}),
        ("form", {"diagnose", "session", "blind"}),
        ("bootstrap", {"diagnose", "session"}),
    ],
)
def test_the_command_line_has_the_defaults_of_the_options(name, commands):
    found = {c: {p.name: p.default for p in gap_command.commands[c].params} for c in commands}
    assert {c: own[name] for c, own in found.items()} == dict.fromkeys(
        commands, getattr(Options(), name)
    )


def test_numbers_outside_their_range_are_told_together():
    with pytest.raises(InvalidParameter, match=r"(?s)credibility = 1\.2.*form = -0\.1"):
        Options(credibility=1.2, form=-0.1)
