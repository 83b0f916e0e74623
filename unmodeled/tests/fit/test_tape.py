"""Tracing of equations: operations, branches, derivatives, integrators, and what is refused."""

from __future__ import annotations

import math
import shutil
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from unmodeled import (
    Coordinate,
    Effect,
    Equations,
    Parameter,
    Rate,
    Record,
    Sensor,
    StartPrior,
    State,
    library,
)
from unmodeled.errors import InvalidParameter
from unmodeled.fit import SensitivityRequest
from unmodeled.models import Candidate, Jobs
from unmodeled.ode import batch, compile, compiled, step
from unmodeled.ode.methods import METHODS

MASS = Coordinate(name="mass", position="q", speed="v", inertia="m")
TIME = 5e-3 * np.arange(121)


@pytest.fixture(scope="session")
def extension(tmp_path_factory):
    """The compiled integrator: that of the package, or one that is compiled for the tests."""
    found = compiled.library()
    if found is None:
        if shutil.which("c++") is None and shutil.which("g++") is None:
            pytest.skip("no C++ compiler")
        found = compiled.loaded(compile.build(tmp_path_factory.mktemp("extension")))
    return found


@pytest.fixture(params=["numpy", "extension"])
def backend(request, monkeypatch):
    """Each integrator in turn."""
    found = None if request.param == "numpy" else request.getfixturevalue("extension")
    monkeypatch.setattr(compiled, "library", lambda: found)
    return request.param


def force(t):
    return 3.0 * np.sin(9.0 * t) + 2.0 * np.sin(31.0 * t + 1.0)


def make_model(rates=None, *, outputs=None, **options):
    own = rates or (lambda t, x, u, p: (x.v, (u.f - p.k * x.q - p.d * x.v) / p.m))
    return Equations(
        own,
        states=[State(name="q", unit="m", scale=0.01), State(name="v", unit="m/s", scale=0.1)],
        parameters=[
            Parameter(name="m", value=1.1, sd=0.1, unit="kg"),
            Parameter(name="k", value=90.0, sd=9.0, unit="N/m"),
            Parameter(name="d", value=0.6, sd=0.3, unit="N s/m"),
        ],
        inputs=["f"],
        outputs=outputs or {"q": "q", "v": "v", "a": Rate("v")},
        coordinates=[MASS],
        **{"hold": "linear", "substeps": 1, **options},
    )


def make_record(time=TIME, name="r", **fields):
    zeros = np.zeros(time.size)
    sensors = {"q": Sensor(name="q", unit="m", sigma=1e-5)}
    given = {"inputs": {"f": force(time)}, "outputs": {"q": zeros}, "sensors": sensors, **fields}
    return Record(name=name, time=time, **given)


def jobs_of(model, included=(), magnitudes=(), starts=None):
    start = [0.01, -0.05] + [h.start for t in included for h in t.effect.hidden]
    return Jobs(
        theta=np.array([[p.value for p in model.parameters]]),
        starts=np.array([start if starts is None else starts]),
        included=included,
        magnitudes=np.array([magnitudes], dtype=float),
    )


def request_of(model, record, included=(), magnitudes=(), **fields):
    jobs = jobs_of(model, included, magnitudes)
    return SensitivityRequest(
        record, jobs.theta[0], jobs.starts[0], included, jobs.magnitudes[0], **fields
    )


# ------------------------------------------------------------------------------- operations


