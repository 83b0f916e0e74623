"""Bead-spring network: forces, virial, energy books, restart, threads, contact counts, loop."""

import math
from dataclasses import replace

import numpy as np
import pytest

from feltmb._core import fiber as core
from feltmb.fiber import (
    Cycle,
    FiberBox,
    FiberRun,
    contacts_per_volume,
    lay,
    read_directions,
    simulate,
)
from unmodeled.errors import DataError, InvalidParameter

SMALL = FiberBox(n_fibers=40, n_beads=11, v_f=0.05, crimp=0.2, seed=3, drag=0.05)


def with_state(box, state):
    return core.BeadSpringNetwork(box.core(), state, 1)


@pytest.mark.parametrize("repulsion", ["hertz", "logarithmic"])
def test_forces_are_the_gradient(repulsion):
    box = replace(SMALL, repulsion=repulsion)
    network = lay(box, 1)
    network.relax(300)
    state = network.state()
    # Shake it so that every term acts; the logarithm needs beads that do not cross exactly.
    rng = np.random.default_rng(0)
    state["positions"] = state["positions"] + 0.02 * box.d_f * rng.normal(
        size=state["positions"].size
    )
    _, forces = with_state(box, state).energy_and_forces()
    scale = np.abs(forces).max()
    worst = 0.0
    for index in rng.integers(0, forces.size, 40):
        h = 1e-6 * box.d_f
        energies = []
        for step in (-2, -1, 1, 2):
            moved = dict(state)
            moved["positions"] = state["positions"].copy()
            moved["positions"][index] += step * h
            energies.append(with_state(box, moved).energy_and_forces()[0])
        numeric = -(energies[0] - 8 * energies[1] + 8 * energies[2] - energies[3]) / (12 * h)
        worst = max(worst, abs(numeric - forces[index]) / scale)
    assert worst < 1e-6


def test_virial_is_the_strain_derivative():
    """Pressure along axis 3 times volume is -dE/d(log side 3) at fixed relative positions."""
    network = lay(SMALL, 1)
    network.relax(300)
    state = network.state()
    rng = np.random.default_rng(1)
    state["positions"] = state["positions"] + 0.02 * SMALL.d_f * rng.normal(
        size=state["positions"].size
    )
    energies = []
    for h in (-2e-7, -1e-7, 1e-7, 2e-7):
        moved = dict(state)
        x = state["positions"].reshape(-1, 3).copy()
        x[:, 2] *= math.exp(h)
        moved["positions"] = x.ravel()
        moved["box"] = state["box"] * np.array([1, 1, math.exp(h)])
        energies.append(with_state(SMALL, moved).energy_and_forces()[0])
    slope = (energies[0] - 8 * energies[1] + 8 * energies[2] - energies[3]) / 12e-7
    pressure = with_state(SMALL, state).sample()["pressure"]
    assert pressure * np.prod(state["box"]) == pytest.approx(-slope, rel=1e-5)


def test_momentum_is_conserved():
    network = lay(SMALL, 1)
    _, forces = network.energy_and_forces()
    assert np.abs(forces.reshape(-1, 3).sum(axis=0)).max() < 1e-9 * np.abs(forces).max()


def short(box, **options):
    return simulate(
        box, Cycle(v_max=0.06, strain_per_step=2e-4, relax_steps=400, sample_every=50), **options
    )


def test_same_bits_for_every_thread_count():
    box = replace(SMALL, friction=0.4)
    one, three = short(box, threads=1), short(box, threads=3)
    assert one.table == three.table
    assert np.array_equal(one.state["positions"], three.state["positions"])


def test_restart_is_exact(tmp_path):
    box = replace(SMALL, friction=0.4)
    whole = short(box, threads=1)
    part = short(box, threads=1, max_samples=7, checkpoint=tmp_path / "run.npz")
    assert not part.done
    again = short(box, threads=2, resume=FiberRun.load(tmp_path / "run.npz"))
    assert again.done
    assert again.table == whole.table
    for key, value in whole.state.items():
        assert np.array_equal(again.state[key], value)


def test_seed_decides():
    assert short(SMALL, threads=1).table == short(SMALL, threads=1).table
    other = short(replace(SMALL, seed=4), threads=1)
    assert other.table != short(SMALL, threads=1).table


def crossings(box, seeds):
    count = expected = 0.0
    for seed in seeds:
        network = lay(replace(box, seed=seed), 0)
        volume = float(np.prod(network.state()["box"]))
        count += network.crossings()
        # Fibers do not count against themselves.
        expected += (
            contacts_per_volume("toll", box.v_f, box.d_f, ratio=box.ratio, counting="once")
            * volume
            * (1 - 1 / box.n_fibers)
        )
    return count, expected


