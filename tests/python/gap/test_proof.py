"""Held-out densities: segment by segment they are predictions; what is known costs nothing."""

import importlib.util
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from feltmb.data import Record, Sensor
from feltmb.fit.filter import reduce_chain
from feltmb.fit.linear import FunctionModel, LinearModel
from feltmb.fit.linearize import Linear
from feltmb.fit.model import Parameter
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import Noise, segment_record
from feltmb.fit.solve import FitSettings, fit_problem
from feltmb.gap import Candidate, Effect, State, proof
from feltmb.gap.acceptance import _Attempt, least_gain
from feltmb.gap.assemble import _gap_row, how_far_rows
from feltmb.gap.criteria import ALPHA, SURE, contradicted, least_odds
from feltmb.gap.proof import (
    HELD_OUT_LEVEL,
    HeldOut,
    Predicted,
    evaluate,
    expected_gain,
    held_out_gain,
    second_start,
)
from feltmb.gap.refine import refit

_spec = importlib.util.spec_from_file_location("gap_models", Path(__file__).parent / "models.py")
models = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(models)

LEVELS = {"alpha": ALPHA, "odds": least_odds(SURE)}


def gaussian(value, mean, cover):
    """Log density but for the constant of its dimension."""
    left = value - mean
    return -0.5 * (left @ np.linalg.solve(cover, left) + np.linalg.slogdet(cover)[1])


def test_heads_are_the_densities_of_the_beginnings():
    draw = np.random.default_rng(7).standard_normal
    segments, m, nx, mi = 4, 6, 2, 2
    linear = Linear(
        residual=draw((segments, m)),
        by_state=draw((segments, m, nx)),
        by_global=np.zeros((segments, m, 0)),
        by_input=draw((segments, m, mi)),
        defect=draw((segments - 1, nx)),
        ends_by_state=draw((segments, nx, nx)),
        ends_by_global=np.zeros((segments, nx, 0)),
        ends_by_input=draw((segments, nx, mi)),
        good=np.ones(segments, dtype=bool),
    )
    defect_sd, start, start_sd = np.array([0.3, 0.02]), np.array([0.1, -0.2]), np.array([0.5, 2.0])
    chain = reduce_chain(linear, defect_sd, start, start_sd, keep_heads=True)

    # Forwards: every state as a mean and columns of unit normal numbers.
    width = nx + segments * (mi + nx)
    mean, columns = start.copy(), np.zeros((nx, width))
    columns[:, :nx] = np.diag(start_sd)
    means, rows = [], []
    so_far = -np.sum(np.log(start_sd))
    for w in range(segments):
        at = nx + w * (mi + nx)
        here = linear.by_state[w] @ columns
        here[:, at : at + mi] += linear.by_input[w]
        means.append(linear.by_state[w] @ mean)
        rows.append(here)
        seen = np.concatenate(rows)
        grams, log_dets = chain.heads
        found = so_far - 0.5 * grams[w][-1, -1] - log_dets[w]
        expected = gaussian(
            linear.residual[: w + 1].ravel(),
            np.concatenate(means),
            seen @ seen.T + np.eye(len(seen)),
        )
        assert found == pytest.approx(expected, rel=1e-9)
        if w == segments - 1:
            break
        so_far += -0.5 * chain.grams[w][-1, -1] - chain.log_dets[w] - np.sum(np.log(defect_sd))
        mean = linear.ends_by_state[w] @ mean + linear.defect[w]
        columns = linear.ends_by_state[w] @ columns
        columns[:, at : at + mi] += linear.ends_by_input[w]
        columns[:, at + mi : at + mi + nx] += np.diag(defect_sd)


@pytest.fixture(scope="module")
def fitted():
    noise = {"q": Noise(1e-4)}
    fit = fit_problem(
        Problem(
            models.NOMINAL,
            tuple(
                segment_record(models.NOMINAL, models.record(f"r{i}", 1.0, i), noise, 0.4)
                for i in range(2)
            ),
        )
    )
    assert fit.explains
    return fit, segment_record(models.NOMINAL, models.record("held", 1.0, 9), noise, 0.4)


