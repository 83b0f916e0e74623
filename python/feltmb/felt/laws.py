"""Laws with few parameters from compression tests, also of loading only and of several specimens.

The fits are least squares of SciPy in the logarithms of the parameters. The intervals follow from
the residuals and their correlation from sample to sample, with Student's t.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from feltmb.contact import law as contact_law
from feltmb.felt.measured import Specimen, measured_loop
from feltmb.fiber.approach import LEAST, free_approach, scatter_of
from feltmb.fiber.cycles import find_branches
from feltmb.fiber.machine import Drift, drift_of_approach, saturation
from unmodeled.arguments import checked
from unmodeled.errors import DataError, InvalidParameter

Array = NDArray[np.float64]
Values = Callable[[Array], dict[str, float]]
LoadingLaw = Literal["power", "exponential", "van_wyk", "van_wyk_3"]

#: Laws of loading.
LOADING = ("power", "exponential", "van_wyk", "van_wyk_3")
#: Units of parameters; others are numbers.
UNITS = {
    **{"a": "N/m", "b": "1/m", "c": "N/m"},
    **{"stiffness": "N/m^p", "scale": "N", "thickness": "m", "zero": "m", "rest": "N"},
    **{name: "s" for name in ("time", "rate_time", "time_1", "time_2", "time_3", "time_4")},
}
#: Ratio of the ends of an interval above which a test does not determine a parameter.
WIDE = 10.0
#: Largest correlation of successive residuals.
CORRELATED = 0.98
#: Largest exponent of a law of loading, and of the exponential at its end.
STEEPEST = 60.0
#: Parameters that may be negative.
SIGNED = ("zero", "c")
#: A law of loading does not follow a test that it misses typically by more than a share of the
#: force, or by more than a multiple of the noise, which is at least a share of the largest force.
MISSES, FAR, QUIET = 0.1, 3.0, 2e-3
#: Most Maxwell branches, and least ratio of their times.
BRANCHES, APART = 4, 2.0
#: Largest ratio of the speeds of the cycles that tells no dependence on the rate.
ONE_SPEED = 3.0
#: Compressions at which specimens are compared, as shares of the smallest largest one.
SHARES = (0.25, 0.5, 0.75, 1.0)


@checked
@dataclass(frozen=True)
class LawFit:
    """A law fitted to one test."""

    law: str
    name: str
    """Name of the test."""
    values: Mapping[str, float]
    """Parameters in SI units."""
    interval: Mapping[str, tuple[float, float]]
    """Intervals of 95 % of those that are not given; none if the law does not follow the test."""
    rms: float
    """Root mean square of the difference of law and test [N]."""
    relative: float
    """Typical difference as a share of the force, without the noise of the load cell [1]."""
    compression: Array = field(repr=False)
    """Compression of the samples [m]; for a relaxation, their time [s]."""
    force: Array = field(repr=False)
    """Their force [N]."""
    fitted: Array = field(repr=False)
    """Force of the law [N]."""
    warnings: tuple[str, ...] = ()
    entry: Mapping[str, Any] = field(default_factory=dict)
    """Keys of ``contacts.NN`` in a mechanism file with this law; empty if there is none."""

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Parameters with an interval that is wider than tenfold; all if there is none.

        A stiffness [N/m^p] moves with its exponent, and is undetermined with it only.
        """
        if not self.interval:
            return tuple(self.values)
        ends = {k: v for k, v in self.interval.items() if k not in (*SIGNED, "stiffness")}
        wide = tuple(k for k, (low, high) in ends.items() if not 0.0 < high <= WIDE * low)
        return ("stiffness", *wide) if "exponent" in wide and "stiffness" in self.interval else wide

    def to_toml(self) -> str:
        """``entry`` as text."""
        import tomlkit

        return tomlkit.dumps(dict(self.entry))


@checked
@dataclass(frozen=True)
class PooledLaw:
    """One law of loading of several specimens."""

    law: str
    fits: tuple[LawFit, ...]
    """That of each specimen."""
    values: Mapping[str, float]
    """Parameters of the law of the mean force at each compression, in SI units."""
    interval: Mapping[str, tuple[float, float]]
    """Their intervals of 95 %, by the jackknife over specimens."""
    compression: Array
    """Compressions at which the specimens are compared [m]."""
    force: Array
    """Force of the law there [N]."""
    scatter: Array
    """Standard deviation between specimens of the force there [N]."""


