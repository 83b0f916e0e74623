"""Comparison of measured files with the mechanism, and a diagnosis in the background."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Coroutine, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from feltmb.action.customer import finding
from feltmb.adapters import mechanism_model
from feltmb.adapters.findings import bodies_at
from feltmb.graphics.viewer.packing import pack_columns, pack_times
from feltmb.live.knobs import Bench
from feltmb.live.proposals import Abandoned, propose
from feltmb.live.states import Turned, fault_of
from unmodeled import Options, Report, Stop, check, diagnose
from unmodeled.data import ReadOptions, Record
from unmodeled.data.files import read_each
from unmodeled.data.mapping import Signals
from unmodeled.errors import InvalidParameter
from unmodeled.experiment import Belief
from unmodeled.fit import Effect
from unmodeled.page.showing import drawn, rows, teller
from unmodeled.page.uploads import MOST_FILES, Uploads
from unmodeled.report.words import clause, percent
from unmodeled.search.result import Change

#: Number of samples of a curve, number of drawn records.
MOST_SAMPLES, MOST_RECORDS = 1500, 6
#: Number of listed parameters and of listed candidates; smallest probability of a candidate [1].
MOST_ROWS, LEAST = 8, 0.01

Text = Annotated[str, Field(max_length=200)]


class _Reading(BaseModel):
    """Entries of the form of a file."""

    model_config = ConfigDict(extra="forbid")
    columns: Annotated[dict[Text, Text], Field(max_length=50)] = {}
    units: Annotated[dict[Text, Text], Field(max_length=50)] = {}
    scales: Annotated[dict[Text, Text], Field(max_length=50)] = {}
    origins: Annotated[dict[Text, Text], Field(max_length=50)] = {}
    frame_rate: Annotated[float, Field(gt=0, le=1e9)] | None = None
    y_up: bool = False

    def options(self) -> ReadOptions:
        """The entries as options of ``gap check``."""
        return ReadOptions(**dict(self))


class _Asked(BaseModel):
    model_config = ConfigDict(extra="forbid")
    id: Annotated[int, Field(ge=0, le=2**53)] = 0
    files: Annotated[list[Text], Field(max_length=MOST_FILES)] = []
    reading: _Reading = _Reading()
    turned: Turned = Turned()
    seconds: Annotated[float, Field(gt=0, le=7200)] = 300.0


class Measured:
    """Comparisons and the diagnosis of one page."""

    def __init__(
        self,
        bench: Callable[[], Bench],
        uploads: Uploads,
        pool: Executor,
        post: Callable[[str, dict[str, Any]], None],
    ):
        self._bench, self._uploads, self._pool, self._post = bench, uploads, pool, post
        self._asked: _Asked | None = None
        self._wake = asyncio.Event()
        self._stop = False
        self._running: asyncio.Task[None] | None = None
        self._believed: tuple[Any, Belief] | None = None

    def ask(self, given: Mapping[str, Any]) -> None:
        """Compare files with the changed mechanism; this replaces the previous request."""
        self._asked = _read(given)
        self._wake.set()

    def diagnose(self, given: Mapping[str, Any]) -> None:
        """Start a diagnosis; only one diagnosis or plan runs at a time."""
        self._begin(self._diagnose, _read(given))

    def plan(self, given: Mapping[str, Any]) -> None:
        """Start a plan of the next stroke to be measured."""
        self._begin(self._plan, _read(given))

    def _begin(self, work: Callable[[_Asked], Coroutine[Any, Any, None]], asked: _Asked) -> None:
        if self._running is not None and not self._running.done():
            raise InvalidParameter("a diagnosis or a plan is under way; stop it first")
        self._stop = False
        self._running = asyncio.create_task(work(asked))

    def stop(self) -> None:
        """End the diagnosis with its results so far, and cancel the plan."""
        self._stop = True

    def close(self) -> None:
        """Stop because the page was closed."""
        self._stop = True

    async def work(self) -> None:
        """Process the comparisons until the page is closed."""
        loop = asyncio.get_running_loop()
        while True:
            await self._wake.wait()
            self._wake.clear()
            asked = self._asked
            if asked is None:
                continue
            bench = self._bench()
            try:
                found = await loop.run_in_executor(self._pool, self._overlay, asked, bench)
            except Exception as error:  # otherwise the page would get no more answers
                found = self._fault(error)
            self._post("measured", {"on": "measured", "id": asked.id, **found})

    def _fault(self, error: Exception) -> dict[str, Any]:
        """Message of an error for the page."""
        return {"fault": self._uploads.named(fault_of(error))}

    def _records(self, asked: _Asked, model: Any) -> tuple[Record, ...]:
        signals = Signals(
            inputs=tuple(getattr(model, "inputs", ())),
            outputs=model.outputs,
            modes=model.input_modes,
            units=model.units if model.input_modes else {},
            names=model.input_names,
        )
        kept = self._uploads.kept(asked.files)
        groups = read_each(list(kept), signals, asked.reading.options(), kept)
        return tuple(r for group in groups for r in group)

    def _overlay(self, asked: _Asked, bench: Bench) -> dict[str, Any]:
        model, _ = mechanism_model(asked.turned.action(bench))
        found = check(model, self._records(asked, model))
        records = [
            {
                "name": r.name,
                "time": pack_times(1e3 * r.time),
                "channels": [
                    {"name": c.name, "unit": c.unit, "values": pack_columns(c.both)}
                    for c in r.channels
                ],
            }
            for r in drawn(found, MOST_SAMPLES, MOST_RECORDS)
        ]
        notes = [self._uploads.named(n) for n in found.notes]
        return {"records": records, "rows": rows(found), "notes": list(dict.fromkeys(notes))[:12]}

    async def _diagnose(self, asked: _Asked) -> None:
        loop = asyncio.get_running_loop()
        bench = self._bench()

        def post(state: dict[str, Any]) -> None:
            message = {"on": "diagnosing", **state}
            loop.call_soon_threadsafe(self._post, "diagnosing", message)

        show_progress = teller(post, lambda: self._stop)

        def work() -> dict[str, Any]:
            model, effects = mechanism_model(asked.turned.action(bench))
            options = Options(seconds=asked.seconds)
            report = diagnose(
                model, effects, self._records(asked, model), options=options, progress=show_progress
            )
            self._believed = (_state(asked, bench), Belief.of_report(report))
            return diagnosis_message(report, effects, bench) | {"stopped": self._stop}

        await self._answer("diagnosis", work)

    async def _plan(self, asked: _Asked) -> None:
        loop = asyncio.get_running_loop()
        bench = self._bench()

        def progress(stage: str, done: int, total: int) -> None:
            if self._stop:
                raise Abandoned("given up")
            message = {"on": "planning", "stage": stage, "done": done, "total": total}
            loop.call_soon_threadsafe(self._post, "planning", message)

        def work() -> dict[str, Any]:
            model, effects = mechanism_model(asked.turned.action(bench))
            records = self._records(asked, model) if asked.files else ()
            belief, source = None, "before any measurement" if not records else "the records"
            if self._believed is not None and self._believed[0] == _state(asked, bench):
                belief, source = self._believed[1], "the diagnosis"
            found = propose(model, effects, records, belief=belief, progress=progress)
            return {**found, "source": source}

        await self._answer("plan", work)

    async def _answer(self, on: str, work: Callable[[], dict[str, Any]]) -> None:
        """Send the result of a long computation to the page, or the reason why there is none."""
        try:
            # A separate thread, so that the pool is free for changes in the meantime.
            found = await asyncio.to_thread(work)
        except Abandoned:
            found = {"rows": [], "stopped": True}
        except Stop:
            found = {"fault": "stopped before the model was fitted to the records"}
        except Exception as error:  # otherwise the page would wait forever
            found = self._fault(error)
        self._post(on, {"on": on, **found})


def _read(given: Mapping[str, Any]) -> _Asked:
    try:
        return _Asked.model_validate(given)
    except ValidationError as error:
        lines = [f"{'.'.join(map(str, e['loc']))[:80]}: {e['msg'][:200]}" for e in error.errors()]
        raise InvalidParameter("\n".join(lines[:8])) from None


def _state(asked: _Asked, bench: Bench) -> Any:
    """Conditions of a diagnosis: the records as they were read, and the changes."""
    return (asked.files, asked.reading, asked.turned, bench.action.hash)


def diagnosis_message(report: Report, effects: Sequence[Effect], bench: Bench) -> dict[str, Any]:
    """A report for the page: what is missing, parameters that moved, candidates, colors of parts.

    Parameters
    ----------
    report
        Result of the diagnosis.
    effects
        Effects that it considered.
    bench
        Mechanism of the page, whose knobs change some of the numbers.
    """
    listed = [c for first in report.changes for c in (first, *first.equivalents)]
    known = {c.name for c in listed}
    chances: dict[str, float] = {}
    for s in report.sets:
        for name in set(s.causes) - known:
            chances[name] = chances.get(name, 0.0) + s.probability
    others = sorted(((v, n) for n, v in chances.items() if v >= LEAST), reverse=True)
    mechanism = {e.name: e.mechanism for e in effects}
    return {
        "verdict": report.verdict.value.capitalize(),
        "answer": finding(report.as_dict(), bench.library),
        "statement": report.summary(),
        "reasons": [reason.value for reason in report.reasons],
        "causes": [
            _row(bench, c.name, c.unit, _how(c, len(first.equivalents)), _text(c))
            | {k: v if math.isfinite(v) else None
               for k, v in (("magnitude", c.size), ("low", c.low), ("high", c.high))}
            for first in report.changes
            for c in (first, *first.equivalents)
        ],
        "candidates": [
            _row(bench, name, "", f"{value:.0%} probable", mechanism.get(name, ""))
            for value, name in others[:MOST_ROWS]
        ],
        "tint": tint_of(bench, _shares(report, bench)),
    }  # fmt: skip


def _how(c: Change, equivalents: int) -> str:
    """How sure a change is, and whether a parameter is within its tolerance."""
    words = [f"one of {1 + equivalents}"] if equivalents else []
    if not equivalents and c.tier == "named":
        words = [f"{c.probability:.0%} probable"]
    if c.within is not None:
        words.append(f"{'within' if c.within else 'outside'} its tolerance")
    return ", ".join(words)


def _text(c: Change) -> str:
    """What is different, what that takes away, and what to do."""
    takes = f"takes away {percent(c.takes)} of the motion of {c.channel}" if c.channel else ""
    words = clause(replace(c, equivalents=()))
    parts = (f"{words[:1].upper()}{words[1:]}", c.mechanism, takes, c.remedy)
    return ". ".join(part.rstrip(".") for part in parts if part)


def _row(bench: Bench, name: str, unit: str, how: str, text: str) -> dict[str, Any]:
    return {"effect": name, "unit": unit, "how": how, "text": text, "knob": knob_of(bench, name)}


def _shares(report: Report, bench: Bench) -> list[tuple[str, float]]:
    """Places with the share of the gap of the worst channel that they take away."""
    c = report.worst
    total = c.tabulated if 0.0 < c.tabulated < math.inf else max(c.calibrated, 1e-300)
    found = [
        (knob_of(bench, x.name) or x.component, x.takes * c.motion / total)
        for first in report.changes
        for x in (first, *first.equivalents)
    ]
    k = report.channels.index(c)
    return found + [(p.name, (c.explained - p.left[k]) / total) for p in report.places]


def knob_of(bench: Bench, effect: str) -> str:
    """Knob that changes the same numbers as an effect; "" if there is none."""
    if effect in bench.knobs:
        return effect
    library = bench.library
    entries = (*library.tolerances, *library.effects) if library else ()
    entry = next((e for e in entries if e.name == effect), None)
    if entry is None or not entry.changes:
        return ""
    same = (k.name for k in bench.knobs.values() if k.changes == entry.changes)
    return next(same, "")


def tint_of(bench: Bench, shares: Sequence[tuple[str, float]]) -> list[float]:
    """Share of the gap by body, ground first: the largest share of the places at the body.

    A place is a knob, or a component of a report.
    """
    config = bench.action.config
    bodies = ["ground", *config.bodies]
    out = dict.fromkeys(bodies, 0.0)
    for place, share in shares:
        for body in _touched(bench, place) if math.isfinite(share) else ():
            out[body] = max(out[body], min(1.0, max(0.0, share)))
    return [round(out[body], 3) for body in bodies]


def _touched(bench: Bench, place: str) -> list[str]:
    """Bodies at a place."""
    knob = bench.knobs.get(place)
    paths = () if knob is None else (change.path for change in knob.changes)
    return bodies_at(bench.action.config, place, paths)
