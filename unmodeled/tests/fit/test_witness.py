"""Functions however they are written: the numbers of the plain function, or an error."""

from __future__ import annotations

import contextlib
import math
import shutil
from dataclasses import replace

import numpy as np
import pytest

from unmodeled import Effect, Equations, Record, Sensor
from unmodeled.errors import Error, InvalidParameter
from unmodeled.fit import Candidate, Jobs, Named
from unmodeled.ode import compile, compiled, step

TIME = 0.02 * np.arange(16)
FORCE = 0.6 + np.sin(9.0 * TIME)
NAMES = {"k": 3.0, "c": 0.4}


@pytest.fixture(scope="session")
def extension(tmp_path_factory):
    """The compiled integrator: that of the package, or one that is compiled for the tests."""
    found = compiled.library()
    if found is None:
        if shutil.which("c++") is None and shutil.which("g++") is None:
            pytest.skip("no C++ compiler")
        found = compiled.loaded(compile.build(tmp_path_factory.mktemp("extension")))
    return found


@pytest.fixture(params=["compiled", "batch", "scalar"])
def engine(request, monkeypatch):
    """Each way of integration in turn."""
    found = request.getfixturevalue("extension") if request.param == "compiled" else None
    monkeypatch.setattr(compiled, "library", lambda: found)
    if request.param == "batch":
        monkeypatch.setattr(step, "MOST", 0)
    return request.param


def record():
    return Record(name="r", time=TIME, inputs={"f": FORCE}, outputs={"q": 0.5 + 0.0 * TIME})


def model(term, name="model"):
    return Equations(
        lambda t, x, u, p: (x.v, u.f - p.k * x.q - term(t, x, u, p)),
        states={"q": (0.2, 0.1, "m"), "v": (0.4, 0.1, "m/s")},
        parameters={n: (v, 0.1, "1") for n, v in NAMES.items()},
        inputs=("f",),
        hold="linear",
        substeps=1,
        name=name,
    )


def jobs(count=3):
    share = np.linspace(0.0, 1.0, count)
    return Jobs(
        theta=np.column_stack([3.0 + share, 0.4 + 0.2 * share]),
        starts=np.column_stack([0.2 + share, 0.4 - 0.7 * share]),
    )


def plain(term, k, given):
    """Runge-Kutta with calls of the function for numbers of NumPy."""
    p = Named(dict(zip(NAMES, given.theta[k], strict=True)))
    x, out = given.starts[k].copy(), [given.starts[k]]

    def rate(t, x, f):
        named = Named({"q": x[0], "v": x[1]})
        u = Named({"f": f})
        return np.array([named.v, u.f - p.k * named.q - float(term(t, named, u, p))])

    for j, h in enumerate(np.diff(TIME)):
        fs = [FORCE[j], FORCE[j] + 0.5 * (FORCE[j + 1] - FORCE[j]), FORCE[j + 1]]
        a = rate(TIME[j], x, fs[0])
        b = rate(TIME[j] + 0.5 * h, x + 0.5 * h * a, fs[1])
        c = rate(TIME[j] + 0.5 * h, x + 0.5 * h * b, fs[1])
        d = rate(TIME[j] + h, x + h * c, fs[2])
        x = x + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
        out.append(x)
    return np.array(out)


def outcome(term):
    """ "right", or the error; a silent difference is an AssertionError."""
    given = jobs()
    try:
        found = model(term).simulate(record(), given)
    except Error as error:
        return str(error)
    with np.errstate(all="ignore"):
        for k in range(given.count):
            np.testing.assert_allclose(found[k], plain(term, k, given), rtol=1e-7, atol=1e-9)
    return "right"


# ------------------------------------------------------------------------------- single spellings


def swallowed(t, x, u, p):
    try:
        return p.c * math.sqrt(abs(x.v))
    except Exception:
        return 0.0


def suppressed(t, x, u, p):
    out = 0.0
    with contextlib.suppress(Exception):
        out = p.c * math.sqrt(abs(x.v))
    return out


def at_last(t, x, u, p):
    out = 0.0
    try:
        out = p.c * math.sqrt(abs(x.v))
    finally:
        return out  # noqa: B012


def everything(t, x, u, p):
    try:
        return p.c * float(x.v)
    except:  # noqa: E722
        return 0.0


