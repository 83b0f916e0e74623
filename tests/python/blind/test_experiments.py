"""The machine that answers requests: what it gives, what it refuses, how it is scored."""

import json
from dataclasses import asdict, replace
from types import SimpleNamespace

import numpy as np
import pytest

from blind import action_truth, experiments, truth
from blind.action_requests import ActionRequests
from blind.interactive import Asked, role_of
from blind.key_hammer import effects
from blind.small_requests import SmallRequests
from feltmb.adapters.changes import read_entry
from feltmb.cli import main
from feltmb.errors import InvalidParameter
from feltmb.gap import Belief, PartTest

SMALL = SmallRequests()


@pytest.fixture(scope="module")
def action():
    return ActionRequests()


def test_truths_are_single_effects_of_plausible_size():
    library = {e.name: e for e in effects()}
    cases = [SMALL.draw(26, n) for n in range(200)]
    assert repr(cases[:5]) == repr([SMALL.draw(26, n) for n in range(5)])
    nulls = sum(not c.parts for c in cases)
    assert 20 <= nulls <= 60
    for case in cases:
        for part in case.parts:
            share = abs(part.size) / library[part.name].scale
            assert 0.3 <= share <= 2.0 + 1e-9
            assert part.name in truth.BOTH_SIGNS or part.size > 0.0
    assert len({p.name for c in cases for p in c.parts}) > 15


def test_truths_of_the_action_are_single_effects_of_plausible_size(action):
    scale = {e.name: e.scale for e in action.effects}
    cases = [action.draw(26, n) for n in range(100)]
    assert repr(cases[7]) == repr(action.draw(26, 7))
    assert 8 <= sum(not c.parts for c in cases) <= 35
    for case in cases:
        assert case.view == "force"
        assert len(case.tolerances) == len(action.model.parameters)
        for part in case.parts:
            assert 0.49 <= abs(part.size) / scale[part.name] <= 2.01
    assert len({p.name for c in cases for p in c.parts}) > 30
    json.dumps([asdict(c) for c in cases])  # can be sealed


def test_requests_beyond_the_limits_are_refused():
    case = SMALL.draw(26, 0)
    time = np.arange(100) * truth.FRAME
    with pytest.raises(InvalidParameter, match="force beyond 0 to 12 N"):
        SMALL.records([Asked(case, "x", 13.0 * np.ones_like(time), 1)])
    with pytest.raises(InvalidParameter, match="N/s, expected <="):
        SMALL.records([Asked(case, "x", np.where(time > 0.01, 5.0, 0.0), 1)])
    assert SMALL.records([]) == []


def test_parts_are_measured_with_the_stated_noise():
    test = PartTest(parameter="key_mass", sd=2e-4)
    cases = [SMALL.draw(26, n) for n in range(60)]
    off = [
        (SMALL.part(c, test, 1).value - np.mean(c.parameters["key_mass"])) / test.sd for c in cases
    ]
    assert abs(np.mean(off)) < 0.5
    assert 0.7 < np.std(off) < 1.4
    assert SMALL.part(cases[0], test, 1) == SMALL.part(cases[0], test, 1)


def test_parts_of_the_action_are_measured_with_the_stated_noise(action):
    cases = [action.draw(26, n) for n in range(60)]
    for name in ("mass.key", "let_off_button"):
        (test,) = [t for t in action.limits.parts if t.parameter == name]
        off = [(action.part(c, test, 1).value - c.tolerances[name]) / test.sd for c in cases]
        assert abs(np.mean(off)) < 0.5
        assert 0.7 < np.std(off) < 1.4


