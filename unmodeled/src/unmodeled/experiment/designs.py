"""Designs the next experiments: inputs and tests of parts, by information and cost.

1. Profiles of each family are drawn within the limits (Sobol points) and simulated.
2. Profiles whose motions differ most, in units of the noise, are kept (farthest point first):
   similar motions give similar information, and a simulation costs much less than derivatives.
3. The information of each of these is computed (:mod:`unmodeled.experiment.information`).
4. The experiment with the best gain for its cost is taken, then the best one in addition to it, and
   so on until the budget is used.
5. The first experiment is improved by a random search over the numbers of its profile.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import qmc

from unmodeled.arguments import checked
from unmodeled.data import Array, Record, Sensor
from unmodeled.errors import Error, InvalidParameter
from unmodeled.experiment.information import (
    TOLD,
    Aim,
    Belief,
    Information,
    Knowledge,
    Study,
)
from unmodeled.experiment.limits import check_limits
from unmodeled.experiment.profiles import FAMILIES, Profile
from unmodeled.fit.limits import Limits, PartTest
from unmodeled.fit.measured import no_test_of
from unmodeled.fit.model import Effect, Model
from unmodeled.search.records import ready_records

__all__ = [
    "Design",
    "DesignedExperiment",
    "Help",
    "Visible",
    "design",
    "sensors_of",
]

#: Number of profiles of each family that are simulated.
DRAWS = 8
#: Number of times at which motions are compared.
POINTS = 64
#: First step of the search for better profiles, as a share of the range of a number of a profile.
STEP = 0.15
#: Number of refinements of one family before the next family is refined.
ROOM = 20
#: Gain below which an experiment is left out of a plan: below it are rounding errors.
LEAST_GAIN = 1e-4
#: Largest number of helpful tests.
TESTS = 8
#: Smallest decrease of the probability of confusion, and smallest gain by a test, that are told.
WORTH_TELLING = 0.02
#: Accuracy of the test of a parameter: share of the uncertainty that the plan leaves, but at least
#: this share of its tolerance.
HALF, BEST = 0.5, 0.1


@dataclass(frozen=True, kw_only=True, eq=False)
class DesignedExperiment:
    """One experiment of a plan."""

    name: str
    cost: float
    """Cost of the experiment, in records."""
    input: str = ""
    """Name of the input that moves."""
    profile: Profile | None = None
    record: Record | None = None
    """Record with the outputs that the model predicts; None: the test of a part."""
    part: PartTest | None = None
    before: float = math.nan
    """Expected probability of the correct name before it [1], or information [log evidence]."""
    after: float = math.nan
    """The same after it."""
    detected: tuple[int, int] = (0, 0)
    """Number of causes that are detectable at their expected magnitude, before and after it."""
    separated: tuple[str, str, float, float] | None = None
    """The cause and the rival that it separates best, and the probability of the rival, if the
    cause is right and no other one is possible, before and after it."""


@dataclass(frozen=True, kw_only=True)
class Visible:
    """One cause, before and after the whole plan."""

    cause: str
    unit: str
    belief: float
    """Present probability that it is missing, if something is [1]."""
    smallest_before: float
    """Smallest detectable magnitude now [unit]; inf: none."""
    smallest: float
    """Smallest detectable magnitude after the plan [unit]; inf: none."""
    right: float
    """Expected probability of the cause after the plan, if it is right [1]."""
    rival: str
    """Cause with which it would most often be confused after the plan; "": none."""
    confusion: float
    """Probability of this rival, if no other one is possible [1]."""
    imitated: bool
    """Whether the parameters of the model imitate it completely."""
    parameter: bool = False
    """Whether it is a parameter outside its tolerance; the magnitude is its deviation."""


@dataclass(frozen=True, kw_only=True)
class Help:
    """A test of one part by itself, or a further sensor, that would help in addition to a plan."""

    name: str
    """Parameter or effect that the test measures, or output that the sensor shows."""
    sd: float
    """Standard deviation that the test needs, or noise of the sensor [unit]."""
    unit: str
    after: float
    """Expected probability of the correct name with it [1], or information [log evidence]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Design:
    """Result of :func:`design`."""

    aim: Aim
    experiments: tuple[DesignedExperiment, ...]
    """Experiments in the order in which they should be made; plan again after each of them."""
    effects: tuple[Visible, ...]
    """All causes that may be missing, the most probable first."""
    tests: tuple[Help, ...]
    """Tests of parts that would help, the most helpful first."""
    sensors: tuple[Help, ...]
    """The further sensors of the limits, the most helpful first."""
    before: float
    """Expected probability of the correct name now [1], or information [log evidence]."""
    after: float
    """The same value after the plan."""
    reachable: float
    """With all experiments that were worked out, in addition to the plan."""
    inseparable: tuple[tuple[str, ...], ...]
    """Causes that all experiments together could not distinguish."""
    failed: int
    """Number of profiles that the model could not simulate."""


