"""What strangers found: units and lists of options, unloaded thickness, fibers, memory."""

import re
from itertools import pairwise

import click
import numpy as np
import pytest
from click.testing import CliRunner

from feltmb.cli import cli
from feltmb.cli.common import ListOption, Quantity, split_list
from feltmb.contact import law as contact_law
from feltmb.errors import DataError, InvalidParameter, ModelError
from feltmb.felt import identify, load_material
from feltmb.fiber import CompressionData, Cycle, FiberBox, fit, law, lay, read_compression, simulate
from feltmb.mechanism import load_action
from feltmb.units import conversion_factor

UNIT = re.compile(r"\[(m|m\^2|s|rad|Hz|Pa|N/m|N|kg)\]")


def commands(command=cli, name="feltmb"):
    yield name, command
    if isinstance(command, click.Group):
        context = click.Context(command)
        for child in command.list_commands(context):
            yield from commands(command.get_command(context, child), f"{name} {child}")


OPTIONS = [
    pytest.param(option, id=f"{name} {option.opts[-1]}")
    for name, command in commands()
    for option in command.params
    if isinstance(option, click.Option)
]


@pytest.mark.parametrize("option", OPTIONS)
def test_options_with_a_unit_take_it(option):
    kinds = getattr(option.type, "types", (option.type,))
    for kind in kinds:
        assert kind not in (click.FLOAT, click.INT)
        assert not isinstance(kind, click.FloatRange) or isinstance(kind, Quantity)
    found = UNIT.search(option.help or "")
    if found:
        for kind in kinds:
            assert isinstance(kind, Quantity)
            assert kind.unit == found.group(1)


@pytest.mark.parametrize("option", [o for o in OPTIONS if o.values[0].multiple])
def test_lists_are_taken_alike(option):
    assert isinstance(option, ListOption)
    context = click.Context(click.Command("any"))
    if isinstance(option.type, Quantity):
        assert option.type_cast_value(context, ("0.1,0.2", "0.3")) == (0.1, 0.2, 0.3)
        return
    together = option.type_cast_value(context, ("first=1,second=2", "third=3"))
    assert together == ("first=1", "second=2", "third=3")


@pytest.mark.parametrize(
    ("text", "items"),
    [
        ("a,b", ["a", "b"]),
        ("a , b", ["a", "b"]),
        ("channels=key,hammer", ["channels=key,hammer"]),
        ("channels=key,hammer,rtol=1e-3", ["channels=key,hammer", "rtol=1e-3"]),
        ('law={name="x", felt="y"}', ['law={name="x", felt="y"}']),
        ("contacts.*.law=mean,p=[1, 2]", ["contacts.*.law=mean", "p=[1, 2]"]),
    ],
)
def test_what_a_list_is(text, items):
    assert split_list(text) == items


def test_an_empty_item_is_refused():
    with pytest.raises(ValueError, match="none of them empty"):
        split_list("a,,b")


@pytest.mark.parametrize(
    ("unit", "si", "factor"),
    [
        ("cm2", "m^2", 1e-4),
        ("mm²", "m^2", 1e-6),
        ("m/s2", "m/s^2", 1.0),
        ("N/mm2", "Pa", 1e6),
        ("m s-2", "m/s^2", 1.0),
        ("N/m^2.3", "N/m^2.3", 1.0),
        ("bar", "Pa", 1e5),
        ("μm", "m", 1e-6),
        ("1/s", "1/s", 1.0),
    ],
)
def test_powers_without_a_caret(unit, si, factor):
    assert conversion_factor(unit, si) == pytest.approx(factor, rel=1e-15)


@pytest.mark.parametrize("unit", ["m2m", "12", "mm^", "m^^2", "2m"])
def test_what_is_no_unit(unit):
    with pytest.raises(InvalidParameter, match="unknown unit"):
        conversion_factor(unit, "m")


THICK, AREA = 8e-3, 4e-4
FELT = load_material("synthetic_soft_red")


