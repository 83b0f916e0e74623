"""Text of a report: five parts, as sentences and tables."""

from __future__ import annotations

import io
import math
import textwrap
from collections.abc import Iterator

from feltmb.fit.solve import NOT_CONVERGED
from feltmb.gap.criteria import NO_GAP_RATIO, NOISE_ERROR
from feltmb.gap.digits import digits
from feltmb.gap.findings import EXPLAINED, Findings, Verdict, sentence
from feltmb.gap.spread import together
from feltmb.tables import FittingTable, Screen, new_table
from feltmb.units import pretty, unit_suffix

__all__ = ["parts", "report_text"]

Part = str | FittingTable
#: Largest numbers of parameters, effects and correlated pairs that are listed.
MOST_MOVED, MOST_EFFECTS, MOST_PAIRS = 8, 6, 3
#: Largest number of names that are listed for a reason why effects were not tested.
MOST_UNTESTED = 3
#: Mark of an effect of the best set that is not named.
REFUSED = "x "


def parts(report: Findings, width: int) -> Iterator[Part]:
    """Sentences and tables: tabulated gap, calibration, effects, residual, next steps.

    ``width``: number of characters in a line.
    """
    yield f"{report.verdict}: {report.statement}"
    yield from _as_it_is(report)
    yield from _calibration(report)
    yield from _missing(report, width)
    yield from _remains(report)
    yield from _next(report)


def report_text(report: Findings, width: int) -> str:
    """The report as plain text with lines of at most ``width`` characters."""
    out = io.StringIO()
    screen = Screen(file=out, width=width, highlight=False, markup=False, emoji=False)
    for part in parts(report, width):
        screen.print(part)
    return "\n".join(line.rstrip() for line in out.getvalue().splitlines())


def _in_unit(value: float, unit: str) -> str:
    return " ".join(pretty(value, unit)) if math.isfinite(value) else "fails"


def _as_it_is(report: Findings) -> Iterator[Part]:
    yield "\n1 The gap as it is: tabulated numbers, before any fit, all records"
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
    yield table
    for row in report.as_it_is:
        if row.failed:
            yield f"{row.channel}: the simulation ends early in {', '.join(row.failed)}"
        elif row.worse_than_constant:
            text = f"{row.channel}: the model is further from the records than a constant is."
            if report.verdict not in EXPLAINED:
                text += " Look at units, signs and columns before anything else."
            yield text


def _calibration(report: Findings) -> Iterator[Part]:
    yield "\n2 What calibration explains"
    fell = dict(report.how_far.waterfall)
    if "calibration" in fell:
        far = report.how_far
        yield (
            f"Held-out gap {far.tabulated:.4g} as tabulated, {far.before:.4g} with fitted "
            f"parameters (in {far.waterfall_unit})."
        )
    if not report.calibrated:
        yield "No parameter moved by more than two standard deviations of its estimate."
    elif report.named:
        yield "Parameters in the fit with the named effects:"
    for row in report.calibrated[:MOST_MOVED]:
        yield f"- {row.text}{row.notes}"
    if len(report.calibrated) > MOST_MOVED:
        yield f"- and {len(report.calibrated) - MOST_MOVED} more, see report.json"
    told = sum(row.share for row in report.calibrated if math.isfinite(row.share))
    fell_by = report.how_far.tabulated / max(report.how_far.before, 1.0)
    if "calibration" in fell and fell_by > NO_GAP_RATIO:
        yield from _moved_together(report, all_pairs=told < 0.5)
    for g in report.given:
        yield f"A part of the model: {g.text}{g.remark}"
    if at_limits := report.model.at_limits:
        yield f"At a limit of its range: {', '.join(at_limits)}"


def _moved_together(report: Findings, *, all_pairs: bool) -> Iterator[str]:
    """Parameters whose combination the records determine, but not each of them.

    ``all_pairs``: also those of which neither parameter moved by itself.
    """
    parameters = report.fit.problem.model.parameters
    labels = {p.name: _within(p.title) for p in parameters if p.of_the_machine}
    moved = {row.name for row in report.calibrated}
    pairs = [
        p
        for p in together(report.fit)
        if labels.keys() >= {*p[:2]} and (all_pairs or moved & {*p[:2]})
    ]
    if pairs:
        rows = [f"{labels[a]} and {labels[b]} ({rho:.2f})" for a, b, rho in pairs[:MOST_PAIRS]]
        listed = ", ".join(rows)
        yield (
            f"The records hardly separate {listed} (correlation); such parameters may have moved "
            "together. A test of one part determines the other."
        )


