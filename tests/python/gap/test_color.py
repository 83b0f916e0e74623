"""Color of the noise: what records at rest say of it, and how it is taken out."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from blind.bench import Bench
from blind.key_hammer import KeyHammer
from feltmb.data import Record, Sensor
from feltmb.errors import DataError
from feltmb.fit import Effect, Parameter
from feltmb.fit.linear import LinearModel
from feltmb.fit.noise import WHITE, Noise
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import segment_record
from feltmb.fit.solve import FitSettings, fit_problem
from feltmb.gap import Verdict, calibrate, diagnose, fit_model
from feltmb.gap.checks import check_records, without_constant
from feltmb.gap.color import AVERAGES, BLOCK, color_at_rest, still_blocks
from feltmb.gap.refine import tighten

_spec = importlib.util.spec_from_file_location("models", Path(__file__).parent / "models.py")
models = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(models)


def mean_of(count, samples, seed):
    white = np.random.default_rng(seed).standard_normal(samples + count - 1)
    return np.convolve(white, np.ones(count), "valid") / np.sqrt(count)


def forgetting(tau, samples, seed):
    white = np.random.default_rng(seed).standard_normal(samples)
    kept = np.exp(-1.0 / tau)
    out = [white[0]]
    for w in white[1:]:
        out.append(kept * out[-1] + np.sqrt(1.0 - kept**2) * w)
    return np.array(out)


def segmented_of(values, noise):
    n = values.size
    record = Record(
        name="r", time=1e-3 * np.arange(n), inputs={"f": np.zeros(n)}, outputs={"q": values}
    )
    segments = np.array([[0, n - 1]], dtype=np.intp)
    return segment_record(models.NOMINAL, record, {"q": noise}, None, segments)


def covariance(noise, n):
    """Its own formula: the mean of ``averaged`` samples, a share of it white."""
    distance = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    common = (1.0 - WHITE) * np.clip(1.0 - distance / noise.averaged, 0.0, None)
    np.fill_diagonal(common, 1.0)
    return noise.sigma**2 * common


def test_whitening_averaged_noise_gives_the_dense_likelihood_with_holes():
    noise = Noise(0.7, averaged=3)
    values = mean_of(3, noise.reach + 3, 1)
    values[[2, 6]] = np.nan  # as many are left as the filter looks back upon
    segmented = segmented_of(values, noise)
    good = np.isfinite(values)
    white = segmented.whiten(segmented.measured)[0, good, 0]
    cover = covariance(noise, values.size)[np.ix_(good, good)]
    expected = values[good] @ np.linalg.solve(cover, values[good])
    np.testing.assert_allclose(white @ white, expected, rtol=1e-10)
    weights = segmented.weight[0, good, 0]
    np.testing.assert_allclose(
        -2.0 * np.sum(np.log(weights)), np.linalg.slogdet(cover)[1], rtol=1e-10
    )


@pytest.mark.parametrize("averaged", AVERAGES)
def test_a_long_record_of_averaged_noise_becomes_white(averaged):
    noise = Noise(0.7, averaged=averaged)
    n = 120
    segmented = segmented_of(np.zeros(n), noise)
    filtered = segmented.whiten(np.eye(n)[None, :, None, :])[0, :, 0, :]
    left = filtered @ covariance(noise, n) @ filtered.T
    np.testing.assert_allclose(np.diag(left), 1.0, rtol=1e-10)
    inner = left[40:80, 40:80]
    near = np.abs(np.subtract.outer(np.arange(40), np.arange(40)))
    assert np.max(np.abs(inner[(near > 0) & (near <= noise.reach)])) < 0.1
    # A slow signal weighs what it weighs against the noise of its frequency, within a tenth.
    slow = np.cos(2.0 * np.pi * 2.0 * np.arange(n) / n)
    exact = slow @ np.linalg.solve(covariance(noise, n), slow)
    assert np.sum((filtered @ slow) ** 2) == pytest.approx(exact, rel=0.1)


def test_noise_that_no_sheet_states_is_that_of_the_rest_also_if_it_is_averaged():
    """Differences of averaged noise are too small: by 0.49 for a mean over three samples."""
    t = np.arange(8 * BLOCK)
    late = np.maximum(t - 5.5 * BLOCK, 0.0)
    motion = 30.0 * np.sin(0.02 * late**1.5 / np.sqrt(BLOCK))

    def checked(noise):
        records = [
            Record(
                name=f"r{k}", time=5e-4 * t, inputs={}, outputs={"q": motion + noise(t.size, k)},
                sensors={"q": Sensor(name="q", unit="m")},
            )
            for k in range(5)
        ]  # fmt: skip
        return check_records(records)

    for count in (3, 5):
        checks = checked(lambda n, k, m=count: 0.7 * mean_of(m, n, 40 + k))
        (told,) = checks.warnings
        assert f"that of a mean over {count} samples" in told
        assert "Specify sigma" in told
        assert checks.estimated
        for c in checks.channels:
            assert (c.averaged, c.method) == (count, "rest")
            assert c.sigma == pytest.approx(0.7, rel=0.12)
    white = checked(lambda n, k: 0.7 * np.random.default_rng(k).standard_normal(n))
    assert not white.warnings
    assert all(c.averaged == 1 and c.sigma == pytest.approx(0.7, rel=0.12) for c in white.channels)
    # First-order noise is not taken for an average.
    slow = checked(lambda n, k: 0.7 * forgetting(2.0, n, k))
    assert all(c.averaged == 1 for c in slow.channels)


def unstated(motion, noise=0.0):
    """Data checks of five records of a sensor without a data sheet; white noise of size 1."""
    rng = np.random.default_rng(8)
    n = motion(0).size
    records = [
        Record(
            name=f"r{k}", time=1e-3 * np.arange(n), inputs={},
            outputs={"q": motion(k) + noise * rng.standard_normal(n)},
            sensors={"q": Sensor(name="q", unit="m")},
        )
        for k in range(5)
    ]  # fmt: skip
    return check_records(records)


@pytest.mark.parametrize("period", [4, 5, 6, 8, 10, 12, 100])
@pytest.mark.parametrize("size", [3.0, 30.0, 1000.0])
def test_a_motion_without_rest_is_not_taken_for_noise(period, size):
    """Without these conditions, a sine of 8 samples per period and its gap were noise."""
    t = np.arange(1024)
    turn = 2 * np.pi * t / period
    for motion in (
        lambda k: size * np.sin(turn + k),
        lambda k: size * np.sin(turn + k) * np.exp(-t / 1000.0),
        # A vibration beside a large motion: the blocks between are not at rest.
        lambda k: size * np.sin(turn + k) + 1e4 * np.exp(-(((t - 512) / 20.0) ** 2)),
    ):
        for noise in (1.0, 1e-9):
            checks = unstated(motion, noise)
            assert all(c.averaged == 1 for c in checks.channels)
            assert not any("mean over" in w for w in checks.warnings)


def test_noise_of_one_sensor_is_not_smaller_in_records_of_another_rate():
    t = np.arange(8 * BLOCK)
    motion = 30.0 * np.maximum(t / BLOCK - 5.5, 0.0) ** 2

    def made(name, seed, step, count=t.size):
        y = (motion + mean_of(3, t.size, seed))[-count:]
        return Record(
            name=name, time=step * np.arange(count), inputs={}, outputs={"q": y},
            sensors={"q": Sensor(name="q", unit="m")},
        )  # fmt: skip

    few = made("other", 9, 2e-3, 4 * BLOCK)
    checks = check_records([*(made(f"r{k}", k, 1e-3) for k in range(4)), few])
    (told,) = [w for w in checks.warnings if "mean over 3" in w]
    assert told.startswith("q (r0, r1, r2, r3): ")
    sigmas = {c.record: c.sigma for c in checks.channels}
    assert sigmas["other"] == sigmas["r0"] == pytest.approx(1.0, rel=0.15)


def test_simulated_noise_has_the_color_of_its_channel():
    noise = Noise(0.7, averaged=3)
    fit = fit_problem(Problem(models.NOMINAL, (segmented_of(np.zeros(4000), noise),)))
    segmented, linear = fit.problem.segmented_records[0], fit.linears[0]
    rng = np.random.default_rng(3)
    drawn = calibrate._noisy(segmented, np.zeros_like(segmented.measured), linear, rng).measured[
        0, :, 0
    ]
    power = drawn @ drawn
    for lag, wanted in ((1, (1 - WHITE) * 2 / 3), (2, (1 - WHITE) / 3), (3, 0.0), (6, 0.0)):
        assert drawn[lag:] @ drawn[:-lag] / power == pytest.approx(wanted, abs=0.06)
    assert np.std(drawn) == pytest.approx(0.7, rel=0.05)


def at_rest(noise, seed=0, records=5):
    """Rest, then a motion that no parabola is, with noise."""
    t = np.arange(10 * BLOCK)
    moving = np.where(t > 2 * BLOCK + 7, 40.0 * np.sin(0.21 * t) + 0.3 * t, 0.0)
    return [still_blocks(moving + noise(t.size, seed + k), 1.0) for k in range(records)]


def test_the_color_is_found_where_the_machine_rests():
    sheet = Noise(1.0, 1.5e-3)
    found = color_at_rest(at_rest(lambda n, k: mean_of(3, n, k)), 1e-3, sheet)
    assert found == Noise(1.0, 1.5e-3, 3)
    found = color_at_rest(at_rest(lambda n, k: mean_of(5, n, k)), 1e-3, sheet)
    assert found.averaged == 5


@pytest.mark.parametrize(("period", "size"), [(150, 130), (80, 18), (60, 8), (20, 1.0), (16, 1.3)])
def test_a_motion_that_hides_in_the_noise_is_not_its_color(period, size):
    """Every block of these passes for rest; only the fit of a model can tell what they are."""
    t = np.arange(20 * BLOCK)
    for averaged in (1, 2, 3):
        blocks = [
            still_blocks(
                size * np.sin(2 * np.pi * t / period + k) + mean_of(averaged, t.size, k), 1.0
            )
            for k in range(3)
        ]
        assert sum(map(len, blocks)) > 20
        for sheet in (Noise(1.0), Noise(1.0, 1e-3)):
            found = color_at_rest(blocks, 1e-3, sheet)
            assert found == sheet or found.averaged == averaged


def test_colors_at_the_ends_of_the_numbers():
    own = at_rest(lambda n, k: np.random.default_rng(k).standard_normal(n))
    for tau in (0.0, 1e-320, 1e-300, 1e20, 1e100):
        assert color_at_rest(own, 1e-3, Noise(1.0, tau)) == Noise(1.0, tau)


def test_a_rounded_ramp_has_no_color():
    rng = np.random.default_rng(4)
    t = np.arange(20 * BLOCK)
    ramp = np.round(0.05 * t + 0.05 * rng.standard_normal(t.size))
    sensor = Sensor(name="q", sigma=0.05, quantum=1.0)
    record = Record(
        name="r",
        time=1e-3 * t,
        inputs={"f": 0.0 * t},
        outputs={"q": ramp},
        sensors={"q": sensor},
    )
    assert check_records([record]).channels[0].averaged == 1


def test_the_data_sheet_holds_where_rest_does_not_contradict():
    sheet = Noise(1.0, 1.5e-3)
    for seed in range(20):
        own = at_rest(lambda n, k: forgetting(1.5, n, k), 10 * seed)
        assert color_at_rest(own, 1e-3, sheet) == sheet
    few = at_rest(lambda n, k: mean_of(3, n, k), records=2)
    assert sum(map(len, few)) < 5
    assert color_at_rest(few, 1e-3, sheet) == sheet
    assert color_at_rest([], 1e-3, sheet) == sheet


def test_blocks_that_move_or_miss_samples_are_not_quiet():
    values = np.random.default_rng(1).standard_normal(4 * BLOCK)
    assert len(still_blocks(values, 1.0)) == 4
    values[BLOCK + 3] = np.nan
    assert len(still_blocks(values, 1.0)) == 3
    values[2 * BLOCK : 3 * BLOCK] += 30.0 * np.sin(np.arange(BLOCK))
    assert len(still_blocks(values, 1.0)) == 2
    assert len(still_blocks(0.0 * values, 1.0)) == 0  # a step of the digitizer hides the noise
    assert len(still_blocks(values[:10], 1.0)) == 0


def records(noise, *, tau, clock=1.0):
    sensor = Sensor(name="q", sigma=0.01, correlation_time=tau)
    rng = np.random.default_rng(9)
    out = []
    for k in range(4):
        n = 6 * BLOCK
        time = np.cumsum(1e-3 * np.where(rng.random(n) < 0.5, clock, 1.0))
        out.append(
            Record(
                name=f"r{k}",
                time=time,
                inputs={"f": np.zeros(n)},
                outputs={"q": 0.01 * noise(n, k)},
                sensors={"q": sensor},
            )
        )
    return out


def test_the_gates_take_the_color_and_say_so():
    checks = check_records(records(lambda n, k: mean_of(3, n, k), tau=1.5e-3))
    assert {c.averaged for c in checks.channels} == {3}
    assert checks.noise("r2")["q"].averaged == 3
    assert checks.noise("r2")["q"].correlation_time == pytest.approx(1.5e-3)
    assert any(
        "q: at rest its noise is that of a mean over 3 samples" in w for w in checks.warnings
    )
    checks = check_records(records(lambda n, k: forgetting(1.5, n, k), tau=1.5e-3))
    assert {c.averaged for c in checks.channels} == {1}
    assert checks.warnings == ()
    checks = check_records(records(lambda n, k: mean_of(3, n, k), tau=1.5e-3, clock=1.3))
    assert {c.averaged for c in checks.channels} == {1}  # samples at no even distance
    unknown = [
        replace(r, sensors={"q": Sensor(name="q")})
        for r in records(lambda n, k: mean_of(3, n, k), tau=0.0)
    ]
    assert {c.averaged for c in check_records(unknown).channels} == {1}


def test_a_stuck_fit_with_tight_gaps_is_no_unknown_force(tmp_path):
    """Once a segment stayed in a wrong place, which looked like 91 units of log evidence."""
    bench = Bench(tmp_path / "b")
    bench.seal(792, 20261122)
    bench.machine.make_records(bench.folder, None, [791])
    model = KeyHammer()
    own = bench.machine.read_records(bench.folder / "records" / "791.npz")
    checks = check_records(own, model.outputs)
    segmented_records = tuple(
        segment_record(model, r, checks.noise(r.name), None) for r in own if r.role == "fit"
    )
    fit = fit_problem(Problem(model, segmented_records))
    assert fit.explains
    tight = tighten(fit, FitSettings())
    assert tight is not None
    assert tight.log_evidence > fit.log_evidence - 6.0


LINE = LinearModel(
    output="y",
    columns={"slope": lambda r: r.inputs["x"]},
    parameters=[Parameter(name="slope", value=1.0, sd=0.2)],
    name="line",
)
CUBIC = Effect(
    name="cubic", component="spring", scale=0.1, regressor=lambda r, s: r.inputs["x"] ** 3
)


def runs(noise, law=lambda x: x):
    """Four records of a line in noise of which the sensors say that it is white, of 0.01."""
    out = []
    for k in range(4):
        random = np.random.default_rng([7, k])
        x = random.uniform(-1.0, 1.0, 400)
        out.append(
            Record(
                name=f"run {k}",
                time=np.arange(400) * 0.01,
                inputs={"x": x},
                outputs={"y": law(x) + noise(random)},
                sensors={"y": Sensor(name="y", sigma=0.01)},
            )
        )
    return out


def remembered(random):
    """First-order noise of 0.01 that remembers itself for four samples."""
    share = np.exp(-0.25)
    noise = 0.01 * random.standard_normal(400)
    for i in range(1, 400):
        noise[i] = share * noise[i - 1] + np.sqrt(1.0 - share**2) * noise[i]
    return noise


def test_colored_noise_that_is_told_as_white_is_no_gap_and_warned_of():
    report = diagnose(LINE, [CUBIC], runs(remembered))
    assert report.verdict is Verdict.NO_GAP
    (warning,) = report.checks.warnings
    assert "correlation_time" in warning
    assert report.checks.channels[0].correlation_time == pytest.approx(0.04, rel=0.4)


def test_an_effect_is_named_through_such_noise():
    report = diagnose(LINE, [CUBIC], runs(remembered, lambda x: x + 0.1 * x**3))
    assert report.named == ("cubic",)


def test_a_smooth_rest_in_white_noise_is_not_taken_for_its_color():
    # Noise and rest together are as large as the noise that is told.
    def swaying(random):
        wave = np.sin(2.0 * np.pi * np.arange(400) / 80.0 + random.uniform(0.0, 6.0))
        return 0.007 * np.sqrt(2.0) * wave + 0.007 * random.standard_normal(400)

    report = diagnose(LINE, [CUBIC], runs(swaying))
    assert report.verdict is Verdict.UNKNOWN
    assert not report.checks.warnings


@pytest.mark.parametrize(("sigma", "found"), [(0.05, 12.0**-0.5), (0.4, 0.4), (None, None)])
def test_a_grid_of_values_bounds_the_noise_from_below(sigma, found):
    """The grid was seen only where a tenth of the samples stood still."""
    rng = np.random.default_rng(4)
    t = np.arange(600)
    exact = 100.0 * np.sin(0.1 * t) + 0.05 * rng.standard_normal(t.size)
    record = Record(
        name="r",
        time=1e-3 * t,
        inputs={"f": 0.0 * t},
        outputs={"q": 0.3 * np.round(exact)},
        sensors={"q": Sensor(name="q", sigma=None if sigma is None else 0.3 * sigma)},
    )
    checks = check_records([record])
    assert checks.channels[0].quantum == pytest.approx(0.3, rel=1e-9)
    if found is not None:
        assert checks.channels[0].sigma == pytest.approx(0.3 * found, rel=1e-9)
    assert any("rounding error" in w for w in checks.warnings) is (sigma == 0.05)
    free = replace(record, outputs={"q": 0.3 * exact})
    assert check_records([free]).channels[0].quantum == 0.0


@pytest.mark.parametrize("still", ["few steps", "constant"])
def test_a_record_that_hardly_moves_does_not_set_the_noise_of_others(still):
    """One quiet record gave all records of a rounded channel a noise of 1e-9 or less."""
    rng = np.random.default_rng(4)
    t = np.arange(600)
    wave = np.sin(0.03 * t)
    second = np.round(1.2 * wave, 0) if still == "few steps" else 0.0 * wave
    records = [
        Record(name=name, time=1e-3 * t, inputs={}, outputs={"q": 0.01 * values})
        for name, values in (
            ("a", np.round(100.0 * wave + 0.05 * rng.standard_normal(t.size))),
            ("b", second),
        )
    ]
    for order in (records, records[::-1]):
        for channel in check_records(order).channels:
            assert channel.sigma == pytest.approx(0.01 / np.sqrt(12.0), rel=1e-6)


def test_a_straight_line_is_no_grid():
    """A motion of constant speed without noise was taken for rounded values."""
    t = 1e-3 * np.arange(300)
    line = Record(
        name="a", time=t, inputs={}, outputs={"q": 0.3 * t},
        sensors={"q": Sensor(name="q", sigma=1e-6)},
    )  # fmt: skip
    (channel,) = check_records([line]).channels
    assert (channel.quantum, channel.sigma) == (0.0, 1e-6)


def test_a_sensor_with_too_small_a_noise_is_told_once():
    t = np.arange(600)
    rounded = [
        Record(
            name=name, time=1e-3 * t, inputs={}, outputs={"q": np.round(50.0 * np.sin(k * t))},
            sensors={"q": Sensor(name="q", sigma=0.1)},
        )
        for name, k in (("a", 0.1), ("b", 0.13))
    ]  # fmt: skip
    (warning,) = check_records(rounded).warnings
    assert warning.startswith("q: all values are multiples of 1; ")
    assert warning.endswith("(2 records)")


def test_a_channel_that_never_changes_needs_a_sigma():
    """Its noise was "estimated" as 1e-16, and its parameter as known to nine digits."""
    t = 1e-3 * np.arange(300)
    dead = Record(name="a", time=t, inputs={"f": t}, outputs={"q": 0.0 * t + 0.5})
    with pytest.raises(DataError, match="q: never changes, so that its noise cannot be estimated"):
        without_constant([dead], ["q"])
    noise = np.random.default_rng(0).normal(size=300)
    alive = replace(dead, name="b", outputs={"q": noise})
    assert without_constant([dead, alive], ["q"]) == ((dead, alive), ())
    known = replace(dead, sensors={"q": Sensor(name="q", sigma=0.01)})
    assert without_constant([known], ["q"]) == ((known,), ())
    both = replace(dead, outputs={"q": noise, "z": 0.0 * t})
    (kept,), (note,) = without_constant([both], ["q", "z"])
    assert list(kept.outputs) == ["q"]
    assert note.startswith("z: never changes")
    # A channel that the model does not have is nobody's business, and does not replace one.
    assert without_constant([both], ["q"]) == ((both,), ())
    moved = replace(dead, outputs={"q": 0.0 * t, "z": noise})
    with pytest.raises(DataError, match="q: never changes"):
        without_constant([moved], ["q"])


def test_a_constant_channel_that_the_model_does_not_have_changes_no_fit():
    plain = models.records(4)
    data = [
        replace(
            r,
            outputs={**r.outputs, "still": np.full(r.samples, 0.5)},
            sensors={**r.sensors, "still": Sensor(name="still")},
        )
        for r in plain
    ]
    fit = fit_model(models.NOMINAL, data)
    assert fit.cost == pytest.approx(fit_model(models.NOMINAL, plain).cost)
    assert not any("never changes" in n for n in fit.notes)
