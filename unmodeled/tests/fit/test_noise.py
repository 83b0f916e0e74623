"""Noise of a sensor: its standard deviation at each sample, and random noise with its color."""

import numpy as np
import pytest

from unmodeled.data import Record, Sensor
from unmodeled.fit.noise import Noise, noise_of, sd_of_knots


@pytest.mark.parametrize(
    "noise", [Noise(0.3), Noise(0.3, correlation_time=4e-3), Noise(0.3, 4e-3, white=0.4)]
)
def test_drawn_noise_has_its_deviation_and_correlation(noise):
    time = 1e-3 * np.arange(20_000)
    drawn = noise.draw(time, np.random.default_rng(7))
    assert np.std(drawn) == pytest.approx(0.3, rel=0.05)
    lag = 2
    correlation = float(np.mean(drawn[lag:] * drawn[:-lag]) / np.mean(drawn**2))
    expected = 0.0
    if noise.correlation_time:
        expected = (1.0 - noise.white) * np.exp(-lag * 1e-3 / noise.correlation_time)
    assert correlation == pytest.approx(expected, abs=0.05)
    first = [noise.draw(time[:1], np.random.default_rng(s))[0] for s in range(400)]
    assert np.std(first) == pytest.approx(0.3, rel=0.15)


def test_the_standard_deviation_follows_the_value_and_not_its_noise():
    time = np.linspace(0.0, 1.0, 2000)
    value = 1.0 + 4.0 * time**2
    noise = Noise(0.01, relative=0.1)
    seen = value + noise.draw(time, np.random.default_rng(1), value)
    assert (seen - value).std() == pytest.approx(np.sqrt(np.mean(noise.sd(value) ** 2)), rel=0.05)
    error = noise.sd_of_measured(time, seen) / noise.sd(value) - 1.0
    assert error.std() < 0.08
    away = (seen - value) / noise.sd(value)
    assert abs(np.corrcoef(error, away)[0, 1]) < 0.06  # of the measured value itself: 1


def test_where_neighbors_disagree_the_noise_is_not_too_small():
    noise = Noise(0.01, relative=0.1)
    time = np.arange(40.0)
    step = np.where(time < 20.0, 0.0, 5.0)
    found = noise.sd_of_measured(time, step)
    assert np.all(found > 0.75 * noise.sd(step))
    assert found[:16] == pytest.approx(noise.sd(step)[:16])
    assert found[24:] == pytest.approx(noise.sd(step)[24:])
    alternating = np.where(time % 2 == 0, 0.0, 5.0)
    assert np.all(noise.sd_of_measured(time, alternating) >= 0.999 * noise.sd(alternating))


def test_few_and_missing_samples():
    noise = Noise(0.01, relative=0.1)
    time = np.arange(4.0)
    few = np.array([1.0, 7.0, np.nan, 3.0])
    assert noise.sd_of_measured(time, few)[[0, 1, 3]] == pytest.approx(noise.sd(few[[0, 1, 3]]))
    assert noise.sd_of_measured(time, np.full(4, np.nan)) == pytest.approx(0.01)


@pytest.mark.parametrize(("tau", "spacing"), [(0.0, 0.02), (0.003, 0.02), (0.0, 1e-4)])
def test_the_noise_of_knots_has_the_integral_of_the_noise_of_samples(tau, spacing):
    """White noise s at samples h apart is s sqrt(h / D) at knots D apart, and at most s."""
    time = np.arange(400) * 1e-3
    one = Record(
        name="r",
        time=time,
        inputs={"f": 0.0 * time},
        outputs={"y": 0.0 * time},
        input_sigma={"f": 0.3},
        input_correlation_time={"f": tau} if tau else {},
    )
    expected = 0.3 * min(1.0, np.sqrt((1e-3 + 2.0 * tau) / max(spacing, 1e-3)))
    assert float(sd_of_knots(one, "f", spacing)) == pytest.approx(expected)


def test_the_parts_of_a_sensor_are_added_and_rounding_is_removed():
    sensor = Sensor(name="y", sigma=0.3, correlation_time=0.01, colored_sigma=0.4)
    noise = noise_of(sensor, 0.3, 0.12)
    rounding = 0.12**2 / 12.0
    assert noise.sigma**2 == pytest.approx(0.09 + 0.16 + rounding)
    assert noise.white * noise.sigma**2 == pytest.approx(0.09 + rounding)
    plain = noise.without_rounding(0.12)
    assert plain.sigma == pytest.approx(0.5)
    assert plain.white == pytest.approx(0.36)
