"""The set of the answer: who stays in it, who leaves, and what is compared with it."""

from __future__ import annotations

import math
from types import SimpleNamespace as Given

import numpy as np
import pytest

from unmodeled import Options, Verdict, diagnose
from unmodeled.search import choice
from unmodeled.search.choice import WORTH, Need, choose
from unmodeled.search.held_out import Predicted, Ratio
from unmodeled.search.ledger import SAME, Mark
from unmodeled.search.linear import Point
from unmodeled.search.progress import Stop
from unmodeled.search.records import prepare, ready_records
from unmodeled.search.result import Reason
from unmodeled.search.search import search

from .conftest import spring_record

ENOUGH = math.log(0.9 / 0.1)
BETTER = Ratio(0.5, 2.0 * WORTH, 0.9, 0, 3)
LITTLE = Ratio(0.5 * WORTH, 0.2 * WORTH, 0.9 * WORTH, 0, 3)
EQUAL = Ratio(0.0, -0.2, 0.2, 1, 3)
WORSE = Ratio(-0.3, -0.5, -0.1, 3, 3)


def fitted(*causes):
    return Given(causes=causes, members=causes)


def pruned(monkeypatch, start, needs, probable=()):
    """The set that remains of a start; ``needs``: by set, the need of each of its members.

    ``probable``: sets that are more probable than others.
    """
    sets = {c: fitted(*c) for c in [*needs, ()]}
    out = Given(everything=Given(sets=sets), problem=None)
    monkeypatch.setattr(
        choice, "best_of", lambda _, some: max(some, key=lambda s: s.causes in probable)
    )
    monkeypatch.setattr(choice, "_needs", lambda _, now, *__: needs[now.causes])
    best, found = choice._pruned(out, sets[start], Options(), lambda: None)
    return best.causes, found


@pytest.mark.parametrize(
    ("need", "stays"),
    [
        (Need(ENOUGH + 0.1), True),
        (Need(ENOUGH - 0.1), False),
        # The held-out records need it, whatever the evidence says.
        (Need(-9.0, BETTER, over_matters=2.0), True),
        (Need(-9.0, BETTER, over_matters=0.9), False),
        (Need(-9.0, LITTLE, over_matters=2.0), False),
        (Need(-9.0, EQUAL, over_matters=2.0), False),
        # They refuse it, whatever the evidence says.
        (Need(99.0, WORSE, over_matters=2.0), False),
        (Need(99.0, EQUAL, over_matters=2.0), True),
        # Its size differs between records by more than what matters.
        (Need(99.0, BETTER, differs=0.5 * SAME, over_matters=2.0), False),
        (Need(99.0, BETTER, differs=2.0 * SAME, over_matters=2.0), True),
        # Without it, the model cannot be simulated; or nobody knows.
        (Need(math.inf, None, fails=True), True),
        (Need(math.nan), True),
    ],
)
def test_a_member_stays_if_the_evidence_or_the_held_out_records_need_it(monkeypatch, need, stays):
    best, found = pruned(monkeypatch, (0,), {(0,): {0: need}})
    assert best == ((0,) if stays else ())
    assert found[0].left is not stays


def test_the_rest_is_judged_again_after_each_removal(monkeypatch):
    """Each of two that stand for each other is needless beside the other one."""
    needs = {
        (0, 1): {0: Need(0.5), 1: Need(0.2)},
        (0,): {0: Need(50.0)},
        (1,): {1: Need(49.0)},
    }
    best, found = pruned(monkeypatch, (0, 1), needs)
    assert best == (0,)
    assert (found[0], found[1].left) == (Need(50.0), True)


def test_an_imitation_leaves_before_what_is_not_needed(monkeypatch):
    needs = {
        (0, 1): {0: Need(-3.0), 1: Need(9.0, differs=1e-6)},
        (0,): {0: Need(50.0)},
        (1,): {1: Need(9.0)},
    }
    assert pruned(monkeypatch, (0, 1), needs)[0] == (0,)