def compression_test(seed, noise, preload=0.03, n=40, thickness=THICK):
    """A loop of a known felt that starts at a preload; noise over the largest pressure."""
    v = np.linspace(FELT.v_f0, FELT.end, 1000)[1:]
    top = FELT.pressure("loading", [FELT.end])[0]
    start = v[np.searchsorted(FELT.pressure("loading", v), preload * top)]
    height = FELT.v_f0 * thickness / np.linspace(start, 0.999 * FELT.end, n)
    v = FELT.v_f0 * thickness / height
    pressure = np.concatenate([FELT.pressure("loading", v), FELT.pressure("unloading", v)[::-1]])
    pressure += noise * top * np.random.default_rng(seed).normal(size=2 * n)
    return np.concatenate([height, height[::-1]]), pressure, np.arange(2 * n) < n


def unknown_thickness(seed, noise, **options):
    height, pressure, loading = compression_test(seed, noise, **options)
    v = FELT.v_f0 * height.max() / height
    return CompressionData(v, pressure, loading, FELT.v_f0, "test", height, False)


def written(tmp_path, seed=0, noise=0.002, **options):
    height, pressure, _ = compression_test(seed, noise, **options)
    rows = [f"{1e3 * h:.6f},{p * AREA:.6f}" for h, p in zip(height, pressure, strict=True)]
    path = tmp_path / "test.csv"
    path.write_text("thickness [mm],force [N]\n" + "\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize("area", ["4cm^2", "4 cm2", "400mm2", "4e-4"])
def test_an_area_in_any_unit(tmp_path, area):
    path = written(tmp_path)
    common = ["--v-f0", str(FELT.v_f0), "--area", area, "--thickness", "8mm", "--json"]
    got = CliRunner().invoke(cli, ["fiber", "fit", str(path), "--starts", "2", *common])
    assert got.exit_code == 0, got.output
    asked = ["--material", "synthetic_soft_red", *common]
    got = CliRunner().invoke(cli, ["felt", "identify", str(path), *asked])
    assert got.exit_code == 0, got.output


def test_a_load_before_the_zero_of_a_displacement_tells_the_zero(tmp_path):
    up = np.linspace(-0.05, 1.0, 60)
    force = 20.0 * np.maximum(up + 0.03, 0.0)  # the contact begins at -0.03 mm
    x, f = np.append(up, up[::-1]), np.append(force, force[::-1])
    path = tmp_path / "test.csv"
    rows = "\n".join(f"{a:.5f},{b:.5f}" for a, b in zip(x, f, strict=True))
    path.write_text(f"displacement [mm],force [N]\n{rows}\n")
    known = {"v_f0": FELT.v_f0, "thickness0": 6e-3, "area": AREA}
    with pytest.raises(DataError, match="hint: the displacement at the first contact") as told:
        read_compression(path, **known)
    zero = float(str(told.value).split("--zero=")[1].split("mm")[0])
    assert -0.035 < zero < -0.01
    assert read_compression(path, zero=1e-3 * zero, **known).reference_known


def test_a_thickness_that_the_file_refutes_is_refused(tmp_path):
    path = written(tmp_path)
    with pytest.raises(DataError, match=r"6 mm without load, but the test carries .* Pa at 6\.0"):
        read_compression(path, v_f0=FELT.v_f0, thickness0=6e-3, area=AREA)
    data = read_compression(path, v_f0=FELT.v_f0, area=AREA)
    assert not data.reference_known
    with pytest.raises(DataError, match="expected more than"):
        data.with_thickness(6e-3)
    assert data.with_thickness(THICK).v_f == pytest.approx(FELT.v_f0 * THICK / data.thickness)
    asked = ["--material", "synthetic_soft_red", "--area", "4cm2", "--thickness", "6mm"]
    got = CliRunner().invoke(cli, ["felt", "identify", str(path), *asked])
    assert isinstance(got.exception, DataError)


def test_the_unloaded_thickness_is_estimated_and_said(tmp_path):
    path = written(tmp_path)
    data = read_compression(path, v_f0=FELT.v_f0, area=AREA)
    found = identify(data, material=FELT)
    low, high = found.thickness_interval
    assert data.thickest_loaded < low < THICK < high < 1.1 * THICK
    assert low < found.thickness < high
    assert found.warnings[0].startswith("The unloaded thickness was not given: estimated")
    assert "unloaded thickness [mm], estimated" in found.report()
    # As one that is known: narrower intervals, around the same truth.
    known = identify(data.with_thickness(THICK), material=FELT)
    assert known.thickness == pytest.approx(THICK)
    assert known.thickness_interval is None
    assert "unloaded thickness [mm], as given" in known.report()
    for b, c in ((found.loading, known.loading), (found.unloading, known.unloading)):
        assert b.interval["K_p"][0] < c.K_p < b.interval["K_p"][1]
        assert np.ptp(b.interval["K_p"]) > 2.0 * np.ptp(c.interval["K_p"])


def test_a_thickness_that_is_not_determined_is_asked_for():
    with pytest.raises(ModelError, match=r"do not determine\s+it.*--thickness"):
        identify(unknown_thickness(0, 0.2, preload=0.4), material=FELT)
    poor = fit(unknown_thickness(0, 0.2, preload=0.4), "binomial", n_starts=2)
    assert "thickness0" in poor.undetermined
    assert any("The data do not determine it" in w for w in poor.warnings)


def test_a_fit_at_a_bound_fails(tmp_path):
    path = tmp_path / "flat.csv"
    rows = [f"{0.1 + 0.004 * i:.3f},{100 + 0.01 * (i % 2)}" for i in range(30)]
    path.write_text("v_f [-],pressure [kPa]\n" + "\n".join(rows) + "\n")
    given = ["--v-f0", "0.0999", "--branch", "loading", "--starts", "2"]
    got = CliRunner().invoke(cli, ["fiber", "fit", str(path), *given])
    assert got.exit_code != 0
    assert "the data do not determine" in got.output


def covered(seeds, noise):
    """Share of the 95 % intervals that hold the truth, of K_p, gamma and thickness."""
    hits = []
    for seed in seeds:
        found = identify(unknown_thickness(seed, noise), material=FELT)
        truths = [
            (b.interval[key], getattr(true, key))
            for b, true in ((found.loading, FELT.loading), (found.unloading, FELT.unloading))
            for key in ("K_p", "gamma")
        ]
        truths.append((found.thickness_interval, THICK))
        hits.append([low <= true <= high for (low, high), true in truths])
    return np.mean(hits, axis=0)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.001, 0.01])
