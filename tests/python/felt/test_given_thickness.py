"""A given thickness of a felt: shared by both branches, contradicted by the data, impossible."""

import math

import numpy as np
import pytest
from click.testing import CliRunner

from feltmb.cli import cli
from feltmb.felt import identify, load_material
from feltmb.fiber import (
    CompressionData,
    compare,
    fit,
    fit_branches,
    law,
    read_compression,
)
from unmodeled.errors import DataError

FELT = load_material("synthetic_soft_red")


THICK = 6e-3


def a_test(*, thickness0=None, noise=0.002, seed=0, known=THICK):
    """Loop of a law of 6 mm, under load at the first sample; its two branches differ."""
    rng = np.random.default_rng(seed)
    v = np.linspace(1.15, 2.6, 40) * FELT.v_f0
    up = law("binomial", K_p=2.6e6, gamma=1.57, v_f0=FELT.v_f0).pressure(v)
    down = law("binomial", K_p=1.3e6, gamma=1.9, v_f0=FELT.v_f0).pressure(v)
    p = np.concatenate([up, down[::-1]]) + noise * up.max() * rng.normal(size=80)
    height = FELT.v_f0 * known / np.concatenate([v, v[::-1]])
    data = CompressionData(
        FELT.v_f0 * height.max() / height, p, np.arange(80) < 40, FELT.v_f0, "test", height, False
    )
    return data if thickness0 is None else data.with_thickness(thickness0)


def written(tmp_path):
    data = a_test()
    rows = [f"{1e3 * h:.6f},{p:.3f}" for h, p in zip(data.thickness, data.pressure, strict=True)]
    path = tmp_path / "test.csv"
    path.write_text("thickness [mm],pressure [Pa]\n" + "\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize(
    ("thickness", "message"),
    [
        (80e-3, r"thickness 80 mm without load.*fibers would fill .* expected at most"),
        (1e-3, r"thickness 1 mm without load, but the test carries .*expected more than"),
        (0.0, r"thickness0 = 0 m, expected > 0"),
    ],
)
def test_a_thickness_that_cannot_be_is_refused_as_a_thickness(tmp_path, thickness, message):
    with pytest.raises(DataError, match=message) as told:
        read_compression(written(tmp_path), v_f0=FELT.v_f0, thickness0=thickness)
    assert "v_f from" not in str(told.value)
    if thickness:
        with pytest.raises(DataError, match=message):
            a_test().with_thickness(thickness)


def test_one_thickness_of_both_branches():
    load, back = fit_branches(a_test(), "binomial", n_starts=3)
    assert load.values["thickness0"] == back.values["thickness0"]
    assert load.interval["thickness0"] == back.interval["thickness0"]
    low, high = load.interval["thickness0"]
    assert low < THICK < high
    assert load.values["K_p"] == pytest.approx(2.6e6, rel=0.2)
    assert back.values["K_p"] == pytest.approx(1.3e6, rel=0.2)
    # Two branches know more than one.
    alone = [fit(a_test(), "binomial", branch=b, n_starts=3) for b in ("loading", "unloading")]
    assert alone[0].values["thickness0"] != alone[1].values["thickness0"]
    for one in alone:
        bottom, top = one.interval["thickness0"]
        assert math.log(high / low) < math.log(top / bottom)
    assert "from all branches" in load.warnings[0]
    ranked = compare(a_test(), ["van_wyk", "binomial"], branch="each", n_starts=2)
    assert [(f.branch, f.model) for f in ranked[::2]] == [
        ("loading", "binomial"), ("unloading", "binomial"),
    ]  # fmt: skip


def test_intervals_of_a_shared_thickness_hold_what_they_say():
    held = 0
    for seed in range(25):
        f = fit_branches(a_test(seed=seed, noise=0.005), "binomial", n_starts=1)[0]
        low, high = f.interval["thickness0"]
        held += low <= THICK <= high
    assert held >= 19  # 95 %: fewer of 25 in 1 of 1000 sets


def test_without_an_unknown_thickness_branches_are_apart():
    data = a_test(thickness0=THICK)
    both = fit_branches(data, "binomial", n_starts=2)
    for got in both:
        own = fit(data, "binomial", branch=got.branch, n_starts=2)
        assert got.values == own.values
        assert got.interval == own.interval


@pytest.mark.parametrize("given", [THICK, 8e-3])
def test_a_thickness_that_the_data_contradict_is_told(given):
    data = a_test(thickness0=given)
    told = [f.warnings for f in fit_branches(data, "binomial", n_starts=3)]
    said = [any("do not agree with the test" in w for w in warnings) for warnings in told]
    assert said == [given != THICK] * 2
    if given != THICK:
        assert "8 mm that was given" in told[0][0]
        assert "asks for 6." in told[0][0] or "asks for 5.9" in told[0][0]


def a_loop(thickness0):
    v = np.linspace(1.05 * FELT.v_f0, 0.999 * FELT.end, 40)
    p = np.concatenate([FELT.pressure("loading", v), FELT.pressure("unloading", v)[::-1]])
    p += 0.002 * p.max() * np.random.default_rng(0).normal(size=80)
    v = np.concatenate([v, v[::-1]])
    height = FELT.v_f0 * THICK / v
    data = CompressionData(v, p, np.arange(80) < 40, FELT.v_f0, "test", height, False)
    return data.with_thickness(thickness0)


@pytest.mark.parametrize("given", [THICK, 8e-3])
def test_identify_tells_a_contradicted_thickness(given):
    found = identify(a_loop(given), material=FELT)
    said = any("does not agree with the loading branch" in w for w in found.warnings)
    assert said == (given != THICK)
    assert found.thickness == pytest.approx(given)
    assert f"unloaded thickness [mm], as given | {1e3 * given:g}" in found.report()


def test_a_given_thickness_is_printed_as_an_assumption(tmp_path):
    asked = ["fiber", "fit", str(written(tmp_path)), "--v-f0", str(FELT.v_f0), "--starts", "2"]
    got = CliRunner().invoke(cli, [*asked, "--thickness", "6mm"])
    assert got.exit_code == 0, got.output
    assert "unloaded thickness: 6 mm, as given" in got.output
    assert "do not agree" not in got.output
    got = CliRunner().invoke(cli, [*asked, "--thickness", "8mm"])
    assert "8 mm that was given" in " ".join(got.output.split())  # it is folded
    got = CliRunner().invoke(cli, asked)
    assert "as given" not in got.output
    assert got.output.count("was not given") == 1  # of one sample, told once
