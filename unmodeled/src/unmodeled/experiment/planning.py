"""What proposed records would tell, and which of them to make first.

1. Each proposed record is simulated, and its information is computed
   (:mod:`unmodeled.experiment.information`).
2. The record with the largest gain comes first, then the best one in addition to it, and so on.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from unmodeled.arguments import checked
from unmodeled.data import Record
from unmodeled.errors import Error, InvalidParameter
from unmodeled.experiment.information import NAMED, Aim, Belief, Information, Knowledge, Study
from unmodeled.fit.measured import no_test_of
from unmodeled.models.model import Effect, Model
from unmodeled.search.records import ready_records
from unmodeled.search.result import plain

#: Smallest decrease of the probability of confusion, and smallest gain by a test, that are shown.
LEAST_SHOWN = 0.02
#: Accuracy of the test of a parameter: share of the uncertainty that the plan leaves, but at least
#: this share of its tolerance.
SHARE_OF_SPREAD, SHARE_OF_TOLERANCE = 0.5, 0.1


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class PlannedRecord:
    """One proposed record."""

    record: Record
    """The record with the outputs that the model predicts."""
    before: float
    """Expected probability of the correct name before it [1], or information [log evidence]."""
    after: float
    """The same after it."""
    detected: tuple[int, int]
    """Number of causes that are detectable at their expected magnitude, before and after it."""
    separated: tuple[str, str, float, float] | None
    """The cause and the rival that it separates best, and the probability of the rival, if the
    cause is right and no other one is possible, before and after it."""

    def reasons(self, causes: int) -> list[str]:
        """What it is good for, in sentences. ``causes``: number of all causes."""
        before, after = self.detected
        out = []
        if after > before:
            out.append(
                f"detects {after} of {causes} causes at their expected magnitude ({before} before)"
            )
        if self.separated is not None:
            cause, rival, was, then = self.separated
            out.append(
                f"separates {cause} from {rival}: probability of confusion {was:.0%} -> {then:.0%}"
            )
        return out


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
class SinglePartTest:
    """A test of one part by itself that would help in addition to all proposed records."""

    name: str
    """Parameter or effect that the test measures."""
    sd: float
    """Standard deviation that the test needs [unit]."""
    unit: str
    after: float
    """Expected probability of the correct name with it [1], or information [log evidence]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """Result of :func:`plan`."""

    aim: Aim
    records: tuple[PlannedRecord, ...]
    """The proposed records, the most informative first; plan again after each of them."""
    effects: tuple[Visible, ...]
    """All causes that may be missing, the most probable first."""
    tests: tuple[SinglePartTest, ...]
    """Tests of parts that would help, the most helpful first."""
    before: float
    """Expected probability of the correct name now [1], or information [log evidence]."""
    after: float
    """The same value after all proposed records."""
    inseparable: tuple[tuple[str, ...], ...]
    """Causes that all records together could not distinguish."""
    failed: tuple[str, ...]
    """Names of the records that the model could not simulate."""
    repeats: tuple[str, ...] = ()
    """Records to repeat with another input, because causes act in some records only."""

    def as_dict(self) -> dict[str, Any]:
        """The plan as one JSON object: records by name; an infinite number is a text."""
        bare = replace(self, records=())
        rows = [{**vars(r), "record": r.record.name} for r in self.records]
        out: dict[str, Any] = plain(bare)
        return out | {"records": [plain(r) for r in rows]}


