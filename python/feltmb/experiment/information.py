"""Information of an experiment about parameters and effects, and the value of that information.

The model is linearized at one point. An experiment j then adds its matrix H_j over the parameters
and the magnitudes of all candidates. Magnitudes are in scales; states, sensors and run-to-run
variability of the record are eliminated:

    H = prior + sum_j H_j,    G = H_ee - H_ep H_pp^-1 H_pe

*Names* (T-optimal): if a is true with magnitude m, the expected log evidence against b, whose
magnitude is free with the prior N(0, s^2), and against the model alone is

    L_ab = m^2/2 (G_aa - G_ab^2 / (G_bb + s^-2)),    L_a0 = m^2/2 G_aa

The prior of the rival is wide (:data:`WIDE`), because a diagnosis uses priors that are at least as
wide as the fitted magnitudes. Two effects with equal signatures then stay equally probable.

With prior probability w, the posterior probability of a will be p_a = w_a / (w_a + sum_b w_b
exp(-L_ab)). The value of the experiment is the mean of p_a over all possible causes. *Sizes*
(D-optimal): 1/2 log det(1 + G), the expected gain of information on all magnitudes [log evidence].
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from feltmb.arguments import checked
from feltmb.data import Array, Record, Sensor
from feltmb.errors import FeltmbError, InvalidParameter
from feltmb.files import Store, digest_of, package_digest
from feltmb.fit.linearize import Linear
from feltmb.fit.model import Candidate, Model
from feltmb.fit.noise import Noise, noise_of
from feltmb.fit.observe import observe_whole
from feltmb.fit.problem import Normal, Point, Problem, solve_scaled
from feltmb.fit.segmented_records import segment_record
from feltmb.fit.solve import chained
from feltmb.gap.checks import with_sigma
from feltmb.gap.confusion import confusion
from feltmb.gap.criteria import DETECTABLE, NOT_LISTED
from feltmb.gap.proof import SEGMENTED_LEVEL

__all__ = [
    "Belief",
    "Information",
    "Knowledge",
    "continuous",
    "expected_noise",
    "information",
    "informations",
    "linearized",
    "of_normal",
    "planned",
]

#: Magnitudes of an effect that are assumed before there are data [scales].
MAGNITUDES = (0.5, 1.0, 2.0)
#: Distance from its states at which one simulation counts as having left a point [their spread].
LEFT = 10.0
#: Standard deviation of the prior of a rival's magnitude [scales].
WIDE = 10.0
#: Largest number of parameters that are told to look like a candidate.
IMITATORS = 3


@checked
@dataclass(frozen=True, eq=False)
class Information:
    """Information of one experiment, over the parameters of the model and then all candidates."""

    matrix: Array
    """Second derivative of -log likelihood, parameters in their units, magnitudes in scales."""
    right: Array
    """Gradient of the log likelihood at the tabulated values; 0 for a planned experiment."""
    square: float = 0.0
    """Squared residual at the tabulated values."""
    samples: float = 0.0
    """Number of measured values."""
    kept: bool = False
    """Whether the result was read from the store instead of computed."""


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class Belief:
    """Possible causes before the next experiment, with their probabilities."""

    weights: Mapping[str, float]
    """Probability of each effect."""
    none: float = 0.0
    """Probability that no effect is missing, or only one that is too weak to be detected."""
    magnitudes: Mapping[str, float] = field(default_factory=dict)
    """Fitted magnitude by effect, if it was fitted [unit]."""

    @classmethod
    def even(cls, candidates: Sequence[Candidate], none: float = 0.1) -> Belief:
        """Probabilities from the weights of the library, before any data."""
        weight = {t.name: t.effect.weight for t in candidates}
        total = sum(weight.values()) or 1.0
        return cls(weights={n: (1.0 - none) * w / total for n, w in weight.items()}, none=none)

    @classmethod
    def of_report(cls, report: Mapping[str, Any]) -> Belief:
        """Probabilities from ``report.json`` of a diagnosis.

        Raises
        ------
        InvalidParameter
            The object is not such a report.
        """
        try:
            which = report["which"]
            rows = which["effects"]
            share = max(1.0 - float(which["none"]), 0.0)
            weights = {str(r["effect"]): float(r["posterior"] or 0.0) for r in rows}
            fitted = {
                str(r["effect"]): abs(float(r["magnitude"] or 0.0))
                for r in rows
                if r["refitted"] and float(r["posterior"] or 0.0) > 0.01 and r["magnitude"]
            }
            none = float(which["none"])
        except (KeyError, TypeError, ValueError, IndexError) as error:
            raise InvalidParameter(
                f"report: is none of a diagnosis ({type(error).__name__}: {error}); expected "
                "report.json of feltmb gap diagnose"
            ) from None
        total = sum(weights.values())
        if total > 0.0:
            weights = {n: share * w / total for n, w in weights.items()}
        return cls(weights=weights, none=none, magnitudes=fitted)

    def over(self, candidates: Sequence[Candidate]) -> Array:
        """Probabilities of candidates (best shape of each effect), with a reserve for all."""
        prior = np.array([t.effect.weight for t in candidates])
        prior = prior / max(float(np.sum(prior)), 1e-300)
        own = np.array([self.weights.get(t.name, 0.0) for t in candidates])
        total = float(np.sum(own)) + self.none
        own = own / total if total > 0.0 else prior
        # If nothing seems to be missing, each effect may still exist below its detectable
        # magnitude.
        reserve = NOT_LISTED + (1.0 - NOT_LISTED) * (self.none / total if total > 0.0 else 0.0)
        out = (1.0 - reserve) * own / max(float(np.sum(own)), 1e-300) + reserve * prior
        return np.asarray(out / np.sum(out))


def planned(
    model: Model,
    record: Record,
    sensors: Mapping[str, Sensor],
    theta: Array | None = None,
) -> Record:
    """The record with the outputs of the model, without noise.

    Parameters
    ----------
    sensors
        Sensors by output; other outputs are not measured.
    theta
        Parameters; None: their prior values.

    Raises
    ------
    InvalidParameter
        The model cannot simulate it.
    """
    prior = {} if record.start is None else record.start.mean
    start = np.array([prior.get(s.name, s.start) for s in model.states()])
    if theta is None:
        theta = np.array([p.value for p in model.parameters])
    names = [n for n in model.outputs if n in sensors]
    bare = replace(record, outputs={n: np.zeros(record.samples) for n in names}, sensors=sensors)
    outputs = observe_whole(model, bare, theta, start)
    columns = {n: outputs[:, model.outputs.index(n)] for n in names}
    for name, column in columns.items():
        if not np.all(np.isfinite(column)):
            raise InvalidParameter(f"record {record.name}: {name} could not be simulated")
    return replace(bare, outputs=columns)


def expected_noise(record: Record) -> dict[str, Noise]:
    """Noise by output; where it is unknown, a thousandth of the spread of the output."""
    out = {}
    for name, sensor in record.sensors.items():
        sigma = sensor.sigma
        if sigma is None:
            sigma = 1e-3 * (float(np.std(record.outputs[name])) or 1.0)
        out[name] = noise_of(sensor, sigma, sensor.quantum)
    return out


def information(
    model: Model,
    record: Record,
    candidates: tuple[Candidate, ...],
    *,
    store: Store | None = None,
) -> Information | None:
    """Information of a measured or planned record; None: the record cannot be simulated.

    The outputs of the record count as measured.
    """
    found = informations(model, record, candidates, [dict.fromkeys(record.outputs, 1.0)], store)
    return None if found is None else found[0]


def informations(
    model: Model,
    record: Record,
    candidates: tuple[Candidate, ...],
    ways: Sequence[Mapping[str, float]],
    store: Store | None = None,
) -> tuple[Information, ...] | None:
    """What a record tells by each of several ways to measure it, from one linearization.

    Parameters
    ----------
    ways
        By output that is read: its noise, in multiples of that of the record. The color of the
        noise is that of the record.
    """
    identity = None if store is None else model.identity()
    if store is None or identity is None:
        return linearized(model, record, candidates, ways)
    key = digest_of(
        package_digest(),
        identity,
        [(p.name, p.value, p.lower, p.upper, p.sd > 0.0) for p in model.parameters],
        [(t.name, t.shape, t.effect.scale, t.effect.bounds, t.effect.data) for t in candidates],
        record.input_mode,
        sorted(record.sensors.items()),
        sorted(record.input_sigma.items()),
        sorted(record.conditions.items()),
        record.time,
        *(record.inputs[n] for n in sorted(record.inputs)),
        *(record.outputs[n] for n in sorted(record.outputs)),
    )
    keys = [digest_of(key, sorted(way.items())) for way in ways]
    stored = [store.get(k) for k in keys]
    out = [
        Information(
            f.arrays["matrix"],
            f.arrays["right"],
            float(f.data["square"]),
            float(f.data["samples"]),
            kept=True,
        )
        for f in stored
        if f is not None
    ]
    if len(out) == len(keys):
        return tuple(out)
    made = linearized(model, record, candidates, ways)
    for k, one in zip(keys, made or (), strict=False):
        numbers = {"square": float(one.square), "samples": float(one.samples)}
        store.put(k, numbers, {"matrix": one.matrix, "right": one.right})
    return made


def linearized(
    model: Model,
    record: Record,
    candidates: tuple[Candidate, ...],
    ways: Sequence[Mapping[str, float]],
    *,
    theta: Array | None = None,
    noise: Mapping[str, Noise] | None = None,
    level: float = SEGMENTED_LEVEL,
) -> tuple[Information, ...] | None:
    """The same as :func:`informations` without a store, at any parameters.

    Parameters
    ----------
    theta
        Parameters of the model; None: their prior values.
    noise
        Noise by output; None: that of the sensors.
    level
        Permitted continuity defects, as a share of the spread of the states [1].
    """
    try:
        ready = model.ready([with_sigma(record, noise or expected_noise(record))])
        own, kept = ready.model, ready.records[0]
        segmented = segment_record(own, kept, noise or expected_noise(kept), None)
        problem = Problem(own, (segmented,))
        at = {p.name: p.value for p in own.parameters}
        if theta is not None:
            at |= zip((p.name for p in model.parameters), theta, strict=True)
        point = problem.start(theta=np.array([at[p.name] for p in own.parameters]))
        if theta is not None:  # the start states are those of the prior values
            point = continuous(problem, point)
        defect_sd = level * problem.scale(point)
        linears = problem.linear(point, candidates)
        if not all(np.all(x.good) for x in linears):
            return None
        out = []
        for way in ways:
            share = np.array(
                [1.0 / way[n] if n in way else float(n not in kept.outputs) for n in own.outputs]
            )
            read = [_read_by(x, share) for x in linears]
            normal = problem.normal(point, read, defect_sd)
            if not np.all(np.isfinite(normal.matrix)):
                return None
            square = float(sum(np.sum(x.residual**2) for x in read))
            samples = float(np.sum(segmented.samples[:, share > 0.0]))
            out.append(of_normal(model, problem, point, normal, candidates, square, samples))
    except FeltmbError:
        return None
    return tuple(out)


def continuous(problem: Problem, point: Point) -> Point:
    """The point with segments that start at the end of the previous one.

    It is unchanged if the model is chaotic, or if one simulation leaves the states of the point.
    """
    if problem.model.chaotic:
        return point
    other, far = chained(problem, point), LEFT * problem.scale(point)
    pairs = zip(point.places, other.places, strict=True)
    stays = all(np.all(np.abs(a.starts - b.starts) <= far) for a, b in pairs)
    return other if stays else point


def _read_by(linear: Linear, share: Array) -> Linear:
    """A linearization whose rows of an output are multiplied by a number; 0: it is not read."""
    if np.all(share == 1.0):
        return linear
    rows = np.tile(share, linear.residual.shape[1] // share.size)  # outputs change fastest
    return replace(
        linear,
        residual=linear.residual * rows,
        by_state=linear.by_state * rows[:, None],
        by_global=linear.by_global * rows[:, None],
        by_input=linear.by_input * rows[:, None],
    )


def of_normal(
    model: Model,
    problem: Problem,
    point: Point,
    normal: Normal,
    candidates: tuple[Candidate, ...],
    square: float = 0.0,
    samples: float = 0.0,
) -> Information:
    """Information of normal equations, over the parameters of the model and all candidates."""
    own = problem.model
    matrix, right = np.array(normal.matrix), np.array(normal.right)
    free = [own.parameters[i] for i in problem.free]
    for c, p in enumerate(free):  # priors must be counted once, not with every record
        if np.isfinite(p.sd) and p.name in {q.name for q in model.parameters}:
            matrix[c, c] -= 1.0 / p.sd**2
            right[c] -= (p.value - point.theta[problem.free[c]]) / p.sd**2
    shared = {p.name: i for i, p in enumerate(model.parameters)}
    k, n = len(candidates), len(model.parameters)
    place = [shared.get(p.name, -1) for p in free] + [-1] * len(problem.included)
    place += list(range(n, n + k))
    place += [-1] * (matrix.shape[0] - len(place))
    kept_rows = [i for i, at in enumerate(place) if at >= 0]
    rest = [i for i, at in enumerate(place) if at < 0]
    a, b = np.ix_(kept_rows, kept_rows), np.ix_(rest, kept_rows)
    h, r = matrix[a], right[kept_rows]
    if rest:
        absorbed = solve_scaled(matrix[np.ix_(rest, rest)], matrix[b])
        h = h - matrix[b].T @ absorbed
        r = r - absorbed.T @ right[rest]
        square -= float(right[rest] @ solve_scaled(matrix[np.ix_(rest, rest)], right[rest]))
    scale = np.ones(n + k)
    scale[n:] = [t.effect.scale for t in candidates]
    full, side = np.zeros((n + k, n + k)), np.zeros(n + k)
    at = [place[i] for i in kept_rows]
    full[np.ix_(at, at)] = 0.5 * (h + h.T)
    side[at] = r
    return Information(full * np.outer(scale, scale), side * scale, square, samples)


@dataclass(frozen=True, eq=False)
class Knowledge:
    """Combined information of priors and experiments, and the possible causes."""

    model: Model
    candidates: tuple[Candidate, ...]
    belief: Belief
    matrix: Array
    right: Array
    before: Array | None = None
    """Gram matrix of the data that the probabilities in ``belief`` already include."""
    square: float = 0.0
    samples: float = 0.0

    @classmethod
    def start(
        cls,
        model: Model,
        candidates: tuple[Candidate, ...],
        belief: Belief,
        known: Sequence[Information] = (),
    ) -> Knowledge:
        """Start from the priors of the parameters and the experiments that were made."""
        n, k = len(model.parameters), len(candidates)
        if not k:
            raise InvalidParameter("plan: there are no effects to tell apart")
        matrix, right = np.zeros((n + k, n + k)), np.zeros(n + k)
        for i, p in enumerate(model.parameters):
            if 0.0 < p.sd < math.inf:
                matrix[i, i] = 1.0 / p.sd**2
        out = cls(model, candidates, belief, matrix, right).plus(*known)
        return replace(out, before=out.gram)

    def plus(self, *more: Information) -> Knowledge:
        """Add experiments."""
        return replace(
            self,
            matrix=self.matrix + sum(m.matrix for m in more),
            right=self.right + sum(m.right for m in more),
            square=self.square + sum(m.square for m in more),
            samples=self.samples + sum(m.samples for m in more),
        )

    def among(self, names: Collection[str]) -> Knowledge:
        """The same for the effects of these names only."""
        kept = [i for i, t in enumerate(self.candidates) if t.name in names]
        n = len(self.model.parameters)
        at = [*range(n), *(n + i for i in kept)]
        return replace(
            self,
            candidates=tuple(self.candidates[i] for i in kept),
            matrix=self.matrix[np.ix_(at, at)],
            right=self.right[at],
            before=None if self.before is None else self.before[np.ix_(kept, kept)],
        )

    def part(self, name: str, sd: float) -> Information:
        """Information of a test of one part by itself: of a parameter, or of an effect.

        The test of a parameter measures the sum of its deviation and of the effects that change the
        same number.

        Parameters
        ----------
        name
            Parameter or effect.
        sd
            Standard deviation of the test [unit of the parameter or effect].
        """
        row = [float(p.name == name) for p in self.model.parameters]
        row += [self._share_in_test(t, name) for t in self.candidates]
        return Information(np.outer(row, row) / sd**2, np.zeros_like(self.right))

    @staticmethod
    def _share_in_test(candidate: Candidate, name: str) -> float:
        """Change of the result of a test by a candidate at one scale [unit of the test]."""
        effect = candidate.effect
        if effect.tolerance_parameter == name:
            return effect.scale * effect.tolerance_ratio
        return effect.scale * (candidate.name == name)

    @property
    def _split(self) -> tuple[Array, Array, Array]:
        n = len(self.model.parameters)
        m = self.matrix
        return m[:n, :n], m[:n, n:], m[n:, n:]

    @property
    def gram(self) -> Array:
        """Matrix G of the candidates, magnitudes in scales; parameters are projected out."""
        pp, pe, ee = self._split
        out = ee - pe.T @ solve_scaled(pp, pe)
        out = 0.5 * (out + out.T)
        # If parameters imitate a column, the remainder is rounding.
        noise = 1e-9 * np.maximum(np.diag(ee), 1e-300)
        bad = np.diag(out) < noise
        out[bad, :] = 0.0
        out[:, bad] = 0.0
        return np.asarray(out)

    def evidence(self, gram: Array | None = None) -> Array:
        """Expected log evidence of a (row) at magnitude 1 scale against b (column); last: none."""
        g = self.gram if gram is None else gram
        own = np.diag(g)
        taken = g**2 / (own + WIDE**-2)[None, :]
        against = 0.5 * np.maximum(own[:, None] - taken, 0.0)
        return np.concatenate([against, 0.5 * own[:, None]], axis=1)

    def magnitudes(self) -> Array:
        """Magnitudes at which each candidate is expected [scales], (m, k).

        An effect that is not visible in the existing records can only be below its detectable
        magnitude.
        """
        out = np.tile(np.array(MAGNITUDES)[:, None], (1, len(self.candidates)))
        if self.before is not None:
            out = np.minimum(out, DETECTABLE / np.sqrt(np.maximum(np.diag(self.before), 1e-12)))
        for i, t in enumerate(self.candidates):
            if t.name in self.belief.magnitudes:
                out[:, i] = max(self.belief.magnitudes[t.name] / t.effect.scale, 1e-3)
        return out

    def beliefs(self, most: int = 1) -> Array:
        """Posterior probability that each candidate would get if it were true, (k,).

        ``most``: the probability of a class of this size, i.e. of the candidate and those that are
        most similar to it.
        """
        weights = self.belief.over(self.candidates)
        none = max(self.belief.none, 1e-3)
        gain = self.evidence() - (0.0 if self.before is None else self.evidence(self.before))
        _, number = np.unique([t.name for t in self.candidates], return_inverse=True)
        same = number[:, None] == number[None, :]
        prior = np.append(weights, none)
        total = np.zeros(number.size)
        sizes = self.magnitudes()
        for size in sizes:
            log = -(size**2)[:, None] * np.maximum(gain, 0.0)
            rest = prior[None, :] * np.exp(log)
            rest[:, :-1][same] = 0.0
            if most > 1:
                rest.sort(axis=1)
                rest = rest[:, : rest.shape[1] - (most - 1)]
            own = weights + (same * weights[None, :]).sum(axis=1) - weights
            total += own / (own + rest.sum(axis=1))
        return np.asarray(total / len(sizes))

    def names(self) -> float:
        """Expected posterior probability of the true cause [1] (T-optimality)."""
        return float(self.belief.over(self.candidates) @ self.beliefs())

    def sizes(self) -> float:
        """Expected information on all magnitudes [log evidence]: D-optimality."""
        g = self.gram
        return 0.5 * float(np.linalg.slogdet(np.eye(len(g)) + g)[1])

    def expected(self) -> Array:
        """Expected magnitude of each candidate: as fitted, else its scale [scales], (k,)."""
        fitted = self.belief.magnitudes
        return np.array(
            [fitted.get(t.name, t.effect.scale) / t.effect.scale for t in self.candidates]
        )

    def confusion(self) -> Array:
        """Probability of mistaking a candidate (row) for another, at its expected magnitude."""
        return confusion(self.gram, self.expected())

    def detected(self) -> NDArray[np.bool_]:
        """Whether each candidate is detectable at its expected magnitude, (k,)."""
        return self.expected() * np.sqrt(np.diag(self.gram)) >= DETECTABLE

    def surviving(self) -> Array:
        """Share of each signature (amplitude) that no parameter can imitate [1], (k,)."""
        whole = np.diag(self._split[2])
        left = np.diag(self.gram) / np.where(whole > 0.0, whole, 1.0)
        return np.asarray(np.sqrt(np.clip(left, 0.0, 1.0)))

    def smallest(self) -> Array:
        """Smallest detectable magnitude [unit], (k,); inf: not detectable."""
        strength = np.sqrt(np.diag(self.gram))
        scale = np.array([t.effect.scale for t in self.candidates])
        with np.errstate(divide="ignore"):
            return np.asarray(np.where(strength > 0.0, DETECTABLE * scale / strength, np.inf))

    def imitators(self, candidate: int) -> list[str]:
        """Parameters whose change looks like a candidate, the largest share first."""
        pp, pe, _ = self._split
        change = solve_scaled(pp, pe[:, candidate])
        share = np.abs(change) * np.sqrt(np.maximum(np.diag(pp), 0.0))
        order = np.argsort(-share, kind="stable")[:IMITATORS]
        return [
            self.model.parameters[i].name
            for i in order
            if share[i] > 0.1 * np.max(share, initial=0.0)
        ]

    def spread(self) -> Array:
        """Standard deviation of each parameter, candidates absent [its unit]."""
        pp = self._split[0]
        return np.asarray(np.sqrt(np.maximum(np.diag(solve_scaled(pp, np.eye(len(pp)))), 0.0)))

    def linear_belief(self) -> Belief:
        """Probabilities by one step from the tabulated values, one effect at a time."""
        pp, pe, _ = self._split
        n = len(self.model.parameters)
        absorbed = solve_scaled(pp, np.column_stack([pe, self.right[:n]]))
        b = self.right[n:] - pe.T @ absorbed[:, -1]
        g = np.diag(self.gram)
        square = self.square - float(self.right[:n] @ absorbed[:, -1])
        best = float(np.max(np.where(g > 0.0, b**2 / np.where(g > 0.0, g, 1.0), 0.0), initial=0.0))
        inflation = max(1.0, (square - best) / max(self.samples, 1.0))
        logs: dict[str, float] = {}
        sizes: dict[str, float] = {}
        for i, t in enumerate(self.candidates):
            low, high = t.effect.bounds
            size = np.clip(b[i] / (g[i] + 1.0), low / t.effect.scale, high / t.effect.scale)
            gain = float(size * b[i] - 0.5 * size**2 * g[i]) / inflation
            log = gain - 0.5 * math.log1p(g[i] / inflation) + math.log(t.effect.weight)
            if log > logs.get(t.name, -math.inf):
                logs[t.name] = log
                sizes[t.name] = abs(float(size)) * t.effect.scale
        none = math.log(sum(t.effect.weight for t in self.candidates))
        top = max([none, *logs.values()])
        total = sum(math.exp(v - top) for v in logs.values()) + math.exp(none - top)
        weights = {name: math.exp(v - top) / total for name, v in logs.items()}
        return Belief(
            weights=weights,
            none=math.exp(none - top) / total,
            magnitudes={n: sizes[n] for n, w in weights.items() if w > 0.05 and sizes[n] > 0.0},
        )
