"""A run that starts from another: damaged states are refused."""

import dataclasses

import numpy as np
import pytest

import feltmb

STILL = feltmb.ramp_stroke(0.0, duration=0.02)


@pytest.fixture(scope="module")
def ended(action):
    """A strike on felt that remembers, and its end."""
    felt = action.with_values(
        {"shank.rigid": True, "wire.rigid": True, "contacts.*.law": "felt_memory"}
    )
    return felt, feltmb.simulate(felt, "forte", 0.02)


def damage(values, how):
    out = np.array(values, dtype=float)
    if how == "empty":
        return out[:0]
    if how == "short":
        return out[:-1]
    out[0] = {"nan": np.nan, "inf": np.inf, "huge": 1e308, "negative": -1.0}[how]
    return out


@pytest.mark.parametrize("how", ["nan", "inf", "huge", "negative", "empty", "short"])
def test_a_damaged_memory_is_refused(ended, how):
    felt, run = ended
    broken = dataclasses.replace(run, end_memory=damage(run.end_memory, how))
    with pytest.raises(feltmb.InvalidParameter, match=r"memory|remembered"):
        feltmb.simulate(felt, STILL, start=broken)


@pytest.mark.parametrize("how", ["nan", "inf", "huge", "empty", "short"])
def test_a_damaged_state_is_refused_or_fails(ended, how):
    felt, run = ended
    for at in (0, len(felt.coordinates), -1):  # a place, a speed, a mode of the string
        state = np.roll(damage(np.roll(run.end_state, -at), how), at)
        broken = dataclasses.replace(run, end_state=state)
        with pytest.raises((feltmb.InvalidParameter, feltmb.IntegrationError)) as caught:
            feltmb.simulate(felt, STILL, start=broken)
        assert str(caught.value)
        partial = getattr(caught.value, "partial", None)
        assert partial is None or np.all(np.isfinite(partial.values))


@pytest.mark.parametrize("name", ["end_state", "end_memory"])
@pytest.mark.parametrize("kind", [complex, str, object, None])
def test_a_start_of_other_than_numbers_is_refused(ended, name, kind):
    felt, run = ended
    broken = None if kind is None else getattr(run, name).astype(kind)
    with pytest.raises(feltmb.InvalidParameter, match=f"start: {name} is an array of"):
        feltmb.simulate(felt, STILL, start=dataclasses.replace(run, **{name: broken}))
