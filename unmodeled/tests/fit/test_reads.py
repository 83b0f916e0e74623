"""Values that functions read beside their arguments, and that are changed after a trace."""

import functools
import math
import types

import numpy as np
import pytest

from unmodeled import Effect, Equations, Record
from unmodeled.fit import Candidate, Jobs

TIME = 2e-3 * np.arange(200)
RECORD = Record(name="swing", time=TIME, inputs={}, outputs={"a": 0.0 * TIME})
G = 9.81
TABLE = np.array([9.81, 9.81])
PLANET = types.SimpleNamespace(g=9.81, moons=[1.0])


def model(rates, **options):
    return Equations(
        rates,
        states={"a": (0.1, 0.01, "rad"), "v": (0.0, 0.01, "rad/s")},
        parameters={"length": (0.5, 0.05, "m")},
        **options,
    )


def end(of, included=(), size=()):
    jobs = Jobs(
        theta=np.array([[0.5]]), starts=np.array([[0.1, 0.0]]), included=included,
        magnitudes=np.array([size]),
    )  # fmt: skip
    return of.simulate(RECORD, jobs)[0, -1]


def by_global(t, x, u, p):
    return x.v, -G / p.length * np.sin(x.a)


def by_table(t, x, u, p):
    return x.v, -TABLE[0] / p.length * np.sin(x.a)


def by_attribute(t, x, u, p):
    return x.v, -PLANET.g / p.length * np.sin(x.a)


def helper(x):
    return G * np.sin(x.a)


def by_helper(t, x, u, p):
    return x.v, -helper(x) / p.length


class Planet:
    g = 9.81

    def rates(self, t, x, u, p):
        return swing(self.g, t, x, u, p)


def swing(g, t, x, u, p):
    return x.v, -g / p.length * np.sin(x.a)


def change_global(monkeypatch):
    monkeypatch.setitem(globals(), "G", 1.62)


@pytest.mark.parametrize(
    ("rates", "change"),
    [
        (by_global, change_global),
        (by_helper, change_global),
        (by_table, lambda patch: patch.setitem(globals(), "TABLE", np.array([1.62]))),
        (by_attribute, lambda patch: patch.setattr(PLANET, "g", 1.62)),
        (Planet().rates, lambda patch: patch.setattr(Planet, "g", 1.62)),
    ],
)
def test_a_value_that_rates_read_is_changed(monkeypatch, rates, change):
    """The program of the new value is used, as by a new model."""
    of = model(rates)
    before = end(of)
    monkeypatch.setattr(PLANET, "moons", [2.0])  # of no use
    assert end(of).tobytes() == before.tobytes()
    with monkeypatch.context() as patch:
        change(patch)
        wanted = end(model(functools.partial(swing, 1.62)))
        assert abs(wanted[0] - before[0]) > 0.01
        np.testing.assert_array_equal(end(of), wanted)
    np.testing.assert_array_equal(end(of), before)


def test_a_closure_of_an_output_or_an_effect_is_changed():
    factor, push = 1.0, np.array([0.0])
    of = model(by_global, outputs={"a": "a", "twice": lambda t, x, u, p: factor * x.a})
    effect = Effect(
        name="push", component="a", rate=lambda t, x, u, p, size, shape: {"v": size + push[0]}
    )
    included = (Candidate(effect),)
    first = end(of, included, (0.5,))
    factor = 2.0
    assert end(of, included, (0.5,))[1] == 2.0 * first[1]
    push[0] = 0.5
    assert end(of, included, (0.0,))[0] == first[0]
    push[0] = 0.0
    np.testing.assert_array_equal(end(of, included, (0.5,)), [first[0], 2.0 * first[1]])


def test_what_a_function_writes_is_not_what_it_reads(monkeypatch):
    """A count of calls does not make a new trace at each run."""
    calls = []

    def counted(t, x, u, p):
        calls.append(type(x.a).__name__)
        return by_global(t, x, u, p)

    of = model(counted)
    end(of)
    count = len(calls)
    end(of)
    assert len(calls) == count
    assert not math.isnan(end(of)[0])
