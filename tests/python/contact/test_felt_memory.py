"""The contact law with memory over random histories: bounds, passivity, memory, slopes."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

import feltmb
from feltmb import _core
from feltmb.contact import law

ACTION = feltmb.load_action("steinway45")
USABLE = [key for key in ACTION.config.contacts if key not in ("02", "16")]


def memory_law(key="01", **options):
    contact = ACTION.config.contacts[key]
    curves = {
        name: (c.a, c.b, c.c)
        for name, c in (("loading", contact.loading), ("unloading", contact.unloading))
    }
    return law("felt_memory", **curves, **options)


def envelope(key):
    contact = ACTION.config.contacts[key]
    return _core.Envelope.from_curves(
        *(_core.ExponentialCurve(c.a, c.b, c.c) for c in (contact.loading, contact.unloading))
    )


def history(legs, points=200):
    """Compressions through the legs' ends, beginning at zero."""
    ends = np.concatenate([[0.0], legs])
    parts = [np.linspace(a, b, points, endpoint=False) for a, b in zip(ends, legs, strict=False)]
    return np.concatenate([*parts, legs[-1:]])


legs = st.lists(st.floats(-0.1, 1.0), min_size=2, max_size=10)
contacts = st.sampled_from(USABLE)


@pytest.mark.parametrize("examples", [25, pytest.param(1000, marks=pytest.mark.slow)])
def test_bounds_and_passivity(examples):
    """0 <= F_U <= F <= F_L on every history, and the work never falls below the stored energy."""

    @settings(max_examples=examples, derandomize=True)
    @given(
        key=contacts,
        ends=legs,
        kappa=st.floats(0.005, 2.0),
        wiping=st.one_of(st.just(0.0), st.floats(0.01, 4.0)),
    )
    def check(key, ends, kappa, wiping):
        env = envelope(key)
        felt = memory_law(key, kappa=kappa, wiping_out=wiping)
        e = history(np.asarray(ends) * env.closing)
        path = _core.LawPath(felt.core)
        work, last_force, last_surplus = 0.0, 0.0, 0.0
        scale = float(env.loading(env.closing)) * env.closing
        for before, now in zip(np.concatenate([[0.0], e]), e, strict=False):
            force = path.step(now, 1e-3)
            top = float(env.loading(now))
            bottom = float(env.unloading(now, path.largest)) if path.largest > 0 else 0.0
            assert min(bottom, top) - 1e-9 <= force <= top + 1e-9
            work += 0.5 * (force + last_force) * (now - before)
            last_force = force
            stored = felt.core.evaluate(now, 0.0, list(path.state), path.largest)["stored_energy"]
            surplus = work - stored
            # The trapezoid of the work has an error of its own.
            assert surplus >= last_surplus - 2e-5 * scale
            last_surplus = max(last_surplus, surplus)

    check()


@settings(derandomize=True)
@given(key=contacts, ends=legs, slower=st.floats(1e-4, 1e4))
def test_rate_independent(key, ends, slower):
    e = history(np.asarray(ends) * envelope(key).closing)
    t = np.arange(len(e)) * 1e-5
    felt = memory_law(key)
    force = felt.path(e, t)
    assert np.max(np.abs(force - felt.path(e, t * slower))) <= 1e-12 * max(1.0, force.max())


