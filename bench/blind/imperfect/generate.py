"""Records of the imperfect machines: integration, magnitudes of causes, cache.

All cases of a machine are integrated together with classical Runge-Kutta steps, several to a
sample. Nothing of feltmb takes part.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Values = Mapping[str, Any]

__all__ = ["ROWS", "SEED", "Cause", "Made", "Row", "Table", "load", "make"]

SEED = 20261128
#: Noise of a sensor as a share of the motion of its channel.
NOISE = 1e-3
#: Discrepancies of the controls and of the cases with an effect, as a share of the motion.
SHARES = (0.0, 0.003, 0.01, 0.03)
RATIOS = (3.0, 10.0)


@dataclass(frozen=True)
class Row:
    """Design of a case, the same for each machine."""

    share: float
    """Motion that the discrepancy causes, as a share of the motion."""
    ratio: float
    """What the effect causes, in units of the discrepancy (of the noise where it is zero), each
    beside the parameters; 0: a control."""
    cause: int
    """Index of the effect in the table of the machine, modulo its length."""


#: Four controls, six cases with an effect, and two with an effect and no discrepancy.
ROWS = (
    *(Row(s, 0.0, 0) for s in SHARES),
    *(Row(s, r, i + j) for i, s in enumerate(SHARES[1:]) for j, r in enumerate(RATIOS)),
    *(Row(0.0, r, j) for j, r in enumerate(RATIOS)),
)


@dataclass(frozen=True)
class Cause:
    """An effect of a machine that its stated model lacks."""

    name: str
    size: float
    """Magnitude with which the search for the wanted size begins."""
    right: tuple[str, ...]
    """Names that are right: the true effect, and others that are the same in these records."""
    near: tuple[str, ...] = ()
    """Look-alikes: in a class with a right one, or beside it, they are no error; alone they count
    as the class."""
    literal: Mapping[str, float] = field(default_factory=dict)
    """Candidate of the same law for large motions -> its magnitude per unit of this one's."""


