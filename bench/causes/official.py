"""Silverbox on its official test records: a fit of the oscillator by plain least squares.

    python bench/causes/official.py silverbox.npz     # writes results/official.json

The file has the array ``SNLS80mV`` with the columns V1 (input) and V2 (output) [V]; it is not kept
here. Slices are those of the package nonlinear_benchmarks: multisines 40650 to 105711 to fit, up to
127399 to test, and the arrow, 100 to 40574, whole and without extrapolation (its first 32000). Of a
test record, 50 samples fit the start, and all later ones count. The arrow is left out of the fit.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

STEP = 2**14 / 1e7  # s
START = 50
TESTS = {"multisine": (105712, 127400), "arrow": (100, 40575),
         "arrow without extrapolation": (100, 32100)}  # fmt: skip
#: Names and scales of the numbers: five, and the quadratic stiffness.
NUMBERS = {"gain": 2e5, "stiffness": 2e5, "damping": 20.0, "cubic stiffness": 1e6,
           "constant force": 100.0, "quadratic stiffness": 1e5}  # fmt: skip
#: Segments of the multisines that are fitted: first sample and length.
SEGMENTS, LENGTH = np.arange(41000, 105000, 5400), 2000
PARTS = 2


def fine(u: np.ndarray) -> np.ndarray:
    """Input at the quarters of the samples, (n, 2 * PARTS), by a cubic spline."""
    n = np.arange(u.size)
    at = n[:, None] + np.arange(2 * PARTS) / (2 * PARTS)
    return CubicSpline(n, u)(at)


def simulated(u: np.ndarray, p: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Outputs (n, m) of m oscillators by the method of Runge and Kutta; u (n, 2 PARTS, m)."""
    gain, k, d, k3, f0, k2 = p * np.reshape(list(NUMBERS.values()), (-1, 1))
    y, v = start[0].copy(), start[1].copy()
    h = STEP / PARTS
    out = np.empty((u.shape[0], y.size))

    def slope(y: np.ndarray, v: np.ndarray, f: np.ndarray) -> np.ndarray:
        return gain * f + f0 - (k + (k2 + k3 * y) * y) * y - d * v

    for i in range(u.shape[0]):
        out[i] = y
        for j in range(PARTS):
            a, b = u[i, 2 * j], u[i, 2 * j + 1]
            c = u[i, 2 * j + 2] if j + 1 < PARTS else u[min(i + 1, u.shape[0] - 1), 0]
            v1, s1 = v, slope(y, v, a)
            v2 = v + 0.5 * h * s1
            s2 = slope(y + 0.5 * h * v1, v2, b)
            v3 = v + 0.5 * h * s2
            s3 = slope(y + 0.5 * h * v2, v3, b)
            v4 = v + h * s3
            s4 = slope(y + h * v3, v4, c)
            y = y + h / 6.0 * (v1 + 2.0 * (v2 + v3) + v4)
            v = v + h / 6.0 * (s1 + 2.0 * (s2 + s3) + s4)
    return out


def residual(z: np.ndarray, free: int, u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, ...]:
    """Residuals of segments and their derivatives by the numbers and two start values each."""
    m = y.shape[1]
    p = np.zeros((len(NUMBERS), m))
    p[:free] = z[:free, None]
    start = z[free:].reshape(2, m) * [[0.1], [40.0]]
    eps = 1e-5
    lanes = [(p, start)]
    for j in range(free):
        lanes.append((p + eps * (np.arange(len(NUMBERS)) == j)[:, None], start))
    for j in range(2):
        lanes.append((p, start + eps * np.array([[0.1 * (j == 0)], [40.0 * (j == 1)]])))
    many = simulated(np.tile(u, (1, 1, len(lanes))), np.hstack([a for a, _ in lanes]),
                     np.hstack([b for _, b in lanes]))  # fmt: skip
    many = many.reshape(y.shape[0], len(lanes), m)
    slopes = (many[:, 1:] - many[:, :1]) / eps
    jacobian = np.zeros((y.shape[0], m, z.size))
    jacobian[..., :free] = np.moveaxis(slopes[:, :free], 1, 2)
    for j in range(2):
        for k in range(m):
            jacobian[:, k, free + j * m + k] = slopes[:, free + j, k]
    return (many[:, 0] - y).ravel(), jacobian.reshape(-1, z.size)


def solved(z: np.ndarray, free: int, u: np.ndarray, y: np.ndarray, fixed: bool) -> np.ndarray:
    """Least squares; ``fixed``: the starts alone."""
    kept = slice(free, None) if fixed else slice(None)

    def full(w: np.ndarray) -> np.ndarray:
        return np.concatenate([z[:free], w]) if fixed else w

    out = least_squares(
        lambda w: residual(full(w), free, u, y)[0], z[kept],
        lambda w: residual(full(w), free, u, y)[1][:, kept], x_scale="jac", max_nfev=25,
    )  # fmt: skip
    return full(out.x)


def main() -> None:
    """Fit, predict the official records, and store their rms."""
    u, y = np.load(sys.argv[1])["SNLS80mV"].T[:2].astype(float)
    rows = {}
    for free in (5, 6):
        begin = time.process_time()
        m = SEGMENTS.size
        z = np.concatenate([[0.9, 0.9, 1.2, 0.0, 0.0, 0.0][:free], np.zeros(2 * m)])
        for length in (100, 400, LENGTH):
            inputs = np.stack([fine(u[s : s + length]) for s in SEGMENTS], axis=2)
            outputs = np.stack([y[s : s + length] for s in SEGMENTS], axis=1)
            z = solved(z, free, inputs, outputs, fixed=False)
        rms = {}
        for name, (first, last) in TESTS.items():
            one = np.concatenate([z[:free], np.zeros(2)])
            part = slice(first, first + START)
            one = solved(one, free, fine(u[part])[:, :, None], y[part, None], fixed=True)
            p = np.zeros((len(NUMBERS), 1))
            p[:free, 0] = one[:free]
            told = simulated(fine(u[first:last])[:, :, None], p, one[free:, None] * [[0.1], [40.0]])
            rest = told[START:, 0] - y[first + START : last]
            rms[name] = 1e3 * float(np.sqrt(np.mean(rest**2)))
        values = dict(zip(NUMBERS, z[:free] * [*NUMBERS.values()][:free], strict=False))
        rows[f"{free} numbers"] = {"rms_mV": rms, "values": values,
                                   "cpu_s": round(time.process_time() - begin, 1)}  # fmt: skip
        print(free, rows[f"{free} numbers"], flush=True)
    path = Path(__file__).with_name("results") / "official.json"
    path.write_text(json.dumps({"silverbox": rows}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
