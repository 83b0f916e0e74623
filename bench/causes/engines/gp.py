"""A Gaussian process as the discrepancy of the model, after Kennedy and O'Hagan (2001).

Parameters first (the modular variant), then output = model + delta(inputs, output) + noise with a
process of scikit-learn: constant times squared exponential, a length for each coordinate, and white
noise, by maximum likelihood. It has no names. It says "something" if the process raises the log
likelihood of white noise alone by more than its unknowns times ln(n) / 2 (BIC).
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import sklearn
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from causes.engines.workbench import Workbench

__all__ = ["run"]

#: Samples of a case: the cost grows with the third power.
MOST = 300


def _coordinates(bench: Workbench, channel: int) -> tuple[np.ndarray, np.ndarray]:
    """Inputs, output and its slope at the samples of a channel, and the residual there."""
    z = np.array(list(bench.fit(()).values.values()))
    records = bench.problem.fit
    rest, _, _ = bench.system((), z, records)
    rows, values, at = [], [], 0
    for o in records:
        own = np.full(o.valid.shape, np.nan)
        count = int(o.valid.sum())
        own[o.valid] = rest[at : at + count]
        at += count
        good = o.valid[:, channel]
        y = o.measured[:, channel]
        inputs = [*o.record.inputs.values()]
        rows.append(np.column_stack([*inputs, y, np.gradient(y, o.record.time)])[good])
        values.append(own[good, channel])
    return np.concatenate(rows), np.concatenate(values)


def run(folder: Path, seconds: float) -> dict[str, Any]:
    """UNKNOWN (something) or CALIBRATED (nothing)."""
    bench = Workbench(folder, seconds)
    something = False
    for channel in range(bench.problem.motion.size):
        x, y = _coordinates(bench, channel)
        take = np.unique(np.linspace(0, y.size - 1, MOST).astype(int))
        x, y = x[take], y[take] - y[take].mean()
        x = (x - x.mean(axis=0)) / np.where(np.ptp(x, axis=0) > 0.0, x.std(axis=0), 1.0)
        y = y / max(float(y.std()), 1e-300)
        kernel = ConstantKernel(1.0) * RBF(np.ones(x.shape[1])) + WhiteKernel(0.5)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            both = GaussianProcessRegressor(kernel, n_restarts_optimizer=1, random_state=0)
            both.fit(x, y)
        white = -0.5 * y.size * (np.log(2.0 * np.pi) + 1.0)
        gain = both.log_marginal_likelihood_value_ - white
        something |= bool(gain > 0.5 * (1 + x.shape[1]) * np.log(y.size))
    verdict = "UNKNOWN" if something else "CALIBRATED"
    return {"verdict": verdict, "version": sklearn.__version__}
