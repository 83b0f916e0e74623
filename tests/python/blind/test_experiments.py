"""The machine that answers requests: what it gives, what it refuses, how it is scored."""

import json

import numpy as np
import pytest

from blind import experiments, truth
from blind.key_hammer import effects
from feltmb.cli import main
from feltmb.errors import InvalidParameter
from feltmb.gap import PartTest


def test_truths_are_single_effects_of_plausible_size():
    library = {e.name: e for e in effects()}
    cases = [experiments.draw(26, n) for n in range(200)]
    assert repr(cases[:5]) == repr([experiments.draw(26, n) for n in range(5)])
    nulls = sum(not c.parts for c in cases)
    assert 20 <= nulls <= 60
    for case in cases:
        for part in case.parts:
            share = abs(part.size) / library[part.name].scale
            assert 0.3 <= share <= 2.0 + 1e-9
            assert part.name in truth.BOTH_SIGNS or part.size > 0.0
    assert len({p.name for c in cases for p in c.parts}) > 15


def test_requests_beyond_the_limits_are_refused():
    machine = experiments.Requests(experiments.limits())
    case = experiments.draw(26, 0)
    time = np.arange(100) * truth.FRAME
    with pytest.raises(InvalidParameter, match="force beyond 0 to 12 N"):
        machine.records([(case, "x", 13.0 * np.ones_like(time), 1)])
    with pytest.raises(InvalidParameter, match="N/s, expected <="):
        machine.records([(case, "x", np.where(time > 0.01, 5.0, 0.0), 1)])


def test_parts_are_measured_with_the_stated_noise():
    machine = experiments.Requests(experiments.limits())
    test = PartTest(parameter="key_mass", sd=2e-4)
    cases = [experiments.draw(26, n) for n in range(60)]
    off = [
        (machine.part(c, test, 1).value - np.mean(c.parameters["key_mass"])) / test.sd
        for c in cases
    ]
    assert abs(np.mean(off)) < 0.5
    assert 0.7 < np.std(off) < 1.4
    assert machine.part(cases[0], test, 1) == machine.part(cases[0], test, 1)


@pytest.mark.parametrize("rounds", [(0, 1), (0, 2), (0, 1, 4)])
def test_results_of_other_rounds_are_not_replaced(tmp_path, rounds):
    """Before, the rounds 0,1 replaced what 0,1,2 had found, and 0,2 counted as done."""
    case = experiments.draw(26, 0)
    done = {"random": {"rounds": [{"experiments": n} for n in (0, 1, 2)]}}
    (tmp_path / "cases").mkdir()
    (tmp_path / "cases" / "0.json").write_text(json.dumps(done), encoding="utf-8")
    with pytest.raises(InvalidParameter, match=f"random was scored after 0, 1, 2.*{rounds[-1]};"):
        experiments.run_cases(None, None, [case], tmp_path, ["random"], lambda: True, rounds)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--rounds", "0,0"], "got '0,0', expected increasing integers from 0 to 1000"),
        (["--rounds", ""], "got '', expected increasing"),
        (["--rounds", "0,9999"], "from 0 to 1000"),
        (["--score-only"], "is no bench: seal.json is missing"),
    ],
)
def test_options_that_cannot_be_used_are_told(tmp_path, capsys, options, said):
    folder = tmp_path / "bench"
    with pytest.raises(SystemExit) as end:
        main(["-o", str(folder), *options], command=experiments.command, name="experiments.py")
    assert end.value.code == 2
    assert said in capsys.readouterr().err
    assert not folder.exists()


def test_another_seed_than_the_sealed_one_is_told(tmp_path):
    experiments._seal(tmp_path, 1, 26)
    with pytest.raises(InvalidParameter, match="sealed with 1 cases of seed 26, got 1 of seed 27"):
        experiments._seal(tmp_path, 1, 27)


@pytest.mark.slow
def test_a_request_is_played():
    machine = experiments.Requests(experiments.limits())
    case = experiments.draw(26, 1)
    time = np.arange(400) * truth.FRAME
    force = 6.0 * np.clip((time - 0.01) / 0.02, 0.0, 1.0)
    one, two = machine.records([(case, "a", force, 1), (case, "b", force, 2)])
    assert one.role == "fit"
    assert two.role == "held_out"
    assert np.abs(one.inputs["finger"] - force).max() < 0.1
    assert one.outputs["key"].max() > 8e-3
    assert not np.array_equal(one.outputs["key"], two.outputs["key"])  # other noise


@pytest.mark.parametrize(
    ("named", "one_of", "verdict", "outcome"),
    [
        (["T"], [], "NAMED", "right"),
        (["x"], [], "NAMED", "wrong"),
        (["T", "x"], [], "NAMED", "more"),
        ([], ["T", "x"], "ONE OF", "class"),
        ([], ["T", "x", "y"], "ONE OF", "large class"),
        ([], ["x", "y"], "ONE OF", "wrong"),
        ([], [], "NO GAP", "silent"),
        ([], [], "UNKNOWN", "unknown"),
    ],
)
def test_outcomes(named, one_of, verdict, outcome):
    case = next(c for c in (experiments.draw(26, n) for n in range(20)) if c.parts)
    true = case.parts[0].name
    report = {
        "named": [true if n == "T" else n for n in named],
        "one_of": [true if n == "T" else n for n in one_of],
        "verdict": verdict,
    }
    assert experiments.outcome_of(case, report) == outcome
    null = next(c for c in (experiments.draw(26, n) for n in range(40)) if not c.parts)
    assert experiments.outcome_of(null, report) == ("quiet" if outcome == "silent" else "alarm")
