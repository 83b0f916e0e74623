"""The packaged strokes against stored numbers; see README.md of this folder."""

import golden
import numpy as np
import pytest

pytestmark = pytest.mark.regression
HINT = "if the change is meant: python tools/make_goldens.py --reason '...'"


@pytest.fixture(scope="module", params=golden.DURATION)
def case(request):
    return request.param, golden.simulate(request.param)


def test_signals(case):
    name, run = case
    stored, record = golden.load(name)
    assert set(stored) == {"time", *golden.SIGNALS}
    assert np.allclose(run.time, stored["time"], rtol=0.0, atol=1e-12)
    for signal in golden.SIGNALS:
        bad = golden.series_errors(run.time, run[signal], stored[signal])
        if bad.size:
            i = bad[np.argmax(np.abs(run[signal] - stored[signal])[bad])]
            pytest.fail(
                f"{name}: {signal} differs at {bad.size} of {len(run.time)} samples, most at "
                f"{run.time[i]:.6g} s: got {run[signal][i]:.9g}, stored {stored[signal][i]:.9g} "
                f"{run.unit(signal)}; stored {record['date']} ({record['reason']}), data set "
                f"{'the same' if record['hash'] == run.provenance['hash'] else 'changed'}; {HINT}"
            )


def test_summary(case):
    name, run = case
    _, record = golden.load(name)
    assert run.summary.keys() == record["summary"].keys(), HINT
    for key, want in record["summary"].items():
        room = golden.LOOSER.get(key, 1e-6) * abs(want) + 1e-9
        assert abs(run.summary[key] - want) <= room, f"{name}: {key}; {HINT}"


def test_record_says_how_it_was_made(case):
    name, _ = case
    _, record = golden.load(name)
    for key in ("reason", "date", "command", "version", "commit", "hash", "stroke", "options"):
        assert record[key], key
    assert record["options"]["rtol"] == golden.RTOL


def test_a_missing_golden_fails(monkeypatch, tmp_path):
    monkeypatch.setattr(golden, "FOLDER", tmp_path)
    with pytest.raises(FileNotFoundError):
        golden.load("piano")


# --- the comparison itself ----------------------------------------------------------------------

TIME = np.linspace(0.0, 0.01, 1001)
PULSE = np.where(TIME > 0.005, 20.0 * np.exp(-(((TIME - 0.006) / 4e-4) ** 2)), 0.0)


def test_equal_and_nearly_equal_series_pass():
    assert golden.series_errors(TIME, PULSE, PULSE).size == 0
    assert golden.series_errors(TIME, PULSE + 1e-5, PULSE).size == 0
    assert golden.series_errors(TIME, PULSE * (1.0 + 5e-7), PULSE).size == 0


def test_a_shift_in_time_passes_up_to_a_microsecond():
    def moved(delay):
        return np.interp(TIME - delay, TIME, PULSE)

    assert np.max(np.abs(moved(5e-7) - PULSE)) > 1e-3 * np.max(PULSE)
    assert golden.series_errors(TIME, moved(5e-7), PULSE).size == 0
    assert golden.series_errors(TIME, moved(1e-5), PULSE).size > 0


def test_real_differences_are_found():
    for other in (PULSE * 1.001, PULSE + 1e-3, np.roll(PULSE, 3), np.full_like(PULSE, np.nan)):
        assert golden.series_errors(TIME, other, PULSE).size > 0