@dataclass(frozen=True)
class _Estimate:
    """Least squares in the parameters of a residual."""

    best: Array
    covariance: Array
    cost: float
    freedom: int


def _estimate(
    rest: Callable[[Array], Array], starts: Sequence[Array], low: Array, high: Array
) -> _Estimate:
    """Best of several starts, with the covariance for correlated residuals."""
    from scipy.optimize import least_squares

    inside = [np.clip(s, low + 1e-9, high - 1e-9) for s in starts]
    fits = [least_squares(rest, s, bounds=(low, high), x_scale="jac") for s in inside]
    best = min(fits, key=lambda f: float(f.cost))
    left, size = np.asarray(best.fun), best.x.size
    square = max(float(left @ left), 1e-300)
    follow = float(np.clip(left[1:] @ left[:-1] / square, 0.0, CORRELATED))
    factor = (1.0 + follow) / (1.0 - follow)
    inverse = np.linalg.pinv(best.jac.T @ best.jac, rcond=1e-14)
    covariance = square / max(left.size - size, 1) * factor * inverse
    freedom = max(int((left.size - size) / factor), 1)
    return _Estimate(np.asarray(best.x), covariance, square, freedom)


def _interval(found: _Estimate, values: Values, key: str) -> tuple[float, float]:
    """Interval of a value that depends on all parameters, positive but for ``SIGNED``."""
    from scipy.stats import t as student

    def at(p: Array) -> float:
        return values(p)[key] if key in SIGNED else math.log(values(p)[key])

    steps = 1e-4 * np.eye(found.best.size)
    slope = np.array([at(found.best + d) - at(found.best - d) for d in steps]) / 2e-4
    sd = math.sqrt(max(float(slope @ found.covariance @ slope), 0.0))
    reach, center = float(student.ppf(0.975, found.freedom)) * sd, at(found.best)
    if key in SIGNED:
        return center - reach, center + reach
    return math.exp(max(center - reach, -600.0)), math.exp(min(center + reach, 600.0))


def _force(name: str, e: Array, v: Mapping[str, float]) -> Array:
    """Force of a law of loading."""
    e = np.maximum(e, 0.0)
    if name == "power":
        return np.asarray(v["stiffness"] * e ** v["exponent"])
    if name == "exponential":
        return np.asarray(e * (v["a"] * np.exp(v["b"] * e) + v["c"]))
    share = np.minimum(e / v["thickness"], 1.0 - 1e-9)
    return np.asarray(v["scale"] * ((1.0 - share) ** -v["exponent"] - 1.0))


def _first_loading(test: Specimen) -> tuple[Array, Array, Drift | None]:
    """Displacement and force of the first complete loading without holds and drift; the drift."""
    branches = find_branches(test.displacement)
    at = branches.kept[branches.loading]
    if at.size < 2 * LEAST:
        raise DataError(f"{test.name}: {at.size} samples of loading, expected at least {2 * LEAST}")
    kept = branches.kept
    limit = saturation(test.displacement[kept], test.force[kept], branches.loading)
    if limit:
        raise DataError(f"{test.name}: {limit}")
    order = at[np.argsort(test.displacement[at], kind="stable")]
    x, force = test.displacement[order], test.force[order]
    clock = x if test.time is None else test.time[np.sort(at)]
    drift = drift_of_approach(x, force, clock, test.zero)
    return x, force if drift is None else force - drift.force, drift


def _space(law: LoadingLaw, before: float, drifts: bool) -> tuple[Array, Array, list[Array]]:
    """Bounds and starts of what is fitted of a law of loading.

    These are shape, force at the end; room behind the end, or c / a + 1; way from the zero to the
    first load, at most ``before`` of the span; drift in its standard errors.
    """
    low, high = [0.0 if law != "exponential" else -5.0, -3.0], [math.log(STEEPEST), 3.0]
    shapes = [[math.log(exponent), 0.0] for exponent in (2.0, 6.0)]
    if law != "power":
        low, high = [*low, -12.0], [*high, 5.0]
        shapes = [[*s, math.log(room)] for s in shapes for room in (0.2, 1.0)]
    if before:
        low, high = [*low, -12.0], [*high, math.log(before)]
        shapes = [[*s, math.log(way)] for s in shapes for way in (0.02, 0.3)]
    if drifts:
        low, high, shapes = [*low, -5.0], [*high, 5.0], [[*s, 0.0] for s in shapes]
    return np.array(low), np.array(high), [np.array(s) for s in shapes]