@pytest.mark.parametrize("ratio", [1.0, 4.0])
def test_contacts_as_laid_agree_with_toll(ratio):
    """Straight fibers; van Wyk's formula is the same number for isotropic ones."""
    count, expected = crossings(
        FiberBox(n_fibers=200, n_beads=13, v_f=0.04, crimp=0.0, ratio=ratio), range(6)
    )
    assert abs(count - expected) < 3 * math.sqrt(expected)
    if ratio == 1.0:
        van_wyk = contacts_per_volume("van_wyk", 0.04, 25e-6)
        toll = contacts_per_volume("toll", 0.04, 25e-6, counting="once")
        assert toll == pytest.approx(van_wyk, rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [1.0, 3.0])
def test_many_contacts_as_laid_agree_with_toll(ratio):
    box = FiberBox(n_fibers=2000, n_beads=21, v_f=0.05, crimp=0.0, ratio=ratio)
    count, expected = crossings(box, range(12))
    assert expected > 5e4
    # Pairs of contacts on one fiber are correlated when directions differ in their J.
    assert abs(count - expected) < 3 * math.sqrt(expected) * (1.0 if ratio == 1 else 1.5)


def test_relaxation_removes_overlaps():
    network = lay(SMALL, 0)
    before = network.sample()["smallest_distance"]
    network.relax(3000)
    after = network.sample()
    assert before < 0.7
    assert after["smallest_distance"] > 0.97


def test_energy_books_close():
    box = replace(SMALL, friction=0.3, drag=0.01)
    run = simulate(box, Cycle(v_max=0.12, strain_per_step=5e-5, relax_steps=2000, sample_every=500))
    stored = sum(
        run.column(k) for k in ("stretching", "bending", "repulsion", "tangential", "kinetic")
    )
    missing = (
        run.column("work")
        - (stored - stored[0])
        - run.column("friction_loss")
        - run.column("drag_loss")
    )
    assert np.abs(missing).max() < 0.03 * run.column("work").max()
    assert np.all(np.diff(run.column("friction_loss")) >= 0)
    assert np.all(np.diff(run.column("drag_loss")) >= 0)


@pytest.mark.slow
def test_loop_from_friction_alone():
    """Same fibers with and without friction: the friction loop is far above what drag leaves,
    its loss is booked as sliding, and halving the speed does not change it much."""
    box, plan = FiberBox(seed=1), Cycle(sample_every=1000)
    rough = simulate(replace(box, friction=0.4), plan)
    smooth = simulate(box, plan)
    work, slid = rough.column("work"), rough.column("friction_loss")
    assert slid[-1] > 5 * rough.column("drag_loss")[-1]
    assert work[-1] > 5 * smooth.column("work")[-1]
    assert 0.3 < rough.loop_loss < 0.95
    # Pressure exponent of loading: between van Wyk's 3 and Toll's 5, above the onset.
    assert 2 < rough.pressure_exponent(0.2) < 9
    assert rough.pressure_exponent(0.25) < rough.pressure_exponent(0.18)
    slower = simulate(
        replace(box, friction=0.4), replace(plan, strain_per_step=1e-5, sample_every=2000)
    )
    assert slower.column("pressure").max() == pytest.approx(rough.column("pressure").max(), rel=0.2)
    assert slower.loop_loss == pytest.approx(rough.loop_loss, abs=0.1)


def test_bad_input(tmp_path):
    with pytest.raises(InvalidParameter) as caught:
        lay(FiberBox(n_fibers=1, d_f=-1.0, v_f=0.7, time_step=2.0))
    for word in ("n_fibers = 1", "d_f = -1 m", "v_f = 0.7", "time_step = 2"):
        assert word in str(caught.value)
    with pytest.raises(InvalidParameter, match="box side"):
        lay(FiberBox(n_fibers=3, n_beads=4, v_f=0.3))
    with pytest.raises(InvalidParameter, match="repulsion"):
        lay(FiberBox(repulsion="soft"))
    with pytest.raises(InvalidParameter) as caught:
        simulate(SMALL, Cycle(v_max=0.01, strain_per_step=1.0, cycles=0))
    for word in ("v_max = 0.01", "strain_per_step = 1", "cycles = 0"):
        assert word in str(caught.value)
    broken = tmp_path / "x.npz"
    broken.write_bytes(b"nothing")
    with pytest.raises(DataError, match="is damaged"):
        FiberRun.load(broken)
    state = lay(SMALL, 1).state()
    state["box"] = np.ones(2)
    with pytest.raises(InvalidParameter, match="box has 2 numbers"):
        with_state(SMALL, state)


def fibers_of(network, box):
    return np.reshape(network.state()["positions"], (box.n_fibers, box.n_beads, 3))


