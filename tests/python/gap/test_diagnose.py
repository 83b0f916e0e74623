"""Verdicts on records whose truth is known, and on measured ones."""

import copy
import importlib.util
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from feltmb.data import read_records
from feltmb.fit.problem import Problem
from feltmb.fit.segmented_records import Noise, segment_record
from feltmb.fit.solve import fit_problem
from feltmb.gap import Jobs, Options, Verdict, diagnose, fit_model, including, library
from feltmb.gap.page import page
from feltmb.gap.refine import refit
from feltmb.gap.report import report_json
from feltmb.gap.score import all_candidates, family_threshold, score_fit, screen_sets

HERE = Path(__file__).parent
ROOT = HERE.parents[2]
EXAMPLES = ROOT / "examples" / "gap"


def load(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


models = load(HERE / "models.py")


def test_score_predicts_the_refit():
    data = models.records(1, dry=2e-3)[:2]
    segmented_records = tuple(
        segment_record(models.NOMINAL, r, {"q": Noise(1e-4)}, None) for r in data
    )
    problem = Problem(models.NOMINAL, segmented_records, state_scale=np.array([0.01, 0.1]))
    fit = fit_problem(problem)
    scores = score_fit(fit, all_candidates(models.EFFECTS))
    again = refit(fit, (scores.candidates[0],), np.array([scores.one_step()[0] * 0.05]), _quick())
    gained = fit.cost - again.cost if again.level == fit.level else scores.singles()[0]
    assert gained == pytest.approx(scores.singles()[0], rel=0.1)
    assert screen_sets(scores)[0].index == (0,)


def _quick():
    from feltmb.fit.solve import FitSettings

    return FitSettings(levels=(1e-5,), restarts=0)


def test_family_threshold_is_that_of_chi_square_for_one_effect():
    data = models.records(1)[:1]
    segmented_records = tuple(
        segment_record(models.NOMINAL, r, {"q": Noise(1e-4)}, None) for r in data
    )
    fit = fit_problem(Problem(models.NOMINAL, segmented_records))
    scores = score_fit(fit, all_candidates([models.CUBIC]))
    level, _ = family_threshold(scores, 0.05)
    assert level == pytest.approx(3.84, rel=0.05)
    one_sided, _ = family_threshold(score_fit(fit, all_candidates([models.DRY])), 0.05)
    assert one_sided == pytest.approx(2.71, rel=0.06)  # chi-bar-square


@pytest.mark.parametrize("seed", range(3))
def test_no_gap_without_an_effect(seed):
    report = diagnose(models.NOMINAL, models.EFFECTS, models.records(seed))
    assert report.verdict in (Verdict.CALIBRATED, Verdict.TOO_WEAK)
    assert report.named == ()


@pytest.mark.parametrize(
    ("what", "named"),
    [
        ({"dry": 0.02}, {"dry friction"}),
        ({"cubic": 1500.0}, {"cubic stiffness"}),
        ({"dry": 0.02, "cubic": 1500.0}, {"dry friction", "cubic stiffness"}),
    ],
)
def test_withheld_effects_are_named(what, named):
    report = diagnose(models.NOMINAL, models.EFFECTS, models.records(4, **what))
    assert report.verdict is Verdict.NAMED
    assert set(report.named) == named
    assert report.how_far.closed > 0.9
    for name, size in (("dry friction", "dry"), ("cubic stiffness", "cubic")):
        if name in named:
            row = report.which[name]
            assert abs(row.magnitude - what[size]) < 4.0 * row.sd
    shares = dict(report.how_far.waterfall)
    total = sum(-shares[n] for n in named)
    assert shares["as tabulated"] + shares["calibration"] - total == pytest.approx(
        shares["unexplained"] + shares["noise"], rel=1e-6
    )


def test_an_effect_outside_the_library_is_not_named():
    data = models.records(4, dry=0.02)
    report = diagnose(models.NOMINAL, [models.CUBIC], data)
    assert report.verdict is Verdict.UNKNOWN
    assert report.named == ()
    # Where it lies is told with the noise of the sensors, though the rest was admitted as noise.
    mass = report.where.components[0]
    assert mass.component == "mass"
    assert mass.significant
    assert mass.explained > 0.5
    assert (
        f"An unknown force at mass would explain {mass.explained:.0%} of the gap"
        in report.statement
    )
    assert sum(c.significant for c in report.where.ledger) > len(report.where.ledger) / 4


def test_a_recovered_force_is_told_by_its_form():
    for what, told in (({"dry": 0.3}, "the sign of the speed"), ({"cubic": 2e5}, "the cube of")):
        data = models.records(3, **what)
        report = diagnose(models.NOMINAL, models.EFFECTS, data, None, Options(bootstrap=0))
        mass = report.where.components[0]
        assert mass.explained > 0.9
        assert told in mass.signature


def test_report_is_the_same_bytes_and_escapes_text():
    data = models.records(4, dry=0.02)
    options = Options(bootstrap=0, restarts=0)
    first, second = (diagnose(models.NOMINAL, models.EFFECTS, data, None, options) for _ in "ab")
    assert page(first) == page(second)
    text = json.dumps(report_json(first), sort_keys=True, allow_nan=False)
    assert text == json.dumps(report_json(second), sort_keys=True, allow_nan=False)
    assert "&lt;against&gt;" in page(first)
    assert "<against>" not in page(first)


@pytest.mark.parametrize("noise", [{}, pytest.param({"f": 0.01}, marks=pytest.mark.slow)])
def test_cut_off_run_resumes(tmp_path, noise):
    data = [replace(r, input_sigma=noise) for r in models.records(4, dry=0.02)]
    options = Options(bootstrap=0, restarts=0, resume=tmp_path / "resume")

    class Stop(Exception):
        pass

    def cut(told):
        if told.detail.startswith("held-out"):
            raise Stop

    with pytest.raises(Stop):
        diagnose(models.NOMINAL, models.EFFECTS, data, None, options, cut)
    kept = len(list((tmp_path / "resume").rglob("*.npz")))
    assert kept > 5
    resumed = diagnose(models.NOMINAL, models.EFFECTS, data, None, options)
    fresh = diagnose(models.NOMINAL, models.EFFECTS, data, None, Options(bootstrap=0, restarts=0))
    assert page(resumed) == page(fresh)


def test_an_edited_prior_is_not_taken_from_a_cut_off_run(tmp_path):
    data = models.records(4)
    for sd in (1e-4, 10.0):  # at its start a fit does not feel the tolerance
        free = [replace(p, sd=sd) if p.name == "k" else p for p in models.NOMINAL.parameters]
        model = copy.copy(models.NOMINAL)
        model.parameters = tuple(free)
        found = fit_model(model, data, resume=tmp_path / "resume")
        fresh = fit_model(model, data)
        assert [i.value for i in found.intervals()] == [i.value for i in fresh.intervals()]


def test_emps_names_dry_friction():
    """Measured: mass and viscous friction only; withheld is the dry friction of the guide."""
    adapter = load(EXAMPLES / "emps.py")
    data = read_records(sorted((EXAMPLES / "data").glob("emps_*.csv")))
    report = diagnose(adapter.model, adapter.effects, data)
    assert report.named[0] == "dry friction"
    row = next(r for r in report.how_far.rows if r.metric == "open loop")
    spread = float(np.sqrt(np.mean(data[1].outputs["force"] ** 2)))
    assert row.before / spread > 0.17
    assert row.after / spread < 0.095  # what a plain trial reached
    assert report.model.parameters["mass"] == pytest.approx(95.3, rel=0.02)


def test_an_early_record_of_an_input_is_a_data_problem():

    late = []
    for r in models.records(4):
        force = np.interp(r.time + 0.004, r.time, r.inputs["f"])
        late.append(replace(r, inputs={"f": force}))  # the record shows the force too early
    effects = (*models.EFFECTS, library.delay_input("f", scale=0.002))
    report = diagnose(models.NOMINAL, effects, late)
    assert report.verdict is Verdict.DATA_PROBLEM
    assert report.named == ("delay of input f",)
    assert report.which["delay of input f"].magnitude == pytest.approx(-0.004, rel=0.05)


@pytest.mark.parametrize("count", [2, 3])
def test_a_drive_that_acts_late_from_the_first_sample(count):
    """The input of a machine at rest is not zero at the first sample, and acts 6 ms later.

    Two records are divided into blocks, whose inputs depend on the blocks before them.
    """
    late = []
    for k in range(count):
        r = models.record("r", 1.0, k)
        time = np.linspace(0.0, r.time[-1], 4 * (r.samples - 1) + 1)
        step, steps = 1.0 + k, np.interp(time, r.time, r.inputs["f"])
        acting = np.where(time < 0.006, 0.0, step + np.interp(time - 0.006, time, steps))
        fine = replace(r, time=time, inputs={"f": acting}, outputs={"q": np.zeros(time.size)})
        jobs = Jobs(
            theta=models.TRUTH[None, :],
            segments=np.array([[0, fine.samples - 1]]),
            starts=np.zeros((1, 2)),
            included=(),
            magnitudes=np.zeros((1, 0)),
        )
        moved = models.NOMINAL.simulate(fine, jobs).outputs[0, ::4, 0]
        noise = 1e-4 * np.random.default_rng(100 + k).standard_normal(r.samples)
        shown = {"f": step + r.inputs["f"]}
        late.append(replace(r, name=f"r{k}", inputs=shown, outputs={"q": moved + noise}))
    effects = (*models.EFFECTS, library.delay_input("f", scale=0.002))
    report = diagnose(models.NOMINAL, effects, late)
    assert report.verdict is Verdict.DATA_PROBLEM
    assert report.named == ("delay of input f",)
    # The model interpolates the step over one sample, which is half a sample early.
    assert report.which["delay of input f"].magnitude == pytest.approx(-0.006, abs=0.0021)
    assert report.statement.startswith("The records or the drive, not the machine")


def test_missing_rows_are_no_gap():
    """The rows of 8 samples are missing, while the force changes from sample to sample."""
    random = np.random.default_rng(8)
    shown = []
    for k in range(3):
        r = models.record("r", 1.0, k)
        force = np.repeat(random.choice([-1.0, 1.0], r.samples // 3), 3)
        jobs = Jobs(
            theta=models.TRUTH[None, :],
            segments=np.array([[0, r.samples - 1]]),
            starts=np.zeros((1, 2)),
            included=(),
            magnitudes=np.zeros((1, 0)),
        )
        driven = replace(r, name=f"r{k}", inputs={"f": force})
        clean = models.NOMINAL.simulate(driven, jobs).outputs[0, :, 0]
        kept = np.delete(np.arange(r.samples), np.arange(200, 208))
        shown.append(
            replace(
                driven,
                time=r.time[kept],
                inputs={"f": force[kept]},
                outputs={"q": (clean + 1e-4 * random.standard_normal(r.samples))[kept]},
            )
        )
    report = diagnose(models.NOMINAL, models.EFFECTS, shown, hold_out="r2")
    assert report.verdict is Verdict.CALIBRATED
    assert any("8 rows are missing" in w for w in report.checks.warnings)


def test_known_sensors_are_applied_to_the_model():
    from feltmb.gap import Sensor

    seen = []
    for r in models.records(4):
        q = np.interp(r.time - 0.008, r.time, r.outputs["q"], left=r.outputs["q"][0])
        sensor = Sensor(name="q", unit="m", sigma=1.1e-4, gain=2.0, offset=0.01, delay=0.008)
        seen.append(
            replace(r, outputs={"q": 2.0 * q + 0.01}, sensors={"q": replace(sensor, sigma=2.2e-4)})
        )
    report = diagnose(models.NOMINAL, models.EFFECTS, seen)
    assert report.named == ()
    for row, truth in zip(report.fit.intervals(), models.TRUTH, strict=True):
        assert abs(row.value - truth) < 0.02 * truth


@pytest.mark.slow
def test_silverbox_names_the_cubic_stiffness():
    """Measured: a linear model; withheld is the cubic stiffness of the oscillator."""
    adapter = load(EXAMPLES / "silverbox.py")
    data = read_records(sorted((EXAMPLES / "data").glob("silverbox_*.nc")))
    report = diagnose(adapter.model, adapter.effects, data)
    assert "cubic stiffness mass" in report.named
    row = next(r for r in report.how_far.rows if r.metric == "open loop")
    assert row.after < 0.3 * row.before


@pytest.mark.slow
def test_tanks_name_the_overflow():
    """Measured: square-root outflow; withheld is the overflow of the upper tank."""
    adapter = load(EXAMPLES / "tanks.py")
    data = read_records(sorted((EXAMPLES / "data").glob("tanks_*.csv")))
    report = diagnose(adapter.model, adapter.effects, data)
    assert report.named[0] == "overflow upper"
    row = next(r for r in report.how_far.rows if r.metric == "open loop")
    assert row.before > 0.6
    assert row.after < 0.574  # what a plain trial reached
    # With what was found included there is no overflow to be found, and the gap is the smaller one.
    with_effects = report.model
    model = including(adapter.model, with_effects.included, with_effects.magnitudes)
    left = [e for e in adapter.effects if e.name not in [t.name for t in with_effects.included]]
    again = diagnose(model, left, data)
    smaller = next(r for r in again.how_far.rows if r.metric == "open loop")
    assert smaller.before < 1.05 * row.after
    assert smaller.after <= smaller.before


@pytest.mark.slow
def test_false_alarms_are_rare():
    """Thirty records without an effect, a library of twenty: not one alarm is expected."""

    alarms = []
    for seed in range(100, 130):
        data = models.records(seed)
        effects = library.standard_effects(
            ["q"], ["f"], [models.MASS], data[0], force=1.0, travel=0.02, speed=0.2
        )
        report = diagnose(models.NOMINAL, effects, data, options=Options(seed=seed))
        if report.verdict not in (Verdict.CALIBRATED, Verdict.TOO_WEAK):
            alarms.append((seed, report.verdict, report.named))
    assert len(alarms) <= 2, alarms