def _fit_loading(test: Specimen, law: LoadingLaw, thickness: float | None) -> LawFit:
    """A law of loading. The misfit is a share of the force, so that small forces count too."""
    x, force, drift = _first_loading(test)
    contact = free_approach(x, force, test.zero)
    force = force - contact.level
    noise = max(scatter_of(force), 1e-6 * float(np.ptp(force)))
    end, top, span = float(x[-1]), float(np.max(force)), float(np.ptp(x))
    begin = float(x[int(np.argmax(force > 5.0 * noise))])
    before = 0.0 if test.zero is not None else max(begin - contact.low, 1e-3 * span)
    if law.startswith("van_wyk") and thickness:
        before = min(before, _room(test, thickness, end, begin))
    low, high, starts = _space(law, before / span, drift is not None)
    way = 2 + (law != "power")

    def values(p: Array) -> dict[str, float]:
        zero = test.zero if test.zero is not None else begin - span * math.exp(p[way])
        most, size = max(end - zero, 1e-12), top * math.exp(p[1])
        return {**_numbers(law, p, most, size, thickness), "zero": zero}

    def fitted(p: Array) -> Array:
        v = values(p)
        made = _force(law, x - v["zero"], v)
        return made + p[-1] * drift.error * drift.force / drift.total if drift else made

    share = 0.1

    def rest(p: Array) -> Array:
        left = (fitted(p) - force) / np.hypot(noise, share * np.maximum(force, 0.0))
        return np.append(left, p[-1]) if drift else np.asarray(left)

    for _ in range(4):
        found = _estimate(rest, starts, low, high)
        starts, left = [found.best], fitted(found.best) - force
        counts = force > 10.0 * noise
        extra = (left[counts] ** 2 - noise**2) / force[counts] ** 2
        share = math.sqrt(max(float(np.mean(extra)), 1e-8)) if counts.any() else 1e-4
    v = values(found.best)
    rms = float(np.sqrt(np.mean(left**2)))
    given = _given(law, thickness) | ({"zero"} if not before else set())
    interval = {k: _interval(found, values, k) for k in v if k not in given}
    warnings = [drift.text] if drift else []
    misses = share > MISSES or rms > FAR * max(noise, QUIET * top)
    if misses:
        interval = {}
        warnings.append(
            f"the law {law} does not follow the test, typically off by {100 * share:.3g} % of the "
            f"force, {rms / noise:.3g} times the noise of {noise:.2g} N: its parameters depend on "
            "the range of the test and have no interval; try another law of loading (--law), or "
            "`feltmb felt contact --loss`, which makes a table that follows any loading"
        )
    if law == "van_wyk" and found.best[0] > high[0] - 1e-3:
        warnings.append(
            "the exponent is at the end of its range: the force grows as an exponential, and van "
            "Wyk's law has no thickness for it"
        )
    numbers = {k: v[k] for k in ("stiffness", "exponent") if k in v}
    return LawFit(
        law, test.name, v, interval, rms, share,
        x - v["zero"], force, left + force, tuple(warnings),
        {"law": "hunt_crossley", "hunt_crossley": numbers} if law == "power" else {},
    )  # fmt: skip


def _given(law: LoadingLaw, thickness: float | None) -> set[str]:
    """Parameters of a law of loading that are not fitted."""
    fixed = {"exponent": law == "van_wyk_3", "thickness": bool(thickness)}
    return {name for name, is_fixed in fixed.items() if is_fixed}


def _room(test: Specimen, thickness: float, end: float, begin: float) -> float:
    """Thickness that is left at the end, from the first load or contact [m]."""
    pressed = end - (begin if test.zero is None else test.zero)
    if pressed >= thickness:
        since = "first load" if test.zero is None else "first contact"
        raise DataError(
            f"{test.name}: compressed by {1e3 * pressed:.4g} mm from the {since}, and thickness = "
            f"{1e3 * thickness:.4g} mm, expected a thickness at the first contact that is larger"
        )
    return thickness - pressed


def _numbers(
    law: LoadingLaw, p: Array, most: float, size: float, thickness: float | None
) -> dict[str, float]:
    """Parameters of a law of loading with the force ``size`` at the compression ``most``."""
    shape = 3.0 if law == "van_wyk_3" else math.exp(p[0])
    if law == "power":
        return {"stiffness": size / most**shape, "exponent": shape}
    if law == "exponential":
        ratio = math.expm1(p[2])  # c / a: the force begins to rise
        a = size / most / (math.exp(shape) + ratio)
        return {"a": a, "b": shape / most, "c": ratio * a}
    h = thickness or most * (1.0 + math.exp(p[2]))
    rise = (1.0 - min(most / h, 1.0 - 1e-9)) ** -shape - 1.0
    return {"scale": size / rise, "exponent": shape, "thickness": h}


