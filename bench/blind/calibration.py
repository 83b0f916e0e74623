"""Noncentrality of a withheld effect: its signal-to-noise ratio.

Definition. With drawing values and plain strokes, let r(phi) be the records minus the model,
started in every 30 ms segment from the true state there. Then

    noncentrality(phi)^2 = d' (V^-1 - V^-1 S (S' V^-1 S + P^-1)^-1 S' V^-1) d,   d = r(phi) - r(0)

over the segments of the three fit strokes: V is the covariance of camera noise and of the input's
noise carried through the model, S the model's sensitivities to its parameters (prior P) and
to the free start state of every segment. It is what is left to see of the effect when all that the
model may adjust has been adjusted. Secant at a noncentrality of about 10 gives the number per
unit of magnitude that magnitudes are drawn with.

    PYTHONPATH=bench python -m blind.calibration     writes scales.json; no seed
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from blind import truth, truth_machine, truth_sensors
from blind.key_hammer import SAMPLE_TIME, KeyHammer
from feltmb.data import Record
from feltmb.fit import Jobs, SensitivityRequest

__all__ = ["WINDOW", "calibrate", "packaged_scales"]

Array = NDArray[np.float64]
Scales = dict[str, dict[str, float]]

WINDOW = 60  # samples
AIM = 10.0


def packaged_scales() -> Scales:
    """Noncentrality per unit of magnitude, {mode: {"effect:form": number}}, computed beforehand."""
    text = (Path(__file__).parent / "scales.json").read_text(encoding="utf-8")
    scales: Scales = json.loads(text)
    return scales


class _Whitener:
    """Projection of the model at the tabulated values, by stroke, for one input mode."""

    def __init__(self, records: list[Record], starts: list[Array]):
        self.model = KeyHammer()
        self.theta = np.array([p.value for p in self.model.parameters])
        prior = np.array([p.sd for p in self.model.parameters])
        self.segments = _segments(records[0].samples)
        self.inverse: list[list[Array]] = []
        self.theta_part: list[list[Array]] = []
        total = np.diag(prior**-2.0)
        for record, start in zip(records, starts, strict=True):
            request = SensitivityRequest(record, self.theta, self.segments, start)
            s = self.model.sensitivities([request])[0]
            inverses, parts = [], []
            for w in range(len(self.segments)):
                n = self.segments[w, 1] - self.segments[w, 0]
                carried = self._input_noise(record, w, start[w])
                inverse = np.linalg.inv(_camera_covariance(n) + carried)
                # The start state of the segment is free and is projected out here.
                x = s.d_starts[w, :n].transpose(1, 0, 2).reshape(2 * n, -1)
                x = x / np.linalg.norm(x, axis=0)
                vx = inverse @ x
                inverse = inverse - vx @ np.linalg.solve(x.T @ vx, vx.T)
                t = s.d_theta[w, :n].transpose(1, 0, 2).reshape(2 * n, -1)
                total += t.T @ inverse @ t
                inverses.append(inverse)
                parts.append(t)
            self.inverse.append(inverses)
            self.theta_part.append(parts)
        self.total = total

    def _input_noise(self, record: Record, w: int, start: Array) -> Array:
        """Covariance of a segment's outputs by the noise of the recorded input."""
        first, last = self.segments[w]
        n = int(last - first)
        mode = record.input_mode
        step = 10.0 * truth_sensors.NOISE_INPUT[mode]
        network = self.model._network(record)
        u = record.inputs["finger"]
        places = range(max(first - 2, 0), min(last + 2, u.size))
        inputs = [u]
        for k in places:
            bumped = u.copy()
            bumped[k] += step
            inputs.append(bumped)
        segments = np.array([[i, first, n - 1, 0] for i in range(len(inputs))], dtype=np.intc)
        full = np.zeros((len(inputs), len(network.states)))
        full[:, :4] = start
        row = np.zeros((1, len(network.parameters)))
        row[0, : self.theta.size] = self.theta
        y = network.simulate(row, inputs, segments, full)[0].reshape(len(inputs), n, 2)
        slope = (y[1:] - y[0]).transpose(2, 1, 0).reshape(2 * n, -1) / step
        noise = np.zeros((len(inputs) - 1,) * 2)
        for lag, value in enumerate((0.375, 0.25, 0.0625)):  # of a white noise through 1/4 1/2 1/4
            both = np.eye(noise.shape[0], k=lag)
            noise += value * (both if lag == 0 else both + both.T)
        quantum = truth_sensors.RANGE_INPUT[mode] / 4096.0
        noise = (
            noise * truth_sensors.NOISE_INPUT[mode] ** 2
            + np.eye(noise.shape[0]) * quantum**2 / 12.0
        )
        return np.asarray(slope @ noise @ slope.T, dtype=np.float64)

    def residual(self, record: Record, start: Array) -> list[Array]:
        """Record minus model, where each segment starts in the true state."""
        jobs = Jobs(
            theta=np.tile(self.theta, (len(self.segments), 1)),
            segments=self.segments,
            starts=start,
            magnitudes=np.zeros((len(self.segments), 0)),
        )
        y = self.model.simulate(record, jobs).outputs
        seen = record.output_array(self.model.outputs)
        return [(seen[a:b] - y[w, : b - a]).T.ravel() for w, (a, b) in enumerate(self.segments)]

    def noncentrality(self, differences: list[list[Array]]) -> float:
        square = 0.0
        pull: Array = np.zeros(self.theta.size)
        for inverses, parts, ds in zip(self.inverse, self.theta_part, differences, strict=True):
            for inverse, t, d in zip(inverses, parts, ds, strict=True):
                vd = inverse @ d
                square += float(d @ vd)
                pull += t.T @ vd
        adjusted = float(pull @ np.linalg.solve(self.total, pull))
        return math.sqrt(max(square - adjusted, 0.0))


