"""A simulated machine for `feltmb gap session`: an action whose hammer butt rubs dry.

    feltmb gap session steinway45 --run "python examples/gap/simulated_machine.py" -o session

It is called with a request (CSV: time and force of the finger) and the name of the record to be
written. A rig of yours does the same: play the request, write what was measured. It may be slow,
ask an operator, or refuse (exit code 1 and a line on stderr). If the limits contain tests of parts
([[parts]]), a request may be a TOML file: measure that part by itself.
"""

import hashlib
import sys
import tomllib
from pathlib import Path

import numpy as np

import feltmb
from feltmb.adapters import action_with_effects, load_library
from feltmb.adapters.changes import read_entry

EFFECT, MAGNITUDE = "coulomb_friction.butt", 0.004  # [N m], what the model lacks
TOLERANCES = {"felt.04": 0.05, "felt.06": -0.07, "capstan_height": 1e-4}  # what is not as drawn
OUTPUTS = ("key_front.y", "key_balance.y", "whippen.y", "hammer_tip.x", "hammer_tip.y",
           "backcheck.x")  # fmt: skip
CAMERA, LOAD_CELL = 2e-5, 0.01  # noise [m], [N]


def machine() -> feltmb.Action:
    """The action as it is, which the diagnosing side does not know."""
    action = feltmb.load_action("steinway45")
    library = load_library(action)
    entries = [(library.effect(EFFECT), MAGNITUDE, None)]
    entries += [(e, TOLERANCES[e.name], None) for e in library.tolerances if e.name in TOLERANCES]
    return action_with_effects(action, entries)


def true_value(name: str) -> float:
    """Value of a parameter or effect as it is in the machine, in the unit of the library."""
    tabulated, found = feltmb.load_action("steinway45"), machine()
    entries = {e.name: e for e in load_library(tabulated).tolerances}
    if name not in entries:  # not a parameter, but an effect
        return MAGNITUDE if name == EFFECT else 0.0
    change = entries[name].changes[0]
    was, now = (float(read_entry(a.config, change.path)) for a in (tabulated, found))
    return (now - was) / (change.scale * was + change.add)


def measure_part(request: Path, answer: Path) -> None:
    """Measure one part by itself: a parameter of the model, or an effect that it lacks."""
    part = tomllib.loads(request.read_text(encoding="utf-8"))["part"]
    name, sd = part["parameter"], part["sd"]
    value = true_value(name) + sd * np.random.default_rng([*name.encode()]).standard_normal()
    answer.write_text(f'[measured."{name}"]\nvalue = {value:.6g}\nsd = {sd:.6g}\n')


def main(request: Path, answer: Path) -> None:
    """Play a request and write the record."""
    if request.suffix == ".toml":
        measure_part(request, answer)
        return
    time, force = np.loadtxt(request, delimiter=",", skiprows=1).T
    stroke = feltmb.table_stroke(time, force, duration=float(time[-1]))
    run = feltmb.simulate(machine(), stroke, output_rate=20000.0)
    noise = np.random.default_rng(int(hashlib.sha256(request.read_bytes()).hexdigest()[:8], 16))
    columns = [time, force + LOAD_CELL * noise.standard_normal(time.size)]
    for name in OUTPUTS:
        seen = np.interp(time, run.time, run[name] - run[name][0])
        columns.append(seen + CAMERA * noise.standard_normal(time.size))
    head = ["time [s]", "force [N]", *(f"{n} [m]" for n in OUTPUTS)]
    lines = [",".join(head), *(",".join(f"{v:.9g}" for v in row) for row in np.transpose(columns))]
    answer.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
