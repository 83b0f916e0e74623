"""Four carts, and what two engines name: forward selection by BIC with lmfit, and unmodeled.

    pip install lmfit
    python bench/causes/carts.py        # the table of unmodeled/README.md, in Markdown

The machine is integrated with steps of 0.1 ms and exact Coulomb friction. It has other numbers than
the model (m 2.06, k 51, d 1.4 where the model has 2.0 +- 0.1, 50 +- 3, 1.5 +- 0.3), a sensor noise
of 0.1 mm, and dry friction of 0.8 N, a dead zone of the spring of 4 mm, both, or nothing. Both
engines get the same three records, the same noise, and candidates of the same kinds.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

TRUTHS = {"nothing": (0.0, 0.0), "dry friction": (0.8, 0.0), "dead zone": (0.0, 4e-3),
          "dry friction, dead zone": (0.8, 4e-3)}  # fmt: skip
#: Parameters of the model: value and standard deviation [kg, N/m, N s/m].
PRIOR = {"m": (2.0, 0.1), "k": (50.0, 3.0), "d": (1.5, 0.3)}
NOISE = 1e-4  # m


def machine(force: np.ndarray, clock: np.ndarray, friction: float, zone: float) -> np.ndarray:
    """Position of the cart [m] at the samples; the force is held between them."""
    mass, stiffness, damping, step = 2.06, 51.0, 1.4, 1e-4
    x = v = 0.0
    out = np.empty(clock.size)
    parts = round((clock[1] - clock[0]) / step)
    for i in range(clock.size):
        out[i] = x
        for _ in range(parts):
            spring = np.sign(x) * max(abs(x) - zone, 0.0)
            before = v
            v += step * (force[i] - stiffness * spring - damping * v) / mass
            v = np.sign(v) * max(abs(v) - step * friction / mass, 0.0)
            x += 0.5 * step * (before + v)  # v alone would be early by half a step
    return out


def measured(friction: float, zone: float) -> pd.DataFrame:
    """Three records of 1000 samples."""
    parts = []
    for seed, run in enumerate("abc"):
        random = np.random.default_rng(seed)
        clock = np.arange(0.0, 4.0, 0.004)
        waves = random.uniform((1.0, 0.2, 0.0), (3.0, 2.5, 6.0), (4, 3))
        force = sum(a * np.sin(2.0 * np.pi * f * clock + p) for a, f, p in waves)
        x = machine(force, clock, friction, zone) + NOISE * random.standard_normal(clock.size)
        parts.append(pd.DataFrame({"run": run, "time": clock, "force": force, "x": x}))
    return pd.concat(parts, ignore_index=True)


# ---------------------------------------------------------------- forward selection by BIC

#: Candidate term -> parameter, its scale as the start of a fit, and its lower limit.
TERMS = {
    "dry friction": ("fc", 0.2, 0.0),
    "dead zone": ("bl", 0.002, 0.0),
    "cubic stiffness": ("k3", 100.0, -np.inf),
    "drag": ("c2", 0.5, -np.inf),
    "constant force": ("f0", 0.2, -np.inf),
    "delay of input": ("tau", 0.004, -np.inf),
    "gain of input": ("g", 0.02, -np.inf),
    "offset of sensor": ("o", 1e-3, -np.inf),
    "gain of sensor": ("gs", 0.02, -np.inf),
}


def simulated(clock: np.ndarray, forces: np.ndarray, p: Mapping[str, float]) -> np.ndarray:
    """Positions by semi-implicit Euler with two steps a sample, (records, samples)."""
    x = np.zeros(len(forces))
    v, out, h = x.copy(), np.empty_like(forces), 0.5 * (clock[1] - clock[0])
    for i in range(forces.shape[1]):
        out[:, i] = x
        for _ in range(2):
            spring = np.sign(x) * np.maximum(np.abs(x) - p["bl"], 0.0)
            push = forces[:, i] - p["k"] * spring - p["d"] * v - p["k3"] * x**3
            v = v + h / p["m"] * (push - p["c2"] * np.abs(v) * v + p["f0"])
            v = np.sign(v) * np.maximum(np.abs(v) - h * p["fc"] / p["m"], 0.0)
            x = x + h * v
    return out


def by_bic(table: pd.DataFrame, most: int = 3) -> tuple[list[str], dict[str, float]]:
    """Terms that forward selection adds while BIC falls by more than 10, and the fitted values."""
    import lmfit

    runs = [r for _, r in table.groupby("run")]
    clock = runs[0].time.to_numpy()
    forces, measured_x = (np.array([r[c] for r in runs]) for c in ("force", "x"))
    neutral = {name: 0.0 for name, *_ in TERMS.values()}

    def residual(given: Any) -> np.ndarray:
        p = neutral | given.valuesdict()
        late = np.array([np.interp(clock - p["tau"], clock, f) for f in forces])
        x = (1.0 + p["gs"]) * simulated(clock, (1.0 + p["g"]) * late, p) + p["o"]
        left = np.nan_to_num((x - measured_x) / NOISE, nan=1e6, posinf=1e6, neginf=-1e6).ravel()
        return np.append(left, [(p[n] - value) / sd for n, (value, sd) in PRIOR.items()])

    def fitted(terms: Sequence[str], start: Mapping[str, float]) -> tuple[float, dict[str, float]]:
        parameters = lmfit.Parameters()
        for name, (value, _) in PRIOR.items():
            parameters.add(name, start.get(name, value), min=1e-3)
        for term in terms:
            name, scale, least = TERMS[term]
            parameters.add(name, start.get(name, scale), min=least)
        out = lmfit.minimize(residual, parameters, method="least_squares", diff_step=1e-5,
                             max_nfev=15)  # fmt: skip
        bic = out.chisqr + len(parameters) * np.log(measured_x.size)
        return float(bic), dict(out.params.valuesdict())

    chosen: list[str] = []
    best, values = fitted(chosen, {})
    while len(chosen) < most:
        tried = [(*fitted([*chosen, t], values), t) for t in TERMS if t not in chosen]
        bic, found, term = min(tried, key=lambda one: one[0])
        if bic > best - 10.0:
            break
        best, values, chosen = bic, found, [*chosen, term]
    return chosen, values


# ---------------------------------------------------------------- unmodeled


def by_unmodeled(table: pd.DataFrame) -> tuple[list[str], dict[str, float]]:
    """What a diagnosis with the default candidates names."""
    import unmodeled

    def rates(t: Any, x: Any, u: Any, p: Any) -> tuple[Any, Any]:
        return x.v, (u.force - p.k * x.x - p.d * x.v) / p.m

    units = {"m": "kg", "k": "N/m", "d": "N s/m"}
    prior = {name: (*PRIOR[name], unit) for name, unit in units.items()}
    model = unmodeled.Equations(
        rates, states={"x": (0.0, 0.0, "m"), "v": (0.0, 0.0, "m/s")}, parameters=prior,
        outputs={"x": "x"}, hold="zero",
    )  # fmt: skip
    records = unmodeled.records_from_frame(table, by="run", inputs=["force"], sigma={"x": NOISE})
    report = model.diagnose(records)
    classes = [" or ".join(c.cause for c in group) for group in report.classes]
    return [n.cause for n in report.named] + classes, {n.cause: n.magnitude for n in report.named}


ENGINES = {"lmfit, forward selection by BIC": by_bic, "unmodeled": by_unmodeled}


def main() -> None:
    print("| in the machine | " + " | ".join(f"{n} | CPU s" for n in ENGINES) + " |")
    print("|---|" + "---|---|" * len(ENGINES))
    for truth, (friction, zone) in TRUTHS.items():
        table = measured(friction, zone)
        cells = []
        for engine in ENGINES.values():
            begin = time.process_time()
            names, values = engine(table)
            print(truth, names, values, file=sys.stderr)
            cells += [", ".join(names) or "nothing", f"{time.process_time() - begin:.1f}"]
        print(f"| {truth} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
