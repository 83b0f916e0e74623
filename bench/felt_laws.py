"""Coverage of the intervals of laws that are fitted to compression tests.

    python bench/felt_laws.py [SEEDS]

prints the second table of docs/validation/felt_tests.md.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np

from feltmb.contact import law
from feltmb.felt import Specimen, fit_law, pool

TOP, SLACK = 1e-3, 0.3e-3
POWER = {"exponent": 2.6, "stiffness": 5.0 / TOP**2.6, "zero": SLACK}
VAN_WYK = {"exponent": 4.2, "scale": 0.05, "thickness": 1.5e-3, "zero": SLACK}
STULOV = {"stiffness": 3e8, "exponent": 2.4, "amplitude": 0.3, "time": 0.5}


def loading(seed: int, *, van_wyk: bool = False, gain: float = 1.0, samples: int = 300) -> Specimen:
    """Loading to 5 N after a slack, with a noise of 2 mN."""
    e = np.linspace(-SLACK, TOP, samples)
    positive = np.maximum(e, 0.0)
    force = 5.0 * (positive / TOP) ** 2.6
    if van_wyk:
        force = 0.05 * ((1.0 - positive / 1.5e-3) ** -4.2 - 1.0)
    noise = 2e-3 * np.random.default_rng(seed).standard_normal(samples)
    return Specimen(f"specimen {seed}", e + SLACK, gain * force + noise)


def speeds(seed: int) -> Specimen:
    """Cycles of Stulov's felt at 0.1, 1 and 10 mm/s, with a noise of 20 mN."""
    up = np.linspace(0.0, TOP, 60)
    x = np.tile(np.concatenate([up, up[::-1][1:]]), 3)
    time = np.cumsum(np.repeat(TOP / 59.0 / np.array([1e-4, 1e-3, 1e-2]), 119))
    force = law("stulov", **STULOV).path(x, time)
    force = force + 0.02 * np.random.default_rng(seed).standard_normal(x.size)
    return Specimen("speeds", x, force, time, 0.0)


def hold(seed: int) -> Specimen:
    """The same felt, compressed in 2 s and held for 20 s."""
    time = np.concatenate([np.linspace(0.0, 2.0, 100), 2.0 + np.arange(0.02, 20.0, 0.02)])
    e = np.minimum(time / 2.0, 1.0) * TOP
    force = law("stulov", **STULOV).path(e, time)
    return Specimen(
        "hold", e, force + 0.02 * np.random.default_rng(seed).standard_normal(time.size), time
    )


def specimens(seed: int) -> list[Specimen]:
    """Five specimens whose forces differ by 10 %."""
    gains = 1.0 + 0.1 * np.random.default_rng(1000 + seed).standard_normal(5)
    return [loading(10 * seed + k, gain=g, samples=150) for k, g in enumerate(gains)]


#: Interval by seed, and truth.
Case = tuple[Callable[[int], dict[str, tuple[float, float]]], dict[str, float]]
CASES: dict[str, Case] = {
    "power, loading only": (lambda s: dict(fit_law(loading(s)).interval), POWER),
    "van Wyk, loading only": (
        lambda s: dict(fit_law(loading(s, van_wyk=True), "van_wyk").interval),
        VAN_WYK,
    ),
    "power, five specimens": (
        lambda s: dict(pool(specimens(s)).interval),
        {k: POWER[k] for k in ("exponent", "stiffness")},
    ),
    "Maxwell branch of a hold": (
        lambda s: dict(fit_law(hold(s), "maxwell").interval),
        {"share_1": 0.3 / 0.7, "time_1": 0.5},
    ),
    "Stulov, three speeds": (lambda s: dict(fit_law(speeds(s), "stulov").interval), STULOV),
}


def coverage(case: str, seeds: int) -> dict[str, float]:
    """Share of the intervals of 95 % that contain the truth, by parameter."""
    fitted, truth = CASES[case]
    found = [fitted(seed) for seed in range(seeds)]
    return {
        key: float(np.mean([one[key][0] <= true <= one[key][1] for one in found]))
        for key, true in truth.items()
    }


def main() -> None:
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    print("| test | intervals with the truth [%] |")
    print("|---|---|")
    for case in CASES:
        shares = coverage(case, seeds)
        told = ", ".join(f"{key} {100 * share:.0f}" for key, share in shares.items())
        print(f"| {case} | {told} |", flush=True)


if __name__ == "__main__":
    main()
