"""The commands of the diagnosis on a committed example."""

import json

import numpy as np
import pytest

import feltmb
from feltmb.cli import main
from feltmb.mechanism import load_action

QUICK = ("--max-effects", "1")


def run(*arguments):
    with pytest.raises(SystemExit) as stop:
        main([str(a) for a in arguments])
    return stop.value.code


FEW = [
    *("--set", "tolerances=let_off_button,felt.03"),
    *("--set", "effects=let_off_button,camera_skew,viscous_friction.butt"),
]


def test_a_stroke_without_a_sheet(tmp_path, capsys):
    """One record, columns by the names of the model; the written mechanism is the fitted one."""
    action = feltmb.load_action("steinway45")
    stroke = feltmb.load_stroke("forte")
    motion = feltmb.simulate(action, stroke, ledger=False)
    noise = np.random.default_rng(5)
    time = np.arange(0.0, 0.2, 1e-3)
    columns = {"time [s]": time, "force [N]": stroke.at(time)}
    for name in ("key_front.y", "hammer_tip.x"):
        moved = np.interp(time, motion.time, motion[name]) - motion[name][0]
        columns[f"{name} [mm]"] = 1e3 * moved + 0.02 * noise.standard_normal(time.size)
    rows = np.column_stack(list(columns.values()))
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",", header=",".join(columns), comments="")
    written = tmp_path / "found.toml"
    given = ("gap", "diagnose", "steinway45", tmp_path / "a.csv", *FEW, *QUICK)
    assert run(*given, "--json", "-o", written) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["verdict"] in ("NO_GAP", "CALIBRATED")
    assert any("samples after" in n for n in report["notes"])
    assert load_action(written).config.name.endswith("_calibrated")
