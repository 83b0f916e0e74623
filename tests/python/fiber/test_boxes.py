"""Boxes of fibers: rest before compression, failed loops, balance of energy."""

import json

import pytest
from click.testing import CliRunner

from feltmb.cli import cli
from feltmb.fiber import Cycle, FiberBox, lay, simulate
from unmodeled.errors import InvalidParameter

LOOSE = FiberBox(n_fibers=30, n_beads=15, friction=0.35, seed=0)


FAST = Cycle(v_max=0.12, strain_per_step=2e-4, sample_every=100, relax_steps=1500)


def test_a_box_too_low_for_its_fibers_is_refused_before_the_run():
    with pytest.raises(InvalidParameter, match=r"can be compressed to 0\.\d+ only"):
        simulate(LOOSE, Cycle(v_max=0.4))
    densest = lay(LOOSE, 1).densest()
    with pytest.raises(InvalidParameter, match="v_max"):
        simulate(LOOSE, Cycle(v_max=1.001 * densest))


def test_a_box_is_at_rest_before_it_is_compressed():
    network = lay(LOOSE, 1)
    network.relax(4000)
    rest = network.sample()
    network.advance(400, 0.0)
    later = network.sample()
    stored = rest["stretching"] + rest["bending"] + rest["repulsion"]
    # The stiffness of a fiber along its diameter: what an overlap of one part in 10^4 holds.
    assert stored < 1e-8 * LOOSE.E * LOOSE.d_f**3
    assert later["kinetic"] < 1e-8 * LOOSE.E * LOOSE.d_f**3


def test_a_loop_of_inertia_and_drag_has_failed(tmp_path):
    run = simulate(LOOSE, FAST, threads=1)
    assert run.done
    assert run.loop_loss > 1.0
    assert run.column("pressure").min() < 0.0
    assert run.status == "failed"
    assert any("the box pulls" in w for w in run.warnings)
    assert any("release takes work too" in w for w in run.warnings)
    words = ["--fibers", "30", "--beads", "15", "--v-max", "0.12", "--strain-per-step", "2e-4"]
    got = CliRunner().invoke(cli, ["fiber", "simulate", str(tmp_path / "run.npz"), *words])
    assert got.exit_code == 1
    assert "failed, for the reasons above" in str(got.exception)
    # The tables of the samples so far are on stdout all the same, with the error.
    words += ["--json", "--force"]
    got = CliRunner().invoke(cli, ["fiber", "simulate", str(tmp_path / "run.npz"), *words])
    assert got.exit_code == 1
    printed = json.loads(got.stdout)
    assert printed["tables"][0]["rows"]
    assert "failed, for the reasons above" in printed["error"]


def test_books_that_do_not_close_are_told():
    run = simulate(LOOSE, FAST, threads=1)
    before = run.energy["residual_relative"]
    assert before < 0.01
    run.table["friction_loss"] = [0.0] * len(run.table["work"])
    assert run.energy["residual_relative"] > before
    run.table["drag_loss"] = [0.0] * len(run.table["work"])
    assert any("is not accounted for" in w for w in run.warnings)
    assert run.status == "failed"