def _within(title: str) -> str:
    """The name of a parameter within a sentence."""
    return "the" + title[3:] if title.startswith("The ") else title


def _missing(report: Findings, width: int) -> Iterator[Part]:
    yield "\n3 What is missing"
    if not report.which.effects:
        yield "No effect was tested."
        return
    if not report.named and not report.one_of:
        yield "Nothing is named. Tested effects in the order of their probability:"
    table = new_table(
        "", "effect", "magnitude, 95 %", "T", "probability", right=(1, 2, 3), whole=(0, 1, 2, 3)
    )
    room = max(27, width - 55)
    refused = {n.name for n in report.refused}
    for r in report.which.effects[:MOST_EFFECTS]:
        mark = "* " if r.named else ("? " if r.effect in report.one_of else "  ")
        if r.effect in refused:
            mark = REFUSED
        unit = unit_suffix(r.unit)
        left = [f"{mark}{r.effect}", *(f"  {b}" for b in textwrap.wrap(r.component, room))]
        shown = digits(r.magnitude, r.sd, 3)
        right = [
            f"{r.magnitude:.{max(4, shown)}g}{unit}",
            f"{r.low:.{shown}g} .. {r.high:.{shown}g}" if r.converged else NOT_CONVERGED,
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
    yield table
    if not (report.named or report.one_of or report.stopped):
        tested = max(0.0, 1.0 - report.which.none - report.which.other)
        yield (
            f"The probability is {report.which.none:.0%} that nothing is missing, "
            f"{report.which.other:.0%} that something else is missing, and {tested:.0%} that one "
            "or several of the tested effects are."
        )
    if report.which.form_note:
        yield report.which.form_note
    if report.verdict == Verdict.NAMED_RESIDUAL:
        yield (
            "The intervals do not contain what the cause of the unexplained residual may change in "
            "magnitudes and parameters."
        )
    for p in report.profiles:
        yield f"- {p.text}"
    if report.no_profile:
        yield f"No profile: {report.no_profile}."
    for n in report.refused:
        yield f"{REFUSED}Refused (in the best set, but not named): {n.name} ({n.why})"
    for why, names in report.not_tested_by_reason:
        listed = ", ".join(names[:MOST_UNTESTED])
        if len(names) > MOST_UNTESTED:
            listed += f" and {len(names) - MOST_UNTESTED} more"
        count = "1 effect" if len(names) == 1 else f"{len(names)} effects"
        yield f"Not tested, {count}: {why} ({listed})"


def _remains(report: Findings) -> Iterator[Part]:
    yield f"\n4 What remains, on held-out records ({', '.join(report.how_far.records)})"
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
    yield table
    far = report.how_far
    if report.model.included:
        yield sentence(far.closing("what is named", "the calibrated gap"))
    cells = report.remaining_cells
    if not cells:
        rest = max((g.after / g.noise for g in report.how_far.rows), default=0.0)
        if report.model.included and rest > NOISE_ERROR:
            yield "What is left is spread over the records: no part of a channel exceeds noise."
        else:
            yield "No channel differs from that by more than noise at any time."
        return
    worst = max(cells, key=lambda c: c.z)
    yield (
        f"Largest of all records in {worst.channel} of {worst.record}, {worst.start:.4g} to "
        f"{worst.end:.4g} s: "
        f"{_in_unit(worst.rms, _unit(report, worst.channel))}"
    )
    if not report.model.included:
        for c in [c for c in report.where.components if c.significant][:3]:
            yield f"{c.text}."
        yield from report.where.hints


def _unit(report: Findings, channel: str) -> str:
    return next((a.unit for a in report.as_it_is if a.channel == channel), "")


def _next(report: Findings) -> Iterator[Part]:
    yield "\n5 What to do next"
    for advice in report.next:
        yield f"- {advice.text}"
    if not report.next:
        yield report.no_step
    for warning in report.checks.told:
        yield f"Warning: {warning}"
