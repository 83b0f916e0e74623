"""Unloaded thickness of a felt: estimated, refuted, not determined."""

import numpy as np
import pytest
from click.testing import CliRunner

from feltmb.cli import cli
from feltmb.felt import identify, load_material
from feltmb.fiber import CompressionData, fit, law, read_compression
from unmodeled.errors import DataError, ModelError

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


@pytest.mark.parametrize(
    "area",
    ["4 cm2", *(pytest.param(a, marks=pytest.mark.slow) for a in ("4cm^2", "400mm2", "4e-4"))],
)
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
    assert "the data do not determine" in str(got.exception)


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
