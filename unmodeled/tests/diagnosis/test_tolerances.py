"""Two readings of a tolerance, parameters that changed, and what is left without a change."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from unmodeled import Effect, Options, Parameter, Record, Sensor, Verdict, diagnose
from unmodeled.fit import LinearModel
from unmodeled.search.problem import NARROW
from unmodeled.search.tolerances import Configuration, Posterior, _widened, mixture
from unmodeled.search.verdict import _told


def linear(columns, truth, noise=0.1, seed=0):
    """Normal equations of a linear fit: A, b, and what was measured."""
    measured = columns @ truth + noise * np.random.default_rng(seed).normal(size=len(columns))
    return columns.T @ columns / noise**2, columns.T @ measured / noise**2, measured


def alike(n, samples=60):
    """Columns that act alike, so that a fit spreads a change over them."""
    columns = np.random.default_rng(1).normal(size=(samples, n))
    return columns + 3.0 * columns[:, :1]


def brute_force(columns, measured, noise, tested, tolerances):
    """Probability, mean and covariance of each configuration, from the densities of the samples."""
    n, g, found = len(tested), columns.shape[1], {}
    for wide in itertools.chain.from_iterable(
        itertools.combinations(tested, k) for k in range(n + 1)
    ):
        prior = np.ones(g)
        prior[[k for k in tested if k not in wide]] = NARROW**2
        density = multivariate_normal(
            cov=columns @ np.diag(prior) @ columns.T + noise**2 * np.eye(len(columns))
        ).logpdf(measured)
        share = 1.0 / max(n, 2)
        kept = share ** len(wide) * (1.0 - share) ** (n - len(wide)) if len(wide) < n else 0.0
        drawn = float(len(wide) == n)
        log = density + np.log({"kept": kept, "drawn": drawn, "auto": kept + drawn}[tolerances]
                               or 1e-300)  # fmt: skip
        gain = (
            np.diag(prior)
            @ columns.T
            @ np.linalg.inv(columns @ np.diag(prior) @ columns.T + noise**2 * np.eye(len(columns)))
        )
        found[frozenset(wide)] = log, gain @ measured, np.diag(prior) - gain @ columns * prior
    log = np.array([v[0] for v in found.values()])
    weight = np.exp(log - log.max())
    weight /= weight.sum()
    return {w: (p, m, c) for (w, (_, m, c)), p in zip(found.items(), weight, strict=True)}


@pytest.mark.parametrize("tolerances", ["auto", "kept", "drawn"])
@pytest.mark.parametrize("changed", [{}, {1: 1.5}, {0: 0.4, 2: -0.2}, {0: 1.0, 1: -0.8, 3: 0.9}])
@pytest.mark.parametrize("n", [1, 2, 4, 6])
def test_the_mixture_is_that_of_all_configurations(n, changed, tolerances):
    """With a further unknown that has no tolerance, such as the size of an effect."""
    columns = alike(n + 1, 12)
    truth = np.array([*(changed.get(k, 0.0) for k in range(n)), 0.7])
    matrix, right, measured = linear(columns, truth, 0.3)
    own = mixture(matrix, right, np.ones(n + 1), range(n), tolerances)
    exact = brute_force(columns, measured, 0.3, range(n), tolerances)
    for c, weight in zip(own.configurations, own.weight, strict=True):
        p, mean, covariance = exact[c.wide]
        assert weight == pytest.approx(p, abs=3e-3)
        np.testing.assert_allclose(c.mean, mean, atol=1e-7)
        np.testing.assert_allclose(c.covariance, covariance, atol=1e-7)
    assert sum(exact[c.wide][0] for c in own.configurations) > 0.997
    mean = sum(p * m for p, m, _ in exact.values())
    whole = sum(p * (c + np.outer(m - mean, m - mean)) for p, m, c in exact.values())
    np.testing.assert_allclose(own.mean, mean, atol=5e-3)
    np.testing.assert_allclose(own.covariance, whole, atol=5e-3)
    assert own.drawn == pytest.approx(
        exact[frozenset(range(n))][0] if tolerances != "kept" else 0.0, abs=3e-3
    )


def test_one_more_wide_prior_costs_one_division():
    columns = alike(5)
    matrix, right, _ = linear(columns, np.array([0.3, 1.2, 0.0, -0.6, 0.1]))
    prior = np.ones(5)

    def solved(wide):
        own = np.where([k in wide for k in range(5)], prior, prior / NARROW**2)
        covariance = np.linalg.inv(matrix + np.diag(own))
        mean = covariance @ right
        log = 0.5 * (right @ mean + np.linalg.slogdet(covariance)[1] + np.log(own).sum())
        return Configuration(frozenset(wide), 0.0, log, mean, covariance)

    for wide in ((), (1,), (1, 3)):
        now, rest = solved(wide), [k for k in range(5) if k not in wide]
        gains = _widened(now, prior, rest)
        for k in rest:
            assert gains[k] == pytest.approx(
                solved((*wide, k)).log_evidence - now.log_evidence, abs=1e-8
            )


def test_an_interval_is_that_of_the_whole_mixture():
    rng, count = np.random.default_rng(2), 200_000
    configurations = tuple(
        Configuration(frozenset(w), 0.0, math.log(p), np.array([m]), np.array([[sd**2]]))
        for w, p, m, sd in (((0,), 0.6, 1.0, 0.3), ((), 0.3, 0.0, 0.05), ((0, 1), 0.1, 4.0, 1.0))
    )
    own = Posterior((0, 1, 2), configurations)
    chosen = rng.choice(3, size=count, p=own.weight)
    means = np.array([c.mean[0] for c in configurations])[chosen]
    sds = np.array([c.covariance[0, 0] ** 0.5 for c in configurations])[chosen]
    drawn = means + sds * rng.normal(size=count)
    mean, low, high = own.interval(0)
    assert mean == pytest.approx(drawn.mean(), abs=0.01)
    assert np.mean(drawn < low) == pytest.approx(0.025, abs=0.0015)
    assert np.mean(drawn > high) == pytest.approx(0.025, abs=0.0015)
    assert own.covariance[0, 0] == pytest.approx(drawn.var(), rel=0.02)
    # Given that it changed: the first and the last.
    some = drawn[chosen != 1]
    mean, low, high = own.interval(0, (0,))
    assert mean == pytest.approx(some.mean(), abs=0.01)
    assert np.mean(some < low) == pytest.approx(0.025, abs=0.002)
    assert np.mean(some > high) == pytest.approx(0.025, abs=0.002)
    # A single normal distribution: the usual interval.
    assert Posterior((0, 1, 2), configurations[:1]).interval(0)[1:] == pytest.approx(
        (1.0 - 1.95996 * 0.3, 1.0 + 1.95996 * 0.3), abs=1e-4
    )


def told(own, credibility=0.9):
    """Parameters that changed, and classes of which one did."""
    return _told(own.sets(), own.weight, credibility)


@pytest.mark.parametrize("changed", [{}, {3: 1.5}, {3: 1.5, 8: -2.0}])
def test_the_parameters_that_changed_are_found_among_many(changed):
    columns = alike(10)
    truth = np.array([changed.get(k, 0.0) for k in range(10)])
    matrix, right, _ = linear(columns, truth)
    own = mixture(matrix, right, np.ones(10), range(10))
    names, classes = told(own)
    assert ({*names}, classes) == ({*changed}, [])
    assert own.drawn < 0.1
    ends = np.array([own.interval(k)[1:] for k in range(10)])
    assert np.sum((ends[:, 0] < truth) & (truth < ends[:, 1])) >= 9
    assert {*changed} <= {*np.flatnonzero((ends[:, 0] > 0.0) | (ends[:, 1] < 0.0)).tolist()}
    # A new machine has no parameter that did not change: the interval is wider.
    wide = mixture(matrix, right, np.ones(10), range(10), "drawn")
    assert np.all(np.diag(wide.covariance) > np.diag(own.covariance))
    assert (told(wide), wide.drawn) == (([], []), 1.0)


def test_if_all_parameters_deviate_none_keeps_its_value():
    columns = np.random.default_rng(1).normal(size=(60, 8))
    truth = np.array([0.9, -0.6, 1.3, 0.4, -1.1, 0.7, -0.5, 1.6])
    matrix, right, _ = linear(columns, truth)
    own = mixture(matrix, right, np.ones(8), range(8))
    assert own.drawn > 0.9
    assert told(own) == ([], [])
    kept = mixture(matrix, right, np.ones(8), range(8), "kept")
    assert kept.drawn == 0.0
    assert {*told(kept)[0]} >= {0, 2, 4, 7}


def test_parallel_parameters_are_a_class():
    columns = np.random.default_rng(1).normal(size=(60, 6))
    columns[:, 5] = columns[:, 2]
    matrix, right, _ = linear(columns, 1.5 * np.eye(6)[2])
    own = mixture(matrix, right, np.ones(6), range(6))
    names, (group,) = told(own)
    assert (names, sorted(group)) == ([], [2, 5])
    # Neither surely changed; if one did, it changed by all of it.
    for k in (2, 5):
        _, low, high = own.interval(k)
        assert low < 0.0 < high
        _, low, high = own.interval(k, (k,))
        assert low < 1.5 < high


def machine(twice=False, **truth):
    """y = a u + b u^2 + c u^3; the records have other numbers; ``twice``: d does what a does."""
    names = ["a", "b", "c", "d"] if twice else ["a", "b", "c"]
    powers = {"a": 1, "b": 2, "c": 3, "d": 1}
    values = dict.fromkeys(names, 1.0)

    parameters = [Parameter(name=n, value=v, sd=0.1, label=f"The {n}") for n, v in values.items()]
    columns = {n: lambda r, power=powers[n]: r.inputs["u"] ** power for n in names}
    model = LinearModel(output="y", columns=columns, parameters=parameters)
    rng, records = np.random.default_rng(3), []
    for k in range(4):
        u = np.sin(np.linspace(0.0, 6.0 + k, 200))
        y = sum((values | truth)[n] * u ** powers[n] for n in names)
        records.append(
            Record(
                name=f"r{k}",
                time=np.linspace(0.0, 1.0, 200),
                inputs={"u": u},
                outputs={"y": y + 0.01 * rng.normal(size=200)},
                sensors={"y": Sensor(name="y", sigma=0.01)},
            )
        )
    return model, records


def constant(records, size=0.3):
    """The records of a machine with a constant, and the effect that is one."""
    more = Effect(name="more", component="c", regressor=lambda r, _: np.ones(r.time.size))
    return [replace(r, outputs={"y": r.outputs["y"] + size}) for r in records], more


def test_a_parameter_within_its_tolerance_is_the_answer():
    model, records = machine(b=1.15)
    report = diagnose(model, [], records, hold_out=["r3"])
    assert report.verdict is Verdict.CALIBRATED
    (change,) = report.changes
    assert (change.name, change.tier, change.within) == ("b", "fitted", True)
    assert change.low < 0.15 < change.high
    assert report.drawn < 0.1  # one of three changed
    # Without it, 0.15 u^2 is missing; a and c cannot stand for it.
    u = np.concatenate([r.inputs["u"] for r in records])
    missing = 0.15 * np.sqrt(np.mean(u**4))
    assert change.takes * report.channels[0].motion == pytest.approx(missing, rel=0.05)


def test_equivalent_parameters_are_one_change():
    model, records = machine(twice=True, a=1.15)
    report = diagnose(model, [], records, hold_out=())
    (change,) = report.changes
    assert {change.name, *(e.name for e in change.equivalents)} == {"a", "d"}
    # It alone, or each by a half: the interval holds both.
    assert change.low < 0.075 < change.size < 0.15 < change.high


def test_nothing_changed_nothing_is_listed():
    model, records = machine()
    report = diagnose(model, [], records, hold_out=["r3"])
    assert report.changes == ()
    assert report.changed == ()
    assert report.summary().startswith("No cause is missing: ")


def test_a_cause_that_takes_nothing_away_is_not_listed():
    model, records = machine(b=1.15)
    slope = Effect(name="more", component="c", regressor=lambda r, _: r.inputs["u"] ** 4)
    report = diagnose(model, [slope], records, hold_out=["r3"])
    assert [c.name for c in report.changes] == ["b"]


def test_all_changes_of_a_kind_leave_the_same():
    """The list is of one fitted set, and so is the channel."""
    model, records = machine(a=0.8, b=1.2)
    records, more = constant(records)
    nothing = Effect(name="nothing", component="c", regressor=lambda r, _: np.cos(40.0 * r.time))
    report = diagnose(model, [nothing, more], records, hold_out=["r3"])
    found = {c.name: c for c in report.changes}
    assert {c.name: c.tier for c in report.changes} == {
        "more": "named",
        "a": "fitted",
        "b": "fitted",
    }
    (c,) = report.channels
    for change in found.values():
        assert change.after == pytest.approx(c.share(c.explained), rel=1e-9)


def test_what_the_model_does_not_allow_comes_before_parameters_within_their_tolerances():
    model, records = machine(a=0.85, b=1.2)
    records, more = constant(records, 0.05)
    report = diagnose(model, [more], records, hold_out=["r3"])
    effect, *others = report.changes
    assert [effect.name, *sorted(c.name for c in others)] == ["more", "a", "b"]
    assert all(c.within and c.takes > effect.takes for c in others)
    assert "and 1 more parameter differs within its tolerance: with all 3" in report.summary()


def test_without_a_single_cause_the_calibrated_model_remains():
    """b takes up a part of a constant; what it can take up is not taken away by the constant."""
    model, records = machine()
    records, more = constant(records)
    drawn = Options(tolerances="drawn")
    (change,), (c,) = (
        (r := diagnose(model, [more], records, hold_out=["r3"], options=drawn)).changes, r.channels
    )  # fmt: skip
    assert change.before == pytest.approx(c.share(c.calibrated), rel=1e-9)
    assert change.after == pytest.approx(c.share(c.explained), rel=1e-9)
    assert change.before * c.motion < 0.25  # all of it would be 0.3
    # It is what nothing else can do, whichever reading of the tolerances holds.
    (kept,) = diagnose(model, [more], records, hold_out=["r3"]).changes
    assert kept.before == pytest.approx(change.before, rel=1e-9)


def test_without_one_of_two_causes_least_squares_of_the_rest_remain():
    model, records = machine()
    waves = [
        Effect(name=name, component="c", regressor=lambda r, _, w=w: np.cos(w * r.time))
        for name, w in (("slow", 9.0), ("fast", 40.0))
    ]
    records = [
        replace(r, outputs={"y": r.outputs["y"] + sum(0.2 * e.regressor(r, None) for e in waves)})
        for r in records
    ]
    drawn = Options(tolerances="drawn")
    found = {c.name: c for c in diagnose(model, waves, records, hold_out=(), options=drawn).changes}
    assert set(found) == {"slow", "fast"}
    y = np.concatenate([r.outputs["y"] for r in records])
    motion = np.sqrt(np.mean([np.var(r.outputs["y"]) for r in records]))
    u = np.concatenate([r.inputs["u"] for r in records])
    for lost, kept in (("slow", waves[1]), ("fast", waves[0])):
        wave = np.concatenate([kept.regressor(r, None) for r in records])
        columns = np.column_stack([u, u**2, u**3, wave])
        left = y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0]
        assert found[lost].before * motion == pytest.approx(np.sqrt(np.mean(left**2)), rel=1e-3)


def test_an_effect_that_parameters_can_imitate_is_small():
    """Without it, fitted parameters leave little: it is told, and takes away what they cannot."""
    model, records = machine()
    fifth = Effect(name="more", component="c", regressor=lambda r, _: r.inputs["u"] ** 5)
    records = [
        replace(r, outputs={"y": r.outputs["y"] + 0.1 * r.inputs["u"] ** 5}) for r in records
    ]
    drawn = Options(tolerances="drawn")
    report = diagnose(model, [fifth], records, hold_out=["r3"], options=drawn)
    (change,), (c,) = report.changes, report.channels
    assert (change.name, change.tier, change.matters) == ("more", "small", False)
    assert change.low < 0.1 < change.high
    assert change.before == pytest.approx(c.share(c.calibrated), rel=1e-9)
    assert change.takes * c.motion == pytest.approx(
        math.sqrt(c.calibrated**2 - c.explained**2), rel=1e-6
    )
    assert "The effect more has a size of" in report.summary()
    assert "this is small" in report.summary()
    assert report.verdict is Verdict.CALIBRATED


def test_without_a_parameter_no_other_one_stands_for_it():
    """c could replace most of a; the answer is that a has changed, and c has not."""
    model, records = machine(a=1.2)
    report = diagnose(model, [], records, hold_out=["r3"])
    (change,) = report.changes
    u = np.concatenate([r.inputs["u"] for r in records])
    left = np.sqrt(np.mean((0.2 * u) ** 2) + 0.01**2)
    assert change.name == "a"
    assert change.before * report.channels[0].motion == pytest.approx(left, rel=0.01)
    # The parameters of a new machine would follow: only what they cannot replace is taken away.
    drawn = diagnose(model, [], records, hold_out=["r3"], options=Options(tolerances="drawn"))
    columns = np.column_stack([u**2, u**3])
    y = 0.2 * u - columns @ np.linalg.lstsq(columns, 0.2 * u, rcond=None)[0]
    first = next(c for c in drawn.changes if c.name == "a")
    assert first.before * drawn.channels[0].motion == pytest.approx(
        np.sqrt(np.mean(y**2) + 0.01**2), rel=0.05
    )


def test_what_acts_in_the_held_out_records_only_is_told():
    model, records = machine()
    (late,), _ = constant(records[3:])
    report = diagnose(model, [], [*records[:3], late], hold_out=["r3"])
    (c,) = report.channels
    assert c.fitted_explained == pytest.approx(0.01, rel=0.1)
    told = f"{100.0 * c.share(c.held_out_explained):.2g} % of y remains in the held-out records, "
    told += f"and {100.0 * c.share(c.fitted_explained):.2g} % in the fitted ones: something acts in"
    assert told in report.text(300)


def test_a_change_is_told_where_it_is_seen_best():
    """In a channel of noise, the share that a change takes away is one of chance."""
    model, records = machine(b=1.15)
    report = diagnose(model, [], records, hold_out=["r3"])
    (c,), (left,) = report.channels, report.without
    noise = replace(c, name="noise", motion=1.0, noise=0.4, good_enough=0.01)
    there = replace(left, before=(*left.before, 0.5), after=(*left.after, 0.4))
    (change,) = replace(report, channels=(c, noise), without=(there,)).changes
    assert change.channel == "y"


def test_of_two_parameters_that_replace_each_other_one_is_told():
    """The prior prefers a part of each; the evidence prefers that one has changed."""
    _, records = machine(a=2.0)
    columns = {
        "a": lambda r: r.inputs["u"],
        "d": lambda r: r.inputs["u"] + 0.011 * np.cos(40.0 * r.time),
        "b": lambda r: r.inputs["u"] ** 2,
        "c": lambda r: r.inputs["u"] ** 3,
    }
    values = {"a": 1.0, "b": 1.0, "c": 1.0, "d": 0.0}
    parameters = [Parameter(name=n, value=v, sd=0.1) for n, v in values.items()]
    model = LinearModel(output="y", columns=columns, parameters=parameters)
    report = diagnose(model, [], records, hold_out=["r3"])
    (change,) = report.changes
    assert (change.name, change.tier, change.within) == ("a", "named", False)
    assert change.size == pytest.approx(1.0, abs=0.02)
    # Without it, d follows within its tolerance, and the channel misses nearly all of it.
    u = np.concatenate([r.inputs["u"] for r in records])
    assert change.before * report.channels[0].motion == pytest.approx(
        np.sqrt(np.mean(u**2)), rel=0.1
    )
