"""The ways through time that a user names: both agree, and a wrong name is named."""

import pytest

import feltmb
from unmodeled.errors import InvalidParameter


@pytest.fixture(scope="module")
def runs():
    return {
        method: feltmb.simulate("steinway45", "forte", 0.15, method=method)
        for method in ("cvode", "modal")
    }


def test_methods_agree_within_their_errors(runs):
    cvode, modal = runs["cvode"], runs["modal"]
    assert (cvode.stats["method"], cvode.stats["strikes"]) == ("cvode", 0)
    assert (modal.stats["method"], modal.stats["strikes"]) == ("modal", 1)
    refined = feltmb.simulate("steinway45", "forte", 0.15, 1e-8, method="cvode", ledger=False)
    for key in ("impact_speed", "max_impact_force", "impact_duration"):
        errors = {name: abs(run.summary[key] - refined.summary[key]) for name, run in runs.items()}
        assert max(errors.values()) < 1e-4 * refined.summary[key], (key, errors)


def test_ledger_closes_with_a_string_outside(runs):
    for run in runs.values():
        assert abs(run.energy["residual_relative"]) < 1e-4
    heat = [run.energy["dissipated"]["string"] for run in runs.values()]
    assert heat[0] == pytest.approx(heat[1], rel=1e-3)
    assert heat[0] > 0


def test_a_string_is_left_after_a_strike_whether_a_ledger_is_kept_or_not():
    """The hammer comes a second time: between the two the string is on its own."""
    kept, none = (feltmb.simulate("steinway45", "staccato", ledger=k) for k in (True, False))
    assert kept.stats["strikes"] == none.stats["strikes"] == 2
    assert kept.stats["steps"] == pytest.approx(none.stats["steps"], rel=0.01)
    assert kept.energy["residual_relative"] < 5e-4
    assert not kept.stats["warnings"]


def test_auto_takes_modal_where_there_is_a_string():
    run = feltmb.simulate("steinway45", "forte", 0.01)
    assert run.stats["method"] == "modal"


def test_unknown_method_is_named():
    with pytest.raises(InvalidParameter, match='method = "fast", must be "auto", "cvode" or'):
        feltmb.simulate("steinway45", "forte", 0.01, method="fast")
