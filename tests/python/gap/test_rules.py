"""What an effect must show before it is named."""

import importlib.util
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from blind.bench import Bench
from blind.key_hammer import KeyHammer
from feltmb.data import Record, Sensor
from feltmb.fit.linear import LinearModel
from feltmb.fit.linearize import Linear, _tame
from feltmb.fit.model import Candidate, Effect, Parameter
from feltmb.fit.problem import Problem, _by_input_noise
from feltmb.fit.segmented_records import Noise, segment_record
from feltmb.fit.solve import FitSettings, fit_problem
from feltmb.gap import Options, Verdict, diagnose
from feltmb.gap.acceptance import Posterior, _Attempt, _certainty, sure_part
from feltmb.gap.decide import _probable, decide
from feltmb.gap.digits import digits
from feltmb.gap.investigate import Task, _explained
from feltmb.gap.page import page
from feltmb.gap.refine import refit
from feltmb.gap.report import write_report
from feltmb.gap.search import search
from feltmb.gap.sizes import Size
from feltmb.gap.where import onset_of

_spec = importlib.util.spec_from_file_location("models", Path(__file__).parent / "models.py")
models = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(models)

NOISE = 0.01
LINE = LinearModel(
    output="y",
    columns={"slope": lambda record: record.inputs["u"]},
    parameters=[Parameter(name="slope", value=1.0, sd=0.1)],
    name="line",
)


def power(n):
    return Effect(
        name=f"power {n}",
        component="spring",
        unit="1",
        scale=0.1,
        regressor=lambda record, shape: record.inputs["u"] ** n,
    )


def record(name, seed, law, role="fit", samples=400, noise=NOISE):
    generator = np.random.default_rng(seed)
    u = np.sin(np.linspace(0.0, 40.0, samples) + seed) * (0.6 + 0.4 * generator.random())
    y = law(u) + noise * generator.standard_normal(samples)
    return Record(
        name=name,
        time=np.arange(samples) * 1e-3,
        inputs={"u": u},
        outputs={"y": y},
        sensors={"y": Sensor(name="y", unit="1", sigma=noise)},
        role=role,
    )


def records(law, noise=NOISE):
    roles = ("fit", "fit", "fit", "held_out", "held_out")
    return [record(f"r{i}", i, law, role, noise=noise) for i, role in enumerate(roles)]


def test_the_statement_tells_what_held_out_records_say(decided):
    report = diagnose(
        LINE, [power(3)], records(lambda u: u + 0.05 * u**3), options=Options(bootstrap=0)
    )
    facts = decided[-1]
    assert report.named == ("power 3",)
    assert f"closes {report.how_far.closed:.0%} of the held-out gap" in report.statement
    far = facts.how_far
    within = replace(far, before=0.98, closed=0.0, low=0.0)
    gain = f"{facts.accepted.proof['power 3']:.2g}"
    said = decide(replace(facts, how_far=within))
    assert said.named == ("power 3",)
    assert f"hardly above their noise, gain {gain} units of log evidence by it" in said.statement
    stopped = replace(within, before=np.inf)
    assert "cannot simulate" in decide(replace(facts, how_far=stopped)).statement
    # Held-out records that surely get worse refuse a name; those that may do not.
    maybe = decide(replace(facts, how_far=replace(far, closed=-0.1, low=-0.4, high=0.2)))
    assert maybe.named == ("power 3",)
    assert "closes -10% of the held-out gap, 95% from -40% to 20%" in maybe.statement
    unclear = replace(far, closed=0.9, low=-0.4, high=1.0)
    band = "95% from -40% to 100%"
    shown = decide(replace(facts, how_far=unclear))
    assert f"closes an undetermined share of the held-out gap, {band}" in shown.statement
    said = replace(report, how_far=unclear)
    closes = f"closes an undetermined share of the calibrated gap ({band})"
    assert closes in " ".join(str(said).split())
    assert closes in page(said)
    assert "closes an undetermined share of the held-out gap" in repr(said)
    grown = replace(far, closed=-0.3, low=-0.5, high=-0.1)
    trifle = replace(grown, before=1.3, after=1.31)
    assert decide(replace(facts, how_far=trifle)).named == ("power 3",)
    grown = replace(facts, how_far=replace(grown, before=1.3, after=1.8))
    assert decide(grown).named == ("power 3",)  # the fitted parameters are that uncertain
    own = facts.accepted.after
    own = replace(own, predicted=replace(own.predicted, explains=False))
    worse = decide(replace(grown, accepted=replace(facts.accepted, after=own)))
    assert worse.named == ()
    assert worse.verdict == Verdict.UNKNOWN
    assert "the held-out gap grows, 95% from -50% to -10%" in worse.statement
    assert "There is a gap (the sum of squares is 1.19 times that of noise; " in worse.statement
    # Only what shows the gap is told as its sign.
    below = replace(facts.misfit, left=True, far=False, other=50.0)
    refused = replace(grown, accepted=replace(facts.accepted, after=own), p=0.9, misfit=below)
    said = decide(refused).statement
    assert (
        "There is a gap (a smooth signal is more probable than noise, log Bayes factor 50)" in said
    )
    far_off = replace(refused, misfit=replace(below, far=True, other=0.0))
    assert "There is a gap (the sum of squares is" in decide(far_off).statement

    # If more than noise is left, the effect must explain more than remains.
    most = replace(far, before=3.0, after=2.0, closed=0.5, low=0.4, high=0.6)
    part = replace(most, after=2.6, closed=0.2, low=0.1, high=0.3)
    assert decide(replace(facts, how_far=part)).verdict == Verdict.NAMED
    said = decide(replace(facts, unexplained=True, how_far=most))
    assert said.verdict == Verdict.NAMED_RESIDUAL
    assert said.named == ("power 3",)
    said = decide(replace(facts, unexplained=True, how_far=part))
    assert said.verdict == Verdict.UNKNOWN
    assert "it explains less of the squared gap than remains" in said.statement