def test_directions_turn_each_fiber_and_keep_its_place_and_crimp(tmp_path):
    wanted = np.random.default_rng(4).normal(size=(SMALL.n_fibers, 3))
    same = fibers_of(lay(SMALL, 1), SMALL)[0]
    wanted[0] = -7.0 * (same[-1] - same[0])  # a line has no sense
    table = tmp_path / "directions.csv"
    np.savetxt(table, wanted, "%.17g", ",", header="x,y,z", comments="")
    random, turned = lay(SMALL, 1), lay(SMALL, 1, directions=read_directions(table))
    before, after = fibers_of(random, SMALL), fibers_of(turned, SMALL)
    assert np.allclose(after.mean(axis=1), before.mean(axis=1), rtol=0.0, atol=1e-15)
    ends = after[:, -1] - after[:, 0]
    cosine = np.sum(ends * wanted, axis=1) / np.linalg.norm(ends, axis=1)
    assert np.allclose(np.abs(cosine), np.linalg.norm(wanted, axis=1), rtol=1e-12)
    # A rigid motion: all distances within a fiber stay.
    for x, y in zip(before, after, strict=True):
        gaps = [np.linalg.norm(f[:, None] - f, axis=2) for f in (x, y)]
        assert np.allclose(*gaps, rtol=0.0, atol=1e-12 * SMALL.segment_length * SMALL.n_beads)
    assert turned.sample()["bending"] == pytest.approx(0.0, abs=1e-20)
    cycle = Cycle(v_max=0.06, relax_steps=0)
    run = simulate(SMALL, cycle, directions=wanted, max_samples=1)
    assert run.laid["f"] != simulate(SMALL, cycle, max_samples=1).laid["f"]


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        (np.zeros((3, 3)), r"got the shape \(3, 3\), expected \(40, 3\)"),
        (np.eye(40)[:, :3], r"row 4 is \[0.0, 0.0, 0.0\], expected finite"),
    ],
)
def test_bad_directions(wanted, message):
    with pytest.raises(InvalidParameter, match=message):
        lay(SMALL, 1, directions=wanted)


def test_a_table_without_directions_is_refused(tmp_path):
    (tmp_path / "a.csv").write_text("x,y\n1,2\n3,4\n5,6\n")
    with pytest.raises(DataError, match="no column z; there are x, y; expected x, y and z"):
        read_directions(tmp_path / "a.csv")


def test_directions_have_the_units_of_their_columns(tmp_path):
    table = tmp_path / "a.csv"
    for head in ("x [mm],y [m],z [um]", "x [1],y,z"):
        table.write_text(f"{head}\n" + "1,2,3\n" * 3)
        lengths = (1e-3, 2.0, 3e-6) if "mm" in head else (1.0, 2.0, 3.0)
        assert np.array_equal(read_directions(table)[0], lengths)
    table.write_text("x [deg],y [mm],z\n" + "1,2,3\n" * 3)
    with pytest.raises(DataError, match=r"(?s)numbers or lengths.*'deg'.*column z states no unit"):
        read_directions(table)


def test_the_fibers_as_a_vtk_file():
    """Points, lines and diameters of PolyData, each fiber in one piece with its center inside."""
    run = simulate(SMALL, Cycle(v_max=0.06, relax_steps=0), max_samples=1)
    lines = run.to_vtk().splitlines()
    assert lines[0] == "# vtk DataFile Version 3.0"
    assert lines[2:4] == ["ASCII", "DATASET POLYDATA"]
    assert lines[4] == "POINTS 440 double"
    points = np.array([line.split() for line in lines[5:445]], dtype=float)
    assert lines[445] == "LINES 40 480"
    cells = np.array([line.split() for line in lines[446:486]], dtype=int)
    assert np.array_equal(cells[:, 0], np.full(40, 11))
    assert np.array_equal(cells[:, 1:].ravel(), np.arange(440))
    assert lines[486:489] == ["CELL_DATA 40", "SCALARS fiber int 1", "LOOKUP_TABLE default"]
    assert [int(line) for line in lines[489:529]] == list(range(40))
    assert lines[529:532] == ["POINT_DATA 440", "SCALARS diameter double 1", "LOOKUP_TABLE default"]
    assert [float(line) for line in lines[532:]] == [25e-6] * 440
    x = np.reshape(run.state["positions"], (40, 11, 3))
    shown, side = points.reshape(40, 11, 3), np.asarray(run.state["box"])
    moved = (shown - x) / side
    assert np.allclose(moved, np.round(moved), rtol=0.0, atol=1e-6)
    center = shown.mean(axis=1)
    assert np.all((center > -1e-9) & (center < side + 1e-9))
    assert np.allclose(np.diff(shown, axis=1), np.diff(x, axis=1), rtol=0.0, atol=2e-12)
    with pytest.raises(InvalidParameter, match="no state"):
        FiberRun(SMALL, Cycle()).to_vtk()
