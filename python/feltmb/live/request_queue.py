"""Simulations for one page: the newest request is computed first, and older ones are stopped."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any, Literal

from feltmb.action.regulate import regulate
from feltmb.action.regulate.measuring import Bench as Measures
from feltmb.action.regulate.measuring import CannotMeasure
from feltmb.action.regulate.targets import MEASURES, Step
from feltmb.action.touch import distances, static_touch
from feltmb.action.touch.strikes import simulate_strike
from feltmb.live.knobs import Bench
from feltmb.live.pictures import SAMPLES, describe_live
from feltmb.live.states import LONGEST, Asked, Turned, fault_of
from feltmb.mechanism import Action
from feltmb.run.quasistatic import simulated_press
from feltmb.run.results import Run
from feltmb.run.simulate import simulate
from feltmb.run.stroke import Stroke

Slot = Literal["a", "b"]
SLOTS: tuple[Slot, ...] = ("a", "b")

#: A newer change stops a simulation that has lasted this long [s]; during dragging the page needs
#: pictures.
PATIENCE = 1.0
#: Relative tolerance during changes: the error of the motion is less than the width of a line.
ROUGH = 1e-5
#: Time without changes before the complete run and the extras are computed [s].
AT_REST = 0.2
#: Largest wall time of a simulation [s].
MOST_WALL = 20.0
#: Limits of the sample rate during changes, which is that of the drawn curves [Hz].
QUICK_RATES = 2000.0, 5000.0
#: Parts of the time until a picture is posted: waiting, thread, values, simulation, description.
PARTS = ("queue", "thread", "values", "simulation", "description")
#: Force levels of the curve of hammer speeds [N].
LEVELS = (1.5, 2.5, 4.0, 7.0, 12.0, 20.0, 35.0)


class Stopped(Exception):
    """A newer request has arrived."""


class RequestQueue:
    """Requests of one page.

    Parameters
    ----------
    bench
        Function that returns the present mechanism, which follows its file.
    pool
        Threads for simulations.
    post
        Function that queues a message for the page; a newer message replaces an unsent one of the
        same kind.
    """

    def __init__(
        self,
        bench: Callable[[], Bench],
        pool: Executor,
        post: Callable[[str, dict[str, Any]], None],
    ):
        self._bench = bench
        self._pool = pool
        self._post = post
        self._wanted: dict[Slot, Asked] = {}
        self._done: dict[Slot, Asked] = {}
        self._full: dict[Slot, Asked] = {}
        self._extra: dict[tuple[Slot, str], Asked] = {}
        self._wake = asyncio.Event()
        self._regulating: Turned | None = None
        self._closed = False
        self._left: asyncio.Future[Any] | None = None
        self.counts = {"asked": 0, "begun": 0, "stopped": 0, "pictures": 0}

    def ask(self, slot: Slot, asked: Asked) -> None:
        """Accept a request, which replaces the previous one."""
        self.counts["asked"] += 1
        self._wanted[slot] = asked
        self._wake.set()

    def forget(self, slot: Slot) -> None:
        """Drop a slot."""
        self._wanted.pop(slot, None)

    def close(self) -> None:
        """Stop all computations because the page was closed."""
        self._closed = True
        self._wanted.clear()
        self._wake.set()

    def again(self) -> None:
        """Compute everything again, because the mechanism changed."""
        for done in (self._done, self._full, self._extra):
            done.clear()
        self._wake.set()

    def regulate(self, turned: Turned) -> None:
        """Regulate the changed mechanism."""
        self._regulating = turned
        self._wake.set()

    async def work(self) -> None:
        """Process the requests until the page is closed."""
        while True:
            await self._wake.wait()
            self._wake.clear()
            try:
                for slot in SLOTS:
                    await self._picture(slot, "quick")
                if self._regulating is not None:
                    turned, self._regulating = self._regulating, None
                    await self._regulate(turned)
                if await self._disturbed(AT_REST):
                    continue
                for slot in SLOTS:
                    await self._picture(slot, "full")
                for slot in SLOTS:
                    await self._extras(slot)
            except Stopped:
                self.counts["stopped"] += 1
                self._wake.set()

    async def _disturbed(self, seconds: float) -> bool:
        """Wait; return whether a new request arrived meanwhile."""
        # Not wait_for: in Python 3.11 it loses a cancellation that arrives together with the
        # awaited event, and the page would then never end.
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                await self._wake.wait()
        return self._wake.is_set()

    async def _run(self, work: Callable[[], Any], *, leave: bool = False) -> Any:
        """Work in a thread; with ``leave``, a new request does not wait for its end.

        Only one such work may be left running, so that work that cannot be stopped does not occupy
        all threads.
        """
        future = asyncio.get_running_loop().run_in_executor(self._pool, work)
        # Its end may remain unnoticed if the page is closed or it is left running.
        future.add_done_callback(lambda f: f.cancelled() or f.exception())
        if not leave or (self._left is not None and not self._left.done()):
            return await future
        waking = asyncio.create_task(self._wake.wait())
        try:
            await asyncio.wait({future, waking}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            waking.cancel()
        if future.done():
            return future.result()
        self._left = future
        raise Stopped

    async def _found(self, work: Callable[[], dict[str, Any]], *, leave: bool = False) -> Any:
        """Result of work in a thread, or its fault."""
        try:
            return await self._run(work, leave=leave)
        except Stopped:
            raise
        except Exception as error:
            return {"fault": fault_of(error)}

    @contextlib.contextmanager
    def _faults_told(self, slot: str, asked: Asked) -> Iterator[None]:
        try:
            yield
        except Stopped:
            raise
        except Exception as error:  # otherwise the page would end
            self._post(
                f"run {slot}",
                {
                    "on": "fault",
                    "slot": slot,
                    "id": asked.id,
                    "faults": fault_of(error).splitlines(),
                },
            )

    async def _picture(self, slot: Slot, quality: str) -> None:
        asked = self._wanted.get(slot)
        quick = quality == "quick"
        done = self._done if quick else self._full
        if asked is None or done.get(slot) is asked:
            return
        bench, begin = self._bench(), time.perf_counter()

        def stop() -> bool:
            if self._wanted.get(slot) is asked:
                return False
            return not quick or time.perf_counter() - begin > PATIENCE

        def work() -> dict[str, Any]:
            times = [asked.came, begin, time.perf_counter()]
            values, stroke = asked.turned.values(bench), asked.playing.stroke()
            action = bench.changed(values)
            times.append(time.perf_counter())
            run = simulated(action, stroke, quick, stop, asked.until)
            if not quick and stop():
                raise Stopped
            times.append(time.perf_counter())
            picture = describe_live(run, action, bench.action, asked.shown, quality)
            picture["last"] = 1e3 * stroke.duration
            times.append(time.perf_counter())
            parts = [round(1e3 * (b - a), 2) for a, b in pairwise(times)]
            picture["milliseconds"] = dict(zip(PARTS, parts, strict=True))
            return {"run": picture, "set": values}

        self.counts["begun"] += 1
        if quick:
            self._done[slot] = asked
        with self._faults_told(slot, asked):
            found = await self._run(work, leave=not quick)
            self.counts["pictures"] += 1
            done[slot] = asked
            self._post(f"run {slot}", {"on": "run", "slot": slot, "id": asked.id, **found})

    async def _extras(self, slot: Slot) -> None:
        asked = self._wanted.get(slot)
        if asked is None:
            return
        bench = self._bench()

        def check() -> None:
            if self._wake.is_set() or self._wanted.get(slot) is not asked:
                raise Stopped

        kinds: dict[str, Callable[[Action], dict[str, Any]]] = {
            "targets": lambda action: {"rows": target_rows(bench, action, check)},
            "touch": touch_curve,
            "speeds": lambda action: speed_curve(action, check),
        }
        for kind in asked.extras:
            if self._extra.get((slot, kind)) is asked:
                continue
            check()
            work = partial(_made, kinds[kind], asked.turned, bench)
            found = await self._found(work, leave=True)
            self._extra[slot, kind] = asked
            self._post(f"{kind} {slot}", {"on": kind, "slot": slot, "id": asked.id, **found})

    async def _regulate(self, turned: Turned) -> None:
        bench = self._bench()
        loop = asyncio.get_running_loop()

        def say(text: str) -> None:
            if self._closed:
                raise Stopped
            loop.call_soon_threadsafe(self._post, "progress", {"on": "progress", "text": text})

        found = await self._found(lambda: regulated(bench, turned, say))
        self._post("regulated", {"on": "regulated", **found})


def _made(make: Callable[[Action], dict[str, Any]], turned: Turned, bench: Bench) -> dict[str, Any]:
    return make(turned.action(bench))


def simulated(
    action: Action, stroke: Stroke, quick: bool, stop: Callable[[], bool], until: float = LONGEST
) -> Run:
    """Run of a stroke, quick to ``until`` [s]; in full quality it is that of ``feltmb stroke``.

    Raises
    ------
    Stopped
        ``stop`` requested the end.
    """
    options: dict[str, Any] = {}
    if quick:
        rate = min(max((SAMPLES["quick"] - 2) / stroke.duration, QUICK_RATES[0]), QUICK_RATES[1])
        options = {"ledger": False, "output_rate": rate, "rtol": ROUGH}
        stroke = replace(stroke, duration=min(stroke.duration, until))
    try:
        return simulate(
            action, stroke, max_wall=MOST_WALL, progress=lambda _t: not stop(), **options
        )
    except KeyboardInterrupt:
        raise Stopped from None


def target_row(step: Step) -> dict[str, Any]:
    """A regulation target without its measured value."""
    _, unit, factor, what = MEASURES[step.measure]
    tolerance = None if step.tolerance is None else step.tolerance * factor
    return {
        "name": step.name,
        "unit": unit,
        "factor": factor,
        "wanted": step.wanted,
        "tolerance": tolerance,
        "what": what,
    }


def target_rows(
    bench: Bench, action: Action, check: Callable[[], None] = lambda: None
) -> list[dict[str, Any]]:
    """Each regulation target with its measured value, and whether it is met."""
    rows: list[dict[str, Any]] = []
    measures = Measures()
    for step in bench.targets.steps if bench.targets else ():
        check()
        row = target_row(step)
        try:
            value = measures.measure(action, step)
            row |= {"value": value * row["factor"], "holds": step.holds(value), "why": ""}
        except CannotMeasure as error:
            row |= {"value": None, "holds": False, "why": str(error)}
        rows.append(row)
    return rows


def touch_curve(action: Action) -> dict[str, Any]:
    """Force against key travel of a slow press and release, mm and N; weights in gf."""
    found = static_touch(action)
    ruled = distances(action, found, simulated_press(action, travel=found.end + 1.2e-3))
    gram = 1e3 / 9.80665
    return {
        "curves": [
            [name, (1e3 * path.travel).round(4).tolist(), path.force.round(4).tolist()]
            for name, path in (("press", found.press), ("release", found.release))
        ],
        "rows": [
            [name, value if math.isfinite(value) else None, unit]
            for name, value, unit in (
                ("down-weight", found.down_weight * gram, "gf"),
                ("up-weight", found.up_weight * gram, "gf"),
                ("friction", found.friction * gram, "gf"),
                ("balance weight", found.balance_weight * gram, "gf"),
                ("let-off force", found.let_off_force, "N"),
                ("let-off", 1e3 * ruled.let_off, "mm"),
                ("key dip", 1e3 * ruled.dip, "mm"),
                ("aftertouch", 1e3 * ruled.aftertouch, "mm"),
            )
        ],
        "notes": list(found.notes),
    }


def speed_curve(action: Action, check: Callable[[], None] = lambda: None) -> dict[str, Any]:
    """Hammer speed against key speed of strikes from pp to ff, m/s."""
    rows = []
    for level in LEVELS:
        check()
        strike = simulate_strike(action, "pressed", level, 0.01)
        if strike.hammer_speed is not None and strike.key_speed is not None:
            rows.append([strike.key_speed, strike.hammer_speed, level])
    return {"rows": rows, "missed": len(LEVELS) - len(rows)}


def regulated(bench: Bench, turned: Turned, say: Callable[[str], None]) -> dict[str, Any]:
    """Result of a regulation as magnitudes of the knobs."""
    found = regulate(turned.action(bench), bench.targets, progress=say)
    knobs: Mapping[str, float] = {
        f"screw.{row.name}": turned.knobs.get(f"screw.{row.name}", 0.0)
        + row.turned * (1e-3 if row.turn_unit == "mm" else 3.141592653589793 / 180.0)
        for row in found.table
        if row.turned and f"screw.{row.name}" in bench.knobs
    }
    return {
        "knobs": dict(knobs),
        "converged": found.converged,
        "rows": [
            {
                "name": row.name,
                "turned": row.turned,
                "unit": row.turn_unit,
                "holds": row.holds,
                "why": row.why,
            }
            for row in found.table
        ],
    }