def sized(report, name):
    """Magnitude, unit and interval of an effect in the words of a statement."""
    row = report.which[name]
    shown = digits(row.magnitude, row.sd, 3)
    unit = "" if row.unit == "1" else f" {row.unit}"
    return (
        f"{name} of {row.magnitude:.{shown}g}{unit} (95% from {row.low:.{shown}g} to "
        f"{row.high:.{shown}g}{unit})"
    )


@pytest.mark.parametrize(
    ("unit", "magnitude", "sd", "told"),
    [
        ("m", 0.0, 0.001, "0 mm (95% from -1.96 to 1.96 mm)"),  # was 0 um, from -1.96e+03
        ("m", 0.997, 0.015, "0.997 m (95% from 0.968 to 1.03 m)"),  # was 997 mm, to 1.03e+03
        ("m", 2e-4, 1e-5, "0.2 mm (95% from 0.18 to 0.22 mm)"),
        ("rad", 2e-4, 1e-5, "0.0002 rad (95% from 0.00018 to 0.00022 rad)"),
        ("1", 0.02, 0.001, "0.02 (95% from 0.018 to 0.022)"),
        ("m", 1e-4, np.inf, "0.1 mm (no finite 95% interval)"),
    ],
)
def test_a_size_and_its_interval_have_one_unit(unit, magnitude, sd, told):
    one = Candidate(replace(power(3), unit=unit))
    assert Size(one, magnitude, sd, {}).text == f"power 3 of {told}"


def test_a_named_effect_is_told_with_its_size_and_in_words(tmp_path):
    """Verdicts that name something gave no number before their tables."""
    bent = replace(power(3), unit="N/m^3", mechanism="The spring is harder at its ends.")
    report = diagnose(
        LINE, [bent], records(lambda u: u + 0.05 * u**3), options=Options(bootstrap=0)
    )
    row = report.which["power 3"]
    assert row.low < 0.05 < row.high
    told = sized(report, "power 3")
    assert " N/m^3 (95% from " in told
    closed = f"It closes {report.how_far.closed:.0%} of the held-out gap."
    assert report.statement == (
        f"The model lacks: {told}. {closed} What is left is noise. power 3: The spring is harder "
        "at its ends."
    )
    # The same words in the terminal, in JSON, on the page and in Python.
    lines = report.text().splitlines()
    first = " ".join(lines[:10])
    assert told in first
    assert closed in first
    html, data = write_report(report, tmp_path)
    assert json.loads(data.read_text())["statement"] == report.statement
    assert told in html.read_text()
    assert told in report._repr_html_()


def test_one_of_some_effects_is_told_with_the_size_of_each():
    like = replace(power(3), name="cube of the machine")
    report = diagnose(
        LINE, [power(3), like], records(lambda u: u + 0.05 * u**3), options=Options(bootstrap=0)
    )
    assert report.verdict is Verdict.ONE_OF
    one, other = (sized(report, n) for n in report.one_of)
    assert report.statement.startswith(f"One of {one} and {other}; these records cannot tell which")


def test_effects_that_no_record_separates_are_to_be_tested_by_themselves():
    cube = replace(power(3), remedy="Bend it.")
    like = replace(cube, name="cube of the machine", remedy="Weigh it.")
    silent = replace(cube, name="nothing is known of this", remedy="")
    data = records(lambda u: u + 0.05 * u**3)
    report = diagnose(LINE, [cube, like, silent], data, options=Options(bootstrap=0, advice=True))
    assert len(report.one_of) == 3
    texts = [a.text for a in report.next]
    assert "If it is power 3: Bend it." in texts
    assert "If it is cube of the machine: Weigh it." in texts
    assert not any(t.startswith("If it is nothing") for t in texts)
    apart = [t for t in texts if "no tested variant" in t]
    assert apart
    assert all(t.endswith("or test one of the parts by itself") for t in apart)