def test_a_test_measures_the_part_with_its_effect(action):
    """As the sealed machine has it: stiffness, torque [N m] as a share, compliance, length [m]."""
    bare = next(c for c in (action.draw(26, n) for n in range(50)) if not c.parts)

    def with_effect(name, size):
        return replace(bare, parts=(action_truth.Part(name, "A", size, float("nan")),))

    path = {
        "felt.04": "contacts.04.loading.a",
        "joint_friction.key": "bodies.key.friction.amplitude",
        "bending.wire": "bodies.wire.young_modulus",
    }
    for name, size, parameter in (
        ("felt_stiffness.04", 0.3, "felt.04"),
        ("coulomb_friction.key", 4e-3, "joint_friction.key"),
        ("wire_compliance", 0.4, "bending.wire"),
    ):
        case = with_effect(name, size)
        own = {t: v for t, v in case.tolerances.items() if t == parameter}
        alone = replace(case, tolerances=own, varied={})
        true = action_truth.machine(action._refined, action._library, alone, "forte").config
        values = [float(read_entry(c, path[parameter])) for c in (true, action._refined.config)]
        assert action.true_value(case, parameter) == pytest.approx(
            values[0] / values[1] - 1.0, rel=1e-9
        )
        assert action.true_value(case, "felt.05") == pytest.approx(case.tolerances["felt.05"])
    far = with_effect("string_distance", 2e-3)
    assert action.true_value(far, "string_distance") == pytest.approx(2e-3)
    assert action.true_value(bare, "string_distance") == 0.0
    # The other form of a stiffer felt also hardens: its stiffness changes less.
    other = replace(bare, parts=(action_truth.Part("felt_stiffness.04", "B", 0.3, float("nan")),))
    assert action.true_value(other, "felt.04") < action.true_value(
        with_effect("felt_stiffness.04", 0.3), "felt.04"
    )
    for test in action.limits.parts:  # each test can be made
        assert np.isfinite(action.true_value(far, test.parameter))


def test_the_test_of_a_part_can_be_the_answer():
    case = SimpleNamespace(parts=[SimpleNamespace(name="felt_stiffness.04")])
    none = SimpleNamespace(parts=[])
    report = {"verdict": "NO GAP", "named": [], "one_of": [], "given": ["felt.04"]}
    assert experiments.outcome_of(case, report, "felt.04") == "right"
    assert experiments.outcome_of(case, report) == "wrong"
    assert experiments.outcome_of(none, report) == "alarm"
    assert experiments.outcome_of(case, {**report, "given": ["felt.04", "x"]}, "felt.04") == "more"
    unexplained = {**report, "verdict": "UNKNOWN CAUSE"}
    assert experiments.outcome_of(case, unexplained, "felt.04") == "unknown"


@pytest.mark.parametrize("rounds", [(0, 1), (0, 2), (0, 1, 4)])
def test_results_of_other_rounds_are_not_replaced(tmp_path, rounds):
    """Before, the rounds 0,1 replaced what 0,1,2 had found, and 0,2 counted as done."""
    case = SMALL.draw(26, 0)
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
    experiments._seal(SMALL, tmp_path, [SMALL.draw(26, 0)], 26)
    with pytest.raises(InvalidParameter, match="seed 26 of key_hammer, got 1 of seed 27"):
        experiments._seal(SMALL, tmp_path, [SMALL.draw(27, 0)], 27)


def test_scores_of_the_whole_diagnosis_are_kept_apart_from_screened_ones(tmp_path, capsys):
    truths = [SMALL.draw(26, 0)]
    experiments._seal(SMALL, tmp_path, truths, 26)
    experiments._seal(SMALL, tmp_path, truths, 26, whole=True)  # the first call that says it
    experiments._seal(SMALL, tmp_path, truths, 26, whole=True)
    experiments._seal(SMALL, tmp_path, truths, 26)
    with pytest.raises(InvalidParameter, match="with --diagnose, got no --diagnose"):
        experiments._seal(SMALL, tmp_path, truths, 26, whole=False)
    call = ["--cases", "1", "--seed", "26", "-o", str(tmp_path)]
    with pytest.raises(SystemExit):
        main(call, command=experiments.command, name="experiments.py")
    assert "Give --diagnose, or another folder" in capsys.readouterr().err
    other = tmp_path / "other"
    experiments._seal(SMALL, other, truths, 26, whole=False)
    call = ["--cases", "1", "--seed", "26", "-o", str(other), "--score-only", "--diagnose"]
    with pytest.raises(SystemExit):
        main(call, command=experiments.command, name="experiments.py")
    assert "Give no --diagnose, or another folder" in capsys.readouterr().err


@pytest.mark.slow
def test_a_request_is_played():
    case = SMALL.draw(26, 1)
    time = np.arange(400) * truth.FRAME
    force = 6.0 * np.clip((time - 0.01) / 0.02, 0.0, 1.0)
    one, two = SMALL.records([Asked(case, "a", force, 1), Asked(case, "b", force, 2)])
    assert one.role == "fit"
    assert two.role == "held_out"
    assert np.abs(one.inputs["finger"] - force).max() < 0.1
    assert one.outputs["key"].max() > 8e-3
    assert not np.array_equal(one.outputs["key"], two.outputs["key"])  # other noise


