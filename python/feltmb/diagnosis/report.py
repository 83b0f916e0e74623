"""The report of a diagnosis: all sentences, as text, as an HTML page, and as files.

The first screen says what the model misses, what explains it, what is left, and what to do. Numbers
for specialists are in the tables of details, which follow.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from feltmb.arguments import checked
from feltmb.data import Record
from feltmb.diagnosis.figures import correlation, residuals, svg, told_set, waterfall
from feltmb.diagnosis.result import Cell, Channel, Named, Place, Reason, Result, Verdict
from feltmb.files import make_folder, write_text
from feltmb.tables import Screen, new_table
from feltmb.units import readable_unit

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

__all__ = ["Report", "Section", "sections", "statement", "text", "write"]

#: Words of reasons that a user must know beside the verdict.
TOLD = {
    Reason.NOISE_NOT_STATED: "No noise of a sensor is stated, so that only the share of the motion "
    "decides what matters.",
    Reason.DIFFERS_BETWEEN_RECORDS: "A probable cause has another magnitude in each record, as an "
    "imitation of something that is not in the list has. It is not named.",
    Reason.BELOW_RESIDUAL: "A probable cause acts less than what remains unexplained. It is not "
    "named.",
    Reason.NO_HELD_OUT_GAIN: "The causes do not improve the prediction of held-out records.",
    Reason.NOT_COMPLETE: "The search ended at its limit of time, or was interrupted.",
    Reason.CALIBRATION_PREDICTS_WORSE: "The calibrated model predicts the held-out records worse "
    "than the tabulated one.",
}
#: Verdicts as words.
VERDICTS = {
    Verdict.NO_GAP: "No gap",
    Verdict.CALIBRATED: "Calibrated",
    Verdict.NAMED: "Named",
    Verdict.ONE_OF: "One of several",
    Verdict.UNKNOWN: "Unknown",
}
#: Largest multiple of the noise that counts as the noise.
NOISE = 1.3
#: Correlation above which two unknowns are hardly separated [1].
TOGETHER = 0.95
#: Largest numbers of parameters on the first screen, sets and causes in tables, next steps.
PARAMETERS, SETS, STEPS = 6, 8, 3


@dataclass(frozen=True)
class Section:
    """A part of the report."""

    title: str
    lines: tuple[str, ...] = ()
    items: tuple[str, ...] = ()
    head: tuple[str, ...] = ()
    """Head of the table; its first column is text, the others are numbers."""
    rows: tuple[tuple[str, ...], ...] = ()
    details: bool = False


# ---------------------------------------------------------------- numbers


def _number(value: float, uncertainty: float) -> str:
    """A number with the digits that its uncertainty supports, two of the uncertainty."""
    if not math.isfinite(value):
        return "-"
    if not math.isfinite(uncertainty) or uncertainty <= 0.0:
        return f"{value:.4g}"
    places = 1 - math.floor(math.log10(uncertainty))
    return f"{value:.{places}f}" if 0 <= places <= 6 else f"{float(f'{value:.{max(0, places)}f}'):.6g}"


def _sized(unit: str, *values: float, uncertainty: float = 0.0) -> tuple[list[str], str]:
    """Numbers in a unit that people read, and the unit with a space before it."""
    factor, name = readable_unit(max((abs(v) for v in values if math.isfinite(v)), default=1), unit)
    numbers = [_number(factor * v, factor * uncertainty) for v in values]
    return numbers, "" if name == "1" else f" {name}"


def _magnitude(n: Named) -> str:
    """Magnitude with its 95 % interval."""
    (value, low, high), unit = _sized(
        n.unit, n.magnitude, n.low, n.high, uncertainty=0.5 * (n.high - n.low)
    )
    return f"{value}{unit} ({low} to {high})"


def _size(value: float, unit: str) -> str:
    (number,), name = _sized(unit, float(f"{value:.3g}"))
    return number + name


def _percent(value: float) -> str:
    return f"{100.0 * value:.2g} %" if math.isfinite(value) else "-"


def _name(n: Named) -> str:
    """Name of a cause as the subject of a sentence."""
    return f"{n.cause} outside its tolerance" if n.parameter else n.cause


def _listed(words: Sequence[str], last: str = "and") -> str:
    return f" {last} ".join(filter(None, [", ".join(words[:-1]), words[-1]])) if words else ""


# ---------------------------------------------------------------- what a user reads first


def statement(result: Result) -> str:
    """What the model misses, what takes it away, what remains, and whether that matters.

    Parameters
    ----------
    result
        Result of a diagnosis.
    """
    c = result.worst
    tabulated, calibrated = (_percent(c.share(v)) for v in (c.tabulated, c.calibrated))
    misses = f"The model misses {tabulated} of the motion of {c.name}"
    if not math.isfinite(c.tabulated):
        misses = f"The tabulated model fails; the fitted one misses {calibrated} of the motion"
        misses += f" of {c.name}"
    elif c.calibrated < 0.9 * c.tabulated:
        misses += f", and {calibrated} with fitted parameters"
    if result.verdict is Verdict.NO_GAP:
        return f"{misses}: there is no gap. {_remains(result)}"
    if result.verdict is Verdict.CALIBRATED:
        return f"{misses}. No cause is missing. {_remains(result)}"
    if result.verdict is Verdict.UNKNOWN:
        return f"{misses}. No cause of the list explains it. {_remains(result)}"
    told = [f"{_name(n)} of {_magnitude(n)}" for n in result.named]
    told += [f"one of {_listed([_name(n) for n in g], 'or')}" for g in result.classes]
    takes = "takes" if len(told) == 1 else "take"
    to = _percent(c.share(c.explained))
    return f"{misses}. {_listed(told)} {takes} it to {to}. {_remains(result)}"


def _remains(result: Result) -> str:
    material = sorted(
        (c for c in result.channels if c.material), key=lambda c: -c.explained / c.good_enough
    )
    if not material:
        c = result.worst
        if c.explained <= NOISE * c.noise:
            return "Nothing but the noise of the sensor remains."
        times = f"{c.explained / c.noise:.2g} times the noise of the sensor, "
        return (
            f"The rest, {'' if math.isnan(c.noise) else times}{_percent(c.share(c.explained))} of "
            "the motion, does not matter."
        )
    c = material[0]
    times = "" if math.isnan(c.noise) else f", {c.explained / c.noise:.2g} times its noise"
    more = f", and {len(material) - 1} more" if len(material) > 1 else ""
    return (
        f"The rest matters: {_percent(c.share(c.explained))} of {c.name}{times}{more}, where "
        f"{_percent(c.share(c.good_enough))} is good enough."
    )


def sections(result: Result) -> list[Section]:
    """The parts of the report, those of the first screen first.

    Parameters
    ----------
    result
        Result of a diagnosis.
    """
    first = [_missing(result), _calibration(result), _held_out(result), _where(result)]
    return [s for s in (*first, _next(result), *_details(result)) if s.lines or s.items or s.rows]


def _missing(result: Result) -> Section:
    lines, items = [], []
    for n in result.named:
        unit = n.unit
        half = 0.5 * (n.high - n.low)
        each = ""
        if len(n.by_record) > 1:
            values, name = _sized(unit, *n.by_record, uncertainty=half)
            each = f"; in each record {', '.join(values)}{name}"
        numbers = n.shape if isinstance(n.shape, tuple) else (n.shape,)
        shape = [f"{a} {v:.3g}" for a, v in zip(n.shape_names, numbers, strict=False)]
        items.append(
            f"{_name(n)} [{n.component}]: {_magnitude(n)}{each}"
            + "".join(f"; {s}" for s in shape)
            + (f". {n.mechanism}" if n.mechanism else "")
        )
    for group in result.classes:
        members = [f"{_name(n)} [{n.component}] of {_magnitude(n)}" for n in group]
        items.append(
            f"One of these, which the records do not tell apart: {_listed(members, 'or')}."
        )
    if not items and result.verdict is Verdict.UNKNOWN:
        best = _probabilities(result)[:2]
        if best:
            tested = _listed([f"{name} ({_percent(p)})" for name, p in best])
            lines.append(f"Nothing is named. Most probable of those tested: {tested}.")
    lines += [TOLD[r] for r in result.reasons if r in TOLD]
    return Section("What is missing", tuple(lines), tuple(items))


def _probabilities(result: Result) -> list[tuple[str, float]]:
    """Probability of each cause over all sets, largest first."""
    found: dict[str, float] = {}
    for s in result.sets:
        for name in s.causes:
            found[name] = found.get(name, 0.0) + s.probability
    return sorted(((k, v) for k, v in found.items() if v >= 0.01), key=lambda f: -f[1])


def _calibration(result: Result) -> Section:
    moved = [p for p in result.parameters if not p.low <= p.tabulated <= p.high]
    moved.sort(key=lambda p: -abs(p.value - p.tabulated) / (p.high - p.low or 1.0))
    items = []
    for p in moved[:PARAMETERS]:
        (value, low, high), unit = _sized(
            p.unit, p.value, p.low, p.high, uncertainty=0.5 * (p.high - p.low)
        )
        sd = abs(p.value - p.tabulated) / p.sd if 0.0 < p.sd < math.inf else math.nan
        far = f", {sd:.2g} tolerances away" if math.isfinite(sd) else ""
        items.append(
            f"{p.title}: {value}{unit} ({low} to {high}), tabulated {_size(p.tabulated, p.unit)}{far}"
        )
    if more := len(moved) - PARAMETERS:
        items += [f"{more} more parameters, see the details"] if more > 0 else []
    lines = [] if items or not result.parameters else ["No parameter left its tabulated value."]
    return Section("Calibration", tuple(lines), tuple(items))


def _held_out(result: Result) -> Section:
    if result.held_out_gain is None:
        return Section("Held-out records")
    value, low, high = (100.0 * (1.0 - g) for g in result.held_out_gain)
    what = f"shrinks by {value:.0f} %" if value >= 0.0 else f"grows by {-value:.0f} %"
    return Section(
        "Held-out records",
        (f"Where nothing was fitted, the residual {what} with these causes ({high:.0f} to "
         f"{low:.0f} %).",),
    )  # fmt: skip


def _worst_cell(result: Result, attribute: str) -> tuple[Cell, Channel] | None:
    channels = {c.name: c for c in result.channels}
    rows = [(cell, channels[cell.channel]) for cell in result.cells]
    rows = [r for r in rows if math.isfinite(r[1].share(getattr(r[0], attribute)))]
    return max(rows, key=lambda r: r[1].share(getattr(r[0], attribute)), default=None)


def _within(cell: Cell) -> str:
    since = f", after {cell.since}" if cell.since else ""
    return f"{cell.channel} of {cell.record}, {cell.start:.3g} to {cell.end:.3g} s{since}"


def _where(result: Result) -> Section:
    lines = []
    told = bool(result.named or result.classes)
    if (worst := _worst_cell(result, "calibrated")) and result.verdict is not Verdict.NO_GAP:
        cell, channel = worst
        after = f", {_size(cell.explained, channel.unit)} with the causes" if told else ""
        lines.append(
            f"Without further causes, the residual is largest in {_within(cell)}: "
            f"{_size(cell.calibrated, channel.unit)} rms{after}."
        )
    units = {c.name: c.unit for c in result.channels}
    late = sorted(result.events, key=lambda e: -abs(e.delay) / e.delay_sd)
    for e in [e for e in late if abs(e.delay) > 3.0 * e.delay_sd][:1]:
        way = "late" if e.delay > 0.0 else "early"
        after = f" ({_size(abs(e.delay_explained), 's')} with the causes)" if told else ""
        lines.append(
            f"At the event {e.event} of {e.record}, {e.channel} comes {_size(abs(e.delay), 's')} "
            f"too {way}{after}; its speed differs by {_size(e.speed, f'{units[e.channel]}/s')}."
        )
    lines += [_place(result, p) for p in result.places[:2]]
    return Section("Where", tuple(lines))


def _place(result: Result, place: Place) -> str:
    k = result.channels.index(result.worst)
    c = result.worst
    what = "An unknown force" if place.port else "Unlisted changes from record to record"
    like = ""
    if place.resembles and place.resembles[0][1] > 0.3:
        law, share = place.resembles[0]
        like = f"; it would resemble the {law} ({_percent(share)} of it)"
    return (
        f"{what} at {place.name} would take the rest from {_percent(c.share(c.explained))} to "
        f"{_percent(c.share(place.left[k]))} of {c.name}{like}."
    )


def _next(result: Result) -> Section:
    steps: list[str] = []
    for n in result.named:
        steps.append(f"{_name(n)}: {n.remedy or 'correct the model, and measure it by itself.'}")
    for group, record in zip(result.classes, result.apart, strict=False):
        one, other = group[:2]
        remedies = [f"{_name(n)}: {n.remedy}" for n in group if n.remedy][:1]
        measure = [f"measure {n.cause} by itself" for n in group if n.parameter][:1]
        steps.append(
            f"To tell {_name(one)} from {_name(other)}: "
            + "; ".join([*measure, f"record more motions like {record}, where they differ most"])
            + "."
        )
        steps += remedies if not measure else []
    if Reason.NOT_COMPLETE in result.reasons:
        steps.append(
            f"Diagnose again with a larger limit of time (seconds): {len(result.not_tried)} causes "
            "were not tried."
        )
    if any(c.material for c in result.channels):
        if result.places:
            p = result.places[0]
            law = f" that resembles the {p.resembles[0][0]}" if p.resembles else ""
            steps.append(f"Inspect {p.name}, and add an effect there{law} to the list.")
        elif worst := _worst_cell(result, "explained"):
            steps.append(f"Look at {_within(worst[0])}: the rest is largest there.")
    steps += [
        f"Measure {a} by itself: the records hardly separate it from {b}."
        for a, b, _ in _pairs(result)
    ]
    if Reason.NOISE_NOT_STATED in result.reasons:
        steps.append("Record the machine at rest, and state the noise of the sensors.")
    if not steps:
        steps.append("Nothing: the model can be used for motions like the recorded ones.")
    return Section("Next", (), tuple(dict.fromkeys(steps))[:STEPS])


def _pairs(result: Result) -> list[tuple[str, str, float]]:
    """Pairs of a moved parameter and another unknown that the records hardly separate."""
    moved = {p.name for p in result.parameters if not p.low <= p.tabulated <= p.high}
    found = []
    for i, j in np.argwhere(np.abs(np.triu(result.correlation, 1)) > TOGETHER):
        a, b = result.unknowns[i], result.unknowns[j]
        if {a, b} & moved:
            first, second = (a, b) if a in moved else (b, a)
            found.append((first, second, float(result.correlation[i, j])))
    return sorted(found, key=lambda f: -abs(f[2]))


# ---------------------------------------------------------------- details


def _details(result: Result) -> Iterator[Section]:
    cells = []
    for c in result.channels:
        values = (c.noise, c.tabulated, c.calibrated, c.explained, c.held_out_calibrated,
                  c.held_out_explained)  # fmt: skip
        cells.append(
            (
                f"{c.name} [{c.unit}]",
                *(f"{v:.3g}" if math.isfinite(v) else "-" for v in values),
                _percent(c.share(c.explained)),
            )
        )
    head = ("rms residual", "noise", "tabulated", "calibrated", "explained", "held out, calibrated",
            "held out, explained", "of motion")  # fmt: skip
    yield Section("Residuals", head=head, rows=tuple(cells), details=True)
    sets = []
    k = result.channels.index(result.worst)
    for s in result.sets[:SETS]:
        share = result.worst.share(s.residual[k])
        sets.append((_listed(s.causes) or "nothing", f"{s.probability:.3f}", _percent(share)))
    head = ("set of causes", "probability", f"of {result.worst.name} left")
    yield Section("Fitted sets", head=head, rows=tuple(sets), details=True)
    causes = [(name, f"{p:.3f}") for name, p in _probabilities(result)[:SETS]]
    head = ("cause", "probability")
    yield Section("Causes", head=head, rows=tuple(causes), details=True)
    rows = []
    for p in result.parameters:
        (value, low, high), unit = _sized(
            p.unit, p.value, p.low, p.high, uncertainty=0.5 * (p.high - p.low)
        )
        rows.append((f"{p.name}{f' [{unit[1:]}]' if unit else ''}",
                     _sized(p.unit, p.tabulated, p.value, p.low, p.high)[0][0], value,
                     f"{low} to {high}"))  # fmt: skip
    head = ("parameter", "tabulated", "fitted", "95 % interval")
    yield Section("Parameters", head=head, rows=tuple(rows), details=True)
    notes = list(result.notes)
    if result.not_tried:
        listed = ", ".join(result.not_tried[:SETS])
        more = len(result.not_tried) - SETS
        notes.append(
            f"Not refitted, because their first-order gain is small: {listed}"
            + (f" and {more} more." if more > 0 else ".")
        )
    yield Section("Notes", items=tuple(notes), details=True)


# ---------------------------------------------------------------- forms


def text(result: Result, width: int = 100) -> str:
    """The report as plain text.

    Parameters
    ----------
    result
        Result of a diagnosis.
    width
        Largest number of characters of a line.
    """
    out = io.StringIO()
    screen = Screen(file=out, width=width, highlight=False, markup=False, emoji=False)
    screen.print(statement(result))
    for s in sections(result):
        screen.print(f"\n{s.title}" + (" (details)" if s.details else ""))
        for line in s.lines:
            screen.print(f"  {line}")
        for item in s.items:
            screen.print(f"- {item}")
        if s.rows:
            table = new_table("", *s.head, right=tuple(range(1, len(s.head))), whole=(0,))
            for row in s.rows:
                table.add_row(*row)
            screen.print(table)
    lines = [line.rstrip() for line in out.getvalue().splitlines()]
    return "\n".join(a for a, b in zip(lines, ["x", *lines], strict=False) if a or b)


def page(result: Result, title: str = "Diagnosis") -> str:
    """The report as one HTML page that loads nothing; all texts are escaped.

    Parameters
    ----------
    result
        Result of a diagnosis.
    title
        Title of the page, for example the name of the model.
    """
    import jinja2
    from markupsafe import Markup

    template = (resources.files("feltmb.diagnosis") / "report.html").read_text(encoding="utf-8")
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    figures = {
        "Where": svg(residuals(result), "residuals of the records"),
        "Parameters": svg(correlation(result), "correlation of the unknowns"),
    }
    parts = sections(result)
    return environment.from_string(template).render(
        title=title,
        result=result,
        verdict=VERDICTS[result.verdict],
        statement=statement(result),
        waterfall=Markup(svg(waterfall(result), "waterfall of the gap")),
        first=[s for s in parts if not s.details],
        details=[s for s in parts if s.details],
        figures={k: Markup(v) for k, v in figures.items()},
    )


class Report(Result):
    """Result of :func:`feltmb.diagnosis.diagnose`, with its texts, tables and figures."""

    @classmethod
    def of(cls, result: Result) -> Report:
        """The report of a result.

        Parameters
        ----------
        result
            Result of a diagnosis.
        """
        return cls(**{f.name: getattr(result, f.name) for f in fields(result)})

    def __str__(self) -> str:
        return text(self)

    def __repr__(self) -> str:
        return f"Report({self.verdict.name}: {self.summary()})"

    def _repr_html_(self) -> str:
        from html import escape

        frame = self.frame.to_html(float_format=lambda v: f"{v:.4g}", na_rep="")
        steps = "".join(f"<li>{escape(s)}</li>" for s in _next(self).items)
        return f"<p><b>{VERDICTS[self.verdict]}.</b> {escape(self.summary())}</p>{frame}<ul>{steps}</ul>"

    def summary(self) -> str:
        """The first lines: what is missed, what takes it away, what remains."""
        return statement(self)

    @checked
    def text(self, width: int = 100) -> str:
        """The whole report as text.

        Parameters
        ----------
        width
            Largest number of characters of a line.
        """
        return text(self, width)

    @property
    def frame(self) -> pd.DataFrame:
        """Named causes, members of classes and parameters; one row each."""
        import pandas as pd

        told = [("named", n) for n in self.named]
        told += [(f"class {k + 1}", n) for k, g in enumerate(self.classes) for n in g]
        rows: list[Mapping[str, Any]] = [
            {"name": n.cause, "kind": kind, "component": n.component, "unit": n.unit,
             "value": n.magnitude, "low": n.low, "high": n.high, "probability": n.probability}
            for kind, n in told
        ]  # fmt: skip
        rows += [
            {"name": p.name, "kind": "parameter", "unit": p.unit, "value": p.value, "low": p.low,
             "high": p.high, "tabulated": p.tabulated, "tolerance": p.sd}
            for p in self.parameters
        ]  # fmt: skip
        columns = ["name", "kind", "component", "unit", "value", "low", "high", "probability",
                   "tabulated", "tolerance"]  # fmt: skip
        return pd.DataFrame(rows, columns=columns).set_index("name")

    def plot(self) -> Figure:
        """Waterfall of the gap: tabulated, calibrated, with each cause, and the noise."""
        return waterfall(self)

    @checked
    def write(self, folder: str | Path, *, title: str = "Diagnosis", force: bool = False) -> Path:
        """Write report.txt, report.html and report.json; returns the path of the page.

        Parameters
        ----------
        folder
            Folder; it is made if it does not exist.
        title
            Title of the page.
        force
            False: existing files are not overwritten.
        """
        return write(self, Path(folder), title=title, force=force)


def write(result: Result, folder: Path, *, title: str = "Diagnosis", force: bool = False) -> Path:
    """Write report.txt, report.html and report.json to a folder; returns the path of the page.

    Parameters
    ----------
    result
        Result of a diagnosis.
    folder
        Folder; it is made if it does not exist.
    title
        Title of the page.
    force
        False: existing files are not overwritten.
    """
    make_folder(folder)
    write_text(folder / "report.json", result.to_json(), force=force)
    write_text(folder / "report.txt", text(result) + "\n", force=force)
    return write_text(folder / "report.html", page(result, title), force=force)