def test_a_data_problem_holds_nothing_of_the_machine():
    cube, square = replace(power(3), kind="sensor"), replace(power(2), kind="sensor")
    both = records(lambda u: u + 0.3 * u**3 + 0.2 * u**2)
    said = diagnose(LINE, [cube, square], both, options=Options(bootstrap=0))
    assert said.verdict is Verdict.DATA_PROBLEM
    one, other = (sized(said, n) for n in said.named)
    assert said.statement.startswith(f"The records, not the machine: {one} and {other}. It closes ")
    # The square may as well be of the machine.
    like = replace(power(2), name="square of the machine")
    said = diagnose(LINE, [cube, square, like], both, options=Options(bootstrap=0))
    assert said.named == ("power 3",)
    assert set(said.one_of) == {"power 2", "square of the machine"}
    assert said.verdict is Verdict.NAMED_RESIDUAL
    either = [sized(said, n) for n in said.one_of]
    assert f"In addition, one of {either[0]} and {either[1]}, which" in said.statement
    assert said.statement.startswith(f"The records show: {sized(said, 'power 3')}. It closes ")


@pytest.mark.parametrize(("cube", "fifth"), [(0.5, 0.06), (0.3, -0.5)])
def test_a_small_effect_beside_a_large_one_is_named_with_its_size(cube, fifth):
    bent = records(lambda u: u + cube * u**3 + fifth * u**5)
    report = diagnose(LINE, [power(3), power(5)], bent, options=Options(bootstrap=0))
    assert set(report.named) == {"power 3", "power 5"}
    assert report.verdict is Verdict.NAMED
    for name, true in (("power 3", cube), ("power 5", fifth)):
        size = report.which[name]
        assert size.low < true < size.high


def test_certainty_is_that_of_least_squares():
    r = record("r", 3, lambda u: u + 0.1 * u**3)
    fit = fit_problem(Problem(LINE, (segment_record(LINE, r, {"y": Noise(NOISE)}, None),)))
    effect = power(3)
    again = refit(fit, tuple(_candidates(effect)), np.array([0.1]), FitSettings())
    u = r.inputs["u"]
    columns = np.column_stack([u, u**3]) / NOISE
    precision = columns.T @ columns + np.diag([1.0 / 0.1**2, 0.0])
    right = columns.T @ ((r.outputs["y"] - u) / NOISE)
    size, sd = np.linalg.solve(precision, right)[1], np.sqrt(np.linalg.inv(precision)[1, 1])
    assert np.isclose(_certainty(again)["power 3"], abs(size) / sd, rtol=1e-2)


def _candidates(effect):
    from feltmb.fit.model import Candidate

    yield Candidate(effect)


def test_a_piece_of_a_record_does_not_begin_at_rest():
    # Records that are cut to hold parts out once kept the prior of a run's first state: a gap of
    # a hundred times the noise where there was none.
    data = [replace(r, role="fit") for r in models.records(5)[:2]]
    report = diagnose(models.NOMINAL, models.EFFECTS, data, options=Options(bootstrap=0))
    assert len(report.fit.problem.segmented_records) == 6
    assert report.verdict in (Verdict.CALIBRATED, Verdict.TOO_WEAK)
    assert report.fit.chi2 < 1.2 * report.fit.dof


def test_a_piece_without_values_is_left_out():
    whole = models.record("r", 1.0, 3)
    values = whole.outputs["q"].copy()
    values[110:250] = np.nan
    data = [replace(whole, outputs={"q": values})]
    report = diagnose(models.NOMINAL, models.EFFECTS, data, options=Options(bootstrap=0))
    assert report.named == ()
    names = [s.record.name for s in report.fit.problem.segmented_records]
    assert names == ["r[1/5]", "r[3/5]", "r[5/5]"]
    assert report.how_far.records == ("r[4/5]",)


def test_segments_that_run_away_leave_finite_numbers():
    # Derivatives of 1e200 once ended three diagnoses of a hundred with "Singular matrix".
    values = np.array([1e200, -1e150, np.nan, np.inf, 3.0])
    np.testing.assert_array_equal(_tame(values), [0.0, 0.0, 0.0, 0.0, 3.0])
    shape = (2, 4, 1)
    linear = Linear(
        residual=np.ones((2, 4)),
        by_state=np.zeros(shape),
        by_global=np.zeros(shape),
        by_input=np.full((2, 4, 3), 1e12) * np.array([1.0, 1.0 + 1e-16, 0.0]),
        defect=np.zeros((1, 1)),
        ends_by_state=np.zeros((2, 1, 1)),
        ends_by_global=np.zeros((2, 1, 1)),
        ends_by_input=np.zeros((2, 1, 3)),
        good=np.ones(2, dtype=bool),
    )
    part = _by_input_noise(linear, linear.residual, linear.defect, np.ones(1))
    assert np.allclose(part, 4.0)  # the two columns explain all of it


