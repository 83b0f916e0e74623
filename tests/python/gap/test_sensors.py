"""What a sensor is: white, colored and quantum noise each by its number; sensors of inputs."""

import numpy as np
import pytest

from feltmb.data import Record, Sensor, read_record
from feltmb.errors import DataError
from feltmb.fit.noise import Noise, innovations
from feltmb.gap.checks import check_records

STEP = 1e-3


def whitened(noise, y):
    """Samples with what those before predict taken away, by the spread that is left."""
    position = np.arange(y.size)[None, :, None]
    time = (STEP * np.arange(y.size))[None, :]
    sd = np.full(position.shape, noise.sigma)
    before, factors, weight = innovations([noise], position, time, sd)
    seen = np.where(before[0, :, 0] >= 0, y[np.maximum(before[0, :, 0], 0)], 0.0)
    return (y - np.sum(factors[0, :, 0] * seen, axis=1)) * weight[0, :, 0]


def test_white_colored_and_quantum_are_one_noise():
    sensor = Sensor(name="y", sigma=3.0, colored_sigma=4.0, correlation_time=0.02, quantum=2.0)
    record = Record(
        name="r", time=STEP * np.arange(50), inputs={}, outputs={"y": np.arange(50.0)},
        sensors={"y": sensor},
    )  # fmt: skip
    noise = check_records([record]).noise("r")["y"]
    assert noise.sigma == pytest.approx(np.sqrt(9.0 + 16.0 + 4.0 / 12.0))
    assert noise.white == pytest.approx((9.0 + 4.0 / 12.0) / noise.sigma**2)
    assert noise.correlation_time == 0.02


def test_a_mixture_is_whitened_and_neither_color_alone_does_it():
    rng = np.random.default_rng(3)
    mixed = Noise(2.0, 0.02, white=0.4)
    y = mixed.draw(STEP * np.arange(20000), rng)
    assert np.std(y) == pytest.approx(2.0, rel=0.05)

    def left(noise):
        z = whitened(noise, y)
        near = [np.mean(z[k:] * z[:-k]) / np.mean(z * z) for k in range(1, 10)]
        return float(np.mean(z * z)), float(np.max(np.abs(near)))

    power, correlation = left(mixed)
    assert power == pytest.approx(1.0, abs=0.03)
    assert correlation < 0.03
    assert left(Noise(2.0))[1] > 0.3
    assert left(Noise(2.0, 0.02))[1] > 0.1


def test_colored_noise_needs_its_time_and_the_white_beside_it():
    with pytest.raises(DataError, match="correlation_time"):
        Sensor(name="y", sigma=1.0, colored_sigma=1.0)
    with pytest.raises(DataError, match="sigma"):
        Sensor(name="y", colored_sigma=1.0, correlation_time=1.0)


def shown(u, time, bandwidth):
    """First-order low-pass of a sine, exact."""
    rate = 2.0 * np.pi * bandwidth
    return rate / np.hypot(rate, u) * np.sin(u * time - np.arctan(u / rate))


def test_the_sensor_of_an_input_is_taken_back():
    time = STEP * np.arange(2000)
    low = 2.0 * shown(12.0, time - 0.005, 20.0) + 0.3
    record = Record(
        name="r", time=time, inputs={"u": low}, outputs={"y": time}, input_sigma={"u": 0.01}
    )
    back = record.with_sensed_input("u", delay=0.005, bandwidth=20.0, gain=2.0, offset=0.3)
    middle = slice(20, -20)
    assert back.inputs["u"][middle] == pytest.approx(np.sin(12.0 * time)[middle], abs=1e-3)
    # A slope over two samples: sqrt(1 + 1 / (2 (2 pi 20 Hz 1 ms)^2)) times the noise.
    assert back.input_sigma["u"] == pytest.approx(0.005 * np.sqrt(1 + 0.5 / 0.12566**2), rel=1e-3)
    with pytest.raises(DataError, match="no input"):
        record.with_sensed_input("v", delay=1.0)
    with pytest.raises(DataError, match="bandwidth"):
        record.with_sensed_input("u", bandwidth=0.0)


def test_a_sheet_tells_the_sensor_of_an_input(tmp_path):
    time = STEP * np.arange(400)
    rows = "\n".join(f"{t:.6f},{np.sin(9 * (t - 0.01)):.9f},{t:.6f}" for t in time)
    (tmp_path / "a.csv").write_text("time,force,y\n" + rows)
    (tmp_path / "a.toml").write_text(
        "[inputs.force]\nunit = 'N'\ndelay = 0.01\n[outputs.y]\nunit = 'm'\nsigma = 1e-3\n"
        "colored_sigma = 2e-3\ncorrelation_time = 0.1\n"
    )
    record = read_record(tmp_path / "a.csv")
    assert record.inputs["force"][:-20] == pytest.approx(np.sin(9 * time)[:-20], abs=1e-4)
    assert record.sensors["y"].colored_sigma == 2e-3