@checked
def pool(
    tests: Sequence[Specimen], law: LoadingLaw = "power", *, thickness: float | None = None
) -> PooledLaw:
    """One law of the loading of several specimens, and the scatter between them.

    Parameters
    ----------
    tests
        At least two specimens. They are compared from the first contact of each: give their
        ``zero`` if it is known.
    law, thickness
        As in :func:`fit_law`.

    Raises
    ------
    InvalidParameter
        Fewer than two specimens.
    """
    from scipy.stats import t as student

    count = len(tests)
    if count < 2:
        raise InvalidParameter(f"pool: got {count} specimens, expected at least 2")
    fits = tuple(fit_law(test, law, thickness=thickness) for test in tests)
    end = min(float(f.compression[-1]) for f in fits)
    grid = end * np.linspace(0.0, 1.0, 201)[1:]
    forces = np.array([np.interp(grid, f.compression, f.force) for f in fits])
    given = _given(law, thickness)

    def together(kept: Sequence[int]) -> dict[str, float]:
        mean = Specimen("mean", grid, np.mean(forces[kept], axis=0), zero=0.0)
        found = _fit_loading(mean, law, thickness)
        return {k: v for k, v in found.values.items() if k not in given}

    values = together(range(count))
    others = [together([j for j in range(count) if j != i]) for i in range(count)]
    factor = math.sqrt(count - 1.0) * float(student.ppf(0.975, count - 1))
    interval = {}
    for key in values.keys() - {"zero"}:
        each = np.array([o[key] for o in others])
        if key in SIGNED:
            reach = factor * float(np.std(each))
            interval[key] = values[key] - reach, values[key] + reach
            continue
        reach = min(factor * float(np.std(np.log(each))), 300.0)
        interval[key] = values[key] * math.exp(-reach), values[key] * math.exp(reach)
    values = {**fits[0].values, **values}
    del values["zero"]
    at = np.array(SHARES) * end
    own = np.array([np.interp(at, f.compression, f.force) for f in fits])
    scatter = np.std(own, axis=0, ddof=1)
    return PooledLaw(law, fits, values, interval, at, _force(law, at, values), scatter)


