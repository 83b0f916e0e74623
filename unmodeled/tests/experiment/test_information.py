"""Information of records against hand-computed Fisher matrices, and the value against records."""

from __future__ import annotations

import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from unmodeled import LinearModel, Parameter, Record, Sensor, diagnose
from unmodeled.data import StartPrior
from unmodeled.errors import InvalidParameter
from unmodeled.experiment import Belief, plan
from unmodeled.experiment.information import Knowledge, Study
from unmodeled.search.problem import RELEASED, TRUSTED

from .models import CUBE, RAMP, SQUARE, effect, line, proposed

TIME = np.arange(400) / 400.0
U = 0.5 + 0.5 * np.sin(7.0 * TIME)


def record(u=U, sigma=0.05, **sensor):
    return Record(
        name="one", time=TIME, inputs={"u": u}, outputs={"y": u.copy()},
        sensors={"y": Sensor(name="y", sigma=sigma, **sensor)},
    )  # fmt: skip


def matrix_of(study, one):
    return study.linearized(one).matrix({"y": 400.0})


def test_information_is_the_fisher_matrix():
    """J'J / sigma^2 in prior scales: slope, square, cube, and the slope outside its tolerance."""
    study = Study.of(line(sd=0.1), [replace(SQUARE, scale=2.0), CUBE])
    columns = np.column_stack([0.1 * U, 2.0 * U**2, U**3, RELEASED * 0.1 * U])
    assert list(study.names) == ["square", "cube", "slope"]
    assert matrix_of(study, record()) == pytest.approx(columns.T @ columns / 0.05**2)


def test_unknowns_of_the_record_are_eliminated():
    """An offset of the sensor with its prior is another column, projected out."""
    study = Study.of(line(sd=0.1), [SQUARE])
    columns = np.column_stack([0.1 * U, U**2, RELEASED * 0.1 * U])
    noise = 0.05**2 * np.eye(400) + 0.3**2  # the covariance of noise and offset
    expected = columns.T @ np.linalg.solve(noise, columns)
    assert matrix_of(study, record(offset_sd=0.3)) == pytest.approx(expected, rel=1e-6)


def test_noise_of_the_input_is_eliminated():
    """A line of which the input is noisy shows less of the square."""
    study = Study.of(line(sd=0.1), [SQUARE])
    exact, noisy = (
        matrix_of(study, replace(record(), input_sigma={"u": sigma})) for sigma in (0.0, 0.5)
    )
    assert noisy[1, 1] < 0.8 * exact[1, 1]


def test_parameters_are_projected_out():
    """G is the inverse of the variance of a magnitude that is fitted with the parameter."""
    study = Study.of(line(sd=0.1), [SQUARE])
    knowledge = Knowledge(study, (study.linearized(record()),))
    covariance = 0.05**2 * np.eye(400) + 0.1**2 * np.outer(U, U)
    assert knowledge.gram[0, 0] == pytest.approx(U**2 @ np.linalg.solve(covariance, U**2))


@pytest.mark.parametrize("repeats", [1, 4])
def test_a_known_discrepancy_counts_as_few_samples(repeats):
    """Noise s and discrepancy d: the variance of a mean is s^2/n + d^2/TRUSTED."""
    belief = Belief(weights={"square": 1.0}, left={"y": (0.05, 0.5)})
    study = Study.of(line(sd=0.1), [SQUARE], belief)
    one = study.linearized(record())
    knowledge = Knowledge(study, (one,) * repeats)
    n = 400 * repeats
    share = 1.0 / (0.05**2 + n * (0.5**2 - 0.05**2) / TRUSTED)
    expected = repeats * share * (U**2 @ U**2)
    # The discrepancy that a finite record shows by chance is not counted.
    assert knowledge.matrix[1, 1] == pytest.approx(expected, rel=0.01)


def test_named_causes_and_fitted_parameters_are_part_of_the_model():
    """The linearization is at the fit; a named cause is an unknown and no hypothesis."""
    model = LinearModel(
        output="y", columns={"slope": lambda r: r.inputs["u"]},
        parameters=[Parameter(name="slope", value=1.0, sd=0.1)],
    )  # fmt: skip
    model.inputs = ("u",)
    belief = Belief(
        weights={"cube": 1.0}, included={"square": (0.7, None)}, parameters={"slope": 1.2}
    )
    study = Study.of(model, [SQUARE, CUBE], belief)
    assert study.x == pytest.approx([2.0, 0.7])
    assert list(study.names) == ["cube", "slope"]
    assert study.simulated([record()])[0].outputs["y"] == pytest.approx(1.2 * U + 0.7 * U**2)
    columns = np.column_stack([0.1 * U, U**2, U**3, RELEASED * 0.1 * U])
    assert matrix_of(study, record()) == pytest.approx(columns.T @ columns / 0.05**2)


