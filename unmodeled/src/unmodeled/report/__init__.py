"""The report of a diagnosis: all sentences, as text, as an HTML page, and as files.

The first screen says what changes, what that takes away, what is left, and what to do. Numbers
for specialists are in the tables of details, which follow.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from unmodeled.arguments import checked
from unmodeled.data import Array, Record
from unmodeled.errors import InvalidParameter, merged
from unmodeled.files import make_folder, whole_folder, write_text
from unmodeled.models.matching import matched
from unmodeled.models.model import Candidate, Effect, Model
from unmodeled.models.writing import numbers, write
from unmodeled.pictures.curves import Law, Motions
from unmodeled.report.figures import (
    answer,
    correlation,
    evidence,
    motion,
    residual_force,
    residuals,
    svg,
    waterfall,
)
from unmodeled.report.page import page, render_page
from unmodeled.report.robot import channels, film, views_of
from unmodeled.report.why import reasons, why
from unmodeled.report.words import (
    clause,
    interval,
    joined,
    number,
    part,
    percent,
    scale,
    sign_of_delay,
    size_in,
    tabulated,
    times_noise,
    turn_back,
    turns_of,
)
from unmodeled.search.compare import simulated
from unmodeled.search.records import same_number
from unmodeled.search.result import (
    Cell,
    Change,
    Channel,
    Finding,
    NamedCause,
    Place,
    Reason,
    Result,
    Verdict,
)
from unmodeled.units import readable_unit

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from unmodeled.report.case import Given


__all__ = ["Explained", "Report", "explained_model", "render_page"]

#: Words of reasons that a user must know beside the verdict.
REASONS = {
    Reason.NOISE_NOT_STATED: "No noise of a sensor is stated; it is taken from what the model "
    "leaves, as far as neighboring samples do not share it.",
    Reason.DIFFERS_BETWEEN_RECORDS: "A probable cause is not in the answer{which}: it has another "
    "magnitude in each record, as an imitation of something that is not in the list has.",
    Reason.WORSE_THAN_MEAN: "No cause is told: with the most probable ones, the mean of the "
    "held-out records predicts them better.",
    Reason.NO_HELD_OUT_GAIN: "The causes do not improve the prediction of held-out records.",
    Reason.NOT_PREDICTED: "The held-out records were not predicted: the search was interrupted, or "
    "their simulation fails.",
    Reason.NOT_COMPLETE: "The search ended at its limit, after {rounds} rounds of simulations.",
    Reason.INTERRUPTED: "The search was interrupted: what was not fitted may explain as much.",
    Reason.CALIBRATION_PREDICTS_WORSE: "The calibrated model predicts the held-out records worse "
    "than the tabulated one.",
}
#: What a line of the list says of changes that are not named.
UNSURE = {
    "supported": "whether it is the cause is not sure: another law could do the same",
    "small": "it takes away less than what matters: another law could do the same",
    "unsure": "it is a part of the fit, and whether it is there is not sure",
}
#: Verdicts as words.
VERDICTS = {
    Verdict.NO_GAP: "No gap",
    Verdict.CALIBRATED: "Calibrated",
    Verdict.NAMED: "Named",
    Verdict.ONE_OF: "One of several",
    Verdict.SUPPORTED: "Supported",
    Verdict.UNKNOWN: "Unknown",
}
#: Largest multiple of the noise that counts as the noise, and multiple of its standard deviation
#: from which a delay is reported.
NOISE, DELAYED = 1.3, 4.0
#: Share of named causes that were in the machine: 123 of 130, on 300 imperfect machines. A
#: probability compares listed causes; one that is not listed may be imitated.
LISTED = 0.95
#: Correlation above which two unknowns are hardly separated [1].
SEPARATED = 0.95
#: Largest share that remains with an action at a place that is reported [1].
USEFUL = 0.8
#: Largest numbers of changes in the first sentence, of rows of a table, and of next steps.
HEADLINE, ROWS, STEPS = 2, 8, 3


@dataclass(frozen=True)
class _Section:
    """A part of the report."""

    title: str
    lines: Sequence[str] = ()
    items: Sequence[str] = ()
    head: Sequence[str] = ()
    """Head of the table; its first column is text, the others are numbers."""
    rows: Sequence[Sequence[str]] = ()


# ---------------------------------------------------------------- what a user reads first


def _statement(result: Result) -> str:
    """The first changes, what all of them take away, what remains, and whether that matters."""
    c = result.worst
    if not result.changes and all(0.0 < x.motion <= NOISE * x.noise for x in result.channels):
        return "The records do not show what may be missing: they hold nothing but noise."
    before, fitted, after = (part(c, v) for v in (c.tabulated, c.calibrated, c.explained))
    if math.isfinite(c.tabulated):
        misses = f"the model misses {before} of the motion of {c.name}"
        misses += f", and {fitted} with fitted parameters" * (c.calibrated < 0.9 * c.tabulated)
    else:
        misses = f"the tabulated model fails; with fitted parameters, it misses {fitted} of the "
        misses += f"motion of {c.name}"
    told, last = _told(result), _last(result)
    if result.verdict is Verdict.UNKNOWN:
        first = f"The cause is not known: {misses}. {_unexplained(result)}."
    elif told:
        first = _falls(result, told, before, after)
    elif result.complete:
        quiet = not last and all(c.explained <= NOISE * c.noise for c in result.channels
                                 if c.noise > 0.0)  # fmt: skip
        if not quiet and any(_near_noise(c) for c in result.channels):
            first = f"No cause can be told from the noise: {misses}."
        else:
            first = f"No cause {'' if quiet else 'that matters '}is missing: {misses}."
    else:
        first = f"No cause was found before the search ended: {misses}."
    first += last
    if Reason.NOTHING_INSIDE in result.reasons:
        first += (
            " No effect inside the model was tested; errors of inputs and sensors may imitate one."
        )
    return f"{first} {_remains(result)}"


def _told(result: Result) -> list[Change]:
    """The changes that the first sentence tells."""
    return [
        c
        for c in result.changes
        if c.tier not in ("small", "unsure") and (c.matters or c.tier != "fitted")
    ]


def _falls(result: Result, told: Sequence[Change], before: str, after: str) -> str:
    """The sentence of what changes and of what is left with all of it."""
    c, rest = result.worst, told[HEADLINE:]
    words = [*(clause(x) for x in told[:HEADLINE]), *_others(rest)]
    count = len(result.changes)  # the residual is that of the whole set
    those = {1: "this", 2: "both"}.get(count, f"all {count}")
    those = those if count == len(told) else f"all {count} changes of the list"
    if not math.isfinite(c.tabulated):
        found = f"with {those}, the residual of {c.name} is {after} of its motion"
    elif before == after or c.explained >= c.tabulated:  # another output shows it
        found = f"with {those}, {after} of the motion of {c.name} is left"
    else:
        own = ""
        if c.calibrated < 0.5 * c.tabulated and all(x.kind != "parameter" for x in told):
            own = f" ({part(c, c.calibrated)} with fitted parameters)"  # no credit for these
        found = f"with {those}, the residual of {c.name} falls from {before}{own} to {after} of "
        found += "its motion"
    first = joined(words, ", and").replace(" , and", ", and")
    first = f"{first[:1].upper()}{first[1:]}: {found}."
    if unsure := joined([x.name for x in told if x.tier == "supported"], "or"):
        first += f" Whether {unsure} is the cause is not sure: another law could do the same."
    return first


def _last(result: Result) -> str:
    """A sentence about what is small, and one about what is not sure."""
    small = [c for c in result.changes if c.tier == "small"]
    unsure = [c for c in result.changes if c.tier == "unsure"]
    text = ""
    if small:
        size = percent(small[0].takes)
        much = f"this is small ({size} of the motion of {small[0].channel})"
        text += f" {_capital(clause(small[0]))}: "
        text += f"{'as little is left without it' if size == '0 %' else much}."
    if unsure:
        so_far = "Best so far" if not result.complete else "Also fitted, and not sure"
        text += f" {so_far}: {joined([_without_may(c) for c in unsure[:HEADLINE]])}."
    return text


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _without_may(c: Change) -> str:
    """Name of a change that is not sure, with its equivalents."""
    return joined([c.name, *(e.name for e in c.equivalents[:1])], "or")


def _others(rest: Sequence[Change]) -> list[str]:
    """The changes of the list that the first sentence does not tell, as a number."""
    many = len(rest) > 1
    if rest and all(c.within for c in rest):
        thing = f"{len(rest)} more parameters differ" if many else "1 more parameter differs"
        return [f"{thing} within {'their tolerances' if many else 'its tolerance'}"]
    return [f"{len(rest)} more change{'s are' if many else ' is'} in the list"] if rest else []


def _unexplained(result: Result) -> str:
    """Why nothing is named although something is missing."""
    untried = _untried(result)
    tried = any(s.causes for s in result.sets) or len(result.not_tried) < result.causes
    if untried and not tried:
        return f"It is not judged why: {untried}"
    if result.unsure:
        return "What was fitted may imitate it"
    if result.refused:
        it = "it has" if len(result.refused) == 1 else "they have"
        return (
            f"What would explain most of it is refused ({joined(result.refused)}): {it} another "
            "magnitude in each record"
        )
    if not tried:
        return "No cause was tried"
    return f"No cause that was tried explains it{f'; {untried}' if untried else ''}"


def _untried(result: Result) -> str:
    """How many causes were not tried because the search ended; empty: it is complete, or none."""
    if result.complete or not result.not_tried:
        return ""
    count = len(result.not_tried)
    verb = "was" if count == 1 else "were"
    need = f", about {_seconds(result)} are needed" if math.isfinite(result.needed) else ""
    return f"{count} of {max(result.causes, count)} causes {verb} not tried{need}"


def _seconds(result: Result) -> str:
    return f"{float(f'{result.needed:.2g}'):g} s"


def _near_noise(c: Channel) -> bool:
    """Whether what remains is not judged because of the noise, although it may matter."""
    return c.good_enough < c.explained <= c.limit and c.explained > NOISE * c.noise


def _remains(result: Result) -> str:
    material = [c for c in result.channels if c.material]
    if not material:
        c = result.worst
        if c.explained <= NOISE * c.noise:
            return "Nothing but the noise of the sensor remains."
        if _near_noise(c):
            which = " (estimated, as none is stated)" * (Reason.NOISE_NOT_STATED in result.reasons)
            return f"The rest, {times_noise(c)}{which}, is too near to it to tell more."
        rest, enough = times_noise(c) or part(c, c.explained), part(c, c.limit)
        enough = "" if enough == rest else f" ({enough})"
        return f"The rest, {rest}, is less than what is good enough{enough}."
    c = max(material, key=lambda c: c.explained / c.limit)
    more = f" (and {len(material) - 1} more)" if len(material) > 1 else ""
    left, enough = part(c, c.explained), part(c, c.limit)
    enough = "a little less" if enough == left else enough
    return (
        f"The rest matters: {left} of {c.name}{more}"
        f"{', ' * bool(times_noise(c))}{times_noise(c)}; {enough} would be good enough."
    )


def _changes(result: Result) -> _Section:
    """The list of changes, with what a reader must know beside it."""
    which = f" ({joined(result.refused)})" if result.refused else ""
    lines = [
        REASONS[r].format(which=which, rounds=result.rounds)
        for r in result.reasons
        if r in REASONS and not (r is Reason.NOT_COMPLETE and Reason.INTERRUPTED in result.reasons)
    ]
    if result.verdict is Verdict.UNKNOWN:
        lines.append("The fitted parameters (see details) may imitate what is not known.")
        if best := _probabilities(result)[:2]:
            tested = joined([f"{name} ({percent(p)})" for name, p in best])
            lines.append(f"Nothing is named. Most probable of those tested: {tested}.")
    elif not (result.changes or any(p.moved for p in result.parameters)) and result.parameters:
        lines.append("All tabulated values are inside the 95 % intervals.")
    return _Section("Changes", lines, [_item(c) for c in result.changes])


def _item(c: Change) -> str:
    """A line of the list: what changes, how sure, what it takes away, in each record."""
    text = clause(c)
    notes = [text[:1].upper() + text[1:]]
    if c.within is not None:
        notes.append(f"{'within' if c.within else 'outside'} its tolerance")
    if c.tier in UNSURE:
        notes.append(UNSURE[c.tier])
    if c.tier == "named":
        notes.append(f"{100.0 * LISTED * c.probability:.0f} % sure")
    if not math.isnan(c.takes):
        lost, before, after = math.isinf(c.before), percent(c.before), percent(c.after)
        it = joined(["it", *c.beside])
        less = f"the simulation fails without {it}" if lost else f"{before} without {it}"
        left = f"{after} of the motion of {c.channel} is left, and {less}"
        if before == after:
            left = f"it takes away {percent(c.takes)} of the motion of {c.channel}"
        notes.append(left)
    if len(c.by_record) > 1:
        factor, _ = scale(c.low, c.high, c.unit, relative=c.relative)
        shown, half = factor * (sign_of_delay(c) or 1.0), 0.5 * factor * (c.high - c.low)
        each = [number(shown * v, half) for v in c.by_record]
        notes.append(f"in each record {', '.join(each)}")
    numbers = c.shape if isinstance(c.shape, tuple) else (c.shape,)
    for name, value in zip(c.shape_names, numbers, strict=False):
        what, _, unit = name.removesuffix("]").partition(" [")
        of = value if isinstance(value, str) else f"{value:.3g}"
        notes.append(f"{what} {of}{'' if unit in ('', '1') else f' {unit}'}")
    return "; ".join(notes) + (f". {c.mechanism}" if c.mechanism else "")


def _probabilities(result: Result, least: float = 0.01) -> list[tuple[str, float]]:
    """Probability of each cause over all sets, largest first, if it is not below ``least``."""
    found: dict[str, float] = {}
    for s in result.sets:
        for name in s.causes:
            found[name] = found.get(name, 0.0) + s.probability
    return sorted(((k, v) for k, v in found.items() if v >= least), key=lambda f: -f[1])


def _held_out(result: Result) -> _Section:
    lines = []
    if result.held_out_gain is not None:
        value, low, high = (round(100.0 * (1.0 - g)) for g in result.held_out_gain)
        what = f"shrinks by {value} %" if value > 0 else f"grows by {-value} %"
        if value:
            lines = [
                f"Where nothing was fitted, the residual {what} with {joined(result.reported)} "
                f"({high} to {low} %)."
            ]
        lines += [_by_record(f) for f in result.findings if f.member and f.of > 1]
    remaining = [c for c in result.channels if c.fitted_explained < c.held_out_explained > c.limit]
    if remaining:
        c = max(remaining, key=lambda c: c.held_out_explained / c.limit)
        line = (
            f"{part(c, c.held_out_explained)} of {c.name} remains in the held-out records, and "
            f"{part(c, c.fitted_explained)} in the fitted ones"
        )
        if not c.material:
            line += ": these alone do not determine all that acts in the held-out ones"
        elif c.fitted_explained <= c.limit:
            line += ": something acts in the held-out ones that these do not show"
        lines.append(f"{line}.")
    return _Section("Held-out records", lines)


def _by_record(f: Finding) -> str:
    """How many of the held-out records need a member of the answer."""
    also = ": these records also chose the answer" if f.predicts else ""
    return f"{f.cause}: better in {f.better} of {f.of} held-out records{also}."


def _worst_cell(result: Result, attribute: str) -> tuple[Cell, str] | None:
    """The part of a record with the largest residual that matters, and its place as words."""
    limits = {c.name: c.limit for c in result.channels}
    ratios = [getattr(c, attribute) / limits[c.channel] for c in result.cells]
    if not max(ratios, default=0.0) > 1.0:
        return None
    cell = result.cells[int(np.argmax(ratios))]
    since = f", after {cell.since}" if cell.since else ""
    span = f"{size_in(cell.start, '1')} to {size_in(cell.end, '1')} s"
    return cell, f"{cell.channel} of {cell.record}, {span}{since}"


def _where(result: Result) -> _Section:
    lines, causes = [], bool(result.named or result.classes)
    units = {c.name: c.unit for c in result.channels}
    worst = None if result.verdict is Verdict.NO_GAP else _worst_cell(result, "calibrated")
    if worst is not None:
        cell, words = worst
        unit = units[cell.channel]
        rms = size_in(cell.calibrated, unit)
        after = f", {size_in(cell.explained, unit)} with the causes" if causes else ""
        before = "Without the causes, the" if causes else "The"
        lines.append(f"{before} residual is largest in {words}: {rms} rms{after}.")
    delayed = [e for e in result.events if abs(e.delay) > DELAYED * e.delay_sd]
    if delayed and result.verdict is not Verdict.NO_GAP:
        e = max(delayed, key=lambda e: abs(e.delay) / e.delay_sd)
        after = f" ({size_in(abs(e.delay_explained), 's')} with the causes)" if causes else ""
        lines.append(
            f"At the event {e.event} of {e.record}, {e.channel} comes {size_in(abs(e.delay), 's')} "
            f"{'later' if e.delay > 0.0 else 'earlier'} than in the model{after}."
        )
    lines += [_place(result, p) for p in _useful(result)[:2]]
    return _Section("Where", lines or ["No part of a record differs by more than what matters."])


def _left(result: Result, place: Place) -> tuple[float, float]:
    """Largest share of the motion that remains, without and with an action at a place."""
    shares = [c.share(v) for c, v in zip(result.channels, place.left, strict=True)]
    now = [c.share(c.explained) for c in result.channels]
    return np.fmax.reduce(now, initial=0.0), np.fmax.reduce(shares, initial=0.0)


def _useful(result: Result) -> list[Place]:
    """Places that take away a good part of what remains."""
    sizes = [(p, *_left(result, p)) for p in result.places]
    return [p for p, now, left in sizes if left < USEFUL * now]


def _place(result: Result, place: Place) -> str:
    what = "An unknown action" if place.port else "Unlisted changes from record to record"
    now, left = _left(result, place)
    like = [f"; it would resemble the {law} ({percent(v)} of it)" for law, v in place.resembles]
    where = place.name if place.name.startswith("between ") else f"at {place.name}"
    return (
        f"{what} {where} would take what remains in the worst channel from {percent(now)} "
        f"to {percent(left)}{''.join(like[:1])}."
    )


def _again(result: Result) -> str:
    more = "more seconds"
    if math.isfinite(result.needed):
        more = f"{_seconds(result)} (--seconds, in Python seconds of Options)"
    why = _untried(result).partition(",")[0] or "the search did not reach its end"
    return f"Diagnose again with {more}: {why}."


def _look_at(result: Result) -> Iterator[str]:
    """Where to look for what remains."""
    if useful := _useful(result):
        p = useful[0]
        law = f" that resembles the {p.resembles[0][0]}" if p.resembles else ""
        yield f"Inspect {p.name}, and add an effect there{law} to the list."
    elif (worst := _worst_cell(result, "explained")) is not None:
        yield f"Look at {worst[1]}: what remains is largest there."


def _next(result: Result) -> list[str]:
    """Actions, the most useful first."""
    first = ["Check units, signs and columns: a constant would be nearer to the records."]
    steps = first if result.worst.calibrated > result.worst.motion > 0.0 else []
    if Reason.NOTHING_INSIDE in result.reasons:
        steps.append(
            "Name what may act inside the model (--unknown friction='N m', in Python unknown=): a "
            "parameter of the function or the FMU that is zero without it, which you may have to "
            "add where the model is made; or coordinates= of equations."
        )
    for c in _told(result):
        if c.tier == "fitted":
            steps.append(_repair(c))
        elif not c.equivalents:
            remedy = c.remedy or "measure it by itself, and correct the model."
            steps.append(f"{c.name}: {remedy}")
        if text := c.subject.scope.repeat(result.records):
            steps.append(f"{c.name}: {text}.")
    for group, record in zip(result.classes, result.apart, strict=False):
        names = f"{group[0].cause} from {group[1].cause}"
        steps += [f"To tell {names}, measure {n.cause} by itself." for n in group if n.parameter]
        steps.append(f"To tell {names}, record more motions like {record}: they differ most there.")
        steps += [f"{n.cause}: {n.remedy}" for n in group if n.remedy]
    if Reason.NOT_COMPLETE in result.reasons:
        steps.append(_again(result))
    if any(c.material for c in result.channels):
        steps += _look_at(result)
    steps += [
        f"Measure {a} by itself: the records hardly separate it from {b}."
        for a, b in _hardly_separated(result)
    ]
    if Reason.NOISE_NOT_STATED in result.reasons:
        steps.append("Record the machine at rest, and state the noise of the sensors.")
    if not steps:
        steps.append("None: the model can be used for motions like the recorded ones.")
    return list(dict.fromkeys(steps))[:STEPS]


def _repair(c: Change) -> str:
    """What to do about a parameter: on the machine the reverse, or in its table."""
    if c.user_unit is not None and c.user_unit.unit == "turn":
        back = turn_back(c.title[:1].lower() + c.title[1:], turns_of(c))
        return f"On the machine, {back}, or correct the model."
    return f"{c.title}: check it, and correct the machine or its tabulated value."


def _hardly_separated(result: Result) -> Iterator[tuple[str, str]]:
    """Moved parameters, each with an unknown from which the records hardly separate it."""
    moved = {p.name for p in result.parameters if p.moved}
    high = np.argwhere(np.abs(np.triu(result.correlation, 1)) > SEPARATED)
    for i, j in sorted(high, key=lambda k: -abs(result.correlation[tuple(k)])):
        a, b = result.unknowns[i], result.unknowns[j]
        if {a, b} & moved:
            yield (a, b) if a in moved else (b, a)


# ---------------------------------------------------------------- details


def _details(result: Result) -> Iterator[_Section]:
    rows: list[list[str]] = []
    for c in result.channels:
        factor, unit = readable_unit(c.motion, c.unit)
        values = (c.noise, c.tabulated, c.calibrated, c.explained, c.held_out_calibrated,
                  c.held_out_explained)  # fmt: skip
        numbers = [f"{factor * v:.3g}" if math.isfinite(v) else "-" for v in values]
        rows.append([f"{c.name} [{unit}]", *numbers, percent(c.share(c.explained))])
    head = ("rms residual", "noise", "tabulated", "calibrated", "explained", "held out, before",
            "held out, after", "of motion")  # fmt: skip
    yield _Section("Residuals", head=head, rows=rows)
    k = result.channels.index(result.worst)
    rows = [
        [joined(s.causes) or "nothing", f"{s.probability:.3f}",
         percent(result.worst.share(s.residual[k]))]
        for s in result.sets[:ROWS]
    ]  # fmt: skip
    yield _Section("Sets", head=("set", "probability", f"left of {result.worst.name}"), rows=rows)
    rows = [[name, f"{p:.3f}"] for name, p in _probabilities(result)[:ROWS]]
    yield _Section("Causes", head=("cause", "probability"), rows=rows)
    rows = [[p.name, tabulated(p), interval(p)] for p in result.parameters]
    yield _Section("Parameters", head=("parameter", "tabulated", "fitted, 95 %"), rows=rows)
    rows = [[f.cause, f.mark.value if f.mark else "no", ", ".join(f.codes)]
            for f in result.findings if f.member or f.left][:ROWS]  # fmt: skip
    yield _Section("Why", head=("candidate", "in the answer", "because"), rows=rows)
    notes = merged(result.notes)
    if result.not_tried:
        more = len(result.not_tried) - ROWS
        notes.append(
            f"Not fitted{', because the first-order gain is small' * result.complete}: "
            f"{', '.join(result.not_tried[:ROWS])}{f' and {more} more' if more > 0 else ''}."
        )
    yield _Section("Notes", items=notes)


def _candidates(result: Result) -> _Section:
    """The candidates with a number, and why they are in the answer, or not."""
    known = [f for f in result.findings if f.fitted or math.isfinite(f.gain)]
    rows = [
        [f.cause, f.mark.value if f.mark else "no", f"{f.probability:.3f}", reasons(f)]
        for f in sorted(known, key=lambda f: (not f.member, -f.probability))
    ]
    more = len(result.findings) - len(known)
    lines = [f"{more} more were not fitted: their gain to first order is small."] if more else []
    head = ("candidate", "in the answer", "probability", "why, or why not")
    return _Section("Candidates", lines, head=head, rows=rows)


# ---------------------------------------------------------------- the report


class Report(Result):
    """Result of :func:`unmodeled.diagnose`, with its texts, table and figures."""

    model: Explained | None = None
    """The model with the fitted parameters and the effects of the answer; of a class, the member
    that is told first. None: it is not known."""
    case: Given | None = None
    """What the diagnosis was given, for those who repeat it; None: it is not known."""
    motions: Motions | None = None
    """Motions of the records: measured, in the model as it is, and with the changes; None: they
    are not known."""
    laws: tuple[Law, ...] = ()
    """The evidence of each change in the coordinates of its law."""
    cached: str = ""
    """How many runs were taken from the folder ``cache``; empty: none. It is the last line of the
    text, and no part of the answer."""

    @classmethod
    @checked
    def of(cls, result: Result) -> Report:
        """The report of a result.

        Parameters
        ----------
        result
            Result of a diagnosis.
        """
        return cls(**{f.name: getattr(result, f.name) for f in fields(result)})

    def __str__(self) -> str:
        return self.text()

    def __repr__(self) -> str:
        return f"Report({self.verdict.name}: {self.summary()})"

    def _repr_html_(self) -> str:
        table = self.frame.to_html(float_format=lambda v: f"{v:.4g}", na_rep="")
        steps = "".join(f"<li>{escape(s)}</li>" for s in _next(self))
        lead = f"<b>{VERDICTS[self.verdict]}.</b> {escape(self.summary())}"
        return f"<p>{lead}</p>{table}<ul>{steps}</ul>"

    def summary(self) -> str:
        """The first two changes, what remains, and whether that matters."""
        return _statement(self)

    @checked
    def why(self, name: str) -> str:
        """Why a candidate is in the answer, or not.

        Parameters
        ----------
        name
            Name of an effect, an error of a sensor or input, or a parameter that was a candidate.

        Raises
        ------
        InvalidParameter
            There is no candidate of this name.
        """
        return why(self.finding(name))

    def _first(self) -> list[_Section]:
        parts = [_changes(self), _held_out(self), _where(self)]
        return [s for s in (*parts, _Section("Next", items=_next(self))) if s.lines or s.items]

    @checked
    def text(self, width: int = 100) -> str:
        """The whole report as plain text.

        Parameters
        ----------
        width
            Largest number of characters of a line.
        """
        from unmodeled.tables import Screen, folded_text, new_table

        file = io.StringIO()
        screen = Screen(file=file, width=width, highlight=False, markup=False, emoji=False)
        screen.print(self.summary())
        first = self._first()
        for s in (*first, *(s for s in _details(self) if s.rows or s.items)):
            screen.print(f"\n{s.title}{'' if s in first else ' (details)'}")
            for line in s.lines:
                screen.print(line)
            for item in s.items:
                screen.print("- " + folded_text(item, width - 2).replace("\n", "\n  "))
            if s.rows:
                table = new_table("", *s.head, right=tuple(range(1, len(s.head))), whole=(0,))
                for row in s.rows:
                    table.add_row(*row)
                screen.print(table)
        if self.cached:
            screen.print(f"\n{self.cached}")
        lines = [line.rstrip() for line in file.getvalue().splitlines()]
        double = zip(lines, ["-", *lines], strict=False)
        return "\n".join(line for line, before in double if line or before).rstrip()

    @checked
    def html(self, title: str = "Diagnosis") -> str:
        """The report as one page that loads nothing; all texts are escaped.

        Parameters
        ----------
        title
            Title of the page, for example the name of the model.
        """
        from markupsafe import Markup

        return page(
            self.motions,
            self.laws,
            title=title,
            result=self,
            verdict=VERDICTS[self.verdict],
            first=self._first(),
            details=[s for s in _details(self) if s.rows or s.items],
            candidates=_candidates(self),
            figures={
                "": Markup(svg(waterfall(self), "waterfall of the gap")),
                "Where": Markup(
                    svg(residual_force(self), "residual force")
                    if any(p.force for p in _useful(self))
                    else ""
                ),
                "Residuals": Markup(svg(residuals(self), "residuals of the records")),
                "Parameters": Markup(svg(correlation(self), "correlation of the unknowns")),
            },
        )

    @property
    def frame(self) -> pd.DataFrame:
        """One row for each change, then for each other effect that was fitted, and each parameter.

        The kind is "change", "equivalent" (it fits as well as the change before it), "tested" or
        "parameter". ``value`` is the size of a change, ``takes`` what it takes away as a share of
        the motion of ``channel``.
        """
        import pandas as pd

        listed = [(kind, c) for first in self.changes
                  for kind, c in (("change", first),
                                  *(("equivalent", e) for e in first.equivalents))]  # fmt: skip
        rows = [asdict(c) | {"kind": kind, "value": c.size} for kind, c in listed]
        known = {row["name"] for row in rows}
        rows += [
            {"name": name, "kind": "tested", "probability": probability}
            for name, probability in _probabilities(self, least=0.0)
            if name not in known
        ]
        rows += [asdict(p) | {"kind": "parameter"} for p in self.parameters if p.name not in known]
        columns = ["name", "kind", "tier", "component", "unit", "value", "low", "high", "takes",
                   "channel", "probability", "tabulated", "sd"]  # fmt: skip
        return pd.DataFrame(rows, columns=columns).set_index("name")

    @checked
    def plot(
        self,
        kind: Literal[
            "answer",
            "motion",
            "channels",
            "evidence",
            "waterfall",
            "residual",
            "correlation",
            "force",
        ] = "waterfall",
    ) -> Figure:
        """Figure of the result.

        Parameters
        ----------
        kind
            ``"answer"``: the motion and the evidence of the first changes; ``"motion"``: measured,
            the model as it is, and with the changes: the part of a record in which they take away
            most, and all records; ``"channels"``: what the model leaves of each channel before and
            after, in a record that was held out, if there is one; ``"evidence"``: what the records
            leave for each change, and its law; ``"waterfall"``: the gap of the tabulated model, of
            the calibrated one, with each cause, and the noise; ``"residual"``: what remains over
            time; ``"correlation"``: correlation of the fitted parameters and magnitudes;
            ``"force"``: the force that would explain what remains at the best place, over speed and
            position.

        Raises
        ------
        InvalidParameter
            The report has no motions, or no change with evidence.
        """
        missing = {"answer", "motion", "channels"} if self.motions is None else set()
        missing |= set() if self.laws else {"evidence"}
        if kind in missing:
            raise InvalidParameter(
                f"plot: {kind!r}: this report holds none of it; it is made by a diagnosis, and "
                "evidence only where something changes"
            )
        figures: dict[str, Callable[[Any], Figure]] = {
            "answer": lambda report: answer(report.motions, report.laws),
            "motion": lambda report: motion(report.motions),
            "channels": lambda report: channels(report.motions),
            "evidence": lambda report: evidence(report.laws),
            "waterfall": waterfall,
            "residual": residuals,
            "correlation": correlation,
            "force": residual_force,
        }
        return figures[kind](self)

    @checked
    def write(self, folder: str | Path, *, title: str = "Diagnosis", force: bool = False) -> Path:
        """Write the report and what repeats it; returns the path of the page.

        These are report.txt, report.html and report.json, and from a diagnosis also the records,
        the model, and all options: :func:`unmodeled.verify` repeats it. README.txt lists them.

        Parameters
        ----------
        folder
            Folder; it is made if it does not exist.
        title
            Title of the page.
        force
            False: existing files are not overwritten.
        """
        from unmodeled.report.case import files_of_case

        at = make_folder(folder)
        with whole_folder(at, force=force, replaced=files_of_case(at)) as new:
            write_text(new / "report.json", self.to_json())
            write_text(new / "report.txt", self.text() + "\n")
            page = write_text(new / "report.html", self.html(title))
            if self.case is not None:
                self.case.write(new)
        return at / page.name


# ------------------------------------------------------------------- the model with what was found


@dataclass(frozen=True, eq=False)
class InRecords:
    """A change of the answer that acts in some records only."""

    name: str
    records: tuple[str, ...]
    size: float
    """Magnitude of the effect, or change of the parameter [its unit]."""
    effect: Candidate | None = None
    parameter: int = -1
    """Index of the parameter, if it is one."""


@dataclass(frozen=True, eq=False)
class Explained:
    """A model with fitted parameters and the effects of the answer."""

    original: Model
    theta: Array
    """Values of its parameters [their units]."""
    included: tuple[Candidate, ...]
    magnitudes: Array
    """Magnitudes of the included effects [their units]."""
    provenance: str
    in_records: tuple[InRecords, ...] = ()
    """Changes of some records only: a simulation of a record of this name has them."""

    @property
    def parameters(self) -> dict[str, float]:
        """Value of each parameter by name."""
        return {p.name: float(v) for p, v in zip(self.original.parameters, self.theta, strict=True)}

    @property
    def effects(self) -> dict[str, float]:
        """Magnitude of each effect by name."""
        return {t.name: float(v) for t, v in zip(self.included, self.magnitudes, strict=True)}

    @property
    def left_out(self) -> tuple[str, ...]:
        """Changes that are no numbers of the model: of sensors, and of some records only."""
        left = numbers(self.original, self.theta, self.included, self.magnitudes)[1]
        return (*left, *dict.fromkeys(c.name for c in self.in_records))

    @checked
    def simulate(self, record: Record) -> dict[str, Array]:
        """Simulate a whole record; returns the outputs by name.

        A start state that is not known is the one that fits the beginning of the record best.

        Parameters
        ----------
        record
            Record whose inputs drive the model.
        """
        here = [c for c in self.in_records if record.name in c.records]
        theta, own = self.theta.copy(), [c for c in here if c.effect is not None]
        for c in here:
            if c.effect is None:
                theta[c.parameter] += c.size
        included = (*self.included, *(c.effect for c in own if c.effect is not None))
        magnitudes = np.array([*self.magnitudes, *(c.size for c in own)])
        (record,) = matched(self.original, (record,)).records
        return simulated(self.original, record, theta, included, magnitudes)

    @checked
    def film(self, path: str | Path, record: Record, *, force: bool = False) -> Path:
        """Write a video of a robot: measured, in the model as it is, and with the changes.

        The pictures are those of the renderer of MuJoCo, or stick figures where it cannot draw
        (``MUJOCO_GL=egl`` helps on a machine without a screen). Joints that were not measured stay
        in the pose of the file.

        Parameters
        ----------
        path
            File to be written, ``.gif``.
        record
            Record that is shown, its first ten seconds.
        force
            False: an existing file is not overwritten.

        Raises
        ------
        InvalidParameter
            The model is no MuJoCo model, or the file has another ending.
        """
        from unmodeled.fit.mjcf import MujocoModel

        model, path = self.original, Path(path)
        if not isinstance(model, MujocoModel) or path.suffix != ".gif":
            raise InvalidParameter(f"{path}: expected the name of a .gif, and a MuJoCo model")
        values, _ = numbers(model, self.theta, self.included, self.magnitudes)
        (own,) = matched(model, (record,)).records
        shown = record.outputs, simulated(model, own), self.simulate(record)
        views = views_of(model.mjcf.model, model.mjcf.patched(values).compile(), shown)
        return film(path, record.time, views, force=force)

    @checked
    def write(self, path: str | Path, *, force: bool = False) -> Path:
        """Write the model to a file: a mechanism, an MJCF file, or its numbers (TOML).

        Parameters
        ----------
        path
            File to be written.
        force
            False: an existing file is not overwritten.

        Raises
        ------
        InvalidParameter
            The file has another ending, or its format cannot represent an effect.
        """
        return write(
            self.original,
            Path(path),
            self.theta,
            self.included,
            self.magnitudes,
            provenance="; ".join([self.provenance, *self._by_record()]),
            force=force,
        )

    def _by_record(self) -> Iterator[str]:
        """What acts in some records only, for a file that has one number for all of them."""
        for name in dict.fromkeys(c.name for c in self.in_records):
            values = []
            for c in (c for c in self.in_records if c.name == name):
                zero = 0.0 if c.effect is not None else self.theta[c.parameter]
                values.append(f"{', '.join(c.records)} {zero + c.size:.6g}")
            yield f"{name}: {', '.join(values)}"


@checked
def explained_model(model: Model, effects: Sequence[Effect], result: Result) -> Explained:
    """The model with the fitted parameters and the effects of the answer of its diagnosis.

    Parameters
    ----------
    model
        The model that was diagnosed.
    effects
        The effects that were tested.
    result
        Report of the diagnosis.
    """
    fitted = {p.name: p.value for p in result.parameters}
    by_name = {e.name: e for e in effects}
    every = (*result.named, *result.supported,
             *(g[0] for g in (*result.classes, *result.small, *result.unsure)))  # fmt: skip
    some = [n for n in every if n.subject.scope.records or n.subject.scope.each]
    told = [n for n in every if n.cause in by_name and same_number(model, by_name[n.cause]) is None]
    return Explained(
        model,
        np.array([fitted.get(p.name, p.value) for p in model.parameters]),
        tuple(Candidate(by_name[n.cause], n.shape) for n in told),
        np.array([n.magnitude for n in told]),
        f"unmodeled diagnose of {', '.join(result.records)}",
        tuple(c for n in some for c in _in_records(model, by_name, n, result)),
    )


def _in_records(
    model: Model, effects: Mapping[str, Effect], n: NamedCause, result: Result
) -> Iterator[InRecords]:
    """A cause of some records as what each of them has; nothing: it is no part of the model."""
    scope = n.subject.scope
    law = n.cause.removesuffix(" in each record" if scope.each else scope.where)
    names = [p.name for p in model.parameters]
    index = names.index(law) if law in names and law not in effects else None
    if index is None and law in effects:
        index = same_number(model, effects[law])
    if index is None and law not in effects:
        return
    sizes = {r: n.magnitude * share for r, share in zip(scope.records, scope.shares, strict=False)}
    if scope.each:
        fitted = {p.name: p.value for p in result.parameters}
        common = fitted.get(law, 0.0)
        sizes = {r: v - common for r, v in zip(result.records, n.by_record, strict=True)}
    for r, size in (sizes or dict.fromkeys(scope.records, n.magnitude)).items():
        if index is not None:
            yield InRecords(n.cause, (r,), size, parameter=index)
        else:
            yield InRecords(n.cause, (r,), size, Candidate(effects[law], n.shape))