def test_a_model_that_tears_at_an_impact_gets_through(tmp_path):
    """Segment by segment these strokes can be followed; closed too fast, convergence was lost."""
    bench = Bench(tmp_path / "b")
    bench.seal(5, 20261120)
    bench.machine.make_records(bench.folder, None, [4])
    model = KeyHammer()
    segmented_records = tuple(
        segment_record(model, r, {c: Noise(5e-5, 7.5e-4) for c in model.outputs}, None)
        for r in bench.machine.read_records(bench.folder / "records" / "4.npz")
        if r.role == "fit"
    )
    fit = fit_problem(Problem(model, segmented_records))
    assert fit.level <= 1e-4
    assert fit.converged
    assert fit.chi2 < fit.dof


def test_a_sure_score_that_held_out_records_refuse_is_unknown():
    # In the records of the fit alone there is a cube: too small for the sum of squares, sure for
    # its score. Something is wrong, and it is not a spring that hardens.
    data = [
        record(f"r{i}", i, lambda u, c=c: u + c * u**3, role)
        for i, (c, role) in enumerate([(0.018, "fit")] * 3 + [(0.0, "held_out")] * 2)
    ]
    report = diagnose(LINE, [power(3)], data, options=Options(bootstrap=0))
    assert report.fit.explains
    assert report.which["power 3"].statistic > 25.0
    assert report.verdict == Verdict.UNKNOWN
    assert "p of the largest score" in report.statement
    assert report.named == ()


def test_held_out_records_that_do_not_excite_an_effect_do_not_refuse_it():
    """A cube that acts at large inputs only; the held-out records have small ones."""
    data = [record(f"r{i}", i, lambda u: u + 0.05 * u**3) for i in range(3)]
    for i in (3, 4):
        quiet = record(f"r{i}", i, lambda u: 0.0 * u, "held_out")
        u = 0.02 * quiet.inputs["u"]
        outputs = {"y": quiet.outputs["y"] + u + 0.05 * u**3}
        data.append(replace(quiet, inputs={"u": u}, outputs=outputs))
    report = diagnose(LINE, [power(3)], data, options=Options(bootstrap=0))
    assert report.named == ("power 3",)
    assert report.how_far.closed < 0.05
    assert "Held-out records hardly show power 3" in report.statement
    assert "neither confirm nor contradict it" in report.statement


def test_held_out_records_can_show_an_effect_that_the_linear_score_misses(decided):
    diagnose(LINE, [power(3)], records(lambda u: u + 0.05 * u**3), options=Options(bootstrap=0))
    facts = decided[-1]
    accepted = facts.accepted
    gain = float(np.sum(accepted.after.density - accepted.before.density))
    clean = replace(facts, p=0.5, misfit=replace(facts.misfit, left=False), uncorrelated=())
    assert accepted.p == pytest.approx(np.exp(-gain / accepted.belief.inflation))
    assert decide(clean).named == ("power 3",)

    def gaining(much):
        """The same facts with another held-out gain."""
        density = accepted.before.density.copy()
        density[0] += much
        predicted = replace(accepted.after.predicted, density=density)
        after = replace(accepted.after, predicted=predicted)
        return replace(clean, accepted=replace(accepted, after=after))

    assert gaining(5.0).accepted.p == pytest.approx(np.exp(-5.0))
    assert decide(gaining(5.0)).named == ("power 3",)  # p below 0.01
    weak = decide(gaining(4.0))
    assert weak.verdict is Verdict.TOO_WEAK  # the posterior alone says that something is missing
    assert weak.named == ()
    # If it is not that probable either, nothing is missing.
    faint = gaining(4.0)
    faint = replace(faint, belief=replace(faint.belief, none=0.2))
    assert decide(faint).verdict in (Verdict.NO_GAP, Verdict.CALIBRATED)


def test_a_likelihood_ratio_is_rarely_large_without_an_effect():
    """``Accepted.p`` is not below the share of such gains: 20 000 null records."""
    generator = np.random.default_rng(5)
    # Predictive distributions with and without an effect whose magnitude is known to 0.3.
    shape, size, sd = generator.standard_normal(30) * 0.5, 1.0, 0.3
    null = generator.standard_normal((20_000, 30))
    cover = np.eye(30) + sd**2 * np.outer(shape, shape)
    left = null - size * shape
    with_it = -0.5 * np.einsum("ki,ij,kj->k", left, np.linalg.inv(cover), left)
    with_it -= 0.5 * np.linalg.slogdet(cover)[1]
    gain = with_it + 0.5 * np.sum(null**2, axis=1)
    for level in (0.1, 0.01):
        assert np.mean(np.exp(-np.maximum(gain, 0.0)) <= level) <= level


