"""Design of the finger: arm, damper and torque that make the finger force follow a target."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from feltmb.action.actuator.composing import compose
from feltmb.action.actuator.model import Actuator, load_actuator, simulate_actuator
from feltmb.mechanism import Action, load_action
from feltmb.run.simulate import simulate
from feltmb.run.stroke import Stroke, torque_stroke
from unmodeled.arguments import checked
from unmodeled.errors import InvalidParameter

if TYPE_CHECKING:
    Array = npt.NDArray[np.float64]

KINDS = ("stiffness", "damping", "torque")

#: Forces are compared as means over this time [s], the resolution of a load cell on a key.
WINDOW = 1e-3
_RATE = 10_000.0
_STARTS = (0.3, 0.5, 0.7, 1.4, 2.0, 4.0)  # further start values of the stiffness factor, besides 1
_FIRST_STEPS = 10
_COARSE, _MIDDLE = 4.0, 1.5  # standard deviations of the smoothing, in windows
_STIFFNESS = (1e-2, 1e2)  # limits of the factor of E I
_DAMPING = (1e-4, 1.0)  # N m s/rad
_TORQUE = 10.0  # N m
_CONFIDENCE = 1.959964  # for a 95 % interval


@dataclass(frozen=True)
class MatchParameter:
    """One fitted parameter.

    Attributes
    ----------
    low, high
        95 % interval from the linearized fit; infinite if the data do not determine the parameter.
    effect
        Sensitivity: change of the finger force, rms [N], for 10 % of a stiffness or damping, or for
        0.1 N m of a torque knot.
    at_bound
        Whether the value is at a limit that the fit would exceed.
    """

    name: str
    unit: str
    start: float
    value: float
    low: float
    high: float
    effect: float
    at_bound: bool


@dataclass(frozen=True)
class Match:
    """Result of :func:`match`.

    Attributes
    ----------
    parameters
        In the order of the fit: stiffness factor, damping, torque knots.
    rms, rms_start
        Root mean square of the deviation from the target after and before the fit [N], for means
        over 1 ms.
    relative
        ``rms`` over the rms of the target.
    time, target, force, force_start
        Times [s]; target, fitted finger force and finger force before the fit [N].
    correlation
        Correlation matrix of the parameters' errors, (n, n).
    actuator, torque
        The designed actuator (its file: ``actuator.to_toml()``) and its torque.
    evaluations
        Number of simulations.
    """

    parameters: tuple[MatchParameter, ...]
    rms: float
    rms_start: float
    relative: float
    time: Array
    target: Array
    force: Array
    force_start: Array
    correlation: Array
    actuator: Actuator
    torque: Stroke
    evaluations: int
    message: str


@checked
def match(
    actuator: Actuator | str,
    target: Stroke,
    *,
    action: Action | str | None = None,
    fit: Sequence[str] = KINDS,
    knots: int = 8,
    start_torque: Stroke | None = None,
    max_evaluations: int = 60,
) -> Match:
    """Fit an actuator so that its finger force on the key follows a target.

    Least squares over the duration of the target, with forces as means over 1 ms. The method is a
    bounded trust region (scipy) with finite differences of the simulation.

    Parameters
    ----------
    actuator
        Start of the fit; the kind of its damper is not changed. If the actuator has a damper
        without a coefficient, the damping is fitted from 0.005 N m s/rad.
    target
        Finger force, a ``force`` stroke (:func:`read_stroke_csv`).
    action
        Action that the actuator presses (:func:`compose`); default: its own stop and equivalent
        reaction, with which a simulation takes milliseconds.
    fit
        Fitted quantities: ``stiffness`` (a factor of E of the whole arm), ``damping``, ``torque``
        (values at ``knots`` equally spaced times, with a smooth curve between them).
    max_evaluations
        Largest number of steps of the fit; each step takes one simulation more than there are
        parameters.

    Raises
    ------
    InvalidParameter
        The target is not a force or is too short, or a fitted quantity is unknown.
    """
    actuator = load_actuator(actuator) if isinstance(actuator, str) else actuator
    action = load_action(action) if isinstance(action, str) else action
    faults = [f"fit: {name!r} is none of {', '.join(KINDS)}" for name in fit if name not in KINDS]
    if not fit:
        faults.append("fit: nothing is to be fitted")
    if target.kind != "force":
        faults.append(f"target {target.name!r} is a {target.kind}, expected a force")
    end = float(target.time[-1])
    if not 10 * WINDOW <= end <= 10.0:
        faults.append(f"target {target.name!r} ends at {end:g} s, expected 0.01 to 10 s")
    if not any(target.value):
        faults.append(f"target {target.name!r} is zero throughout")
    if not 2 <= knots <= 100:
        faults.append(f"knots = {knots}, must be 2 to 100")
    if start_torque is not None and start_torque.kind != "torque":
        faults.append(f"start torque {start_torque.name!r} is a {start_torque.kind}, not a torque")
    if max_evaluations < 1:
        faults.append(f"max_evaluations = {max_evaluations}, must be at least 1")
    if "damping" in fit and actuator.config.damper.kind == "none":
        faults.append("fit: a damping needs a damper, dashpot or one_sided; the actuator has none")
    if faults:
        raise InvalidParameter("match: " + "; ".join(faults))
    return _Fit(actuator, target, action, tuple(fit), knots, start_torque).run(max_evaluations)


class _Fit:
    def __init__(
        self,
        actuator: Actuator,
        target: Stroke,
        action: Action | None,
        fit: tuple[str, ...],
        knots: int,
        start_torque: Stroke | None,
    ):
        self.actuator, self.action, self.fit = actuator, action, fit
        self.end = float(target.time[-1])
        fine = np.arange(round(self.end * _RATE) + 1) / _RATE
        self.time, self.target = _means(fine, target.at(fine))
        self.knots = np.linspace(0.0, self.end, knots)
        self.base_torque = start_torque or actuator.torque
        self.names: list[tuple[str, str]] = []
        start: list[float] = []
        low: list[float] = []
        high: list[float] = []
        if "stiffness" in fit:
            self.names.append(("stiffness factor", "1"))
            start.append(0.0)
            low.append(math.log(_STIFFNESS[0]))
            high.append(math.log(_STIFFNESS[1]))
        if "damping" in fit:
            self.names.append(("damping", "N m s/rad"))
            start.append(math.log(actuator.config.damper.coefficient or 0.005))
            low.append(math.log(_DAMPING[0]))
            high.append(math.log(_DAMPING[1]))
        if "torque" in fit:
            for t, value in zip(self.knots, self.base_torque.at(self.knots), strict=True):
                self.names.append((f"torque at {1e3 * t:.0f} ms", "N m"))
                start.append(float(value))
                low.append(-_TORQUE)
                high.append(_TORQUE)
        self.start, self.low, self.high = np.array(start), np.array(low), np.array(high)
        self.logarithmic = np.array([unit != "N m" for _, unit in self.names])
        self.evaluations = 0

    def design(self, x: Array) -> tuple[Actuator, Stroke]:
        """Actuator and torque for a parameter vector."""
        values = list(x)
        changed: dict[str, Any] = {}
        if "stiffness" in self.fit:
            factor = math.exp(values.pop(0))
            arm = self.actuator.config.arm
            paths = [f"arm.sections.{n}.young_modulus" for n in arm.sections] or [
                "arm.young_modulus"
            ]
            for path, section in zip(paths, arm.stretches(), strict=True):
                value = section.young_modulus * factor
                changed[path] = {"value": value, "unit": "Pa", "status": "fitted"}
        if "damping" in self.fit:
            value = math.exp(values.pop(0))
            changed["damper.coefficient"] = {
                "value": value,
                "unit": "N m s/rad",
                "status": "fitted",
            }
        torque = self.base_torque
        if "torque" in self.fit:
            torque = torque_stroke(
                self.knots.tolist(), values, interpolation="monotone", name="fitted"
            )
            changed["torque"] = {
                "time": self.knots.tolist(),
                "value": [float(v) for v in values],
                "unit": ["s", "N m"],
                "interpolation": "monotone",
            }
        elif torque is not self.actuator.torque:
            changed["torque"] = {
                "time": [float(t) for t in torque.time],
                "value": [float(v) for v in torque.value],
                "unit": ["s", "N m"],
                "interpolation": torque.interpolation,
            }
        return self.actuator.with_values(changed), torque

    def force(self, x: Array) -> Array:
        """Finger force as means over the windows of the target."""
        self.evaluations += 1
        actuator, torque = self.design(x)
        if self.action is None:
            run = simulate_actuator(actuator, torque, self.end, output_rate=_RATE, tolerance=3e-4)
            return _means(run.time, run["finger.force"])[1]
        coupled = simulate(
            compose(self.action, actuator),
            torque,
            self.end,
            1e-6,
            output_rate=_RATE,
            ledger=False,
            events=False,
        )
        return _means(coupled.time, coupled["finger.force"])[1]

    def run(self, most: int) -> Match:
        from scipy.ndimage import gaussian_filter1d
        from scipy.optimize import least_squares

        force_start = self.force(self.start)

        def residual(x: Array) -> Array:
            return self.force(x) - self.target

        def solve(x: Array, width: float, most: int) -> Any:
            def smooth(y: Array) -> Array:
                deviation = residual(y)
                return gaussian_filter1d(deviation, width, mode="nearest") if width else deviation

            return least_squares(
                smooth,
                np.clip(x, self.low + 1e-6, self.high - 1e-6),
                jac=lambda y: self.jacobian(smooth, y),
                bounds=(self.low, self.high),
                x_scale=0.3,
                max_nfev=most,
                xtol=1e-5,
                ftol=1e-6,
            )

        # From coarse to fine: a narrow peak at the wrong time, or a vibration of another frequency,
        # causes a local minimum. With smoothing over some milliseconds it does not.
        coarse = solve(self.start, _COARSE, most)
        starts = [coarse.x]
        if "stiffness" in self.fit:
            for factor in _STARTS:
                other = coarse.x.copy()
                other[0] = math.log(factor)
                starts.append(other)
        middle = [solve(x, _MIDDLE, min(_FIRST_STEPS, most)) for x in starts]
        best = sorted(middle, key=lambda f: float(f.cost))[:2]
        found = min((solve(f.x, 0.0, most) for f in best), key=lambda f: float(f.cost))
        jacobian = self.jacobian(residual, found.x)
        return self.report(found, jacobian, force_start)

    def jacobian(self, residual: Callable[[Array], Array], x: Array) -> Array:
        """Central differences, with steps that are large enough for the nonlinear contact."""
        columns = []
        for i in range(x.size):
            step = 0.01
            up, down = x.copy(), x.copy()
            up[i] = min(x[i] + step, self.high[i])
            down[i] = max(x[i] - step, self.low[i])
            columns.append((residual(up) - residual(down)) / (up[i] - down[i]))
        return np.stack(columns, axis=1)

    def report(self, found: Any, jacobian: Array, force_start: Array) -> Match:
        x = found.x
        deviation = found.fun
        free = max(1, deviation.size - x.size)
        variance = float(deviation @ deviation) / free
        covariance = np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-12) * variance
        sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        # A direction that the pseudo-inverse dropped is not determined.
        blind = np.linalg.norm(jacobian, axis=0) < 1e-9 * max(1.0, np.abs(self.target).max())
        sd[blind] = np.inf
        width = np.where(sd > 0, sd, 1.0)
        effect = 0.1 * np.linalg.norm(jacobian, axis=0) / math.sqrt(deviation.size)
        parameters = []
        for i, (name, unit) in enumerate(self.names):
            ends = (x[i] - _CONFIDENCE * sd[i], x[i] + _CONFIDENCE * sd[i])
            with np.errstate(over="ignore"):
                to = np.exp if self.logarithmic[i] else np.asarray
                start, value, low, high = (float(to(v)) for v in (self.start[i], x[i], *ends))
            parameters.append(
                MatchParameter(
                    name, unit, start, value, low, high, float(effect[i]),
                    bool(min(x[i] - self.low[i], self.high[i] - x[i]) < 1e-3),
                )
            )  # fmt: skip
        actuator, torque = self.design(x)
        rms = float(np.sqrt(np.mean(deviation**2)))
        return Match(
            parameters=tuple(parameters),
            rms=rms,
            rms_start=float(np.sqrt(np.mean((force_start - self.target) ** 2))),
            relative=rms / float(np.sqrt(np.mean(self.target**2))),
            time=self.time,
            target=self.target,
            force=deviation + self.target,
            force_start=force_start,
            correlation=covariance / np.outer(width, width),
            actuator=actuator,
            torque=torque,
            evaluations=self.evaluations,
            message=str(found.message),
        )


def _means(time: Array, value: Array) -> tuple[Array, Array]:
    """Means over windows of 1 ms, at the centers of the windows."""
    per = round(WINDOW * _RATE)
    count = (time.size - 1) // per
    mean = np.asarray(value, dtype=float)[: count * per].reshape(count, per).mean(axis=1)
    middle = np.asarray((np.arange(count) + 0.5) * WINDOW, dtype=np.float64)
    return middle, np.asarray(mean, dtype=np.float64)
