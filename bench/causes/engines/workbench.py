"""What an engineer's script has: residuals and derivatives of a model with some of the candidates.

The simulations are those of ``unmodeled``, so that the engines differ by their decisions and not by
their integrators. Only the magnitude of a candidate is fitted, with the shape that fits best at the
first step; unknown starts of the records are fitted, too.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import signal
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from causes.cases import opened
from unmodeled import Options
from unmodeled.search.linear import (
    EvaluationRequest,
    Point,
    count_global,
    evaluate,
    local_of,
    unknowns_of,
)
from unmodeled.search.problem import Member, Members, Observed
from unmodeled.search.records import prepare, ready_records

__all__ = ["Ended", "Fitted", "Workbench"]

#: Growing parts of the records of the first fit: unknown starts have local minima.
PARTS = 0.05, 0.2, 0.5, 1.0
#: First magnitude of a candidate, in expected ones.
FIRST = 0.1


class Ended(BaseException):
    """The limit ended a search; no error, so that no function of a model takes it for its own."""


@dataclass(frozen=True)
class Fitted:
    """A fit of the model with some candidates."""

    members: Members
    values: Mapping[Any, float]
    """Unknowns in their scales: parameters, magnitudes and numbers of shapes, starts of records."""
    cost: float
    """Sum of squares of the residuals, in variances of the noise, and of the priors."""
    samples: int

    @property
    def unknowns(self) -> int:
        return len(self.values)

    @property
    def bic(self) -> float:
        """n ln(S / n) + k ln n, as lmfit has it: the size of the noise is not known."""
        n = self.samples
        return n * math.log(self.cost / n) + self.unknowns * math.log(n)

    @property
    def aicc(self) -> float:
        """n ln(S / n) + 2 k, corrected for small samples."""
        n, k = self.samples, self.unknowns
        return n * math.log(self.cost / n) + 2.0 * k + 2.0 * k * (k + 1.0) / max(n - k - 1.0, 1.0)


class Workbench:
    """A case with its residuals; ``left()`` tells the processor time until the limit [s]."""

    def __init__(self, folder: Path, seconds: float, most: int = 60) -> None:
        self._end = time.process_time() + 0.85 * seconds
        self._most = most
        self._shapes: dict[int, tuple[Fitted, dict[str, Any]]] = {}
        self.model, self.effects, self.records = opened(folder)
        self.ready = ready_records(self.model, self.records)
        self.problem = prepare(self.ready, self.effects, None, Options())

    def left(self) -> float:
        return self._end - time.process_time()

    @contextlib.contextmanager
    def limited(self) -> Iterator[None]:
        """Raise :class:`Ended` inside at the limit, wherever the program is."""

        def end(*_: Any) -> None:
            raise Ended

        signal.signal(signal.SIGPROF, end)
        signal.setitimer(signal.ITIMER_PROF, max(self.left(), 0.01))
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0.0)

    @cached_property
    def places(self) -> dict[str, int]:
        """Candidates of the case: name -> index of the cause."""
        known = {e.name for e in self.effects}
        return {c.name: i for i, c in enumerate(self.problem.causes) if c.name in known}

    def members(self, names: Sequence[str], shapes: Mapping[str, Any] | None = None) -> Members:
        """A set of candidates, in the order of the problem."""
        out = []
        for i in sorted(self.places[n] for n in names):
            effect = self.problem.causes[i].effect
            assert effect is not None
            out.append(Member(i, (shapes or {}).get(effect.name, effect.shapes[0])))
        return tuple(out)

    def name(self, member: Member) -> str:
        return self.problem.causes[member.cause].name

    # ------------------------------------------------------------ residuals

    def _keys(self, members: Members, records: Sequence[Observed]) -> list[Any]:
        """Names of all unknowns of a set."""
        own = [("global", *u) for u in unknowns_of(self.problem, members)]
        return own + [
            ("local", k, q.kind, q.index, q.scale)
            for k, o in enumerate(records)
            for q in local_of(self.problem, members, o)
        ]

    def _weights(self, members: Members, records: Sequence[Observed]) -> np.ndarray:
        """Square roots of the weights of the priors; a candidate has none."""
        g, free = count_global(self.problem, members), len(self.problem.free)
        rows = np.zeros(g)
        rows[:free] = np.sqrt(self.problem.prior)
        local = [q.weight for o in records for q in local_of(self.problem, members, o)]
        return np.concatenate([rows, np.sqrt(local)])

    def _bounds(self, members: Members, size: int) -> tuple[np.ndarray, np.ndarray]:
        low, high = np.full(size, -np.inf), np.full(size, np.inf)
        a, b = self.problem.parameter_bounds
        low[: a.size], high[: b.size] = a - 1e-12, b + 1e-12
        for j, m in enumerate(members):
            lower, upper = self.problem.causes[m.cause].bounds
            low[a.size + j], high[a.size + j] = lower - 1e-12, upper + 1e-12
        shapes = slice(a.size + len(members), count_global(self.problem, members))
        low[shapes], high[shapes] = -3.0, 3.0
        return low, high

    def system(
        self, members: Members, z: np.ndarray, records: Sequence[Observed], further: Members = ()
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Residuals (n,), derivatives by the unknowns (n, k), and columns of candidates (n, c).

        A step d of the unknowns, or a magnitude d of a candidate, takes its column times d away.
        """
        g = count_global(self.problem, members)
        counts = [len(local_of(self.problem, members, o)) for o in records]
        ends = np.cumsum([g, *counts])
        local = tuple(z[a:b] for a, b in itertools.pairwise(ends))
        ask = EvaluationRequest(members, Point(z[:g], local), tuple(records), further)
        rest, slopes, columns = [], [], []
        for k, (o, linear) in enumerate(
            zip(records, evaluate(self.problem, [ask])[0], strict=True)
        ):
            good = o.valid
            own = np.zeros((int(good.sum()), z.size))
            own[:, :g] = linear.by_global[good]
            own[:, ends[k] : ends[k + 1]] = linear.by_local[good]
            rest.append(linear.residual[good])
            slopes.append(own)
            columns.append(linear.by_further[good])
        return tuple(  # a diverged simulation is a large residual
            np.nan_to_num(np.concatenate(part), nan=1e6, posinf=1e6, neginf=-1e6)
            for part in (rest, slopes, columns)
        )  # type: ignore[return-value]

    # ------------------------------------------------------------ fits

    def setting(self, members: Members, start: Fitted | None) -> dict[str, Any]:
        """First values, limits, residual and derivative of a fit, for any least-squares program."""
        records = self.problem.fit
        keys = self._keys(members, records)
        known = {} if start is None else start.values
        z = np.array([known.get(k, FIRST if k[:2] == ("global", "magnitude") else 0.0)
                      for k in keys])  # fmt: skip
        low, high = self._bounds(members, z.size)
        weight = self._weights(members, records)
        kept: dict[str, Any] = {}

        def at(z: np.ndarray, part: float) -> tuple[np.ndarray, np.ndarray]:
            if kept.get("part") != part or not np.array_equal(kept["z"], z):
                cut = records if part == 1.0 else tuple(o.first(part) for o in records)
                rest, slopes, _ = self.system(members, z, cut)
                kept.update(part=part, z=z.copy(), r=np.append(rest, weight * z),
                            j=np.vstack([-slopes, np.diag(weight)]))  # fmt: skip
            return kept["r"], kept["j"]

        return {
            "keys": keys, "z": np.clip(z, low + 1e-9, high - 1e-9), "low": low, "high": high,
            "residual": lambda z, part=1.0: at(z, part)[0],
            "slopes": lambda z, part=1.0: at(z, part)[1],
        }  # fmt: skip

    def fit(self, members: Members, start: Fitted | None = None) -> Fitted:
        """Least squares of scipy; the first fit grows along the records."""
        s = self.setting(members, start)
        z, out = s["z"], None
        for part in PARTS if start is None else (1.0,):
            out = least_squares(
                s["residual"], z, s["slopes"], bounds=(s["low"], s["high"]), x_scale="jac",
                ftol=1e-5, max_nfev=self._most, kwargs={"part": part},
            )  # fmt: skip
            z = np.clip(out.x, s["low"] + 1e-9, s["high"] - 1e-9)
        assert out is not None
        return self.fitted(members, s, out.x, 2.0 * out.cost)

    def fitted(
        self, members: Members, setting: Mapping[str, Any], z: np.ndarray, cost: float
    ) -> Fitted:
        samples = int(sum(o.valid.sum() for o in self.problem.fit))
        values = dict(zip(setting["keys"], map(float, z), strict=True))
        return Fitted(members, values, max(cost, 1e-300), samples)

    def shaped(self, names: Sequence[str], start: Fitted) -> Members:
        """Candidates with the shapes that take most of the residual at the first step."""
        if id(start) not in self._shapes:
            some = self.each_shape()
            rest, columns = self.projected(start, some)
            size = np.sqrt((columns**2).sum(axis=0))
            gains = np.abs(columns.T @ rest) / np.where(size > 0.0, size, np.inf)
            found = sorted(zip(gains, range(len(some)), strict=True))
            best = {self.name(some[k]): some[k].shape for _, k in found}  # the last one is the best
            self._shapes[id(start)] = start, best
        return self.members(names, self._shapes[id(start)][1])

    def each_shape(self) -> Members:
        """All candidates, with each of their shapes."""
        return tuple(self._each())

    def _each(self) -> Iterator[Member]:
        for i in self.places.values():
            effect = self.problem.causes[i].effect
            assert effect is not None
            yield from (Member(i, shape) for shape in effect.shapes)

    def projected(self, start: Fitted, some: Members) -> tuple[np.ndarray, np.ndarray]:
        """Residual and columns of candidates, without what the unknowns of a fit can take up."""
        z = np.array(list(start.values.values()))
        rest, slopes, columns = self.system(start.members, z, self.problem.fit, some)
        weights = self._weights(start.members, self.problem.fit)
        q, _ = np.linalg.qr(np.vstack([slopes, np.diag(weights)]))
        q = q[: rest.size]
        return rest - q @ (q.T @ rest), columns - q @ (q.T @ columns)

    # ------------------------------------------------------------ answers

    def answer(self, best: Fitted, **more: Any) -> dict[str, Any]:
        """What a fit tells: its candidates, parameters and prediction of held-out records."""
        p = self.problem
        theta = p.tabulated.copy()
        x = np.array([v for k, v in best.values.items() if k[0] == "global"])
        theta[p.free] += p.unit * x[: len(p.free)]
        own = [m.name for m in self.ready.model.parameters]
        nan = math.nan
        sizes = {}
        for j, m in enumerate(best.members):
            effect = p.causes[m.cause].effect
            assert effect is not None
            sizes[effect.name] = (effect.scale * x[len(p.free) + j], nan, nan)
        return {
            "named": [self.name(m) for m in best.members],
            "parameters": {n: (float(v), nan, nan) for n, v in zip(own, theta, strict=True)},
            "magnitudes": sizes,
            "predicted": self.predicted(best, x),
            **more,
        }

    def predicted(self, best: Fitted, x: np.ndarray) -> float:
        """Rms of the held-out records, whose starts alone are fitted [unit], worst channel."""
        p = self.problem
        if not p.held_out:
            return math.nan
        counts = [len(local_of(p, best.members, o)) for o in p.held_out]
        z = np.zeros(sum(counts))

        def at(z: np.ndarray, part: float) -> tuple[np.ndarray, np.ndarray]:
            cut = [o.first(part) for o in p.held_out]
            rest, slopes, _ = self.system(best.members, np.concatenate([x, z]), cut)
            return rest, -slopes[:, x.size :]

        for part in PARTS if z.size else ():
            z = least_squares(
                lambda z, part=part: at(z, part)[0], z, lambda z, part=part: at(z, part)[1],
                x_scale="jac", max_nfev=30,
            ).x  # fmt: skip
        ends = np.cumsum([0, *counts])
        local = tuple(z[a:b] for a, b in itertools.pairwise(ends))
        ask = EvaluationRequest(best.members, Point(x, local), tuple(p.held_out), derivatives=False)
        squares, count = np.zeros(p.motion.size), np.zeros(p.motion.size)
        for o, linear in zip(p.held_out, evaluate(p, [ask])[0], strict=True):
            squares += (np.where(o.valid, linear.residual * o.sd, 0.0) ** 2).sum(axis=0)
            count += o.valid.sum(axis=0)
        rms = np.sqrt(squares / np.maximum(count, 1))
        return float(rms[np.argmax(rms / np.maximum(p.motion, 1e-300))])
