"""Detectability of effects before any measurement, and records and sensors that would help."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from feltmb.arguments import checked
from feltmb.data import Record, Sensor
from feltmb.errors import DataError, InvalidParameter
from feltmb.experiment.information import Belief, Information, Knowledge, linearized, planned
from feltmb.fit.model import Effect, Model
from feltmb.gap.checks import faults_against
from feltmb.gap.confusion import confused_groups, confusion_if_detected
from feltmb.gap.measured import open_effects
from feltmb.gap.score import all_candidates
from feltmb.gap.smoke_test import try_effects
from feltmb.gap.visibility import Visible, reasons, visible

__all__ = ["Experiment", "Plan", "plan"]


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """A further record or sensor, and its benefit."""

    name: str
    kind: str
    """"record" or "sensor"."""
    after: float
    """Expected probability of the correct name with it [1]."""
    reasons: tuple[str, ...]
    """What it detects and separates, as text."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Result of :func:`plan`."""

    effects: tuple[Visible, ...]
    """Effects without and with the planned records."""
    inseparable: tuple[tuple[str, ...], ...]
    """Effects that the planned records cannot distinguish (confusion above one in ten)."""
    after: float
    """Expected probability of the correct name with the planned records [1]."""
    experiments: tuple[Experiment, ...]
    """Ranked, the best first."""


@checked
def plan(
    model: Model,
    effects: Sequence[Effect],
    records: Sequence[Record],
    *,
    channels: Sequence[str] | None = None,
    sensors: Mapping[str, Sensor] | None = None,
    experiments: Sequence[Record] = (),
) -> Plan:
    """Compute which effects planned records could detect, from the model alone.

    Parameters
    ----------
    records
        Planned runs: their inputs and clock count, their outputs do not.
    channels
        Outputs that will be measured; default: those of the records.
    sensors
        Sensors by output, also of outputs that are not among the channels: these are offered as
        further sensors. An output without a sensor gets a noise of a thousandth of its spread.
    experiments
        Further runs that could be made.

    Raises
    ------
    DataError
        Records that do not match the model.
    InvalidParameter
        Unknown outputs, faulty effects, or a record that the model cannot simulate.
    """
    if not records:
        raise InvalidParameter("plan: no planned records; give inputs over time")
    wanted = list(channels) if channels is not None else list(records[0].outputs)
    unknown = [c for c in wanted if c not in model.outputs]
    if unknown or not wanted:
        raise InvalidParameter(
            f"channels: {', '.join(unknown) or 'none'} is no output of {model.name}; "
            f"there are {', '.join(model.outputs)}"
        )
    faults = faults_against(model, [*records, *experiments])
    if faults:
        raise DataError("plan: " + "; ".join(faults))
    known = {n: Sensor(name=n) for n in model.outputs}
    for r in reversed(records):
        known |= r.sensors
    known |= sensors or {}
    tested = open_effects(effects, model)
    every = all_candidates(tested)
    further = [n for n in model.outputs if n not in wanted]
    ways = [
        dict.fromkeys(n, 1.0) for n in (wanted, *([*wanted, n] for n in further), model.outputs)
    ]

    def expected(record: Record) -> Record:
        return planned(model, record, {n: known[n] for n in model.outputs})

    def told(record: Record, ways: Sequence[Mapping[str, float]]) -> tuple[Information, ...]:
        found = linearized(model, expected(record), every, ways)
        if found is None:
            raise InvalidParameter(f"record {record.name}: the model has no derivatives there")
        return found

    try_effects(model, tested, expected(records[0]))
    start = Knowledge.start(model, every, Belief.even(every))
    now, *with_sensor, everything = (
        start.plus(*found) for found in zip(*(told(r, ways) for r in records), strict=True)
    )
    more = [told(r, ways[:1]) for r in experiments]
    options = [(r.name, "record", now.plus(*own)) for r, own in zip(experiments, more, strict=True)]
    options += [(n, "sensor", then) for n, then in zip(further, with_sensor, strict=True)]
    ranked = [
        Experiment(name=name, kind=kind, after=then.names(), reasons=reasons(now, then))
        for name, kind, then in options
    ]
    return Plan(
        effects=visible(start, now, everything.plus(*(own for (own,) in more))),
        inseparable=confused_groups(
            [t.name for t in every], confusion_if_detected(now.gram, now.expected())
        ),
        after=now.names(),
        experiments=tuple(sorted(ranked, key=lambda e: (-e.after, e.name))),
    )
