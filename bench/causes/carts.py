"""Four carts, and what two engines name: forward selection by BIC with lmfit, and unmodeled.

    pip install lmfit
    python bench/causes/carts.py        # the table of unmodeled/README.md, in Markdown

The machine is integrated with steps of 0.1 ms and exact Coulomb friction. It has other numbers than
the model (m 2.06, k 51, d 1.4 where the model has 2.0 +- 0.1, 50 +- 3, 1.5 +- 0.3), a sensor noise
of 0.1 mm, and dry friction of 0.8 N, a dead zone of the spring of 4 mm, both, or nothing. Both
engines get the same three records, the same noise, and candidates of the same kinds. First their
simulations are accurate; then both have the same coarse one, as real models are a little wrong.
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


def simulated(
    clock: np.ndarray, forces: np.ndarray, p: Mapping[str, np.ndarray], *, coarse: bool = False
) -> np.ndarray:
    """Positions, (runs, records, samples); the numbers are columns (runs, 1).

    By the leapfrog method with four steps a sample, or, if ``coarse``, by semi-implicit Euler with
    two, whose positions are early by half a step. With the numbers of the machine they differ from
    its positions by at most 1.3 and 8 times the noise.
    """
    x = np.zeros(forces.shape[:2])
    parts, before, after = (2, 0.0, 1.0) if coarse else (4, 0.5, 0.5)
    v, out, h = x.copy(), np.empty_like(forces), (clock[1] - clock[0]) / parts
    for i in range(forces.shape[2]):
        out[..., i] = x
        for _ in range(parts):
            x = x + before * h * v
            spring = x - np.clip(x, -p["bl"], p["bl"])
            push = forces[..., i] - p["k"] * spring - p["d"] * v - p["k3"] * x**3
            v = v + h / p["m"] * (push - p["c2"] * np.abs(v) * v + p["f0"])
            v = v - np.clip(v, -h / p["m"] * p["fc"], h / p["m"] * p["fc"])
            x = x + after * h * v
    return out


def by_bic(
    table: pd.DataFrame, *, coarse: bool, most: int = 3
) -> tuple[list[str], dict[str, float]]:
    """Terms that forward selection adds while BIC falls by more than 10, and the fitted values."""
    import lmfit

    runs = [r for _, r in table.groupby("run")]
    clock = runs[0].time.to_numpy()
    forces, measured_x = (np.array([r[c] for r in runs]) for c in ("force", "x"))
    neutral = {name: 0.0 for name, *_ in TERMS.values()}
    steps = {name: 1e-3 * sd for name, (_, sd) in PRIOR.items()}
    steps |= {name: 1e-3 * scale for name, scale, _ in TERMS.values()}

    def outputs(given: Any) -> np.ndarray:
        """Residuals (samples, 1 + parameters): at the values, and a step further in each."""
        values = given.valuesdict()
        rows = [neutral | values]
        rows += [rows[0] | {name: rows[0][name] + steps[name]} for name in values]
        p = {name: np.array([[row[name]] for row in rows]) for name in rows[0]}
        late = [[np.interp(clock - t, clock, f) for f in forces] for (t,) in p["tau"]]
        x = simulated(clock, (1.0 + p["g"])[..., None] * np.array(late), p, coarse=coarse)
        x = (1.0 + p["gs"])[..., None] * x + p["o"][..., None]
        left = np.nan_to_num((x - measured_x) / NOISE, nan=1e6, posinf=1e6, neginf=-1e6)
        prior = [(p[n] - value) / sd for n, (value, sd) in PRIOR.items()]
        table: np.ndarray = np.hstack([left.reshape(len(rows), -1), *prior]).T
        return table

    def residual(given: Any, kept: dict[str, np.ndarray]) -> np.ndarray:
        kept["at"], kept["all"] = np.array(list(given.valuesdict().values())), outputs(given)
        return kept["all"][:, 0]

    def slopes(given: Any, kept: dict[str, np.ndarray]) -> np.ndarray:
        values = given.valuesdict()
        if not np.array_equal(kept["at"], list(values.values())):
            residual(given, kept)
        table: np.ndarray = kept["all"][:, 1:] - kept["all"][:, :1]
        return table / [steps[name] for name in values]

    def fitted(terms: Sequence[str], start: Mapping[str, float]) -> tuple[float, dict[str, float]]:
        parameters = lmfit.Parameters()
        for name, (value, _) in PRIOR.items():
            parameters.add(name, start.get(name, value), min=1e-3)
        for term in terms:
            name, scale, least = TERMS[term]
            parameters.add(name, start.get(name, scale), min=least)
        out = lmfit.minimize(residual, parameters, args=({},), method="least_squares", jac=slopes,
                             x_scale="jac", ftol=1e-6, max_nfev=40)  # fmt: skip
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


def by_unmodeled(table: pd.DataFrame, *, coarse: bool) -> tuple[list[str], dict[str, float]]:
    """What a diagnosis with the default candidates names."""
    import unmodeled

    units = {"m": "kg", "k": "N/m", "d": "N s/m"}
    prior = {name: (*PRIOR[name], unit) for name, unit in units.items()}

    def cart(time: Any, inputs: Any, parameters: Any) -> dict[str, np.ndarray]:
        values = {name: 0.0 for name, *_ in TERMS.values()} | dict(parameters)
        p = {name: np.array([[value]]) for name, value in values.items()}
        return {"x": simulated(time, inputs["force"][None, None], p, coarse=True)[0, 0]}

    def rates(t: Any, x: Any, u: Any, p: Any) -> tuple[Any, Any]:
        return x.v, (u.force - p.k * x.x - p.d * x.v) / p.m

    model: unmodeled.Model
    if coarse:
        unknown = {"fc": "N", "bl": "m", "k3": "N/m^3", "c2": "N s^2/m^2", "f0": "N"}
        # In one process, as the other engine: the time of the processor is that of this process.
        model = unmodeled.Simulator(cart, parameters=prior, unknown=unknown, workers=1)
    else:
        model = unmodeled.Equations(
            rates, states={"x": (0.0, 0.0, "m"), "v": (0.0, 0.0, "m/s")}, parameters=prior,
            outputs={"x": "x"}, hold="zero",
        )  # fmt: skip
    records = unmodeled.records_from_frame(table, by="run", inputs=["force"], sigma={"x": NOISE})
    # The limit of time is one of the clock: with its default a busy machine changes the answer.
    report = model.diagnose(records, options=unmodeled.Options(seconds=3600.0))
    classes = [" or ".join(c.cause for c in group) for group in report.classes]
    return [n.cause for n in report.named] + classes, {n.cause: n.magnitude for n in report.named}


ENGINES = {"lmfit, forward selection by BIC": by_bic, "unmodeled": by_unmodeled}


def main() -> None:
    print("| in the machine | " + " | ".join(f"{n} | CPU s" for n in ENGINES) + " |")
    print("|---|" + "---|---|" * len(ENGINES))
    for coarse in (False, True):
        for truth, (friction, zone) in TRUTHS.items():
            table = measured(friction, zone)
            cells = [truth + " (coarse steps)" * coarse]
            for engine in ENGINES.values():
                begin = time.process_time()
                names, values = engine(table, coarse=coarse)
                print(truth, coarse, names, values, file=sys.stderr)
                cells += [", ".join(names) or "nothing", f"{time.process_time() - begin:.1f}"]
            print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