def test_another_law_takes_the_place_of_an_imitation(monkeypatch):
    needs = {(0,): {0: Need(9.0, differs=1e-6)}, (1,): {1: Need(9.0)}}
    best, found = pruned(monkeypatch, (0,), needs, probable=[(1,)])
    assert best == (1,)
    assert found[0].left
    needs[1,] = {1: Need(9.0, differs=1e-6)}
    assert pruned(monkeypatch, (0,), needs, probable=[(1,)])[0] == ()
    # What has left does not come again.
    needs = {
        (0, 2): {0: Need(9.0, differs=1e-6), 2: Need(9.0)},
        (1, 3): {1: Need(9.0, differs=1e-6), 3: Need(-3.0)},
        (1,): {1: Need(9.0, differs=1e-6)},
        (3,): {3: Need(9.0, differs=1e-6)},
        (2,): {2: Need(9.0)},
    }
    assert pruned(monkeypatch, (0, 2), needs, probable=[(1, 3), (3,)])[0] == ()


def test_a_set_whose_rest_cannot_be_fitted_stays(monkeypatch):
    best, found = pruned(monkeypatch, (0, 1), {(0, 1): {0: Need(50.0), 1: Need(-3.0)}})
    assert best == (0, 1)
    assert found[1].evidence == -3.0


@pytest.mark.parametrize(
    ("rival", "ratio", "odds", "preferred"),
    [
        ((0, 1), BETTER, -9.0, True),  # surely predicts better with one cause more
        ((0, 1), EQUAL, -9.0, False),
        ((0, 1), EQUAL, 1.0, True),  # predicts as well, and is more probable
        ((1,), BETTER, -1.0, True),
        ((1,), WORSE, 9.0, False),
        ((1,), EQUAL, -1.0, False),
    ],
)
def test_a_set_that_surely_predicts_better_takes_the_place_of_the_most_probable_one(
    monkeypatch, rival, ratio, odds, preferred
):
    sets = {c: fitted(*c) for c in ((), (0,), rival)}
    predicted = dict.fromkeys(sets, object())
    out = Given(everything=Given(sets=sets), predicted=predicted, problem=None, alone=sets[()])
    monkeypatch.setattr(choice, "_fit_smaller", lambda *_: None)
    monkeypatch.setattr(choice, "best_of", lambda *_: sets[0,])
    monkeypatch.setattr(choice, "_rival", lambda *_: sets[rival])
    monkeypatch.setattr(choice, "_pruned", lambda _, now, *__: (now, {}))
    monkeypatch.setattr(choice, "_worse_than_constant", lambda *_: False)
    monkeypatch.setattr(choice, "log_odds", lambda _, one, other: odds)
    monkeypatch.setattr(choice, "_ratio", lambda *_: ratio)
    choice._pruned_from_all(out, Options(), lambda: None)
    assert out.best.causes == (rival if preferred else (0,))


def climbed(monkeypatch, sets, left, without=()):
    """The set that a climb ends with; ``sets`` has the most probable first."""
    ranked = [fitted(*c) for c in sets]
    known = {s.causes: s for s in ranked}
    laws = {4: 1}  # cause 4 is law 1 with a size of its own in each record
    problem = Given(families_of=lambda causes: {laws.get(i, i) for i in causes})
    out = Given(problem=problem, everything=Given(sets=known), predicted=dict.fromkeys(known, 1))
    position = {c: k for k, c in enumerate(sets)}

    def ratio(_, one, other, __):
        value = left[one] - left[other]
        return Ratio(value, value - 0.2, value + 0.2)

    monkeypatch.setattr(choice, "_fit_smaller", lambda *_: None)
    monkeypatch.setattr(choice, "rank", lambda *_: (ranked, None))
    monkeypatch.setattr(choice, "best_of", lambda *_: ranked[0])
    monkeypatch.setattr(choice, "_ratio", ratio)
    monkeypatch.setattr(choice, "_worse_than_constant", lambda *_: False)
    monkeypatch.setattr(
        choice, "log_odds", lambda _, a, b: float(position[b.causes] - position[a.causes])
    )
    pruned = {**dict(zip(sets, sets, strict=True)), **dict(without)}
    monkeypatch.setattr(choice, "_pruned", lambda _, now, *__: (known[pruned[now.causes]], {}))
    choice._pruned_from_all(out, Options(), lambda: None)
    return out.best.causes


