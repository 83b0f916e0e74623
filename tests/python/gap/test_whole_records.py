"""The fit of records in one go: how far they count, how long its steps are, where it ends."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from feltmb.fit import VARIABILITY, solve
from feltmb.fit.noise import Noise
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import segment_record
from feltmb.fit.solve import FOLLOWED, FitSettings, _agrees_until, _within, fit_problem
from feltmb.gap import Parameter, Record, Sensor, SimulatorModel

NOISE = 1e-2
TRUTH = {"rate": 1.25, "wall": 2.2, "loss": 0.6, "drag": 0.1}


def thrown(time, inputs, parameters):
    """A ball that flies to a wall and comes back slower; drag acts on the way back alone."""
    speed = parameters["rate"] * inputs["u"]
    hit = parameters["wall"] / speed
    after = np.maximum(time - hit, 0.0)
    back = parameters["loss"] * speed * after + parameters["drag"] * after**2
    return {"y": np.where(time < hit, speed * time, parameters["wall"] - back)}


def model(**change):
    priors = {"rate": (1.0, 0.2), "wall": (2.0, 0.2), "loss": (0.8, 0.2), "drag": (0.0, 0.2)}
    return SimulatorModel(
        thrown,
        parameters=[
            Parameter(name=n, value=v, sd=sd, lower=0.05 if n != "drag" else -np.inf)
            for n, (v, sd) in priors.items()
        ],
        inputs={"u": "1"},
        outputs={"y": "m"},
        **change,
    )


@pytest.fixture(scope="module")
def problem():
    m = model()
    records = []
    for seed, u in enumerate((1.0, 1.6)):
        time = np.arange(200) * 2e-2
        inputs = {"u": np.full(time.size, u)}
        y = thrown(time, inputs, TRUTH)["y"]
        y = y + NOISE * np.random.default_rng(seed).standard_normal(time.size)
        sensors = {"y": Sensor(name="y", sigma=NOISE)}
        records.append(
            Record(name=f"r{u}", time=time, inputs=inputs, outputs={"y": y}, sensors=sensors)
        )
    noise = {"y": Noise(NOISE)}
    return Problem(m, tuple(segment_record(m, r, noise, 0.5) for r in records))


def test_a_record_counts_as_far_as_the_motion_follows_it(problem):
    truth = np.array([TRUTH[p.name] for p in problem.model.parameters])

    def agrees(theta):
        seen = problem.predict(problem.start(theta=theta))
        return [
            _agrees_until(s, residual, FOLLOWED)
            for s, (_, residual, _) in zip(problem.segmented_records, seen, strict=True)
        ]

    assert agrees(truth) == [200, 200]
    other = truth.copy()
    other[2] = 0.9  # after the wall the ball is too fast; it is there at 1.76 s and 1.1 s
    slow, fast = agrees(other)
    assert 88 < slow < 98
    assert 55 < fast < 65


def test_what_is_after_the_end_of_a_beginning_does_not_count(problem):
    (segmented, _) = problem.segmented_records
    begun = segmented.until(73)
    assert np.sum(begun.samples) == 73
    assert np.all(np.isnan(begun.record.outputs["y"][73:]))


def test_a_step_is_no_longer_than_the_radius_in_prior_deviations(problem):
    point = problem.start()
    normal = problem.normal(point, problem.linear(point), np.zeros(0))
    sd = np.array([p.sd for p in problem.model.parameters])

    def length(delta):
        return float(np.linalg.norm(delta / sd))

    whole = problem.newton(point, normal)
    for radius in (0.01, 0.3, 0.9 * length(whole)):
        delta, told = _within(problem, point, normal, radius)
        assert told == pytest.approx(length(delta))
        assert 0.85 * radius < told <= radius
    np.testing.assert_allclose(_within(problem, point, normal, 2.0 * length(whole))[0], whole)


def test_fits_from_random_starts_end_where_the_fit_from_the_truth_ends(problem):
    everything = problem.model.parameters
    truth = np.array([TRUTH[p.name] for p in everything])
    best = fit_problem(problem, FitSettings(restarts=0), point=problem.start(theta=truth))
    assert best.explains
    assert best.converged
    generator = np.random.default_rng(5)
    for _ in range(8):
        theta = np.array([p.value + p.sd * generator.standard_normal() for p in everything])
        fit = fit_problem(
            problem,
            FitSettings(restarts=0),
            point=problem.start(theta=np.clip(theta, 0.1, None)),
        )
        assert fit.cost < best.cost + 0.1


def caught(_, inputs, parameters):
    """A part follows the input; above a gain of 1 it is caught, and held hard near 1.2."""
    gain = parameters["gain"]
    held = 20.0 * (1.2 - gain) if gain >= 1.0 else 0.0
    return {"y": gain * inputs["u"] + held}


def caught_problem(sigma):
    m = SimulatorModel(
        caught,
        parameters=[Parameter(name="gain", value=0.8, sd=0.3)],
        inputs={"u": "1"},
        outputs={"y": "1"},
    )
    time = np.linspace(0.0, 1.0, 200)
    y = 1.5 * time + sigma * np.random.default_rng(1).standard_normal(time.size)
    record = Record(
        name="r",
        time=time,
        inputs={"u": time},
        outputs={"y": y},
        sensors={"y": Sensor(name="y", sigma=sigma)},
    )
    return Problem(m, (segment_record(m, record, {"y": Noise(sigma)}, 0.5),))


def test_a_fit_crosses_a_jump_of_the_sum_of_squares(monkeypatch):
    problem = caught_problem(0.6)
    fit = fit_problem(problem, FitSettings(restarts=0))
    assert fit.point.theta[0] == pytest.approx(1.2, abs=0.05)
    assert fit.converged
    # Without the crossing it ends in front of the jump, 15 units of log evidence below.
    monkeypatch.setattr(solve, "CROSSINGS", 0)
    stuck = fit_problem(problem, FitSettings(restarts=0))
    assert 0.95 < stuck.point.theta[0] < 1.0
    assert not stuck.converged
    assert stuck.cost > fit.cost + 20.0


def test_the_step_across_a_jump_does_not_extend_the_variability():
    """It has no unit of length; 60 times its step would end the simulation instead."""

    def shaken(time, inputs, parameters):
        shift = parameters["shift"]
        y = caught(time, inputs, parameters)["y"] + 0.6 * shift
        return {"y": y if abs(shift) < 2.0 else np.full(time.size, np.nan)}

    easy = caught_problem(0.6)
    m = SimulatorModel(
        shaken,
        parameters=[
            Parameter(name="gain", value=0.8, sd=5.0),
            Parameter(name="shift", value=0.0, sd=1.0, component=VARIABILITY),
        ],
        inputs={"u": "1"},
        outputs={"y": "1"},
    )
    fit = fit_problem(Problem(m, easy.segmented_records), FitSettings(restarts=0))
    assert fit.converged
    assert fit.point.theta[0] == pytest.approx(1.2, abs=0.05)


def test_a_fit_along_the_records_extends_little_beyond_what_the_model_follows(problem, monkeypatch):
    """Each beginning ends at most a thirty-second of the record after what was followed."""
    followed, ends = [], []
    agrees, optimize = solve._agrees_until, solve._optimize

    def watched_agrees(segmented, residual, limit):
        count = agrees(segmented, residual, limit)
        followed.append(count)
        return count

    def watched_optimize(part, *more):
        ends.append([int(np.sum(s.samples)) for s in part.segmented_records])
        return optimize(part, *more)

    monkeypatch.setattr(solve, "_agrees_until", watched_agrees)
    monkeypatch.setattr(solve, "_optimize", watched_optimize)
    fit = fit_problem(problem, FitSettings(restarts=0))
    assert fit.explains
    pairs = [followed[i : i + 2] for i in range(0, len(followed), 2)]
    assert len(ends) >= 3  # two beginnings at least, and the whole
    begun = [0, 0]
    for reached, end in zip(pairs, ends, strict=False):
        for k in range(2):
            if reached[k] >= begun[k]:
                assert end[k] <= reached[k] + np.ceil(200 / 64)
        begun = end


def test_a_fit_ends_when_two_paths_reach_the_same_minimum(problem, monkeypatch):
    """The first path ends at a ball that never reaches the wall, where no derivative shows it."""
    along, lengths, lost = solve._led, [], [1]

    def led(part, point, settings, **_):
        lengths.append(len(part.segmented_records))
        if len(lengths) in lost:
            return problem.start(theta=np.array([0.06, 9.0, 0.8, 0.0]))
        found = along(part, point, settings)
        # Two paths never end at exactly the same start.
        return replace(found, theta=found.theta * (1.0 + 1e-9 * len(lengths)))

    monkeypatch.setattr(solve, "_led", led)
    stuck = fit_problem(problem, FitSettings(restarts=0))
    assert not stuck.plausible
    assert lengths == [2]
    lengths.clear()
    fit = fit_problem(problem, FitSettings())
    assert fit.plausible
    assert fit.cost < stuck.cost
    assert lengths == [2, 1, 2, 1, 2]  # each record joins last once
    lengths.clear()
    lost.clear()
    assert fit_problem(problem, FitSettings()).cost == pytest.approx(fit.cost, abs=0.1)
    assert lengths == [2, 1, 2]


def test_a_single_record_has_a_second_path(problem, monkeypatch):
    along, limits = solve._led, []

    def led(part, point, settings, limit=solve.FOLLOWED, *_, **__):
        limits.append(limit)
        if len(limits) == 1:
            return part.start(theta=np.array([0.06, 9.0, 0.8, 0.0]))
        return along(part, point, settings, limit)

    monkeypatch.setattr(solve, "_led", led)
    one = replace(problem, segmented_records=problem.segmented_records[1:])
    assert fit_problem(one, FitSettings()).explains
    assert limits == [solve.FOLLOWED, solve.FOLLOWED_FURTHER]


def test_paths_are_not_more_than_restarts(problem, monkeypatch):
    left_out = []
    monkeypatch.setattr(solve, "_led", lambda part, *_, **__: part.start())
    monkeypatch.setattr(solve, "_led_without", lambda *a: left_out.append(a[3]) or problem.start())
    four = replace(problem, segmented_records=problem.segmented_records * 2)
    monkeypatch.setattr(solve, "polish", lambda p, *_: lost)
    lost = SimpleNamespace(cost=1e9, explains=False, point=four.start(), problem=four)
    monkeypatch.setattr(solve, "_across_jumps", lambda fit, _: fit)
    solve._fit_whole(four, four.start(), FitSettings(restarts=3), None)
    assert len(left_out) == 3


def test_the_record_that_is_explained_worst_joins_last(problem, monkeypatch):
    left_out = []
    without = solve._led_without

    def led(part, point, settings, which, tell=None):
        left_out.append(which)
        return without(part, point, settings, which, tell)

    monkeypatch.setattr(solve, "_led_without", led)
    for worst in (0, 1):
        records = tuple(
            replace(s, measured=s.measured + (5.0 * NOISE if i == worst else 0.0))
            for i, s in enumerate(problem.segmented_records)
        )
        left_out.clear()
        fit_problem(replace(problem, segmented_records=records), FitSettings())
        assert left_out[0] == worst


def test_a_start_that_two_paths_give_is_fitted_once(problem, monkeypatch):
    ends = []
    minimize = solve.polish
    truth = np.array([TRUTH[p.name] for p in problem.model.parameters])

    def polish(part, *rest):
        ends.append(len(part.segmented_records))
        return minimize(part, *rest)

    monkeypatch.setattr(solve, "_led", lambda part, *_, **__: part.start(theta=truth))
    monkeypatch.setattr(solve, "polish", polish)
    assert fit_problem(problem, FitSettings(jumps=False)).plausible
    assert ends.count(2) == 1  # all records


def test_a_fit_without_priors_is_plausible_if_it_explains_and_is_not_repeated(problem, monkeypatch):
    free = model()
    free.parameters = tuple(replace(p, sd=np.inf) for p in free.parameters)
    own = replace(problem, model=free)
    start = own.start(theta=np.array([TRUTH[p.name] for p in free.parameters]))
    monkeypatch.setattr(solve, "_led", lambda *_: pytest.fail("repeated"))
    fit = fit_problem(own, FitSettings(), point=start)
    assert fit.explains
    assert fit.plausible
