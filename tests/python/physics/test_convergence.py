"""Results converge with the tolerance and with the number of modes; the bounds are what was found.

Distances from rtol 1e-11, largest over piano, forte, staccato, measured with and without ledger:

    rtol 1e-6: impact time 1.2e-6 s, impact and rebound speed 2.4e-4 m/s, string force 3e-4 N,
               let-off gap 1.5e-6 m, check gap 1.1e-6 m
    rtol 1e-8: impact time 1e-8 s, speeds 1e-6 m/s

Of sixty tolerances from 7e-7 to 1.5e-6 the flexible piano stroke is off by 6e-7 s in the median,
but four to five of them by up to 2.4e-5 s and 3.6e-4 m/s; why these is not known. The bounds leave
room for such a one; medians are held to what is typical.
"""

import numpy as np
import pytest

BOUNDS = {
    "impact_time": 4e-5,  # s
    "impact_speed": 6e-4,  # m/s
    "rebound_speed": 1e-3,  # m/s
    "impact_duration": 2e-6,  # s
    "max_impact_force": 3e-3,  # N
    "let_off_gap": 1e-5,  # m
    "check_gap": 1e-5,  # m
}
STROKES = ("piano", "forte", "staccato")


@pytest.mark.parametrize("flexible", [False, True], ids=["rigid", "flexible"])
@pytest.mark.parametrize("stroke", STROKES)
def test_default_tolerance_keeps_its_bounds(run_of, stroke, flexible):
    coarse = run_of(stroke, rtol=1e-6, flexible=flexible).summary
    fine = run_of(stroke, rtol=1e-10, flexible=flexible).summary
    assert coarse.keys() == fine.keys()
    for name, bound in BOUNDS.items():
        if name in fine:
            assert abs(coarse[name] - fine[name]) < bound, name


@pytest.mark.parametrize("stroke", STROKES)
def test_typical_error_at_the_default_tolerance(run_of, stroke):
    fine = run_of(stroke, rtol=1e-10, flexible=True).summary
    runs = [run_of(stroke, rtol=r, flexible=True).summary for r in (0.8e-6, 0.9e-6, 1e-6)]
    for name, bound in (("impact_time", 4e-6), ("impact_speed", 3e-4)):
        assert np.median([abs(r[name] - fine[name]) for r in runs]) < bound


@pytest.mark.parametrize("stroke", STROKES)
def test_errors_fall_with_the_tolerance(run_of, stroke):
    fine = run_of(stroke, rtol=1e-10).summary
    names = ("impact_time", "impact_speed", "rebound_speed", "max_impact_force")
    errors = np.array(
        [
            [abs(run_of(stroke, rtol=rtol).summary[n] / fine[n] - 1.0) for n in names]
            for rtol in (1e-5, 1e-7, 1e-9)
        ]
    )
    largest = errors.max(axis=1)
    assert largest[1] < largest[0] / 5
    assert largest[2] < largest[1] / 5
    assert largest[2] < 1e-6


@pytest.mark.parametrize("stroke", STROKES)
def test_trajectory_up_to_check_converges(run_of, stroke):
    """Hammer and key against time, before anything bounces freely."""
    fine = run_of(stroke, rtol=1e-10)
    until = fine.time <= fine.summary["string_contact_off_time"]
    for rtol, room in ((1e-6, 5e-5), (1e-8, 1e-6)):
        run = run_of(stroke, rtol=rtol)
        for name in ("hammer.angle", "key.angle", "whippen.angle"):
            span = np.ptp(fine[name])
            assert np.max(np.abs(run[name] - fine[name])[until]) < room * span


def test_work_stays_below_its_ceiling(run_of):
    """Machine independent counts with generous room: a lost exact Jacobian shows here."""
    for stroke, steps, flexible in (
        ("piano", 9_000, False),
        ("forte", 11_000, False),
        ("staccato", 17_000, False),
        ("piano", 25_000, True),
        ("forte", 30_000, True),
        ("staccato", 90_000, True),
    ):
        stats = run_of(stroke, rtol=1e-6, flexible=flexible).stats
        assert stats["steps"] < steps
        assert stats["rhs"] < 2 * steps
        assert stats["newton_failures"] < 0.1 * stats["steps"]


def test_force_of_the_string_converges_with_the_modes(run_of):
    """Distance of the force history from that of 320 modes, over the peak."""
    force = {
        n: run_of("forte", values={"string.modes": n}, rtol=1e-8, duration=0.1, output_rate=50e3)
        for n in (20, 40, 80, 160, 320)
    }
    fine = force[320]["contact06.force"]
    errors = [
        float(np.max(np.abs(force[n]["contact06.force"] - fine)) / np.max(fine))
        for n in (20, 40, 80, 160)
    ]
    assert errors == sorted(errors, reverse=True)
    assert errors[0] < 0.1
    assert errors[-1] < errors[0] / 5
    assert errors[-1] < 2e-3


def test_peak_force_does_not_depend_on_the_output_rate(run_of):
    coarse = run_of("forte", rtol=1e-8, output_rate=1000.0)
    fine = run_of("forte", rtol=1e-8)
    peak = fine.summary["max_impact_force"]
    assert coarse.summary["max_impact_force"] == peak
    assert coarse.summary["impact_time"] == fine.summary["impact_time"]
    assert np.max(coarse["contact06.force"]) < peak
    dense = run_of("forte", rtol=1e-8, output_rate=1e6, duration=0.096)
    assert np.max(dense["contact06.force"]) == pytest.approx(peak, rel=1e-6)


def test_moving_and_fixed_strike_point_differ_little(run_of):
    """The hammer moves some tenths of a millimeter along the string during a strike."""
    moving = run_of("forte", rtol=1e-8).summary
    fixed = run_of("forte", values={"string.strike_point": 0.0694}, rtol=1e-8).summary
    assert fixed["impact_speed"] == pytest.approx(moving["impact_speed"], rel=1e-5)
    assert fixed["rebound_speed"] != moving["rebound_speed"]
    assert fixed["rebound_speed"] == pytest.approx(moving["rebound_speed"], rel=0.05)
    assert fixed["max_impact_force"] == pytest.approx(moving["max_impact_force"], rel=0.02)
