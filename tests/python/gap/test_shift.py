"""Sensors that lag: what a window shows does not depend on where it was cut."""

from dataclasses import replace

import numpy as np
import pytest

from feltmb.data import Record, Sensor
from feltmb.fit.linear import LinearNominal
from feltmb.fit.nominal import Lanes, Parameter
from feltmb.fit.observe import observe_lanes
from feltmb.fit.shift import shifted

SAMPLES = 101


def record(time):
    return Record(
        name="r",
        time=time,
        inputs={"u": np.zeros(time.size)},
        outputs={"y": np.zeros(time.size)},
        sensors={"y": Sensor(name="y", unit="m", sigma=1e-3)},
    )


def motion(t):
    return np.stack([np.sin(7.0 * t), np.cos(5.0 * t)], axis=-1)


def cut(y, windows):
    length = int(np.max(windows[:, 1] - windows[:, 0])) + 1
    out = np.zeros((len(windows), length, y.shape[-1]))
    for b, (i, j) in enumerate(windows):
        out[b, : j - i + 1] = y[i : j + 1]
    return out


@pytest.mark.parametrize("even", [True, False])
@pytest.mark.parametrize("delay", [3e-3, -3e-3, 0.017])
def test_windows_of_one_motion_see_into_one_another(even, delay):
    time = np.linspace(0.0, 1.0, SAMPLES)
    if not even:
        time = time + 0.003 * np.sin(9.0 * time)
    r = record(time)
    windows = np.array([[0, 30], [30, 47], [47, 77], [77, 100]])
    delays = np.full(4, delay)
    whole = shifted(r, motion(time)[None], np.array([[0, 100]]), delays[:1])[0]
    assert np.allclose(whole[3:-3], motion(time - delay)[3:-3], atol=2e-7)
    assert np.allclose(
        whole, motion(time - delay), atol=0.011
    )  # straight from rest beyond the ends
    seen = shifted(r, cut(motion(time), windows), windows, delays)
    assert np.allclose(seen, cut(whole, windows), atol=2e-7)


def test_windows_with_a_gap_keep_to_themselves():
    time = np.linspace(0.0, 1.0, SAMPLES)
    windows = np.array([[0, 50], [50, 100]])
    y = cut(motion(time), windows)
    y[1] += 1.0
    delays = np.full(2, 4e-3)
    seen = shifted(record(time), y, windows, delays)
    want = cut(motion(time - 4e-3), windows)
    want[1] += 1.0
    assert np.allclose(seen, want, atol=5e-5)
    # Lanes of other sizes are not one motion, and none is lost.
    other = shifted(record(time), y, windows, np.array([4e-3, 0.0]))
    assert np.array_equal(other[0], seen[0])
    assert np.array_equal(other[1], y[1])


def test_what_failed_stays_and_two_dimensions_do():
    time = np.linspace(0.0, 1.0, SAMPLES)
    windows = np.array([[0, 50], [50, 100]])
    y = cut(motion(time), windows)
    y[1, 7] = np.nan
    delays = np.full(2, 4e-3)
    seen = shifted(record(time), y, windows, delays)
    assert np.array_equal(seen[1], y[1], equal_nan=True)
    assert np.all(np.isfinite(seen[0]))
    flat = shifted(record(time), y[:, :, 0], windows, delays)
    assert np.array_equal(flat, seen[:, :, 0], equal_nan=True)


def test_a_known_delay_does_not_depend_on_the_windows():
    time = np.linspace(0.0, 1.0, SAMPLES)
    r = record(time)
    r = replace(
        r,
        inputs={"u": motion(time)[:, 0]},
        sensors={"y": replace(r.sensors["y"], delay=0.004)},
    )
    nominal = LinearNominal(
        output="y",
        columns={"slope": lambda record: record.inputs["u"]},
        parameters=[Parameter(name="slope", value=1.0, sd=0.1)],
        name="line",
    )
    windows = np.array([[0, 40], [40, 100]])
    lanes = Lanes.at_point(np.ones(1), windows, np.zeros((2, 0)), (), np.zeros(0))
    seen = observe_lanes(nominal, r, lanes).outputs
    want = motion(time - 0.004)[:, 0]
    assert np.allclose(seen[0, :41, 0], want[:41], atol=5e-5)
    assert np.allclose(seen[1, :61, 0], want[40:], atol=5e-5)
