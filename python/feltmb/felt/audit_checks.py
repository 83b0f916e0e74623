"""Checks of an audit: curves of a loop, and power and cycles of a law."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from feltmb import _core
from feltmb.fiber.material import FeltMaterial
from feltmb.mechanism import LawChoice
from unmodeled.errors import InvalidParameter

Array = NDArray[np.float64]

_STEPS = 1000  # steps of half a cycle of a law with states
_SAMPLES = 4000  # steps of half a cycle of a law without states
_SCAN = 4001


@dataclass(frozen=True)
class Finding:
    """One fault, with its range of compression."""

    kind: str
    """``crossing``, ``adhesion``, ``softening``, ``open``, ``shape`` (faults of the data),
    ``energy``, ``pull`` (faults of the law), ``material``."""
    low: float
    """Start of the range of compression [m]."""
    high: float
    """End of the range of compression [m]."""
    value: float
    """Magnitude of the fault, in ``unit``."""
    unit: str
    text: str


@dataclass(frozen=True)
class Cycle:
    """Two sinusoidal cycles from 0 to an amplitude and back, starting from virgin felt."""

    amplitude: float
    """Amplitude of the compression [m]."""
    frequency: float
    """Frequency of the cycles [Hz]."""
    work: float
    """Work supplied in the second compression [J]."""
    lost: float
    """Energy lost in the second cycle [J]; negative: the law produces energy."""
    first_lost: float
    """Energy lost in the first cycle [J]."""
    first_work: float
    """Work supplied in the first compression [J]."""

    @property
    def loss(self) -> float:
        """Ratio of lost energy to supplied work, second cycle [-]."""
        return self.lost / self.work if self.work != 0 else 0.0

    @property
    def first_loss(self) -> float:
        """Ratio of lost energy to supplied work, first cycle [-]."""
        return self.first_lost / self.first_work if self.first_work != 0 else 0.0


def _stretches(bad: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and last index of every sequence of True values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], bad, [False]]).astype(int)))
    return [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _edge(f: Callable[[float], float], a: float, b: float) -> float:
    """Zero of f between neighboring samples with different signs."""
    from scipy.optimize import brentq

    fa, fb = f(a), f(b)
    if fa == 0.0 or fa * fb > 0:
        return a
    return b if fb == 0.0 else float(brentq(f, a, b, xtol=1e-12))


@dataclass(frozen=True)
class _Curves:
    """Both curves of a pair as functions of compression."""

    loading: Callable[[Array], Array]
    unloading: Callable[[Array], Array]
    closing: float | None
    reach: float
    pair: bool = True


def _below(
    f: Callable[[Array], Array], e: Array, scale: float
) -> list[tuple[float, float, float, float]]:
    """Intervals with f < 0: start, end, minimum, integral of -f. Rounding is not a fault."""
    values = f(e)
    out = []
    for first, last in _stretches(values < -1e-9 * scale):

        def at(x: float) -> float:
            return float(f(np.array([x]))[0])

        while first > 0 and values[first - 1] <= 0.0:
            first -= 1
        low = e[first] if first == 0 else _edge(at, float(e[first - 1]), float(e[first]))
        high = e[last] if last == len(e) - 1 else _edge(at, float(e[last]), float(e[last + 1]))
        x = np.linspace(low, high, 2001)
        y = f(x)
        # Only the minimum matters; the ends are zeros of f or the ends of the range.
        out.append((float(low), float(high), float(y.min()), -float(_integral(y, x))))
    return out


def _integral(y: Array, x: Array) -> float:
    return float(np.sum(0.5 * (y[1:] + y[:-1]) * np.diff(x)))


def _mm(x: float) -> str:
    return f"{x * 1e3:.4g} mm"


def audit_curves(curves: _Curves) -> list[Finding]:
    """Faults of the curves: crossing, adhesion, softening, open end."""
    out = []
    end = curves.closing if curves.closing is not None else curves.reach
    # More points near zero, where fits often fail.
    e = end * np.linspace(0.0, 1.0, _SCAN) ** 2
    scale = float(np.max(np.abs(curves.loading(e))))
    if curves.closing is None and curves.pair:
        gap = float((curves.loading(e[-1:]) - curves.unloading(e[-1:]))[0])
        out.append(
            Finding(
                "open", end, end, gap, "N",
                f"unloading does not meet loading up to {_mm(end)}: {gap:.4g} N apart there",
            )
        )  # fmt: skip

    def band(x: Array) -> Array:
        return curves.loading(x) - curves.unloading(x)

    for low, high, least, made in _below(band, e, scale):
        # The last sample is the point where the branches meet.
        if curves.closing is not None and low > 0.999 * end:
            continue
        out.append(
            Finding(
                "crossing", low, high, made, "J",
                f"unloading lies above loading from {_mm(low)} to {_mm(high)}, by up to "
                f"{-least:.4g} N: a fast cycle gains {made * 1e6:.4g} uJ there",
            )
        )  # fmt: skip
    for branch, curve in (("loading", curves.loading), ("unloading", curves.unloading)):
        for low, high, least, _ in _below(curve, e, scale):
            out.append(
                Finding(
                    "adhesion", low, high, least, "N",
                    f"{branch} force is negative from {_mm(low)} to {_mm(high)}, down to "
                    f"{least * 1e3:.4g} mN",
                )
            )  # fmt: skip

        def slope(x: Array, curve: Callable[[Array], Array] = curve) -> Array:
            h = 1e-6 * end
            low = np.maximum(x - h, 0.0)
            return (curve(x + h) - curve(low)) / (x + h - low)

        inner = e[e <= end * (1 - 2e-6)]
        for low, high, least, _ in _below(slope, inner, scale / end):
            out.append(
                Finding(
                    "softening", low, high, least, "N/m",
                    f"{branch} force falls with compression from {_mm(low)} to {_mm(high)}, "
                    f"slope down to {least:.4g} N/m",
                )
            )  # fmt: skip
    return out


def valid_window(curves: _Curves, findings: Sequence[Finding]) -> tuple[float, float] | None:
    """Longest range of the loop without a fault of the data."""
    end = curves.closing if curves.closing is not None else curves.reach
    bad = sorted(
        (f.low, f.high) for f in findings if f.kind in ("crossing", "adhesion", "softening")
    )
    best: tuple[float, float] | None = None
    start = 0.0
    for low, high in [*bad, (end, end)]:
        if low > start and (best is None or low - start > best[1] - best[0]):
            best = (start, low)
        start = max(start, high)
    return best


def audit_power(law: _core.ContactLaw, end: float, reach: float) -> list[Finding]:
    """Attraction and energy production of a law without states, at all compressions and rates."""
    e = np.concatenate([end * np.linspace(0.0, 1.0, 321)[1:] ** 2, np.linspace(end, reach, 81)[1:]])
    speed = 10.0 ** np.linspace(-5, 1, 25)
    rates = np.concatenate([-speed[::-1], [0.0], speed])
    force = np.empty((len(e), len(rates)))
    heat = np.empty_like(force)
    for i, x in enumerate(e):
        for j, rate in enumerate(rates):
            point = law.evaluate(float(x), float(rate), [], 0.0)
            force[i, j] = point["force"]
            heat[i, j] = point["dissipated_power"]
    out = []
    scale = float(np.max(np.abs(force[e <= end])))
    # Power divided by speed is the force error of the law.
    wrong = np.min(np.where(rates == 0, 0.0, heat / np.where(rates == 0, 1.0, np.abs(rates))), 1)
    for first, last in _stretches(wrong < -1e-9 * scale):
        low, high = float(e[first - 1]) if first else 0.0, float(e[last])
        where = "beyond the end of the loop, " if low >= end else ""
        size = float(wrong[first : last + 1].min())
        out.append(
            Finding(
                "energy", low, high, size, "N",
                f"{where}between {_mm(low)} and {_mm(high)} energy is made: the force of unloading "
                f"exceeds that of loading by up to {-size:.4g} N",
            )
        )  # fmt: skip
    least = force.min(axis=1)
    for first, last in _stretches(least < -1e-9 * scale):
        low, high = float(e[first - 1]) if first else 0.0, float(e[last])
        size = float(least[first : last + 1].min())
        where = "beyond the end of the loop, " if low >= end else ""
        out.append(
            Finding(
                "pull", low, high, size, "N",
                f"{where}between {_mm(low)} and {_mm(high)} the law pulls, by up to "
                f"{-size * 1e3:.4g} mN",
            )
        )  # fmt: skip
    return out


def _run_states(
    law: _core.ContactLaw, amplitude: float, frequency: float, cycles: int
) -> tuple[list[tuple[float, float]], float]:
    """Work and net loss of every cycle, and the smallest force, of a law with states."""
    samples = 2 * _STEPS
    turn = np.arange(cycles * samples + 1)
    e = 0.5 * amplitude * (1.0 - np.cos(2.0 * math.pi * turn / samples))
    e[::samples] = 0.0
    force = np.asarray(
        _core.force_along(law, (turn / (samples * frequency)).tolist(), e.tolist()), dtype=float
    )
    work = 0.5 * (force[1:] + force[:-1]) * np.diff(e)
    out = []
    for one in work.reshape(cycles, samples):
        out.append((float(one[:_STEPS].sum()), float(one.sum())))
    return out, float(force.min())


def _cycle(law: _core.ContactLaw, amplitude: float, frequency: float) -> tuple[Cycle, float]:
    if law.n_states == 0 and not law.has_memory:
        phase = math.pi * (np.arange(_SAMPLES) + 0.5) / _SAMPLES
        e = 0.5 * amplitude * (1.0 - np.cos(phase))
        rate = math.pi * amplitude * frequency * np.sin(phase)
        span = 0.5 * amplitude * np.sin(phase) * math.pi / _SAMPLES
        up, down = law.force(e, rate), law.force(e, -rate)
        into = float(np.sum(up * span))
        lost = into - float(np.sum(down * span))
        return (
            Cycle(amplitude, frequency, into, lost, lost, into),
            float(min(up.min(), down.min())),
        )
    (first, second), least = _run_states(law, amplitude, frequency, 2)
    return Cycle(amplitude, frequency, second[0], second[1], first[1], first[0]), least


def audit_cycles(
    law: _core.ContactLaw, end: float, amplitudes: Sequence[float], frequencies: Sequence[float]
) -> tuple[list[Cycle], list[Finding]]:
    """Loss of the second cycle at each amplitude and frequency; cycles that produce energy."""
    cycles, findings = [], []
    for share in amplitudes:
        for frequency in frequencies:
            cycle, least = _cycle(law, share * end, frequency)
            cycles.append(cycle)
            worst = min(cycle.lost, cycle.first_lost)
            if worst < -1e-9 * abs(cycle.first_work):
                findings.append(
                    Finding(
                        "energy", 0.0, share * end, worst, "J",
                        f"a cycle to {_mm(share * end)} at {frequency:g} Hz gains "
                        f"{-worst * 1e6:.4g} uJ",
                    )
                )  # fmt: skip
            if law.n_states and least < -1e-9 * abs(cycle.first_work) / end:
                findings.append(
                    Finding(
                        "pull", 0.0, share * end, least, "N",
                        f"in a cycle to {_mm(share * end)} at {frequency:g} Hz the law pulls by up "
                        f"to {-least * 1e3:.4g} mN",
                    )
                )  # fmt: skip
    return cycles, findings


def pair_curves(contact: LawChoice, reach: float) -> _Curves:
    """Loading and unloading of a pair of curves, up to the point where they meet."""
    assert contact.loading is not None
    assert contact.unloading is not None
    loading = _core.ExponentialCurve(contact.loading.a, contact.loading.b, contact.loading.c)
    unloading = _core.ExponentialCurve(
        contact.unloading.a, contact.unloading.b, contact.unloading.c
    )
    closing: float | None
    try:
        closing = _core.Envelope.from_curves(loading, unloading).closing
    except InvalidParameter:
        closing = None

    def up(e: Array) -> Array:
        return np.asarray(loading.force(e), dtype=float)

    def down(e: Array) -> Array:
        return np.asarray(unloading.force(e), dtype=float)

    return _Curves(up, down, closing, contact.memory.closing_compression or reach)


def envelope_curves(core: _core.Envelope) -> _Curves:
    """Both branches of the complete loop of an envelope."""

    def up(e: Array) -> Array:
        return np.asarray(core.loading(e), dtype=float)

    def down(e: Array) -> Array:
        return np.asarray(core.unloading(e, core.closing), dtype=float)

    return _Curves(up, down, core.closing, core.closing)


def shape_findings(core: _core.Envelope) -> list[Finding]:
    """Ranges in which the share of unloading decreases, before the law with memory corrects it."""
    force, low, high = core.repair
    top = float(core.loading(core.closing))
    if force <= 1e-4 * top:
        return []
    return [
        Finding(
            "shape", low, high, force, "N",
            f"the share of unloading falls with compression between {_mm(low)} and {_mm(high)}: a "
            f"deeper cycle would unload along a higher force; the law with memory changes the "
            f"unloading by up to {force:.4g} N, {100 * force / top:.2g} % of the largest force",
        )
    ]  # fmt: skip


def law_curves(law: _core.ContactLaw, reach: float) -> _Curves:
    """Curves of a law without a pair: its static curve is both branches."""

    def force(e: Array) -> Array:
        h = 1e-6 * reach
        energy = [np.asarray(law.stored_energy(np.maximum(x, 0.0))) for x in (e + h, e - h)]
        return np.asarray((energy[0] - energy[1]) / (e + h - np.maximum(e - h, 0.0)))

    return _Curves(force, force, None, reach, pair=False)


def material_findings(material: FeltMaterial) -> list[Finding]:
    """Warnings about a felt: inverted branches, residual strain, end of the loop."""
    from feltmb._core import fiber

    out = []
    ratio = np.linspace(1.0, material.end / material.v_f0, 101)
    unique = np.asarray(fiber.unloading_is_unique(ratio, material.fiber.friction), dtype=bool)
    if not unique.all():
        top = float(ratio[~unique].max() * material.v_f0)
        out.append(
            Finding(
                "material", 0.0, 0.0, top, "1",
                f"friction {material.fiber.friction:g}: up to v_f = {top:.4g} an unloading "
                "pressure belongs to several contact forces",
            )
        )  # fmt: skip
    end = [material.end]
    load = float(material.pressure("loading", end)[0])
    gap = float(material.pressure("unloading", end)[0]) / load - 1.0
    if abs(gap) > 0.02:
        out.append(
            Finding(
                "material", 0.0, 0.0, gap, "1",
                f"unloading ends {100 * gap:+.2f} % from loading at v_f = {material.end:.4g}",
            )
        )  # fmt: skip
    return out