SMOOTH = {
    "polynomial": lambda a, b: 2.0 + a - 3.0 * b + a * b / (1.0 + b) - (-a) ** 3 + a**2.5,
    "power": lambda a, b: a**b + 2.0**a + np.power(a, -1) + np.square(b) + np.reciprocal(a),
    "exp": lambda a, b: np.exp(a) * np.log(b) + np.expm1(a) - np.log1p(b) + np.sqrt(a),
    "log": lambda a, b: np.log10(a) + np.log2(b) + np.exp2(a),
    "sin": lambda a, b: np.sin(a) * np.cos(b) + np.tan(0.3 * a),
    "arc": lambda a, b: np.arcsin(0.3 * a) - np.arccos(0.2 * b) + np.arctan(a / b),
    "sinh": lambda a, b: np.sinh(a) + np.cosh(b) * np.tanh(a * b) + np.arcsinh(a),
    "arctanh": lambda a, b: np.arctanh(0.3 * a) + a * b,
    "array": lambda a, b: (np.array([[1.0, 2.0], [0.5, 1.0]]) @ np.array([a, b])).sum(),
    "sines": lambda a, b: np.sum(np.sin(np.array([a, b]) * np.array([0.5, 2.0]))),
}
#: Without a complex step: branches, steps and corners, away from where they are.
OTHER = {
    "abs": lambda a, b: abs(a - 2.0) + np.abs(b - a) + np.fabs(a) + np.hypot(a, b),
    "clip": lambda a, b: np.clip(a, 0.2, 0.9 * b) + np.minimum(a, b) - np.maximum(a, 1.1),
    "where": lambda a, b: np.where(a > b, a**2, np.where((a < 0.5) & (b >= 0.1), b, -b)),
    "logic": lambda a, b: ((a > 0.2) | ~(b > 5.0)) * a + np.logical_xor(a > b, b > a) * b,
    "sign": lambda a, b: np.sign(a - b) * a + np.floor(3.0 * b) * a + np.ceil(2.2 * a) * b,
    "modulo": lambda a, b: a % 0.3 + a // 0.3 + np.heaviside(a - b, 0.5) * b,
    "copysign": lambda a, b: np.copysign(a, b - a) + np.arctan2(a, -b) + np.isfinite(a),
    "interp": lambda a, b: np.interp(a, [0.0, 0.5, 1.0, 2.0], [0.0, 2.0, 1.0, 7.0]) * b,
    "angles": lambda a, b: np.deg2rad(a) + np.degrees(b) + np.full_like(a, 2.0) + np.ones_like(b),
    "branch": lambda a, b: (a if a > b else 3.0 * b) + max(a, 0.1) - min(b, a),
    "nested": lambda a, b: (a * b if b > 0.1 else a) if a > 0.0 and b < 5.0 else -a,
}


@pytest.mark.parametrize("names", [SMOOTH, OTHER], ids=["smooth", "other"])
def test_operations_and_their_derivatives(backend, names):
    """Values against NumPy; derivatives against complex steps, or against differences."""

    def shown(of):
        return lambda t, x, u, p: of(p.k * u.f, x.q)

    model = make_model(
        lambda t, x, u, p: (0.311 + 0.0 * x.q, 0.0),
        outputs={n: shown(of) for n, of in names.items()},
    )
    time = 0.1 * np.arange(20)
    record = make_record(time, inputs={"f": (1.03 + np.sin(time)) / 90.0})
    (s,) = model.sensitivities([request_of(model, record, by_theta=[1])])
    start, share = 0.01 + 0.311 * time, record.inputs["f"]
    for o, of in enumerate(names.values()):
        a, b = 90.0 * share, start
        wanted = np.array([float(of(*pair)) for pair in zip(a, b, strict=True)])
        np.testing.assert_allclose(s.outputs[:, o], wanted, rtol=1e-12, atol=1e-12)
        for move, found in (
            ((1.0, 0.0), s.d_theta[:, o, 0] / share),
            ((0.0, 1.0), s.d_starts[:, o, 0]),
        ):
            if names is SMOOTH:
                h = 1e-30
                changed = [
                    of(x + 1j * h * move[0], y + 1j * h * move[1])
                    for x, y in zip(a, b, strict=True)
                ]
                slope = np.imag(changed) / h
            else:
                h = 1e-7
                ends = [
                    [float(of(x + e * move[0], y + e * move[1])) for x, y in zip(a, b, strict=True)]
                    for e in (h, -h)
                ]
                slope = (np.array(ends[0]) - np.array(ends[1])) / (2.0 * h)
            np.testing.assert_allclose(found, slope, rtol=1e-6, atol=1e-6)