@dataclass(frozen=True)
class Table:
    """One machine: its laws, its stated parameters, its causes."""

    name: str
    rates: Callable[[Any, Values, Values, Values, Any], None]
    """``rates(x (nx, B), u, p, e, out (nx, B))`` writes the rates."""
    states: tuple[str, ...]
    """Own states, then hidden states of the laws."""
    outputs: Mapping[str, Callable[[Any, Values, Values, Values], Any]]
    """Output -> function of states (nx, n, B), inputs (n, B), parameters and causes."""
    parameters: Mapping[str, tuple[float, float]]
    """Parameter -> tabulated value and standard deviation; the true one is drawn from this."""
    drive: Callable[[np.random.Generator, Array, int], Mapping[str, Array]]
    """Inputs of record k at the samples."""
    foreign: float
    """First magnitude of the discrepancy."""
    causes: tuple[Cause, ...]
    units: Mapping[str, str]
    """Unit of each output and input."""
    step: float
    """Interval of samples [s]."""
    samples: int
    substeps: int = 6
    records: int = 4
    held_out: int = 1
    """How many of the records, the last ones, are held out."""
    start: Mapping[str, float] = field(default_factory=dict)
    hold: str = "linear"
    varied: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Constants of the discrepancy that differ from case to case: lower and upper end."""
    late: Mapping[str, str] = field(default_factory=dict)
    """Cause -> input that comes late by its magnitude [s]."""
    slow: Mapping[str, str] = field(default_factory=dict)
    """Cause -> input or output that passes two lags, each of half its magnitude [s]."""


@dataclass(frozen=True)
class Made:
    """A case: what was measured, and the truth."""

    machine: str
    row: Row
    records: Sequence[Mapping[str, Array]]
    noise: Mapping[str, float]
    parameters: Mapping[str, float]
    cause: Cause | None
    size: float
    foreign: Mapping[str, float]
    reached: Mapping[str, float]
    """Shares of the motion: ``foreign``, ``foreign_left`` and ``effect_left`` beside the
    parameters."""


def lagged(time: Array, values: Array, constant: Array) -> Array:
    """Two lags in series, exact for straight lines between the points; (n, B)."""
    for _ in range(2):
        tau = np.maximum(0.5 * constant, 1e-12)
        h = time[1] - time[0]
        keep = np.exp(-h / tau)
        mean = tau / h * (1.0 - keep)  # of the straight line
        out = values.copy()
        for i in range(1, len(values)):
            out[i] = keep * out[i - 1] + (mean - keep) * values[i - 1] + (1.0 - mean) * values[i]
        values = out
    return values


def _inputs(table: Table, time: Array, given: Values, e: Values) -> dict[str, Array]:
    """Inputs at all half steps, (2 S (n - 1) + 1, B), as they act on the machine."""
    per = 2 * table.substeps
    fine = np.linspace(time[0], time[-1], per * (time.size - 1) + 1)
    out = {}
    for name, values in given.items():
        late = [e[c] for c, n in table.late.items() if n == name]
        columns = []
        for b in range(values.shape[1]):
            at = fine - (late[0][b] if late else 0.0)
            if table.hold == "zero":
                index = np.floor((at - time[0]) / table.step + 1e-9).astype(int)
                columns.append(values[np.clip(index, 0, time.size - 1), b])
            else:
                columns.append(np.interp(at, time, values[:, b]))
        signal = np.stack(columns, 1)
        for c, n in table.slow.items():
            if n == name and np.any(e[c] > 0.0):
                signal = lagged(fine, signal, e[c])
        out[name] = signal
    return out


def simulate(table: Table, given: Values, p: Values, e: Values) -> dict[str, Array]:
    """Outputs of all columns, each (n, B)."""
    n, count, per = table.samples, next(iter(p.values())).size, 2 * table.substeps
    time = table.step * np.arange(n, dtype=np.float64)
    fine = _inputs(table, time, given, e)
    x = np.zeros((len(table.states), count))
    for name, value in table.start.items():
        x[table.states.index(name)] = value
    out = np.empty((len(table.states), n, count))
    k = np.empty((4, *x.shape))
    h = table.step / table.substeps
    out[:, 0] = x
    zero = table.hold == "zero"
    with np.errstate(all="ignore"):
        for j in range(n - 1):
            for s in range(table.substeps):
                at = j * per + 2 * s
                u = [{m: v[at + i] for m, v in fine.items()} for i in range(3)]
                # The value at the end of a step is that of the next interval for a held input.
                if zero:
                    u[2] = u[1]
                table.rates(x, u[0], p, e, k[0])
                table.rates(x + 0.5 * h * k[0], u[1], p, e, k[1])
                table.rates(x + 0.5 * h * k[1], u[1], p, e, k[2])
                table.rates(x + h * k[2], u[2], p, e, k[3])
                x = x + h / 6.0 * (k[0] + 2.0 * (k[1] + k[2]) + k[3])
            out[:, j + 1] = x
    seen = {m: v[::per] for m, v in fine.items()}
    told = {}
    for name, of in table.outputs.items():
        y = np.array(of(out, seen, p, e))
        for c, channel in table.slow.items():
            if channel == name and np.any(e[c] > 0.0):
                finite = np.all(np.isfinite(y), axis=0)
                y[:, finite] = _lagged_between(time, y[:, finite], e[c][finite])
        told[name] = y
    return told


def _lagged_between(time: Array, y: Array, constant: Array) -> Array:
    """Lag of a channel at eight points a sample, exact between the samples too."""
    from scipy.interpolate import CubicSpline  # slow to import

    fine = np.linspace(time[0], time[-1], 8 * (time.size - 1) + 1)
    return lagged(fine, np.asarray(CubicSpline(time, y)(fine)), constant)[::8]


@dataclass(frozen=True)
class _Drawn:
    """Everything random of the cases of a machine; a column is a record of a case."""

    given: dict[str, Array]
    p: dict[str, Array]
    plain: dict[str, Array]
    """Causes and discrepancy of zero, with its constants."""
    count: int


def _draw(table: Table, index: int, rows: Sequence[int], seed: int) -> _Drawn:
    time: Array = table.step * np.arange(table.samples, dtype=np.float64)
    given: dict[str, list[Array]] = {}
    p: dict[str, list[float]] = {n: [] for n in table.parameters}
    varied: dict[str, list[float]] = {n: [] for n in table.varied}
    for row in rows:
        rng = np.random.default_rng([seed, index, row])
        own = {
            n: v + sd * float(np.clip(rng.standard_normal(), -2.0, 2.0))
            for n, (v, sd) in table.parameters.items()
        }
        constants = {n: float(rng.uniform(*ends)) for n, ends in table.varied.items()}
        for k in range(table.records):
            for n, values in table.drive(rng, time, k).items():
                given.setdefault(n, []).append(values)
            for n in p:
                p[n].append(own[n])
            for n in varied:
                varied[n].append(constants[n])
    count = len(rows) * table.records
    plain = {c.name: np.zeros(count) for c in table.causes} | {"foreign": np.zeros(count)}
    plain |= {n: np.array(v) for n, v in varied.items()}
    return _Drawn(
        {n: np.stack(v, 1) for n, v in given.items()},
        {n: np.array(v) for n, v in p.items()},
        plain,
        count,
    )


def _by_case(table: Table, outputs: Values, case: int) -> list[Array]:
    """Outputs of the fit records of a case by channel, each (records * n,)."""
    first = case * table.records
    fit = slice(first, first + table.records - table.held_out)
    return [outputs[c][:, fit].T.ravel() for c in table.outputs]


def make(
    table: Table, index: int, rows: Sequence[int] | None = None, seed: int = SEED
) -> list[Made]:
    """Simulate cases of a machine, with causes of the wanted sizes.

    Parameters
    ----------
    table
        The machine.
    index
        Its number, a part of the seeds.
    rows
        Which of :data:`ROWS`; default all.
    seed
        Of inputs, parameters and noise.
    """
    rows = list(range(len(ROWS))) if rows is None else list(rows)
    d = _draw(table, index, rows, seed)
    names = list(table.parameters)
    # The plain machine, and with each parameter moved: what the parameters can take up.
    moved = [d.p] + [d.p | {n: d.p[n] + 0.2 * table.parameters[n][1]} for n in names]
    times = len(moved)
    runs = simulate(
        table,
        {n: np.tile(v, (1, times)) for n, v in d.given.items()},
        {n: np.concatenate([m[n] for m in moved]) for n in names},
        {n: np.tile(v, times) for n, v in d.plain.items()},
    )
    split = [
        {c: v[:, i * d.count : (i + 1) * d.count] for c, v in runs.items()} for i in range(times)
    ]
    plain = split[0]
    base = [_by_case(table, plain, k) for k in range(len(rows))]
    motion = [[float(np.std(v)) for v in channels] for channels in base]
    columns = [
        np.stack(
            [
                np.concatenate(
                    [
                        (a - b) / 0.2 / (NOISE * size)
                        for a, b, size in zip(
                            _by_case(table, run, k), base[k], motion[k], strict=True
                        )
                    ]
                )
                for run in split[1:]
            ],
            1,
        )
        for k in range(len(rows))
    ]

    def shares(outputs: Values, case: int) -> tuple[float, float]:
        """Largest share of the motion of a channel, as it is and beside the parameters."""
        change = [
            (a - b) / (NOISE * size)
            for a, b, size in zip(
                _by_case(table, outputs, case), base[case], motion[case], strict=True
            )
        ]
        if not all(np.all(np.isfinite(v)) for v in change):
            return np.inf, np.inf
        flat, J = np.concatenate(change), columns[case]
        left = flat - J @ np.linalg.solve(J.T @ J + np.eye(J.shape[1]), J.T @ flat)
        parts = np.split(left, len(change))
        return (
            NOISE * max(float(np.sqrt(np.mean(v**2))) for v in change),
            NOISE * max(float(np.sqrt(np.mean(v**2))) for v in parts),
        )

    def sized(
        which: Sequence[str],
        first: Array,
        wanted: Array,
        part: int,
        rounds: int,
    ) -> tuple[Array, Array]:
        """Magnitudes of ``which`` (by case) that make the wanted shares; they, and the shares."""
        size, best, reached = first.copy(), np.zeros_like(first), np.zeros((len(rows), 2))
        old: list[tuple[float, float] | None] = [None] * len(rows)
        if not np.any(wanted):
            return best, reached
        for _ in range(rounds):
            now = dict(d.plain)
            for name in {*which}:
                own = np.array([s if w == name else 0.0 for s, w in zip(size, which, strict=True)])
                now[name] = np.repeat(own, table.records)
            run = simulate(table, d.given, d.p, now)
            for k in range(len(rows)):
                if wanted[k] == 0.0:
                    size[k] = 0.0
                    continue
                got = shares(run, k)
                if abs(np.log(max(got[part], 1e-12) / wanted[k])) < abs(
                    np.log(max(reached[k][part], 1e-12) / wanted[k])
                ):
                    best[k], reached[k] = size[k], got
                if not np.isfinite(got[part]):
                    size[k] *= 0.3
                    continue
                slope = 1.0
                before = old[k]
                if before is not None and before[0] != size[k] and got[part] > 0.0:
                    slope = np.log(got[part] / before[1]) / np.log(size[k] / before[0])
                    slope = float(np.clip(slope, 0.3, 4.0))
                old[k] = (float(size[k]), max(got[part], 1e-12))
                size[k] *= np.clip((wanted[k] / max(got[part], 1e-12)) ** (1.0 / slope), 0.1, 10.0)
        return best, reached

    design = [ROWS[r] for r in rows]
    alien, told = sized(
        ["foreign"] * len(rows), np.full(len(rows), table.foreign),
        np.array([r.share for r in design]), 0, 5,
    )  # fmt: skip
    chosen = [table.causes[r.cause % len(table.causes)] for r in design]
    wanted = np.array([r.ratio * (told[k][1] or NOISE) for k, r in enumerate(design)])
    size, got = sized([c.name for c in chosen], np.array([c.size for c in chosen]), wanted, 1, 9)
    e = dict(d.plain)
    e["foreign"] = np.repeat(alien, table.records)
    for name in {c.name for c in chosen}:
        own = np.array([s if c.name == name else 0.0 for s, c in zip(size, chosen, strict=True)])
        e[name] = np.repeat(own, table.records)
    final = simulate(table, d.given, d.p, e)
    time: Array = table.step * np.arange(table.samples, dtype=np.float64)
    made = []
    for k, (row, design_row) in enumerate(zip(rows, design, strict=True)):
        rng = np.random.default_rng([seed, index, row, 1])
        noise = {
            c: float(f"{NOISE * m:.2g}") for c, m in zip(table.outputs, motion[k], strict=True)
        }
        records = []
        for i in range(table.records):
            b = k * table.records + i
            record = {"time": time} | {n: v[:, b] for n, v in d.given.items()}
            for c in table.outputs:
                record[c] = final[c][:, b] + noise[c] * rng.standard_normal(time.size)
            records.append(record)
        first = k * table.records
        made.append(
            Made(
                machine=table.name,
                row=design_row,
                records=records,
                noise=noise,
                parameters={n: float(d.p[n][first]) for n in names},
                cause=chosen[k] if design_row.ratio else None,
                size=float(size[k]),
                foreign={"foreign": float(alien[k])}
                | {n: float(d.plain[n][first]) for n in table.varied},
                reached={
                    "foreign": float(told[k][0]),
                    "foreign_left": float(told[k][1]),
                    "effect_left": float(got[k][1]),
                    "wanted": float(wanted[k]),
                },
            )
        )
    return made


def save(path: Path, made: Sequence[Made]) -> None:
    """Write the cases of a machine to one file."""
    arrays: dict[str, Any] = {}
    plain = []
    for k, m in enumerate(made):
        for i, record in enumerate(m.records):
            arrays |= {f"{k}/{i}/{n}": v for n, v in record.items()}
        plain.append(
            {
                "noise": m.noise,
                "parameters": m.parameters,
                "size": m.size,
                "foreign": m.foreign,
                "reached": m.reached,
            }
        )
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".part.npz")
    np.savez_compressed(partial, plain=np.array(json.dumps(plain)), **arrays)
    partial.replace(path)


def load(table: Table, index: int, folder: Path, seed: int = SEED) -> list[Made]:
    """Cases of a machine from the cache, which is filled if it has none."""
    path = folder / f"{table.name}.npz"
    if not path.exists():
        save(path, make(table, index, seed=seed))
    with np.load(path) as file:
        plain = json.loads(str(file["plain"]))
        names = [n.split("/") for n in file.files if n != "plain"]
        records: list[list[dict[str, Array]]] = [
            [{} for _ in range(table.records)] for _ in range(len(plain))
        ]
        for k, i, n in names:
            records[int(k)][int(i)][n] = file[f"{k}/{i}/{n}"]
    return [
        Made(
            machine=table.name,
            row=ROWS[k],
            records=records[k],
            cause=table.causes[ROWS[k].cause % len(table.causes)] if ROWS[k].ratio else None,
            **own,
        )
        for k, own in enumerate(plain)
    ]