@dataclass(frozen=True, eq=False)
class _Option:
    """A possible experiment, with what it tells."""

    told: Information | Array
    experiment: DesignedExperiment
    knobs: tuple[float, ...] = ()

    @property
    def cost(self) -> float:
        return self.experiment.cost


@checked
def design(
    model: Model,
    effects: Sequence[Effect],
    records: Sequence[Record] = (),
    *,
    limits: Limits,
    sensors: Mapping[str, Sensor] | None = None,
    budget: float = 3.0,
    aim: Aim = "names",
    belief: Belief | None = None,
    families: Sequence[str] = (),
    candidates: int = 12,
    refinements: int = 4,
    seed: int = 0,
    progress: Callable[[str, int, int], None] | None = None,
) -> Design:
    """Design the most informative experiments within limits and a budget.

    Parameters
    ----------
    model
        Model of the machine.
    effects
        Effects that it may lack.
    records
        Records that were measured before. Their inputs and sensors count; what they say about
        causes comes from ``belief``.
    limits
        Limits of the inputs, sensors, and possible tests of parts.
    sensors
        Sensors of the measured outputs. Default: those of ``limits``, else of the records, else all
        outputs, each with a noise of a thousandth of its spread.
    budget
        Cost of all experiments: a record costs 1, the costs of tests of parts are in ``limits``.
    aim
        ``names``: identify causes; ``sizes``: estimate their magnitudes.
    belief
        Result of a diagnosis of the records (:meth:`Belief.of_report`). Default: the prior odds of
        a diagnosis.
    families
        Names of :data:`~unmodeled.experiment.profiles.FAMILIES`; default: all.
    candidates
        Number of profiles that are evaluated in full.
    refinements
        Number of further profiles that improve the first experiment.
    seed
        Seed of the random draws.
    progress
        Is called with the stage, the completed number, and the total.

    Returns
    -------
    Design
        The experiments, and what they tell.

    Raises
    ------
    InvalidParameter
        Unknown names, a wrong number, or no profile that can be simulated.
    """
    if records:
        ready = ready_records(model, records)
        model, records = ready.model, ready.records
    check_limits(limits, model, effects)
    known = ", ".join(FAMILIES)
    faults = [f"families: {n} is none of {known}" for n in families if n not in FAMILIES]
    if not 0.0 < budget <= 1000.0:
        faults.append(f"budget = {budget!r} records, expected in (0, 1000]")
    if not 1 <= candidates <= 10_000:
        faults.append(f"candidates = {candidates!r}, expected 1 to 10000")
    if not 0 <= refinements <= 10_000:
        faults.append(f"refinements = {refinements!r}, expected 0 to 10000")
    if faults:
        raise InvalidParameter("plan: " + "; ".join(faults))
    study = Study.of(model, effects, belief)
    work = _Work(study, limits, sensors_now(model, limits, records, sensors), seed, progress)
    start = Knowledge(study, aim=aim)
    for i, r in enumerate(records):
        work.tell("what the records tell", i, len(records))
        start = start.plus(study.linearized(r))
    if belief is not None and records:
        start = replace(start, before=start.gram)
    options = work.options(list(dict.fromkeys(families)) or list(FAMILIES), candidates)
    for t in limits.parts:
        words = f"{t.how or 'test of a part'}: {t.parameter}"
        test = DesignedExperiment(name=words, cost=t.cost, part=t)
        options.append(_Option(start.test(t.parameter, t.sd), test))
    if not options:
        raise InvalidParameter(
            f"plan: none of the {work.failed} profiles within the limits can be simulated by "
            f"{model.name}{work.why}; hint: lower inputs.most or lengthen the duration"
        )
    picked = _greedy(start, options, budget)
    if picked and refinements and picked[0].experiment.profile is not None:
        better = work.improved(start, options, refinements)
        options = [*options, *([] if better in options else [better])]
        picked = [better, *_greedy(start.plus(better.told), options, budget - 1.0)]
    return _result(start, picked, options, work)