def density(fit, *segmented_records):
    held = HeldOut(
        segmented_records=segmented_records,
        state_scale=fit.problem.scale(fit.point),
        sensed=segmented_records,
    )
    return evaluate(held, fit, FitSettings()).density


def test_what_a_segment_is_worth_does_not_depend_on_what_follows(fitted):
    fit, segmented = fitted
    whole, begun = (
        density(fit, segmented),
        density(fit, segmented.until(segmented.record.samples // 2)),
    )
    assert whole[:2] == pytest.approx(begun[:2], abs=0.01)
    assert begun[3:] == pytest.approx(0.0, abs=1e-9)  # nothing is measured there


@pytest.mark.parametrize("better", ["own", "other"])
def test_held_out_start_states_have_those_of_the_other_model_as_a_second_start(
    fitted, monkeypatch, better
):
    """A true effect lost 60 units of log density: its tight segments were in a local minimum."""
    fit, segmented = fitted
    held = HeldOut((segmented,), fit.problem.scale(fit.point), (segmented,))
    other = evaluate(held, fit, FitSettings())
    places = tuple(replace(p, starts=p.starts + 0.3) for p in other.fit.point.places)
    other = replace(other, fit=replace(other.fit, point=replace(other.fit.point, places=places)))

    def where_it_is(problem, point, level, _):
        return replace(other.fit, problem=problem, point=point, level=level)

    def predicted(_, fit, __):
        from_other = np.array_equal(fit.point.places[0].starts, places[0].starts)
        value = -50.0 if from_other == (better == "other") else -110.0
        return Predicted(np.array([value]), True, fit.point, True)

    monkeypatch.setattr(proof, "polish", where_it_is)
    monkeypatch.setattr(proof, "predict", predicted)
    found = evaluate(held, fit, FitSettings(), like=other)
    assert found.density == pytest.approx([-50.0])
    assert found.explains  # so that no larger defects are tried
    assert found.fit.level == max(fit.level, HELD_OUT_LEVEL)
    alone = evaluate(held, fit, FitSettings())
    assert alone.density == pytest.approx([-50.0 if better == "own" else -110.0])
    assert second_start(alone, other).density == pytest.approx([-50.0])


@pytest.mark.parametrize("squares", [1e6, 0.0])
def test_larger_defects_are_tried_from_the_start_states_of_the_other_model_too(
    fitted, monkeypatch, squares
):
    """A null was named: its set had larger defects, which the model alone was not offered.

    It was UNKNOWN if the states alone agreed with noise, but not with parameters that the fit
    permits.
    """
    fit, segmented = fitted
    held = HeldOut((segmented,), fit.problem.scale(fit.point), (segmented,))
    other = evaluate(held, fit, FitSettings())
    places = tuple(replace(p, starts=p.starts + 0.3) for p in other.fit.point.places)
    other = replace(other, fit=replace(other.fit, point=replace(other.fit.point, places=places)))
    level = 0.1
    assert level in FitSettings().levels

    def where_it_is(problem, point, level, _):
        return replace(other.fit, problem=problem, point=point, level=level, chi2=squares)

    def predicted(_, fit, __):
        from_other = np.array_equal(fit.point.places[0].starts, places[0].starts)
        value = -50.0 if from_other and fit.level == level else -110.0
        return Predicted(np.array([value]), False, fit.point, True)

    monkeypatch.setattr(proof, "polish", where_it_is)
    monkeypatch.setattr(proof, "predict", predicted)
    alone = evaluate(held, fit, FitSettings())
    assert alone.total == -110.0
    assert second_start(alone, other).total == -50.0
    assert evaluate(held, fit, FitSettings(), like=other).total == -50.0


def tone(samples, seed, frequency=1.0, noise=0.1):
    time = 0.05 * np.arange(samples)
    value = np.sin(frequency * time)
    value += noise * np.random.default_rng(seed).standard_normal(samples)
    sensor = Sensor(name="y", unit="1", sigma=noise)
    inputs = {"time": time}
    return Record(
        name="tone", time=time, inputs=inputs, outputs={"y": value}, sensors={"y": sensor}
    )


TONE = FunctionModel(
    outputs={"y": lambda record, p: np.sin(p.frequency * record.inputs["time"])},
    parameters=[Parameter(name="frequency", value=1.05, sd=0.1)],
    name="tone",
)


def tones(frequency):
    """A fit to a short record, and a long one in which the fitted tone leaves the measured one."""
    noise = {"y": Noise(0.1)}
    fit = fit_problem(Problem(TONE, (segment_record(TONE, tone(80, 1), noise, None),)))
    long = segment_record(TONE, tone(1600, 2, frequency), noise, None)
    return fit, HeldOut((long,), np.zeros(0), (long,))


def test_the_prediction_of_a_nonlinear_model_agrees_with_an_integral_over_its_parameter():
    """The fitted frequency is so uncertain that the phase at the end is open by a radian."""
    fit, held = tones(1.0)
    outcome = evaluate(held, fit, FitSettings())
    assert not outcome.fit.explains
    assert outcome.explains
    at, sd = fit.point.theta[0], np.sqrt(fit.covariance[0, 0])
    record = held.segmented_records[0].record
    time, value = record.time, record.outputs["y"]
    grid = np.linspace(at - 8.0 * sd, at + 8.0 * sd, 20_001)
    left = value - np.sin(np.outer(grid, time))
    log = -0.5 * np.sum((left / 0.1) ** 2, axis=1) - 0.5 * ((grid - at) / sd) ** 2
    log -= 0.5 * np.log(2.0 * np.pi) + np.log(sd)
    expected = np.max(log) + np.log(np.trapezoid(np.exp(log - np.max(log)), grid))
    assert outcome.total == pytest.approx(expected, abs=0.1)


def test_a_linear_model_explains_what_its_uncertain_parameter_permits():
    """The fitted record hardly shows the slope, and the held-out one a hundred times as well."""
    line = LinearModel(
        output="y",
        columns={"slope": lambda record: record.inputs["u"]},
        parameters=[Parameter(name="slope", value=1.0, sd=0.5)],
        name="line",
    )

    def segmented(size, slope, seed):
        u = np.linspace(-size, size, 100)
        y = slope * u + 0.1 * np.random.default_rng(seed).standard_normal(u.size)
        sensor = Sensor(name="y", unit="1", sigma=0.1)
        record = Record(
            name="line", time=np.arange(100) * 0.01, inputs={"u": u}, outputs={"y": y},
            sensors={"y": sensor},
        )  # fmt: skip
        return segment_record(line, record, {"y": Noise(0.1)}, None)

    fit = fit_problem(Problem(line, (segmented(0.1, 1.0, 1),)))
    for slope, explains in ((1.3, True), (2.5, False)):
        long = segmented(10.0, slope, 2)
        outcome = evaluate(HeldOut((long,), np.zeros(0), (long,)), fit, FitSettings())
        assert not outcome.fit.explains
        assert outcome.predicted.converged
        assert outcome.explains is explains


def test_parameters_that_the_fit_excludes_explain_no_held_out_record():
    fit, held = tones(1.1)
    outcome = evaluate(held, fit, FitSettings())
    assert not outcome.explains
    assert outcome.total < -2000.0


def test_the_likeliest_parameters_of_another_model_are_a_second_start(monkeypatch):
    """A search that stops on its way is repeated from where another model explains the record."""
    fit, held = tones(1.0)
    other = evaluate(held, fit, FitSettings())
    monkeypatch.setattr(proof, "STEPS", 0)
    alone = evaluate(held, fit, FitSettings())
    assert not alone.predicted.converged
    assert alone.total < other.total - 5.0
    assert second_start(alone, other).total == pytest.approx(other.total, abs=0.01)
    assert second_start(other, alone) is other


def gain_model(law, **prior):
    """y = law(a, u)."""
    return FunctionModel(
        outputs={"y": lambda record, p: law(p.a, record.inputs["u"])},
        parameters=[Parameter(name="a", **prior)],
    )


def gain_records(model, truth, size=3.0, samples=200, seed=0):
    """A fit to a small motion at a = 1, and a held-out large one at another a."""
    generator = np.random.default_rng(seed)

    def segmented(u, a):
        y = a * u + 0.1 * generator.standard_normal(u.size)
        sensor = Sensor(name="y", unit="1", sigma=0.1)
        record = Record(
            name="r", time=0.01 * np.arange(u.size), inputs={"u": u}, outputs={"y": y},
            sensors={"y": sensor},
        )  # fmt: skip
        return segment_record(model, record, {"y": Noise(0.1)}, None)

    fit = fit_problem(Problem(model, (segmented(np.linspace(-0.1, 0.1, 50), 1.0),)))
    long = segmented(np.linspace(-size, size, samples), truth)
    return fit, HeldOut((long,), np.zeros(0), (long,))


def evidence(fit, held, low=-np.inf, high=np.inf):
    """Log of the integral over a of the density of a record with y = a u, a normal a priori."""
    record = held.segmented_records[0].record
    at, sd = fit.point.theta[0], np.sqrt(fit.covariance[0, 0])
    grid = np.linspace(max(low, at - 40.0 * sd), min(high, at + 40.0 * sd), 200_001)
    residual = record.outputs["y"] - np.outer(np.arange(2), record.inputs["u"])
    # The sum of squares is a parabola in a: three sums give all of its values.
    slope = residual[1] - residual[0]
    squares = residual[0] @ residual[0] + 2.0 * grid * (residual[0] @ slope)
    squares += grid**2 * (slope @ slope)
    log = (
        -0.5 * squares / 0.01
        - 0.5 * ((grid - at) / sd) ** 2
        - 0.5 * np.log(2.0 * np.pi)
        - np.log(sd)
    )
    return np.max(log) + np.log(np.trapezoid(np.exp(log - np.max(log)), grid))


def test_a_simulation_that_fails_at_the_start_of_another_model_predicts_nothing():
    """Its residuals counted as zero, a perfect prediction."""
    fails = gain_model(
        lambda a, u: a * u if a < 1.5 else np.full_like(u, np.nan), value=1.0, sd=0.2
    )
    fit, held = gain_records(fails, 2.0)
    alone = evaluate(held, fit, FitSettings())
    other_fit, _ = gain_records(gain_model(lambda a, u: a * u, value=1.0, sd=0.5), 2.0)
    like = evaluate(held, other_fit, FitSettings())
    like = replace(like, predicted=replace(like.predicted, explains=True))
    assert like.predicted.likeliest.theta[0] == pytest.approx(2.0, abs=0.02)
    found = second_start(alone, like)
    assert found is alone
    assert not found.explains
    assert found.total == pytest.approx(evidence(fit, held, high=1.5), abs=10.0)


def test_a_gain_that_the_simulation_does_not_have_is_no_density():
    """The linear model below a jump promises what is beyond it: 7500 units too much."""
    jumps = gain_model(
        lambda a, u: a * u if a < 1.5 else np.where(u > 0.0, 5.0, -3.0) * u, value=1.0, sd=0.2
    )
    fit, held = gain_records(jumps, 2.0)
    outcome = evaluate(held, fit, FitSettings())
    assert not outcome.predicted.converged
    assert outcome.total == pytest.approx(evidence(fit, held, high=1.5), abs=10.0)


def test_many_samples_do_not_hide_parameters_that_the_fit_excludes():
    line = gain_model(lambda a, u: a * u, value=1.0, sd=0.01)
    fit, held = gain_records(line, 1.2, size=100.0, samples=10_000)
    predicted = evaluate(held, fit, FitSettings()).predicted
    assert predicted.converged
    assert predicted.likeliest.theta[0] == pytest.approx(1.2, abs=0.001)
    assert not predicted.explains


@pytest.mark.parametrize("truth", [0.3, -0.3])
def test_the_likeliest_parameter_is_within_its_limits(truth):
    line = gain_model(lambda a, u: a * u, value=0.5, sd=0.4, lower=0.0)
    fit, held = gain_records(line, truth, size=0.5, samples=100)
    outcome = evaluate(held, fit, FitSettings())
    assert outcome.predicted.converged
    assert outcome.predicted.likeliest.theta[0] == pytest.approx(max(truth, 0.0), abs=0.05)
    # At a limit the volume of the Laplace approximation is that of both sides.
    error = 0.01 if truth > 0.0 else 5.0
    assert outcome.total == pytest.approx(evidence(fit, held, low=0.0), abs=error)


def test_a_step_keeps_a_global_at_its_limit_and_moves_the_others_to_their_best():
    draw = np.random.default_rng(3).standard_normal
    rows = draw((6, 3))
    matrix, right, units = np.eye(3) + rows.T @ rows, draw(3), draw((3, 3))
    free = proof._step_within(matrix, right, units, np.full(3, -1.0), np.full(3, 1.0))
    assert matrix @ free == pytest.approx(right)
    low = np.where(units @ free < 0.0, [0.0, -1.0, -1.0], -1.0)
    high = np.where(units @ free > 0.0, [0.0, 1.0, 1.0], 1.0)
    step = proof._step_within(matrix, right, units, low, high)
    assert units[0] @ step == pytest.approx(0.0, abs=1e-12)
    # The gradient that is left is along the limit that holds it.
    left = right - matrix @ step
    assert left == pytest.approx(units[0] * (left @ units[0]) / (units[0] @ units[0]))


@pytest.mark.parametrize("order", [("good", "stopped"), ("stopped", "good")])
def test_second_starts_do_not_depend_on_the_order_of_the_sets(monkeypatch, order):
    """The model alone, and a set before the first that explains, had none."""
    fit, held = tones(1.0)
    good = evaluate(held, fit, FitSettings())
    monkeypatch.setattr(proof, "STEPS", 0)
    stopped = evaluate(held, fit, FitSettings())
    failed = replace(stopped, predicted=replace(stopped.predicted, density=np.full(1, np.nan)))

    def evaluated(_, fit, __, *, like):
        found = {"good": good, "stopped": stopped}[fit]
        return found if like is None else second_start(found, like)

    monkeypatch.setattr("feltmb.gap.acceptance.evaluate", evaluated)
    attempt = _Attempt.__new__(_Attempt)
    attempt.held, attempt.settings = held, FitSettings()
    attempt.outcomes = {(): stopped, ("failed",): failed}
    for name in order:
        attempt.outcomes[name,] = attempt._with_second_starts(name)
    for key in ((), ("stopped",), ("good",)):
        assert attempt.outcomes[key].total == pytest.approx(good.total, abs=0.01)


def test_an_expected_gain_is_searched_from_the_parameters_of_the_other_model(monkeypatch):
    """A search that stops would expect a gain that the model alone has too."""
    fit, held = tones(1.0)
    sd = np.sqrt(fit.covariance[0, 0])
    away = replace(fit, point=replace(fit.point, theta=fit.point.theta + sd, memo={}))
    before, after = (evaluate(held, f, FitSettings()) for f in (fit, away))
    whole, _ = expected_gain(held, before, after, FitSettings(), 1.0)
    assert whole < 3.0
    monkeypatch.setattr(proof, "STEPS", 0)
    assert expected_gain(held, before, after, FitSettings(), 1.0)[0] == pytest.approx(
        whole, abs=0.6
    )


def test_a_memory_that_starts_known_costs_nothing(fitted):
    fit, segmented = fitted
    idle = Effect(
        name="idle",
        component="spring",
        unit="N/m",
        scale=1.0,
        hidden=(State(name="memory", hidden=True, scale=0.01, start_sd=0.0),),
        rate=lambda t, x, u, p, size, shape: {
            "v": -size * x.memory / p.m,
            "memory": (x.q - x.memory) / 0.05,
        },
    )
    with_idle = refit(fit, (Candidate(idle),), np.zeros(1), FitSettings())
    with_idle = replace(with_idle, level=fit.level)
    gain = np.sum(density(with_idle, segmented)) - np.sum(density(fit, segmented))
    assert abs(gain) < 5.0


def _line(size: float, seed: int, samples: int = 60) -> Record:
    """y = 0.5 + u + size u^2 with noise of 0.1."""
    generator = np.random.default_rng(seed)
    u = generator.uniform(-1.0, 1.0, samples)
    return Record(
        name=f"r{seed}",
        time=0.01 * np.arange(samples),
        inputs={"u": u},
        outputs={"y": 0.5 + u + size * u**2 + 0.1 * generator.standard_normal(samples)},
        sensors={"y": Sensor(name="y", sigma=0.1)},
    )


LINE = LinearModel(
    output="y",
    columns={"offset": lambda r: np.ones(r.samples), "slope": lambda r: r.inputs["u"]},
    parameters=[
        Parameter(name="offset", value=0.4, sd=0.3),
        Parameter(name="slope", value=0.9, sd=1.0),
    ],
    segment=10.0,
)
SQUARE = Effect(
    name="square", component="spring", unit="1", scale=0.3,
    regressor=lambda record, shape: record.inputs["u"] ** 2,
)  # fmt: skip


def _pair(size: float, seed: int = 0):
    """Fits of the model and with the square, and a function that evaluates them on a record."""
    noise = {"y": Noise(0.1)}
    problem = Problem(LINE, (segment_record(LINE, _line(size, seed), noise, 10.0),))
    bare = fit_problem(problem)
    square = refit(bare, (Candidate(SQUARE),), np.array([size]), FitSettings())

    def outcomes(record):
        segmented = (segment_record(LINE, record, noise, 10.0),)
        held = HeldOut(segmented_records=segmented, state_scale=np.zeros(0), sensed=segmented)
        both = [evaluate(held, f, FitSettings()) for f in (bare, square)]
        return held, both

    return bare, square, outcomes


def test_the_expected_gain_is_that_of_two_gaussians():
    bare, square, outcomes = _pair(0.3)
    record = _line(0.3, 1)
    held, (before, after) = outcomes(record)
    u = record.inputs["u"]
    small = np.column_stack([np.ones_like(u), u])
    large = np.column_stack([small, u**2])
    apart = large @ np.concatenate([square.point.theta, square.point.magnitudes])
    apart -= small @ bare.point.theta
    cover = small @ bare.covariance @ small.T + 0.01 * np.eye(u.size)
    want = 0.5 * apart @ np.linalg.solve(cover, apart)
    found, _ = expected_gain(held, before, after, FitSettings(), 1.0)
    assert found == pytest.approx(want, rel=1e-6)
    assert found > 5.0
    half, _ = expected_gain(held, before, after, FitSettings(), 2.0)
    assert half == pytest.approx(0.5 * found)


@pytest.mark.parametrize("sigmas", [(0.1, 0.4), (0.4, 0.1)])
def test_the_closed_share_is_that_of_the_gaps_if_the_noise_of_a_channel_differs(sigmas):
    """Every record was divided by the noise of the first one."""
    bare, square, _ = _pair(1.0)
    segmented = tuple(
        segment_record(LINE, _line(1.0, seed), {"y": Noise(sigma)}, 10.0)
        for seed, sigma in enumerate(sigmas, start=1)
    )
    held = HeldOut(segmented_records=segmented, state_scale=np.zeros(0), sensed=segmented)
    before, after = (evaluate(held, f, FitSettings()) for f in (bare, square))
    accepted = SimpleNamespace(before=before, after=after)
    found = how_far_rows(accepted, before, segmented, {}, "open_loop", 0)
    left = max(found.after, 1.0)
    assert found.closed == pytest.approx((found.before - left) / (found.before - 1.0))
    assert found.low <= found.closed <= found.high


@pytest.mark.parametrize("part", ["small", "large", "below noise"])
def test_the_closed_share_of_the_gap_is_at_most_all_of_it(part):
    """A fit that follows some of the noise was told to close 103 % (95 % to 1970 %)."""
    noise, (old, new) = 0.1, {"small": (0.102, 0.07), "large": (1.0, 0.08)}.get(part, (0.08, 0.07))
    rows = np.random.default_rng(0).standard_normal((2, 400))
    before, after = [old * rows[0]], [new * rows[1]]
    row = _gap_row("open loop", "y", "1", before, before, after, noise, 0)
    assert 0.0 <= row.low <= row.closed <= row.high <= 1.0
    if part == "large":
        assert row.low == row.closed == row.high == 1.0
        assert row.closed_text == "100%"
        assert row.band_text == "95% from 100% to 100%"
    elif part == "small":  # some of the drawn blocks have no gap above the noise
        assert (row.low, row.high) == (0.0, 1.0)
        assert row.undetermined
    else:
        assert row.closed == 0.0
    if part != "large":  # "closes 0% (95% from 0% to 0%)"
        told = row.closing("it", "the held-out gap")
        assert told.startswith("the held-out gap is hardly above the noise, so that there is")
        assert row.closed_text == "nothing (no gap above noise)"
    assert row.no_gap == (part != "large")
    assert not _gap_row("open loop", "y", "1", before, before, before, 0.01, 0).no_gap
    grown = _gap_row("open loop", "y", "1", after, after, [3.0 * before[0]], 0.01, 0)
    assert grown.high < 0.0
    assert not grown.undetermined


def test_gains_of_a_true_effect_are_as_expected():
    """Mean and standard deviation over fitted and held-out records of the true machine."""
    rows = []
    for seed in range(0, 400, 2):
        _, _, outcomes = _pair(0.15, seed)
        held, (before, after) = outcomes(_line(0.15, seed + 1))
        expected = expected_gain(held, before, after, FitSettings(), 1.0)
        gain = held_out_gain(before, after)
        rows.append((gain, *expected))
    gain, mean, sd = np.array(rows).T
    z = (gain - mean) / sd
    assert abs(z.mean()) < 0.25
    assert z.std() == pytest.approx(1.0, abs=0.25)
    assert np.mean([g < least_gain(e, s, **LEVELS) for g, e, s in rows]) <= 0.02


def test_never_more_is_required_than_the_odds_of_the_credibility():
    assert least_gain(1e6, 1.0, **LEVELS) == least_odds(SURE)
    assert least_gain(0.0, 0.0, **LEVELS) == 0.0
    assert least_gain(2.0, 2.0, **LEVELS) == pytest.approx(2.0 - 2.0 * contradicted(ALPHA))


@pytest.mark.parametrize(("mean", "certain"), [(20.0, 3.5), (250.0, 3.8), (3.0, 8.0), (5.0, 2.6)])
def test_an_uncertain_magnitude_does_not_excuse_a_large_loss(mean, certain):
    """Gains from the definition: the held-out records measure the magnitude of a true effect."""
    generator = np.random.default_rng(0)
    own, measured = 1.0 / certain, 1.0 / np.sqrt(2.0 * mean)  # sd, with a magnitude of 1
    seen = 1.0 + np.hypot(own, measured) * generator.standard_normal(400_000)
    with_it = -((seen - 1.0) ** 2) / (own**2 + measured**2) - np.log(own**2 + measured**2)
    without = -((seen / measured) ** 2) - np.log(measured**2)
    quantile = np.quantile(0.5 * (with_it - without), 0.01)
    sd = np.sqrt(2.0 * mean + 4.0 * mean**2 / certain**2)
    assert least_gain(mean, sd, **LEVELS) == pytest.approx(
        min(least_odds(SURE), quantile), abs=0.15
    )


def test_a_magnitude_that_the_fit_does_not_show_has_an_expected_gain():
    """Its variance is infinite; beside another effect, the covariance has no inverse."""
    noise = {"y": Noise(0.1)}
    record = _line(0.3, 0)
    half = replace(
        SQUARE, name="half", regressor=lambda record, shape: (record.inputs["u"] > 2.0) * 1.0
    )
    problem = Problem(LINE, (segment_record(LINE, record, noise, 10.0),))
    bare = fit_problem(problem)
    both = refit(bare, (Candidate(SQUARE), Candidate(half)), np.array([0.3, 0.3]), FitSettings())
    assert np.isinf(both.covariance[-1, -1])
    segmented = (segment_record(LINE, _line(0.3, 1), noise, 10.0),)
    held = HeldOut(segmented_records=segmented, state_scale=np.zeros(0), sensed=segmented)
    outcomes = [evaluate(held, f, FitSettings()) for f in (bare, both)]
    mean, sd = expected_gain(held, *outcomes, FitSettings(), 1.0)
    assert mean > 5.0
    assert np.sqrt(2.0 * mean) < sd < 2.0 * mean
