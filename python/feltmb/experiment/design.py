"""Designs the next experiments: inputs, tests of parts and sensors, by information and cost.

1. Profiles of each family are drawn within the limits (Sobol points) and simulated.
2. Profiles whose motions differ most, in units of the noise, are kept (farthest point first):
   similar motions give similar information, and a simulation costs a fiftieth of a linearization.
3. The information of each of these is computed (:mod:`feltmb.experiment.information`).
4. The experiment with the best gain and cost is taken, then the best one in addition to it, and so
   on until the budget is used.
5. A further sensor is taken if a plan of the same budget, which pays for it and measures all of its
   experiments with it, ends better.
6. The first experiment is improved by a compass search over the parameters of its profile.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.stats import qmc

from feltmb.arguments import checked
from feltmb.data import Array, Record, Sensor
from feltmb.errors import FeltmbError, InvalidParameter
from feltmb.experiment.information import (
    Belief,
    Information,
    Knowledge,
    expected_noise,
    information,
    informations,
    planned,
)
from feltmb.experiment.profiles import FAMILIES, Profile
from feltmb.files import Store
from feltmb.fit.limits import FurtherSensor, Limits, PartTest
from feltmb.fit.model import Candidate, Effect, Model
from feltmb.fit.noise import Noise
from feltmb.fit.watch import Say
from feltmb.gap.checks import with_sigma
from feltmb.gap.further_sensors import Sensors, offered
from feltmb.gap.measured import open_effects
from feltmb.gap.score import all_candidates
from feltmb.gap.visibility import (
    DecisiveTest,
    HelpfulPart,
    Visible,
    decisive_tests,
    helpful_parts,
    inseparable,
    reasons,
    visible,
)

__all__ = [
    "Design",
    "DesignedExperiment",
    "HelpfulSensor",
    "design",
    "draw_experiment",
    "sensors_now",
]

Aim = Literal["names", "sizes"]

#: Number of profiles of each family that are simulated.
DRAWS = 8
#: Number of times at which motions are compared.
POINTS = 64
#: First and smallest step of the compass search, as a share of the range of a profile parameter.
COMPASS, FINEST = 0.15, 1e-3
#: Gain below which an experiment is left out of a plan: below it are rounding errors.
LEAST_PLAN_GAIN = 1e-4
#: Number of refinements of one family before the next family is refined.
ROOM = 20


@dataclass(frozen=True, kw_only=True, eq=False)
class DesignedExperiment:
    """One experiment of a plan, or a sensor for those after it."""

    name: str
    kind: Literal["record", "part", "sensor"]
    cost: float
    """Cost of the experiment, in experiments."""
    input: str = ""
    """Name of the input that moves."""
    profile: Profile | None = None
    record: Record | None = None
    """Record with the outputs that the model predicts."""
    part: PartTest | None = None
    sensor: FurtherSensor | None = None
    before: float
    """Expected probability of the correct name before it [1], or information [log evidence]. Of a
    sensor: at the end of a plan of the same budget without it."""
    after: float
    """The same after it. Of a sensor: at the end of a plan of the same budget with it."""
    reasons: tuple[str, ...] = ()
    """Reasons for the experiment, as text."""


@dataclass(frozen=True, kw_only=True)
class HelpfulSensor:
    """What a further sensor would tell in all experiments that are made with it."""

    name: str
    """The output, what it is, and its noise, as text."""
    sensor: FurtherSensor
    """With its noise."""
    unit: str
    """Of the output."""
    before: float
    """Expected probability of the correct name after a plan without it [1], or information [log
    evidence]."""
    after: float
    """After a plan of as many records and tests that are all made with it."""
    after_paid: float
    """After a plan that pays for it from the same budget."""
    planned: bool
    """Whether the plan has it."""
    reasons: tuple[str, ...]
    """What it separates, as text."""

    @property
    def gain(self) -> float:
        """Expected gain of all further experiments by it."""
        return self.after - self.before

    @property
    def gain_per_cost(self) -> float:
        """The same for the cost of one record."""
        return self.gain / self.sensor.cost


@dataclass(frozen=True, kw_only=True, eq=False)
class Design:
    """Result of :func:`design`."""

    aim: Aim
    experiments: tuple[DesignedExperiment, ...]
    """Experiments in the order in which they should be made; plan again after each of them."""
    effects: tuple[Visible, ...]
    parts: tuple[HelpfulPart, ...]
    """Parameters whose uncertainty limits the detection of an effect most, after the plan."""
    sensors: tuple[HelpfulSensor, ...]
    """Further sensors of the limits, the largest gain for its cost first."""
    before: float
    """Expected probability of the correct name now [1], or information [log evidence]."""
    after: float
    """The same value after the plan."""
    reachable: float
    """With every experiment that was worked out, each once and with all further sensors: more than
    this nothing here brings."""
    inseparable: tuple[tuple[str, ...], ...]
    """Effects that all experiments together could not distinguish (confusion above one in ten)."""
    decisive: tuple[DecisiveTest, ...]
    """Tests of single parts that would distinguish the effects in ``inseparable``."""
    worked_out: int
    """Number of computed linearizations, without those from the store."""
    failed: int
    """Number of profiles that the model could not simulate."""
    belief: Mapping[str, float]
    """Probability of each effect before the plan [1]."""


@dataclass
class _Option:
    """A possible experiment."""

    name: str
    cost: float
    information: Information
    carrying: tuple[Information, ...] = ()
    """With each available sensor in addition; the last: with all of them."""
    input: str = ""
    family: str = ""
    knobs: tuple[float, ...] = ()
    profile: Profile | None = None
    record: Record | None = None
    part: PartTest | None = None


@checked
def design(
    model: Model,
    effects: Sequence[Effect],
    records: Sequence[Record] = (),
    *,
    limits: Limits,
    sensors: Mapping[str, Sensor] | None = None,
    budget: float = 6.0,
    aim: Aim = "names",
    belief: Belief | None = None,
    families: Sequence[str] = (),
    candidates: int = 12,
    refinements: int = 4,
    seed: int = 0,
    folder: str | Path | None = None,
    progress: Say | None = None,
) -> Design:
    """Design the most informative experiments within limits and a budget.

    Parameters
    ----------
    records
        Records that were measured before; empty: none.
    limits
        Limits of the inputs, possible tests of parts, and available further sensors.
    sensors
        Sensors of the outputs that are measured in any case. Default: those of ``limits``, else of
        the records, else all outputs, each with a noise of a thousandth of its spread.
    budget
        Cost of all experiments: a record costs 1, the costs of tests of parts and of further
        sensors are in ``limits``.
    aim
        ``names``: identify effects; ``sizes``: estimate their magnitudes.
    belief
        Prior probabilities of the effects. Default: from the records by one step, else the weights
        of the library.
    families
        Names of :data:`~feltmb.experiment.profiles.FAMILIES`; default: all.
    candidates
        Number of profiles that are evaluated in full.
    refinements
        Number of further profiles that improve the first experiment.
    seed
        Seed of the random draws.
    folder
        Folder in which evaluated profiles are stored for the next plan. It is used for mechanisms
        only, because functions of other models cannot be compared.

    Raises
    ------
    InvalidParameter
        Unknown names, a budget that is too small, or no profile that can be simulated.
    """
    limits.check(model, effects)
    chosen = _families(families)
    if not 0.0 < budget <= 1000.0:
        raise InvalidParameter(f"budget = {budget!r} experiments, expected in (0, 1000]")
    for name, count in (("candidates", candidates), ("refinements", refinements)):
        if not 0 <= count <= 100_000 or (name == "candidates" and not count):
            raise InvalidParameter(f"{name} = {count!r}, expected 1 to 100000")
    if aim not in ("names", "sizes"):
        raise InvalidParameter(f"aim = {aim!r}, expected names or sizes")
    tested = open_effects(effects, model)
    if not tested:
        raise InvalidParameter(f"plan: model {model.name} can simulate none of the effects")
    every = all_candidates(tested)
    store = None if folder is None else Store(Path(folder))
    measured_now = sensors_now(model, limits, records, sensors)
    with_offers = Sensors(measured_now, offered(limits.further, measured_now, model))
    work = _Work(model, limits, with_offers, seed, every=every, store=store, progress=progress)
    knowledge = _known(work, records, belief)
    options = work.options(chosen, candidates) + _tests(knowledge, limits)
    if not options:
        raise InvalidParameter(
            f"plan: none of the {work.failed} profiles within the limits can be simulated by "
            f"{model.name}; hint: lower inputs.most or lengthen the duration"
        )
    value = _worth(aim)
    equipped = _equip(work, knowledge, options, budget, value)
    options, budget = equipped.options, equipped.budget
    picked = _greedy(knowledge, options, budget, value)
    if picked and refinements and picked[0].part is None:
        first = picked[0]
        better = work.best_of(knowledge, first, options, refinements, value)
        if better is not first:
            picked = [better, *_greedy(
                knowledge.plus(better.information),
                [*options, better],
                budget - better.cost,
                value,
            )]  # fmt: skip
    return _result(knowledge, picked, equipped, aim, work)


def _known(work: _Work, records: Sequence[Record], belief: Belief | None) -> Knowledge:
    """What the records tell, with given probabilities or those that follow from them."""
    model, every = work.model, work.every
    known = []
    for i, r in enumerate(records):
        work.tell("what the records tell", i, len(records))
        shown = {n: s for n, s in r.sensors.items() if n in model.outputs}
        noisy = with_sigma(r, expected_noise(r)) if shown else r
        found = information(model, noisy, every, store=work.store)
        if found is not None:
            known.append(found)
    if belief is None and known:
        belief = Knowledge.start(model, every, Belief.even(every), known).linear_belief()
    return Knowledge.start(model, every, belief or Belief.even(every), known)


def _tests(knowledge: Knowledge, limits: Limits) -> list[_Option]:
    """Tests of single parts as experiments."""
    return [
        _Option(
            name=f"{t.how or 'test of a part'}: {t.parameter}",
            cost=t.cost,
            information=knowledge.part(t.parameter, t.sd),
            part=t,
        )
        for t in limits.parts
    ]


def _worth(aim: Aim) -> Callable[[Knowledge], float]:
    return Knowledge.names if aim == "names" else Knowledge.sizes


def _families(names: Sequence[str]) -> list[str]:
    unknown = [n for n in names if n not in FAMILIES]
    if unknown:
        raise InvalidParameter(f"families: {', '.join(unknown)} is none of {', '.join(FAMILIES)}")
    return list(dict.fromkeys(names)) or list(FAMILIES)


def sensors_now(
    model: Model, limits: Limits, records: Sequence[Record], given: Mapping[str, Sensor] | None
) -> dict[str, Sensor]:
    """By output that is measured in any case: as given, else by the limits, else by the records."""
    known: dict[str, Sensor] = dict(given or {})
    for r in () if given else records:
        for n, s in r.sensors.items():
            known.setdefault(n, s)
    unknown = [n for n in known if n not in model.outputs]
    if given and unknown:
        raise InvalidParameter(
            f"sensors: {', '.join(unknown)} is no output of {model.name}; there are "
            f"{', '.join(model.outputs)}"
        )
    known = {n: s for n, s in known.items() if n in model.outputs}
    if limits.sensors and not given:
        return {
            n: replace(known.get(n, Sensor(name=n, unit=model.units.get(n, "1"))), sigma=sigma)
            for n, sigma in limits.sensors.items()
        }
    return known or {n: Sensor(name=n, unit=model.units.get(n, "1")) for n in model.outputs}


def _greedy(
    knowledge: Knowledge,
    options: Sequence[_Option],
    budget: float,
    value: Callable[[Knowledge], float],
) -> list[_Option]:
    """Repeatedly take the experiment with the best gain and cost, until the budget is used."""
    out: list[_Option] = []
    now = value(knowledge)
    left = budget
    while True:
        able = [
            o for o in options if o.cost <= left + 1e-9 and not (o.part is not None and o in out)
        ]
        if not able:
            return out
        gains = [(value(knowledge.plus(o.information)) - now) / o.cost for o in able]
        best = int(np.argmax(gains))
        if not gains[best] > LEAST_PLAN_GAIN:
            return out
        out.append(able[best])
        left -= able[best].cost
        knowledge = knowledge.plus(able[best].information)
        now = value(knowledge)


def _after(knowledge: Knowledge, picked: Sequence[_Option]) -> Knowledge:
    return knowledge.plus(*(option.information for option in picked))


@dataclass
class _Equipped:
    """Options with the sensors of the plan."""

    options: list[_Option]
    budget: float
    """That is left for experiments."""
    bought: list[DesignedExperiment]
    sensors: tuple[HelpfulSensor, ...] = ()


def _equip(
    work: _Work,
    knowledge: Knowledge,
    options: list[_Option],
    budget: float,
    value: Callable[[Knowledge], float],
) -> _Equipped:
    """Take the sensors with which a plan of the same budget ends better, the best one first."""
    out = _Equipped(options, budget, [])
    if not work.sensors.offers:
        return out
    plan = _after(knowledge, _greedy(knowledge, options, budget, value))
    while work.sensors.offers:
        told, paid = [], []
        for k, offer in enumerate(work.sensors.offers):
            work.tell("further sensors", k, len(work.sensors.offers))
            carried = [
                replace(o, information=o.carrying[k]) if o.carrying else o for o in out.options
            ]
            free = _after(knowledge, _greedy(knowledge, carried, out.budget, value))
            left = _greedy(knowledge, carried, out.budget - offer.cost, value)
            paid.append(_after(knowledge, left))
            unit = work.model.units.get(offer.output) or "1"
            told.append(
                HelpfulSensor(
                    name=work.sensors.words(offer, unit),
                    sensor=offer,
                    unit=unit,
                    before=value(plan),
                    after=value(free),
                    after_paid=value(paid[-1]),
                    planned=False,
                    reasons=reasons(plan, free),
                )
            )
        best = max(range(len(told)), key=lambda k: told[k].after_paid)
        chosen = told[best]
        worth = chosen.after_paid - chosen.before > LEAST_PLAN_GAIN
        first = not out.bought
        if first:
            out.sensors = tuple(sorted(told, key=lambda h: -h.gain_per_cost))
        if not worth:
            break
        plan = paid[best]
        out.budget -= chosen.sensor.cost
        out.bought.append(
            DesignedExperiment(
                name=chosen.name,
                kind="sensor",
                cost=chosen.sensor.cost,
                sensor=chosen.sensor,
                before=chosen.before,
                after=chosen.after_paid,
                reasons=(
                    "all experiments after it are made with it: at the end of the plan without "
                    "and with it",
                    *chosen.reasons,
                ),
            )
        )
        out.options = work.equipped(chosen.sensor, out.options)
    taken = [e.sensor for e in out.bought]
    out.sensors = tuple(replace(h, planned=h.sensor in taken) for h in out.sensors)
    return out


class _Work:
    """Draws profiles and computes their information."""

    def __init__(
        self,
        model: Model,
        limits: Limits,
        sensors: Sensors,
        seed: int,
        *,
        every: tuple[Candidate, ...] = (),
        store: Store | None = None,
        progress: Say | None = None,
    ):
        self.model, self.limits, self.sensors = model, limits, sensors
        self.every, self.store, self.seed, self.progress = every, store, seed, progress
        self.failed = self.made = 0
        self._known: dict[tuple[Any, ...], _Option | None] = {}

    def tell(self, stage: str, done: int, total: int) -> None:
        if self.progress is not None:
            self.progress(stage, done, total)

    def draw(self, input_name: str, family: str, knobs: Sequence[float]) -> Profile | None:
        return FAMILIES[family].make(knobs, self.limits.inputs[input_name], self.limits)

    def record(self, input_name: str, profile: Profile, name: str) -> Record | None:
        """Record of a profile with the prediction of the model; None: it cannot be simulated."""
        rate = self.limits.sample_rate
        time = np.arange(max(16, math.floor(profile.end * rate + 1e-6) + 1)) / rate
        mode, others = _mode_of(self.model, input_name, self.limits)
        inputs = {
            n: np.full(time.size, self.limits.inputs[n].start if n in self.limits.inputs else 0.0)
            for n in others
        }
        inputs[input_name] = profile.at(time)
        own = {n: s for n, s in self.limits.input_sigma.items() if n in inputs}
        sensors = self.sensors.all
        bare = Record(
            name=name,
            time=time,
            inputs=inputs,
            outputs={n: np.zeros(time.size) for n in sensors},
            sensors=sensors,
            input_mode=mode,
            input_sigma=own,
        )
        try:
            return planned(self.model, bare, sensors)
        except FeltmbError:
            self.failed += 1
            return None

    def options(self, families: Sequence[str], count: int) -> list[_Option]:
        """Profiles with the most different motions, with their information."""
        drawn: list[tuple[str, str, tuple[float, ...], Profile, Record]] = []
        total = len(families) * len(self.limits.inputs)
        for at, (input_name, family) in enumerate(
            (i, f) for i in self.limits.inputs for f in families
        ):
            self.tell("profiles", at, total)
            width = len(FAMILIES[family].knobs)
            sobol = qmc.Sobol(width, seed=np.random.default_rng([self.seed, at]))
            for knobs in sobol.random(DRAWS):
                own = tuple(float(u) for u in knobs)
                profile = self.draw(input_name, family, own)
                if profile is None:
                    continue
                record = self.record(input_name, profile, "planned")
                if record is not None:
                    drawn.append((input_name, family, own, profile, record))
        out = []
        kept = _farthest([d[4] for d in drawn], self.sensors.now, count)
        for done, i in enumerate(kept):
            self.tell("what they tell", done, len(kept))
            found = self.option(*drawn[i][:3])
            if found is not None:
                out.append(found)
        return out

    def option(self, input_name: str, family: str, knobs: tuple[float, ...]) -> _Option | None:
        """A profile with its information; None: it is not allowed or cannot be simulated."""
        key = (input_name, family, knobs)
        if key not in self._known:
            self._known[key] = self._option(input_name, family, knobs)
        return self._known[key]

    def _option(self, input_name: str, family: str, knobs: tuple[float, ...]) -> _Option | None:
        profile = self.draw(input_name, family, knobs)
        record = None if profile is None else self.record(input_name, profile, "planned")
        if profile is None or record is None:
            return None
        ways = self.sensors.ways
        found = informations(self.model, record, self.every, ways, store=self.store)
        if found is None:
            self.failed += 1
            return None
        self.made += not found[0].kept
        unit = self.limits.inputs[input_name].unit
        return _Option(
            name=_words(profile, input_name, unit),
            cost=1.0,
            information=found[0],
            carrying=found[1:],
            input=input_name,
            family=family,
            knobs=knobs,
            profile=profile,
            record=_measured(record, self.sensors.now),
        )

    def equipped(self, sensor: FurtherSensor, options: Sequence[_Option]) -> list[_Option]:
        """The options with one of the available sensors, computed again."""
        self.sensors = self.sensors.having(sensor)
        self._known.clear()
        out = []
        for done, o in enumerate(options):
            self.tell("what they tell with it", done, len(options))
            again = o if o.part is not None else self.option(o.input, o.family, o.knobs)
            if again is not None:
                out.append(again)
        return out

    def best_of(
        self,
        knowledge: Knowledge,
        first: _Option,
        options: Sequence[_Option],
        most: int,
        value: Callable[[Knowledge], float],
    ) -> _Option:
        """Improve the first experiment and, if refinements remain, the best of other families."""

        def worth(option: _Option) -> float:
            return value(knowledge.plus(option.information))

        leaders: dict[tuple[str, str], _Option] = {}
        for option in sorted((o for o in options if o.part is None), key=lambda o: -worth(o)):
            leaders.setdefault((option.input, option.family), option)
        others = [o for k, o in leaders.items() if k != (first.input, first.family)]
        starts = [first, *others][: max(1, most // ROOM)]
        if len(starts) == 1:
            return self.improve(knowledge, first, most, value)
        own = most // (2 * len(starts))
        found = [self.improve(knowledge, s, own, value) for s in starts]
        best = max(found, key=worth)
        return self.improve(knowledge, best, most - own * len(starts), value)

    def improve(
        self,
        knowledge: Knowledge,
        first: _Option,
        most: int,
        value: Callable[[Knowledge], float],
    ) -> _Option:
        """Compass search over the parameters of a profile."""
        generator = np.random.default_rng([self.seed, 7])
        best, top = first, value(knowledge.plus(first.information))
        width, step, tried = len(first.knobs), COMPASS, 0
        while tried < most and step > FINEST:
            moved = False
            order = generator.permutation(2 * width)
            for k in order:
                if tried >= most:
                    break
                knobs = list(best.knobs)
                knobs[k // 2] = min(max(knobs[k // 2] + (step if k % 2 else -step), 0.0), 1.0)
                if tuple(knobs) == best.knobs:
                    continue
                self.tell("a better profile", tried, most)
                tried += 1
                other = self.option(best.input, best.family, tuple(knobs))
                worth = -math.inf if other is None else value(knowledge.plus(other.information))
                if other is not None and worth > top:
                    best, top, moved = other, worth, True
            if not moved:
                step *= 0.5
        return best


def _measured(record: Record, sensors: Mapping[str, Sensor]) -> Record:
    """A planned record as these sensors show it."""
    outputs = {n: y for n, y in record.outputs.items() if n in sensors}
    return replace(record, outputs=outputs, sensors={n: sensors[n] for n in outputs})


def _mode_of(model: Model, name: str, limits: Limits) -> tuple[Any, list[str]]:
    """Input mode in which a model reads an input, and all inputs of this mode.

    The limits determine it for a model that does not state its modes.
    """
    for mode, names in model.input_modes.items():
        if name in names:
            return mode, list(names)
    return "force", list(model.inputs) or list(limits.inputs)


def _farthest(records: Sequence[Record], sensors: Mapping[str, Sensor], most: int) -> list[int]:
    """Indices of records; each differs most from the previous ones, in units of the noise."""
    if len(records) <= most:
        return list(range(len(records)))
    rows = []
    for r in records:
        parts = []
        at = np.linspace(0.0, max(x.time[-1] for x in records), POINTS)
        for name, sensor in sensors.items():
            spread = max(float(np.std(x.outputs[name])) for x in records) or 1.0
            noise = Noise(sensor.sigma or 1e-3 * spread, relative=sensor.relative_sigma)
            # After the end of a record its last value is used. Large motions are compared by
            # logarithm.
            value = np.interp(at, r.time, r.outputs[name])
            value = value / noise.sd(value)
            parts.append(np.sign(value) * np.log1p(np.abs(value)))
        for name, values in r.inputs.items():  # a hundredth of the largest is one step
            unit = 0.01 * max(float(np.max(np.abs(x.inputs[name]))) for x in records)
            value = np.interp(at, r.time, values) / (unit or 1.0)
            parts.append(np.sign(value) * np.log1p(np.abs(value)))
        rows.append(np.concatenate(parts))
    table = np.array(rows)
    far = np.linalg.norm(table, axis=1)  # from nothing happens
    out: list[int] = []
    for _ in range(most):
        best = int(np.argmax(far))
        out.append(best)
        far = np.minimum(far, np.linalg.norm(table - table[best], axis=1))
    return out


def _words(profile: Profile, input_name: str, unit: str) -> str:
    """Description of a profile with its numbers."""
    parts = []
    for name, value in profile.numbers.items():
        if name in ("rise", "hold"):
            parts.append(
                f"{name} {value:.3g} s" if value >= 1.0 else f"{name} {1e3 * value:.3g} ms"
            )
        elif name in ("from", "to"):
            parts.append(f"{name} {value:.3g} Hz")
        else:
            shown = f"{value:.3g}" if unit == "1" else f"{value:.3g} {unit}"
            shown = f"{1e3 * value:.3g} mm" if unit == "m" else shown
            parts.append(shown if name == "level" else f"{name} {shown}")
    return f"{profile.family} of {input_name}: " + ", ".join(parts)


def _result(
    knowledge: Knowledge, picked: Sequence[_Option], equipped: _Equipped, aim: Aim, work: _Work
) -> Design:
    value = _worth(aim)
    start, experiments = knowledge, list(equipped.bought)
    for i, option in enumerate(picked, 1):
        then = knowledge.plus(option.information)
        experiments.append(
            DesignedExperiment(
                name=option.name,
                kind="record" if option.part is None else "part",
                cost=option.cost,
                input=option.input,
                profile=option.profile,
                record=None
                if option.record is None
                else replace(option.record, name=f"experiment_{i}"),
                part=option.part,
                before=value(knowledge),
                after=value(then),
                reasons=reasons(knowledge, then),
            )
        )
        knowledge = then
    everything = start.plus(*((o.information, *o.carrying)[-1] for o in equipped.options))
    groups = inseparable(everything)
    return Design(
        aim=aim,
        experiments=tuple(experiments),
        effects=visible(start, knowledge, everything),
        parts=helpful_parts(knowledge),
        sensors=equipped.sensors,
        before=value(start),
        after=value(knowledge),
        reachable=value(everything),
        inseparable=groups,
        decisive=decisive_tests(everything, groups),
        worked_out=work.made,
        failed=work.failed,
        belief=_by_name(start, start.belief.over(start.candidates)),
    )


def _by_name(knowledge: Knowledge, values: Array) -> dict[str, float]:
    out: dict[str, float] = {}
    for t, v in zip(knowledge.candidates, values, strict=True):
        out[t.name] = out.get(t.name, 0.0) + float(v)
    return out


@checked
def draw_experiment(
    model: Model,
    limits: Limits,
    *,
    sensors: Mapping[str, Sensor] | None = None,
    families: Sequence[str] = (),
    seed: int = 0,
) -> tuple[str, Profile, Record]:
    """A random experiment within the limits: input, profile, and the prediction of the model.

    The baseline for a plan: a random choice without optimization.

    Parameters
    ----------
    model
        Model of the machine that will be measured.
    limits
        Limits of inputs, duration and rates.
    sensors
        Sensors by output; sensors of the limits have priority. Default: all outputs.
    families
        Names of :data:`~feltmb.experiment.profiles.FAMILIES`; default: all.
    seed
        Seed of the random numbers; equal seeds give equal experiments.

    Raises
    ------
    InvalidParameter
        An unknown family, or a hundred draws gave no profile that can be simulated.
    """
    replace(limits, parts=()).check(model)  # tests of parts are not drawn
    chosen = _families(families)
    generator = np.random.default_rng([seed, 11])
    work = _Work(model, limits, Sensors(sensors_now(model, limits, (), sensors)), seed)
    names = list(limits.inputs)
    for _ in range(100):
        name = names[int(generator.integers(len(names)))]
        family = chosen[int(generator.integers(len(chosen)))]
        knobs = generator.random(len(FAMILIES[family].knobs))
        profile = work.draw(name, family, [float(u) for u in knobs])
        if profile is None:
            continue
        record = work.record(name, profile, "planned")
        if record is not None:
            return name, profile, record
    raise InvalidParameter("no profile within the limits can be simulated by " + model.name)
