"""Long records are thinned as far as what moves is shown by lines between the samples."""

import numpy as np
import pytest

from unmodeled import Record, Sensor, Simulator
from unmodeled.data.thinning import MOST_SAMPLES, thinned
from unmodeled.search.records import ready_records

TIME = np.linspace(0.0, 60.0, 20 * MOST_SAMPLES)
NOISE = 1e-3 * np.random.default_rng(0).standard_normal(TIME.size)


def record(u, x, **fields):
    sensors = {"x": Sensor(name="x", unit="m", **fields)}
    return Record(name="a", time=TIME, inputs={"u": u}, outputs={"x": x}, sensors=sensors)


def test_a_slow_motion_is_thinned_to_the_limit_and_told():
    u, x = np.sin(5.0 * TIME) + NOISE, np.cos(3.0 * TIME) + NOISE
    ((found,), notes) = thinned([record(u, x)], ["x"])
    assert found.samples == MOST_SAMPLES
    np.testing.assert_array_equal(found.time, TIME[::20])
    np.testing.assert_array_equal(found.outputs["x"], x[::20])
    # Noise of independent samples: the rms of a triangular mean over 2 x 20 intervals.
    left = np.std(found.inputs["u"][1:-1] - np.sin(5.0 * TIME[::20])[1:-1])
    assert left == pytest.approx(1e-3 * np.sqrt(801 / 24_000), rel=0.02)
    assert notes == [
        "record a: every 20th of 600000 samples is used, because a line between them shows all "
        "that moves; inputs are averaged"
    ]
    model = Simulator(lambda t, u, p: {"x": p["g"] * u["u"]}, parameters={"g": (1.0, 0.1, "m")})
    ready = ready_records(model, [record(u, x)])
    assert ready.records[0].samples == MOST_SAMPLES
    assert notes[0] in ready.notes


def test_pulses_keep_their_integral():
    u = (TIME % 2.0 < 0.5).astype(float)
    ((found,), _) = thinned([record(u, np.cos(TIME))], ["x"])
    assert found.samples < TIME.size
    assert np.trapezoid(found.inputs["u"], found.time) == pytest.approx(
        np.trapezoid(u, TIME), abs=1e-4
    )


@pytest.mark.parametrize(
    ("u", "x", "samples"),
    [
        (np.sin(TIME), np.cos(400.0 * TIME), TIME.size // 5),  # 63 Hz
        (np.where(np.arange(TIME.size) % 7, np.sin(TIME), 0.5), np.cos(TIME), TIME.size),
    ],
)
def test_what_moves_fast_is_not_thinned_away(u, x, samples):
    ((found,), notes) = thinned([record(u, x, sigma=1e-3)], ["x"])
    assert found.samples == samples
    assert any("move too fast to be thinned further" in n for n in notes)


def test_short_records_stay_and_missing_values_are_no_motion():
    u, x = np.sin(TIME), np.cos(TIME)
    short = record(u, x).cut(0, 20_000)
    assert thinned([short], ["x"]) == ((short,), [])
    x[1000:1100] = np.nan
    ((found,), _) = thinned([record(u, x)], ["x"])
    assert found.samples == MOST_SAMPLES
