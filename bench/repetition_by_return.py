"""Highest rate of notes by the return of the key: the grand action beside the upright.

python bench/repetition_by_return.py [--out FILE.png]
"""

import argparse

import feltmb

RETURNS = (0.25, 0.3, 0.35, 0.4, 0.5, 0.6, 0.8, 1.0)  # of the key travel
FORCE = 10.0  # N


def main():
    from unmodeled.style import BLUE, RED, new_figure, style_axes

    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", default="repetition_by_return.png")
    out = parser.parse_args().out
    figure = new_figure(6.4, 3.8)
    axes = figure.subplots()
    actions = (("grand_action", "grand", RED), ("steinway45_leaded", "upright", BLUE))
    for name, label, color in actions:
        result = feltmb.repeat(name, forces=[FORCE], returns=RETURNS)
        rows = sorted(result.rows, key=lambda row: row.key_return)
        back = [1e3 * result.travel * row.key_return for row in rows]
        for mm, row in zip(back, rows, strict=True):
            print(f"{name}: key returns {mm:.1f} mm, {row.rate_text} a second, then {row.sentence}")
        axes.plot(back, [row.rate for row in rows], "o-", color=color, label=label)
    axes.set_ylim(-0.5, 17.0)
    axes.legend(frameon=False, loc="lower right")
    style_axes(axes, "return of the key front [mm]", "notes a second", "")
    figure.savefig(out, dpi=120)


if __name__ == "__main__":
    main()