def sensors_now(
    model: Model, limits: Limits, records: Sequence[Record], given: Mapping[str, Sensor] | None
) -> dict[str, Sensor]:
    """Sensor by measured output: as given, else by the limits, else by the records."""
    if given:
        if unknown := [n for n in given if n not in model.outputs]:
            raise InvalidParameter(
                f"sensors: {', '.join(unknown)} is no output of {model.name}; there are "
                f"{', '.join(model.outputs)}"
            )
        return dict(given)
    known = {n: s for r in reversed(records) for n, s in r.sensors.items() if n in model.outputs}
    every = {n: Sensor(name=n, unit=model.units.get(n, "1")) for n in model.outputs}
    if limits.sensors:
        return {n: replace(known.get(n, every[n]), sigma=s) for n, s in limits.sensors.items()}
    return known or every


def sensors_of(
    records: Sequence[Record], outputs: Iterable[str], usual: Mapping[str, Sensor]
) -> dict[str, Sensor]:
    """Sensors that records have for outputs, with the usual noise where it is not stated."""
    seen = {n: s for r in records for n, s in r.sensors.items() if n in outputs}
    return {
        n: replace(s, sigma=usual[n].sigma) if s.sigma is None and n in usual else s
        for n, s in seen.items()
    }


def _greedy(knowledge: Knowledge, options: Sequence[_Option], budget: float) -> list[_Option]:
    """Repeatedly take the experiment with the best gain for its cost, until the budget is used."""
    out: list[_Option] = []
    while True:
        made = [o for o in out if o.experiment.part is not None]  # a test is made once
        able = [o for o in options if o.cost <= budget + 1e-9 and o not in made]
        gains = [(knowledge.plus(o.told).value - knowledge.value) / o.cost for o in able]
        if not gains or not max(gains) > LEAST_GAIN:
            return out
        best = able[int(np.argmax(gains))]
        out.append(best)
        budget -= best.cost
        knowledge = knowledge.plus(best.told)