def test_held_out_records_take_weight_from_the_rivals_that_they_refute():
    names = (("a",), ("b",), ("c",))
    sets = [SimpleNamespace(key=n, fit=n, names=n, evidence=0.0) for n in names]
    outcomes = {("a",): 3.0, ("b",): 1.0, ("c",): 7.0}
    outcomes = {k: SimpleNamespace(total=v + 1.0, explains=True) for k, v in outcomes.items()}
    attempt = SimpleNamespace(
        search=SimpleNamespace(sets=sets),
        outcomes={k: v for k, v in outcomes.items() if k != ("c",)},
        inflation=2.0,
        outcome=lambda fit: outcomes[fit],
        before=SimpleNamespace(total=0.0, simulated=True),
    )
    before = Posterior(0.1, 0.1, (0.4, 0.2, 0.2), 2.0)
    after = _Attempt.weighed(attempt, before, sets[0])
    # Over an inflation of 2, b loses 2 units, and the model alone 4. An unknown cause loses none.
    total = 0.1 * np.exp(-2.0) + 0.1 + 0.4 + 0.2 * np.exp(-1.0) + 0.2
    assert np.sum([after.none, after.other, *after.sets]) == pytest.approx(1.0)
    assert after.none == pytest.approx(0.1 * np.exp(-2.0) / total)
    assert after.other == pytest.approx(0.1 / total)
    assert after.sets == pytest.approx(np.array([0.4, 0.2 * np.exp(-1.0), 0.2]) / total)
    # What was not compared, and what predicts better, keeps its weight.
    attempt.outcomes = outcomes
    assert _Attempt.weighed(attempt, before, sets[0]).sets == pytest.approx(after.sets)
    # A simulation of the model alone that fails proves nothing.
    attempt.before = SimpleNamespace(total=-1e6, simulated=False)
    assert _Attempt.weighed(attempt, before, sets[0]).none > 0.1
    # Records that the accepted set does not explain say nothing about its rivals.
    outcomes[("a",)].explains = False
    assert _Attempt.weighed(attempt, before, sets[0]) is before


def test_two_effects_that_held_out_records_do_not_excite_are_both_named(decided):
    """Neither is small beside the other: their held-out gains are of chance."""

    def law(u):
        return u + 0.05 * u**3 + 0.05 * u**2

    data = [record(f"r{i}", i, law) for i in range(3)]
    for i in (3, 4):
        quiet = record(f"r{i}", i, lambda u: 0.0 * u, "held_out")
        u = 0.02 * quiet.inputs["u"]
        data.append(replace(quiet, inputs={"u": u}, outputs={"y": quiet.outputs["y"] + law(u)}))
    report = diagnose(LINE, [power(2), power(3)], data, options=Options(bootstrap=0))
    assert sorted(report.named) == ["power 2", "power 3"]
    assert "neither confirm nor contradict them" in report.statement
    assert "a record in which they act" in report.statement
    # One of them shows: the statement tells what it closes, and which one does not show.
    facts = decided[-1]
    proof = facts.accepted.proof
    # If no record has more than noise, a score of the fitted records alone names nothing.
    within = replace(
        facts, misfit=replace(facts.misfit, left=False), how_far=replace(facts.how_far, before=1.0)
    )
    told = decide(within)
    assert (told.verdict, told.named) == (Verdict.TOO_WEAK, ())
    assert "no record has more than noise without them" in told.statement
    one = {**proof, "power 2": 5.0}
    confirmed = replace(within, accepted=replace(facts.accepted, proof=one))
    assert decide(confirmed).verdict is Verdict.NAMED
    # Nothing was refitted before the time was over: the first score is told.
    early = replace(
        facts,
        accepted=replace(facts.accepted, best=None),
        search=replace(facts.search, sets=()),
        belief=replace(facts.belief, sets=()),
        closest=None,
    )
    assert "No effect was refitted. By its score, the first candidate is power" in (
        decide(early).statement
    )
    proof = {**proof, "power 2": 50.0}
    shown = replace(facts, accepted=replace(facts.accepted, proof=proof))
    told = decide(shown).statement
    assert "gain 50 units of log evidence by power 2. Held-out records hardly show power 3" in told
    wide = replace(shown, how_far=replace(facts.how_far, before=9.0, closed=0.8, low=0.6))
    assert "It closes 80% of the held-out gap. Held-out records" in decide(wide).statement
    # If an equally good set has one of them alone, the other is a possibility and no statement.
    smaller = (SimpleNamespace(names=("power 2",), evidence=-np.inf),)
    maybe = decide(replace(shown, accepted=replace(shown.accepted, rivals=smaller)))
    assert (maybe.verdict, maybe.named, maybe.one_of) == (Verdict.NAMED, ("power 2",), ())
    assert "do not determine whether power 3" in maybe.statement
    assert "one of power 3" not in maybe.statement
    rivals = (*smaller, SimpleNamespace(names=("power 2", "power 4"), evidence=-np.inf))
    maybe = decide(replace(shown, accepted=replace(shown.accepted, rivals=rivals)))
    assert (maybe.verdict, maybe.named, maybe.one_of) == (Verdict.NAMED, ("power 2",), ())
    assert "do not determine whether one of power 3 of 0.0" in maybe.statement
    # If every equally good set has another one beside it, one of these acts.
    maybe = decide(replace(shown, accepted=replace(shown.accepted, rivals=rivals[1:])))
    assert maybe.verdict is Verdict.NAMED_RESIDUAL
    assert (maybe.named, set(maybe.one_of)) == (("power 2",), {"power 3", "power 4"})
    assert "In addition, one of power 3 of 0.0" in maybe.statement


