"""Many jobs of one system with derivatives: ``unmodeled.ode`` against ``solve_ivp`` of SciPy.

    python bench/speed/integrator.py [--jobs 200] [--repeat 3]

A driven pendulum with dry and viscous friction, 500 times in 5 s, with derivatives by its four
parameters and two start states. ``solve_ivp`` integrates each job with its variational equations,
written by hand. The error is the largest of eight jobs, relative to the largest value of its
column, against DOP853 at 1e-11.
"""

from __future__ import annotations

import argparse
import time as clock
from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp

from unmodeled.ode import Integrator

TIME = np.linspace(0.0, 5.0, 501)
TORQUE = 2.0 * np.sin(3.0 * TIME)
NAMES = ("inertia", "gravity", "damping", "dry")
WIDTH = 0.05


def rates(t, x, u, p):
    """Of angle and speed."""
    friction = p.damping * x.speed + p.dry * np.tanh(x.speed / WIDTH)
    return x.speed, (u.torque - p.gravity * np.sin(x.angle) - friction) / p.inertia


def variational(t: float, y: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Rates of the states and of their derivatives by four parameters and two starts."""
    inertia, gravity, damping, dry = theta
    (angle, speed), s = y[:2], y[2:].reshape(2, 6)
    tanh = np.tanh(speed / WIDTH)
    torque = np.interp(t, TIME, TORQUE)
    slope = (torque - gravity * np.sin(angle) - damping * speed - dry * tanh) / inertia
    by_state = np.array(
        [
            [0.0, 1.0],
            [
                -gravity * np.cos(angle) / inertia,
                -(damping + dry / WIDTH * (1 - tanh**2)) / inertia,
            ],
        ]
    )
    by_theta = np.zeros((2, 6))
    by_theta[1, :4] = [-slope, -np.sin(angle), -speed, -tanh]
    by_theta[1, :4] /= inertia
    return np.concatenate([[speed, slope], (by_state @ s + by_theta).ravel()])


def by_scipy(theta: np.ndarray, starts: np.ndarray, method: str, rtol: float) -> np.ndarray:
    """States and derivatives, (B, n, 14)."""
    seeds = np.hstack([np.zeros((2, 4)), np.eye(2)]).ravel()
    given = {"method": method, "t_eval": TIME, "rtol": rtol, "atol": 1e-3 * rtol, "max_step": 0.05}
    return np.array(
        [
            solve_ivp(variational, TIME[[0, -1]], [*x, *seeds], args=(p,), **given).y.T
            for p, x in zip(theta, starts, strict=True)
        ]
    )


def by_ode(model: Integrator, theta: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """As :func:`by_scipy`."""
    d = model.derivatives(TIME, theta, starts, {"torque": TORQUE})
    both = np.concatenate([d.by_parameters, d.by_starts], axis=-1)
    return np.concatenate([d.outputs, both.reshape(*both.shape[:2], 12)], axis=-1)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--jobs", type=int, default=200)
    parser.add_argument("--repeat", type=int, default=3)
    given = parser.parse_args()
    random = np.random.default_rng(0)
    theta = random.uniform(0.8, 1.2, (given.jobs, 4)) * [1.0, 9.8, 0.1, 0.3]
    starts = random.uniform(-0.5, 0.5, (given.jobs, 2))
    few = slice(0, min(8, given.jobs))
    exact = by_scipy(theta[few], starts[few], "DOP853", 1e-11)

    def row(name: str, count: int, run: Callable[[], np.ndarray]) -> None:
        seconds = []
        for _ in range(given.repeat):
            began = clock.process_time()
            found = run()
            seconds.append(clock.process_time() - began)
        error = np.abs(found[few] - exact[: len(found)]) / np.abs(exact).max(axis=(0, 1))
        print(f"| {name} | {1e3 * min(seconds) / count:.3g} | {error.max():.1e} |")

    print("| | ms of processor a job | largest error |\n|---|---|---|")
    for method, rtol in (("RK45", 1e-4), ("DOP853", 1e-7), ("LSODA", 1e-6)):
        name = f"`solve_ivp`, {method}, rtol {rtol:g}"
        row(name, len(exact), lambda m=method, r=rtol: by_scipy(theta[few], starts[few], m, r))
    for substeps in (1, 2, 4):
        model = Integrator(
            rates,
            states=["angle", "speed"],
            parameters=NAMES,
            inputs=["torque"],
            substeps=substeps,
        )
        began = clock.process_time()
        by_ode(model, theta[:1], starts[:1])
        first = 1e3 * (clock.process_time() - began)
        name = f"`unmodeled.ode`, rk4, {substeps} substeps"
        row(name, given.jobs, lambda m=model: by_ode(m, theta, starts))
        print(f"| its first call, with the trace | {first:.3g} | |")


if __name__ == "__main__":
    main()
