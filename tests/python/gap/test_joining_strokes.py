"""Two records with two clocks become one."""

import numpy as np
import pytest

from feltmb.cli import main
from unmodeled.data import Record, Sensor, read_record

OFFSET, RATE = 1.25, 1.0005


def force(t):
    return 3.0 * np.sin(20.0 * t)


def camera(**changes):
    t = np.arange(0.0, 0.5, 2e-3)
    given = {
        "name": "camera",
        "time": t,
        "inputs": {},
        "outputs": {"y": 1e-3 * t},
        "sensors": {"y": Sensor(name="y", unit="m", sigma=1e-5)},
    }
    return Record(**(given | changes))


def cell(low=0.1, high=0.4, step=1e-4, **changes):
    t = np.arange(low, high, step)  # time on the clock of the camera
    given = {
        "name": "cell",
        "time": OFFSET + RATE * t,
        "inputs": {},
        "outputs": {"Load": force(t)},
        "sensors": {"Load": Sensor(name="Load", unit="N")},
    }
    return Record(**(given | changes))


def test_the_motion_of_a_model_gives_the_clocks(tmp_path, capsys):
    """A camera of 1000 frames a second and a load cell of 20 kHz, of one stroke.

    The begin alone is far off, because a slow force begins long before the motion, and says so.
    """
    import feltmb

    run = feltmb.simulate("steinway45", "piano", output_rate=20e3, ledger=False)
    rng, frames, offset = np.random.default_rng(1), slice(0, None, 20), 0.3712
    key = run["key_front.y"][frames] - run["key_front.y"][0]
    key += rng.normal(scale=2e-5, size=key.size)
    load = run["finger.force"] + rng.normal(scale=5e-3, size=run.time.size)
    for name, head, time, values in (
        ("camera", "key_front.y [mm]", run.time[frames], 1e3 * key),
        ("cell", "Load [N]", run.time + offset, load),
    ):
        rows = np.column_stack([time, values])
        np.savetxt(tmp_path / f"{name}.csv", rows, delimiter=",", header=f"time [s],{head}",
                   comments="", fmt="%.6f")  # fmt: skip
    for options, accuracy in (((), 0.03), (("--model", "steinway45"), 1e-4)):
        out = tmp_path / "both.csv"
        files = [str(tmp_path / "camera.csv"), str(tmp_path / "cell.csv"), "-o", str(out)]
        with pytest.raises(SystemExit) as end:
            main(["gap", "join", *files, "--same", "auto", *options, "--force"])
        assert end.value.code == 0
        told = capsys.readouterr().err
        found = 1e-3 * float(told.partition("first clock is ")[2].split(" ms")[0])
        assert abs(found - offset) < min(accuracy, read_record(out).sensors["key_front.y"].delay_sd)
    with pytest.raises(SystemExit):
        main(["gap", "join", *files, "--model", "steinway45", "--force"])
    assert "--same auto" in capsys.readouterr().err