@checked
def plan(
    model: Model,
    effects: Sequence[Effect],
    proposed: Sequence[Record],
    records: Sequence[Record] = (),
    *,
    aim: Aim = "names",
    belief: Belief | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> Plan:
    """Compute what proposed records would tell about the causes, and order them by it.

    Parameters
    ----------
    model
        Model of the machine.
    effects
        Effects that it may lack.
    proposed
        Records that could be made. Their inputs, and the sensors of their outputs count; the values
        of the outputs do not. The noise of a sensor without a stated one is a thousandth of the
        spread of the predicted output.
    records
        Records that were measured before. Their inputs and sensors count; what they say about
        causes comes from ``belief``.
    aim
        ``names``: identify causes; ``sizes``: estimate their magnitudes.
    belief
        Result of a diagnosis of the records (:meth:`Belief.of_report`). Default: the prior odds of
        a diagnosis.
    progress
        Is called with the stage, the completed number, and the total.

    Returns
    -------
    Plan
        The proposed records in their order, and what they tell.

    Raises
    ------
    InvalidParameter
        No record is proposed, none can be simulated, or the model can simulate none of the effects.

    Examples
    --------
    A line that may be bent: small inputs cannot show it, a large one can.

    >>> import numpy as np
    >>> from unmodeled import Effect, LinearModel, Parameter, Record, Sensor
    >>> from unmodeled.experiment import plan
    >>> line = LinearModel(
    ...     output="y", columns={"k": lambda r: r.inputs["u"]},
    ...     parameters=[Parameter(name="k", value=1.0, sd=0.1)],
    ... )
    >>> bend = Effect(name="bend", component="line", regressor=lambda r, s: r.inputs["u"] ** 2)
    >>> time = np.linspace(0.0, 1.0, 200)
    >>> sensors = {"y": Sensor(name="y", sigma=0.05)}
    >>> proposed = [
    ...     Record(name=name, time=time, inputs={"u": size * time}, outputs={"y": 0.0 * time},
    ...            sensors=sensors)
    ...     for name, size in (("small", 0.1), ("large", 1.0))
    ... ]
    >>> [p.record.name for p in plan(line, [bend], proposed).records]
    ['large', 'small']
    """
    if not proposed:
        raise InvalidParameter("plan: proposed is empty, expected at least one record")
    if records:
        ready = ready_records(model, records)
        model, records = ready.model, ready.records
    study = Study.of(model, effects, belief)
    show = progress or (lambda *_: None)
    start = Knowledge(study, aim=aim)
    for i, r in enumerate(records):
        show("what the records tell", i, len(records))
        start = start.plus(study.linearized(r))
    if belief is not None and records:
        start = replace(start, before=start.gram)
    options, failed = [], {}
    for i, (given, made) in enumerate(zip(proposed, study.simulated(proposed), strict=True)):
        show("expected information", i, len(proposed))
        try:
            if made is None:
                raise InvalidParameter("its simulation failed")
            options.append((made, study.linearized(made)))
        except Error as error:
            failed[given.name] = str(error)
    if not options:
        name, why = next(iter(failed.items()))
        raise InvalidParameter(
            f"plan: {model.name} can simulate none of the {len(proposed)} proposed records "
            f"({name}: {why})"
        )
    found = _result(start, options, tuple(failed))
    return found if belief is None else replace(found, repeats=belief.repeats)


def _result(
    start: Knowledge, options: list[tuple[Record, Information]], failed: tuple[str, ...]
) -> Plan:
    knowledge, records, names = start, [], start.study.names
    while options:
        gains = [knowledge.plus(information) for _, information in options]
        best = int(np.argmax([g.value for g in gains]))
        then, (record, _) = gains[best], options.pop(best)
        records.append(
            PlannedRecord(
                record=record,
                before=knowledge.value,
                after=then.value,
                detected=(len({*names[knowledge.detected]}), len({*names[then.detected]})),
                separated=_separated(knowledge, then),
            )
        )
        knowledge = then
    groups = knowledge.inseparable()
    return Plan(
        aim=start.aim,
        records=tuple(records),
        effects=_visible(start, knowledge),
        tests=_tests(knowledge, groups),
        before=start.value,
        after=knowledge.value,
        inseparable=groups,
        failed=failed,
    )


def _separated(before: Knowledge, after: Knowledge) -> tuple[str, str, float, float] | None:
    """The pair of causes that an experiment separates best, weighted by their probability."""
    weights, names = before.study.possible, before.study.names
    was, then = before.chance, after.chance
    decrease = (was - then) * np.minimum(weights[:, None], weights[None, :])
    a, b = np.unravel_index(int(np.argmax(decrease)), decrease.shape)
    if was[a, b] - then[a, b] < LEAST_SHOWN:
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


def _tests(knowledge: Knowledge, groups: Sequence[Sequence[str]]) -> tuple[SinglePartTest, ...]:
    """Tests of single parts that would help.

    Of a parameter: to half of its uncertainty. Of an inseparable effect: as exact as it takes to
    tell it from another one. With the standard deviation s, the magnitude m has the log evidence
    m^2 / (2 s^2).
    """
    study, spread = knowledge.study, knowledge.spread()
    wanted = [
        (p.name, max(SHARE_OF_SPREAD * spread[p.name], SHARE_OF_TOLERANCE * p.sd), p.unit)
        for p in study.model.parameters
        if 0.0 < p.sd < math.inf and p.of_the_machine
    ]
    for i, c in enumerate(study.causes):
        tested = c.effect is not None and not no_test_of(c.name, study.model, study.effects)
        if tested and any(c.name in g for g in groups):
            scale, unit = study.size(c)
            size = knowledge.expected[i] * scale
            wanted.append((c.name, size / math.sqrt(2.0 * NAMED), unit))
    tests = [
        SinglePartTest(
            name=name, sd=sd, unit=unit, after=knowledge.plus(knowledge.test(name, sd)).value
        )
        for name, sd, unit in dict.fromkeys(wanted)
    ]
    useful = [t for t in tests if t.after - knowledge.value > LEAST_SHOWN]
    return tuple(sorted(useful, key=lambda t: -t.after))