def test_expected_evidence_is_what_records_then_give():
    """Mean log evidence over noise, of the true effect against its rival and against nothing."""
    study = Study.of(line(sd=0.5), [SQUARE, CUBE])
    one = Knowledge(study, (study.linearized(record(sigma=0.05)),))
    generator = np.random.default_rng(3)
    known = 0.05**2 * np.eye(400) + 0.5**2 * np.outer(U, U)
    free = [np.linalg.inv(known + np.outer(c, c)) for c in (U**2, U**3)]
    alone = np.linalg.inv(known)
    gains = []
    for _ in range(300):
        y = U * generator.normal(0.0, 0.5) + U**2 + 0.05 * generator.standard_normal(400)
        gains.append([0.5 * (y @ (m - free[0]) @ y) for m in (free[1], alone)])
    gram = one.gram
    against = 0.5 * (gram[0, 0] - gram[0, 1] ** 2 / (gram[1, 1] + 1e-2))
    assert np.mean(gains, axis=0) == pytest.approx([against, 0.5 * gram[0, 0]], rel=0.05)
    # Equal priors: the probability of the rival follows from the evidence.
    assert one.chance[0, 1] == pytest.approx(1.0 / (1.0 + np.exp(against)))


def test_the_smallest_detectable_magnitude_is_named():
    """A diagnosis of a record with twice this magnitude tells the effect, with half of it not."""
    model, wave = line(sd=0.1), effect("wave", lambda u: np.sin(20.0 * u))
    study = Study.of(model, [wave])
    own = Knowledge(study, (study.linearized(record()),))
    noise = 0.05 * np.random.default_rng(5).standard_normal(400)
    told = []
    for factor in (0.5, 2.0):
        size = factor * own.smallest[0]
        y = 1.03 * U + size * np.sin(20.0 * U) + noise
        report = diagnose(model, [wave], [replace(record(), outputs={"y": y})])
        told.append(sum(s.probability for s in report.sets if "wave" in s.causes) > 0.9)
    assert told == [False, True]


def test_a_test_of_a_part_is_one_more_measured_value():
    """Its information is that of a record with the number as its only output."""
    steeper = replace(
        effect("steeper", lambda u: u, scale=0.5), tolerance_parameter="slope", tolerance_ratio=-2.0
    )
    study = Study.of(line(sd=0.1), [SQUARE, steeper])
    start = Knowledge(study)
    # The slope is covered by the effect, so that it is no cause of its own.
    assert list(study.names) == ["square", "steeper"]
    row = np.array([0.1, 0.0, -1.0])
    assert start.test("slope", 0.2) == pytest.approx(np.outer(row, row) / 0.04)
    row = np.array([0.0, 1.0, 0.0])
    assert start.test("square", 0.2) == pytest.approx(np.outer(row, row) / 0.04)


def test_reports_of_another_model_and_other_files_are_refused():
    with pytest.raises(InvalidParameter, match="report: is none of a diagnosis"):
        Belief.of_report({"which": {}})
    belief = Belief(weights={}, left={"temperature": (1.0, 2.0)})
    with pytest.raises(InvalidParameter, match="tells of temperature"):
        plan(line(), [SQUARE], [proposed(RAMP)], belief=belief)


# ---------------------------------------------------------------- what a plan promises


def two_lines():
    """Offset and slope with wide priors."""
    model = LinearModel(
        output="y",
        columns={"offset": lambda r: np.ones(r.samples), "slope": lambda r: r.inputs["u"]},
        parameters=[
            Parameter(name="offset", value=0.0, sd=0.5), Parameter(name="slope", value=1.0, sd=0.5),
        ],
    )  # fmt: skip
    model.inputs = ("u",)
    return model


def measured(planned, seed):
    """The record of a machine with the square."""
    u = planned.inputs["u"]
    noise = 0.02 * np.random.default_rng(seed).standard_normal(u.size)
    sensors = {"y": Sensor(name="y", sigma=0.02)}
    return replace(planned, outputs={"y": 0.1 + 1.2 * u + u**2 + noise}, sensors=sensors)