def test_intervals_with_an_estimated_thickness_hold_what_they_say(noise):
    share = covered(range(100), noise)
    # Five standard deviations of a count of 100 at 95 % are 11 %.
    assert np.all(np.abs(share - 0.95) < 0.11), share


@pytest.mark.slow
def test_intervals_of_a_law_with_an_estimated_thickness_hold_what_they_say():
    truth = {"K_p": 2.63e6, "gamma": 1.57, "thickness0": THICK}
    made = law("binomial", K_p=2.63e6, gamma=1.57, v_f0=0.132, Q=2.0)
    height = np.linspace(6.2e-3, 3e-3, 80)
    exact = np.asarray(made.pressure(0.132 * THICK / height, 1))
    hits = []
    for seed in range(100):
        p = exact + 0.003 * exact.max() * np.random.default_rng(seed).normal(size=80)
        v = 0.132 * height.max() / height
        data = CompressionData(v, p, np.ones(80, bool), 0.132, "test", height, False)
        found = fit(data, "binomial", n_starts=2)
        assert not found.undetermined
        hits.append([found.interval[k][0] <= x <= found.interval[k][1] for k, x in truth.items()])
    share = np.mean(hits, axis=0)
    assert np.all(np.abs(share - 0.95) < 0.11), share


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
    assert "failed, for the reasons above" in got.output


def test_books_that_do_not_close_are_told():
    run = simulate(LOOSE, FAST, threads=1)
    before = run.energy["residual_relative"]
    assert before < 0.01
    run.table["friction_loss"] = [0.0] * len(run.table["work"])
    assert run.energy["residual_relative"] > before
    run.table["drag_loss"] = [0.0] * len(run.table["work"])
    assert any("is not accounted for" in w for w in run.warnings)
    assert run.status == "failed"


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
    pytest.param((0.8 * TOP, 0.0), id="a smaller cycle"),
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
