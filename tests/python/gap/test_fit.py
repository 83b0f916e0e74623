"""The filter against dense algebra, derivatives against their definition, fits against truth."""

import copy
import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from feltmb.fit.filter import reduce_chain
from feltmb.fit.linearize import Linear
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import Noise, choose_segments, segment_record
from feltmb.fit.solve import fit_problem

from feltmb.errors import InvalidParameter
from feltmb.fit import SensitivityRequest
from feltmb.gap import (
    Candidate,
    Coordinate,
    Coupling,
    Jobs,
    OdeModel,
    Parameter,
    Rate,
    Record,
    Sensor,
    State,
    fit_model,
    library,
)

HERE = Path(__file__).parent
spec = importlib.util.spec_from_file_location("gap_models", HERE / "models.py")
models = importlib.util.module_from_spec(spec)
spec.loader.exec_module(models)


def random_linear(generator, segments=4, m=7, nx=2, ng=3, mi=2):
    draw = generator.standard_normal
    return Linear(
        residual=draw((segments, m)),
        by_state=draw((segments, m, nx)),
        by_global=draw((segments, m, ng)),
        by_input=draw((segments, m, mi)),
        defect=draw((segments - 1, nx)),
        ends_by_state=draw((segments, nx, nx)),
        ends_by_global=draw((segments, nx, ng)),
        ends_by_input=draw((segments, nx, mi)),
        good=np.ones(segments, dtype=bool),
    )


def dense(linear, defect_sd, start_mean, start_sd):
    """All rows of the same problem: (states and input noise, globals, right-hand side)."""
    segments, m, nx = linear.by_state.shape
    ng, mi = linear.by_global.shape[2], linear.by_input.shape[2]
    width = segments * (nx + mi)
    rows = []

    def row(own, other, right):
        rows.append(np.concatenate([own, other, [right]]))

    for w in range(segments):
        for i in range(m):
            own = np.zeros(width)
            own[w * nx : (w + 1) * nx] = linear.by_state[w, i]
            own[segments * nx + w * mi : segments * nx + (w + 1) * mi] = linear.by_input[w, i]
            row(own, linear.by_global[w, i], linear.residual[w, i])
        for i in range(mi):
            own = np.zeros(width)
            own[segments * nx + w * mi + i] = 1.0
            row(own, np.zeros(ng), 0.0)
        if w < segments - 1:
            for i in range(nx):
                own = np.zeros(width)
                own[w * nx : (w + 1) * nx] = -linear.ends_by_state[w, i]
                own[(w + 1) * nx + i] = 1.0
                own[segments * nx + w * mi : segments * nx + (w + 1) * mi] = -linear.ends_by_input[
                    w, i
                ]
                row(
                    own / defect_sd[i],
                    -linear.ends_by_global[w, i] / defect_sd[i],
                    linear.defect[w, i] / defect_sd[i],
                )
    for i in range(nx):
        own = np.zeros(width)
        own[i] = 1.0 / start_sd[i]
        row(own, np.zeros(ng), start_mean[i] / start_sd[i])
    table = np.array(rows)
    return table[:, :width], table[:, width:-1], table[:, -1]


