"""Output of ``feltmb gap diagnose``."""

from __future__ import annotations

import math
import textwrap
from typing import TYPE_CHECKING

from feltmb.cli.common import console, new_table, pretty, say
from feltmb.units import unit_suffix

if TYPE_CHECKING:
    from feltmb.gap import Report

__all__ = ["print_report"]

#: Largest numbers of parameters and effects that are listed.
MOST_MOVED, MOST_EFFECTS = 8, 6


def print_report(report: Report) -> None:
    """Print the report in five parts: tabulated gap, calibration, effects, residual, next steps."""
    say(f"{report.verdict}: {report.statement}")
    _as_it_is(report)
    _calibration(report)
    _missing(report)
    _remains(report)
    _next(report)


def _head(text: str) -> None:
    say(f"\n{text}")


def _in_unit(value: float, unit: str) -> str:
    return " ".join(pretty(value, unit)) if math.isfinite(value) else "fails"


def _as_it_is(report: Report) -> None:
    from feltmb.gap.findings import EXPLAINED

    _head("1 The gap as it is: tabulated numbers, before any fit, all records")
    table = new_table(
        "", "channel", "gap", "noise", "gap / noise", "gap / motion", right=(1, 2, 3, 4), whole=(0,)
    )
    for row in report.as_it_is:
        share = row.gap / row.spread if row.spread > 0.0 else math.inf
        table.add_row(
            row.channel,
            _in_unit(row.gap, row.unit),
            _in_unit(row.noise, row.unit),
            f"{row.multiple:.3g}",
            f"{share:.2g}" if math.isfinite(share) else "-",
        )
    console().print(table)
    for row in report.as_it_is:
        if row.failed:
            say(f"{row.channel}: the simulation ends early in {', '.join(row.failed)}")
        elif row.worse_than_constant:
            text = f"{row.channel}: the model is further from the records than a constant is."
            if report.verdict not in EXPLAINED:
                text += " Look at units, signs and columns before anything else."
            say(text)


def _calibration(report: Report) -> None:
    _head("2 What calibration explains")
    fell = dict(report.how_far.waterfall)
    if "calibration" in fell:
        far = report.how_far
        say(
            f"Held-out gap {far.tabulated:.4g} as tabulated, {far.before:.4g} with fitted "
            f"parameters (in {far.waterfall_unit})."
        )
    if not report.calibrated:
        say("No parameter moved by more than two standard deviations of its estimate.")
    elif report.named:
        say("Parameters in the fit with the named effects:")
    for row in report.calibrated[:MOST_MOVED]:
        say(f"- {row.text}{row.notes}")
    if len(report.calibrated) > MOST_MOVED:
        say(f"- and {len(report.calibrated) - MOST_MOVED} more, see report.json")
    for g in report.given:
        say(f"A part of the model: {g.text}{g.remark}")
    at_limit = [i.name for i in report.fit.intervals() if i.at_limit]
    if at_limit:
        say(f"At a limit of its range: {', '.join(at_limit)}")


def _missing(report: Report) -> None:
    from feltmb.gap.digits import digits

    _head("3 What is missing")
    if not report.which.effects:
        say("No effect was tested.")
        return
    if not report.named and not report.one_of:
        say("Nothing is named. Tested effects in the order of their probability:")
    out = console()
    table = new_table(
        "", "effect", "magnitude, 95 %", "T", "probability", right=(1, 2, 3), whole=(0, 1, 2, 3)
    )
    room = max(27, out.width - 55)
    for r in report.which.effects[:MOST_EFFECTS]:
        mark = "* " if r.named else ("? " if r.effect in report.one_of else "  ")
        unit = unit_suffix(r.unit)
        left = [f"{mark}{r.effect}", *(f"  {b}" for b in textwrap.wrap(r.component, room))]
        shown = digits(r.magnitude, r.sd, 3)
        right = [
            f"{r.magnitude:.{max(4, shown)}g}{unit}",
            f"{r.low:.{shown}g} .. {r.high:.{shown}g}",
        ]
        right += [""] * (len(left) - len(right))
        if r.named or r.effect in report.one_of:
            left += [f"  {n.name} {n.value:.4g}" for n in r.numbers]
            right += [f"{n.low:.4g} .. {n.high:.4g}" if n.low < n.high else "" for n in r.numbers]
        table.add_row(
            "\n".join(left),
            "\n".join(right),
            f"{r.statistic:.{0 if r.statistic > 1000 else 1}f}",
            f"{r.posterior:.0%}",
        )
    out.print(table)
    if report.which.form_note:
        say(report.which.form_note)
    for p in report.profiles:
        say(f"- {p.text}")
    if report.no_profile:
        say(f"No profile: {report.no_profile}.")
    for n in report.refused:
        say(f"In the best set, but not named: {n.name} ({n.why})")
    for why in dict.fromkeys(n.why for n in report.not_tested):
        names = ", ".join(n.name for n in report.not_tested if n.why == why)
        say(f"Not tested: {names} ({why})")


def _remains(report: Report) -> None:
    _head(f"4 What remains, on held-out records ({', '.join(report.how_far.records)})")
    table = new_table(
        "",
        "metric",
        "channel",
        "tabulated",
        "calibrated",
        "with effects",
        "noise",
        right=(2, 3, 4, 5),
        whole=(0, 1),
    )
    for g in report.how_far.rows:
        table.add_row(
            g.metric,
            f"{g.channel} [{g.unit}]",
            f"{g.tabulated:.3g}",
            f"{g.before:.3g}",
            f"{g.after:.3g}" if report.model.included else "-",
            f"{g.noise:.2g}",
        )
    console().print(table)
    far = report.how_far
    if report.model.included:
        what = "What is named" if report.named or report.one_of else "The closest tested set"
        say(
            f"{what} closes {far.closed_text} of the calibrated gap "
            f"({far.low:.0%} to {far.high:.0%})."
        )
    named = bool(report.model.included)
    cells = [c for c in (report.where.remains if named else report.where.ledger) if c.significant]
    if not cells:
        say("No channel differs from that by more than noise at any time.")
        return
    worst = max(cells, key=lambda c: c.z)
    say(
        f"Largest in {worst.channel} of {worst.record}, {worst.start:.4g} to {worst.end:.4g} s: "
        f"{_in_unit(worst.rms, _unit(report, worst.channel))}"
    )
    if not named:
        for c in [c for c in report.where.components if c.significant][:3]:
            say(f"An unknown force at {c.component} would explain {c.explained:.0%} of it.")


def _unit(report: Report, channel: str) -> str:
    return next((a.unit for a in report.as_it_is if a.channel == channel), "")


def _next(report: Report) -> None:
    _head("5 What to do next")
    for advice in report.next:
        say(f"- {advice.text}")
    if not report.next:
        say("Nothing: the model explains these records.")
    for warning in report.checks.warnings:
        say(f"Warning: {warning}")
