"""A fit or diagnosis tells what it does, and ends early with what it knows."""

import os
import re
import shutil
import signal
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from feltmb.fit.watch import Ended, Watch
from feltmb.gap.findings import NotTested
from feltmb.gap.page import page
from feltmb.gap.resumed import discard

from feltmb.cli.common import ProgressLine, duration, interruptible
from feltmb.fit import Progress, watch
from feltmb.fit.calling import calling
from feltmb.gap import (
    Exposed,
    FunctionModel,
    Options,
    Parameter,
    Record,
    Sensor,
    SimulatorModel,
    diagnose,
    fit_model,
    law_errors,
)
from feltmb.gap.report import report_json

sys.path.insert(0, str(Path(__file__).parent))
import models

TIME = np.arange(240) * 1e-2
STAGES = [
    "checks of the data",
    "fit of the model",
    "search",
    "proof on held-out records",
    "report",
]


def wave(time, inputs, parameters):
    p = parameters
    bent = inputs["u"] + p["square"] * inputs["u"] ** 2 + p["cube"] * inputs["u"] ** 3
    return {"y": p["gain"] * bent + p["drift"] * time}


def record(name, phase, role="fit"):
    u = np.sin(3.0 * TIME + phase) + 0.5 * np.sin(7.0 * TIME)
    truth = {"gain": 1.05, "square": 0.2, "cube": 0.0, "drift": 0.0}
    noise = 1e-3 * np.random.default_rng(int(10 * phase)).standard_normal(TIME.size)
    y = wave(TIME, {"u": u}, truth)["y"] + noise
    sensors = {"y": Sensor(name="y", sigma=1e-3)}
    return Record(
        name=name, time=TIME, inputs={"u": u}, outputs={"y": y}, sensors=sensors, role=role
    )


RECORDS = [record("a", 0.0), record("b", 1.0), record("c", 2.0, "held_out")]


def model(sd=0.1):
    return SimulatorModel(
        wave,
        parameters=[Parameter(name="gain", value=1.0, sd=sd)],
        inputs=["u"],
        outputs=["y"],
        exposed={n: Exposed(scale=0.1) for n in ("square", "cube", "drift")},
        workers=1,
    )


def test_progress_tells_stage_simulations_misfit_and_what_is_left():
    m, told = model(), []
    report = diagnose(m, m.effects, RECORDS, progress=told.append)
    assert report.named == ("square",)
    assert report.stopped == ""
    assert list(dict.fromkeys(p.stage for p in told)) == STAGES
    work = next(p for p in told if "a step of the fit 6 runs or more" in p.detail)
    assert work.simulations <= 3  # before the runs that it announces
    assert "these checks need about 17 runs" in work.detail
    fit = [p for p in told if p.stage == "fit of the model"]
    assert any(re.fullmatch(r"start 1, \d+% of the records", p.detail) for p in fit)
    assert fit[-1].misfit is not None
    assert not any("takes" in w for w in report.checks.warnings)  # bytes without clock times
    made = [p.simulations for p in told]
    assert made == sorted(made)
    assert made[-1] == m.simulations
    search = [p for p in told if p.stage == "search"]
    assert all(p.about >= p.simulations > 0 for p in search if p.about)
    assert all((p.left is None) == (p.about == 0) for p in search)
    assert any(p.left is not None and p.left >= 0.0 for p in search)
    assert search[0].misfit > 100.0
    assert search[-1].misfit < 2.0


def test_stopped_before_the_model_is_fitted_nothing_is_claimed():
    m = model()
    report = diagnose(m, m.effects, RECORDS, stop=lambda: m.simulations > 0)
    assert report.verdict == "NOT COMPLETE"
    assert report.statement.startswith(
        "Stopped in the fit of the model (interrupted): whether there is a gap cannot be told yet. "
    )
    assert re.search(
        r"fit of the model, which has not converged, leaves \S+ times", report.statement
    )
    assert "the first candidate is square of " in report.statement
    assert np.isnan(report.confidence)
    assert "With an output folder" in report.next[0].text
    text = page(report)
    assert "Probability" not in text
    assert "nan" not in text
    assert report_json(report)["stopped"] == report.stopped
    assert report.named == report.one_of == ()
    assert report.stopped == "fit of the model (interrupted)"
    whole = model()
    diagnose(whole, whole.effects, RECORDS)
    assert m.simulations < 0.5 * whole.simulations


