"""The energy ledger: no energy from undamped members, and a run with a wrong ledger has failed."""

import math

import pytest

import feltmb

STILL = feltmb.ramp_stroke(0.0, duration=0.02)


def members(shapes, count):
    return {
        path: value
        for member in ("wire", "shank")
        for path, value in {f"{member}.shapes": shapes, f"{member}.lateral_shapes": count}.items()
    }


@pytest.fixture(scope="module")
def ringing(action):
    """Members with undamped modes up to 20 kHz."""
    return action.with_values(members("craig_bampton", 6))


def test_fast_undamped_members_make_no_energy(ringing):
    run = feltmb.simulate(ringing, "staccato", 0.1)
    assert run.energy["residual_relative"] < 1e-4
    assert not run.stats["warnings"]


def test_with_strings_in_the_integrator_members_make_no_energy_either(ringing):
    # The string of 7 % damping alone would allow order 3, under which they grow.
    run = feltmb.simulate(ringing, "staccato", 0.06, method="cvode")
    assert run.energy["residual_relative"] < 1e-3


@pytest.mark.parametrize("name", ["steinway45", "steinway45_damped"])
def test_long_ringing_with_strings_in_the_integrator_makes_no_energy(name):
    """Order 3 let the wire grow by a fifth of its energy in half a second: 1.2e-3 missing."""
    run = feltmb.simulate(name, "staccato", method="cvode")
    assert run.energy["residual_relative"] < 4e-4
    assert run.stats["steps"] < 65_000  # order 2: 140 000


def test_a_run_whose_ledger_is_off_has_failed_and_keeps_its_trajectory(ringing):
    options = {"duration": 0.1, "rtol": 1e-5, "max_order": 3}
    with pytest.raises(feltmb.IntegrationError, match="ledger_limit") as caught:
        feltmb.simulate(ringing, "staccato", **options)
    assert caught.value.code == "energy_balance"
    run = caught.value.partial
    assert run.status == "failed"
    assert run.time[-1] == pytest.approx(0.1)
    assert run.energy["residual_relative"] > 0.1
    assert feltmb.simulate(ringing, "staccato", ledger_limit=1e9, **options).status == "done"


def test_rows_of_a_sweep_whose_ledger_is_off_have_failed(ringing):
    table = feltmb.sweep(
        ringing, "staccato", {"options.max_order": [3, 5]},
        options={"duration": 0.1, "rtol": 1e-5, "ledger": True},
    ).table  # fmt: skip
    assert list(table["status"]) == ["failed", "done"]
    assert "energy balance error" in table["error"][0]


@pytest.mark.parametrize("limit", [0.0, -1.0, math.nan])
def test_a_limit_of_the_ledger_is_positive(rigid, limit):
    with pytest.raises(feltmb.InvalidParameter, match="ledger_limit"):
        feltmb.simulate(rigid, STILL, 0.001, ledger_limit=limit)


def test_the_ledger_counts_where_no_work_is_done(data, state_of):
    """A hammer thrown at a string: no work comes in, only its own energy is exchanged."""
    action = feltmb.load_action(data / "hammer_string.toml")
    start = state_of(action, [0.0], [3.0])
    rough = feltmb.simulate(action, STILL, rtol=1e-2, start=start)
    fine = feltmb.simulate(action, STILL, rtol=1e-8, start=start)
    kinetic = 0.5 * 9e-3 * 3.0**2
    for run in (rough, fine):
        assert run.energy["work_throughput"] == 0.0
        assert run.energy["turned_over"] == pytest.approx(kinetic, rel=0.05)
        ratio = run.energy["residual_largest"] / run.energy["turned_over"]
        assert run.energy["residual_relative"] == pytest.approx(ratio, rel=1e-12)
    assert rough.energy["residual_relative"] > 1e-3
    assert any("energy balance error" in w for w in rough.stats["warnings"])
    assert 0.0 < fine.energy["residual_relative"] < 1e-5


def test_at_rest_nothing_is_missing(rigid):
    run = feltmb.simulate(rigid, STILL)
    assert run.energy["residual_relative"] < 1e-3
    assert not run.stats["warnings"]


def test_the_ledger_of_late_samples_counts_from_the_start(rigid):
    whole = feltmb.simulate(rigid, "forte")
    late = feltmb.simulate(rigid, "forte", summary_only=True)
    assert late.time[0] > 0.1
    assert late.energy["residual_relative"] < 1e-3
    for key in ("work_in", "kinetic", "potential", "elastic", "dissipated_total"):
        assert late.energy[key] == pytest.approx(whole.energy[key], rel=1e-9, abs=1e-12)