def test_the_choice_climbs_to_sets_that_surely_predict_better(monkeypatch):
    sets = [(0,), (0, 1), (2,), (0, 1, 3)]
    left = {(0,): 0.0, (0, 1): -0.7, (2,): -0.1, (0, 1, 3): -0.75}
    assert climbed(monkeypatch, sets, left) == (0, 1)  # (0, 1, 3) is not surely better
    assert climbed(monkeypatch, sets, {**left, (0, 1, 3): -1.5}) == (0, 1, 3)
    # What needs a cause less is not as good as the set before.
    assert climbed(monkeypatch, sets, {**left, (0, 1, 3): -1.5}, {(0, 1, 3): (2,)}) == (0, 1)
    assert climbed(monkeypatch, sets, dict.fromkeys(sets, 0.0)) == (0,)
    # The same laws by record, less probable, are fitted to the held-out records, too.
    by_record = [(0,), (0, 1), (0, 4), (0, 1, 3)]
    left = {(0,): 0.0, (0, 1): -0.7, (0, 4): -2.0, (0, 1, 3): -0.75}
    assert climbed(monkeypatch, by_record, left) == (0, 1)
    # Another law that is surely less probable does not take the place, however it predicts.
    far = [(0,), (1,), (2,), (3,)]
    left = {(0,): 0.0, (1,): 0.0, (2,): 0.0, (3,): -2.0}
    assert climbed(monkeypatch, far, left) == (0,)
    assert climbed(monkeypatch, far, {**left, (2,): -2.0}) == (2,)


def test_a_set_that_predicts_worse_than_the_mean_is_none(monkeypatch):
    t = np.linspace(0.0, 1.0, 101)[:, None]
    record = Given(samples=np.array([101.0]), measured=t, valid=t >= 0.0, sd=np.full_like(t, 0.01))
    problem = Given(held_out=(record,), noise=np.array([0.01]))
    one = fitted(0)
    for factor, worse in ((0.9, False), (1.1, True)):
        left = factor * np.std(t) / 0.01 * np.ones_like(t)
        predicted = {(0,): Predicted(Point(np.zeros(0), ()), (left,))}
        out = Given(predicted=predicted, searched=Given(problem=problem))
        assert choice._worse_than_constant(out, one) is worse
    problem.noise = np.array([1.0])  # a record of noise
    assert not choice._worse_than_constant(out, one)
    # Then all its causes leave.
    sets = {(0,): one, (): fitted()}
    out = Given(everything=Given(sets=sets), predicted={}, problem=None, alone=sets[()])
    monkeypatch.setattr(choice, "_fit_smaller", lambda *_: None)
    monkeypatch.setattr(choice, "best_of", lambda *_: one)
    monkeypatch.setattr(choice, "_rival", lambda *_: None)
    monkeypatch.setattr(choice, "_pruned", lambda _, now, *__: (now, {0: Need(9.0)}))
    monkeypatch.setattr(choice, "_worse_than_constant", lambda *_: True)
    choice._pruned_from_all(out, Options(), lambda: None)
    assert (out.best.causes, out.worse_than_mean, out.needs[0].left) == ((), True, True)


def machine(*sizes, held_out=(), **what):
    cycles = (2, 5, 3, 4)
    return [
        spring_record(n, k, role="held_out" if n in held_out else "fit", hardening=size, **what)
        for n, k, size in zip("abcd", cycles, sizes, strict=False)
    ]