def test_stopped_in_the_search_the_best_so_far_is_told_with_what_was_not_tried():
    # Without a prior no sets are led along the records: each is refitted in the search.
    m, seen = model(sd=np.inf), []

    def stop():
        return sum(p.detail.startswith("refine") for p in seen) > 1

    report = diagnose(m, m.effects, RECORDS, progress=seen.append, stop=stop)
    assert report.statement.startswith("Stopped in the search (interrupted); ")
    assert "of 3 effects were not refitted" in report.statement
    assert report.verdict == "ONE OF"
    assert report.named == ()
    assert report.one_of[0] == "square"
    assert "Best so far: square" in report.statement
    assert report.how_far.closed > 0.9
    untried = {n.name for n in report.not_tested}
    assert untried
    assert untried <= {"cube", "drift"}


def test_numbers_of_a_fit_that_was_ended_have_no_interval(monkeypatch):
    monkeypatch.setattr(watch, "GRACE", 0.0)
    m, seen = model(sd=np.inf), []

    def stop():
        return sum(p.stage == "search" and "refine" in p.detail for p in seen) > 0

    report = diagnose(m, m.effects, RECORDS, progress=seen.append, stop=stop)
    (row,) = [r for r in report.which.effects if r.refitted]
    assert not row.converged
    assert re.search(rf"{row.effect} +\S+ +\S+ .*\n +\S* +not converged", report.text())
    assert f"{row.effect} of" in report.statement
    assert "(not converged)" in report.statement
    for page_of in (report._repr_html_(), page(report)):
        assert "not converged" in page_of
    assert all(r.converged for r in diagnose(m, m.effects, RECORDS).which.effects)
    fit = fit_model(model(), RECORDS, stop=lambda: True)
    assert not any(i.converged for i in fit.intervals())
    assert all(i.converged for i in fit_model(model(), RECORDS).intervals())


def test_refused_and_untested_effects_in_the_tables():
    m = model()
    report = diagnose(m, m.effects, RECORDS)
    untested = [NotTested(name=f"e{k}", why="too slow") for k in range(5)]
    report = replace(
        report,
        refused=(NotTested(name="cube", why="held-out gain -2"),),
        not_tested=(NotTested(name="other", why="not visible"), *untested),
    )
    text, html = report.text(), page(report)
    assert re.search(r"\n +x cube ", text)
    assert "x Refused (in the best set, but not named): cube (held-out gain -2)" in text
    assert "Not tested, 5 effects: too slow (e0, e1, e2 and 2 more)\n" in text
    assert "Not tested, 1 effect: not visible (other)\n" in text
    assert html.count("; refused") == 1  # in the table
    assert "6 effects were not tested" in html
    assert '<td>too slow</td><td class="num">5</td><td>e0, e1, e2, e3, e4</td>' in html


@pytest.mark.parametrize("stage", STAGES[1:])
def test_an_interrupt_ends_each_stage_within_few_steps(monkeypatch, stage):
    m, steps, step, seen, before = model(), [], Watch.step, [], []

    def counted(self):
        steps.append(self.stage)
        step(self)

    def stop():
        asked = stage in steps or any(p.stage == "report" for p in seen)
        if asked and not before:
            before.append(len(steps))
        return asked

    monkeypatch.setattr(Watch, "step", counted)
    monkeypatch.setattr(watch, "GRACE", 0.0)
    report = diagnose(m, m.effects, RECORDS, progress=seen.append, stop=stop)
    assert len(steps) - before[0] <= 20
    assert report.stopped == f"{stage} (interrupted)"
    if stage == "report":
        assert report.named == ("square",)
        assert report.statement.startswith("Stopped in the report (interrupted). ")
        return
    assert report.named == report.one_of == ()
    assert "NAMED" not in report.text()
    if stage in STAGES[2:4]:
        assert "the proof on held-out records is not complete" in report.statement
        assert report.verdict == "NOT COMPLETE"


