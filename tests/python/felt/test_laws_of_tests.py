"""Laws with few parameters: loading only, several specimens, relaxation, speeds; KES, density."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from feltmb import load_action
from feltmb.cli.felt import command
from feltmb.contact import law
from feltmb.felt import Specimen, bulk, fit_law, measured_loop, pool, read_specimen
from unmodeled.errors import DataError, InvalidParameter

BENCH = Path(__file__).resolve().parents[3] / "bench" / "felt_laws.py"
SPEC = importlib.util.spec_from_file_location("felt_laws", BENCH)
BENCH = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(BENCH)
TOP, POWER, STULOV = BENCH.TOP, BENCH.POWER, BENCH.STULOV
loading = BENCH.loading


@pytest.mark.slow
@pytest.mark.parametrize("case", [*BENCH.CASES])
def test_intervals_of_laws_contain_the_truth(case):
    shares = BENCH.coverage(case, 40)
    assert min(shares.values()) >= 0.85
    assert np.mean(list(shares.values())) >= 0.9


@pytest.mark.parametrize("name", ["power", "van_wyk"])
def test_a_law_of_loading_comes_back(name):
    true = BENCH.VAN_WYK if name == "van_wyk" else POWER
    found = fit_law(loading(1, van_wyk=name == "van_wyk"), name)
    assert found.undetermined == ()
    assert found.values["exponent"] == pytest.approx(true["exponent"], rel=0.03)
    inside = [low <= true[key] <= high for key, (low, high) in found.interval.items()]
    assert np.mean(inside) > 0.7


def test_van_wyk_with_his_exponent_and_a_given_thickness():
    test = loading(0, van_wyk=True)
    third = fit_law(test, "van_wyk_3")
    assert third.values["exponent"] == 3.0
    assert third.relative > 5.0 * fit_law(test, "van_wyk").relative
    known = fit_law(test, "van_wyk", thickness=1.5e-3)
    assert "thickness" not in known.interval
    assert known.values["exponent"] == pytest.approx(4.2, rel=0.01)


def test_an_exponential_has_no_thickness_by_van_wyk():
    e = np.linspace(0.0, TOP, 300)
    found = fit_law(Specimen("cotton", e, 1e-3 * np.expm1(8e3 * e), zero=0.0), "van_wyk")
    assert "thickness" in found.undetermined
    assert any("end of its range" in text for text in found.warnings)
    third = fit_law(Specimen("cotton", e, 1e-3 * np.expm1(8e3 * e), zero=0.0), "van_wyk_3")
    assert any("van_wyk_3 does not follow the test" in text for text in third.warnings)


@pytest.mark.parametrize("zero", [None, 0.0])
def test_a_felt_is_not_compressed_by_more_than_its_thickness(zero):
    e = np.linspace(0.0, TOP, 300)
    test = Specimen("yarn", e, 1e-3 * np.expm1(8e3 * e), zero=zero)
    for name in ("van_wyk", "van_wyk_3"):
        with pytest.raises(DataError, match=r"compressed by .* and thickness = 0\.4 mm"):
            fit_law(test, name, thickness=0.4e-3)
    assert fit_law(test, "van_wyk_3", thickness=2.0 * TOP).values["thickness"] == 2.0 * TOP


def pressed(force, seed=5, n=200):
    """A loading with 0.4 mm of free approach, and noise of 0.2 % of the largest force."""
    x = np.linspace(0.0, 1.5e-3, n)
    f = force(np.maximum(x - 0.4e-3, 0.0))
    noise = 2e-3 * f.max() * np.random.default_rng(seed).standard_normal(n)
    return x, f + noise, f.max()


def a_power(e):
    return 4.0e8 * e**2.7


def test_a_saturated_load_cell_is_refused_for_loading_only_too():
    x, force, top = pressed(a_power)
    force = np.minimum(force, 0.75 * top)
    for law_of in ("power", "exponential", "van_wyk"):
        with pytest.raises(DataError, match=r"sat: the force stays at 3\.0.* load cell is at its"):
            fit_law(Specimen("sat", x, force), law_of)
    with pytest.raises(InvalidParameter, match="load cell is at its limit"):
        measured_loop(x, force, loss=0.2)


def test_the_drift_of_a_load_cell_is_subtracted_from_loading_only_too():
    """2 % of the largest force along the test; a power of 2.7 from 0.4 mm on."""
    x, force, top = pressed(a_power)
    clean = fit_law(Specimen("clean", x, force))
    assert clean.warnings == ()
    force = force + 0.02 * top * np.linspace(0.0, 1.0, x.size)
    time = np.linspace(0.0, 60.0, x.size)
    found = fit_law(Specimen("drift", x, force, time))
    assert any("the load cell drifts by 0.0" in text for text in found.warnings)
    low, high = found.interval["exponent"]
    assert low < 2.7 < high < low + 0.15
    assert found.interval["zero"][0] < 0.4e-3 < found.interval["zero"][1]
    loop = measured_loop(x, force, loss=0.2)
    assert loop.zero == pytest.approx(0.4e-3, abs=0.03e-3)
    assert float(np.interp(0.5e-3, loop.envelope.compression, loop.envelope.loading)) == (
        pytest.approx(a_power(0.5e-3), abs=0.03)
    )
    assert any("the load cell drifts by" in text for text in loop.notes)


def test_the_law_of_eq_4_21_comes_back_and_others_have_no_interval():
    x, force, _ = pressed(lambda e: 5.52e3 * e * np.exp(1.58e3 * e) - 0.6e3 * e)
    test = Specimen("e421", x, force)
    found = fit_law(test, "exponential")
    assert found.warnings == ()
    for key, true in {"a": 5.52e3, "b": 1.58e3, "c": -0.6e3, "zero": 0.4e-3}.items():
        assert found.interval[key][0] < true < found.interval[key][1]
    assert found.interval["b"][1] < 1.05 * found.interval["b"][0]
    other = fit_law(test)
    assert other.interval == {}
    assert other.undetermined == ("stiffness", "exponent", "zero")
    assert any("14.1 times the noise" in text for text in other.warnings)
    both = pool(
        [test, Specimen("again", *pressed(lambda e: a_power(e) * 9.0, 6)[:2])], "exponential"
    )
    assert both.interval["c"][0] < both.values["c"] < both.interval["c"][1]


@pytest.mark.parametrize("seed", range(3))
def test_a_free_approach_without_drift_shows_none(seed):
    x, force, _ = pressed(lambda e: 30.0 * e + 4.0e8 * e**2.7, seed)
    assert fit_law(Specimen("free", x, force)).warnings == ()


def test_specimens_are_pooled_with_the_scatter_between_them():
    """Gains of 10 % between specimens, with noise that is much less."""
    gains = 1.0 + 0.1 * np.random.default_rng(3).standard_normal(6)
    tests = [loading(k, gain=g) for k, g in enumerate(gains)]
    found = pool(tests)
    assert found.values["exponent"] == pytest.approx(2.6, rel=0.01)
    share = found.scatter / found.force
    assert share == pytest.approx(np.std(gains, ddof=1) / np.mean(gains), rel=0.15)
    low, high = found.interval["stiffness"]
    assert low < POWER["stiffness"] < high
    assert set(found.values) == {"stiffness", "exponent"}
    with pytest.raises(InvalidParameter, match="expected at least 2"):
        pool(tests[:1])


def relaxing(ramp=2.0, noise=0.01):
    """25 N by 2e8 e^2.3 with branches of 20 % (0.5 s) and 10 % (20 s), held for 100 s."""
    t = np.concatenate([np.arange(0.0, ramp, 0.01 * ramp), ramp + np.arange(0.0, 100.0, 0.1)])
    e = np.minimum(t / ramp, 1.0) * TOP
    felt = 2e8 * e**2.3
    force = felt.copy()
    for share, time in ((0.2, 0.5), (0.1, 20.0)):
        branch = 0.0
        for i in range(1, t.size):
            step = t[i] - t[i - 1]
            decay = np.exp(-step / time)
            branch = branch * decay + share * (felt[i] - felt[i - 1]) / step * time * (1.0 - decay)
            force[i] += branch
    return Specimen("hold", e, force + noise * np.random.default_rng(0).standard_normal(t.size), t)


def test_maxwell_branches_of_a_hold_are_those_of_a_sudden_compression():
    """A part of the fast branch relaxes during the ramp of 2 s."""
    found = fit_law(relaxing(), "maxwell")
    assert found.values["share_1"] == pytest.approx(0.2, rel=0.03)
    assert found.values["time_1"] == pytest.approx(0.5, rel=0.03)
    assert found.values["share_2"] == pytest.approx(0.1, rel=0.03)
    assert found.values["time_2"] == pytest.approx(20.0, rel=0.03)
    assert found.entry["memory"]["rate_time"] == found.values["time_1"]
    assert found.warnings == ()
    test = relaxing()
    short = test.time < 12.0
    cut = Specimen("short", test.displacement[short], test.force[short], test.time[short])
    assert any("did not come to rest" in text for text in fit_law(cut, "maxwell").warnings)
    with pytest.raises(DataError, match="no column of time"):
        fit_law(Specimen("x", test.displacement, test.force), "maxwell")


def cycles(speeds, n=60):
    """Compression and time of cycles at some speeds [m/s]."""
    up = np.linspace(0.0, TOP, n)
    x = np.concatenate([np.concatenate([up, up[::-1][1:]]) for _ in speeds])
    steps = [np.full(2 * n - 1, TOP / (n - 1) / s) for s in speeds]
    return x, np.cumsum(np.concatenate(steps))


def test_stulov_is_fitted_from_cycles_of_several_speeds():
    found = fit_law(BENCH.speeds(0), "stulov")
    for key, true in STULOV.items():
        assert found.values[key] == pytest.approx(true, rel=0.05)
    assert found.undetermined == ()
    assert found.warnings == ()
    assert found.rms == pytest.approx(0.02, rel=0.1)
    one = cycles([1e-3])
    force = law("stulov", **STULOV).path(*one)
    warned = fit_law(Specimen("one", one[0], force, one[1], 0.0), "stulov").warnings
    assert any("about the same speed" in text for text in warned)


def test_the_rate_of_a_felt_with_memory_is_within_its_interval():
    x, t = cycles([1e-4, 1e-3, 1e-2])
    up = np.linspace(0.0, TOP, 100)
    table = up, 2e8 * up**2.3, 2e8 * up**2.3 * (up / TOP) ** 1.6
    felt = law("felt_memory", envelope=table, rate_amplitude=0.25, rate_time=0.5)
    force = felt.path(x, t) + 0.02 * np.random.default_rng(0).standard_normal(x.size)
    found = fit_law(Specimen("speeds", x, force, t, 0.0), "rate")
    for key, true in (("rate_amplitude", 0.25), ("rate_time", 0.5)):
        low, high = found.interval[key]
        assert low < true < high < 10.0 * low
    assert found.entry["memory"]["rate_time"] == found.values["rate_time"]


def test_a_felt_without_rate_has_no_amplitude():
    x, t = cycles([1e-4, 1e-2], n=40)
    up = np.linspace(0.0, TOP, 100)
    table = up, 2e8 * up**2.3, 2e8 * up**2.3 * (up / TOP) ** 1.6
    force = law("felt_memory", envelope=table).path(x, t)
    force += 0.02 * np.random.default_rng(0).standard_normal(x.size)
    found = fit_law(Specimen("speeds", x, force, t, 0.0), "rate")
    assert found.undetermined or found.values["rate_amplitude"] < 0.01


def test_a_loop_of_loading_only_has_the_loss_that_is_given():
    test = loading(0)
    with pytest.raises(InvalidParameter, match="of a test of loading only, give the loss"):
        measured_loop(test.displacement, test.force)
    for loss in (0.0, 0.3):
        found = measured_loop(test.displacement, test.force, loss=loss)
        assert found.envelope.loss == pytest.approx(loss, abs=2e-3)
        assert found.uncertainty.loss == 0.0
        assert any(f"the loss of {100 * loss:g} % is an assumption" in n for n in found.notes)
        assert found.envelope.loading[-1] == pytest.approx(5.0, rel=1e-3)
    x = np.concatenate([test.displacement, test.displacement[::-1][1:]])
    force = np.concatenate([test.force, test.force[::-1][1:] * 0.8])
    with pytest.raises(InvalidParameter, match="the test has unloading"):
        measured_loop(x, force, loss=0.3)


def test_values_of_makers():
    """KES of power laws, and the loss factor of a linear solid over the same cycle."""
    up = np.linspace(0.0, TOP, 200)
    force = 5.0 * np.concatenate([(up / TOP) ** 2, (up[::-1][1:] / TOP) ** 3])
    found = measured_loop(np.concatenate([up, up[::-1][1:]]), force, zero=0.0)
    kes = found.kawabata(2e-4)
    assert kes["WC"] == pytest.approx(5.0 * TOP / 3.0 / 2e-4, rel=1e-3)
    assert kes["LC"] == pytest.approx(2.0 / 3.0, rel=1e-3)
    assert kes["RC"] == pytest.approx(0.75, abs=1e-3)
    assert kes["pressure"] == pytest.approx(2.5e4, rel=1e-3)
    angle = np.linspace(0.0, 2.0 * np.pi, 801)
    x, rate = 0.5 * TOP * (1.0 - np.cos(angle)), 0.5 * TOP * np.sin(angle)
    for factor in (0.1, 0.4):  # 1 N/mm and a phase whose tangent is the factor
        force = 1e3 * (x + factor * rate)
        rise = x[:401], force[:401]
        lost = np.trapezoid(force, x) / np.trapezoid(rise[1], rise[0])
        assert 4.0 * lost / (np.pi * (2.0 - lost)) == pytest.approx(factor, rel=1e-3)
    lost = found.loss
    assert found.loss_factor == pytest.approx(4.0 * lost / (np.pi * (2.0 - lost)))


def test_density_weight_porosity_and_fineness():
    made = bulk(density=200.0, thickness=6e-3, fineness=6e-7)
    assert made["v_f"] == pytest.approx(200.0 / 1310.0)
    assert made["porosity"] == pytest.approx(1.0 - made["v_f"])
    assert made["area_weight"] == pytest.approx(1.2)
    assert 0.25 * np.pi * made["diameter"] ** 2 * 1310.0 == pytest.approx(6e-7)
    again = bulk(area_weight=1.2, thickness=6e-3, diameter=made["diameter"])
    assert again == pytest.approx(made)
    assert bulk(porosity=made["porosity"])["density"] == pytest.approx(200.0)
    with pytest.raises(InvalidParameter, match=r"(?s)density = -1.*expected one of v_f, density"):
        bulk(density=-1.0, v_f=0.2)
    with pytest.raises(InvalidParameter, match="would fill 152"):
        bulk(density=2000.0)


def run(*arguments):
    result = CliRunner().invoke(command, [str(a) for a in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def test_the_commands(tmp_path):
    paths = []
    for k in range(3):
        test = loading(k)
        path = tmp_path / f"s{k}.csv"
        rows = zip(1e3 * test.displacement, test.force, strict=True)
        path.write_text("displacement [mm],force [N]\n" + "\n".join(f"{a},{b}" for a, b in rows))
        paths.append(path)
    out = run("law", *paths).output
    assert "all specimens" in out
    assert "Scatter between specimens" in out
    told = json.loads(run("law", paths[0], "--json").output)
    assert told[0]["values"]["exponent"] == pytest.approx(2.6, rel=0.02)
    rows = np.loadtxt(paths[0], delimiter=",", skiprows=1)
    thick = tmp_path / "thick.csv"
    np.savetxt(
        thick,
        rows * [-1.0, 1.0] + [6.0, 0.0],
        "%.7g",
        ",",
        header="thickness [mm],force [N]",
        comments="",
    )
    turned = json.loads(run("law", thick, "--json").output)[0]
    assert turned["values"]["zero"] == pytest.approx(6e-3 - told[0]["values"]["zero"], abs=1e-6)
    assert turned["interval"]["zero"][0] < turned["values"]["zero"] < turned["interval"]["zero"][1]
    with pytest.raises(InvalidParameter, match="expected no --cycle"):
        run("law", thick, "--cycle", "2")
    made = tmp_path / "law.toml"
    run("law", paths[0], "-o", made)
    assert "[hunt_crossley]" in made.read_text()
    by_421 = json.loads(run("law", paths[0], "--law", "exponential", "--json").output)[0]
    assert list(by_421["values"]) == ["a", "b", "c", "zero"]
    with pytest.raises(DataError, match=r"`feltmb felt law` fits a law, and `feltmb felt contact"):
        run("identify", paths[0], "--material", "a12_06", "--area", "1cm2", "--thickness", "6mm")
    assert "KES: WC" in run("contact", paths[0], "--loss", "30%", "--area", "1cm2").output
    mine = tmp_path / "mine.toml"
    run("contact", paths[0], "--loss", "30%", "--contact", "06", "-o", mine)
    assert load_action(mine).config.contacts["06"].law == "felt_memory"
    light = run("bulk", "--area-weight", "100g/m2", "--thickness", "6mm").output
    assert "16.667" in light
    assert "dtex" in run("bulk", "--v-f", "0.2", "--diameter", "25um").output
    assert read_specimen(paths[1]).name == "s1"