@pytest.mark.parametrize(
    ("gain", "expected", "level", "refused"),
    [
        (5.0, 50.0, 0.01, False),
        (-0.7, 0.0, 0.01, False),  # a record at rest: two fits differ by chance
        (-3.0, 0.0, 0.01, True),
        (1.9, 0.0, 0.1, True),  # its states follow records that it does not explain
        (5.0, 0.0, 0.1, False),
        (0.0, 0.0, np.inf, True),  # it cannot be simulated
    ],
)
def test_what_held_out_records_refuse(gain, expected, level, refused):
    cost = 1.0 if np.isfinite(level) else np.inf
    own = SimpleNamespace(level=level, cost=cost, defect_sd=np.ones(2))
    after = SimpleNamespace(fit=own, model=SimpleNamespace(level=0.01), explains=True)
    attempt = object.__new__(_Attempt)
    attempt.inflation, attempt.options = 1.0, Options()
    attempt.expected = lambda old, new: (expected, float(np.sqrt(2.0 * expected)))
    assert attempt._refused(gain, None, after) is refused


@pytest.mark.parametrize(
    ("before", "after", "explains", "refused"),
    [
        ((3.0, 2.0), (3.1, 2.1), False, True),
        ((3.0, 2.0), (3.0, 2.0), False, True),
        ((3.0, 2.0), (3.1, 2.1), True, False),
        ((3.0, 2.0), (3.1, 1.9), False, False),
        ((np.inf, np.inf), (3.1, 2.1), False, False),  # the model alone could not be simulated
    ],
)
def test_a_set_that_does_not_explain_held_out_records_is_closer_to_them(
    before, after, explains, refused
):
    attempt = object.__new__(_Attempt)
    attempt.options = Options()
    attempt._gaps = lambda outcome: outcome.gaps
    outcomes = [SimpleNamespace(gaps=g, explains=explains) for g in (before, after)]
    assert attempt._refused(99.0, *outcomes) is refused


def _fault_of(monkeypatch, gain, *, expected, level=0.01, parameter=""):
    """Reason against the only effect of a set, whose held-out gain is given."""
    own = SimpleNamespace(level=level, cost=1.0, defect_sd=np.ones(2))
    after = SimpleNamespace(fit=own, model=SimpleNamespace(level=0.01), explains=True)
    attempt = object.__new__(_Attempt)
    attempt.alone, attempt.inflation, attempt.options = {"a": 99.0}, 1.0, Options()
    for name, value in {
        "unexplained": lambda c: 0.0,
        "_outcome_without": lambda c, name: None,
        "outcome": lambda fit: after,
        "expected": lambda old, new: expected,
    }.items():
        monkeypatch.setattr(attempt, name, value, raising=False)
    effect = SimpleNamespace(tolerance_parameter=parameter)
    one = SimpleNamespace(fit=SimpleNamespace(included=[SimpleNamespace(name="a", effect=effect)]))
    return attempt._fault(one, "a", gain, 9.0)


@pytest.mark.parametrize(
    ("gain", "level", "told"),
    [
        (1.9, 0.1, "only with larger continuity defects"),
        (-9.0, 0.01, "40.0 would be expected of it"),
    ],
)
def test_the_reason_of_a_refusal(monkeypatch, gain, level, told):
    why = _fault_of(monkeypatch, gain, expected=(40.0, 9.0), level=level)
    assert why.startswith(f"held-out gain {gain:.1f} units of log evidence")
    assert told in why


@pytest.mark.parametrize(("parameter", "refused"), [("", False), ("friction", True)])
def test_an_effect_that_increases_a_tolerance_must_be_confirmed(monkeypatch, parameter, refused):
    """A gain of 0.5 where 0.6 is expected: the records can neither confirm nor contradict it."""
    why = _fault_of(monkeypatch, 0.5, expected=(0.6, 1.2), parameter=parameter)
    assert bool(why) is refused