def _fit_relaxation(test: Specimen) -> LawFit:
    """Maxwell branches of a hold, by the Bayesian information criterion."""
    assert test.time is not None
    whole = int(np.argmax(test.force)), test.force.size - 1
    still = np.ptp(test.displacement) == 0.0
    holds = [whole] if still else find_branches(test.displacement).holds
    if not holds:
        raise DataError(f"{test.name}: no hold of the compression")
    first, last = max(holds, key=lambda h: (test.force[h[0]], h[1] - h[0]))
    t, force = test.time[first : last + 1] - test.time[first], test.force[first : last + 1]
    if t.size < 3 * LEAST or not t[-1] > 0.0:
        raise DataError(f"{test.name}: {t.size} samples of a hold, expected at least {3 * LEAST}")
    shortest, longest = float(t[-1]) / (t.size - 1), float(t[-1])
    size = float(np.max(np.abs(force)))

    def times_of(p: Array) -> Array:
        n = p.size // 2
        gaps = math.log(APART) + np.exp(p[1:n])
        return np.asarray(np.exp(np.cumsum(np.concatenate([p[:1], gaps]))))

    def fitted(p: Array) -> Array:
        terms = np.column_stack([np.ones_like(t), np.exp(-t[:, None] / times_of(p))])
        return np.asarray(terms @ np.exp(p[p.size // 2 :]))

    def values(p: Array) -> dict[str, float]:
        forces = size * np.exp(p[p.size // 2 :])
        times = times_of(p)
        shares = _shares(test, first, times, forces[1:] / forces[0])
        made = {"rest": float(forces[0])}
        for i, (share, time) in enumerate(zip(shares, times, strict=True), 1):
            made |= {f"share_{i}": float(share), f"time_{i}": float(time)}
        return made

    options = []
    for n in range(1, BRANCHES + 1):
        places = np.log(np.geomspace(2.0 * shortest, 0.5 * longest, n + 2)[1:-1])
        gaps = np.log(np.maximum(np.diff(places) - math.log(APART), 1e-2))
        falls = np.full(n, math.log(max(float(force[0] - force[-1]) / size, 1e-6) / n))
        start = np.concatenate([places[:1], gaps, [math.log(force[-1] / size)], falls])
        low = np.concatenate(
            [[math.log(0.5 * shortest)], np.full(n - 1, -8.0), np.full(n + 1, -20.0)]
        )
        high = np.concatenate(
            [[math.log(10.0 * longest)], np.full(n - 1, 3.0), np.full(n + 1, 2.0)]
        )
        found = _estimate(lambda p: fitted(p) - force / size, [start], low, high)
        samples = found.freedom + start.size
        options.append((samples * math.log(found.cost) + start.size * math.log(samples), n, found))
    _, n, found = min(options, key=lambda o: o[0])
    v = values(found.best)
    left = size * fitted(found.best) - force
    warnings = []
    if v[f"time_{n}"] > 0.5 * longest:
        warnings.append(
            f"the slowest branch has {v[f'time_{n}']:.3g} s, and the hold {longest:.3g} s: the "
            "force did not come to rest, and a longer hold changes share, time and rest"
        )
    most = max(range(1, n + 1), key=lambda i: v[f"share_{i}"])
    memory = {"rate_amplitude": v[f"share_{most}"], "rate_time": v[f"time_{most}"]}
    return LawFit(
        "maxwell", test.name, v, {k: _interval(found, values, k) for k in v},
        float(np.sqrt(np.mean(left**2))), float(np.sqrt(np.mean((left / force) ** 2))),
        t, force, left + force, tuple(warnings), {"memory": memory},
    )  # fmt: skip


def _shares(test: Specimen, first: int, times: Array, seen: Array) -> Array:
    """Shares of branches after a sudden compression from those that are seen in a hold.

    Each branch follows ``q' = share F_s' - q/time`` before the hold, where the measured force is
    that at rest, F_s, and all q.
    """
    assert test.time is not None
    force = test.force[: first + 1]
    steps = np.maximum(np.diff(test.time[: first + 1]), 1e-12 * float(times[0]))
    shares = seen
    for _ in range(5 if steps.size and force[-1] > force[0] else 0):
        rest, branches = float(force[0]), np.zeros(times.size)
        for step, now in zip(steps, force[1:], strict=True):
            decay = np.exp(-step / times)
            gain = shares * times / step * (1.0 - decay)
            rise = (now - rest - float(np.sum(branches * decay))) / (1.0 + float(np.sum(gain)))
            branches, rest = branches * decay + gain * rise, rest + rise
        left = np.clip(branches / (shares * max(rest, 1e-300)), 1e-6, 1.0)
        shares = seen / left
    return np.asarray(shares)


def _fit_rate(test: Specimen, law: Literal["stulov", "rate"]) -> LawFit:
    """A law that depends on the rate, along the whole test."""
    assert test.time is not None
    x, time = test.displacement, test.time
    branches = find_branches(x)
    speeds = {
        number: float((x[b] - x[a]) / max(time[b] - time[a], 1e-300))
        for number, (a, b, _) in branches.loops.items()
        if x[b] > x[a]
    }
    if law == "rate":
        slowest = min(speeds, key=lambda number: speeds[number], default=None)
        loop = measured_loop(x, test.force, time=time, zero=test.zero, cycle=slowest)
        x, f, made = loop.compression, loop.force, loop.envelope
        ends = [0.0, 0.0]
    else:
        contact = free_approach(*_first_loading(test)[:2], test.zero)
        f, ends = test.force - contact.level, [contact.low, contact.high]
    span, top = float(np.max(x)) - ends[1], float(np.max(f))
    duration = float(np.ptp(time))
    fastest = max(speeds.values(), default=span / duration)

    def values(p: Array) -> dict[str, float]:
        if law == "rate":
            return dict(zip(("scale", "rate_amplitude", "rate_time"), np.exp(p), strict=True))
        exponent = math.exp(p[3])
        return {
            "stiffness": top * math.exp(p[0]) / span**exponent,
            "exponent": exponent,
            "amplitude": 1.0 / (1.0 + math.exp(-p[1])),
            "time": math.exp(p[2]),
            "zero": ends[0] + float(p[4]) * (ends[1] - ends[0]),
        }

    def memory(v: Mapping[str, float]) -> dict[str, Any]:
        scaled = [v["scale"] * branch for branch in (made.loading, made.unloading)]
        table = replace(made, loading=scaled[0], unloading=scaled[1], made=None)
        return {**made.memory, "rate_amplitude": v["rate_amplitude"], "rate_time": v["rate_time"],
                "envelope": table}  # fmt: skip

    def along(p: Array) -> Array:
        v = values(p)
        e = np.maximum(x - v.pop("zero", 0.0), 0.0)
        if law == "stulov":
            return contact_law(law, **v).path(e, time)
        own = memory(v)
        table = own.pop("envelope")
        columns = table.compression, table.loading, table.unloading
        return contact_law("felt_memory", envelope=columns, **own).path(e, time)

    more = [math.log(2.5), 0.5] if law == "stulov" else []
    times = np.log(np.geomspace(0.1 * span / fastest, max(duration / 3.0, span / fastest), 3))
    low = np.array([-3.0, -9.0, math.log(1e-3 * span / fastest), *([0.0, 0.0] if more else [])])
    high = np.array([3.0, 4.0, math.log(10.0 * duration), *([math.log(8.0), 1.0] if more else [])])
    starts = [np.array([0.0, -1.0, tau, *more]) for tau in times]
    found = _estimate(lambda p: (along(p) - f) / top, starts, low, high)
    v = values(found.best)
    warnings = []
    if not branches.holds and fastest < ONE_SPEED * min(speeds.values(), default=fastest):
        warnings.append(
            "all cycles have about the same speed, and there is no hold: the test cannot tell a "
            "loss that depends on the rate from one that does not"
        )
    left = along(found.best) - f
    rms = float(np.sqrt(np.mean(left**2)))
    entry: dict[str, Any] = {"law": "stulov", "stulov": {k: v[k] for k in v if k != "zero"}}
    if law == "rate":
        own = memory(v)
        entry = {"law": "felt_memory", "memory": {**own, "envelope": own["envelope"].table()}}
    interval = {k: _interval(found, values, k) for k in v if k != "zero" or test.zero is None}
    e = x - v.get("zero", 0.0)
    return LawFit(
        law, test.name, v, interval, rms, rms / top, e, f, left + f, tuple(warnings), entry
    )


@checked
def fit_law(
    test: Specimen,
    law: Literal[
        "power", "exponential", "van_wyk", "van_wyk_3", "maxwell", "stulov", "rate"
    ] = "power",
    *,
    thickness: float | None = None,
) -> LawFit:
    """Fit a law with few parameters to a test.

    Parameters
    ----------
    test
        The test; ``read_specimen`` reads it from a file. If its ``zero`` is not given, the first
        contact of a law of loading is fitted.
    law
        Of loading, with the loss open: ``"power"``, ``stiffness e^exponent``; ``"exponential"``,
        ``a e exp(b e) + c e`` with a + c >= 0 (eq. 4.21 of the thesis); ``"van_wyk"``,
        ``scale ((1 - e/thickness)^-exponent - 1)``, and ``"van_wyk_3"`` with van Wyk's exponent 3.

        ``"maxwell"``: the hold under the largest load, ``rest`` and, for each branch, its force
        relative to the rest after a sudden compression (``share_1``) and its time (``time_1``). The
        force before the hold tells how much of a branch relaxed already.

        Of cycles of several speeds: ``"stulov"``, and ``"rate"``, the law with memory of the
        slowest cycle with ``rate_amplitude`` and ``rate_time``. ``scale`` is a factor of its
        forces, because that cycle has a share of the rate too.
    thickness
        Thickness at the first contact [m], for van Wyk's law; default: fitted.

    Raises
    ------
    DataError
        The test has too few samples, no hold, or no clock.
    """
    if law in ("maxwell", "stulov", "rate") and test.time is None:
        raise DataError(f"{test.name}: no column of time, expected one for the law {law}")
    if law == "maxwell":
        return _fit_relaxation(test)
    rate = law == "stulov" or law == "rate"
    found = _fit_rate(test, law) if rate else _fit_loading(test, law, thickness)  # type: ignore[arg-type]
    if not test.by_thickness or "zero" not in found.values:
        return found
    ends = {k: (-high, -low) for k, (low, high) in found.interval.items() if k == "zero"}
    values = {**found.values, "zero": -found.values["zero"]}  # as the thickness is read
    return replace(found, values=values, interval={**found.interval, **ends})
