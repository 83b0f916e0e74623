"""Cost of a mechanism step by step: CPU time of each step of a forte, against one run.

    python bench/speed/steps.py [--repeat N] [--rate HZ ...]

A step is timed N times from the same state; the least of them is its cost on a busy machine.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

import feltmb


def costs(action: feltmb.Action, rate: float, rtol: float, repeat: int) -> np.ndarray:
    """Least CPU milliseconds of every step of a forte of 0.4 s."""
    forte = feltmb.load_stroke("forte")
    machine = feltmb.Machine(action, rtol=rtol)
    steps = round(0.4 * rate)
    force = forte.at((np.arange(steps) + 0.5) / rate)
    out = np.full((repeat, steps), np.inf)
    for i in range(repeat):
        machine.reset()
        for k in range(steps):
            begin = time.process_time_ns()
            machine.advance(1.0 / rate, force=float(force[k]))
            out[i, k] = 1e-6 * (time.process_time_ns() - begin)
    return out.min(axis=0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--rate", type=float, nargs="*", default=[100.0, 1000.0, 10000.0])
    options = parser.parse_args()
    whole = feltmb.load_action("steinway45")
    rigid = whole.with_values({"shank.rigid": True, "wire.rigid": True})
    for name, action in (("steinway45", whole), ("rigid members", rigid)):
        for rtol in (1e-6, 1e-4):
            run = []
            for _ in range(options.repeat):
                begin = time.process_time()
                feltmb.simulate(action, "forte", rtol=rtol, ledger=False, output_rate=1000.0)
                run.append(1e3 * (time.process_time() - begin))
            print(f"{name}, rtol {rtol:g}: one run of 0.4 s {min(run):.1f} ms")
            for rate in options.rate:
                c = costs(action, rate, rtol, options.repeat)
                print(
                    f"  {rate:6.0f} Hz: median {np.median(c):.3f} ms, 99 % "
                    f"{np.quantile(c, 0.99):.3f} ms, worst {c.max():.3f} ms, sum {c.sum():.1f} ms"
                )


if __name__ == "__main__":
    main()