def test_probabilities_compare_what_was_tested():
    report = diagnose(
        LINE, [power(3), power(5)], records(lambda u: u + 0.3 * u**3), options=Options(bootstrap=0)
    )
    which = report.which
    assert report.verdict == Verdict.NAMED
    assert np.isclose(which.none + which.other + sum(s.posterior for s in which.sets), 1.0)
    assert which["power 3"].posterior > 0.99
    assert np.isclose(report.confidence, sum(s.posterior for s in which.sets))


def test_a_set_that_held_out_records_refuse_is_no_explanation():
    """An effect that is in the fitted records alone: UNKNOWN is sure, not improbable."""
    fitted, held_out = records(lambda u: u + 0.1 * u**3), records(lambda u: u)
    mixed = [f if f.role == "fit" else h for f, h in zip(fitted, held_out, strict=True)]
    report = diagnose(LINE, [power(3)], mixed, options=Options(bootstrap=0))
    assert report.verdict is Verdict.UNKNOWN
    # What held-out records refuse has no probability, but it is still the first in the table.
    assert report.which.effects[0].effect in {n.name for n in report.refused}
    assert report.which.effects[0].posterior < 0.01
    assert report.confidence > 0.9


def test_a_quiet_model_needs_no_refits():
    report = diagnose(
        LINE, [power(3), power(5)], records(lambda u: u), options=Options(bootstrap=0)
    )
    assert report.verdict == Verdict.NO_GAP
    assert report.which.sets == ()


def test_the_onset_is_where_the_effect_begins():
    # An input that rests and then swings: the cube acts from there.
    def late(r):
        u = np.where(r.time < 0.15, 0.0, np.sin(30.0 * (r.time - 0.15)))
        noise = r.outputs["y"] - r.inputs["u"] - 0.3 * r.inputs["u"] ** 3
        return replace(r, inputs={"u": u}, outputs={"y": u + 0.3 * u**3 + noise})

    data = [late(r) for r in records(lambda u: u + 0.3 * u**3)]
    report = diagnose(LINE, [power(3)], data, options=Options(bootstrap=0))
    assert report.named == ("power 3",)
    assert set(report.where.onset) == {"r0", "r1", "r2"}
    # sin(30 t)^3 reaches a tenth of its largest at 16 ms
    assert all(abs(t - 0.166) < 0.003 for t in report.where.onset.values())


def test_without_a_library_there_is_still_a_verdict():
    report = diagnose(LINE, [], records(lambda u: u), options=Options(bootstrap=0))
    assert report.verdict == Verdict.NO_GAP
    report = diagnose(LINE, [], records(lambda u: u + 0.3 * u**3), options=Options(bootstrap=0))
    assert report.verdict == Verdict.UNKNOWN
    assert report.named == ()
    assert report.which.effects == ()


def test_what_a_limit_forbids_is_not_explained():
    steep = records(lambda u: 1.3 * u)
    for upper, verdict in ((np.inf, Verdict.CALIBRATED), (1.1, Verdict.UNKNOWN)):
        slope = Parameter(name="slope", value=1.0, sd=0.3, upper=upper)
        line = LinearModel(output="y", columns=LINE.columns, parameters=[slope], name="line")
        report = diagnose(line, [], steep, options=Options(bootstrap=0))
        assert report.verdict == verdict
        assert report.fit.intervals()[0].at_limit == (upper < 2.0)


def test_a_small_effect_that_explains_all_that_is_left_is_no_small_print():
    both = records(lambda u: u + 0.3 * u**3 + 0.03 * u**2, noise=1e-4)
    said = diagnose(LINE, [power(3), power(2)], both, options=Options(bootstrap=0))
    assert said.verdict is Verdict.NAMED
    assert set(said.named) == {"power 2", "power 3"}
    # Where it leaves more than noise it may compensate the form of the larger one.
    more = records(lambda u: u + 0.3 * u**3 + 0.03 * u**2 + 3e-3 * np.sin(9.0 * u), noise=1e-4)
    said = diagnose(LINE, [power(3), power(2)], more, options=Options(bootstrap=0))
    assert said.verdict is not Verdict.NAMED
    assert "nothing tested explains it" not in said.statement or not said.refused


