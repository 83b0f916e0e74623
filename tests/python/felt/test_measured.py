"""Contact laws from measured loops: a known law comes back, and faults are told."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.signal import lfilter

import feltmb
from feltmb.cli.felt import command
from feltmb.contact import law
from feltmb.felt import load_envelope, measured_loop, read_measured_loop
from unmodeled.errors import DataError, InvalidParameter

TRUE = {"loading": (5.52e3, 1.58e3, -0.60e3), "unloading": (0.19e3, 5.04e3, 3.04e3)}
UP = np.linspace(0.0, 8e-4, 300)
#: A whole loop and an inner one.
PATH = np.concatenate([UP, UP[::-1], UP[:200], UP[:200][::-1]])


def made_loop(noise=0.0, approach=0, zero=0.0, **memory):
    """Displacement and force of the law with memory."""
    felt = law("felt_memory", **TRUE, **memory)
    force = felt.path(PATH, 1e-3 * np.arange(PATH.size))
    random = np.random.default_rng(2)
    x = np.concatenate([np.linspace(-2e-4, 0.0, approach + 1)[:-1], PATH]) + zero
    force = np.concatenate([np.zeros(approach), force])
    return x, force + noise * random.standard_normal(x.size)


@pytest.mark.parametrize("noise", [0.0, 0.02, 0.1])
def test_the_law_of_a_loop_follows_it_to_the_noise(noise):
    found = measured_loop(*made_loop(noise, approach=60, zero=1.3e-3))
    # The force rises with 4.9 kN/m at first: the noise hides the first contact.
    assert found.zero == pytest.approx(1.3e-3, abs=4e-6 + 1e-3 * noise)
    assert found.rms == pytest.approx(noise, rel=0.1, abs=0.005)
    true = law("felt_memory", **TRUE)
    grid = np.linspace(0.0, 8e-4, 200)
    time = np.arange(200.0)
    shifted = grid - (found.zero - 1.3e-3)
    made = found.law().path(np.maximum(shifted, 0.0), time)
    assert made == pytest.approx(true.path(grid, time), abs=0.02 + 2.5 * noise)


def test_a_short_transition_is_found():
    found = measured_loop(*made_loop(0.02, kappa=0.01, wiping_out=0.2))
    assert found.memory["kappa"] < 0.05
    assert found.rms == pytest.approx(0.02, rel=0.25)
    default = found.law(kappa=0.2, wiping_out=0.0).path(
        np.maximum(found.compression, 0.0), 1e-3 * np.arange(found.force.size)
    )
    assert np.sqrt(np.mean((default - found.force) ** 2)) > 5.0 * found.rms


def test_the_envelope_is_valid_whatever_the_noise():
    """Unloading is between zero and loading, both rise, and they meet at the end."""
    for seed in range(5):
        x, force = made_loop(0.0)
        force += 0.5 * np.random.default_rng(seed).standard_normal(x.size)
        made = measured_loop(x, force, zero=0.0).envelope
        assert np.all(made.unloading <= made.loading)
        assert np.all(np.diff(made.loading) >= 0.0)
        assert made.unloading[0] == made.loading[0] == 0.0
        assert made.unloading[-1] == pytest.approx(made.loading[-1])
        assert 0.0 < made.loss < 1.0


def powers(low=0.0, back=0.0, n=200):
    """Loading 10 e^2.5 and unloading 10 e^4, over 1 mm, from ``low`` and down to ``back``."""
    up, down = np.linspace(low, 1.0, n), np.linspace(1.0, back, n)
    return 1e-3 * np.concatenate([up, down]), 10.0 * np.concatenate([up**2.5, down**4])


@pytest.mark.parametrize("n", [20, 61, 2000])
def test_the_loss_contains_the_turn(n):
    assert measured_loop(*powers(n=n), zero=0.0).loss == pytest.approx(0.3, abs=0.002)


@pytest.mark.parametrize(("low", "back"), [(0.4, 0.4), (0.0, 0.5)])
def test_a_branch_without_samples_at_small_compression_is_a_power_there(low, back):
    found = measured_loop(*powers(low, back), zero=0.0)
    e = 1e3 * found.envelope.compression
    small = e < 0.5
    assert found.envelope.loading[small] == pytest.approx(10.0 * e[small] ** 2.5, abs=0.01)
    assert found.envelope.unloading[small] == pytest.approx(10.0 * e[small] ** 4, abs=0.01)
    told = [f"unloading has no samples below {back:.4g} mm"]
    told += [f"loading has no samples below {low:.4g} mm"] if low else []
    for words in told:
        assert any(words in note for note in found.notes)
    assert not any("--zero" in note for note in found.notes)
    # Both losses are over the range that has samples of both branches.
    start = max(low, back)
    work = [(1.0 - start ** (p + 1.0)) / (p + 1.0) for p in (2.5, 4.0)]
    assert found.loss == pytest.approx(1.0 - work[1] / work[0], abs=0.002)


@pytest.mark.parametrize(
    ("offset", "wrong"),
    [
        (0.2, None),
        (-0.2, 30),
        (0.2, 140),
        *(pytest.param(*c, marks=pytest.mark.slow) for c in ((-0.2, None), (0.2, 30), (-0.2, 140))),
    ],
)
def test_the_force_of_the_approach_and_lost_samples(offset, wrong):
    """An offset of the load cell, and one sample of 0 N or 5 N."""
    x, force = powers()
    x = np.concatenate([np.linspace(-1e-3, 0.0, 101)[:-1], x])
    force = np.concatenate([np.zeros(100), force]) + offset
    if wrong is not None:
        force[wrong] = 5.0 if wrong < 100 else 0.0
    found = measured_loop(x, force)
    assert abs(found.zero) < 5e-5
    assert found.envelope.loading[-1] == pytest.approx(10.0, abs=0.02)
    assert any(f"approach, {offset:.2g} N, is subtracted" in note for note in found.notes)


#: Noise [N] and power of a loading from zero: without, with little and with much noise.
FAST = ((0.0, 1.0), (0.4, 1.5), (3.0, 2.5))


def preloaded(missing, noise, seed=1):
    """Loop of 150 e^1.5 + 120 e^3 N (e in mm) that begins at the compression ``missing`` [mm]."""
    up = np.linspace(missing, 1.4, 600)
    load = 150.0 * up**1.5 + 120.0 * up**3
    force = np.concatenate([load, load[-1] * (up[::-1] / 1.4) ** 3.2])
    x = 1e-3 * (np.concatenate([up, up[::-1]]) - missing)
    return x, force + noise * np.random.default_rng(seed).standard_normal(x.size)


@pytest.mark.parametrize("missing", [0.16, 0.3])
def test_a_preload_is_told_with_the_compression_that_the_test_lacks(missing, tmp_path):
    """The force at the first sample is 2 % or 5 % of the largest one."""
    x, force = preloaded(missing, 0.4)
    (note,) = (n for n in measured_loop(x, force).notes if "first sample" in n)
    zero = float(note.split("--zero=")[1].split("mm")[0])
    assert zero == pytest.approx(-missing, rel=0.4)
    rows = "\n".join(f"{6.0 - 1e3 * a:.6f},{b:.6f}" for a, b in zip(x, force, strict=True))
    path = tmp_path / "pair.csv"
    path.write_text("thickness [mm],force [N]\n" + rows)
    (note,) = (n for n in read_measured_loop(path).notes if "first sample" in n)
    assert f"about --zero={6.0 - zero:.3g}mm" in note
    # With the zero, the law begins softly, and nothing is left to tell.
    told = measured_loop(x, force, zero=-1e-3 * missing)
    assert not any("first sample" in n for n in told.notes)
    told = measured_loop(x, force, zero=0.0)
    assert any("first sample" in n and "--zero" not in n for n in told.notes)


@pytest.mark.parametrize(
    ("noise", "power"),
    [
        pytest.param(n, p, marks=() if (n, p) in FAST else pytest.mark.slow)
        for n in (0.0, 0.05, 0.4, 3.0)
        for p in (1.0, 1.5, 2.5)
    ],
)
def test_noise_is_no_preload(noise, power):
    for seed, n in enumerate((20, 100, 1000)):
        up = np.linspace(0.0, 1.4, n)
        load = 100.0 * up**power + 120.0 * up**3
        force = np.concatenate([load, load[-1] * (up[::-1] / 1.4) ** 4])
        force += noise * np.random.default_rng(seed).standard_normal(force.size)
        found = measured_loop(1e-3 * np.concatenate([up, up[::-1]]), force)
        assert not any("first sample" in note for note in found.notes)


def test_unloading_above_loading_is_told():
    x, force = powers()
    found = measured_loop(x, np.concatenate([force[200:][::-1], force[:200][::-1]]))
    assert found.loss < 0.0
    assert any("unloading lies above loading" in note for note in found.notes)


def test_a_file_may_list_unloading_with_rising_displacement(tmp_path):
    x, force = powers()
    rows = [f"{1e3 * x[i]:.6f},{force[i]:.6f},loading" for i in range(200)]
    rows += [f"{1e3 * x[i]:.6f},{force[i]:.6f},unloading" for i in reversed(range(200, 400))]
    path = tmp_path / "pair.csv"
    path.write_text("displacement [mm],force [N],branch\n" + "\n".join(rows))
    assert read_measured_loop(path).loss == pytest.approx(0.3, abs=0.01)


def test_exports_with_more_columns(tmp_path):
    """Strain and stress of the machine beside its displacement and force."""
    x, force = powers()
    rows = "\n".join(
        f"{i};{1e3 * a:.5f};{b:.5f};{a / 6e-5:.5f};{b / 100.0:.6f};ok".replace(".", ",")
        for i, (a, b) in enumerate(zip(x, force, strict=True))
    )
    path = tmp_path / "pair.csv"
    path.write_text(
        "Probe;1,02;0,98;;;\nZeit (s);Standardweg (mm);Standardkraft (N);Dehnung (%);"
        f"Spannung (MPa);Status\n{rows}\n",
        encoding="cp1252",
    )
    found = read_measured_loop(path)
    assert found.loss == pytest.approx(0.3, abs=0.01)
    assert any("Standardweg (mm) is used, not Dehnung (%)" in note for note in found.notes)


def test_holds_are_left_out_and_told():
    x, force = made_loop(0.01)
    top = int(np.argmax(x))
    held = force[top] * (1.0 - 0.08 * (1.0 - np.exp(-np.arange(400) / 50.0)))
    x = np.concatenate([x[: top + 1], np.full(400, x[top]), x[top + 1 :]])
    force = np.concatenate([force[: top + 1], held, force[top + 1 :]])
    found = measured_loop(x, force)
    assert found.branches.held.size == pytest.approx(400, abs=10)
    assert any("samples of holds are left out" in note for note in found.notes)
    assert found.rms == pytest.approx(0.01, rel=0.3)


def cycles_of(count, gain, noise, seed):
    """Complete cycles, whose forces differ by a gain each; successive noise correlates by 0.5."""
    random = np.random.default_rng(seed)
    cycle = np.concatenate([UP, UP[::-1]])
    force = law("felt_memory", **TRUE).path(cycle, 1e-3 * np.arange(cycle.size))
    gains = 1.0 + gain * random.standard_normal(count)
    white = np.sqrt(0.75) * random.standard_normal(count * cycle.size)
    drift = noise * lfilter([1.0], [1.0, -0.5], white)
    return np.tile(cycle, count), np.concatenate([g * force for g in gains]) + drift


@pytest.mark.parametrize(
    ("seeds", "room"), [(8, 2.5), pytest.param(30, 1.0, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize(("count", "gain", "noise"), [(1, 0.0, 0.05), (3, 0.03, 0.005)])
def test_two_thirds_of_the_intervals_contain_the_true_forces(count, gain, noise, seeds, room):
    """From the scatter of correlated samples, and from that between cycles."""
    cycle = np.concatenate([UP, UP[::-1]])
    true = law("felt_memory", **TRUE).path(cycle, 1e-3 * np.arange(cycle.size))
    sides = true[: UP.size], true[UP.size :][::-1]
    places = np.linspace(2e-4, 7e-4, 6)
    inside, losses = [], []
    work = [np.trapezoid(side, UP) for side in sides]
    for seed in range(seeds):
        found = measured_loop(*cycles_of(count, gain, noise, seed), zero=0.0)
        made, sure = found.envelope, found.uncertainty
        assert sure.cycles == count
        losses.append((made.loss - 1.0 + work[1] / work[0]) / sure.loss)
        pairs = ((made.loading, sure.loading), (made.unloading, sure.unloading))
        for (force, sd), side in zip(pairs, sides, strict=True):
            error = np.interp(places, made.compression, force) - np.interp(places, UP, side)
            inside.append(np.abs(error) < np.interp(places, made.compression, sd))
    assert np.mean(inside) == pytest.approx(0.68, abs=0.12 * room)
    if count == 1:  # that between cycles is larger: the ends of both branches meet
        assert np.mean(np.abs(losses) < 1.0) == pytest.approx(0.68, abs=0.2 * room)
        assert np.sqrt(np.mean(np.square(losses))) == pytest.approx(1.0, abs=0.35 * room)


def inner_loops(noise, seed, count=120, **memory):
    """A complete cycle and two inner ones, with correlated noise."""
    up = np.linspace(0.0, 8e-4, count)
    inner = up[: 2 * count // 3], up[: 5 * count // 6]
    x = np.concatenate([up, up[::-1], *(part for i in inner for part in (i, i[::-1]))])
    force = law("felt_memory", **TRUE, **memory).path(x, 1e-3 * np.arange(x.size))
    white = np.sqrt(0.75) * np.random.default_rng(seed).standard_normal(x.size)
    return x, force + noise * lfilter([1.0], [1.0, -0.5], white)


@pytest.mark.parametrize(
    ("seeds", "room"), [(5, 1.6), pytest.param(20, 1.0, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("memory", [{"kappa": 0.4}, {"kappa": 0.05, "wiping_out": 0.2}])
def test_intervals_of_kappa_contain_it(memory, seeds, room):
    """The transition of inner loops, from correlated samples."""
    errors = []
    for seed in range(seeds):
        found = measured_loop(*inner_loops(0.04, seed, **memory), zero=0.0)
        assert found.memory.get("wiping_out", 0.0) == memory.get("wiping_out", 0.0)
        errors.append((found.memory["kappa"] - memory["kappa"]) / found.uncertainty.kappa)
    assert np.mean(np.abs(errors) < 1.0) == pytest.approx(0.68, abs=0.25 * room)
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(1.0, abs=0.4 * room)


def test_a_kappa_that_the_test_does_not_show_has_no_uncertainty():
    """A first cycle has no transition, and cycles with other forces hide it."""
    assert np.isnan(measured_loop(*cycles_of(1, 0.0, 0.05, 1), zero=0.0).uncertainty.kappa)
    hidden = measured_loop(*cycles_of(3, 0.03, 0.005, 1), zero=0.0)
    assert "kappa" in hidden.memory
    assert np.isnan(hidden.uncertainty.kappa)
    small, large = (
        measured_loop(*inner_loops(n, 1, kappa=0.4), zero=0.0).uncertainty.kappa for n in (0.1, 0.4)
    )
    assert large == pytest.approx(4.0 * small, rel=0.3)


def test_the_force_of_the_approach_has_an_error():
    """Subtracting the force of few samples moves all forces in common."""
    x, force = made_loop(0.05, approach=40)
    few, many = (measured_loop(x, force + offset).uncertainty for offset in (0.0, 0.5))
    added = np.sqrt(many.loading[5] ** 2 - few.loading[5] ** 2)
    assert added == pytest.approx(1.25 * 0.05 / np.sqrt(20.0), rel=0.5)
    assert many.loss > 1.1 * few.loss


def test_uncertainties_follow_the_noise_and_the_cycles():
    one = [measured_loop(*cycles_of(1, 0.0, n, 1), zero=0.0).uncertainty for n in (0.01, 0.1)]
    half = UP.size // 3
    assert one[1].loading[half] == pytest.approx(10.0 * one[0].loading[half], rel=0.3)
    assert one[1].loss == pytest.approx(10.0 * one[0].loss, rel=0.4)
    assert one[0].zero == 0.0  # given
    assert "do not contain the variation from cycle to cycle" in one[0].source
    found = measured_loop(*cycles_of(4, 0.1, 0.01, 2))
    sure = found.uncertainty
    assert sure.cycles == 4
    assert sure.loading[-1] > 30.0 * one[0].loading[-1]
    assert 0.0 < sure.zero < 5e-5
    assert any("give the uncertainty" in note for note in found.notes)
    # An inner loop is no repetition of the whole one.
    inner = measured_loop(*made_loop(0.02))
    assert inner.uncertainty.cycles == 1
    assert len(inner.branches.by_loading) == 2
    # The numbers do not require memory for all pairs of rows.
    fine = measured_loop(*cycles_of(1, 0.0, 0.01, 1), zero=0.0, points=20_000).uncertainty
    assert fine.loading[-1] == pytest.approx(one[0].loading[-1], rel=1e-6)
    assert 0.5 * one[0].loss < fine.loss < one[0].loss  # without the chords of a coarse table


def write(path, unit=1e3, text=None):
    x, force = made_loop(0.02, approach=20)
    rows = "\n".join(f"{unit * a:.6f},{b:.4f}" for a, b in zip(x, force, strict=True))
    path.write_text(f"displacement [mm],force [N]\n{rows}\n" if text is None else text)
    return path


def run(*arguments):
    result = CliRunner().invoke(command, [str(a) for a in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.stdout


def test_from_a_file_to_a_mechanism(tmp_path):
    path = write(tmp_path / "pair.csv")
    out = run("contact", path, "--contact", "06", "-o", tmp_path / "mine.toml",
              "--plot", tmp_path / "pair.png")  # fmt: skip
    assert "difference of law and test: 0.02" in out
    assert (tmp_path / "pair.png").stat().st_size > 5000
    action = feltmb.load_action(tmp_path / "mine.toml")
    run_of = feltmb.simulate(action, "forte", duration=0.12)
    assert run_of["contact06.force"].max() > 1.0
    run("contact", path, "-o", tmp_path / "table.toml")
    assert load_envelope(tmp_path / "table.toml").closing == pytest.approx(8e-4, rel=0.02)
    told = json.loads(run("contact", path, "--json", "--zero", "0mm"))
    assert told["zero"] == 0.0
    assert told["rms_of_law"] == pytest.approx(0.02, rel=0.1)
    sure = told["uncertainty"]
    assert len(sure["loading"]) == len(told["envelope"]["loading"])
    assert sure["loss"] > 0.0
    assert "% of the loading work; of the samples of its cycle" in " ".join(out.split())
    assert "±: standard uncertainty (68 %), from the scatter of the samples" in out
    assert "mm (95 %: " in out
    assert told["memory"] == {}
    assert sure["kappa"] is None
    assert "the test does not tell better ones, and they have no uncertainty" in " ".join(
        out.split()
    )


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (inner_loops(0.04, 1, kappa=0.05, wiping_out=0.2), "(± "),
        (cycles_of(3, 0.03, 0.005, 1), "(the test does not determine its uncertainty), wiping_out"),
    ],
)
def test_the_command_prints_the_uncertainty_of_kappa(tmp_path, made, words):
    x, force = made
    rows = "\n".join(f"{1e3 * a:.6f},{b:.4f}" for a, b in zip(x, force, strict=True))
    path = write(tmp_path / "pair.csv", text=f"displacement [mm],force [N]\n{rows}\n")
    out = " ".join(run("contact", path, "--zero", "0mm").split())
    told = json.loads(run("contact", path, "--zero", "0mm", "--json"))
    assert f"memory: kappa = {told['memory']['kappa']:.4g} {words}" in out
    assert (told["uncertainty"]["kappa"] is None) == ("±" not in words)
    wiping = told["memory"].get("wiping_out", 0)
    assert f"wiping_out = {wiping:g} (of 0 and 0.2, the one that follows the test better; no" in out


def test_a_test_by_thickness(tmp_path):
    x, force = made_loop(0.0)
    rows = "\n".join(f"{6.0 - 1e3 * a:.6f};{b:.4f}" for a, b in zip(x, force, strict=True))
    path = tmp_path / "pair.csv"
    path.write_text("Dicke [mm];Kraft [N]\n" + rows.replace(".", ","))
    found = read_measured_loop(path)
    assert found.by_thickness
    assert -found.zero == pytest.approx(6e-3, abs=4e-6)
    assert found.rms < 0.01


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (
            {"head": "v_f [-],force [N]"},
            "expected a column displacement or thickness or strain; there are v_f",
        ),
        (
            {"head": "displacement [mm],pressure [Pa]"},
            "pressure without the area of the sample, expected area",
        ),
        ({"rows": 300}, "0 samples of unloading, expected at least 8"),
    ],
)
def test_faults_of_a_file_are_told(tmp_path, change, told):
    x, force = made_loop(0.0)
    force = change.get("force", 1.0) * force
    count = change.get("rows", x.size)
    rows = "\n".join(
        f"{1e3 * a:.6f},{b:.4f}" for a, b in zip(x[:count], force[:count], strict=True)
    )
    path = tmp_path / "pair.csv"
    path.write_text(f"{change.get('head', 'displacement [mm],force [N]')}\n{rows}\n")
    with pytest.raises(DataError, match=told):
        read_measured_loop(path)


def test_faults_of_arrays_are_told():
    with pytest.raises(InvalidParameter, match="expected arrays of equal length"):
        measured_loop(np.zeros(30), np.zeros(20))
    with pytest.raises(InvalidParameter, match="expected finite numbers that change"):
        measured_loop(np.zeros(30), np.zeros(30))
    x, force = made_loop()
    for zero in (0.01, -1.0):
        with pytest.raises(InvalidParameter, match=f"zero = {zero:g} m, expected less than the"):
            measured_loop(x, force, zero=zero)
    with pytest.raises(InvalidParameter, match="samples of unloading beyond it, expected at least"):
        measured_loop(x, force, zero=7.9e-4)
    with pytest.raises(InvalidParameter, match="expected compression to be positive"):
        measured_loop(x, -force)
    with pytest.raises(InvalidParameter, match="points = 3, must be >= 5"):
        measured_loop(x, force, points=3)
