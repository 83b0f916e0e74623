"""Highest rate of strikes by the return of the key: the grand action beside the upright.

python bench/repetition_by_return.py [--out FILE.png]

A finger presses at 0.4 m/s, holds for half a period and lifts to the height to which the key may
return. A rate counts if each of four presses after the first drives the hammer to the string with
0.1 m/s or more, and if every lower rate of the grid counts as well.
"""

import argparse
from concurrent.futures import ThreadPoolExecutor

import numpy as np

import feltmb
from unmodeled.errors import Error

RATES = range(2, 16)  # 1/s
RETURNS = (0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6, 0.8, 1.0)  # of the key travel
PRESSES, START, BEYOND, LIFT, AUDIBLE = 5, 0.02, 1e-3, 0.5, 0.1
SPEED = 0.4  # m/s


def key_travel(action):
    """Travel of the key front from rest to the contact with the front punching [m]."""
    run = feltmb.simulate(action, feltmb.ramp_stroke(10.0, START, 0.3, duration=0.35), ledger=False)
    depth = run["key_front.y"][0] - run["key_front.y"]
    return float(np.interp(run.summary["key_landing_time"], run.time, depth))


def presses(rate, share, travel):
    """The finger's motion, or None if a press and a lift last longer than the period."""
    low, high, time, value = travel + BEYOND, (1.0 - share) * travel, [], []
    for k in range(PRESSES):
        start, top = START + k / rate, high if k else 0.0
        bottom = start + (low - top) / SPEED
        lift = max(bottom + 1e-3, start + 0.5 / rate)
        end = lift + (low - high) / LIFT
        if end >= start + 1.0 / rate:
            return None
        time += [start, bottom, lift, end]
        value += [top, low, low, high]
    return feltmb.motion_stroke(
        time, value, interpolation="linear", duration=START + PRESSES / rate
    )


def weakest(action, rate, share, travel):
    """Smallest impact speed of the presses after the first [m/s]."""
    stroke = presses(rate, share, travel)
    if stroke is None:
        return 0.0
    strikes = feltmb.simulate(action, stroke, ledger=False, output_rate=1000.0).strikes
    times = np.asarray(strikes.get("impact_time", ()))
    speeds = np.asarray(strikes.get("impact_speed", ()))
    starts = START + np.arange(1, PRESSES) / rate
    own = [speeds[(times >= s) & (times < s + 1.0 / rate)] for s in starts]
    return min(float(v.max()) if v.size else 0.0 for v in own)


def highest(name):
    """Returns of the key [m] and highest rates [1/s] of an action."""
    action = feltmb.load_action(name)
    travel = key_travel(action)

    def rate_of(share):
        best = 0
        for rate in RATES:
            try:
                if weakest(action, rate, share, travel) < AUDIBLE:
                    break
            except Error:
                break
            best = rate
        return best

    with ThreadPoolExecutor() as pool:
        return np.array(RETURNS) * travel, np.array(list(pool.map(rate_of, RETURNS)))


def main():
    from unmodeled.style import BLUE, RED, new_figure, style_axes

    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", default="repetition_by_return.png")
    out = parser.parse_args().out
    figure = new_figure(6.4, 3.8)
    axes = figure.subplots()
    for name, label, color in (("grand_action", "grand", RED), ("steinway45", "upright", BLUE)):
        back, rate = highest(name)
        for mm, r in zip(1e3 * back, rate, strict=True):
            print(f"{name}: key returns {mm:.1f} mm, {r} strikes a second", flush=True)
        axes.plot(1e3 * back, rate, "o-", color=color, label=label)
    axes.set_ylim(-0.5, max(RATES) + 1)
    axes.legend(frameon=False, loc="upper left")
    style_axes(axes, "return of the key front [mm]", "strikes a second", "")
    figure.savefig(out, dpi=120)


if __name__ == "__main__":
    main()