def test_an_interrupt_ends_the_comparison_with_an_unknown_cause(monkeypatch):
    begun, inside, beats, beat, screened = [], [], [], Watch.beat, law_errors._screened

    def counted(self):
        beat(self)
        beats.extend(inside)

    def once(*given):
        begun.append(True)
        inside.append(True)
        try:
            return screened(*given)
        finally:
            inside.clear()

    monkeypatch.setattr(watch, "GRACE", 0.0)
    monkeypatch.setattr(Watch, "beat", counted)
    monkeypatch.setattr(law_errors, "_screened", once)
    seen = [
        models.record("a", 1.0, 1, dry=0.05),
        models.record("b", 1.5, 2, dry=0.05, role="held_out"),
    ]
    report = diagnose(models.NOMINAL, [models.DRY], seen, stop=lambda: bool(begun))
    assert len(begun) == 1
    assert not beats  # the derivatives with errors of form were not computed
    assert report.stopped == "proof on held-out records (interrupted)"
    assert report.verdict == "NOT COMPLETE"
    assert "the proof on held-out records is not complete" in report.statement
    assert report.named == report.one_of == ()


def test_without_a_name_a_search_that_was_stopped_is_not_complete():
    m, seen = model(sd=np.inf), []
    effects = [e for e in m.effects if e.name != "square"]
    whole = diagnose(m, effects, RECORDS)
    assert whole.verdict == "UNKNOWN"

    def stop():
        return sum(p.detail.startswith("refine") for p in seen) > 0

    report = diagnose(m, effects, RECORDS, progress=seen.append, stop=stop)
    assert report.verdict == "NOT COMPLETE"
    assert report.statement.startswith(
        "Stopped in the search (interrupted): the search for a cause is not complete. "
        "The present step was: refine: "
    )
    assert "There is a gap" in report.statement


def test_scores_have_some_time_after_an_interrupt(monkeypatch):
    def stopped(grace):
        monkeypatch.setattr(watch, "GRACE", grace)
        m, seen = model(), []

        def stop():
            return any(p.stage == "fit of the model" for p in seen)

        return diagnose(m, m.effects, RECORDS, progress=seen.append, stop=stop)

    report = stopped(np.inf)
    assert report.which.effects[0].effect == "square"
    assert {n.why for n in report.not_tested} == {
        "was scored to first order, but not refitted: the search was stopped before"
    }
    report = stopped(-1.0)
    assert report.verdict == "NOT COMPLETE"
    assert report.which.effects == ()
    assert {n.name: n.why for n in report.not_tested} == dict.fromkeys(
        ("square", "cube", "drift"), "the search was stopped before"
    )
    assert "first candidate" not in report.statement


def test_shares_that_take_too_long_are_left_out(monkeypatch):
    m, seen = model(sd=np.inf), []
    whole = diagnose(m, (), RECORDS, progress=seen.append)
    assert whole.calibrated[0].share > 0.0
    monkeypatch.setattr(watch, "GRACE", -1.0)
    m, seen = model(sd=np.inf), []

    def stop():
        return any(p.stage == "report" for p in seen)

    report = diagnose(m, (), RECORDS, progress=seen.append, stop=stop)
    assert report.calibrated[0].value == whole.calibrated[0].value
    assert np.isnan(report.calibrated[0].share)


def test_the_proof_has_some_time_after_an_interrupt(monkeypatch):
    m, seen = model(), []
    monkeypatch.setattr(watch, "GRACE", np.inf)

    def stop():
        return any(p.stage == "proof on held-out records" for p in seen)

    report = diagnose(m, m.effects, RECORDS, progress=seen.append, stop=stop)
    assert report.named == ("square",)
    assert report.stopped == "proof on held-out records (interrupted)"