def test_both_integrators_agree(extension):
    """Values and derivatives with everything that a program may have, to 1e-12."""
    effects = (
        library.hysteresis(MASS, scale=0.3, travel=0.02),
        library.dry_friction(MASS, scale=0.3, speed=0.2),
        library.creep(MASS, scale=9.0, travel=0.1, times=(0.05, 0.5)),
        library.backlash(MASS, stiffness=90.0, travel=0.01),
    )
    candidates = tuple(Candidate(e, s) for e in effects for s in e.shapes)
    for method, hold in (("rk4", "spline"), ("rosenbrock", "zero")):
        model = make_model(method=method, hold=hold, substeps=2)
        program, kept = step.run, []

        def both(*given, kept=kept):
            kept.append((step.in_numpy(*given), step.Runs(*compiled.run(*given))))
            return kept[-1][1]

        included = (Candidate(effects[0], (0.004, 2.0)), candidates[5])
        requests = [
            request_of(model, make_record(TIME[:n]), included, (0.3, 0.2), candidates=candidates,
                       input_changes=({"f": np.cos(TIME[:n])},))
            for n in (121, 60, 90, 33, 77)
        ]  # fmt: skip
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(compiled, "library", lambda: extension)
            patch.setattr(batch, "run", both)
            model.sensitivities(requests)
        assert program is step.run
        for one, other in kept:
            for part in ("outputs", "derivatives", "states"):
                for a, b in zip(getattr(one, part), getattr(other, part), strict=True):
                    assert a.shape == b.shape
                    size = np.abs(a).max(axis=0, initial=0.0) + 1e-300
                    assert (np.abs(a - b) / size).max(initial=0.0) < 1e-12


KNOTS = np.linspace(-1.0, 1.0, 9)


def every_operation(t, x, u, p):
    """Rates with each operation of a tape; a branch that is not taken divides by zero."""
    q, v = x.q, x.v
    small = np.sin(q) + np.cos(v) * np.tan(0.1 * q) + np.tanh(v) + np.arctan(q) + np.sinh(0.1 * q)
    small = small + np.exp(-q * q) + np.expm1(-v * v) + np.log1p(q * q) + np.log(2.0 + q * q)
    small = small + np.arcsin(0.5 * np.tanh(q)) - np.arccos(0.5 * np.tanh(v)) + np.cosh(0.1 * v)
    small = small + np.arctan2(q, 1.0 + v * v) + np.sqrt(1.0 + abs(v)) + np.sign(v) * 0.1
    small = small + np.minimum(q, v) - np.maximum(q, 0.1) + np.floor(9.0 * q) * 0.01 + 0.1 * (q < v)
    small = small + np.where(q <= v, 0.1, -0.1) + (1.0 + q * q) ** (0.5 + 0.1 * u.f) * 0.1
    small = small + np.interp(q, KNOTS, KNOTS**3) + np.where(np.equal(q, 0.0), 1.0, u.f / q) * 1e-3
    return v, (u.f - p.k * q - p.d * v + 0.1 * small) / p.m


