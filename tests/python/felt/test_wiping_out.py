"""Wiping-out memory: the largest compression alone decides the release."""

from itertools import pairwise

import numpy as np
import pytest

from feltmb.contact import law as contact_law
from feltmb.mechanism import load_action

ROW = load_action("steinway45").config.contacts["06"]


CURVES = {k: (c.a, c.b, c.c) for k, c in (("loading", ROW.loading), ("unloading", ROW.unloading))}


TOP = 5e-4


def forces_at_release(felt, *before):
    """Force on the way back from TOP, after cycles between these compressions [N]."""
    ends = [0.0, *before, TOP, 0.0]
    legs = [np.linspace(a, b, 400, endpoint=False) for a, b in pairwise(ends)]
    path = np.concatenate([*legs, [0.0]])
    return felt.path(path, 1e-3 * np.arange(len(path)))[-401:]


HISTORIES = [
    pytest.param((TOP, 0.0), id="a whole cycle"),
    pytest.param((0.98 * TOP, 0.0), id="a smaller cycle"),
    pytest.param((TOP, 0.3 * TOP), id="let go in part"),
    pytest.param((0.999 * TOP, 0.5 * TOP, 0.999 * TOP, 0.0), id="two just below"),
]


@pytest.mark.parametrize("before", HISTORIES)
def test_wiping_out_makes_the_release_that_of_the_largest_compression(before):
    kept = contact_law("felt_memory", **CURVES)
    wiped = contact_law("felt_memory", **CURVES, kappa=0.002, wiping_out=0.2)
    first = forces_at_release(wiped)
    assert np.allclose(first, forces_at_release(kept), rtol=1e-12)
    scale = first.max()
    # The transition takes 2 % of the loop; without the option a tenth of the force is memory.
    assert np.max(np.abs(forces_at_release(wiped, *before) - first)) < 0.02 * scale
    assert np.max(np.abs(forces_at_release(kept, *before) - first)) > 0.04 * scale


def test_a_wiped_felt_loses_the_measured_loop_in_every_cycle():
    felt = contact_law("felt_memory", **CURVES, kappa=0.002, wiping_out=0.2)
    e = TOP * 0.5 * (1.0 - np.cos(np.linspace(0.0, 6.0 * np.pi, 6001)))
    force = felt.path(e, 1e-4 * np.arange(len(e)))
    work = 0.5 * (force[1:] + force[:-1]) * np.diff(e)
    first, second, third = (float(np.sum(part)) for part in np.split(work, 3))
    assert second == pytest.approx(first, rel=0.03)
    assert third == pytest.approx(second, rel=1e-3)


def test_wiping_out_of_an_action_closes_the_ledger():
    from feltmb import load_stroke, simulate

    options = {"wiping_out": 0.2, "kappa": 0.02}
    settings = {"contacts.*.law": "felt_memory", "contacts.*.memory": options}
    settings["contacts.02.memory"] = {**options, "closing_compression": 2.6e-3}
    action = load_action("steinway45").with_values(settings)
    run = simulate(action, load_stroke("forte"), duration=0.12)
    assert run.energy["residual_relative"] < 1e-3