def test_a_report_that_is_ended_says_why(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(watch.clock, "perf_counter", lambda: now[0])
    w = Watch(budget=60.0)
    for now[0], stage in ((40.0, "proof on held-out records"), (58.0, "report")):
        w.enter(stage)
        assert not w.proof_over()
    now[0] = 60.0 + 1.1 * watch.GRACE
    assert w.proof_over()
    assert (w.stopped_in, w.why) == ("report", "the budget of 60 s was spent")


def test_a_budget_is_told_and_must_be_positive():
    m = model()
    report = diagnose(m, m.effects, RECORDS, budget=1e-9)
    assert "fits may take 60% of the budget of 1e-09 s" in report.statement
    with pytest.raises(ValueError, match=r"budget = 0\.0 s, expected > 0"):
        diagnose(m, m.effects, RECORDS, budget=0.0)


def test_a_fit_that_is_stopped_says_so():
    m, told = model(), []
    fit = fit_model(m, RECORDS, progress=told.append, stop=lambda: True)
    assert not fit.converged
    assert fit.notes[0].startswith("stopped (interrupted): the fit is the best so far")
    assert not any("stopped" in n for n in fit_model(model(), RECORDS).notes)
    assert [p.stage for p in told][-1] == "fit of the model"


def test_what_was_cut_short_is_not_kept_for_the_next_run(tmp_path):
    cut = fit_model(model(), RECORDS, resume=tmp_path, stop=lambda: True)
    again = fit_model(model(), RECORDS, resume=tmp_path)
    assert again.cost < cut.cost
    assert again.cost == pytest.approx(fit_model(model(), RECORDS).cost)


def test_other_models_are_counted():
    m = FunctionModel(
        outputs={"y": lambda r, p: p.gain * r.inputs["u"]},
        parameters=[Parameter(name="gain", value=1.0, sd=0.1)],
    )
    told = []
    fit_model(m, RECORDS, progress=told.append)
    assert told[-1].stage == "fit of the model"
    seen = []
    fit_model(m, RECORDS, progress=seen.append, stop=lambda: True)
    assert told[-1].simulations >= seen[-1].simulations


def test_the_remaining_time_counts_what_is_known(monkeypatch):
    now, told = [0.0], []
    monkeypatch.setattr(watch.clock, "perf_counter", lambda: now[0])
    w = Watch(told.append)
    watch.simulated(1.0)
    w.enter("fit of the model")
    for now[0] in (1.0, 2.0, 3.0, 4.0):
        w.step()
    w.enter("search")  # at least 3 refits and 2 evaluations of 5 steps, usually 40 and 16 of 12
    assert (told[-1].left, told[-1].left_most) == (25.0, 12.0 * 56)
    w.expect(7)
    now[0] = 14.0
    w.expect(6)  # the first refit took 10 s
    w.say("refine: b")
    assert (told[-1].left, told[-1].left_most) == (6 * 10.0 + 2 * 10.0, 38 * 10.0 + 16 * 10.0)
    now[0] = 18.0
    w.say("refine: b")
    assert told[-1].left == 76.0
    for _ in range(40):
        w.expect(1)
    w.say("refine: c")
    assert told[-1].left_most is None  # more than usual
    w.enter("proof on held-out records")
    w.expect(2)
    now[0] = 48.0
    w.expect(1)  # the first evaluation took 30 s
    w.say("held-out: c")
    assert told[-1].left == 30.0
    limited = Watch(told.append, budget=100.0)
    limited._begin, limited._calls["search"] = 0.0, 4
    watch.simulated(1.0)
    limited.enter("search")
    assert told[-1].left_most == 52.0  # until the limit
    w.enter("report")
    assert told[-1].left is told[-1].left_most is None


def test_refits_that_were_ended_early_tell_nothing_about_the_time(monkeypatch):
    now, told, asked = [0.0], [], []
    monkeypatch.setattr(watch.clock, "perf_counter", lambda: now[0])
    w = Watch(told.append, stop=lambda: bool(asked))
    watch.simulated(1.0)
    w.enter("search")
    for now[0] in (1.0, 2.0, 3.0, 4.0):
        w.step()
    asked.append(True)
    w.expect(2)
    w.expect(1)
    w.enter("proof on held-out records")  # at least 2 evaluations of 5 steps
    assert told[-1].left == 10.0


def test_a_fit_with_more_steps_than_usual_may_take_any_time(monkeypatch):
    now, told = [0.0], []
    monkeypatch.setattr(watch.clock, "perf_counter", lambda: now[0])
    w = Watch(told.append, stages=STAGES[:2])
    watch.simulated(1.0)
    w.enter("fit of the model")
    for now[0] in map(float, range(1, 122)):
        w.step()
        if now[0] == 120.0:
            assert (told[-1].left, told[-1].left_most) == (0.0, 0.0)
    assert (told[-1].left, told[-1].left_most) == (0.0, None)


PROGRESS = Progress(
    stage="search",
    detail="refine: dry friction",
    simulations=241,
    about=830,
    misfit=1.0712,
    elapsed=8.2,
    left=200.0,
)


def test_the_line_of_progress(capsys):
    line = ProgressLine()
    line(PROGRESS)
    line(PROGRESS)  # no terminal: once a stage
    line.close()
    wanted = (
        "feltmb: search, 241 of at least 830 simulations, misfit 1.07, 8 s, at least 3:20 min "
        "left: refine: dry friction\n"
    )
    assert capsys.readouterr().err == wanted
    assert "8 s, 3:20 min to 8:20 min left" in line.text(replace(PROGRESS, left_most=500.0))
    assert duration(5400.0) == "90:00 min"
    assert duration(7500.0) == "2:05 h"


@pytest.fixture
def heard():
    """SIGINT is heard: a shell starts background jobs with it ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("heard")
def test_the_first_interrupt_asks_and_the_second_ends(capsys):
    def second(stop):
        assert not stop()
        os.kill(os.getpid(), signal.SIGINT)
        assert stop()
        os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt), interruptible() as stop:
        second(stop)
    assert "ends within seconds with the results so far" in capsys.readouterr().err
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.usefixtures("heard")
def test_no_interrupt_stops_the_writing_of_results(capsys):
    with interruptible() as stop:
        os.kill(os.getpid(), signal.SIGINT)
        stop.writing()
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)
    assert stop()
    assert capsys.readouterr().err.count("writes the results, without further pictures") == 2


MODEL = """
import numpy as np
from feltmb.gap import Exposed, Parameter, SimulatorModel

def wave(time, inputs, parameters):
    return {"y": parameters["gain"] * inputs["u"] + parameters["drift"] * time}

model = SimulatorModel(
    wave,
    parameters=[Parameter(name="gain", value=1.0, sd=0.1)],
    inputs={"u": "N"},
    outputs={"y": "m"},
    exposed={"drift": Exposed(scale=0.1, unit="m/s")},
)
effects = model.effects
"""


def test_budget_of_the_command_line(tmp_path, capsys, monkeypatch):
    from feltmb.cli import main

    monkeypatch.chdir(tmp_path)
    (tmp_path / "m.py").write_text(MODEL)
    u = np.sin(3.0 * TIME)
    y = 1.05 * u + 0.03 * TIME + 1e-3 * np.random.default_rng(0).standard_normal(TIME.size)
    rows = "\n".join(f"{a:.6g},{b:.9g},{c:.9g}" for a, b, c in zip(TIME, u, y, strict=True))
    (tmp_path / "r.csv").write_text(f"time [s],u [N],y [m]\n{rows}\n")

    def run(*words):
        with pytest.raises(SystemExit) as end:
            main(list(words))
        assert not end.value.code
        return capsys.readouterr()

    said = run("gap", "diagnose", "m.py", "r.csv", "--budget", "1us", "-o", "out")
    stopped = "Stopped in the fit of the model (fits may take 60% of the budget of 1e-06 s)"
    assert stopped in said.out.replace("\n", " ")
    assert "feltmb: checks of the data" in said.err
    assert "feltmb: proof on held-out records" in said.err
    assert "finished fits" not in said.err  # none was finished
    other = Path("out/.resume/other")
    other.mkdir()
    (other / "fit.npz").write_bytes(bytes(2_300_000))
    said = run("gap", "diagnose", "m.py", "r.csv", "-o", "out", "--force")
    assert f"{other.parent} keeps finished fits of interrupted runs (about 2.3 MB)" in said.err
    assert other.is_dir()
    said = run("fit", "m.py", "r.csv", "--budget", "1us", "-o", "out", "--force")
    assert "note: stopped" in said.out
    assert "(about 2.3 MB)" in said.err
    said = run("fit", "m.py", "r.csv", "-o", "out", "--force")  # finished
    assert sorted(p.name for p in other.parent.iterdir()) == ["other"]
    shutil.rmtree(other.parent)
    said = run("gap", "diagnose", "m.py", "r.csv", "-o", "out", "--force")
    assert "finished fits" not in said.err
    assert "m" not in sys.modules  # the module of the user's file


def test_a_rerun_tells_what_it_reuses(tmp_path):
    def begun(m, records=RECORDS, after=("refine", 2), **more):
        options = Options(resume=tmp_path, **more)
        told = []

        def stop():
            return sum(p.detail.startswith(after[0]) for p in told) > after[1]

        report = diagnose(m, m.effects, records, None, options, told.append, stop=stop)
        assert [p.notice for p in told if p.notice] == [report.resumed]
        return report.resumed

    assert begun(model(sd=np.inf)) == "starts anew: the folder holds no unfinished diagnosis"
    again = begun(model(sd=np.inf))
    assert again.startswith("resumes the diagnosis of 2")
    assert re.search(
        r": fits of the model and \d sets? with [123] of 3 candidates are reused$", again
    )
    assert begun(model(sd=np.inf), alpha=0.02).endswith(
        "; the option alpha changed, which other fits may need"
    )
    other = [replace(RECORDS[0], time=RECORDS[0].time + 0.001), *RECORDS[1:]]
    notes = tmp_path / "notes.json"
    notes.write_text('{"of": "the user"}')
    changed = begun(model(sd=np.inf), other)
    assert "starts anew, because record a changed since 2" in changed
    assert changed.endswith("; the fits of then are kept")
    assert begun(model(sd=np.inf), alpha=0.02) == again  # who returns finds his fits
    assert notes.exists()
    assert "starts anew, because the model (gain) changed" in begun(model(sd=0.2), other)
    fewer = [*other[:2], replace(other[2], outputs={"y": 2.0 * other[2].outputs["y"]})]
    assert "because record c changed" in begun(model(sd=0.2), fewer)
    assert diagnose(model(), (), RECORDS).resumed == ""
    begun(model(sd=np.inf), RECORDS[1:], after=("score", 0))
    assert begun(model(sd=np.inf), RECORDS[1:]).endswith(": fits of the model are reused")


def test_the_fits_of_a_finished_diagnosis_are_discarded_alone(tmp_path):
    folders = []
    for seen in (RECORDS, [replace(RECORDS[0], time=RECORDS[0].time + 0.001), *RECORDS[1:]]):
        options = Options(resume=tmp_path / "fits")
        folders.append(diagnose(model(), (), seen, None, options).fits)
    first, second = folders
    assert first.parent == second.parent == tmp_path / "fits"
    discard(first)
    assert second.is_dir()
    assert not first.exists()
    discard(second)
    assert not (tmp_path / "fits").exists()


def test_the_end_of_the_time_is_no_fault_of_a_model():
    with pytest.raises(Ended), calling("model m: its simulation"):
        raise Ended
