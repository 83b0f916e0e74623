"""Duffing and Bouc-Wen oscillators with a little foreign structure: named, with a rest?

A mass on a spring is driven by a force; the model lacks a cubic spring or a hysteresis. Besides,
0.1 to 0.5 % of something that no effect of the library is: another mode, a drift of the sensor, or
its quantization. Three records of 600 samples, the whole bundle of effects.

    python bench/stories/oscillators.py              fifty cases
    python bench/stories/oscillators.py 0 1 2        some
    python bench/stories/oscillators.py --bare 0     without the foreign structure

A row a case: law, structure and its share, verdict, what is named, processor time. Below them: the
share that names the right effect.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Sequence

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from unmodeled import (
    Coordinate,
    Effect,
    Equations,
    Parameter,
    Record,
    Report,
    Sensor,
    State,
    candidates,
    diagnose,
)

Array = NDArray[np.float64]
CASES, SAMPLES, STEP = 50, 600, 0.02
MASS, DAMPING, STIFFNESS = 1.0, 0.4, 20.0
NOISE = 1e-3
"""Noise of the sensor, as a share of the motion."""
LAWS = {"duffing": "cubic stiffness", "bouc-wen": "hysteresis"}
STRUCTURES = ("mode", "drift", "quantization")


def _force(seed: int, amplitude: float) -> Array:
    """Smooth broadband force [N]."""
    random = np.random.default_rng(seed)
    t = np.arange(SAMPLES) * STEP
    rates = random.uniform(1.0, 9.0, 8)
    waves = np.sin(rates * t[:, None] + random.uniform(0.0, 6.28, 8))
    return amplitude * np.asarray(waves.sum(axis=1)) / 2.0


def _motion(law: str, size: float, sharp: float, force: Array) -> tuple[Array, Array]:
    """Displacement of the mass, and of a light 3 Hz mode on it [m]."""
    t = np.arange(SAMPLES) * STEP
    width = 0.06

    def rates(now: float, y: Array) -> list[float]:
        q, v, z, a, b = y
        push = float(np.interp(now, t, force)) - DAMPING * v - STIFFNESS * q
        if law == "duffing":
            push -= size * q**3
            slip = 0.0
        else:
            push -= size * z
            slip = v / width * (1.0 - abs(z) ** sharp * (0.5 + 0.5 * np.sign(v * z)))
        pull = (2.0 * np.pi * 3.0) ** 2 * (q - a) - 1.0 * b
        return [v, push / MASS, slip, b, pull]

    done = solve_ivp(
        rates, (0.0, t[-1]), np.zeros(5), t_eval=t, rtol=1e-8, atol=1e-10, max_step=STEP
    )
    return done.y[0], done.y[3] - done.y[0]


def records(case: int, *, bare: bool = False) -> tuple[str, str, float, list[Record]]:
    """Law, structure, its share, and the measured records."""
    random = np.random.default_rng(1000 + case)
    law = ("duffing", "bouc-wen")[case % 2]
    structure = STRUCTURES[case // 2 % 3]
    share = float(random.uniform(1e-3, 5e-3))
    size = float(random.uniform(40.0, 120.0) if law == "duffing" else random.uniform(0.6, 2.0))
    sharp = float(random.uniform(1.0, 2.0))
    out = []
    for k, amplitude in enumerate((3.0, 6.0, 4.5)):
        force = _force(10 * case + k, amplitude)
        q, mode = _motion(law, size, sharp, force)
        spread = float(np.std(q))
        sensor = Sensor(name="q", unit="m", sigma=NOISE * spread)
        y = q.copy()
        if not bare and structure == "mode":
            y += share * spread / max(float(np.std(mode)), 1e-12) * mode
        elif not bare and structure == "drift":
            y += share * spread * np.linspace(-1.7, 1.7, SAMPLES)
        y += NOISE * spread * random.standard_normal(SAMPLES)
        if not bare and structure == "quantization":
            step = share * spread * np.sqrt(12.0)
            y = step * np.round(y / step)
        out.append(
            Record(
                name=f"r{k}",
                time=np.arange(SAMPLES) * STEP,
                inputs={"f": force},
                outputs={"q": y},
                sensors={"q": sensor},
                role="held_out" if k == 2 else "fit",
            )
        )
    return law, structure, share, out


def model_and_effects(data: Sequence[Record]) -> tuple[Equations, tuple[Effect, ...]]:
    """A linear oscillator and all generic effects."""
    mass = Coordinate(name="mass", position="q", speed="v", inertia="m")
    model = Equations(
        name="oscillator",
        states=[
            State(name="q", unit="m", scale=0.1, start_sd=1e-2),
            State(name="v", unit="m/s", scale=0.5, start_sd=1e-2),
        ],
        parameters=[
            Parameter(name="m", value=1.02, sd=0.1, unit="kg", lower=0.1),
            Parameter(name="d", value=0.5, sd=0.3, unit="N s/m", lower=0.0),
            Parameter(name="k", value=21.0, sd=4.0, unit="N/m", lower=1.0),
        ],
        inputs=["f"],
        rates=lambda t, x, u, p: (x.v, (u.f - p.d * x.v - p.k * x.q) / p.m),
        outputs={"q": "q"},
        coordinates=[mass],
    )
    return model, candidates(model, data)


def run(case: int, *, bare: bool = False) -> tuple[str, str, float, Report, float]:
    """Law, structure, its share, report and processor time [s]."""
    law, structure, share, data = records(case, bare=bare)
    model, effects = model_and_effects(data)
    start = time.process_time()
    report = diagnose(model, effects, data)
    return law, structure, share, report, time.process_time() - start


def main() -> None:
    """Run cases and count the correct ones."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("cases", nargs="*", type=int)
    parser.add_argument("--bare", action="store_true")
    given = parser.parse_args()
    right, spent = [], []
    for case in given.cases or range(CASES):
        law, structure, share, report, seconds = run(case, bare=given.bare)
        named = [n.cause for n in (*report.named, *(n for g in report.classes for n in g))]
        right.append(any(n.cause.startswith(LAWS[law]) for n in report.named))
        spent.append(seconds)
        first = next((c for s in report.sets for c in s.causes), "-")
        print(
            f"{case:3d} {law:9s} {'none' if given.bare else structure:12s} {100 * share:4.2f} %  "
            f"{report.verdict.name}: {', '.join(named) or '(' + first + ')'}; {seconds:.0f} s",
            flush=True,
        )
    print(
        f"right {np.mean(right):.0%} of {len(right)}; processor time: median "
        f"{np.median(spent):.0f} s, most {max(spent):.0f} s"
    )


if __name__ == "__main__":
    main()