def _segments(samples: int) -> NDArray[np.intp]:
    edges = [*range(0, samples - 1 - WINDOW // 2, WINDOW), samples - 1]
    return np.column_stack([edges[:-1], edges[1:]]).astype(np.intp)


def _camera_covariance(n: int) -> Array:
    one = np.eye(n) * (truth_sensors.NOISE_CAMERA**2 + truth_sensors.PIXEL**2 / 12.0)
    for lag in (1, 2):  # mean of three white frames
        both = np.eye(n, k=lag) + np.eye(n, k=-lag)
        one += both * (1.0 - lag / 3.0) * truth_sensors.NOISE_CAMERA**2
    return np.asarray(np.kron(np.eye(2), one), dtype=np.float64)


def _view(
    case: truth.Case, result: truth_machine.Strokes, first: int, kinds: Mapping[str, Any]
) -> tuple[list[Record], list[Array]]:
    """Ideal records of the fitted strokes, and the true states at the segment starts."""
    views = truth_sensors.record(case, truth.FIT, result, first, kinds, ideal=True)
    records, starts = [], []
    per_frame = round(truth.FRAME / truth.STEP) // truth.KEEP
    for k, stroke in enumerate(truth.FIT):
        v = views[stroke]
        record = Record(
            name=stroke,
            time=np.asarray(np.arange(v["key"].size) * SAMPLE_TIME, dtype=np.float64),
            inputs={"finger": v["finger"]},
            outputs={"key": v["key"], "hammer": v["hammer"]},
            input_mode="force" if case.mode == "force" else "motion",
        )
        at = _segments(record.samples)[:, 0] * per_frame
        job = first + k
        columns = (result.key, result.hammer, result.key_speed, result.hammer_speed)
        records.append(record)
        starts.append(np.column_stack([c[at, job] for c in columns]))
    return records, starts


def calibrate(
    kinds: Mapping[str, Any],
    *,
    only_outside: bool = False,
    modes: Sequence[str] = ("force", "motion"),
) -> Scales:
    """Noncentrality per unit of magnitude of every effect and form, and of kinds from outside."""
    names = [] if only_outside else [(n, f) for n in truth.EFFECTS for f in "AB"]
    names += [(n, "outside") for n in kinds]
    guess = {
        (mode, *key): (kinds[key[0]].size if key[1] == "outside" else 0.1 * truth.LARGEST[key[0]])
        for mode in modes
        for key in names
    }
    scales: Scales = {mode: {} for mode in modes}
    base = [truth.plain_case(mode) for mode in modes]
    for _ in range(3):
        cases = base + [
            truth.plain_case(mode, [truth.Part(name, form, size, 0.0)])
            for (mode, name, form), size in guess.items()
        ]
        result = truth_machine.integrate(cases, [truth.FIT] * len(cases), kinds)
        whiteners, plain = {}, {}
        for i, case in enumerate(base):
            records, starts = _view(case, result, 3 * i, kinds)
            whiteners[case.mode] = _Whitener(records, starts)
            plain[case.mode] = [
                whiteners[case.mode].residual(r, s) for r, s in zip(records, starts, strict=True)
            ]
        for i, ((mode, name, form), size) in enumerate(guess.items()):
            case = cases[len(base) + i]
            records, starts = _view(case, result, 3 * (len(base) + i), kinds)
            d = [
                [a - b for a, b in zip(whiteners[mode].residual(r, s), plain[mode][k], strict=True)]
                for k, (r, s) in enumerate(zip(records, starts, strict=True))
            ]
            found = whiteners[mode].noncentrality(d)
            if not np.isfinite(found) or found <= 0.0:
                found = 1e-12
            scales[mode][f"{name}:{form}"] = found / size
            wanted = size * AIM / found
            limit = np.inf if form == "outside" else truth.LARGEST[name]
            guess[mode, name, form] = float(min(wanted, limit, 30.0 * size))
    return scales


if __name__ == "__main__":
    from blind import truth_outside

    rounded = {
        mode: {name: float(f"{value:.6g}") for name, value in found.items()}
        for mode, found in calibrate(truth.load_outside(truth_outside)).items()
    }
    target = Path(__file__).parent / "scales.json"
    target.write_text(json.dumps(rounded, indent=1, sort_keys=True) + "\n", encoding="utf-8")
