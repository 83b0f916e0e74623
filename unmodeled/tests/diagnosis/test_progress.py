"""Stage, share and time left of a diagnosis, with a clock of its own."""

from __future__ import annotations

import math

import pytest

from unmodeled import InvalidParameter, Options, Progress, diagnose
from unmodeled.cli.screen import ProgressLine
from unmodeled.search.progress import ENDS, Limit, Meter, Stop

from .conftest import spring_record


class Run:
    """A diagnosis whose steps take known times."""

    def __init__(self, seconds=120.0):
        self.now, self.seen = 0.0, []
        self.meter = Meter(self.seen.append, seconds, clock=lambda: self.now)

    def stage(self, name, *steps):
        """A stage with the durations of its first part and of its steps."""
        self.meter.stage(name)
        for k, duration in enumerate(steps):
            if k:
                self.meter.step()
            self.now += duration

    def ratio_at_half(self):
        """Estimated over true time left at half time."""
        last = [p for p in self.seen if p.elapsed <= 0.5 * self.now][-1]
        return (last.left - (0.5 * self.now - last.elapsed)) / (0.5 * self.now)


def typical(rounds, steps=9, scale=1.0, after=24):
    run = Run(1e3)
    run.stage("prepare", 2.0 * scale)
    run.stage("fit", *[0.5 * scale] * 8)
    for k in range(rounds):
        run.stage("search", 3.0 * scale, *[scale * (1.0 + 0.3 * k)] * steps)
    if rounds > 1:
        run.stage("exchange", *[scale] * 6)
    run.stage("held_out", *[0.4 * scale] * after)
    run.stage("judge", 0.2 * scale)
    run.stage("locate", 0.5 * scale)
    run.meter.stage("done")
    return run


@pytest.mark.parametrize("scale", [0.5, 1.0, 2.0])
@pytest.mark.parametrize(("rounds", "steps", "after"), [(1, 7, 20), (1, 12, 30), (2, 9, 24)])
def test_time_left_is_true_within_a_factor_of_two_at_half_time(rounds, steps, after, scale):
    assert 0.5 < typical(rounds, steps, scale, after).ratio_at_half() < 2.0


def test_share_never_decreases_and_ends_at_one():
    seen = typical(3).seen
    shares = [p.share for p in seen]
    assert shares == sorted(shares)
    assert seen[-1] == Progress("done", 1.0, 0.0, seen[-1].elapsed)
    assert math.isnan(seen[0].left)  # nothing is known yet


def test_each_stage_ends_at_its_share_however_long_it_takes():
    run = Run(1e9)
    for name in ("prepare", "fit", "search", "exchange", "held_out", "judge", "locate"):
        run.stage(name, 1.0, *[100.0] * 50)
        run.meter.step()
        assert run.seen[-1].share <= ENDS[name] <= 1.0
    assert run.seen[-1].share == pytest.approx(1.0, abs=0.01)


def test_the_fits_are_expected_to_end_at_their_limit():
    left = []
    for seconds in (20.0, 1e6):
        run = Run(seconds)
        run.stage("prepare", 2.0)
        run.stage("fit", *[1.0] * 8)
        run.stage("search", 3.0, 3.0)
        run.meter.step()
        left.append(run.seen[-1].left)
    # 16 s have passed: 4 s of fits and the verdict remain, not as much as has passed.
    assert 4.0 < left[0] < 6.0
    assert 8.0 < left[1] < 24.0


def test_a_diagnosis_tells_all_stages(spring, causes):
    records = [spring_record(n, k, hardening=2000.0) for n, k in (("a", 2), ("b", 5), ("c", 3))]
    seen = []
    diagnose(spring, causes, records, progress=seen.append)
    stages = list(dict.fromkeys(p.stage for p in seen))
    assert stages == [
        "prepare", "fit", "search", "exchange", "held_out", "judge", "locate", "done",
    ]  # fmt: skip
    assert seen[-1].share == 1.0


def test_the_time_that_is_needed_is_told_before_the_search():
    clock = [0.0]
    seen = []
    meter = Meter(seen.append, 100.0, clock=lambda: clock[0])
    clock[0] = 90.0
    meter.stage("fit")
    meter.stage("search")  # the model alone has taken 90 s, a third of the whole time
    assert seen[-1].left < 20.0
    assert seen[-1].needed == pytest.approx(90.0 / 0.3, rel=0.01)
    assert "all causes need about 5:00 min (--seconds)" in ProgressLine.text(seen[-1])
    assert "--seconds" not in ProgressLine.text(Progress("search", 0.3, 200.0, 90.0, 290.0))


def test_no_step_begins_that_would_end_after_the_limit():
    now = [0.0]
    limit = Limit(10.0, clock=lambda: now[0])
    for duration in (1.0, 3.0, 2.0):
        limit()
        now[0] += duration
    limit()  # 6 s, and the longest step takes 3 s
    now[0] += 2.0
    with pytest.raises(Stop):
        limit()


def test_a_limit_of_rounds_does_not_depend_on_the_time():
    now = [0.0]
    limit = Limit(math.inf, clock=lambda: now[0], most=3)
    for duration in (1.0, 1e9, 0.0):
        limit()
        now[0] += duration
    with pytest.raises(Stop):
        limit()
    assert limit.steps == 3


def test_a_search_with_a_limit_of_rounds_has_one_answer(spring, causes):
    records = [spring_record(f"r{k}", 2 + k, seed=k, hardening=2000.0) for k in range(3)]
    whole = diagnose(spring, causes, records)
    assert whole.complete
    assert whole.rounds > 8
    again = diagnose(spring, causes, records, options=Options(rounds=whole.rounds * 2))
    assert (again.summary(), again.rounds) == (whole.summary(), whole.rounds)
    cut = [diagnose(spring, causes, records, options=Options(rounds=5)) for _ in range(2)]
    assert cut[0].sets == cut[1].sets
    assert not cut[0].complete
    assert cut[0].rounds == 5
    assert "after 5 rounds of simulations" in cut[0].text(400)
    with pytest.raises(InvalidParameter, match="rounds = 0, expected from 1 on"):
        Options(rounds=0)