def test_filter_is_the_dense_projection():
    generator = np.random.default_rng(3)
    linear = random_linear(generator)
    defect_sd, mean, sd = np.array([0.3, 0.02]), np.array([0.1, -0.2]), np.array([0.5, 2.0])
    chain = reduce_chain(linear, defect_sd, mean, sd)
    x, g, r = dense(linear, defect_sd, mean, sd)
    q, upper = np.linalg.qr(x)
    left = np.column_stack([g, r])
    left = left - q @ (q.T @ left)
    np.testing.assert_allclose(np.sum(chain.grams, axis=0), left.T @ left, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(
        np.sum(chain.log_dets), np.sum(np.log(np.abs(np.diag(upper)))), rtol=1e-10
    )
    step = np.array([0.3, -0.1, 0.2])
    whole = np.linalg.lstsq(x, r - g @ step, rcond=None)[0]
    np.testing.assert_allclose(chain.back(step).ravel(), whole[:8], rtol=1e-8, atol=1e-9)


def test_whitening_gives_the_dense_likelihood_with_gaps_in_the_data():
    generator = np.random.default_rng(5)
    time = np.cumsum(generator.uniform(0.5, 1.5, 40))
    values = generator.standard_normal(40)
    values[[3, 4, 17, 30]] = np.nan
    one = Record(
        name="r",
        time=time,
        inputs={"f": 0 * time},
        outputs={"q": values},
        sensors={"q": Sensor(name="q", sigma=0.7, correlation_time=2.0)},
    )
    segmented = segment_record(
        models.NOMINAL, one, {"q": Noise(0.7, 2.0)}, None, np.array([[0, 39]], dtype=np.intp)
    )
    white = segmented.whiten(segmented.measured)[0, :, 0]
    good = np.isfinite(values)
    cover = 0.49 * np.exp(-np.abs(time[good][:, None] - time[good][None, :]) / 2.0)
    expected = values[good] @ np.linalg.solve(cover, values[good])
    np.testing.assert_allclose(white @ white, expected, rtol=1e-10)
    _, log_det = np.linalg.slogdet(cover)
    weights = segmented.weight[0, good, 0]
    np.testing.assert_allclose(-2.0 * np.sum(np.log(weights)), log_det, rtol=1e-10)


def test_sensitivities_are_derivatives():
    one = models.record("r", 1.0, 1, samples=200)
    segments = choose_segments(one, 0.2)
    starts = models.NOMINAL.guess([one], [segments])[0]
    included, candidates = (Candidate(models.CUBIC),), (Candidate(models.DRY),)
    s = models.NOMINAL.sensitivities(
        [
            SensitivityRequest(
                one,
                models.TRUTH,
                segments,
                starts,
                included,
                np.array([500.0]),
                candidates=candidates,
            )
        ]
    )[0]

    def run(theta, x, cubic, dry):
        count = len(segments)
        jobs = Jobs(
            theta=np.tile(theta, (count, 1)),
            segments=segments,
            starts=x,
            included=(*included, *candidates),
            magnitudes=np.tile([cubic, dry], (count, 1)),
        )
        return models.NOMINAL.simulate(one, jobs).outputs

    h = 1e-5
    moved = models.TRUTH + np.array([0.0, h, 0.0])
    back = models.TRUTH - np.array([0.0, h, 0.0])
    by_k = (run(moved, starts, 500.0, 0.0) - run(back, starts, 500.0, 0.0)) / (2 * h)
    scale = np.nanmax(np.abs(by_k))
    np.testing.assert_allclose(s.d_theta[..., 1] / scale, by_k / scale, atol=1e-4)
    by_v = (
        run(models.TRUTH, starts + [0, h], 500.0, 0.0) - run(models.TRUTH, starts, 500.0, 0.0)
    ) / h
    np.testing.assert_allclose(s.d_starts[..., 1], by_v, atol=1e-4)
    by_dry = (run(models.TRUTH, starts, 500.0, 1e-6) - run(models.TRUTH, starts, 500.0, 0.0)) / 1e-6
    scale = np.nanmax(np.abs(by_dry))
    np.testing.assert_allclose(s.d_candidates[..., 0] / scale, by_dry / scale, atol=2e-3)


def test_fit_recovers_the_truth_within_its_intervals():
    data = models.records(2)[:2]
    segmented_records = tuple(
        segment_record(models.NOMINAL, r, {"q": Noise(1e-4)}, None) for r in data
    )
    fit = fit_problem(Problem(models.NOMINAL, segmented_records))
    assert fit.converged
    assert 0.85 < fit.chi2 / fit.dof < 1.15
    for row, truth in zip(fit.intervals(), models.TRUTH, strict=True):
        assert abs(row.value - truth) < 4.0 * row.sd
        assert row.sd < 0.05 * truth
        assert row.contraction > 0.9


@pytest.mark.parametrize("length", [0.05, 0.4])
def test_segments_cover_the_record_once(length):
    one = models.record("r", 1.0, 1, samples=300)
    segments = choose_segments(one, length)
    assert segments[0, 0] == 0
    assert segments[-1, 1] == 299
    np.testing.assert_array_equal(segments[1:, 0], segments[:-1, 1])
    assert np.all(segments[:, 1] > segments[:, 0])


def test_a_segment_in_a_wrong_valley_is_not_taken_for_a_gap():
    """A pendulum seen by the sine of its angle: half a turn more is another local minimum."""
    from dataclasses import replace as changed

    from feltmb.fit.linearize import Place
    from feltmb.fit.problem import Point

    from feltmb.gap import OdeModel, Parameter, State

    pendulum = OdeModel(
        states=[State(name="a", scale=1.0, start_sd=0.3), State(name="w", scale=3.0, start_sd=1.0)],
        parameters=[
            Parameter(name="g", value=20.0, sd=2.0),
            Parameter(name="d", value=0.3, sd=0.2),
        ],
        inputs=["f"],
        rates=lambda t, x, u, p: (x.w, u.f - p.g * np.sin(x.a) - p.d * x.w),
        outputs={"s": lambda t, x, u, p: np.sin(x.a)},
    )
    generator = np.random.default_rng(2)
    time = np.arange(600) * 0.01
    empty = Record(
        name="r", time=time, inputs={"f": 4.0 * np.sin(2.1 * time)}, outputs={"s": 0.0 * time}
    )
    jobs = Jobs(
        theta=np.array([[21.0, 0.25]]), segments=np.array([[0, 599]]), starts=np.array([[0.4, 0.0]])
    )
    clean = pendulum.simulate(empty, jobs).outputs[0, :, 0]
    one = changed(empty, outputs={"s": clean + 0.01 * generator.standard_normal(600)})
    segmented = segment_record(pendulum, one, {"s": Noise(0.01)}, 0.4)
    problem = Problem(pendulum, (segmented,))
    good = problem.start()
    starts = good.places[0].starts.copy()
    starts[6] = np.pi - starts[6]  # the same sine, the other branch
    starts[9] += [2.5, -4.0]
    bad = Point(good.theta, good.magnitudes, (Place(starts, good.places[0].nuisances),))
    fit = fit_problem(problem, point=bad)
    assert fit.chi2 < fit.dof + 4.0 * np.sqrt(2.0 * fit.dof)


def test_all_that_is_wrong_with_a_model_is_told_at_once():
    arm = Coordinate(name="arm", position="q", speed="v")
    with pytest.raises(InvalidParameter) as error:
        OdeModel(
            name="arm",
            states=[State(name="q"), State(name="v")],
            rates=lambda t, x, u, p: (x.v, -x.q),
            outputs={"q": "q"},
            coordinates=[arm, arm, Coupling(name="joint", first=arm, second=arm)],
            substeps=0,
        )
    text = str(error.value)
    for part in (
        "'arm' names two coordinates or ports",
        "coupling joint: lies between arm and itself",
        "substeps = 0, expected a whole number >= 1, or None",
    ):
        assert part in text
    # Arguments of a wrong kind are told before.
    given = {"states": [State(name="q")], "rates": lambda t, x, u, p: (x.q,), "outputs": {"q": "q"}}
    for name, value in (("method", "euler"), ("hold", "cubic"), ("substeps", 2.5)):
        with pytest.raises(InvalidParameter, match=f"{name}: got {value!r}, expected"):
            OdeModel(**given, **{name: value})


def test_a_parameter_far_off_its_prior_is_told():
    data = models.records(4)
    model = copy.copy(models.NOMINAL)
    model.parameters = tuple(
        replace(p, value=70.0, sd=1.0) if p.name == "k" else p for p in model.parameters
    )
    notes = fit_model(model, data).notes
    assert any("far from their priors" in note and "k by" in note for note in notes)


def test_an_accelerometer_feels_effects_and_unknown_forces():
    slide = Coordinate(name="slide", position="q", speed="v", inertia="m")
    model = OdeModel(
        states=[State(name="q", unit="m", start=0), State(name="v", unit="m/s", scale=1)],
        parameters=[Parameter(name="m", value=2.0), Parameter(name="k", value=100.0)],
        inputs=["f"],
        rates=lambda t, x, u, p: (x.v, (u.f - p.k * x.q) / p.m),
        outputs={"a": Rate("v"), "v": "v"},
        coordinates=[slide],
        substeps=4,
    )
    assert model.units == {"a": "m/s^2", "v": "m/s"}
    time = np.arange(401) * 2.5e-3
    record = Record(name="r", time=time, inputs={"f": np.sin(20.0 * time)}, outputs={"a": 0 * time})
    cube = library.polynomial_stiffness(slide, 3, scale=1.0)
    jobs = Jobs(
        theta=np.array([[2.0, 100.0]]),
        segments=np.array([[0, 400]]),
        starts=np.zeros((1, 2), dtype=int),
        included=(Candidate(cube),),
        magnitudes=np.array([[2e6]]),
        forces=np.array([[[0.0, 0.5]]]),
    )
    a, v = model.simulate(record, jobs).outputs[0].T
    assert np.allclose(a[1:-1], (v[2:] - v[:-2]) / 5e-3, atol=2e-3 * np.max(abs(a)))
    bare = replace(jobs, included=(), magnitudes=np.zeros((1, 0)), forces=None)
    without = model.simulate(record, bare).outputs[0, :, 0]
    assert np.max(abs(a - without)) > 0.2 * np.max(abs(a))
    with pytest.raises(InvalidParameter, match="output a: 'w' is no state; known are q, v"):
        OdeModel(
            states=[State(name="q"), State(name="v")],
            rates=lambda t, x, u, p: (x.v, -x.q),
            outputs={"a": Rate("w")},
        )


def test_the_unit_of_a_coordinate_agrees_with_that_of_its_state():
    """A pendulum whose coordinate has the default unit N got magnitudes in N s/m."""

    def turning(angle="rad", **of_coordinate):
        return OdeModel(
            states=[State(name="q", unit=angle), State(name="v", unit=f"{angle}/s")],
            rates=lambda t, x, u, p: (x.v, -x.q),
            outputs={"q": "q"},
            coordinates=[Coordinate(name="pivot", position="q", speed="v", **of_coordinate)],
        )

    with pytest.raises(InvalidParameter, match=r"position q has the unit rad, but a force in N mo"):
        turning()
    torques = ("N m", "Nm", "N*m", "kN m", "mN m", "rad/s^2")
    for good in (*({"unit": u} for u in torques), {"position_unit": "rad"}):
        turning(**good)
    turning("deg", unit="N m")
    turning("steps")
    turning("1")


@pytest.mark.parametrize(
    "noise", [Noise(0.3), Noise(0.3, correlation_time=4e-3), Noise(0.3, averaged=4)]
)
def test_drawn_noise_is_the_one_that_innovations_whiten(noise):
    time = 1e-3 * np.arange(20_000)
    drawn = noise.draw(time, np.random.default_rng(7))
    assert np.std(drawn) == pytest.approx(0.3, rel=0.05)
    lag = 2
    correlation = float(np.mean(drawn[lag:] * drawn[:-lag]) / np.mean(drawn**2))
    expected = 0.0
    if noise.correlation_time:
        expected = np.exp(-lag * 1e-3 / noise.correlation_time)
    elif noise.averaged > 1:
        expected = 1.0 - lag / noise.averaged
    assert correlation == pytest.approx(expected, abs=0.05)
    first = [noise.draw(time[:1], np.random.default_rng(s))[0] for s in range(400)]
    assert np.std(first) == pytest.approx(0.3, rel=0.15)
