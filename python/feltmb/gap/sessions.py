"""Repeats plan, measurement and diagnosis until the cause is named or no experiment helps.

Files of a session, with one folder for each step::

    0/report.json      diagnosis of the records that were there before
    1/plan.json, ...   the plan whose first experiment is made; see :mod:`feltmb.gap.plan_files`
    1/request.csv      inputs over time that are to be played (or request.toml: a test of a part, or
                       a sensor for the records to come)
    1/record.csv       what was measured (or record.toml)
    1/report.json      diagnosis of all records so far
    1/step.json        result of the step; written last, so that a session resumes there
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from feltmb.arguments import checked
from feltmb.data import Array, Record, Sensor
from feltmb.errors import DataError, FeltmbError, InvalidParameter
from feltmb.files import digest_of, is_file, make_folder, read_json, read_toml, write_text
from feltmb.fit.limits import FurtherSensor, Limits
from feltmb.fit.model import Effect, Model
from feltmb.gap.criteria import WORTH_TELLING
from feltmb.gap.designs import Design, design, sensors_now
from feltmb.gap.diagnosis import diagnose
from feltmb.gap.findings import Verdict
from feltmb.gap.further_sensors import Sensors
from feltmb.gap.information import MAGNITUDES, Belief
from feltmb.gap.limits import read_sensors
from feltmb.gap.measured import Measured, read_measured, with_measured
from feltmb.gap.options import Options
from feltmb.gap.plan_files import InputFiles, read_request, request_file, write_design
from feltmb.gap.report import Report, write_report
from feltmb.gap.resumed import discard
from feltmb.units import unit_suffix

__all__ = ["Session", "SessionStep", "session"]

Outcome = Literal[
    "named", "inseparable", "nothing is missing", "nothing more to learn", "out of budget"
]
#: Verdicts that end a session without a cause, because the model explains the records.
_COMPLETE = (Verdict.NO_GAP.value, Verdict.CALIBRATED.value)
#: Factor of the duration of a request beyond which a record is no answer to it, shares of it
#: between which the duration is not told, and relative difference of an input that is told.
OTHER_DURATION, SHORTER, LONGER, OTHER_INPUT = 20.0, 0.9, 2.0, 0.5
#: Step 0 of a session.
_BEFORE = {"kind": "", "name": "records from before", "cost": 0.0, "expected": 0.0}
#: Entries of a step that are required to resume.
_KEYS = ("number", "kind", "name", "cost", "verdict", "named", "one_of", "statement", "expected")


@dataclass(frozen=True, kw_only=True)
class SessionStep:
    """One experiment and the diagnosis after it; number 0: before the first experiment."""

    number: int
    kind: str
    """"record", "part", "sensor", or "" for what was there before."""
    name: str
    cost: float
    verdict: str
    """Verdict of the diagnosis; "" if there is no record yet."""
    named: tuple[str, ...]
    """Effects that the diagnosis named, and what a test of the session found to differ from its
    table."""
    one_of: tuple[str, ...]
    statement: str
    expected: float
    """Probability of the correct name that the plan predicted for the time after it [1]."""
    warnings: tuple[str, ...] = ()
    """Warnings of the diagnosis: noise, copies of records, tolerances."""


@dataclass(frozen=True, kw_only=True)
class Session:
    """Result of :func:`session`."""

    outcome: Outcome
    statement: str
    steps: tuple[SessionStep, ...]
    report: Mapping[str, Any] | None
    """report.json of the last diagnosis; None: there was no diagnosis."""


@checked
def session(
    model: Model,
    effects: Sequence[Effect],
    run: Callable[[Path, Path], None],
    read: Callable[[Path], Sequence[Record]],
    folder: str | Path,
    *,
    limits: Limits,
    records: Sequence[Record] = (),
    sensors: Mapping[str, Sensor] | None = None,
    measured: Sequence[Measured] = (),
    budget: float = 6.0,
    options: Options | None = None,
    candidates: int = 12,
    refinements: int = 4,
    seed: int = 0,
    units: Mapping[str, str] | None = None,
    input_files: InputFiles | None = None,
    progress: Callable[[str, int, int], None] | None = None,
    diagnosing: Callable[[Any], None] | None = None,
    told: Callable[[SessionStep], None] | None = None,
) -> Session:
    """Plan, measure and diagnose until the cause is named or inseparable, or the budget is spent.

    Parameters
    ----------
    run
        ``run(request, answer)`` performs a request and writes the measurement. A request is a CSV
        of time and inputs, and the answer is a CSV of a record. Or a request is a TOML with
        ``[part]``, and the answer is a TOML with ``[measured.NAME]``. Or it is a TOML with
        ``[sensor]``: all records from then on have this output, and the answer is a TOML with
        ``[sensors.OUTPUT]`` and its ``sigma``.
    read
        Records of an answer.
    folder
        Folder of the session. An interrupted session continues.
    records
        Records that were measured before.
    budget
        In experiments.
    units, input_files
        See :func:`~feltmb.gap.plan_files.write_design`.
    progress, diagnosing
        Functions that receive the progress of a plan and of a diagnosis.
    told
        Function that receives each step, also those of an earlier call.

    Raises
    ------
    DataError
        An answer is missing or cannot be read.
    InvalidParameter
        The folder holds another session.
    """
    place = make_folder(folder)
    limits.check(model, effects)
    if not 0.0 < budget <= 1000.0:
        raise InvalidParameter(f"budget = {budget!r} experiments, expected in (0, 1000]")
    _same_session(place, with_measured(model, measured, effects), effects, limits, records, seed)
    state = _State(model, effects, limits, records, sensors, measured)
    steps: list[SessionStep] = []
    report: Mapping[str, Any] | None = None
    number = 0

    def ended(outcome: Outcome, text: str) -> Session:
        return Session(outcome=outcome, statement=text, steps=tuple(steps), report=report)

    while True:
        here = place / str(number)
        step = _finished_step(here)
        warnings: tuple[str, ...] = ()
        asked: Mapping[str, Any] = _BEFORE
        if number:
            if step is None and not _asked(here):
                left = budget - state.spent
                plan = design(
                    state.measured_model,
                    effects,
                    state.known,
                    limits=state.limits.without_tests(m.parameter for m in state.parts),
                    sensors=state.measuring,
                    budget=left,
                    belief=None if report is None else Belief.of_report(report),
                    candidates=candidates,
                    refinements=refinements,
                    seed=seed,
                    folder=place / ".plan",
                    progress=progress,
                )
                done = _complete(report) and not _more_to_show(plan, effects)
                if done or not plan.experiments or plan.after - plan.before < WORTH_TELLING:
                    return ended(*_at_an_end(report, plan, effects, left))
                make_folder(here)
                _ask(plan, here, units or {}, input_files)
            asked = _read_asked(here)
            request = here / ("request.csv" if asked["kind"] == "record" else "request.toml")
            answer = request.with_name(request.name.replace("request", "record"))
            if not is_file(answer):
                run(request, answer)
            warnings = state.take(asked, request, answer, number, read, new=step is None)
        if step is None:
            found = None
            if state.known and asked["kind"] != "sensor":
                found = _diagnosed(
                    state.measured_model, effects, state.known, options, here, diagnosing
                )
            step = state.step(number, asked, found, warnings)
            make_folder(here)
            write_text(here / "step.json", json.dumps(asdict(step), indent=1) + "\n", force=True)
        if is_file(here / "report.json"):
            report = read_json(here / "report.json")
        if number or state.known:
            steps.append(step)
            if told is not None:
                told(step)
        if step.verdict == Verdict.NAMED or (step.verdict in _COMPLETE and step.named):
            return ended("named", step.statement)
        if state.spent >= budget - 1e-9:
            told_last = [s.statement for s in steps if s.statement]
            return ended("out of budget", (told_last or ["No experiment gave a record."])[-1])
        number += 1


class _State:
    """What a session knows so far: records, tests of parts, sensors, and what it has spent."""

    def __init__(
        self,
        model: Model,
        effects: Sequence[Effect],
        limits: Limits,
        records: Sequence[Record],
        sensors: Mapping[str, Sensor] | None,
        measured: Sequence[Measured],
    ):
        self._model, self._effects = model, effects
        self._records, self._measured_before = records, len(measured)
        self.limits = limits
        self.known = [_with_noise(r, limits) for r in records]
        self.parts = list(measured)
        self.measuring = sensors
        self.spent = 0.0

    @property
    def measured_model(self) -> Model:
        """The model with the tests of parts."""
        return with_measured(self._model, self.parts, self._effects)

    def take(
        self,
        asked: Mapping[str, Any],
        request: Path,
        answer: Path,
        number: int,
        read: Callable[[Path], Sequence[Record]],
        *,
        new: bool,
    ) -> tuple[str, ...]:
        """Take up the answer to a request; returns warnings about a new one."""
        warnings: tuple[str, ...] = ()
        if asked["kind"] == "record":
            found = _measured_records(read, answer, number, self.measuring, self.limits)
            if new:
                warnings = _not_as_asked(found, request, answer)
            self.known += found
        elif asked["kind"] == "sensor":
            wanted = FurtherSensor(**read_toml(request)["sensor"])
            sigma = _answered_sigma(answer, self._model, wanted.output)
            now = sensors_now(self._model, self.limits, self._records, self.measuring)
            had = Sensors(now, self.limits.further).answered(wanted, sigma)
            self.measuring, self.limits = had.now, replace(self.limits, further=had.offers)
            warnings = _noisier(wanted, sigma, now, self._model)
        else:
            self.parts += _answered_tests(request, answer, self._model, self._effects)
        self.spent += float(asked["cost"])
        return warnings

    def step(
        self,
        number: int,
        asked: Mapping[str, Any],
        found: Report | None,
        warnings: tuple[str, ...],
    ) -> SessionStep:
        """A step with the diagnosis after it; ``found``: None if there was none."""
        asked_for = {
            "number": number,
            "kind": asked["kind"],
            "name": asked["name"],
            "cost": float(asked["cost"]),
            "expected": float(asked["expected"]),
        }
        if found is None:
            return SessionStep(
                **asked_for, verdict="", named=(), one_of=(), statement="", warnings=warnings
            )
        by_test = _found_by_test(found, self.parts[self._measured_before :])
        return SessionStep(
            **asked_for,
            verdict=str(found.verdict),
            named=(*found.named, *by_test),
            one_of=tuple(found.one_of),
            statement=found.statement,
            warnings=(*warnings, *found.checks.warnings),
        )


def _complete(report: Mapping[str, Any] | None) -> bool:
    """Whether the model explains the records."""
    return report is not None and report.get("verdict") in _COMPLETE


def _found_by_test(report: Report, tests: Sequence[Measured]) -> tuple[str, ...]:
    """Tested parameters and effects whose values differ from the table."""
    tested = {m.parameter for m in tests}
    return tuple(g.name for g in report.given if g.differs and g.name in tested)


def _hidden(plan: Design, effects: Sequence[Effect], *, planned: bool) -> list[str]:
    """Effects not detectable at their smallest expected magnitude, now or after the plan."""
    scale = {e.name: e.scale for e in effects}
    return [
        row.effect
        for row in plan.effects
        if (row.smallest if planned else row.smallest_before) > MAGNITUDES[0] * scale[row.effect]
    ]


def _more_to_show(plan: Design, effects: Sequence[Effect]) -> bool:
    """Whether a plan makes an effect detectable at its smallest expected magnitude.

    Any experiment reduces the smallest detectable magnitudes, which alone is no reason for it.
    """
    now, then = (_hidden(plan, effects, planned=p) for p in (False, True))
    return not set(now) <= set(then)


def _at_an_end(
    report: Mapping[str, Any] | None, plan: Design, effects: Sequence[Effect], left: float
) -> tuple[Outcome, str]:
    """Reason why there is no further experiment."""
    open_ = [] if report is None else [*report.get("one_of", ()), *report.get("named", ())]
    if open_:
        return (
            "inseparable",
            f"No experiment within limits and budget separates {', '.join(open_)} from similar "
            f"causes: the probability of the correct name would change from {plan.before:.0%} to "
            f"{plan.after:.0%} with the remaining budget of {left:g}, and to "
            f"{plan.reachable:.0%} with all tested ones." + _would_separate(plan, open_),
        )
    if report is not None and _complete(report):
        hidden = _hidden(plan, effects, planned=False)
        text = (
            f"The records would show each effect at {MAGNITUDES[0]:g} times its expected magnitude"
        )
        if hidden:
            text += f", but {', '.join(hidden)}, which no experiment within the limits shows"
        return "nothing is missing", f"{report['statement']} {text}. {left:g} experiments are left."
    return (
        "nothing more to learn",
        "No experiment within the limits is expected to detect a cause that these records do not "
        f"show: {plan.before:.0%} of the effects of the library would be named now, "
        f"{plan.after:.0%} with the remaining budget of {left:g}, {plan.reachable:.0%} with "
        "all tested ones.",
    )


def _would_separate(plan: Design, names: Sequence[str]) -> str:
    """Sentence about tests of single parts with which a further session could go on."""
    tests = [t.text for t in plan.decisive if t.effect in names]
    if not tests:
        return ""
    return (
        " A test of its part, with this standard deviation, separates a cause from the others: "
        f"{', '.join(tests)}."
    )


def _same_session(
    place: Path,
    model: Model,
    effects: Sequence[Effect],
    limits: Limits,
    records: Sequence[Record],
    seed: int,
) -> None:
    """Raise an error if a folder belongs to another session."""
    values = [v for r in records for _, v in sorted({**r.inputs, **r.outputs}.items())]
    own = {
        "model": model.name,
        "parameters": digest_of(
            [(p.name, p.value, p.lower, p.upper, p.sd) for p in model.parameters]
        ),
        "effects": digest_of([(e.name, e.scale, e.bounds) for e in effects]),
        "limits": digest_of(repr(limits)),
        "records": [*(r.name for r in records), digest_of(*values)],
        "seed": seed,
    }
    path = place / "session.json"
    if not is_file(path):
        write_text(path, json.dumps(own, indent=1) + "\n")
        return
    other = read_json(path)
    if not isinstance(other, dict) or other.keys() != own.keys():
        raise InvalidParameter(
            f"{path}: is of another version of feltmb, or damaged; give another folder"
        )
    changed = [k for k in own if other[k] != own[k]]
    if changed:
        raise InvalidParameter(
            f"{place}: holds another session, with other {', '.join(changed)}; give another "
            "folder, or what this session was started with"
        )


def _finished_step(here: Path) -> SessionStep | None:
    """A step of an earlier run; None: it was not completed."""
    path = here / "step.json"
    if not is_file(path):
        return None
    raw = read_json(path)
    if not isinstance(raw, dict) or any(k not in raw for k in _KEYS):
        raise DataError(f"{path}: is damaged; remove it, and the step is diagnosed again")
    values = {k: raw[k] for k in _KEYS}
    values["named"], values["one_of"] = tuple(raw["named"]), tuple(raw["one_of"])
    return SessionStep(**values, warnings=tuple(raw.get("warnings", ())))


def _asked(here: Path) -> bool:
    return is_file(here / "asked.json")


def _read_asked(here: Path) -> dict[str, Any]:
    raw = read_json(here / "asked.json")
    if not isinstance(raw, dict) or not {"kind", "name", "cost", "expected"} <= raw.keys():
        raise DataError(f"{here / 'asked.json'}: is damaged; remove the folder to plan again")
    if raw["kind"] not in ("record", "part", "sensor"):
        raise DataError(
            f"{here / 'asked.json'}: kind {raw['kind']!r}, expected record, part or sensor; a "
            "session of another version of feltmb goes on with that version"
        )
    return raw


def _ask(
    plan: Design, here: Path, units: Mapping[str, str], input_files: InputFiles | None
) -> None:
    """Write the plan and the request of its first experiment; asked.json is written last."""
    first = plan.experiments[0]
    write_design(plan, here, units=units, input_files=input_files, force=True)
    request_file(first, here / "request", units=units, force=True)
    asked = {
        "kind": first.kind,
        "name": first.name,
        "cost": first.cost,
        "expected": first.after,
        "reasons": list(first.reasons),
    }
    write_text(here / "asked.json", json.dumps(asked, indent=1) + "\n", force=True)


def _answered_tests(
    request: Path, answer: Path, model: Model, effects: Sequence[Effect]
) -> tuple[Measured, ...]:
    """Results of the test that was asked for, and perhaps of others."""
    if not is_file(answer):
        raise DataError(f"{answer}: missing; expected [measured.NAME] with value and sd")
    found = read_measured(answer, model, effects)
    wanted = read_toml(request)["part"]["parameter"]
    if wanted not in [m.parameter for m in found]:
        raise DataError(
            f"{answer}: got {', '.join(m.parameter for m in found) or 'no test'}, expected the "
            f"test of {wanted}"
        )
    return found


def _answered_sigma(answer: Path, model: Model, output: str) -> float:
    """Noise of the sensor that was asked for [its unit]."""
    if not is_file(answer):
        raise DataError(f"{answer}: missing; expected [sensors.OUTPUT] with sigma")
    found = read_sensors(answer, model)
    if list(found) != [output]:
        raise DataError(
            f"{answer}: got {', '.join(found) or 'no sensor'}, expected the sensor of {output}"
        )
    return found[output]


def _noisier(
    wanted: FurtherSensor, sigma: float, now: Mapping[str, Sensor], model: Model
) -> tuple[str, ...]:
    """Warning that a sensor has more noise than the plan assumed; empty: it has not."""
    assumed = float(wanted.sigma or 0.0)
    if sigma <= assumed:
        return ()
    unit = model.units.get(wanted.output) or "1"
    own = unit_suffix(unit)
    text = f"{wanted.output}: noise {sigma:g}{own}, the plan assumed {assumed:g}{own}"
    old = now[wanted.output].sigma if wanted.output in now else None
    if old is not None and sigma >= old:
        text += f"; the present sensor with {old:g}{own} is used further"
    return (text,)


def _measured_records(
    read: Callable[[Path], Sequence[Record]],
    answer: Path,
    number: int,
    sensors: Mapping[str, Sensor] | None,
    limits: Limits,
) -> list[Record]:
    """Records of an answer; noise that they do not state is that of the limits."""
    if not is_file(answer):
        raise DataError(f"{answer}: missing; expected the record that the command writes")
    try:
        found = read(answer)
    except FeltmbError as error:
        raise DataError(
            f"step {number}: {error}. Correct {answer}, or remove it to measure again"
        ) from None
    out = []
    for k, r in enumerate(found):
        name = f"experiment_{number}" + (f"_{k + 1}" if len(found) > 1 else "")
        known = {
            n: replace(s, sigma=(sensors or {}).get(n, s).sigma) if s.sigma is None else s
            for n, s in r.sensors.items()
        }
        out.append(_with_noise(replace(r, name=name, sensors=known), limits))
    return out


def _with_noise(record: Record, limits: Limits) -> Record:
    """The record with the noise that the limits state for inputs for which it states none."""
    noise = {n: s for n, s in limits.input_sigma.items() if n in record.inputs}
    return replace(record, input_sigma={**noise, **record.input_sigma})


def _difference(one: Array, other: Array) -> float:
    """Norm of the difference relative to the larger one [1]."""
    size = max(float(np.linalg.norm(one)), float(np.linalg.norm(other)))
    return float(np.linalg.norm(one - other)) / size if size > 0.0 else 0.0


def _not_as_asked(records: Sequence[Record], request: Path, answer: Path) -> tuple[str, ...]:
    """Warnings that records differ from their request.

    Raises
    ------
    DataError
        The duration is that of another request.
    """
    time, inputs = read_request(request)
    wanted = float(time[-1] - time[0])
    out = []
    for r in records:
        lasts = float(r.time[-1] - r.time[0])
        if not wanted / OTHER_DURATION < lasts < wanted * OTHER_DURATION:
            raise DataError(
                f"{answer}: lasts {lasts:.4g} s, expected {wanted:.4g} s as in {request.name}: is "
                "the unit of the time right? Correct it, or remove it to measure again"
            )
        if not SHORTER * wanted < lasts < LONGER * wanted:
            out.append(f"{r.name}: lasts {lasts:.4g} s, {request.name} {wanted:.4g} s")
        for name, value in inputs.items():
            if name not in r.inputs:
                continue
            # The record may begin before the request, or its clock somewhere else.
            clocks = (r.time, r.time - r.time[0] + time[0])
            left = min(_difference(r.inputs[name], np.interp(t, time, value)) for t in clocks)
            if left > OTHER_INPUT:
                out.append(
                    f"{r.name}: the recorded {name} differs from {request.name} by {left:.0%} of "
                    "the larger root mean square"
                )
    return tuple(out)


def _diagnosed(
    model: Model,
    effects: Sequence[Effect],
    records: Sequence[Record],
    options: Options | None,
    here: Path,
    diagnosing: Callable[[Any], None] | None,
) -> Report:
    make_folder(here)
    own = replace(options or Options(advice=False), resume=here / ".resume")
    report = diagnose(model, effects, records, None, own, diagnosing)
    write_report(report, here, force=True)
    if report.fits is not None:
        discard(report.fits)
    return report
