"""Checkpoints of a box of fibers."""

import json

import numpy as np
import pytest

from unmodeled.errors import DataError


def test_a_changed_checkpoint_is_refused(tmp_path):
    from feltmb import fiber

    box, cycle = fiber.FiberBox(n_fibers=40, n_beads=8), fiber.Cycle(0.12, 1e-3, 10, 20, 1)
    good = fiber.simulate(box, cycle, max_samples=2).save(tmp_path / "a.npz")
    whole = dict(np.load(good))
    header = json.loads(str(whole["header"]))
    for changed in (
        whole | {"state_positions": np.array(1.0)},
        whole | {"table_pressure": np.full(3, np.nan)},
        {k: v for k, v in whole.items() if k != "state_box"},
        whole | {"header": np.array(json.dumps(header | {"box": header["box"] | {"nope": 1}}))},
    ):
        np.savez(tmp_path / "b.npz", **changed)
        with pytest.raises(DataError):
            fiber.FiberRun.load(tmp_path / "b.npz")
    with pytest.raises(DataError, match=r"box: unknown entries \['nope'\]"):
        fiber.FiberRun.load(tmp_path / "b.npz")
    assert fiber.FiberRun.load(good).box == box
