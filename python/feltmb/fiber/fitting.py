"""Identification of compression laws from measured curves."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from feltmb._core import fiber as _core
from feltmb.fiber.data import CompressionData
from feltmb.fiber.laws import law, models
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter

Array = NDArray[np.float64]

DEFAULT_FREE: dict[str, tuple[str, ...]] = {
    "van_wyk": ("k_p",),
    "neckar": ("k_p", "v_fm"),
    "stamm": ("k_p", "w_f"),
    "toll_planar": ("E",),
    "narter": ("K_E", "gamma"),
    "alkhagen_toll": ("k_b", "k_t", "beta"),
    "binomial": ("K_p", "gamma"),
    "bending_chain": ("K_p", "gamma"),
    "komori_itoh": ("E",),
    "komori_itoh_renewed": ("E",),
    "lee_carnaby": ("E", "chord_ratio"),
}
"""Parameters that a fit determines by default; the others keep their given values."""

# The pressure is proportional to each of these; several of them only determine a common scale.
_SCALE: dict[str, tuple[str, ...]] = {
    "van_wyk": ("k_p", "E"),
    "neckar": ("k_p", "E"),
    "stamm": ("k_p", "E"),
    "toll_planar": ("E",),
    "narter": ("K_E", "E"),
    "alkhagen_toll": ("E",),
    "binomial": ("K_p",),
    "bending_chain": ("K_p", "E"),
    "komori_itoh": ("E",),
    "komori_itoh_renewed": ("E",),
    "lee_carnaby": ("E",),
}

THICKNESS = "thickness0"
"""Name of the unloaded thickness [m] in a fit that estimates it."""

WOOL_MODULUS = 2.5e9
"""Default fiber modulus [Pa]: wool, between 2.38 and 2.53 GPa."""


@dataclass(frozen=True)
class Fit:
    """Result of an identification."""

    model: str
    free: tuple[str, ...]
    values: dict[str, float]
    """All parameters of the law in SI units, fitted and fixed."""
    units: dict[str, str]
    interval: dict[str, tuple[float, float]]
    """Confidence interval of every free parameter; infinite ends if the data do not determine
    it."""
    level: float
    """Confidence level of the intervals [-]."""
    correlation: Array
    """Correlation matrix of the free parameters, shape (p, p); of their logarithms if these are
    fitted."""
    singular_values: Array
    """Singular values of the derivative of the residuals by the scaled parameters, relative to the
    largest."""
    v_f: Array
    """Volume fraction of the data [-]."""
    pressure: Array
    """Pressure of the data [Pa]."""
    fitted: Array
    """Pressure of the law at the data [Pa]."""
    rmse: float
    """Root mean square residual [Pa]."""
    bic: float
    """Bayesian information criterion, n log(SSR/n) + (p + 1) log n; smaller is better."""
    r_squared: float
    warnings: tuple[str, ...]
    method: str
    n_starts: int
    n_best: int
    """Number of starts whose sum of squares is within 0.1 % of the best one."""
    branch: str
    name: str
    at_bound: tuple[str, ...] = field(default=())
    undetermined: tuple[str, ...] = field(default=())
    """Parameters that the data do not determine: their interval is the complete range of the
    search, or the unloaded state includes an impossible state."""
    reference: str = "given"
    """Source of the unloaded state: "given" or "estimated"."""

    @property
    def residuals(self) -> Array:
        """Data minus law [Pa]."""
        return self.pressure - self.fitted

    def law(self) -> _core.CompressionLaw:
        """Law with the fitted parameters."""
        return law(self.model, **{k: v for k, v in self.values.items() if k != THICKNESS})


def _defaults(model: str, data: CompressionData) -> dict[str, float]:
    values: dict[str, float] = {"v_f0": data.v_f0}
    for p in models()[model].parameters:
        if p.name == "E":
            values["E"] = WOOL_MODULUS
        elif p.name == "v_fm" and model == "stamm":
            values["v_fm"] = 1.0
        elif p.name not in values and not math.isnan(p.default):
            values[p.name] = p.default
    return values


@checked
def fit(
    data: CompressionData,
    model: str,
    *,
    free: Sequence[str] | None = None,
    fixed: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    start: Mapping[str, float] | None = None,
    branch: str = "loading",
    method: str = "least_squares",
    n_starts: int = 12,
    seed: int = 0,
    relative: float = 0.0,
    level: float = 0.95,
) -> Fit:
    """Fit a compression law to one branch of a test.

    If the test does not state its unloaded state (``data.reference_known`` is False), the unloaded
    state is a further free parameter. It is ``"thickness0"`` for a test by thickness, at least the
    largest thickness under load, or else ``"v_f0"``, at most the smallest volume fraction under
    load. Its uncertainty is included in all intervals.

    Minimizes the sum over samples of ``((P_law - P_data) / w)^2`` with
    ``w = 1 + relative * P_data / max(P_data)`` (relative = 0: equal weights), from several starts.

    Parameters
    ----------
    data
        Test, see :func:`read_compression`.
    model
        Name of a compression law.
    free
        Parameters to identify; default: :data:`DEFAULT_FREE`.
    fixed
        Values of the other parameters in SI units. Defaults: E = 2.5 GPa (wool), v_f0 of the data,
        Q = 2, v_random = v_f0.
    bounds
        ``name -> (low, high)``; default: the usual range of the law.
    start
        One start; the others are random within the bounds.
    branch
        ``"loading"``, ``"unloading"`` or ``"both"`` (one curve through both).
    method
        ``"least_squares"`` (trust region with bounds) or ``"nelder_mead"`` (as in the thesis).
    n_starts
        Number of starts.
    seed
        Seed of the random starts.
    relative
        Weight of a relative error, see above.
    level
        Confidence level of the intervals.

    Returns
    -------
    Fit
        Values, intervals (linearized, Student t, in the scale the parameter is fitted in),
        correlation, residuals, BIC, warnings.

    Raises
    ------
    InvalidParameter
        Names or values are unknown or contradictory; all of them are in the message.
    """
    asked = FitOptions(
        model=model,
        free=None if free is None else tuple(free),
        fixed=fixed or {},
        bounds=bounds or {},
        start=start or {},
        method=method,
        n_starts=n_starts,
        seed=seed,
        relative=relative,
        level=level,
    )
    return _fit(data, [asked], (branch,))[0]


@checked
def fit_branches(
    data: CompressionData,
    model: str,
    *,
    branches: Sequence[str] = ("loading", "unloading"),
    **options: Any,
) -> list[Fit]:
    """Fit a compression law to several branches of a test, each with parameters of its own.

    The unloaded state belongs to the sample. If the test does not state it, it is estimated once,
    from all branches. Each branch is weighted by the scatter about its own best fit.

    Parameters
    ----------
    data
        Test, see :func:`read_compression`.
    model
        Name of a compression law.
    branches
        Names of branches: ``"loading"``, ``"unloading"``, ``"both"``.
    options
        Options of :func:`fit`, besides ``branch``.

    Returns
    -------
    list of Fit
        Fits in the order of ``branches``.

    Raises
    ------
    InvalidParameter
        Names or values are unknown or contradictory; all of them are in the message.
    """
    if not branches:
        raise InvalidParameter("fit_branches: no branch, expected at least one")
    return _fit(data, [FitOptions(model=model, **options)] * len(branches), tuple(branches))


@checked
@dataclass(frozen=True, kw_only=True)
class FitOptions:
    """Options of a fit, see :func:`fit`."""

    model: str
    free: Sequence[str] | None = None
    fixed: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    start: Mapping[str, float] = field(default_factory=dict)
    method: str = "least_squares"
    n_starts: int = 12
    seed: int = 0
    relative: float = 0.0
    level: float = 0.95

    def __post_init__(self) -> None:
        known = models()
        if self.model not in known:
            raise InvalidParameter(
                f'fit: model = "{self.model}", must be one of {", ".join(known)}'
            )
        described = [p.name for p in known[self.model].parameters]
        given = {
            "free": self.names,
            "fixed": tuple(self.fixed),
            "bounds": tuple(self.bounds),
            "start": tuple(n for n in self.start if n != THICKNESS),
        }
        faults = [
            f'fit, model "{self.model}": {what} parameter "{name}" is unknown, expected one of '
            f"{', '.join(described)}"
            for what, names in given.items()
            for name in names
            if name not in (*described, THICKNESS)
        ]
        if THICKNESS in (*self.names, *self.fixed, *self.bounds):
            faults.append(
                f'fit: "{THICKNESS}" is no parameter of a law; give it to read_compression, or '
                "leave it out there and it is estimated"
            )
        faults += [
            f'fit: parameter "{n}" is both free and fixed' for n in self.names if n in self.fixed
        ]
        if not self.names:
            faults.append("fit: no free parameter, expected at least one")
        if self.method not in ("least_squares", "nelder_mead"):
            faults.append(f'fit: method = "{self.method}", expected least_squares or nelder_mead')
        if self.n_starts < 1:
            faults.append(f"fit: n_starts = {self.n_starts}, expected >= 1")
        if not 0 < self.level < 1:
            faults.append(f"fit: level = {self.level:.6g}, expected between 0 and 1")
        if self.relative < 0:
            faults.append(f"fit: relative = {self.relative:.6g}, expected >= 0")
        if faults:
            raise InvalidParameter("\n".join(faults))

    @property
    def names(self) -> tuple[str, ...]:
        """Free parameters."""
        return DEFAULT_FREE[self.model] if self.free is None else tuple(self.free)


class _Curve:
    """One branch and a law: residuals as a function of the scaled free parameters."""

    def __init__(self, data: CompressionData, asked: FitOptions, branch: str):
        self.asked, self.branch = asked, branch
        model, fixed, bounds = asked.model, asked.fixed, asked.bounds
        described: dict[str, Any] = {p.name: p for p in models()[model].parameters}
        names = asked.names
        self.part = part = data.branch(branch)
        self.v, self.p = part.v_f, part.pressure
        self.reference: str | None = None
        """Name of the unloaded state as a parameter, if it is estimated."""
        if not data.reference_known and "v_f0" not in fixed and "v_f0" not in bounds:
            self.reference = "v_f0" if part.thickness is None else THICKNESS
            if self.reference not in names:
                names = (*names, self.reference)
            if part.thickness is not None:
                described[THICKNESS] = _thickness_parameter(data)
        self.names, self.described = names, described
        n, k = len(self.v), len(names)
        if n <= k:
            raise InvalidParameter(
                f"fit: {n} samples on branch {branch} for {k} free parameters, expected more "
                "samples"
            )
        self.base = {**_defaults(model, part), **fixed}
        for name in names:
            self.base.pop(name, None)
        missing = [
            m
            for m, d in described.items()
            if m not in self.base and m not in names and m != "v_random" and math.isnan(d.default)
        ]
        if missing:
            raise InvalidParameter(
                f'fit, model "{model}": {", ".join(missing)} neither free nor given, expected '
                "values"
            )
        low, high = _limits(names, described, bounds, self.v, self.base)
        if self.reference == "v_f0":
            at = names.index("v_f0")
            high[at] = min(high[at], data.loosest_loaded)
        self.low, self.high = low, high
        self.logs = np.array([described[m].log_scale and low[i] > 0 for i, m in enumerate(names)])
        self.weight = 1.0 / (1.0 + asked.relative * np.maximum(self.p, 0) / np.max(self.p))
        self.scale = float(np.max(np.abs(self.p)))
        self.curve(self.encode(low))
        self.at_values(0.5 * (low + high))  # reported instead of compensated

    def encode(self, x: Array) -> Array:
        return np.where(self.logs, np.log(np.where(self.logs, x, 1.0)), x)

    def decode(self, u: Array) -> Array:
        inside = np.clip(u, self.encode(self.low), self.encode(self.high))
        x = np.where(self.logs, np.exp(np.where(self.logs, inside, 0.0)), inside)
        return np.clip(x, self.low, self.high)

    def at_values(self, x: Array) -> tuple[_core.CompressionLaw, Array]:
        """Law with these parameters, and the measured volume fractions for them."""
        chosen = dict(zip(self.names, x.tolist(), strict=True))
        h0 = chosen.pop(THICKNESS, None)
        made = law(self.asked.model, **self.base, **chosen)
        if h0 is None or self.part.thickness is None:
            return made, self.v
        return made, np.minimum(self.part.v_f0 * h0 / self.part.thickness, 1.0)

    def curve(self, x: Array) -> Array:
        try:
            made, seen = self.at_values(x)
            result: Array = made.pressure(seen, 1)
        except InvalidParameter:
            return np.full(len(self.v), 1e3 * self.scale)
        far = 1e6 * self.scale
        return np.clip(np.nan_to_num(result, nan=far), -far, far)

    def residual(self, u: Array) -> Array:
        return np.asarray((self.curve(self.decode(u)) - self.p) * self.weight / self.scale)

    def starts(self) -> list[Array]:
        """Start in the middle of the range or as given, then random ones."""
        rng = np.random.default_rng(self.asked.seed)
        lower, upper = self.encode(self.low), self.encode(self.high)
        result = []
        for number in range(self.asked.n_starts):
            u = lower + (upper - lower) * rng.uniform(size=len(self.names))
            if number == 0:
                u = lower + 0.5 * (upper - lower)
                if self.asked.start:
                    middle = zip(self.names, self.decode(u).tolist(), strict=True)
                    x = np.array([self.asked.start.get(m, value) for m, value in middle])
                    result.append(self._within(x))
                    continue
            result.append(self._scaled(u))
        return result

    def _within(self, x: Array) -> Array:
        """Parameters of the search of these values, within their limits."""
        u = self.encode(np.clip(x, self.low, self.high))
        return np.clip(u, self.encode(self.low), self.encode(self.high))

    def _scaled(self, u: Array) -> Array:
        """The same start with the best scale of the pressure, which is known in closed form."""
        scalers = [i for i, m in enumerate(self.names) if m in _SCALE[self.asked.model]]
        together = [i for i, m in enumerate(self.names) if m in ("k_b", "k_t")]
        movable = scalers[:1] or (together if len(together) == 2 else together[:1])
        for _ in range(3 if movable else 0):
            x = self.decode(u)
            c = self.curve(x)
            denominator = float(np.sum((c * self.weight) ** 2))
            factor = 1.0
            if denominator > 0:
                factor = float(np.sum(c * self.p * self.weight**2)) / denominator
            if not factor > 0:
                break
            x[movable] *= factor
            u = self._within(x)
        return u


class _Problem:
    """Curves that are fitted together; their unloaded state is a common parameter."""

    def __init__(
        self, curves: Sequence[_Curve], spread: Sequence[float], *, common: bool = True
    ) -> None:
        self.curves, self.spread = curves, spread
        own = [np.arange(len(c.names)) for c in curves]
        self.places = _places(curves) if common else own
        """Indices of the parameters of each curve."""
        size = 1 + max(int(np.max(at)) for at in self.places)
        self.low, self.high = np.full(size, -np.inf), np.full(size, np.inf)
        for c, at in zip(curves, self.places, strict=True):
            self.low[at] = np.maximum(self.low[at], c.encode(c.low))
            self.high[at] = np.minimum(self.high[at], c.encode(c.high))

    def residual(self, u: Array) -> Array:
        """Residuals of all curves, each over its scatter."""
        parts = zip(self.curves, self.places, self.spread, strict=True)
        return np.concatenate([c.residual(u[at]) / s for c, at, s in parts])

    def minimized(self, u0: Array) -> tuple[float, Array]:
        """Sum of squares and parameters of the minimum from a start."""
        from scipy import optimize

        low, high = self.low, self.high
        if self.curves[0].asked.method == "least_squares":
            margin = 1e-9 * (high - low)
            found = optimize.least_squares(
                self.residual,
                np.clip(u0, low + margin, high - margin),
                bounds=(low, high),
                jac="3-point",
                x_scale="jac",
                xtol=1e-13,
                ftol=1e-13,
                gtol=1e-13,
                max_nfev=300,
            )
            return float(2 * found.cost), np.asarray(found.x)
        found = optimize.minimize(
            lambda u: float(np.sum(self.residual(u) ** 2)),
            u0,
            method="Nelder-Mead",
            bounds=list(zip(low, high, strict=True)),
            options={
                "xatol": 1e-9,
                "fatol": 1e-16,
                "maxiter": 4000,
                "maxfev": 8000,
                "adaptive": len(u0) > 2,
            },
        )
        return float(found.fun), np.asarray(found.x)

    def jacobian(self, u: Array) -> Array:
        """Derivative of the residuals."""
        columns = []
        for i in range(len(u)):
            h = 1e-5 * max(1.0, abs(u[i]))
            up, down = u.copy(), u.copy()
            up[i] = min(u[i] + h, self.high[i])
            down[i] = max(u[i] - h, self.low[i])
            columns.append((self.residual(up) - self.residual(down)) / (up[i] - down[i]))
        return np.array(columns).T


def _fit(data: CompressionData, each: Sequence[FitOptions], branches: Sequence[str]) -> list[Fit]:
    """One fit per branch; an estimated unloaded state is a common parameter of all branches."""
    curves = [_Curve(data, own, branch) for own, branch in zip(each, branches, strict=True)]
    best: list[Array] = []
    agree: list[int] = []
    spread: list[float] = []
    for c in curves:
        alone = _Problem([c], [1.0], common=False)
        found = sorted((alone.minimized(u0) for u0 in c.starts()), key=lambda pair: pair[0])
        best.append(found[0][1])
        agree.append(sum(cost <= found[0][0] * 1.001 + 1e-30 for cost, _ in found))
        spread.append(math.sqrt(found[0][0] / (len(c.v) - len(c.names))))
    if len(curves) == 1 or curves[0].reference is None:
        fits = [
            _evaluate(_Problem([c], [1.0], common=False), u, [n])[0]
            for c, u, n in zip(curves, best, agree, strict=True)
        ]
    else:
        # Without noise, the scatter of a curve is only rounding.
        problem = _Problem(curves, [max(s, 1e-9) for s in spread])
        joint = []
        for first in range(len(curves)):  # one start for the common state of each branch
            u = np.zeros(len(problem.low))
            for i in [*range(len(curves)), first]:
                u[problem.places[i]] = best[i]
            joint.append(problem.minimized(np.clip(u, problem.low, problem.high)))
        fits = _evaluate(problem, min(joint, key=lambda p: p[0])[1], agree)
    fits = [replace(f, warnings=(*data.notes, *f.warnings)) for f in fits]
    return _hold_given(data, each[0], branches, fits)


def _places(curves: Sequence[_Curve]) -> list[NDArray[np.int_]]:
    """Indices of the parameters of each branch in one vector; the unloaded state is common."""
    places, size = [], 1
    for c in curves:
        at = np.zeros(len(c.names), int)
        own = [i for i, name in enumerate(c.names) if name != c.reference]
        at[own] = size + np.arange(len(own))
        size += len(own)
        places.append(at)
    return places


@dataclass(frozen=True)
class _Optimum:
    """Best parameters of one problem, and how well the test tells them.

    All arrays are over the parameters of the problem; ``best`` are those of the search.
    """

    problem: _Problem
    best: Array
    values: Array
    """Values of the parameters."""
    span: Array
    """A parameter that changes over its complete range changes the curve by column * span."""
    singular: Array
    """Singular values over the largest one."""
    covariance: Array
    """Covariance of the parameters over their span."""
    blind: NDArray[np.bool_]
    """Parameters on which the curve does not depend."""
    quantile: float
    """Half an interval over the standard deviation."""

    @classmethod
    def of(cls, problem: _Problem, best: Array) -> _Optimum:
        """Optimum at the best parameters of a search."""
        from scipy import stats

        size, curves = len(best), problem.curves
        logs, values = np.zeros(size, bool), np.zeros(size)
        for c, at in zip(curves, problem.places, strict=True):
            logs[at], values[at] = c.logs, c.decode(best[at])
        freedom = sum(len(c.v) for c in curves) - size
        weighted = float(np.sum(problem.residual(best) ** 2))
        span = np.where(logs, 1.0, np.maximum(np.abs(values), 1e-12))
        _, singular, vt = np.linalg.svd(problem.jacobian(best) * span, full_matrices=False)
        ratio = singular / singular[0] if singular[0] > 0 else np.zeros_like(singular)
        lost = ratio < 1e-9
        inverse = np.where(lost, 0.0, 1.0 / np.where(lost, 1.0, singular))
        covariance = (vt.T * inverse**2) @ vt * (weighted / freedom)
        blind = np.any(np.abs(vt[lost]) > 1e-6, axis=0) if lost.any() else np.zeros(size, bool)
        quantile = float(stats.t.ppf(0.5 + 0.5 * curves[0].asked.level, freedom))
        return cls(problem, best, values, span, ratio, covariance, blind, quantile)

    def interval(self, at: int, log: bool) -> tuple[float, float]:
        """Interval of a parameter."""
        if self.blind[at]:
            return -math.inf, math.inf
        x = float(self.values[at])
        half = float(self.quantile * np.sqrt(self.covariance[at, at]) * self.span[at])
        if not log:
            return x - half, x + half
        top = math.log(x) + half
        bottom = math.exp(max(-700.0, math.log(x) - half))
        return bottom, math.exp(top) if top < 700 else math.inf

    def correlation(self, at: NDArray[np.int_]) -> Array:
        """Correlation matrix of some parameters."""
        sd = np.sqrt(np.diag(self.covariance)[at])
        out: Array = self.covariance[np.ix_(at, at)] / np.maximum(np.outer(sd, sd), 1e-300)
        return out

    def at_edge(self, at: NDArray[np.int_]) -> NDArray[np.bool_]:
        """Whether parameters are at a limit of the search."""
        low, high = self.problem.low, self.problem.high
        edge = np.minimum(self.best - low, high - self.best)[at]
        out: NDArray[np.bool_] = edge < 1e-4 * (high - low)[at]
        return out


def _evaluate(problem: _Problem, best: Array, agree: Sequence[int]) -> list[Fit]:
    """Values, intervals and warnings at the best parameters of one problem."""
    found = _Optimum.of(problem, best)
    return [
        _evaluated(c, found, at, n_best, len(problem.curves))
        for c, at, n_best in zip(problem.curves, problem.places, agree, strict=True)
    ]


def _evaluated(c: _Curve, found: _Optimum, at: NDArray[np.int_], n_best: int, branches: int) -> Fit:
    """Fit of one branch."""
    asked, names, p = c.asked, c.names, c.p
    n, k = len(p), len(names)
    x, blind = found.values[at], found.blind[at]
    correlation = found.correlation(at)
    interval = {
        name: found.interval(int(i), bool(log))
        for name, i, log in zip(names, at, c.logs, strict=True)
    }
    values = {**c.base, **dict(zip(names, x.tolist(), strict=True))}
    if "v_random" in c.described and "v_random" not in values and asked.model != "bending_chain":
        values["v_random"] = values["v_f0"]
    # Down to the first limit, the unloaded state is that of a sample in the file; beyond the other
    # limit, no felt exists.
    reported = tuple(
        m for m, edge in zip(names, found.at_edge(at), strict=True) if edge and m != c.reference
    )
    warnings = [
        *_loose(c, interval, blind),
        *(f"{m} = {values[m]:.4g} lies at a bound of the search" for m in reported),
        *_together(names, correlation, blind),
        *_unphysical(asked.model, names, values),
    ]
    undetermined = [
        m
        for i, m in enumerate(names)
        if blind[i] or (interval[m][0] <= c.low[i] and interval[m][1] >= c.high[i])
    ]
    if c.reference is not None:
        undetermined += _judge_reference(
            names, interval, c.low, c.high, undetermined, warnings, branches
        )
    if n_best < max(1, asked.n_starts // 4) and asked.n_starts > 3:
        warnings.append(
            f"only {n_best} of {asked.n_starts} starts reached the best fit: several minima"
        )
    fitted = c.curve(x)
    ssr = float(np.sum((fitted - p) ** 2))
    mean = float(np.sum((p - np.mean(p)) ** 2))
    return Fit(
        model=asked.model,
        free=names,
        values=values,
        units={m: d.unit for m, d in c.described.items()},
        interval=interval,
        level=asked.level,
        correlation=correlation,
        singular_values=found.singular,
        v_f=c.at_values(x)[1],
        pressure=p,
        fitted=fitted,
        rmse=math.sqrt(ssr / n),
        bic=n * math.log(max(ssr, 1e-300) / n) + (k + 1) * math.log(n),
        r_squared=1 - ssr / mean if mean > 0 else float("nan"),
        warnings=tuple(warnings),
        method=asked.method,
        n_starts=asked.n_starts,
        n_best=n_best,
        branch=c.branch,
        name=c.part.name,
        at_bound=reported,
        undetermined=tuple(undetermined),
        reference="given" if c.reference is None else "estimated",
    )


def _hold_given(
    data: CompressionData, asked: FitOptions, branches: Sequence[str], fits: list[Fit]
) -> list[Fit]:
    """Warn if the test indicates another unloaded thickness than the given one."""
    h0 = data.thickness0
    if h0 is None or "v_f0" in (*asked.fixed, *asked.bounds, *(asked.free or ())):
        return fits
    each = []
    for f in fits:
        start = {**{name: f.values[name] for name in f.free}, THICKNESS: h0}
        each.append(replace(asked, start=start, n_starts=1))
    try:
        free = _fit(replace(data, reference_known=False), each, branches)
    except InvalidParameter:  # too few samples for an estimate
        return fits
    # A BIC that is less by 10 is very strong evidence (Kass and Raftery 1995).
    if not sum(f.bic for f in free) < sum(f.bic for f in fits) - 10.0:
        return fits
    bottom, top = free[0].interval[THICKNESS]
    both = [" and ".join(f"{f.rmse:.4g} Pa ({f.branch})" for f in some) for some in (free, fits)]
    warning = (
        f"the unloaded thickness of {h0 * 1e3:.5g} mm that was given and this law do not agree "
        f"with the test together: the law asks for {free[0].values[THICKNESS] * 1e3:.5g} mm "
        f"({bottom * 1e3:.5g} to {top * 1e3:.5g} mm), RMSE {both[0]}; with what was given it is "
        f"{both[1]}. Measure the thickness again, or take another law"
    )
    return [replace(f, warnings=(warning, *f.warnings)) for f in fits]


def _thickness_parameter(data: CompressionData) -> SimpleNamespace:
    """Unloaded thickness as a parameter, from the largest under load to completely filled space."""
    assert data.thickness is not None
    low = data.thickest_loaded  # of both branches
    high = float(np.min(data.thickness)) / data.v_f0
    return SimpleNamespace(
        name=THICKNESS, unit="m", default=math.nan, fit_low=low, fit_high=high, log_scale=True
    )


def _judge_reference(
    names: tuple[str, ...],
    interval: dict[str, tuple[float, float]],
    low: Array,
    high: Array,
    known: Sequence[str],
    warnings: list[str],
    branches: int,
) -> list[str]:
    """Limit the interval of the unloaded state and add a warning about its estimate."""
    name = THICKNESS if THICKNESS in names else "v_f0"
    i = names.index(name)
    bottom, top = interval[name]
    thick = name == THICKNESS
    far = top >= high[i] if thick else bottom <= low[i]
    interval[name] = (max(bottom, low[i]), min(top, high[i]))
    bottom, top = interval[name]
    factor, unit, option = (1e3, " mm", "thickness0") if thick else (1.0, "", "v_f0")
    bound = low[i] if thick else high[i]
    whence = " from all branches" if branches > 1 else ""
    what = (
        f"{'unloaded thickness' if thick else 'v_f0'} was not given: estimated{whence}, between "
        f"{bottom * factor:.5g} and {top * factor:.5g}{unit}; the file is under load at "
        f"{bound * factor:.5g}{unit}"
    )
    if far or name in known:
        warnings.insert(
            0, f"{what}. The data do not determine it: measure it and give {option}, see --help"
        )
        return [] if name in known else [name]
    warnings.insert(0, f"{what}. All intervals include this uncertainty")
    return []


def _limits(
    names: tuple[str, ...],
    described: Mapping[str, Any],
    bounds: Mapping[str, tuple[float, float]],
    v: Array,
    base: Mapping[str, float],
) -> tuple[Array, Array]:
    low = np.array([described[m].fit_low for m in names])
    high = np.array([described[m].fit_high for m in names])
    top = float(np.max(v))
    for i, name in enumerate(names):
        # Jamming must be beyond the data.
        if name == "v_fm":
            low[i] = min(0.999, top * 1.0005)
        if name == "w_f":
            low[i] = min(0.999, top**3 / base.get("v_fm", 1.0) ** 2 * 1.0005)
        if name == "v_f0":
            high[i] = top * 0.999
        if name in bounds:
            low[i], high[i] = bounds[name]
    bad = [
        f"fit: bounds of {m} = ({low[i]:.6g}, {high[i]:.6g}), expected low < high"
        for i, m in enumerate(names)
        if not low[i] < high[i]
    ]
    if bad:
        raise InvalidParameter("\n".join(bad))
    return low, high


def _loose(
    c: _Curve, interval: Mapping[str, tuple[float, float]], blind: NDArray[np.bool_]
) -> Iterator[str]:
    """Warnings of parameters that the data hardly determine."""
    for i, name in enumerate(c.names):
        bottom, top = interval[name]
        if blind[i]:
            yield f"{name} is not identifiable: the curve does not depend on it here"
        elif bottom <= c.low[i] and top >= c.high[i]:
            yield (
                f"{name} is not identifiable: its interval ({bottom:.3g}, {top:.3g}) covers the "
                f"whole range searched ({c.low[i]:.3g}, {c.high[i]:.3g})"
            )
        elif top > 0 and bottom > 0 and top / bottom > 1e3:
            yield f"{name} is poorly identifiable: interval {bottom:.3g} to {top:.3g}"


def _together(
    names: tuple[str, ...], correlation: Array, blind: NDArray[np.bool_]
) -> Iterator[str]:
    """Warnings of parameters of which only a combination is determined."""
    for i in range(len(names)):
        for j in range(i):
            if not (blind[i] or blind[j]) and abs(correlation[i, j]) > 0.999:
                yield (
                    f"{names[j]} and {names[i]} are correlated {correlation[i, j]:+.4f}: "
                    "only a combination of them is identified"
                )


def _unphysical(model: str, names: tuple[str, ...], values: Mapping[str, float]) -> list[str]:
    """Warnings of values that no felt has."""
    out: list[str] = []
    gamma = values.get("gamma")
    if gamma is not None and gamma <= 0:
        out.append(
            f"gamma = {gamma:.4g} is unphysical (a blocked length cannot be negative): axial "
            "deformation of fibers is not what carries the load"
        )
    elif gamma is not None and gamma > 10:
        out.append(f"gamma = {gamma:.4g} is far from its geometric value pi/2")
    if model == "alkhagen_toll":
        if "k_t" in names and values["k_t"] < 1e-6:
            out.append(
                "k_t is near zero: the crimp term vanishes, torsion and beta are not identifiable"
            )
        if values["k_b"] > 100:
            out.append(f"k_b = {values['k_b']:.4g} is far above 1 of a clamped beam: unphysical")
    if values.get("k_p", 0) > 10:
        out.append(f"k_p = {values['k_p']:.4g} is far above the theory's 3/8: unphysical")
    arcs = ("komori_itoh", "komori_itoh_renewed", "lee_carnaby", "toll_planar")
    if model in arcs and "E" in names:
        out.append("E is an effective modulus here; compare it with that of the fiber")
    return out


@checked
def compare(
    data: CompressionData,
    names: Sequence[str] | None = None,
    *,
    branch: str = "loading",
    fixed: Mapping[str, float] | None = None,
    **options: Any,
) -> list[Fit]:
    """Fit several laws and sort them by BIC, best first.

    Parameters
    ----------
    data
        Test.
    names
        Names of laws; default: all.
    branch
        See :func:`fit`; ``"each"``: both branches separately, by :func:`fit_branches`, loading
        first.
    fixed
        Values of parameters that are not fitted; each law uses its own parameters that are not
        free.
    options
        Options of :func:`fit`.
    """
    known = models()
    results: list[Fit] = []
    for name in names or list(known):
        if name not in known:
            raise InvalidParameter(f'compare: model = "{name}", must be one of {", ".join(known)}')
        own = {p.name for p in known[name].parameters} - set(DEFAULT_FREE[name])
        given = {k: v for k, v in (fixed or {}).items() if k in own}
        if branch == "each":
            results += fit_branches(data, name, fixed=given, **options)
        else:
            results.append(fit(data, name, branch=branch, fixed=given, **options))
    return sorted(results, key=lambda f: (f.branch, f.bic))