def test_a_request_is_played_on_the_action(action):
    case = action.draw(26, 1)
    time = np.arange(300) / action_truth.RATE
    force = 6.0 * np.clip((time - 0.01) / 0.02, 0.0, 1.0)
    one, two = action.records([Asked(case, "a", force, 1), Asked(case, "b", force, 2)])
    assert (one.role, two.role) == ("fit", "held_out")
    n = one.samples
    assert np.abs(one.inputs["force"] - force[:n]).max() < 0.05
    assert np.nanmin(one.outputs["hammer_tip.x"]) < -0.02
    off = one.outputs["hammer_tip.y"][:20] - two.outputs["hammer_tip.y"][:20]
    assert 1e-5 < np.std(off) < 2e-4  # other noise
    first = action.defaults([case])[0]
    assert [r.name for r in first] == ["piano", "staccato", "forte"]
    assert [r.role for r in first] == ["fit", "fit", "held_out"]
    # The default strokes may be requested too.
    for k in range(3):
        name, values = action.default(k)
        assert name == first[k].name
        assert values.max() <= action.limits.inputs["force"].most


def test_a_bench_is_sealed_and_not_opened_with_other_truths(action, tmp_path):
    truths = [action.draw(3, n) for n in range(2)]
    experiments._seal(action, tmp_path, truths, 3)
    seal = json.loads((tmp_path / "seal.json").read_text())
    assert (seal["machine"], seal["cases"], seal["seed"]) == ("steinway45", 2, 3)
    experiments._seal(action, tmp_path, truths, 3)
    with pytest.raises(InvalidParameter, match="2 cases of seed 3 of steinway45, got 2 of seed 4"):
        experiments._seal(action, tmp_path, [action.draw(4, n) for n in range(2)], 4)


def test_the_model_states_the_variability_of_its_machine():
    stated = {p.name: p.process_sd / p.value for p in SMALL.model.parameters if p.process_sd}
    assert stated == pytest.approx(dict.fromkeys(truth.WANDERING, 0.01))


def test_plans_and_draws_use_the_permitted_families_only():
    player = experiments.Player(SMALL, whole=False)
    case = SMALL.draw(26, 1)
    own = experiments.Case(case, SMALL.defaults([case])[0], [], Belief(weights={}), [], [])
    asked = experiments.ask(player, SMALL, "random", own, 6)
    assert len(asked) == 6
    assert set(own.asked) <= {*SMALL.families}
    assert "chirp" not in SMALL.families


def test_every_second_requested_record_is_held_out_whatever_parts_are_tested():
    """Tests of parts counted too: after them, all of the strokes could be held out."""
    part = SMALL.limits.parts[0]
    strokes = [SimpleNamespace(inputs={"finger": np.full(3, float(k))}) for k in range(3)]
    made = [
        SimpleNamespace(name=str(k), cost=0.5, part=part if k % 2 == 0 else None, record=stroke)
        for k, stroke in enumerate(np.repeat(np.array(strokes), 2))
    ]
    player = SimpleNamespace(plan=lambda *_: SimpleNamespace(experiments=made))
    own = experiments.Case(SMALL.draw(26, 1), [], [], Belief(weights={}), [], [])
    asked = experiments.ask(player, SMALL, "designed", own, 3)
    assert [role_of(a) for a in asked] == ["fit", "held_out", "fit"]
    assert [a.values[0] for a in asked] == [0.0, 1.0, 2.0]
    assert own.asked == [*"012345"]
    assert len({m.value for m in own.parts}) == 3  # other noise


def test_evidence_of_the_truth_is_that_of_the_best_set_with_it():
    case = next(c for c in (SMALL.draw(26, n) for n in range(20)) if c.parts)
    true = case.parts[0].name
    sets = {(true,): 5.0, (true, "x"): 7.0, ("x",): 4.0, ("x", "y"): 4.5}
    assert experiments.evidence_of(case, sets) == 2.5
    assert experiments.evidence_of(case, {(true,): 5.0}) == 5.0
    assert np.isnan(experiments.evidence_of(case, {("x",): 4.0}))


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
    case = next(c for c in (SMALL.draw(26, n) for n in range(20)) if c.parts)
    true = case.parts[0].name
    report = {
        "named": [true if n == "T" else n for n in named],
        "one_of": [true if n == "T" else n for n in one_of],
        "verdict": verdict,
    }
    assert experiments.outcome_of(case, report) == outcome
    null = next(c for c in (SMALL.draw(26, n) for n in range(40)) if not c.parts)
    assert experiments.outcome_of(null, report) == ("quiet" if outcome == "silent" else "alarm")