def probability(report, cause):
    return sum(s.probability for s in report.sets if s.causes == (cause,))


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_the_chosen_experiment_raises_the_probability_of_the_right_cause(seed):
    """Records near one level leave the square and the cube; the planned one names the square."""
    model, causes = two_lines(), [SQUARE, CUBE]
    narrow = record(u=0.5 + 0.1 * np.sin(7.0 * TIME + seed))
    records = [replace(measured(narrow, 10 * seed + k), name=f"r{k}") for k in range(2)]
    first = diagnose(model, causes, records, hold_out=[])
    assert first.verdict.name == "ONE_OF"
    assert probability(first, "square") < 0.8
    sensors = {"y": Sensor(name="y", sigma=0.02)}
    others = [proposed(np.linspace(0.0, 1.0, 400), "ramp", sensors), replace(narrow, name="old")]
    result = plan(model, causes, others, records, belief=Belief.of_report(first))
    assert result.before < 0.62
    assert result.records[0].record.name == "ramp"
    assert result.records[0].after > 0.95
    new = measured(result.records[0].record, 90 + seed)
    then = diagnose(model, causes, [*records, new], hold_out=[])
    assert then.verdict.name == "NAMED"
    assert probability(then, "square") > 0.9
    # One more record of the old kind tells nothing, as the plan would have said.
    again = Knowledge(Study.of(model, causes, Belief.of_report(first)))
    known = again.plus(*(again.study.linearized(r) for r in records))
    more = replace(known, before=known.gram).plus(again.study.linearized(narrow))
    assert more.names() < 0.62


@pytest.mark.slow
def test_the_example_of_a_session_names_its_cause(capsys):
    """Plan, measure, diagnose, until the friction of 0.05 N is named."""
    runpy.run_path(str(Path(__file__).parents[3] / "unmodeled" / "examples" / "session.py"))
    *_, verdict, named = capsys.readouterr().out.splitlines()
    assert verdict.endswith(": named")
    assert float(named.removeprefix("dry friction: ").removesuffix(" N")) == pytest.approx(
        0.05, abs=0.005
    )


def test_belief_is_that_of_the_sets():
    """Sets share their probability; a file of the report says the same as the object."""
    narrow = record(u=0.5 + 0.1 * np.sin(7.0 * TIME))
    report = diagnose(two_lines(), [SQUARE, CUBE], [measured(narrow, 3)], hold_out=[])
    belief = Belief.of_report(report)
    assert Belief.of_report(report.as_dict()).weights == belief.weights
    both = sum(s.probability for s in report.sets if set(s.causes) == {"square", "cube"})
    assert belief.weights["square"] == pytest.approx(
        probability(report, "square") + 0.5 * both, abs=0.02
    )
    assert belief.left["y"] == pytest.approx((0.02, report.channels[0].explained))


def test_start_states_count_as_in_a_diagnosis():
    """A start prior of the record that fixes a state leaves more information than a free one."""
    from unmodeled import Equations, State

    model = Equations(
        name="lag",
        states=[State(name="x", scale=1.0, start_sd=1.0)],
        parameters=[Parameter(name="rate", value=3.0, sd=0.5, lower=0.1)],
        inputs=["u"],
        rates=lambda t, x, u, p: (p.rate * (u.u - x.x),),
        outputs={"y": "x"},
    )
    drag = replace(
        SQUARE, name="drag", regressor=None,
        rate=lambda t, x, u, p, size, shape: {"x": -size * x.x**3},
    )  # fmt: skip
    study = Study.of(model, [drag])
    still = replace(record(u=0.0 * U), outputs={"y": np.exp(-3.0 * TIME)})
    free, fixed = (
        matrix_of(study, replace(still, start=StartPrior(mean={"x": 1.0}, sd={"x": sd})))[1, 1]
        for sd in (1.0, 0.0)
    )
    assert 0.0 < free < 0.9 * fixed


def test_a_deviation_that_a_parameter_has_is_not_counted_twice():
    model = line(sd=0.1)
    name = model.parameters[0].name
    steeper = replace(SQUARE, name="steeper", tolerance_parameter=name)
    belief = Belief(weights={}, included={"steeper": (0.7, None)}, parameters={name: 1.7})
    study = Study.of(model, [steeper, CUBE], belief)
    assert study.members == ()
    assert study.x == pytest.approx([(1.7 - model.parameters[0].value) / 0.1])
    assert "steeper" not in study.names


def test_an_effect_of_a_parameter_with_a_tolerance_is_this_parameter():
    """Its own column, which a simulation knows less exactly, would look like a signature."""
    bent = replace(effect("bent", lambda u: u + 1e-3 * u**2, scale=0.5), tolerance_ratio=-2.0)
    model = line(sd=0.1)
    for name, same in (("slope", True), ("", False)):
        study = Study.of(model, [replace(bent, tolerance_parameter=name)])
        matrix = matrix_of(study, record())
        at = list(study.names).index("bent")
        slope = -10.0 * matrix[:, 0]
        assert np.allclose(matrix[:, 1 + at], slope, rtol=1e-9) is same
