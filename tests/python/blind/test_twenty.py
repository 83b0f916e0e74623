"""Blind cases: the whole engine on sealed truths; two in every run, twenty in the slow tests."""

import pytest

from blind.bench import Bench
from blind.score import read

SEED = 1


@pytest.fixture(scope="module", params=[2, pytest.param(20, marks=pytest.mark.slow)])
def cases(request, tmp_path_factory):
    bench = Bench(tmp_path_factory.mktemp("twenty") / "b")
    bench.seal(request.param, SEED)
    bench.make_records(workers=2)
    bench.diagnose(workers=2, oracle=False)
    bench.make_answers(workers=2)
    found = read(bench.folder, bench.numbers("both"))
    assert len(found) == request.param
    return found


def test_none_fails(cases):
    assert not [c.result["error"] for c in cases if c.failed]


def test_nothing_is_named_where_there_is_nothing(cases):
    assert not [(c.number, c.verdict) for c in cases if c.kind == 0 and c.claims]


def test_few_are_confident_and_wrong(cases):
    wrong = [(c.number, c.truth, c.named) for c in cases if c.wrong()]
    assert len(wrong) <= 1, wrong


def test_what_stands_out_is_named_first(cases):
    plain = [c for c in cases if c.kind == 1 and c.strength >= 5.0]
    missed = [(c.number, c.truth, c.ranking[:2]) for c in plain if not c.top(1)]
    assert len(missed) <= 0.2 * len(plain), missed


def test_causes_from_outside_are_not_passed_over(cases):
    silent = [c.number for c in cases if c.kind == 4 and not c.flagged()]
    assert len(silent) <= 1, silent
