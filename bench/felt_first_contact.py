"""Coverage of the interval of the first contact of a compression test, by toe and samples.

    python bench/felt_first_contact.py [SEEDS]

prints the table of docs/validation/felt_tests.md. The loading goes from 0.35 mm before the contact
to 1 mm of compression; the noise is white.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from feltmb.fiber.approach import free_approach

Array = NDArray[np.float64]

SLACK, TOP = 0.35e-3, 1e-3


def power(exponent: float) -> Callable[[Array], Array]:
    """Power law to 25 N."""
    return lambda e: 25.0 * (e / TOP) ** exponent


def exponential(a: float, b: float, c: float) -> Callable[[Array], Array]:
    """Eq. 4.21: a e exp(b e) + c e."""
    return lambda e: a * e * np.exp(b * e) + c * e


def van_wyk(e: Array) -> Array:
    """Layer of 6 mm and 400 mm^2, 25 MPa, volume fraction 0.2 [N]."""
    return np.asarray(4e-4 * 25e6 * ((0.2 / (1.0 - e / 6e-3)) ** 3 - 0.2**3))


def nap(e: Array) -> Array:
    """Loose fibers, 0.25 mm high, on a stiffer felt [N]."""
    return np.asarray(2e3 * e**1.2 + 4e8 * np.maximum(e - 0.25e-3, 0.0) ** 2.4)


#: Force [N] of compression [m], and noise [N].
TOES: dict[str, tuple[Callable[[Array], Array], float]] = {
    "power 1.5": (power(1.5), 0.05),
    "power 2.3": (power(2.3), 0.05),
    "power 3.5": (power(3.5), 0.05),
    "eq. 4.21, contact 01": (exponential(5.52e3, 1.58e3, -0.6e3), 0.05),
    "eq. 4.21, contact 06": (exponential(23.5e3, 1.74e3, -23.5e3), 0.05),
    "van Wyk": (van_wyk, 1.0),
    "nap on bulk": (nap, 0.05),
}


def coverage(toe: str, samples: int, seeds: Iterable[int]) -> tuple[float, float, float]:
    """Share of the intervals with the true contact, their median width [m], error [m] rms."""
    law, noise = TOES[toe]
    x = np.linspace(0.0, SLACK + TOP, samples)
    clean = law(np.maximum(x - SLACK, 0.0))
    found = [
        free_approach(x, clean + noise * np.random.default_rng(seed).standard_normal(samples))
        for seed in seeds
    ]
    inside = [one.low <= SLACK <= one.high for one in found]
    errors = np.array([one.zero - SLACK for one in found])
    width = float(np.median([one.high - one.low for one in found]))
    return float(np.mean(inside)), width, float(np.sqrt(np.mean(errors**2)))


def main() -> None:
    seeds = range(int(sys.argv[1]) if len(sys.argv) > 1 else 100)
    print("| toe | samples | contains the contact [%] | width [mm] | error, rms [mm] |")
    print("|---|---|---|---|---|")
    for toe in TOES:
        for samples in (12, 20, 60, 200):
            share, width, error = coverage(toe, samples, seeds)
            numbers = f"{100 * share:.0f} | {1e3 * width:.2f} | {1e3 * error:.3f}"
            print(f"| {toe} | {samples} | {numbers} |", flush=True)


if __name__ == "__main__":
    main()