def one_of_two(t, x, u, p):
    return p.c * x.v if isinstance(x.v, float) else 0.0 * x.v


def one_scalar(t, x, u, p):
    return p.c * x.v if np.isscalar(x.v) else p.c * x.q


def in_place(t, x, u, p):
    v = x.v
    v *= p.c
    return v * x.v


RIGHT = {
    "norm": lambda t, x, u, p: p.c * np.linalg.norm([x.q, x.v]),
    "norm of an array": lambda t, x, u, p: p.c * np.linalg.norm(np.array([0.1 + 0.0 * x.v, x.v])),
    "mean": lambda t, x, u, p: p.c * np.mean([x.q, x.v]),
    "sum": lambda t, x, u, p: p.c * np.array([x.q, x.v]).sum(),
    "any": lambda t, x, u, p: p.c * x.v if np.any(x.v > 0.0) else p.c * x.q,
    "all": lambda t, x, u, p: p.c * x.v if np.all([x.v > 0.0, x.q > 0.5]) else p.c * x.q,
    "max": lambda t, x, u, p: p.c * np.max([x.q, x.v]),
    "std": lambda t, x, u, p: p.c * np.std([x.q, x.v, 0.0]),
    "median": lambda t, x, u, p: p.c * np.median([x.q, x.v, 0.0]),
    "cube root": lambda t, x, u, p: p.c * np.cbrt(x.q + 2.0),
    "except": swallowed,
    "suppress": suppressed,
    "finally": at_last,
    "bare except": everything,
    "in place": in_place,
    "astype": lambda t, x, u, p: p.c * x.v.astype(np.float32),
    "to whole numbers": lambda t, x, u, p: p.c * np.float64(3.0 * x.v).astype(int),
    "dtype": lambda t, x, u, p: p.c * np.multiply(x.v, 2.0, dtype=np.float32),
    "whole numbers": lambda t, x, u, p: p.c * np.full_like(x.v, 2.7, dtype=int),
    "modulo": lambda t, x, u, p: p.c * (t % 0.1) + (x.v % 0.3),
    "quotient": lambda t, x, u, p: p.c * (t // 0.1) + x.v // 0.3 + np.mod(x.q, -0.2),
    "zero by": lambda t, x, u, p: np.where(np.isnan(0.0 / (x.v - x.v)), p.c, 0.0) * x.v,
    "zero times": lambda t, x, u, p: np.where(np.isnan(0.0 * np.log(x.v - x.v)), p.c, 0.0),
    "arcsinh": lambda t, x, u, p: 1e9 * np.arcsinh(1e-9 * x.v),
    "rounded": lambda t, x, u, p: p.c * round(x.v, 1),
    "whole": lambda t, x, u, p: p.c * int(10.0 * x.v),
    "item": lambda t, x, u, p: p.c * x.v.item(),
    "table": lambda t, x, u, p: p.c * [1.0, 2.0][int(x.v > 0.0)],
}
REFUSED = {
    "caret": (lambda t, x, u, p: p.c * (x.v ^ 2), "bitwise_xor"),
    "and": (lambda t, x, u, p: p.c * (x.v & 1), "bitwise_and"),
    "or": (lambda t, x, u, p: p.c * (x.v | x.q), "bitwise_or"),
    "not": (lambda t, x, u, p: p.c * ~x.v, "invert"),
    "minus a condition": (lambda t, x, u, p: -(x.v > 0.0) * p.c, "boolean negative"),
    "difference of conditions": (lambda t, x, u, p: ((x.v > 0) - (x.v < 0)) * p.c, "subtract"),
    "text": (lambda t, x, u, p: x.v * "2", "raises"),
    "sum of conditions": (
        lambda t, x, u, p: p.c * ((x.v > -9.0) + (x.q > -9.0)), "when it is traced"
    ),
    "isinstance": (one_of_two, "when it is traced"),
    "isscalar": (one_scalar, "when it is traced"),
}  # fmt: skip


@pytest.mark.parametrize("name", RIGHT)
def test_the_numbers_of_the_plain_function(engine, name):
    assert outcome(RIGHT[name]) == "right"


@pytest.mark.parametrize("name", REFUSED)
def test_what_differs_is_an_error(name):
    term, text = REFUSED[name]
    found = outcome(term)
    assert text in found
    assert "of test_witness.py)" in found
    assert ", at t = " in found


def relay():
    held = {"on": False}

    def term(t, x, u, p):
        if x.v > 0.4:
            held["on"] = True
        if x.v < 0.1:
            held["on"] = False
        return p.c if held["on"] else 0.0

    return term


def largest():
    most = [0.0]

    def term(t, x, u, p):
        most[0] = max(most[0], float(abs(x.v)))
        return p.c * most[0]

    return term


def before():
    last = {}

    def term(t, x, u, p):
        out = p.c * (x.v - last.get("v", 0.0))
        last["v"] = x.v
        return out

    return term


def counter():
    calls = []

    def term(t, x, u, p):
        calls.append(t)
        return 1e-3 * len(calls)

    return term


@pytest.mark.parametrize("term", [relay(), largest(), before(), counter()])
def test_a_state_of_its_own_is_an_error(term):
    with pytest.raises(InvalidParameter, match="differs between two equal calls"):
        model(term).simulate(record(), jobs())


def test_a_symbol_of_an_earlier_call_is_a_state():
    kept = []

    def term(t, x, u, p):
        out = p.c * (kept[-1] if len(kept) > 4 else 0.0)
        kept.append(x.v)
        return out

    with pytest.raises(InvalidParameter, match="uses a value of an earlier call"):
        model(term).simulate(record(), jobs())


def test_an_honest_count_of_calls_is_no_state():
    calls = []

    def term(t, x, u, p):
        calls.append(t)
        return p.c * x.v

    assert outcome(term) == "right"


def test_the_answer_does_not_depend_on_the_number_of_jobs():
    def rates(t, x, u, p):
        return (-p.c * np.linalg.norm([x.a, 1.0 + 0.0 * x.a]) * x.a,)

    own = Equations(rates, states={"a": (1.0, 0.1, "m")}, parameters={"c": (0.5, 0.1, "1")})
    found = []
    for n in (1, 2, 4, 16):
        many = Jobs(theta=np.full((n, 1), 0.5), starts=np.ones((n, 1)))
        found.append(
            own.simulate(Record(name="r", time=TIME, inputs={}, outputs={"a": TIME}), many)[0]
        )
    for other in found[1:]:
        np.testing.assert_array_equal(other, found[0])


@pytest.mark.parametrize("term", [one_of_two, relay(), REFUSED["caret"][0]])
def test_effects_and_outputs_are_compared_too(term):
    effect = Effect(
        name="own", component="v",
        rate=lambda t, x, u, p, size, shape: {"v": -size * term(t, x, u, p)},
    )  # fmt: skip
    plain_one = model(lambda t, x, u, p: 0.0)
    given = replace(jobs(), included=(Candidate(effect),), magnitudes=np.ones((3, 1)))
    with pytest.raises(InvalidParameter, match=r"^effect own: its rate .*test_witness.py\)"):
        plain_one.simulate(record(), given)
    shown = Equations(
        lambda t, x, u, p: (x.v, u.f - p.k * x.q),
        states={"q": (0.2, 0.1, "m"), "v": (0.4, 0.1, "m/s")},
        parameters={n: (v, 0.1, "1") for n, v in NAMES.items()},
        outputs={"q": "q", "own": term},
    )
    with pytest.raises(InvalidParameter, match=r"^model model: its output own "):
        shown.simulate(record(), jobs())


def test_a_difference_along_the_answer_is_its_first_note():
    """Where the records did not show it: the answer is kept."""

    def rates(t, x, u, p):
        far = 1e-3 if 3.0 < x.q < 5.0 and not isinstance(x.q, float) else 0.0
        return x.v, p.g * u.f - 0.5 * x.v + far

    time = 0.02 * np.arange(150)
    push, v = np.where(time < 1.0, 1.0, 0.2), np.zeros(150)
    for k in range(149):
        v[k + 1] = v[k] + 0.02 * (4.0 * push[k] - 0.5 * v[k])
    noise = 1e-3 * np.random.default_rng(0).normal(size=150)
    run = Record(
        name="run", time=time, inputs={"f": push}, outputs={"v": v + noise},
        sensors={"v": Sensor(name="v", unit="m/s", sigma=1e-3)},
    )  # fmt: skip
    own = Equations(
        rates,
        states={"q": (0.0, 1e-4, "m"), "v": (0.0, 1e-3, "m/s")},
        parameters={"g": (1.0, 100.0, "1")},
        inputs={"f": "m/s^2"},
        outputs={"v": "v"},
    )
    report = own.diagnose(run, effects=())
    assert report.parameters[0].value == pytest.approx(4.0, rel=0.02)
    assert report.notes[0].startswith("the numbers below are not those of the model's functions: ")
    assert "when it is traced" in report.notes[0]


# ------------------------------------------------------------------------------- random spellings

LEAVES = ("x.q", "x.v", "u.f", "t", "p.k", "p.c", "0.7", "-1.3", "2", "0", "1e-9")
PAIRS = (
    "({a} + {b})", "({a} - {b})", "({a} * {b})", "({a} / {b})", "({a} % {b})", "({a} // {b})",
    "np.hypot({a}, {b})", "np.arctan2({a}, {b})", "max({a}, {b})", "np.minimum({a}, {b})",
    "({a} if {a} > {b} else {b})", "np.where({a} > {b}, {a}, 0.5)", "abs({a}) ** {b}",
    "np.copysign({a}, {b})", "np.heaviside({a}, {b})", "np.mean([{a}, {b}])", "({a} & {b})",
    "np.linalg.norm([{a}, {b}])", "np.array([{a}, {b}]).sum()", "(({a} > 0) + ({b} > 0))",
    "(({a} > 0) & ({b} > 0)) * 1.0", "({a} ^ {b})", "np.clip({a}, -0.5, abs({b}))",
    "(({a} > 0) * {b})", "np.any([{a} > 0, {b} > 1]) * 0.3", "np.fmod({a}, {b})",
    "({a} > {b} or {b} > 0.5) * 0.2", "np.dot([1.0, {a}], [{b}, 2.0])", "divmod({a}, {b})[1]",
)  # fmt: skip
SINGLES = (
    "np.sin({a})", "np.tanh({a})", "np.sign({a})", "abs({a})", "-({a})", "np.sqrt(abs({a}))",
    "math.sin({a})", "math.exp(-abs({a}))", "np.floor({a})", "np.arcsinh({a})", "np.log1p({a})",
    "float({a})", "round({a}, 2)", "np.float32({a})", "(0.2 if isinstance({a}, float) else 0.1)",
    "(0 / {a})", "0 * np.log(abs({a}))", "~({a} > 0) * 0.1", "-({a} > 0) * 0.1", "{a} ** 2",
    "np.square({a})", "np.cbrt({a})", "np.exp(-{a} ** 2)", "np.interp({a}, [0.0, 1.0], [0.0, 2.0])",
    "(1.0 if {a} else 2.0)", "np.nan_to_num({a})", "np.round({a})", "(not {a}) * 0.1",
    "guarded(lambda: math.sqrt({a}))", "np.atleast_1d({a})[0]", "np.asarray({a}) * 1.0",
    "np.sinc({a})", "np.reciprocal({a})", "np.rint({a})", "np.isnan({a}) * 1.0", "np.float64({a})",
    "np.bool_({a}) * 0.3", "(hasattr({a}, 'node') * 0.3)", "np.array({a}).item()",
)  # fmt: skip


def guarded(of):
    try:
        return of()
    except Exception:
        return 0.0


def written(seed):
    """A random term as text."""
    random = np.random.default_rng(seed)

    def expression(depth):
        if depth == 0 or random.random() < 0.15:
            return str(random.choice(LEAVES))
        if random.random() < 0.45:
            return str(random.choice(SINGLES)).format(a=expression(depth - 1))
        a, b = expression(depth - 1), expression(depth - 1)
        return str(random.choice(PAIRS)).format(a=a, b=b)

    return expression(int(random.integers(1, 4)))


def check(seeds):
    right = 0
    for seed in seeds:
        text = written(seed)
        term = eval(f"lambda t, x, u, p: {text}", {"np": np, "math": math, "guarded": guarded})
        try:
            right += outcome(term) == "right"
        except AssertionError as error:
            raise AssertionError(f"seed {seed}: {text}: {error}") from None
    return right


@pytest.mark.filterwarnings("ignore")
def test_random_spellings_are_right_or_refused(engine):
    assert check(range(36)) > 18


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_300_random_spellings_are_right_or_refused(engine):
    assert check(range(100, 400)) > 150