@pytest.mark.parametrize("key", USABLE)
def test_virgin_loading_and_first_unloading_are_the_envelopes(key):
    env = envelope(key)
    up = np.linspace(0.0, env.closing, 300)
    force = memory_law(key).path(np.concatenate([up, up[::-1][1:]]), np.arange(599) * 1e-3)
    assert np.allclose(force[:300], env.loading(up), rtol=1e-12, atol=1e-12)
    assert np.allclose(force[300:], env.unloading(up[::-1][1:], env.closing), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("kappa", [0.05, 0.2, 2.0])
def test_the_loss_is_continuous_in_what_the_felt_remembers(kappa):
    """By hand: z rises to q in the small loop, and virgin loading wipes it out over c."""
    env, top = envelope("06"), 5e-4
    q = 1.0 - np.exp(-1.0 / kappa)

    def area(e_m):
        e = e_m * np.linspace(0.0, 1.0, 4001) ** 2
        return np.trapezoid(env.loading(e) - env.unloading(e, e_m), e)

    losses = []
    for before in top * np.array([0.0, 1e-4, 1e-3, 0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99, 1.0]):
        half = np.unique(np.append(top * (1.0 - np.linspace(1.0, 0.0, 4001) ** 2), before))
        e = np.concatenate([[0.0, before], half, half[::-1]])
        force = memory_law("06", kappa=kappa).path(e, np.arange(e.size))
        z = q * (area(before) / area(top)) ** (1.0 / kappa)
        expected = area(top) * (1.0 - kappa * q * z) - kappa * q * area(before)
        losses.append(np.trapezoid(force[2:], e[2:]) / area(top))
        assert losses[-1] == pytest.approx(expected / area(top), abs=1e-4)
    assert np.all(np.diff(losses) < 1e-6)
    assert losses[2] == pytest.approx(losses[0], abs=1e-4)


def test_a_law_that_goes_by_substeps_forgets_the_same():
    """A Kelvin element that hardly gives way leaves the law as it is."""
    e = history(5e-4 * np.array([0.7, 0.0, 0.8, 0.3, 1.0, 0.0]))
    creeping = memory_law("06", creep_stiffness=1e10, creep_damping=1e8)
    forces = [one.path(e, np.arange(e.size)) for one in (creeping, memory_law("06"))]
    assert np.max(np.abs(forces[0] - forces[1])) < 2e-3 * np.max(forces[1])


@pytest.mark.parametrize("key", USABLE)
def test_no_jump_at_a_reversal_and_return_point(key):
    env = envelope(key)
    top = 0.7 * env.closing
    felt = memory_law(key)
    for e in np.linspace(0.0, top, 200)[1:]:
        before = felt.step(e, 1e-3)
    after = felt.peek(top * (1.0 - 1e-10), 1e-3)
    assert abs(after - before) < 1e-6 * before
    for e in np.linspace(top, 0.3 * top, 200)[1:]:
        felt.step(e, 1e-3)
    for e in np.linspace(0.3 * top, top, 200)[1:]:
        back = felt.step(e, 1e-3)
    assert back == pytest.approx(float(env.loading(top)), rel=1e-9)


@pytest.mark.parametrize("share", [0.25, 0.5, 0.75, 1.0])
@pytest.mark.parametrize("key", USABLE)
def test_partial_loops_lose_a_like_share(key, share):
    """The unloading depends on the largest compression, and is monotone in the compression."""
    env = envelope(key)
    top = share * env.closing
    e = np.linspace(0.0, top, 2000)
    unloading = env.unloading(e, top)
    assert np.all(np.diff(unloading) >= -1e-12 * unloading.max())
    loss = float(env.loop_area(top)) / np.trapezoid(env.loading(e), e)
    assert 0.1 < loss < 0.6


@settings(derandomize=True)
@given(
    key=contacts,
    share=st.floats(0.05, 1.2),
    rate=st.floats(-2.0, 2.0).filter(lambda r: abs(r) > 1e-3),
    z=st.floats(0.0, 1.0),
    options=st.sampled_from(
        [
            {},
            {"kappa": 0.05, "wiping_out": 0.3},
            {"kappa": 0.05, "wiping_out": 0.3, "creep_stiffness": 2e5, "creep_damping": 300.0},
            {"creep_stiffness": 2e5, "creep_damping": 300.0},
            {"rate_amplitude": 0.2, "rate_time": 1e-3},
            {
                "creep_stiffness": 2e5,
                "creep_damping": 300.0,
                "rate_amplitude": 0.2,
                "rate_time": 1e-3,
            },
        ]
    ),
)
def test_slopes_are_exact(key, share, rate, z, options):
    """All derivatives against central differences, away from the change of branch."""
    env = envelope(key)
    core = memory_law(key, **options).core
    largest = 0.8 * env.closing
    state = [z, 0.02 * env.closing, 0.3 * float(env.loading(share * env.closing))]
    if "creep_stiffness" not in options:
        state = [z, state[2]]
    state = [*state, 0.0, 0.0][: core.n_states]
    e = share * env.closing
    inner = e - (state[1] if "creep_stiffness" in options else 0.0)
    if min(abs(inner - largest), abs(inner)) < 0.02 * env.closing:
        return

    def values(e, rate, state):
        v = core.evaluate(e, rate, list(state), largest)
        return np.array([v["force"], *v["state_rate"][: core.n_states]])

    got = core.evaluate(e, rate, state, largest)
    sizes = np.abs(values(e, rate, state)) + 1.0

    def check(analytic, difference, width):
        assert np.allclose(
            np.asarray(analytic) * width / sizes, np.asarray(difference) / sizes, atol=2e-6
        )

    h = 1e-5 * env.closing
    difference = (values(e + h, rate, state) - values(e - h, rate, state)) / 2
    check([got["d_compression"], *got["rate_by_compression"][: core.n_states]], difference, h)
    k = 1e-5 * abs(rate)
    difference = (values(e, rate + k, state) - values(e, rate - k, state)) / 2
    check([got["d_rate"], *got["rate_by_rate"][: core.n_states]], difference, k)
    for j in range(core.n_states):
        s = 1e-5 * max(abs(state[j]), 1e-3)
        up, down = list(state), list(state)
        up[j] += s
        down[j] -= s
        difference = (values(e, rate, up) - values(e, rate, down)) / 2
        column = [got["d_state"][j], *[row[j] for row in got["rate_by_state"][: core.n_states]]]
        check(column, difference, s)


def test_elastic_limit_conserves_energy():
    """Loading equals unloading: no loss, whatever the path."""
    curve = (5.52e3, 1.58e3, 0.0)
    e = np.linspace(0.0, 2e-3, 200)
    force = curve[0] * e * np.exp(curve[1] * e)
    felt = law("felt_memory", envelope=(e, force, force))
    path = history(np.array([1.0, 0.2, 1.6, 0.5, 0.0]) * 1e-3, 2000)
    work = np.trapezoid(felt.path(path, np.arange(len(path)) * 1e-3), path)
    assert abs(work) < 1e-6 * np.trapezoid(force, e)


def test_printed_law_depends_on_the_rate():
    """Why the printed law is not the default: its loss changes with the frequency (E18)."""
    contact = ACTION.config.contacts["01"]
    curves = {
        name: (c.a, c.b, c.c)
        for name, c in (("loading", contact.loading), ("unloading", contact.unloading))
    }
    printed = law("printed", **curves, alpha=100.0)
    top = envelope("01").closing
    losses = []
    for frequency in (0.03, 1.0, 30.0):
        t = np.linspace(0.0, 1.0 / frequency, 20001)
        e = 0.5 * top * (1.0 - np.cos(2 * np.pi * frequency * t))
        rate = np.pi * frequency * top * np.sin(2 * np.pi * frequency * t)
        force = printed.force(e, rate)
        loaded = np.trapezoid(force[:10001], e[:10001])
        losses.append(np.trapezoid(force, e) / loaded)
    assert losses == pytest.approx([0.0025, 0.0814, 0.3369], abs=2e-3)


@pytest.mark.parametrize("law_name", ["felt_memory", "guarded"])
def test_restart_goes_on_with_the_memory(law_name):
    """A run cut in two equals the uncut one, memory included."""
    action = ACTION.with_values(
        {"contacts.*.law": law_name, "shank.rigid": True, "wire.rigid": True, "string.modes": 10}
    )
    stroke = feltmb.ramp_stroke(25.0, 0.05, 0.0905, duration=0.12)
    whole = feltmb.simulate(action, stroke, rtol=1e-9)
    first = feltmb.simulate(action, stroke, 0.1, rtol=1e-9)
    second = feltmb.simulate(action, stroke.shifted(-0.1), 0.02, rtol=1e-9, start=first)
    n = len(action.coordinates)
    scale = np.asarray(action.mechanism.coordinate_scale)
    assert np.allclose(second.end_state[:n] / scale, whole.end_state[:n] / scale, atol=1e-3)


def test_stroke_with_memory_closes_the_ledger():
    action = ACTION.with_values({"contacts.*.law": "felt_memory"})
    run = feltmb.simulate(action, "piano", rtol=1e-8)
    assert run.energy["residual_relative"] < 1e-6
    assert run.energy["created_by"] == []
    assert 5 < run.stats["reversals"] < 500


def test_stulov_in_a_mechanism_closes_the_ledger():
    action = ACTION.with_values(
        {
            "contacts.06.law": "stulov",
            "contacts.06.stulov": {
                "stiffness": 4e8,
                "exponent": 2.5,
                "amplitude": 0.3,
                "time": 2e-5,
            },
        }
    )
    run = feltmb.simulate(action, "forte", rtol=1e-8)
    assert run.energy["residual_relative"] < 1e-6
    assert run.summary["impact_speed"] > 3.0


def test_creep_and_rate_term_close_the_ledger():
    action = ACTION.with_values(
        {
            "contacts.02.law": "felt_memory",
            "contacts.02.memory.creep_stiffness": 5e4,
            "contacts.02.memory.creep_damping": 100.0,
            "contacts.06.law": "felt_memory",
            "contacts.06.memory": {"rate_amplitude": 0.2, "rate_time": 1e-4},
            "contacts.03.law": "felt_memory",
            "contacts.03.memory": {"recovery_time": 0.05},
        }
    )
    run = feltmb.simulate(action, "forte", rtol=1e-8)
    assert run.energy["residual_relative"] < 1e-6


def by_its_equations(ends, kappa, K, p, s):
    """Compression, force and stored energy along F_L = K e^p, rho = x^s, by an ODE of z alone."""

    def area(m):
        return K * m ** (p + 1) * (1.0 / (p + 1) - 1.0 / (p + 1 + s))

    def band(e, m):
        e = np.maximum(e, 0.0)
        return K * e**p * (1.0 - (e / m) ** s)

    largest, z, rows = 0.0, 0.0, []
    for start, end in pairwise(ends):
        inside = [start, *([largest] if start < largest < end else []), end]
        for a, b in pairwise(inside):
            e, virgin = np.linspace(a, b, 400), b > a >= largest
            zs = np.zeros_like(e)
            if largest > 0.0 and virgin:
                rate = lambda x, y: -y * (p + 1) / (kappa * x)  # noqa: E731  # W'/W = (p + 1)/e_m
            elif largest > 0.0:
                target, m = float(b > a), largest
                sign = 1.0 if b > a else -1.0
                rate = lambda x, y, g=target, m=m, sign=sign: (  # noqa: E731
                    sign * band(x, m) / (kappa * area(m)) * (g - y)
                )
            if largest > 0.0:
                zs = solve_ivp(rate, (a, b), [z], t_eval=e, rtol=1e-9, atol=1e-12).y[0]
            z, m = float(zs[-1]), np.maximum(e, largest) if virgin else np.full(e.size, largest)
            held, inner = np.maximum(e, 0.0), band(e, np.maximum(m, 1e-30))
            low = np.maximum(m, 1e-30) ** -s * K * held ** (p + 1 + s) / (p + 1 + s)
            stored = 0.5 * (K * held ** (p + 1) / (p + 1) + low)
            stored += 0.25 * kappa * area(m) * (2.0 * zs - 1.0) ** 2
            rows.append(np.array([e, K * held**p - (1.0 - zs) * inner, stored]))
            largest = float(m[-1])
    return np.concatenate(rows, axis=1)


@pytest.mark.parametrize("kappa", [0.1, 2.0])
def test_an_independent_integration_of_the_equations(kappa):
    """Loops below, up to, and beyond the largest compression; a touch at the beginning."""
    K, p, s, end = 2e8, 2.3, 1.3, 1.2e-3
    random = np.random.default_rng(3)
    ends = [0.0, 2e-6, 0.0, 0.5, 0.2, 0.5, 0.6, 0.0, 0.599, 0.1, 0.8, -0.1, 0.85, 0.3, 1.0, 0.0]
    ends += [*random.uniform(0.0, 1.0, 8), 0.0]
    e, force, stored = by_its_equations(1e-3 * np.array(ends), kappa, K, p, s)
    grid = end * np.linspace(0.0, 1.0, 1501) ** 2
    felt = law(
        "felt_memory", kappa=kappa, envelope=(grid, K * grid**p, K * grid**p * (grid / end) ** s)
    )
    assert felt.path(e, np.arange(e.size)) == pytest.approx(force, abs=2e-6 * force.max())
    work = np.cumsum(0.5 * (force[1:] + force[:-1]) * np.diff(e))
    lost = np.diff(work - stored[1:], prepend=0.0)
    assert lost.min() > -1e-6 * work.max()  # of the quadrature


@pytest.mark.parametrize(("kappa", "wiping_out", "most"), [(0.2, 0.0, 0.057), (0.2, 0.2, 0.11)])
def test_a_cycle_inside_earlier_ones_returns_a_bounded_share_more_than_it_took(
    kappa, wiping_out, most
):
    """By hand, for a cycle over the area A of the loop from z = 0, u = exp(-A/c): it returns
    c [(1 - u)^2 + (1 - u) + ln u] more than it took, at most 0.0569 c at A = 0.7 c, c = kappa W."""
    made = law(
        "felt_memory", loading=(5520, 1580, -600), unloading=(190, 5040, 3040), kappa=kappa,
        wiping_out=wiping_out,
    )  # fmt: skip
    n = 400

    def work(*ends):
        """Work at each end of a path from 0 [J]."""
        parts = [np.linspace(a, b, n + 1)[1:] for a, b in pairwise((0.0, *ends))]
        e = np.concatenate([[0.0], *parts])
        force = made.path(e, 1e-3 * np.arange(e.size))
        steps = 0.5 * (force[1:] + force[:-1]) * np.diff(e)
        return np.concatenate([[0.0], np.cumsum(steps)])[::n]

    top, gains, shares = 1e-3, [], []
    area = work(top, 0.0)[2]
    for low in np.linspace(0.0, 0.9, 7):
        for high in np.linspace(low + 0.03, 1.0, 9):
            w = work(top, low * top, high * top, low * top, high * top, low * top, 0.0)
            gains.append((w[2] - w[4], w[4] - w[6]))
            shares.append(gains[-1][0] / (w[3] - w[2]))
            assert w[-1] > 0.0
    first, second = np.max(gains, axis=0)
    assert 0.85 * most < first / (kappa * area) < most * 1.01
    assert max(first, second) < 0.25 * kappa * area
    assert second < first
    assert 0.05 < max(shares) < (0.12 if wiping_out else 0.09)
