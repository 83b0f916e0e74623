"""Information of whole records about each effect of the action, as a signal-to-noise ratio.

At the packaged numbers, linearized, on the strokes that are fitted, for one unit of each effect:

    nc^2 = |d|^2 - d' S (S' S + P)^-1 S' d

with d the whitened change of the records by the effect and S those of the tolerances, P their
priors. Start states of the segments and the noise of the force are eliminated first. Four ways to
take a record:

    free     whole records, the start state of every segment free
    tied     whole records, segments tied by process noise: felts and frictions depart from their
             values in each segment by the allowance
    single   until some time after the hammer turns, in one go from rest
    exact    whole records in one go from rest: nothing could follow them that far, see GAP2.md

    PYTHONPATH=bench python -m blind.whole_records -o bench/results/whole_records.md
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from blind import action_truth as truth
from blind.action_calibration import to_record
from feltmb.adapters import mechanism_model
from feltmb.adapters.landmarks import first_turn
from feltmb.data import Array, Record
from feltmb.fit import Candidate
from feltmb.fit.filter import reduce_chain
from feltmb.fit.linearize import Linear, Place, linearize
from feltmb.fit.noise import Noise
from feltmb.fit.segmented_records import SegmentedRecord, segment_record

__all__ = ["strengths"]

SEGMENT = 0.02
#: Continuity defect where the process noise says what a segment may depart, as a share of the scale
#: of a state, and of a state that vibrates as a share of its spread along the records.
TIGHT, PHASE = 0.03, 0.1
ALLOWANCE = 0.01
#: Continuity defects that do not connect segments, and that connect them as far as double precision
#: allows.
LOOSE, EXACT = 1e6, 1e-7

Part = tuple[SegmentedRecord, Linear]


def strengths(names: Sequence[str] | None = None) -> tuple[list[str], dict[str, Array]]:
    """Names of effects and, by way of taking a record, their noncentrality a unit of magnitude."""
    action, base, library, outputs = truth.setup()
    wanted = [e.name for e in truth.candidates(library, outputs)]
    model: Any
    model, effects = mechanism_model(
        action,
        library=library,
        effects=wanted if names is None else list(names),
        shooting="multiple",
        rtol=1e-6,
        allowance=ALLOWANCE,
    )
    candidates = tuple(Candidate(e, e.shapes[0]) for e in effects)
    plain = truth.plain_case()
    parts = []
    for stroke in truth.FIT:
        longest = truth.command(stroke, plain)[1]
        view, _ = truth.record(base, library, plain, stroke, outputs, length=longest)
        parts.append(_linearized(model, to_record(stroke, view), candidates))
    scale = np.array([s.scale for s in model.states()])
    vibrating = np.array([s.vibrates for s in model.states()])
    spread = np.std(np.vstack([p[2].starts for p in parts]), axis=0)
    tied = TIGHT * scale
    tied[vibrating] = np.maximum(tied, PHASE * spread)[vibrating]
    pairs = [(segmented, linear) for segmented, linear, _ in parts]
    if library.until is None:
        raise ValueError("the library has no [until], so a single segment has no end")
    short = [_until(p, library.until.after_turn) for p in pairs]
    still = [_without_process(model, p) for p in pairs]
    found = {
        "exact": _noncentrality(model, still, EXACT * scale, effects),
        "tied": _noncentrality(model, pairs, tied, effects),
        "free": _noncentrality(model, pairs, LOOSE * scale, effects),
        "single": _noncentrality(
            model, [_without_process(model, p) for p in short], EXACT * scale, effects
        ),
    }
    return [e.name for e in effects], found


def _linearized(
    model: Any, record: Record, candidates: tuple[Candidate, ...]
) -> tuple[SegmentedRecord, Linear, Place]:
    noise = {o: Noise(truth.NOISE_CAMERA, s.correlation_time) for o, s in record.sensors.items()}
    count = max(1, round(float(record.time[-1]) / SEGMENT))
    edges = np.round(np.linspace(0, record.samples - 1, count + 1)).astype(np.intp)
    segmented = segment_record(model, record, noise, None, np.column_stack([edges[:-1], edges[1:]]))
    place = Place(model.guess([record], [segmented.segments])[0], np.zeros(0))
    free = list(range(len(model.parameters)))
    theta = np.zeros(len(free))
    linears = linearize(model, [segmented], theta, free, (), np.zeros(0), [place], candidates)
    return segmented, linears[0], place


def _until(part: Part, after: float) -> Part:
    """The record without samples later than a time after the reversal of the hammer."""
    segmented, linear = part
    record = segmented.record
    turn = first_turn(record.time, record.outputs["hammer_tip.x"])
    last = np.inf if turn is None else turn + after
    at = segmented.segments[:, :1] + np.arange(segmented.measured.shape[1])
    seen = record.time[np.minimum(at, record.samples - 1)] <= last
    rows = np.repeat(seen[..., None], segmented.measured.shape[2], axis=2).reshape(len(at), -1)
    kept = rows[..., None]
    return segmented, replace(
        linear,
        residual=linear.residual * rows,
        by_state=linear.by_state * kept,
        by_global=linear.by_global * kept,
        by_input=linear.by_input * kept,
    )


def _without_process(model: Any, part: Part) -> Part:
    """The record with only the noise of the force."""
    segmented, linear = part
    laws = sum(p.process_sd > 0.0 for p in model.parameters)
    own = slice(0, linear.by_input.shape[2] - laws)
    return segmented, replace(
        linear, by_input=linear.by_input[..., own], ends_by_input=linear.ends_by_input[..., own]
    )


def _noncentrality(
    model: Any, parts: list[Part], defect_sd: Array, effects: Sequence[Any]
) -> Array:
    sd = np.array([p.sd for p in model.parameters])
    unit = np.concatenate([sd, [e.scale for e in effects]])
    known = np.zeros(defect_sd.size)
    gram = sum(
        np.sum(reduce_chain(linear, defect_sd, known, known).grams, axis=0)[
            : unit.size, : unit.size
        ]
        for _, linear in parts
    )
    gram = unit[:, None] * np.asarray(gram) * unit
    n = sd.size
    own = gram[:n, :n] + np.eye(n)
    cross = gram[:n, n:]
    left = np.diag(gram)[n:] - np.einsum("ij,ij->j", cross, np.linalg.solve(own, cross))
    result: Array = np.sqrt(np.maximum(left, 0.0))
    return result


def table(names: Sequence[str], found: dict[str, Array]) -> str:
    """Markdown: a summary, and one row for each effect."""
    lines = [
        "| records | median | effects >= 3 | >= 5 | >= 10 | of |",
        "|---|---|---|---|---|---|",
    ]
    for way, values in found.items():
        counts = " | ".join(str(int(np.sum(values >= bar))) for bar in (3.0, 5.0, 10.0))
        lines.append(f"| {way} | {np.median(values):.2f} | {counts} | {values.size} |")
    lines += ["", "| effect | " + " | ".join(found) + " |", "|---|" + "---|" * len(found)]
    for i in np.argsort(-found["tied"]):
        row = " | ".join(f"{values[i]:.3g}" for values in found.values())
        lines.append(f"| `{names[i]}` | {row} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("-o", "--output", type=Path)
    text = table(*strengths())
    output = parser.parse_args().output
    print(text)
    if output is not None:
        output.write_text(text, encoding="utf-8")