def test_a_gap_of_held_out_records_alone_is_told_beside_a_name():
    """A cause that acts above |u| = 0.8; the fitted records stay below."""

    def law(u):
        return u + 0.3 * u**3 + np.where(np.abs(u) > 0.8, 0.1 * np.sin(60.0 * u), 0.0)

    def scaled(name, role, largest):
        u = largest * np.sin(np.linspace(0.0, 40.0, 400))
        y = law(u) + NOISE * np.random.default_rng(len(name)).standard_normal(400)
        return replace(record(name, 0, law, role), inputs={"u": u}, outputs={"y": y})

    fitted = [scaled("a", "fit", 0.79), scaled("bb", "fit", 0.7)]
    within, beyond = scaled("ccc", "held_out", 0.75), scaled("dddd", "held_out", 1.1)
    said = diagnose(LINE, [power(3)], [*fitted, within], options=Options(bootstrap=0))
    assert said.verdict is Verdict.NAMED
    assert "What is left is noise." in said.statement
    said = diagnose(LINE, [power(3)], [*fitted, beyond], options=Options(bootstrap=0))
    assert said.named == ("power 3",)
    assert said.verdict is Verdict.NAMED_RESIDUAL
    assert "What is left of the fitted records is noise, but the held-out ones" in said.statement
    # Another value of the parameter or of the magnitude would close the gap: none is told.
    more = replace(beyond, outputs={"y": beyond.inputs["u"] + 0.3 * beyond.inputs["u"] ** 3})
    noise = NOISE * np.random.default_rng(7).standard_normal(400)
    more = replace(more, outputs={"y": more.outputs["y"] + noise})
    said = diagnose(LINE, [power(3)], [*fitted, more], options=Options(bootstrap=0))
    assert said.verdict is Verdict.NAMED


def test_a_set_found_beside_a_rest_is_asked_whether_there_is_one():
    """Where the first search passed over a cause that explains all, no rest is told."""

    def segmented_records(law, noise):
        runs = records(law)[:3]
        return tuple(segment_record(LINE, r, {"y": Noise(noise)}, None) for r in runs)

    settings, effects = FitSettings(), [power(2), power(3)]
    for law, explains in (
        (lambda u: u + 0.3 * u**3, True),
        (lambda u: u + 0.3 * u**3 + 0.1 * np.sin(9.0 * u), False),
    ):
        sensed = fit_problem(Problem(LINE, segmented_records(law, NOISE)))
        first = search(sensed, [power(2)], settings)
        beside = search(
            fit_problem(Problem(LINE, segmented_records(law, 3.0 * NOISE))), effects, settings
        )
        assert beside.best.names == ("power 3",)
        task = Task(
            effects=effects, options=Options(), settings=settings, store=None, progress=None
        )
        found = _explained(first, beside, SimpleNamespace(estimated=False), task)
        assert (found is not None) is explains
        if explains:
            assert found.best.names == ("power 3",)
            assert found.model_fit is first.model_fit


@pytest.mark.parametrize(
    ("belief", "sure"),
    [
        ({"a": 0.12, "a b": 0.8, "a c": 0.08}, ("a",)),  # that of b took a with it
        ({"a b": 0.95, "a": 0.05}, ("a", "b")),
        ({"a b": 0.5, "a c": 0.5}, ("a", "b")),  # something is there beside a: one of b and c
        ({"a b": 0.5, "c d": 0.5}, ("a", "b")),  # nothing is sure
        ({"a": 0.05, "b": 0.15, "a b": 0.8}, ("b",)),
    ],
)
def test_an_effect_that_is_not_sure_takes_no_other_with_it(belief, sure):
    sets = [SimpleNamespace(names=tuple(k.split())) for k in belief]
    assert sure_part(("a", "b"), sets, list(belief.values()), 0.9) == sure


@pytest.mark.parametrize(
    ("belief", "sure", "unsure"),
    [
        # Both together are probable enough.
        ({"ab": 0.95, "a": 0.05}, "ab", ""),
        # The second one may be another one.
        ({"ab": 0.8, "ac": 0.15, "a": 0.03, "b": 0.02}, "a", "bc"),
        # A set without the sure effect does not tell what acts beside it.
        ({"ab": 0.85, "d": 0.08, "ac": 0.07}, "a", "bc"),
        # Nothing is probable enough: the set stays as it is, and its probability is told.
        ({"ab": 0.6, "cd": 0.4}, "ab", ""),
    ],
)
def test_the_probable_part_of_a_set_is_named(belief, sure, unsure):
    facts = SimpleNamespace(
        search=SimpleNamespace(sets=[SimpleNamespace(names=tuple(key)) for key in belief]),
        belief=SimpleNamespace(sets=tuple(belief.values())),
        options=Options(),
    )
    kept, others = _probable(facts, ("a", "b"), [])
    assert ("".join(kept), "".join(others)) == (sure, unsure)


def test_missing_samples_do_not_move_the_onset():
    """The residual grows at 0.5 s; 60 % of the samples before and after it are missing."""
    time = np.arange(1001) * 1e-3
    rng = np.random.default_rng(3)
    values = rng.standard_normal(1001) * np.where(time < 0.5, 1.0, 1.6)
    valid = rng.random(1001) > 0.6
    at = np.flatnonzero(valid)
    assert time[at[onset_of(values[at], 0.01)]] == pytest.approx(0.5, abs=0.05)


def test_the_onset_is_that_of_the_first_event():
    """A weak event before a strong one."""
    rng = np.random.default_rng(4)
    values = rng.standard_normal(400)
    values[100:110] *= 5.0
    values[300:] *= 20.0
    assert onset_of(values, 0.01) == pytest.approx(100.0, abs=4.0)
