"""What the examples of the gallery share: a number, what it is checked against, a picture."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any


@dataclass
class Found:
    """What an example computed."""

    name: str
    """Of the number."""
    value: float
    unit: str
    data: dict[str, Any] = field(default_factory=dict)
    """For the picture."""
    checks: list[tuple[str, float, float, float]] = field(default_factory=list)
    """What was checked: name, value, value expected by other means, relative tolerance."""

    def check(self, name: str, value: float, expected: float, tolerance: float) -> None:
        """Note a check; a test looks at it."""
        self.checks.append((name, float(value), float(expected), tolerance))

    def faults(self) -> list[str]:
        """Checks that fail."""
        return [
            f"{name}: {value:.8g}, expected {expected:.8g} to {tolerance:g}"
            for name, value, expected, tolerance in self.checks
            if not abs(value - expected) <= tolerance * abs(expected)
        ]


def show(compute: Callable[[], Found], draw: Callable[[Found], Any]) -> None:
    """Print the number and its checks; draw to the file that is named on the command line."""
    found = compute()
    print(f"{found.name}: {found.value:.4g} {found.unit}")
    for name, value, expected, _ in found.checks:
        print(f"  {name}: {value:.6g}, by other means {expected:.6g}")
    if len(sys.argv) > 1:
        draw(found).savefig(sys.argv[1])


def placed(action: Any, positions: list[float], speeds: list[float]) -> Any:
    """A run of no length that ends at these coordinates and rates, all felt virgin: a start."""
    from dataclasses import replace

    import numpy as np

    import feltmb

    still = feltmb.ramp_stroke(0.0, duration=1e-7)
    run = feltmb.simulate(action, still, events=False, ledger=False)
    state = np.zeros_like(run.end_state)
    n = len(positions)
    state[:n], state[n : 2 * n] = positions, speeds
    return replace(run, end_state=state, end_memory=np.zeros_like(run.end_memory))