@dataclass(eq=False)
class _Work:
    """Draws profiles and computes their information."""

    study: Study
    limits: Limits
    sensors: Mapping[str, Sensor]
    seed: int
    progress: Callable[[str, int, int], None] | None
    failed: int = 0
    why: str = ""

    def tell(self, stage: str, done: int, total: int) -> None:
        if self.progress is not None:
            self.progress(stage, done, total)

    def record(self, name: str, profile: Profile) -> Record:
        """Record of a profile; its outputs are zero."""
        limits, model = self.limits, self.study.model
        count = max(16, math.floor(profile.end * limits.sample_rate + 1e-6) + 1)
        time = np.arange(count) / limits.sample_rate
        modes = {n: mode for mode, names in model.input_modes.items() for n in names}
        mode: Any = modes.get(name, "force")
        others = model.input_modes.get(mode) or model.inputs or tuple(limits.inputs)
        start = {n: limits.inputs[n].start if n in limits.inputs else 0.0 for n in others}
        further = {
            n: Sensor(name=n, unit=model.units.get(n, "1"), sigma=sigma)
            for n, sigma in limits.further.items()
        }
        sensors = further | dict(self.sensors)
        return Record(
            name="planned",
            time=time,
            inputs={n: np.full(time.size, v) for n, v in start.items()} | {name: profile.at(time)},
            outputs={n: np.zeros(time.size) for n in sensors},
            sensors=sensors,
            input_mode=mode,
            input_sigma={n: s for n, s in limits.input_sigma.items() if n in start or n == name},
        )

    def options(self, families: Sequence[str], count: int) -> list[_Option]:
        """Profiles with the most different motions, with their information."""
        drawn = []
        pairs = [(i, f) for i in self.limits.inputs for f in families]
        for at, (name, family) in enumerate(pairs):
            generator = np.random.default_rng([self.seed, at])
            sobol = qmc.Sobol(len(FAMILIES[family].knobs), rng=generator)
            drawn += [(name, family, tuple(float(u) for u in row)) for row in sobol.random(DRAWS)]
        return self.evaluated(drawn, count)

    def evaluated(
        self, drawn: Sequence[tuple[str, str, tuple[float, ...]]], count: int
    ) -> list[_Option]:
        """The most different ones of some profiles (input, family, numbers), with information."""
        made = []
        for name, family, knobs in drawn:
            profile = FAMILIES[family].make(knobs, self.limits.inputs[name], self.limits)
            if profile is not None:
                made.append((name, knobs, profile, self.record(name, profile)))
        records = self.study.simulated([record for *_, record in made])
        self.failed += records.count(None)
        able = [(m[:3], r) for m, r in zip(made, records, strict=True) if r is not None]
        out = []
        for done, i in enumerate(kept := _farthest([r for _, r in able], count)):
            if len(drawn) > 1:
                self.tell("expected information", done, len(kept))
            (name, knobs, profile), record = able[i]
            try:
                told = self.study.linearized(record)
            except Error as error:
                self.failed += 1
                self.why = f": {error}"
                continue
            shown = replace(
                record,
                outputs={n: record.outputs[n] for n in self.sensors},
                sensors={n: record.sensors[n] for n in self.sensors},
            )
            words = _words(profile, name, self.limits.inputs[name].unit)
            experiment = DesignedExperiment(
                name=words, cost=1.0, input=name, profile=profile, record=shown
            )
            read = {n: 1.0 for n in told.read if n in self.sensors}
            out.append(_Option(replace(told, read=read, planned=True), experiment, knobs))
        return out

    def improved(self, knowledge: Knowledge, options: Sequence[_Option], most: int) -> _Option:
        """The best profile after a random search with decreasing steps.

        It begins with the best profile of each family in turn, and ends with the best of all.
        """
        generator = np.random.default_rng([self.seed, 7])
        best: dict[tuple[str, str], tuple[float, _Option]] = {}

        def keep(option: _Option) -> None:
            profile = option.experiment.profile
            if profile is not None:
                key = option.experiment.input, profile.family
                worth = knowledge.plus(option.told).value
                if key not in best or worth > best[key][0]:
                    best[key] = worth, option

        for option in options:
            keep(option)
        for k in range(most):
            self.tell("refinement", k, most)
            found = sorted(best.items(), key=lambda own: -own[1][0])
            turns = min(len(found), 1 + most // ROOM) if 2 * k < most else 1
            place, (_, option) = found[k % turns]
            parent = option.knobs
            step = STEP * (1.0 + k) ** -0.75 * generator.standard_normal(len(parent))
            knobs = tuple(float(u) for u in np.clip(parent + step, 0.0, 1.0))
            for one in self.evaluated([(*place, knobs)], 1):
                keep(one)
        return max(best.values(), key=lambda own: own[0])[1]


def _farthest(records: Sequence[Record], most: int) -> list[int]:
    """Indices of records; each differs most from the previous ones, in units of the noise."""
    if len(records) <= most:
        return list(range(len(records)))
    at = np.linspace(0.0, max(r.time[-1] for r in records), POINTS)
    inputs = dict.fromkeys(n for r in records for n in r.inputs)
    rows = [{n: r.inputs.get(n, 0.0 * r.time) for n in inputs} | dict(r.outputs) for r in records]
    unit = {n: 0.01 * max(np.abs(row[n]).max() for row in rows) or 1.0 for n in inputs}
    unit |= {n: min(r.sensors[n].sigma or np.inf for r in records) for n in records[0].outputs}
    # After the end of a record its last value is used. Large motions are compared by logarithm.
    table = np.array(
        [
            np.concatenate([np.interp(at, r.time, v) / unit[n] for n, v in row.items()])
            for r, row in zip(records, rows, strict=True)
        ]
    )
    table = np.sign(table) * np.log1p(np.abs(table))
    far = np.linalg.norm(table, axis=1)  # from nothing happens
    out: list[int] = []
    for _ in range(most):
        best = int(np.argmax(far))
        out.append(best)
        far = np.minimum(far, np.linalg.norm(table - table[best], axis=1))
    return out


def _words(profile: Profile, name: str, unit: str) -> str:
    """Description of a profile with its numbers."""
    parts = []
    for key, value in profile.numbers.items():
        if key in ("rise", "hold"):
            parts.append(f"{key} {value:.3g} s" if value >= 1.0 else f"{key} {1e3 * value:.3g} ms")
        elif key in ("from", "to"):
            parts.append(f"{key} {value:.3g} Hz")
        else:
            shown = f"{value:.3g}" if unit == "1" else f"{value:.3g} {unit}"
            shown = f"{1e3 * value:.3g} mm" if unit == "m" else shown
            parts.append(shown if key == "level" else f"{key} {shown}")
    return f"{profile.family} of {name}: " + ", ".join(parts)


# ---------------------------------------------------------------- what a plan tells


def _result(
    start: Knowledge, picked: Sequence[_Option], options: Sequence[_Option], work: _Work
) -> Design:
    knowledge, experiments = start, []
    names = start.study.names
    for i, option in enumerate(picked, 1):
        then, record = knowledge.plus(option.told), option.experiment.record
        experiments.append(
            replace(
                option.experiment,
                record=None if record is None else replace(record, name=f"experiment_{i}"),
                before=knowledge.value,
                after=then.value,
                detected=(len({*names[knowledge.detected]}), len({*names[then.detected]})),
                separated=_separated(knowledge, then),
            )
        )
        knowledge = then
    everything = knowledge.plus(*(o.told for o in options if o not in picked))
    groups = everything.inseparable()
    return Design(
        aim=start.aim,
        experiments=tuple(experiments),
        effects=_visible(start, knowledge),
        tests=_tests(knowledge, groups),
        sensors=_sensors(knowledge, work),
        before=start.value,
        after=knowledge.value,
        reachable=everything.value,
        inseparable=groups,
        failed=work.failed,
    )


def _separated(before: Knowledge, after: Knowledge) -> tuple[str, str, float, float] | None:
    """The pair of causes that an experiment separates best, weighted by their probability."""
    weights, names = before.study.possible, before.study.names
    was, then = before.chance, after.chance
    worth = (was - then) * np.minimum(weights[:, None], weights[None, :])
    a, b = np.unravel_index(int(np.argmax(worth)), worth.shape)
    if was[a, b] - then[a, b] < WORTH_TELLING:
        return None
    return str(names[a]), str(names[b]), float(was[a, b]), float(then[a, b])


def _visible(before: Knowledge, after: Knowledge) -> tuple[Visible, ...]:
    """Each cause before and after a plan, in its best shape; the most probable first."""
    study, n = after.study, after.study.x.size
    whole = np.diag(after.matrix)[n:]
    rows: dict[str, Visible] = {}
    for i, c in enumerate(study.causes):
        rival = int(np.argmax(after.chance[i]))
        if c.name in rows and rows[c.name].smallest <= after.smallest[i]:
            continue
        rows[c.name] = Visible(
            cause=c.name,
            unit=study.size(c)[1],
            belief=float(study.possible[study.names == c.name].sum()),
            smallest_before=float(before.smallest[i]),
            smallest=float(after.smallest[i]),
            right=float(after.beliefs[i]),
            rival=str(study.names[rival]) if after.chance[i, rival] > 0.01 else "",
            confusion=float(after.chance[i, rival]),
            imitated=bool(whole[i] > 0.0 and after.gram[i, i] == 0.0),
            parameter=c.effect is None and c.alias is None,
        )
    return tuple(sorted(rows.values(), key=lambda r: (-r.belief, -r.right, r.cause)))


def _tests(knowledge: Knowledge, groups: Sequence[Sequence[str]]) -> tuple[Help, ...]:
    """Tests of single parts that would help.

    Of a parameter: to half of its uncertainty. Of an inseparable effect: as exact as it takes to
    tell it from another one. With the standard deviation s, the magnitude m has the log evidence
    m^2 / (2 s^2).
    """
    study, spread = knowledge.study, knowledge.spread()
    wanted = [
        (p.name, max(HALF * spread[p.name], BEST * p.sd), p.unit)
        for p in study.model.parameters
        if 0.0 < p.sd < math.inf and p.of_the_machine
    ]
    for i, c in enumerate(study.causes):
        tested = c.effect is not None and not no_test_of(c.name, study.model, study.effects)
        if tested and any(c.name in g for g in groups):
            scale, unit = study.size(c)
            size = knowledge.expected[i] * scale
            wanted.append((c.name, size / math.sqrt(2.0 * TOLD), unit))
    found = [
        Help(name=name, sd=sd, unit=unit, after=knowledge.plus(knowledge.test(name, sd)).value)
        for name, sd, unit in dict.fromkeys(wanted)
    ]
    useful = [t for t in found if t.after - knowledge.value > WORTH_TELLING]
    return tuple(sorted(useful, key=lambda t: -t.after)[:TESTS])


def _sensors(knowledge: Knowledge, work: _Work) -> tuple[Help, ...]:
    """Further sensors, the most helpful first: the plan as it is, measured with each of them."""
    out = []
    for name, sigma in work.limits.further.items():
        records = []
        for r in knowledge.records:
            (observed,) = r.problem.fit
            own = observed.record.sensors[name].sigma if r.planned else None
            records.append(r if own is None else replace(r, read={**r.read, name: sigma / own}))
        then = replace(knowledge, records=tuple(records))
        unit = work.study.model.units.get(name) or "1"
        out.append(Help(name=name, sd=sigma, unit=unit, after=then.value))
    return tuple(sorted(out, key=lambda s: -s.after))