@pytest.mark.parametrize("count", [1, 3])
def test_plain_numbers_give_what_arrays_give(monkeypatch, count):
    monkeypatch.setattr(compiled, "library", lambda: None)
    model = make_model(every_operation, substeps=2)
    requests = [request_of(model, make_record(TIME[: 121 - 30 * k])) for k in range(count)]
    called = []

    def counted(*given, own=step.marched):
        called.append(own(*given))
        return called[-1]

    monkeypatch.setattr(step, "marched", counted)
    plain = model.sensitivities(requests)
    assert called
    assert all(path is not None for path in called)
    monkeypatch.setattr(step, "MOST", 0)
    arrays = make_model(every_operation, substeps=2).sensitivities(requests)
    for a, b in zip(plain, arrays, strict=True):
        np.testing.assert_allclose(a.outputs, b.outputs, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(a.d_theta, b.d_theta, rtol=1e-10, atol=1e-12)


def test_what_is_no_number_is_that_of_arrays(monkeypatch):
    """The root of a negative number: an exception of plain numbers, NaN from there on in arrays."""
    monkeypatch.setattr(compiled, "library", lambda: None)

    def rates(t, x, u, p):
        return x.v, (u.f - p.k * x.q - p.d * x.v * np.sqrt(0.05 - x.v)) / p.m

    requests = [request_of(make_model(rates), make_record())]
    (plain,) = make_model(rates).sensitivities(requests)
    monkeypatch.setattr(step, "MOST", 0)
    (arrays,) = make_model(rates).sensitivities(requests)
    assert np.isnan(plain.outputs).any()
    assert plain.outputs.tobytes() == arrays.outputs.tobytes()


def test_equal_calls_give_equal_bytes(backend):
    model = make_model()
    effect = library.hysteresis(MASS, scale=0.3, travel=0.02)
    one = request_of(model, make_record(), (Candidate(effect, (0.004, 2.0)),), (0.3,))
    others = [replace(one, theta=one.theta * f) for f in np.linspace(0.9, 1.1, 9)]
    (first,) = model.sensitivities([one])
    again = model.sensitivities([*others, one])[-1]
    fresh = make_model().sensitivities([one])[0]
    for other in (fresh, *([again] if backend == "extension" else [])):  # whatever comes with it
        assert first.outputs.tobytes() == other.outputs.tobytes()
        assert first.d_theta.tobytes() == other.d_theta.tobytes()


# ------------------------------------------------------------------------------ integration


def exact(rates, start, time=TIME):
    """SciPy's integration at 1e-10; the input is straight between samples, where it restarts."""
    path = [np.array(start, dtype=float)]
    f = force(time)
    for j in range(time.size - 1):
        slope = (f[j + 1] - f[j]) / (time[j + 1] - time[j])
        run = solve_ivp(
            lambda t, x, j=j, slope=slope: rates(x, f[j] + slope * (t - time[j])),
            time[j : j + 2], path[-1], "DOP853", rtol=1e-10, atol=1e-12,
        )  # fmt: skip
        path.append(run.y[:, -1])
    return np.array(path)


def smooth_friction(x, f):
    return x[1], (f - 90.0 * x[0] - 0.6 * x[1] - 0.4 * np.tanh(x[1] / 0.05)) / 1.1


def jumping_friction(x, f):
    return x[1], (f - 90.0 * x[0] - 0.6 * x[1] - 0.05 * np.sign(x[1])) / 1.1


def dead_zone(x, f):
    part = 60.0 * np.clip(x[0], -0.01, 0.01)
    return x[1], (f - 90.0 * x[0] - 0.6 * x[1] + part) / 1.1


def hysteretic(x, f):
    deflection = (x[0] - x[2]) / 0.01
    share = min(abs(deflection), 1.2) ** 2.0 if deflection * x[1] > 0.0 else 0.0
    push = 0.8 * np.clip(deflection, -1.2, 1.2)
    return x[1], (f - 90.0 * x[0] - 0.6 * x[1] - push) / 1.1, share * x[1]


SIGN = Effect(
    name="sign", component="mass", unit="N", sign=1,
    rate=lambda t, x, u, p, size, shape: {"v": -size * np.sign(x.v) / p.m},
)  # fmt: skip
CASES = {
    "smooth friction": (
        smooth_friction, library.dry_friction(MASS, scale=0.4, speed=1.0), 0.05, 0.4, 2e-7
    ),
    "jump": (jumping_friction, SIGN, None, 0.05, 1e-4),
    "dead zone": (
        dead_zone, library.backlash(MASS, stiffness=90.0, travel=0.1), 0.01, 60.0, 2e-6
    ),
    "hysteresis": (
        hysteretic, library.hysteresis(MASS, scale=0.8, travel=0.1), (0.01, 2.0), 0.8, 2e-6
    ),
}  # fmt: skip


@pytest.mark.parametrize("method", ["rk4", "rosenbrock"])
@pytest.mark.parametrize("case", CASES)
def test_motions_are_those_of_scipy(backend, case, method):
    rates, effect, shape, size, error = CASES[case]
    included = (Candidate(effect, shape),)
    model = make_model(method=method, substeps=8)
    jobs = jobs_of(model, included, (size,))
    path = model.motion(make_record(), jobs)[0]
    wanted = exact(rates, jobs.starts[0])
    errors = np.abs(path - wanted).max(axis=0) / np.abs(wanted).max(axis=0)
    assert errors.max() < (error if method == "rk4" else 2e-3), errors


def test_the_chosen_substeps_keep_the_error_below_the_noise(backend):
    """Within what the choice promises: the error is less than the noise of all samples together."""
    record = make_record(0.02 * np.arange(150), start=StartPrior(mean={"q": 0.01, "v": -0.05}))
    ready = make_model(substeps=None).ready([record])
    assert ready.notes == ()
    model = ready.model
    assert model.substeps > 1
    shown = model.simulate(record, jobs_of(model))[0]
    wanted = exact(
        lambda x, f: (x[1], (f - 90.0 * x[0] - 0.6 * x[1]) / 1.1), (0.01, -0.05), record.time
    )
    assert np.sqrt(np.sum((shown[:, 0] - wanted[:, 0]) ** 2)) < 1e-5


@pytest.mark.parametrize("substeps", [1, 3])
def test_derivatives_are_those_of_complex_steps(backend, substeps):
    """Of the same method, so that no error of it counts."""

    def rates(t, x, u, p):
        return x.v, (u.f - p.k * np.sin(x.q) - p.d * x.v * x.v - 0.2 * np.tanh(x.v / p.m)) / p.m

    model, record = make_model(rates, substeps=substeps), make_record()
    (s,) = model.sensitivities([request_of(model, record)])
    values, start = np.array([1.1, 90.0, 0.6]), np.array([0.01, -0.05])
    signals = batch._Tracks(model._system, model._traces)
    track = signals.of(record)

    def run(at):
        def slopes(t, x, held):
            m, k, d = at[:3]
            u = held[0]
            return np.array(
                [x[1], (u - k * np.sin(x[0]) - d * x[1] ** 2 - 0.2 * np.tanh(x[1] / m)) / m]
            )

        lanes = step.Lanes(
            np.zeros(1, dtype=int), [signals.times[track]], [signals.signals[track]],
            np.zeros((0, 1)), at[3:, None], np.zeros((0, 0)),
        )  # fmt: skip
        show = lambda t, x, u, k: np.array([*x, k[1]])  # noqa: E731
        return step.plain(slopes, show, np.ones(2), METHODS["rk4"], substeps, lanes).outputs[0]

    point = np.concatenate([values, start]).astype(complex)
    np.testing.assert_allclose(s.outputs, run(point).real, rtol=1e-11, atol=1e-13)
    ours = np.concatenate([s.d_theta, s.d_starts], axis=-1)
    for k in range(5):
        moved = point.copy()
        moved[k] += 1e-30j
        slope = run(moved).imag / 1e-30
        size = np.abs(slope).max(axis=0)
        assert (np.abs(ours[..., k] - slope) / size).max() < 1e-10


def test_shapes_and_magnitudes_are_differentiated(backend):
    """Against differences of simulations, for included effects and candidates."""
    from unmodeled.models.model import ShapeChange

    model, record = make_model(substeps=2), make_record()
    slip = library.hysteresis(MASS, scale=0.3, travel=0.02)
    drag = Effect(  # not linear in its magnitude
        name="drag", component="mass", unit="1", step=1e-4,
        rate=lambda t, x, u, p, size, shape: {"v": -np.expm1(size) * x.v * abs(x.v)},
    )  # fmt: skip
    included = (Candidate(slip, (0.01, 2.0)),)
    change = ShapeChange(0, (0.01 * (1 + 1e-6), 2.0), (0.01 * (1 - 1e-6), 2.0), 2e-6)
    wanted = request_of(
        model, record, included, (0.3,), candidates=(Candidate(drag),), shape_changes=(change,)
    )
    (s,) = model.sensitivities([wanted])

    def run(size=0.3, b=0.01, drag_size=0.0):
        own = (Candidate(slip, (b, 2.0)), Candidate(drag))
        return model.simulate(record, jobs_of(model, own, (size, drag_size)))[0]

    pairs = (
        (s.d_magnitudes[..., 0], (run(size=0.3 + 1e-5) - run(size=0.3 - 1e-5)) / 2e-5),
        (s.d_candidates[..., 0], (run(drag_size=1e-5) - run(drag_size=-1e-5)) / 2e-5),
        (-s.d_shapes[..., 0], (run(b=0.01 + 1e-7) - run(b=0.01 - 1e-7)) / 2e-7 * 0.01),
    )
    for ours, theirs in pairs:
        assert np.abs(ours - theirs).max() < 1e-5 * np.abs(theirs).max()


# ------------------------------------------------------------------- what cannot be traced


def sine_of_math(t, x, u, p):
    return x.v, (u.f - p.k * math.sin(x.q) - p.d * x.v) / p.m


def own_table(t, x, u, p):
    knots = np.linspace(-1.0, 1.0, 9)
    i = np.clip(np.searchsorted(knots, x.q) - 1, 0, 7)
    return x.v, (u.f - p.k * (knots[i] + (x.q - knots[i])) - p.d * x.v) / p.m


@pytest.mark.parametrize(
    ("rates", "same", "reason"),
    [
        (sine_of_math, lambda t, x, u, p: (x.v, (u.f - p.k * np.sin(x.q) - p.d * x.v) / p.m),
         "a number of Python is needed"),
        (own_table, None, "np.searchsorted cannot be traced"),
    ],
)  # fmt: skip
def test_what_cannot_be_traced_runs_as_it_is(rates, same, reason):
    record = make_record(TIME[:40])
    slow, fast = make_model(rates), make_model(same)
    (note,) = [n for n in slow.ready([record]).notes if "cannot be traced" in n]
    assert reason in note
    assert "of test_tape.py)" in note
    assert fast.ready([record]).notes == ()
    jobs = jobs_of(fast, (Candidate(SIGN),), (0.02,))
    np.testing.assert_allclose(
        slow.simulate(record, jobs), fast.simulate(record, jobs), rtol=1e-12, atol=1e-15
    )
    wanted = request_of(fast, record, candidates=(Candidate(SIGN),))
    (one,), (other,) = slow.sensitivities([wanted]), fast.sensitivities([wanted])
    for name in ("d_theta", "d_starts", "d_candidates"):
        ours, theirs = getattr(one, name), getattr(other, name)
        assert np.abs(ours - theirs).max() < 1e-4 * np.abs(theirs).max()


def test_an_effect_that_cannot_be_traced_leaves_the_others_traced(monkeypatch):
    own = Effect(
        name="own", component="mass", unit="N/m", step=1e-3,
        rate=lambda t, x, u, p, size, shape: {"v": -size * np.vectorize(math.sin)(x.q) / p.m},
    )  # fmt: skip
    drag = library.quadratic_friction(MASS, scale=1.0)
    model, record = make_model(), make_record(TIME[:40])
    both = (Candidate(own), Candidate(drag))
    (s,) = model.sensitivities([request_of(model, record, candidates=both)])
    (alone,) = model.sensitivities([request_of(model, record, candidates=both[1:])])
    np.testing.assert_array_equal(s.d_candidates[..., 1], alone.d_candidates[..., 0])
    np.testing.assert_array_equal(s.d_theta, alone.d_theta)
    runs = [model.simulate(record, jobs_of(model, both[:1], (z,)))[0] for z in (1e-3, -1e-3)]
    np.testing.assert_allclose(s.d_candidates[..., 0], (runs[0] - runs[1]) / 2e-3, atol=1e-9)


class Counter:
    """Rates with a state of their own."""

    calls = 0

    def __call__(self, _, x, u, p):
        self.calls += 1
        return x.v, (u.f - p.k * x.q) / p.m + 1e-3 * self.calls


RANDOM = np.random.default_rng()


@pytest.mark.parametrize(
    ("rates", "text"),
    [
        (Counter(), "its rates function differs between two equal calls: the rate of v is"),
        (lambda t, x, u, p: (x.v, u.f + RANDOM.normal()), "differs between two equal calls"),
        (lambda t, x, u, p: (x.v, np.log(x.q - 5.0)), "its rate of v at t = 0 s and q = 0, v = 0"),
        (lambda t, x, u, p: (x.v, 1j * x.q), "the rate of v is complex, expected a real number"),
        (lambda t, x, u, p: (x.v, np.zeros(7)), r"the rate of v has shape \(7,\), expected a numb"),
        (lambda t, x, u, p: (x.v,), "rates returned 1 values, expected one for each state: q, v"),
        (lambda t, x, u, p: (x.v, p.kk * x.q), r"no 'kk'; known are m, k, d \(line \d+ of test_t"),
    ],
)
def test_rates_of_no_use_are_told(rates, text):
    record = make_record(TIME[:20])
    with pytest.raises(InvalidParameter, match=text):
        make_model(rates).fit([record])


def test_too_many_branches_are_a_loop():
    def halved(t, x, u, p):
        q = x.q
        while q > 0.01:
            q = 0.5 * q
        return x.v, -q

    (note,) = [n for n in make_model(halved).ready([make_record()]).notes if "traced" in n]
    assert "or a loop, depend on values" in note


@pytest.mark.parametrize("sine", [np.sin, math.sin])
def test_equations_without_inputs_and_with_the_jobs_of_the_guide(backend, sine):
    """With and without a trace; magnitudes are not stated."""
    swing = Equations(
        lambda t, x, u, p: (-p.c * sine(x.a),),
        states={"a": (1.0, 0.1, "rad")},
        parameters={"c": (0.5, 0.1, "1/s")},
    )
    record = Record(name="r", time=TIME, inputs={}, outputs={"a": 0.0 * TIME})
    shown = swing.simulate(record, Jobs(theta=np.full((17, 1), 0.5), starts=np.ones((17, 1))))
    wanted = 2.0 * np.arctan(np.tan(0.5) * np.exp(-0.5 * TIME))
    np.testing.assert_allclose(shown[16, :, 0], wanted, rtol=1e-9)
    swing.sensitivities([SensitivityRequest(record, np.array([0.5]), np.array([1.0]))])


# ------------------------------------------------------------------------------ the extension


def test_an_extension_of_another_version_is_told(extension, monkeypatch):
    monkeypatch.setattr(compiled, "VERSION", compiled.VERSION + 1)
    with pytest.warns(
        RuntimeWarning, match="it is of another version; python -m unmodeled.ode.comp"
    ):
        assert compiled.loaded(extension._name) is None


def test_a_compiler_that_fails_is_told(monkeypatch, tmp_path):
    monkeypatch.setenv("CXX", "false")
    with pytest.raises(RuntimeError, match=r"^false -O3 .* fails"):
        compile.build(tmp_path)
    monkeypatch.delenv("CXX")
    monkeypatch.setattr("shutil.which", lambda _: None)
    with pytest.raises(RuntimeError, match="no C\\+\\+ compiler: got neither CXX nor c\\+\\+"):
        compile.build(tmp_path)


def test_derivatives_with_a_known_and_an_unknown_start_are_tested():
    model = Equations(
        lambda t, x, u, p: (x.v, u.F - p.k * x.q),
        states={"q": (0.0, 0.0, "m"), "v": (0.0, 0.1, "m/s")},
        parameters={"k": (20.0, 2.0, "1/s^2")},
        inputs={"F": "m/s^2"},
        outputs={"q": "q"},
    )
    sensors = {"q": Sensor(name="q", unit="m", sigma=1e-4)}
    record = Record(name="r", time=TIME, inputs={"F": np.sin(5.0 * TIME)},
                    outputs={"q": 0.0 * TIME}, sensors=sensors)  # fmt: skip
    request = SensitivityRequest(record, np.array([20.0]), np.zeros(2))
    two, changes = batch._moves(model, request)
    assert np.all(two.starts[:, 0] == 0.0)
    assert np.ptp(two.starts[:, 1]) > 0.0
    assert changes.shape == (3,)
    assert changes[1] == 0.0
