"""Callbacks of progress: only False interrupts."""

from contextlib import nullcontext

import numpy as np
import pytest

from feltmb import simulate
from feltmb.fiber import (
    Cycle,
    FiberBox,
)
from feltmb.fiber import simulate as compress
from feltmb.mechanism import load_action
from feltmb.run.stroke import load_stroke


@pytest.mark.parametrize(
    ("answer", "stops"),
    [(None, False), (0, False), ("", False), (False, True), (np.False_, True)],
)
def test_only_false_interrupts(answer, stops):
    action = load_action("steinway45")
    told = []

    def progress(t):
        told.append(t)
        return answer

    expected = pytest.raises(KeyboardInterrupt) if stops else nullcontext()
    with expected:
        simulate(action, load_stroke("staccato"), progress=progress)
    assert told  # the first report comes after 50 ms
    assert stops == (len(told) == 1)


@pytest.mark.parametrize("answer", [None, 0, False])
def test_only_false_stops_a_fiber_box(answer):
    box = FiberBox(n_fibers=12, n_beads=7, v_f=0.02)
    cycle = Cycle(v_max=0.03, strain_per_step=1e-3, relax_steps=10, sample_every=50)
    run = compress(box, cycle, threads=1, progress=lambda *_: answer)
    assert run.done == (answer is not False)
    if not run.done:
        assert len(run.table["v_f"]) < len(compress(box, cycle, resume=run).table["v_f"])
