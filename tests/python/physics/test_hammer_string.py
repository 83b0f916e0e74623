"""Problem H of the benchmarks, through the public interface, against the reference solutions."""

import numpy as np
import pytest

import feltmb

# rtol, largest errors of hammer position [m], force over peak, end speed [m/s]
BOUNDS = {1e-6: (1e-6, 3e-3, 3e-5), 1e-8: (3e-8, 1e-4, 1e-6)}
STILL = feltmb.ramp_stroke(0.0, duration=0.05)


def errors(data, root, state_of, modes, damping, rtol, **values):
    action = feltmb.load_action(data / "hammer_string.toml").with_values(
        {"string.modes": modes, "string.damping_ratio": damping, **values}
    )
    start = state_of(action, [0.0], [3.0])
    run = feltmb.simulate(action, STILL, rtol=rtol, start=start, output_rate=20000.0)
    path = root / "bench" / "speed" / "reference" / f"ref_N{modes}_xi{damping:g}.csv"
    reference = np.genfromtxt(path, delimiter=",", names=True)
    assert np.allclose(run.time, reference["t"], atol=1e-12)
    return run, (
        np.max(np.abs(run["hammer.x"] - reference["x"])),
        np.max(np.abs(run["contact01.force"] - reference["F"])) / np.max(reference["F"]),
        abs(run["hammer.x.rate"][-1] - reference["v"][-1]),
        np.max(np.abs(run["string.strike"] - reference["xs"])),
    )


@pytest.mark.parametrize("rtol", BOUNDS)
@pytest.mark.parametrize(
    ("modes", "damping"),
    [
        (40, 0.07),
        (40, 7e-4),
        (200, 0.07),
        pytest.param(200, 7e-4, marks=pytest.mark.slow),
    ],
)
def test_against_the_reference(data, root, state_of, modes, damping, rtol):
    run, found = errors(data, root, state_of, modes, damping, rtol)
    for got, bound in zip(found, BOUNDS[rtol], strict=False):
        assert got < bound
    assert found[3] < 3 * BOUNDS[rtol][0]
    start = 0.5 * 9e-3 * 3.0**2
    assert run.energy["residual_largest"] < 100 * rtol * start
    assert run.energy["created_by"] == [] or run.energy["work_throughput"] == 0.0


def test_momentum_and_energy_of_the_strike(data, state_of):
    """Hammer's change of momentum is the impulse; its loss of energy goes into string and felt."""
    action = feltmb.load_action(data / "hammer_string.toml")
    run = feltmb.simulate(
        action, STILL, rtol=1e-9, start=state_of(action, [0.0], [3.0]), output_rate=200e3
    )
    impulse = np.trapezoid(run["contact01.force"], run.time)
    change = 9e-3 * (3.0 - run["hammer.x.rate"][-1])
    assert impulse == pytest.approx(change, rel=1e-5)
    lost = 0.5 * 9e-3 * (9.0 - run["hammer.x.rate"][-1] ** 2)
    gone = run.energy["dissipated_total"] + run.energy["elastic_parts"]["string"]
    assert gone == pytest.approx(lost, rel=1e-6)
    assert run.summary["impact_speed"] == pytest.approx(3.0, rel=1e-8)
    assert run.summary["rebound_speed"] == pytest.approx(-run["hammer.x.rate"][-1], rel=1e-6)


def test_struck_string_rings_at_its_partials(data, state_of):
    """Spectrum of the bridge force after the hammer has left: exact partials, light damping."""
    action = feltmb.load_action(data / "hammer_string.toml").with_values(
        {"string.modes": 12, "string.damping_ratio": 1e-4}
    )
    run = feltmb.simulate(
        action, STILL, duration=1.0, rtol=1e-6, start=state_of(action, [0.0], [3.0]),
        output_rate=20000.0, max_order=2, ledger=False,
    )  # fmt: skip
    after = run.time > 0.1
    signal = run["string.bridge_force"][after] * np.hanning(after.sum())
    spectrum = np.abs(np.fft.rfft(signal, 8 * len(signal)))
    frequency = np.fft.rfftfreq(8 * len(signal), 1.0 / 20000.0)
    string = run._string()
    for exact in string.angular_frequency[:6] / (2.0 * np.pi):
        near = np.abs(frequency - exact) < 30.0
        peak = frequency[near][np.argmax(spectrum[near])]
        assert peak == pytest.approx(exact, abs=0.7)