def test_the_set_is_fitted_to_all_records(spring, causes):
    records = machine(2000.0, 2000.0, 2000.0, held_out="c")
    options = Options()
    problem = prepare(ready_records(spring, records), causes, None, options)
    searched = search(problem, options, lambda _: None, lambda *_: None)
    chosen = choose(searched, options)
    assert [problem.causes[i].name for i in chosen.best.causes] == ["hardening"]
    assert not chosen.worse_than_mean
    assert len(chosen.best.linears) == 3
    (need,) = (chosen.needs[i] for i in chosen.best.causes)
    assert need.evidence > ENOUGH
    assert need.predicts
    assert (need.held_out.records, need.held_out.smaller) == (1, 0)
    # Without held-out records, the evidence alone decides.
    problem = prepare(ready_records(spring, records[:2]), causes, (), options)
    searched = search(problem, options, lambda _: None, lambda *_: None)
    chosen = choose(searched, options)
    (need,) = (chosen.needs[i] for i in chosen.best.causes)
    assert need.evidence > ENOUGH
    assert (need.held_out, chosen.predicted) == (None, {})


def test_one_record_and_some_records_have_no_differences():
    one = Given(local=None, records=frozenset())
    record = Given()
    for cause, records in (
        (one, [record]),
        (Given(local=object(), records=frozenset()), [record] * 3),
        (Given(local=None, records=frozenset({1})), [record] * 3),
    ):
        problem = Given(causes=[cause], fit=records)
        assert choice.differences(problem, None, 0, Options()) == 1.0


def test_a_member_without_which_nothing_can_be_simulated_is_needed(monkeypatch):
    out = Given(everything=None, searched=Given(problem=Given(held_out=())))
    monkeypatch.setattr(choice, "without_one", lambda *_: [None])
    (need,) = choice._needs(out, fitted(0), Options(), lambda: None).values()
    assert (need.fails, need.predicts, need.evidence) == (True, True, math.inf)


def test_differences_that_matter_refuse_a_cause_and_others_do_not(spring, causes):
    """7000 and 5000 N/m^3: 0.6 N apart in a record, of a motion of 9 N."""
    records = machine(7000.0, 5000.0, 6000.0, held_out="c")
    refused = diagnose(spring, causes, records)
    line = refused.finding("hardening")
    assert (line.codes[0], line.mark, line.left) == ("differs", None, True)
    assert "hardening" in refused.refused
    assert Reason.DIFFERS_BETWEEN_RECORDS in refused.reasons
    enough = diagnose(spring, causes, records, options=Options(good_enough={"N": 0.7}))
    assert enough.finding("hardening").same == 1.0
    assert "hardening" in enough.reported
    assert enough.refused == ()


def stop_in(stage, count=6):
    seen = []

    def tell(progress):
        seen.append(progress.stage)
        if progress.stage == stage and seen.count(stage) == count:
            raise Stop

    return tell


def test_a_search_that_was_cut_names_nothing(spring, causes):
    records = machine(3000.0, 3000.0, 3000.0, held_out="c")
    report = diagnose(spring, causes, records, progress=stop_in("search"))
    assert report.reported == ("hardening",)
    assert (report.named, report.verdict) == ((), Verdict.UNKNOWN)
    line = report.finding("hardening")
    assert (line.mark, line.codes[0]) == (Mark.UNSURE, "cut")
    assert "Best so far: hardening" in report.summary()
    assert "sure" not in report.summary().replace("not sure", "").replace("measure", "")
    whole = diagnose(spring, causes, records)
    assert [n.cause for n in whole.named] == ["hardening"]


def test_an_end_between_the_readings_of_tolerances_leaves_one_model(spring, causes, monkeypatch):
    """The set is then that of the search, with its own intervals."""

    def stopped(*_):
        raise Stop

    records = machine(3000.0, 3000.0, 3000.0, held_out="c")
    whole = diagnose(spring, causes, records)
    monkeypatch.setattr("unmodeled.search.verdict._kept", stopped)
    report = diagnose(spring, causes, records)
    assert not report.complete
    assert report.reported == whole.reported == ("hardening",)
    (c,) = report.channels
    left = np.concatenate([report.model.simulate(r)["force"] - r.outputs["force"] for r in records])
    assert np.sqrt(np.mean(left**2)) == pytest.approx(c.explained, rel=1e-6)
