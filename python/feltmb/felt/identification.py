"""Two-step procedure of thesis section 3.3.2: a felt from a measured loop.

Step 1 separates friction from the measured pressures. At each volume fraction, it finds the contact
force C for the measured pressure, and with it the critical angle, the proportion of sliding
contacts and the stress of the sticking contacts. Step 2 fits the elastic law, eq. 3.64 minus its
value at v_f0, to that stress. The free length in step 1 depends on the gamma of step 2. Both steps
are therefore repeated until they converge, separately for each branch.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from feltmb._core import fiber as _core
from feltmb.fiber import CompressionData
from feltmb.fiber.data import slack_fault
from feltmb.fiber.material import (
    Branch,
    BranchCurve,
    CriticalAngles,
    FeltMaterial,
    sliding_at_pressure,
)
from unmodeled.arguments import checked
from unmodeled.errors import DataError, InvalidParameter, ModelError

Array = NDArray[np.float64]
BranchName = Literal["loading", "unloading"]

LOADING_ONLY = (
    "; of loading only, `feltmb felt law` fits a law, and `feltmb felt contact --loss` makes a "
    "table with an assumed loss"
)
_TOLERANCE = 1e-10  # of log gamma
_GAMMA_RANGE = (1e-3, 30.0)
_PLAUSIBLE_GAMMA = (0.5, 5.0)


@dataclass(frozen=True)
class BranchFit:
    """One branch: data, components and fit. Arrays over the samples, sorted by volume fraction."""

    which: BranchName
    v_f: Array
    """Volume fraction of the data [-]."""
    pressure: Array
    """Pressure of the data [Pa]."""
    elastic: Array
    """Stress of the sticking contacts, computed from the data [Pa]."""
    friction: Array
    """Stress of the sliding contacts, computed from the data [Pa]."""
    theta_cr: Array
    """Critical angle, computed from the data [rad]."""
    r_sc: Array
    """Proportion of sliding contacts [-]."""
    fitted_elastic: Array
    """Fitted elastic law [Pa]."""
    fitted: Array
    """Pressure of the identified felt [Pa]."""
    K_p: float
    """Coefficient of the elastic law [Pa]."""
    gamma: float
    """Blocked length per contact divided by the fiber diameter [-]."""
    interval: dict[str, tuple[float, float]]
    """Confidence intervals of ``K_p`` and ``gamma``."""
    correlation: float
    """Correlation of log K_p and log gamma [-]."""
    rounds: tuple[float, ...]
    """gamma after every round of the iteration."""
    ambiguous: int
    """Number of samples whose pressure belongs to several contact forces; the largest one was
    used."""

    @property
    def residuals(self) -> Array:
        """Measured minus identified pressure [Pa]."""
        return self.pressure - self.fitted

    @property
    def rmse(self) -> float:
        """Root mean square residual [Pa]."""
        return float(np.sqrt(np.mean(self.residuals**2)))

    @property
    def r_squared(self) -> float:
        """1 - residual sum of squares / total sum of squares [-]."""
        spread = self.pressure - self.pressure.mean()
        return 1.0 - float(np.sum(self.residuals**2) / np.sum(spread**2))


@dataclass(frozen=True)
class Identification:
    """Result of :func:`identify`."""

    material: FeltMaterial
    """The felt, with its table of critical angles."""
    loading: BranchFit
    unloading: BranchFit
    level: float
    """Confidence level of the intervals [-]."""
    warnings: tuple[str, ...]
    name: str
    """Name of the test."""
    thickness: float | None = None
    """Thickness without load [m], for a test by thickness: given or estimated."""
    thickness_interval: tuple[float, float] | None = None
    """Confidence interval of the estimated thickness [m]; None if it was given."""

    @property
    def closing_gap(self) -> float:
        """(P_U - P_L) / P_L of the identified felt at the end of the loop [-]."""
        end = [self.material.end]
        load = self.material.pressure("loading", end)[0]
        return float(self.material.pressure("unloading", end)[0] / load) - 1.0

    @property
    def measured_loss(self) -> float:
        """Share of the loading work that is lost between the samples of both branches [-].

        Over the compressions that both branches have. ``material.loss()`` is the loss of the fitted
        law up to the end of the loop, where its branches are closed.
        """
        depths = [1.0 - self.material.v_f0 / b.v_f for b in (self.loading, self.unloading)]
        low, high = max(d[0] for d in depths), min(d[-1] for d in depths)
        if not high > low:
            return math.nan
        x = np.linspace(low, high, 1001)
        load, back = (
            np.interp(x, d, b.pressure)
            for d, b in zip(depths, (self.loading, self.unloading), strict=True)
        )
        return 1.0 - float(np.sum(back[1:] + back[:-1]) / np.sum(load[1:] + load[:-1]))

    def report(self) -> str:
        """Markdown: parameters with intervals, quality, warnings."""
        m = self.material
        percent = f"{100 * self.level:g} %"
        lines = [
            f"# Felt identified from {self.name}",
            "",
            f"Volume fraction {m.v_f0:.4g} to {m.end:.4g}; friction between fibers "
            f"{m.fiber.friction:g}, withdrawal force {m.fiber.withdrawal_force:g} N/m, fiber "
            f"diameter {m.fiber.diameter * 1e6:g} um (given, not identified).",
            "",
            f"| branch | parameter | value | {percent} interval |",
            "|---|---|---|---|",
        ]
        if self.thickness is not None and self.thickness_interval is not None:
            low, high = self.thickness_interval
            lines.append(
                f"| both | unloaded thickness [mm], estimated | {self.thickness * 1e3:.5g} | "
                f"{low * 1e3:.5g} to {high * 1e3:.5g} |"
            )
        elif self.thickness is not None:
            lines.append(
                f"| both | unloaded thickness [mm], as given | {self.thickness * 1e3:.5g} | - |"
            )
        for b in (self.loading, self.unloading):
            for key, unit in (("K_p", "Pa"), ("gamma", "-")):
                low, high = b.interval[key]
                lines.append(
                    f"| {b.which} | {key} [{unit}] | {getattr(b, key):.5g} | "
                    f"{low:.5g} to {high:.5g} |"
                )
        lines += [
            "",
            "| branch | samples | rms residual [Pa] | R^2 | correlation K_p, gamma | rounds |",
            "|---|---|---|---|---|---|",
        ]
        for b in (self.loading, self.unloading):
            lines.append(
                f"| {b.which} | {len(b.v_f)} | {b.rmse:.4g} | {b.r_squared:.6f} | "
                f"{b.correlation:.4f} | {len(b.rounds)} |"
            )
        lines += [
            "",
            f"Loss of the loop: {100 * m.loss():.2f} % of the loading work. Unloading meets "
            f"loading at the end within {100 * self.closing_gap:+.2f} %.",
            "",
            "| v_f [-] | critical angle, loading [deg] | unloading [deg] | friction, loading |",
            "|---|---|---|---|",
        ]
        v = np.linspace(m.v_f0, m.end, 9)[1:]
        load, back = m.branch("loading", v), m.branch("unloading", v)
        for i, x in enumerate(v):
            share = load.friction[i] / load.pressure[i] if load.pressure[i] > 0 else 0.0
            lines.append(
                f"| {x:.4f} | {math.degrees(load.theta_cr[i]):.2f} | "
                f"{math.degrees(back.theta_cr[i]):.2f} | {100 * share:.1f} % |"
            )
        lines += ["", "## Warnings", ""]
        lines += [f"- {w}" for w in self.warnings] or ["None."]
        return "\n".join(lines) + "\n"


def _shape(v: Array, v0: float, q: float, gamma: float) -> Array:
    """Eq. 3.64 minus its value at v0, divided by K_p."""
    law = _core.CompressionLaw("binomial", {"K_p": 1.0, "gamma": gamma, "v_f0": v0, "Q": q})
    return np.asarray(law.pressure(v, 1), dtype=float)


def _shape_slope(v: Array, v0: float, q: float, gamma: float) -> Array:
    """Derivative of the shape by log gamma, central difference of fourth order."""
    h = 1e-3

    def at(k: float) -> Array:
        return _shape(v, v0, q, gamma * math.exp(k * h))

    return (8.0 * (at(1) - at(-1)) - (at(2) - at(-2))) / (12.0 * h)


def _fit_elastic(
    v: Array, stress: Array, weight: Array, v0: float, q: float, gamma: float
) -> tuple[float, float]:
    """Least squares of K_p and gamma; K_p enters linearly, so that only gamma is searched."""
    from scipy.optimize import brentq, minimize_scalar

    def best_K(g: float) -> tuple[float, Array]:
        f = _shape(v, v0, q, g) * weight
        return float(f @ (stress * weight) / (f @ f)), f

    def cost(log_gamma: float) -> float:
        K, f = best_K(math.exp(log_gamma))
        return float(np.sum((K * f - stress * weight) ** 2))

    def slope(log_gamma: float) -> float:
        # Derivative of the sum of squares; the part by K_p is zero at the best K_p.
        g = math.exp(log_gamma)
        K, f = best_K(g)
        return float((K * f - stress * weight) @ (K * weight * _shape_slope(v, v0, q, g)))

    low, high = (math.log(x) for x in _GAMMA_RANGE)
    start = minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": 1e-4}).x
    if abs(math.log(gamma) - start) > 2.0:
        grid = np.linspace(low, high, 81)
        start = float(grid[int(np.argmin([cost(g) for g in grid]))])
    a, b = start - 0.05, start + 0.05
    if slope(a) < 0.0 < slope(b):
        start = brentq(slope, a, b, xtol=1e-13, rtol=1e-13)
    found = math.exp(start)
    return best_K(found)[0], found


@dataclass(frozen=True)
class _Linear:
    """Linearized branch: sensitivity of its parameters to errors of its pressures."""

    gain: Array
    """d (log K_p, log gamma) / dP, shape (2, n)."""
    variance: Array
    """Variance of each pressure [Pa^2]."""
    weight: Array
    """Weight of each sample [-]."""
    freedom: int
    """Number of samples minus number of parameters."""


def _linear(
    v: Array,
    pressure: Array,
    fitted: Array,
    weight: Array,
    material: FeltMaterial,
    which: BranchName,
    branch: Branch,
) -> _Linear:
    """The complete procedure, friction and iteration included, to first order.

    The estimate solves J^T W (sigma(P, gamma) - f(K_p, gamma)) = 0 with J = df/d(log K_p, log
    gamma); the scatter of the estimate follows from the scatter of P by the implicit function
    theorem.
    """
    q, v0 = material.fiber.Q, material.v_f0
    f = branch.K_p * _shape(v, v0, q, branch.gamma)
    jacobian = np.column_stack([f, branch.K_p * _shape_slope(v, v0, q, branch.gamma)])
    h = 1e-5
    scale = float(np.max(np.abs(pressure)))

    def elastic(p: Array, gamma: float) -> Array:
        return sliding_at_pressure(material, v, p, which, gamma)[:, 5]

    change, ratio = h * scale, math.exp(h)
    by_pressure = elastic(pressure + change, branch.gamma) - elastic(
        pressure - change, branch.gamma
    )
    by_pressure /= 2 * change
    by_gamma = elastic(pressure, branch.gamma * ratio) - elastic(pressure, branch.gamma / ratio)
    by_gamma /= 2 * h
    moved = jacobian.copy()
    moved[:, 1] -= by_gamma
    weighted = (weight**2)[:, None] * jacobian
    normal = weighted.T @ moved
    gain = np.asarray(np.linalg.solve(normal, weighted.T * by_pressure), dtype=float)
    freedom = len(v) - 2
    residual = weight * (pressure - fitted)
    variance = float(residual @ residual) / freedom / weight**2
    return _Linear(gain, variance, weight, freedom)


def _with_intervals(fit: BranchFit, covariance: Array, freedom: int, level: float) -> BranchFit:
    """The fit with intervals from this covariance of log K_p and log gamma.

    Raises
    ------
    ModelError
        The data do not determine gamma.
    """
    from scipy.stats import t as student

    deviation = np.sqrt(np.diag(covariance))
    reach = float(student.ppf(0.5 + 0.5 * level, freedom)) * deviation
    low, high = (math.log(x / fit.gamma) for x in _GAMMA_RANGE)
    if -reach[1] <= low and reach[1] >= high:
        raise ModelError(
            f"identify: {fit.which}: gamma is undetermined: {100 * level:g} % of its values cover "
            f"all that was searched, {_GAMMA_RANGE[0]:g} to {_GAMMA_RANGE[1]:g}, and K_p goes with "
            "it. More compression, less scatter or more samples are needed; check the unloaded "
            "thickness and v_f0 too"
        )
    interval = {
        key: (value * math.exp(-min(r, 700.0)), value * math.exp(min(r, 700.0)))
        for key, value, r in zip(("K_p", "gamma"), (fit.K_p, fit.gamma), reach, strict=True)
    }
    product = float(deviation[0] * deviation[1])
    correlation = float(covariance[0, 1]) / product if product > 0 else 0.0
    return replace(fit, interval=interval, correlation=correlation)


def fixed_point(change: Callable[[float], float], start: float) -> float:
    """Where a round changes nothing, the first such point in the direction of the first change.

    At an end of the range, a round cannot lead out of it, so that there is such a point. Repeated
    rounds would reach it only if they contract.
    """
    from scipy.optimize import brentq

    low, high = (math.log(x) for x in _GAMMA_RANGE)
    here, value = start, change(start)
    reach = 1.2 * value
    while abs(value) > _TOLERANCE:
        there = min(max(here + reach, low), high)
        further = change(there)
        if further * value <= 0.0:
            return float(brentq(change, here, there, xtol=_TOLERANCE))
        if there in (low, high):
            return there
        here, value, reach = there, further, 2.0 * reach
    return here


def _identify_branch(
    which: BranchName,
    v: Array,
    pressure: Array,
    material: FeltMaterial,
    relative: float,
    start: float,
) -> tuple[BranchFit, _Linear]:
    """Fit one branch, without intervals."""
    order = np.argsort(v, kind="stable")
    v, pressure = v[order], pressure[order]
    weight = 1.0 / (1.0 + relative * np.maximum(pressure, 0.0) / np.max(pressure))
    q, v0 = material.fiber.Q, material.v_f0
    rounds: list[float] = []

    def change(x: float) -> float:
        """Change of log gamma by a round: friction at this gamma, then the best gamma."""
        rows = sliding_at_pressure(material, v, pressure, which, math.exp(x))
        rounds.append(_fit_elastic(v, rows[:, 5], weight, v0, q, math.exp(x))[1])
        return math.log(rounds[-1]) - x

    gamma = math.exp(fixed_point(change, math.log(start)))
    rows = sliding_at_pressure(material, v, pressure, which, gamma)
    K = _fit_elastic(v, rows[:, 5], weight, v0, q, gamma)[0]
    if not K > 0:
        raise ModelError(
            f"identify: {which}: the best K_p = {K:.6g} Pa, expected > 0: the elastic part of the "
            "data does not grow with compression"
        )
    if not 1.01 * _GAMMA_RANGE[0] < gamma < 0.99 * _GAMMA_RANGE[1]:
        raise ModelError(
            f"identify: {which}: gamma = {gamma:.4g} is at an end of its range, "
            f"{_GAMMA_RANGE[0]:g} to {_GAMMA_RANGE[1]:g}: the data have not the shape of the law. "
            "Check the unloaded thickness (thickness0, --thickness), v_f0 (--v-f0), the area "
            "(--area) and the fibers of the material"
        )
    branch = Branch(K_p=K, gamma=gamma)
    curve: BranchCurve = material.model_copy(update={which: branch}).branch(which, v)
    linear = _linear(v, pressure, curve.pressure, weight, material, which, branch)
    fit = BranchFit(
        which=which,
        v_f=v,
        pressure=pressure,
        elastic=rows[:, 5],
        friction=rows[:, 6] if which == "loading" else rows[:, 7],
        theta_cr=rows[:, 1],
        r_sc=rows[:, 2],
        fitted_elastic=curve.elastic,
        fitted=curve.pressure,
        K_p=K,
        gamma=gamma,
        interval={},
        correlation=math.nan,
        rounds=tuple(rounds),
        ambiguous=int(np.sum(rows[:, 8] == 0.0)),
    )
    return fit, linear


@dataclass(frozen=True)
class _Thickness:
    """Unloaded thickness from the loading branch, by its logarithm s."""

    value: float
    """Thickness [m]."""
    interval: tuple[float, float]
    """Confidence interval [m]."""
    row: Array
    """ds/dP for the pressures of loading."""
    variance: float
    """Variance of s [-]."""


def _estimate_thickness(
    test: CompressionData, base: FeltMaterial, relative: float, level: float
) -> _Thickness:
    """Unloaded thickness with the smallest sum of squares of loading; all else is fitted to it.

    Its scatter follows to first order from the condition of the least squares: D^T W^2 (P - F) = 0,
    where D is the derivative of the fitted pressures by s along the fits, and P are the data.

    Raises
    ------
    ModelError
        The data do not determine it.
    """
    from scipy.optimize import minimize_scalar
    from scipy.stats import t as student

    assert test.thickness is not None
    height, pressure = test.thickness[test.loading], test.pressure[test.loading]
    bottom = test.thickest_loaded
    # Up to the thickness at which fibers fill all but the space for friction and bending.
    top = 0.98 * float(np.min(test.thickness)) / base.v_f0
    span = math.log(top / bottom) if top > bottom else 0.0
    start = 1.5

    def at(s: float) -> tuple[BranchFit, _Linear]:
        v = base.v_f0 * bottom * math.exp(s) / height
        inside = v > base.v_f0 * (1.0 + 1e-12)
        return _identify_branch("loading", v[inside], pressure[inside], base, relative, start)

    def cost(s: float) -> float:
        try:
            fit, linear = at(s)
        except ModelError:
            return math.inf
        slack = pressure[height >= bottom * math.exp(s)]
        return float(np.sum((linear.weight * fit.residuals) ** 2) + np.sum(slack**2))

    grid = span * np.linspace(0.0, 1.0, 17) ** 2
    costs = [cost(float(s)) for s in grid]
    best = int(np.argmin(costs))
    unknown = (
        f"identify: {test.name}: the unloaded thickness was not given, and the data do not "
        "determine it"
    )
    ask = (
        f"The file is under load at {bottom * 1e3:.6g} mm: measure the thickness without load and "
        "give it (thickness0 of read_compression, --thickness)"
    )
    if span <= 0.0 or not math.isfinite(costs[best]) or best == len(grid) - 1:
        raise ModelError(f"{unknown}. {ask}")
    around = (float(grid[max(best - 1, 0)]), float(grid[best + 1]))
    found = float(
        minimize_scalar(cost, bounds=around, method="bounded", options={"xatol": 1e-7 * span}).x
    )
    fit, linear = at(found)
    start = fit.gamma
    h = min(1e-3, 0.1 * span)
    left = max(found - h, 0.0)
    (ahead, _), (behind, _) = at(found + h), at(left)
    n = len(fit.v_f)
    # The same samples, sorted by volume fraction; the loosest ones may be missing on the left.
    kept = min(n, len(behind.v_f))
    by_s = np.zeros(n)
    by_s[n - kept :] = (ahead.fitted[-kept:] - behind.fitted[-kept:]) / (found + h - left)
    by_parameters = np.column_stack(
        [
            (
                _fitted(base, "loading", fit, *(1e-4 * e))
                - _fitted(base, "loading", fit, *(-1e-4 * e))
            )
            / 2e-4
            for e in np.eye(2)
        ]
    )
    weighted = by_s * linear.weight**2
    row = (weighted - (weighted @ by_parameters) @ linear.gain) / float(weighted @ by_s)
    freedom = linear.freedom - 1
    variance = float((row * linear.variance * linear.freedom / freedom) @ row)
    reach = float(student.ppf(0.5 + 0.5 * level, freedom)) * math.sqrt(variance)
    value = bottom * math.exp(found)
    interval = (max(bottom, value * math.exp(-reach)), value * math.exp(min(reach, 700.0)))
    if interval[1] >= top:
        raise ModelError(
            f"{unknown}: {interval[0] * 1e3:.5g} to {min(interval[1], top) * 1e3:.5g} mm would do. "
            + ask
        )
    return _Thickness(value, interval, row, variance)


def _hold_given(test: CompressionData, base: FeltMaterial, relative: float) -> list[str]:
    """Warn if the test indicates another unloaded thickness than the given one."""
    given = test.thickness0
    if given is None or np.sum(test.loading) < 8 or test.v_f0 != base.v_f0:
        return []
    try:  # so unlikely that the thickness or the law is wrong
        own = _estimate_thickness(test, base, relative, 0.9999)
    except ModelError:  # the data do not determine it
        return []
    if own.interval[0] <= given <= own.interval[1]:
        return []
    return [
        f"The unloaded thickness of {given * 1e3:.5g} mm that was given does not agree with the "
        f"loading branch, which asks for {own.value * 1e3:.5g} mm, {own.interval[0] * 1e3:.5g} to "
        f"{own.interval[1] * 1e3:.5g} mm at 99.99 %. Measure it again, or leave it out."
    ]


def _fitted(
    material: FeltMaterial, which: BranchName, fit: BranchFit, log_K: float, log_gamma: float
) -> Array:
    """Pressure with changed parameters."""
    branch = Branch(K_p=fit.K_p * math.exp(log_K), gamma=fit.gamma * math.exp(log_gamma))
    return material.model_copy(update={which: branch}).branch(which, fit.v_f).pressure


def _spread(
    fits: tuple[tuple[BranchFit, _Linear], tuple[BranchFit, _Linear]],
    level: float,
    test: CompressionData,
    base: FeltMaterial,
    relative: float,
    thickness: _Thickness | None,
) -> tuple[BranchFit, BranchFit]:
    """Both branches with their intervals, including the uncertainty of an estimated thickness."""
    out = []
    for fit, linear in fits:
        if thickness is None:
            covariance = (linear.gain * linear.variance) @ linear.gain.T
            out.append(_with_intervals(fit, covariance, linear.freedom, level))
            continue
        keep = test.loading if fit.which == "loading" else ~test.loading
        assert test.thickness is not None
        h = 1e-3
        moved = []
        for side in (h, -h):
            v = base.v_f0 * thickness.value * math.exp(side) / test.thickness[keep]
            inside = v > base.v_f0 * (1.0 + 1e-12)
            pressure = test.pressure[keep][inside]
            other, _ = _identify_branch(fit.which, v[inside], pressure, base, relative, fit.gamma)
            moved.append(np.log([other.K_p, other.gamma]))
        by_s = (moved[0] - moved[1]) / (2 * h)
        if fit.which == "loading":
            gain = linear.gain + np.outer(by_s, thickness.row)
            freedom = linear.freedom - 1
            covariance = (gain * linear.variance * linear.freedom / freedom) @ gain.T
        else:
            freedom = linear.freedom
            covariance = (linear.gain * linear.variance) @ linear.gain.T
            covariance += thickness.variance * np.outer(by_s, by_s)
        out.append(_with_intervals(fit, covariance, freedom, level))
    return out[0], out[1]


def _as_data(
    data: CompressionData | ArrayLike,
    pressure: ArrayLike | None,
    loading: ArrayLike | None,
    v_f0: float,
) -> CompressionData:
    if isinstance(data, CompressionData):
        if pressure is not None or loading is not None:
            raise InvalidParameter(
                "identify: pressure or loading given beside a test, expected the test alone"
            )
        return data
    if pressure is None:
        raise InvalidParameter("identify: pressure is missing, expected one value per v_f [Pa]")
    v, p = np.asarray(data, dtype=float), np.asarray(pressure, dtype=float)
    if v.ndim != 1 or v.shape != p.shape:
        raise InvalidParameter(
            f"identify: v_f has shape {v.shape}, pressure {p.shape}; expected equal and one "
            "dimension"
        )
    bad = np.flatnonzero(~(np.isfinite(v) & np.isfinite(p)))
    if bad.size:
        raise DataError(
            f"identify: {bad.size} samples are not finite (first: index {bad[0]}, v_f = "
            f"{v[bad[0]]:g}, pressure = {p[bad[0]]:g} Pa), expected numbers"
        )
    if loading is None:
        up = np.arange(len(v)) <= int(np.argmax(v))
    else:
        up = np.asarray(loading, dtype=bool)
        if up.shape != v.shape:
            raise InvalidParameter(
                f"identify: loading has shape {up.shape}, expected that of v_f, {v.shape}"
            )
    return CompressionData(v, p, up, v_f0, "data")


def _estimated(
    test: CompressionData, base: FeltMaterial, relative: float, level: float, warnings: list[str]
) -> _Thickness:
    """Unloaded thickness from the loading branch, with a warning that it was not given."""
    if np.sum(test.loading) < 8:
        raise DataError(
            f"{test.name}: {int(np.sum(test.loading))} samples of loading, expected at least 8 "
            "to estimate the unloaded thickness"
        )
    thickness = _estimate_thickness(test, base, relative, level)
    low, high = (1e3 * x for x in thickness.interval)
    warnings.append(
        f"The unloaded thickness was not given: estimated as {thickness.value * 1e3:.5g} mm, "
        f"{low:.5g} to {high:.5g} mm; the file is under load at "
        f"{test.thickest_loaded * 1e3:.5g} mm. All intervals include this uncertainty."
    )
    return thickness


def _compressed(
    test: CompressionData, reference: float, warnings: list[str]
) -> dict[str, tuple[Array, Array]]:
    """Volume fractions and pressures of both branches above the unloaded state."""
    faults: list[str] = []
    branches: dict[str, tuple[Array, Array]] = {}
    for which, keep in (("loading", test.loading), ("unloading", ~test.loading)):
        v, p = test.v_f[keep], test.pressure[keep]
        inside = v > reference * (1.0 + 1e-12)
        if np.sum(inside) < 5:
            faults.append(
                f"{test.name}: {int(np.sum(inside))} samples of {which} above v_f0 = "
                f"{reference:.6g}, expected at least 5{LOADING_ONLY * bool(test.loading.all())}"
            )
            continue
        if np.max(v) >= 1:
            faults.append(f"{test.name}: v_f up to {np.max(v):.6g}, must be < 1")
        if not np.max(p[inside]) > 0:
            faults.append(f"{test.name}: no positive pressure of {which}, expected compression > 0")
        if below := int(np.sum(v < reference)):
            warnings.append(f"{which}: {below} samples below v_f0 = {reference:.4g} were left out.")
        branches[which] = (v[inside], p[inside])
    if faults:
        raise DataError("\n".join(faults))
    return branches


@checked
def identify(
    data: CompressionData | ArrayLike,
    pressure: ArrayLike | None = None,
    *,
    material: FeltMaterial,
    loading: ArrayLike | None = None,
    v_f0: float | None = None,
    relative: float = 0.0,
    level: float = 0.95,
    name: str | None = None,
) -> Identification:
    """Identify a felt from a measured loading-unloading loop (thesis section 3.3.2).

    If a test by thickness does not state the unloaded thickness (``reference_known`` is False), it
    is estimated from the loading branch by least squares. It is at least the largest thickness
    under load. Its uncertainty is included in all intervals.

    Parameters
    ----------
    data
        A test (:func:`feltmb.fiber.read_compression`), or volume fractions [-] of the loop.
    pressure
        Pressures [Pa], if ``data`` are volume fractions.
    material
        Felt with the data of the fibers: diameter, friction, withdrawal force, Q. Its elastic laws
        are not used.
    loading
        True on the loading branch; default: up to the largest volume fraction.
    v_f0
        Volume fraction without load [-]; default: of the test, else of ``material``.
    relative
        Weight of a sample ``1 / (1 + relative P / P_max)``; 0: equal weights.
    level
        Confidence level of the intervals, between 0 and 1.
    name
        Name of the new felt; default: the name of the test.

    Returns
    -------
    Identification
        Felt, components and fits of both branches, intervals, warnings. The intervals assume that
        the errors of the samples are independent and that mu, Wf0 and d_f are known.

    Raises
    ------
    InvalidParameter, DataError
        Arguments or data are invalid; all faults are in one message.
    ModelError
        The iteration does not converge, an elastic part does not increase, a parameter is at an end
        of its range, or the data do not determine gamma or the unloaded thickness.
    """
    where = "identify"
    faults: list[str] = []
    if not 0 < level < 1:
        faults.append(f"{where}: level = {level:g}, must be > 0 and < 1")
    if not (relative >= 0 and math.isfinite(relative)):
        faults.append(f"{where}: relative = {relative:g}, must be finite and >= 0")
    if not material.fiber.friction > 0:
        faults.append(
            f"{where}: fiber.friction = {material.fiber.friction:g}, must be > 0 (without friction "
            "the stress of the sticking contacts is bounded)"
        )
    if faults:
        raise InvalidParameter("\n".join(faults))
    test = _as_data(data, pressure, loading, v_f0 if v_f0 is not None else material.v_f0)
    reference = v_f0 if v_f0 is not None else test.v_f0
    if v_f0 is None and not test.reference_known and test.thickness is None:
        reference = material.v_f0  # the loosest sample is under load
    base = material.model_copy(
        update={
            "name": name or test.name,
            "about": f"identified from {test.name}"
            + (" with the fibers of a SYNTHETIC material" if material.synthetic else ""),
            "source": {"cite": test.name, "status": "fitted"},
            "v_f0": reference,
            "loading": None,
            "unloading": None,
            "critical_angles": None,
        }
    )
    warnings: list[str] = [*test.notes, *material.fiber.unusual()]
    thickness: _Thickness | None = None
    if test.thickness is not None and not test.reference_known:
        thickness = _estimated(test, base, relative, level, warnings)
        test = replace(test, v_f=reference * thickness.value / test.thickness, v_f0=reference)
    else:
        slack = slack_fault(replace(test, v_f0=reference), None)
        if slack:
            raise DataError(f"{test.name}: {slack}")
        warnings += _hold_given(test, base, relative)
    branches = _compressed(test, reference, warnings)
    first = _identify_branch("loading", *branches["loading"], base, relative, 1.5)
    second = _identify_branch("unloading", *branches["unloading"], base, relative, first[0].gamma)
    load, back = _spread((first, second), level, test, base, relative, thickness)
    end = float(max(load.v_f[-1], back.v_f[-1]))
    grid = reference + (end - reference) * (np.arange(1, 66) / 65.0) ** 2
    found = base.with_branches(
        Branch(K_p=load.K_p, gamma=load.gamma), Branch(K_p=back.K_p, gamma=back.gamma), end
    )
    angles = CriticalAngles(
        v_f=tuple(grid),
        loading=tuple(found.branch("loading", grid).theta_cr),
        unloading=tuple(found.branch("unloading", grid).theta_cr),
    )
    found = found.model_copy(update={"critical_angles": angles})
    result = Identification(found, load, back, level, (), test.name, thickness=test.thickness0)
    if thickness is not None:
        result = replace(result, thickness=thickness.value, thickness_interval=thickness.interval)
    return replace(result, warnings=(*warnings, *_doubts(result)))


def _doubts(result: Identification) -> list[str]:
    """Warnings about the reliability of the values."""
    out = []
    m, load, back = result.material, result.loading, result.unloading
    mu = m.fiber.friction
    ratios = np.linspace(1.0, m.end / m.v_f0, 41)
    bad = ratios[~np.asarray(_core.unloading_is_unique(ratios, mu), dtype=bool)]
    if bad.size:
        out.append(
            f"The inversion of the unloading branch is not unique for v_f up to "
            f"{bad.max() * m.v_f0:.4g} with mu = {mu:g} (unique from mu = 0.298 on at R = 1, from "
            "0.080 at R = 2): of several contact forces the largest was taken, for "
            f"{back.ambiguous} samples."
        )
    for b in (load, back):
        if not _PLAUSIBLE_GAMMA[0] <= b.gamma <= _PLAUSIBLE_GAMMA[1]:
            out.append(
                f"{b.which}: gamma = {b.gamma:.4g} is far from the geometric pi/2: the blocked "
                "length of a contact can hardly be so."
            )
        low, high = b.interval["gamma"]
        if high > 2.0 * b.gamma or low < 0.5 * b.gamma:
            out.append(
                f"{b.which}: the data hardly determine gamma ({low:.3g} to {high:.3g}); K_p goes "
                "with it."
            )
        signs = np.sign(b.residuals)
        runs = 1 + int(np.sum(signs[1:] != signs[:-1]))
        if len(signs) > 20 and runs < 0.25 * len(signs) and b.rmse > 1e-6 * b.pressure.max():
            out.append(
                f"{b.which}: residuals keep their sign over long stretches ({runs} runs in "
                f"{len(signs)} samples): they are not scatter, and the intervals are too narrow."
            )
    if abs(result.closing_gap) > 0.05:
        out.append(
            f"The branches end {100 * result.closing_gap:+.1f} % apart at v_f = {m.end:.4g}; an "
            "envelope is closed there by force."
        )
    loss = m.loss()
    if not 0 < loss < 0.95:
        out.append(f"The loop loses {100 * loss:.1f} % of the loading work.")
    return out
