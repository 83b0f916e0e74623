"""Information of records about parameters and causes, and the value of that information.

The model is linearized once for each record, as a diagnosis does (:mod:`unmodeled.search.linear`).
The matrix H of the records is over the parameters and the magnitudes of all causes, each in its
prior scale; the unknowns of single records are eliminated:

    G = H_cc - H_cp (H_pp + W)^-1 H_pc

with the weights W of the priors of the parameters. A sample of a channel counts as in the evidence
of a diagnosis (:func:`unmodeled.search.evidence.precision`): without a diagnosis only by the noise
of its sensor, with one also by the discrepancy that the model is known to leave.

*Names* (T-optimal): if a is missing with magnitude m, the expected log evidence against b, whose
magnitude is free with the prior N(0, PRIOR_WIDTH^2), and against the model alone is

    L_ab = m^2/2 (G_aa - G_ab^2 / (G_bb + PRIOR_WIDTH^-2)),    L_a0 = m^2/2 G_aa - 1/2 log(1 + G_aa)

With the prior probability w, the posterior probability of a is p_a = w_a / (w_a + sum_b w_b
exp(-L_ab)). The value of an experiment is the mean of p_a over all possible causes. *Sizes*
(D-optimal): 1/2 log det(1 + G), the expected gain of information on all magnitudes.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csgraph

from unmodeled.arguments import checked
from unmodeled.data import Array, Record, Sensor
from unmodeled.errors import InvalidParameter
from unmodeled.fit.measured import untested
from unmodeled.fit.observe import machine_candidates, observe_all
from unmodeled.models.model import Effect, Jobs, Model
from unmodeled.models.subject import Scope
from unmodeled.search.evidence import Fitted, precision, prior_of, system
from unmodeled.search.fit import empty_point
from unmodeled.search.linear import (
    EvaluationRequest,
    Linear,
    Point,
    evaluate,
    magnitudes_at,
    shapes_of,
    theta_at,
)
from unmodeled.search.options import Options
from unmodeled.search.problem import RELEASED, Cause, Member, Members, Problem
from unmodeled.search.records import as_parameter, causes_of, problem_of, ready_records
from unmodeled.search.result import Result
from unmodeled.search.variation import varies, with_variation

Aim = Literal["names", "sizes"]

#: Magnitudes of a cause that are assumed before there are data [scales].
MAGNITUDES = (0.5, 1.0, 2.0)
#: Standard deviation of the prior of a rival's magnitude [scales]: two causes with equal signatures
#: then stay equally probable.
PRIOR_WIDTH = 10.0
#: Prior weight below which there is no prior knowledge, and the weight that replaces it: such a
#: parameter imitates an effect completely.
LEAST_PRIOR, NO_PRIOR = 1e-5, 1e-12
#: Options of a diagnosis by default.
DEFAULTS = Options()
#: Log odds from which a cause is named.
NAMED = math.log(DEFAULTS.credibility / (1.0 - DEFAULTS.credibility))


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class Belief:
    """What is known before the next experiment: probabilities of causes, and a fitted model."""

    weights: Mapping[str, float]
    """Probability of each cause."""
    none: float = 0.0
    """Probability that no cause is missing."""
    magnitudes: Mapping[str, float] = field(default_factory=dict)
    """Fitted magnitude by cause [its unit]."""
    included: Mapping[str, tuple[float, Any]] = field(default_factory=dict)
    """Named causes, which are part of the model: magnitude [unit] and shape."""
    parameters: Mapping[str, float] = field(default_factory=dict)
    """Fitted values of parameters [their units]."""
    left: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Noise of the sensor, and rms that the model leaves, by output [its unit]."""
    repeats: tuple[str, ...] = ()
    """Records that separate causes of some records from what their inputs show."""

    @classmethod
    def of_report(cls, report: Result | Mapping[str, Any]) -> Belief:
        """Probabilities and fitted values from a diagnosis.

        The named causes are certain and become part of the model. The others share the
        probabilities of their sets.

        Parameters
        ----------
        report
            Result of a diagnosis, or the content of its ``report.json``.

        Raises
        ------
        InvalidParameter
            The object is not such a report.
        """
        data = report.as_dict() if isinstance(report, Result) else report
        try:
            named = {n["cause"]: n for n in data["named"]}
            weights = _shares(data["sets"], named)
            return cls(
                none=weights.pop("", 0.0),
                weights=weights,
                magnitudes={
                    n["cause"]: abs(float(n["magnitude"]))
                    for group in data["classes"]
                    for n in group
                    if n["magnitude"] and not n["parameter"]
                },
                included={
                    c: (float(n["magnitude"]), _shape(n["shape"]))
                    for c, n in named.items()
                    if not n["parameter"]
                },
                parameters={p["name"]: float(p["value"]) for p in data["parameters"]},
                left={
                    c["name"]: (float(c["noise"]), float(c["explained"]))
                    for c in data["channels"]
                    if c["noise"] is not None and c["explained"] is not None
                },
                repeats=_repeats(
                    [*data["named"], *chain(*data["classes"])], data.get("records", ())
                ),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise InvalidParameter(
                f"report: is none of a diagnosis ({type(error).__name__}: {error}); expected "
                "report.json of unmodeled diagnose"
            ) from None


def _shares(sets: Sequence[Mapping[str, Any]], named: Collection[str]) -> dict[str, float]:
    """Probability by cause that is not named, equal shares of its sets; "": of none of them."""
    weights: dict[str, float] = {}
    for s in sets:
        rest = [c for c in s["causes"] if c not in named] or [""]
        for c in rest:
            weights[c] = weights.get(c, 0.0) + float(s["probability"]) / len(rest)
    return weights


def _repeats(causes: Sequence[Mapping[str, Any]], records: Sequence[str]) -> tuple[str, ...]:
    """Records to repeat because of causes of some records."""
    found: dict[str, list[str]] = {}
    for n in causes:
        scope = n.get("subject", {}).get("scope", {})
        text = Scope(records=tuple(scope.get("records", ()))).repeat(records)
        found.setdefault(text, []).append(n["cause"])
    return tuple(f"{', '.join(names)}: {text}" for text, names in found.items() if text)


def _shape(value: Any) -> Any:
    """A shape as it was before it was written as JSON."""
    return tuple(value) if isinstance(value, list) else value


@dataclass(frozen=True, eq=False)
class Study:
    """What a plan is about: a model at a point, and the causes that it may lack."""

    model: Model
    effects: tuple[Effect, ...]
    belief: Belief | None = None
    """None: the prior odds of a diagnosis."""

    def __post_init__(self) -> None:
        if self.belief is None:
            return
        known = {*(e.name for e in self.effects), *self.model.outputs}
        strange = [n for n in (*self.belief.included, *self.belief.left) if n not in known]
        if strange:
            raise InvalidParameter(
                f"report: tells of {', '.join(strange)}, which the model {self.model.name} and its "
                "effects do not have; expected a report of this model"
            )

    @classmethod
    def of(cls, model: Model, effects: Sequence[Effect], belief: Belief | None = None) -> Study:
        """A study of the effects that the model can simulate and that no test has measured."""
        able = tuple(e for e in untested(effects, model) if model.accepts(e))
        if not able:
            raise InvalidParameter(f"plan: model {model.name} can simulate none of the effects")
        return cls(model, able, belief)

    @cached_property
    def problem(self) -> Problem:
        """Model and causes without records."""
        causes = causes_of(self.model, self.effects, DEFAULTS.prior)
        same = tuple(as_parameter(self.model, c) for c in causes)
        return Problem(self.model, same, (), (), ())

    @cached_property
    def members(self) -> Members:
        """The named causes; the fitted parameters have those that change the same number."""
        included = {} if self.belief is None else self.belief.included
        return tuple(
            Member(i, included[c.name][1])
            for i, c in enumerate(self.problem.causes)
            if c.effect is not None and c.name in included
        )

    @cached_property
    def x(self) -> Array:
        """Global unknowns at which the model is linearized, in their scales."""
        problem, x = self.problem, empty_point(self.problem, self.members, ()).x
        if self.belief is not None:
            for k, i in enumerate(problem.free):
                p = self.model.parameters[i]
                value = self.belief.parameters.get(p.name, p.value)
                x[k] = (value - p.value) / problem.unit[k]
            for k, e in enumerate(problem.effects_of(self.members), len(problem.free)):
                x[k] = self.belief.included[e.name][0] / e.scale
        return x

    @cached_property
    def hypotheses(self) -> Members:
        """Causes that may be missing, each with all shapes."""
        included = () if self.belief is None else self.belief.included
        return tuple(
            Member(i, shape)
            for i, c in enumerate(self.problem.causes)
            if c.name not in included
            for shape in (c.effect.shapes if c.effect else (None,))
        )

    @property
    def causes(self) -> list[Cause]:
        """The cause of each hypothesis."""
        return [self.problem.causes[h.cause] for h in self.hypotheses]

    @cached_property
    def names(self) -> Array:
        """Name of each hypothesis, (k,)."""
        return np.array([c.name for c in self.causes])

    def size(self, cause: Cause) -> tuple[float, str]:
        """Expected magnitude of a cause, and its unit."""
        if (e := cause.effect or cause.alias) is not None:
            return e.scale, e.unit
        p = self.model.parameters[cause.parameter or 0]
        return RELEASED * p.size, p.unit

    @cached_property
    def scales(self) -> Array:
        """Expected magnitude of each hypothesis [its unit], (k,)."""
        return np.array([self.size(c)[0] for c in self.causes])

    @cached_property
    def odds(self) -> Array:
        """Prior odds that each hypothesis exists, shared by the shapes of a cause, (k,)."""
        number = [h.cause for h in self.hypotheses]
        shared = np.array([number.count(i) for i in number])
        return np.asarray(np.exp([c.log_odds for c in self.causes]) / shared)

    @cached_property
    def weights(self) -> tuple[Array, float]:
        """Probability of each hypothesis, and that none is right."""
        odds, names = self.odds, list(self.names)
        if self.belief is None:
            return odds / (1.0 + odds.sum()), 1.0 / (1.0 + float(odds.sum()))
        weights = np.array([self.belief.weights.get(n, 0.0) / names.count(n) for n in names])
        total = weights.sum() + self.belief.none
        return (weights / total, self.belief.none / total) if total > 0.0 else (weights, 1.0)

    @cached_property
    def possible(self) -> Array:
        """Probability of each hypothesis if one is right.

        If nothing seems to be missing, each cause may still exist below its detectable magnitude.
        """
        prior = self.odds / self.odds.sum()
        weights, none = self.weights
        credibility = DEFAULTS.credibility  # of what a diagnosis believes in
        reserve = 1.0 - credibility + credibility * none
        out = (1.0 - reserve) * weights / max(weights.sum(), 1e-300) + reserve * prior
        return np.asarray(out / out.sum())

    def simulated(self, records: Sequence[Record]) -> list[Record | None]:
        """Planned records with the outputs that are expected; None: the simulation failed."""
        included = shapes_of(self.problem, self.members, self.x)
        start = np.array([s.start for s in self.model.states(machine_candidates(included))])
        theta = theta_at(self.problem, self.x)
        sizes = magnitudes_at(self.problem, self.members, self.x)
        jobs = Jobs(
            theta=theta[None], starts=start[None], included=included, magnitudes=sizes[None]
        )
        out: list[Record | None] = []
        runs = observe_all(self.model, [(r, jobs) for r in records])
        for r, run in zip(records, runs, strict=True):
            values = {n: run[0][:, self.model.outputs.index(n)] for n in r.outputs}
            if not all(np.isfinite(v).all() for v in values.values()):
                out.append(None)
                continue
            sensors = {n: expected_sensor(s, values[n]) for n, s in r.sensors.items()}
            out.append(replace(r, outputs=values, sensors=sensors))
        return out

    def linearized(self, record: Record) -> Information:
        """Information of a measured record, or of a planned one with its expected outputs.

        Raises
        ------
        Error
            The model cannot simulate it.
        """
        ready = ready_records(self.model, (record,))
        problem = problem_of(ready.model, self.effects, ready.records, (), DEFAULTS)
        extra = len(problem.free) - len(self.problem.free)
        shared = len(self.problem.free)
        x = np.concatenate([self.x[:shared], np.zeros(extra), self.x[shared:]])

        def point() -> Point:
            return Point(x, empty_point(problem, self.members, problem.fit).local)

        if varies(problem):
            one = np.ones(len(problem.channels))
            problem = with_variation(problem, Fitted(self.members, point(), (), one))
        further = tuple(h for h in self.hypotheses if self.problem.causes[h.cause].effect)
        linears = tuple(
            evaluate(problem, [EvaluationRequest(self.members, point(), problem.fit, further)])[0]
        )
        if any(linear.failed for linear in linears):
            raise InvalidParameter(f"record {record.name}: its simulation failed")
        return Information(self, problem, point(), linears)


def expected_sensor(sensor: Sensor, values: Array) -> Sensor:
    """A sensor whose noise is known: else a thousandth of the spread of the expected values."""
    if sensor.sigma is not None:
        return sensor
    return replace(sensor, sigma=1e-3 * (float(np.std(values)) or 1.0))


@dataclass(frozen=True, eq=False)
class Information:
    """What one record tells."""

    study: Study
    problem: Problem
    point: Point
    linears: tuple[Linear, ...]
    _known: dict[bytes, Array] = field(default_factory=dict, repr=False)

    @property
    def samples(self) -> dict[str, float]:
        """Number of values by output."""
        pairs = zip(self.problem.names, self.problem.samples, strict=True)
        return {n: float(v) for n, v in pairs}

    def matrix(self, samples: Mapping[str, float]) -> Array:
        """Information over the shared unknowns and all hypotheses, in their scales.

        ``samples``: number of values by output of all records that are diagnosed together.
        """
        known = self._shares(samples)
        share = np.array([known[n] for n in self.problem.names])
        key = share.tobytes()
        if key not in self._known:
            self._known[key] = self._computed(share)
        return self._known[key]

    def _shares(self, samples: Mapping[str, float]) -> dict[str, float]:
        """Inverse variance of one value of each channel in units of the noise of its sensor."""
        belief, sd = (
            self.study.belief,
            dict(zip(self.problem.names, self.problem.noise, strict=True)),
        )
        number = np.maximum(np.array(list(samples.values())), 1.0)
        square = np.ones(number.size)
        for i, name in enumerate(samples):
            noise, left = (0.0, 0.0) if belief is None else belief.left.get(name, (0.0, 0.0))
            square[i] += max(left**2 - noise**2, 0.0) / (sd.get(name) or noise or 1.0) ** 2
        random = 1.0 / number
        return dict(
            zip(
                samples,
                precision(square, random, self.problem.discrepancy_samples) / number,
                strict=True,
            )
        )

    def _computed(self, share: Array) -> Array:
        study, problem = self.study, self.problem
        normal = system(
            problem,
            problem.fit,
            study.members,
            self.point,
            self.linears,
            np.ones(share.size),
            share,
        )
        full = np.block([[normal.matrix, normal.further.T], [normal.further, normal.own]])
        # Parameters of the model that only this record has (its variation) are eliminated too.
        shared = len(study.problem.free)
        alone = np.arange(shared, len(problem.free))
        if alone.size:
            weight = prior_of(problem, study.members).weights(self.point.x)[alone]
            inner = full[np.ix_(alone, alone)] + np.diag(weight)
            full = full - full[:, alone] @ np.linalg.solve(inner, full[alone])
            full = np.delete(np.delete(full, alone, axis=0), alone, axis=1)
        matrix = study_rows(study, len(full)) @ full @ study_rows(study, len(full)).T
        return np.asarray(0.5 * (matrix + matrix.T))


def study_rows(study: Study, columns: int) -> Array:
    """Shared unknowns and hypotheses (rows) as combinations of linearized unknowns (columns)."""
    rows, at = np.zeros((study.x.size + len(study.hypotheses), columns)), study.x.size
    rows[:at, :at] = np.eye(at)
    free, effect = list(study.problem.free), at
    for k, (c, scale) in enumerate(zip(study.causes, study.scales, strict=True), at):
        if c.parameter is not None:
            place = free.index(c.parameter)
            ratio = c.alias.tolerance_ratio if c.alias else 1.0
            rows[k, place] = scale * ratio / study.problem.unit[place]
        else:
            rows[k, effect] = 1.0
            effect += 1
    return rows


@dataclass(frozen=True, eq=False)
class Knowledge:
    """Combined information of priors, records, and tests of parts."""

    study: Study
    records: tuple[Information, ...] = ()
    tests: tuple[Array, ...] = ()
    """Information of tests of parts."""
    before: Array | None = None
    """Matrix G of the records whose evidence the belief already contains."""
    aim: Aim = "names"

    @cached_property
    def value(self) -> float:
        """What an experiment increases, by its aim."""
        return self.names() if self.aim == "names" else self.sizes()

    def plus(self, *more: Information | Array) -> Knowledge:
        """Knowledge with further records and tests of parts."""
        return replace(
            self,
            records=(*self.records, *(m for m in more if isinstance(m, Information))),
            tests=(*self.tests, *(m for m in more if not isinstance(m, Information))),
        )

    def test(self, name: str, sd: float) -> Array:
        """Information of a test of a parameter or effect by itself, with its standard deviation.

        The test of a parameter measures the sum of its deviation and of the effects that change the
        same number.
        """
        study = self.study
        row = np.zeros(study.x.size + len(study.hypotheses))
        for k, i in enumerate(study.problem.free):
            row[k] = study.problem.unit[k] * (study.model.parameters[i].name == name)
        for k, (c, scale) in enumerate(zip(study.causes, study.scales, strict=True)):
            e = c.effect or c.alias
            same = e is not None and e.tolerance_parameter == name
            row[study.x.size + k] = scale * (e.tolerance_ratio if e and same else c.name == name)
        return np.outer(row, row) / sd**2

    @cached_property
    def matrix(self) -> Array:
        """Information with the priors of the shared unknowns."""
        study, samples = self.study, dict[str, float]()
        for r in self.records:
            for n, count in r.samples.items():
                samples[n] = samples.get(n, 0.0) + count
        size = study.x.size + len(study.hypotheses)
        out = np.zeros((size, size))
        at = np.arange(study.x.size)
        prior = prior_of(study.problem, study.members).weights(study.x)
        out[at, at] = np.where(prior > LEAST_PRIOR, prior, NO_PRIOR)
        for r in self.records:
            out += r.matrix(samples)
        return np.asarray(out + sum(self.tests))

    @cached_property
    def gram(self) -> Array:
        """Matrix G of the hypotheses, in scales; all shared unknowns are projected out."""
        n = self.study.x.size
        pp, pe, ee = self.matrix[:n, :n], self.matrix[:n, n:], self.matrix[n:, n:]
        unit = 1.0 / np.sqrt(np.diag(pp))
        scaled = pe * unit[:, None]
        out = ee - scaled.T @ np.linalg.solve(pp * np.outer(unit, unit), scaled)
        # If parameters imitate a column, the remainder is rounding.
        bad = np.diag(out) < 1e-9 * np.maximum(np.diag(ee), 1e-300)
        out[bad, :] = 0.0
        out[:, bad] = 0.0
        return np.asarray(0.5 * (out + out.T))

    @cached_property
    def beliefs(self) -> Array:
        """Posterior probability that each hypothesis would get if it were right, (k,)."""
        study = self.study
        weights, none = study.possible, max(study.weights[1], 1e-3)
        against, occam = _against(self.gram), np.log1p(np.diag(self.gram))
        alone = np.diag(self.gram)
        if self.before is not None:
            against = against - _against(self.before)
            occam = occam - np.log1p(np.diag(self.before))
            alone = alone - np.diag(self.before)
        _, number = np.unique(study.names, return_inverse=True)
        same = number[:, None] == number[None, :]
        weight = same @ weights
        total = np.zeros(number.size)
        sizes = self._magnitudes()
        for size in sizes:
            rivals = np.exp(-np.maximum(size[:, None] ** 2 * against, 0.0))
            rest = np.where(same, 0.0, rivals) @ weights
            rest += none * np.exp(-np.maximum(0.5 * (size**2 * alone - occam), 0.0))
            total += weight / (weight + rest)
        return np.asarray(total / len(sizes))

    def _magnitudes(self) -> Array:
        """Magnitudes at which each hypothesis is expected [scales], (m, k).

        A cause that the diagnosed records do not show can only be below its detectable magnitude.
        """
        out = np.tile(np.array(MAGNITUDES)[:, None], (1, len(self.study.hypotheses)))
        if self.before is not None:
            out = np.minimum(out, self._smallest(self.before))
        return np.where(self._fitted > 0.0, self._fitted, out)

    @cached_property
    def _fitted(self) -> Array:
        """Fitted magnitude of each hypothesis [scales], (k,); 0: it was not fitted."""
        known = {} if self.study.belief is None else self.study.belief.magnitudes
        return np.array([known.get(str(n), 0.0) for n in self.study.names]) / self.study.scales

    @property
    def expected(self) -> Array:
        """Expected magnitude of each hypothesis: as fitted, else its scale [scales], (k,)."""
        return np.where(self._fitted > 0.0, self._fitted, 1.0)

    def names(self) -> float:
        """Expected posterior probability of the right cause [1]: T-optimality."""
        return float(self.study.possible @ self.beliefs)

    def sizes(self) -> float:
        """Expected information on all magnitudes [log evidence]: D-optimality."""
        return 0.5 * float(np.linalg.slogdet(np.eye(len(self.gram)) + self.gram)[1])

    def _smallest(self, gram: Array) -> Array:
        """Magnitude from which a cause is named rather than that nothing is missing [scales]."""
        alone = np.diag(gram)
        needed = NAMED - np.log(self.study.odds) + 0.5 * np.log1p(alone)
        with np.errstate(divide="ignore"):
            return np.asarray(np.sqrt(2.0 * np.maximum(needed, 0.0) / alone))

    @cached_property
    def smallest(self) -> Array:
        """Smallest detectable magnitude of each hypothesis [its unit], (k,); inf: none is."""
        return np.asarray(self._smallest(self.gram) * self.study.scales)

    @property
    def detected(self) -> NDArray[np.bool_]:
        """Whether each hypothesis is detectable at its expected magnitude, (k,)."""
        return np.asarray(self.expected >= self._smallest(self.gram))

    @cached_property
    def chance(self) -> Array:
        """Probability that a diagnosis leaves a rival (column) if a cause (row) is right, (k, k).

        Both are equally probable before, and the cause has its expected magnitude.
        """
        out = 1.0 / (
            1.0 + np.exp(np.minimum(self.expected[:, None] ** 2 * _against(self.gram), 700))
        )
        out[self.study.names[:, None] == self.study.names[None, :]] = 0.0
        return np.asarray(out)

    def inseparable(self) -> tuple[tuple[str, ...], ...]:
        """Groups of detectable causes that a diagnosis could not tell apart."""
        names, shown = self.study.names, self.detected
        alike = (self.chance > 1.0 - DEFAULTS.credibility) & np.outer(shown, shown)
        count, label = csgraph.connected_components(alike, directed=False)
        groups = [{str(n) for n in names[label == k]} for k in range(count)]
        return tuple(sorted(tuple(sorted(g)) for g in groups if len(g) > 1))

    def spread(self) -> dict[str, float]:
        """Standard deviation of each fitted parameter if nothing is missing [its unit]."""
        study, n = self.study, self.study.x.size
        sd = np.sqrt(np.maximum(np.diag(np.linalg.inv(self.matrix[:n, :n])), 0.0))
        names = [study.model.parameters[i].name for i in study.problem.free]
        return dict(zip(names, study.problem.unit * sd[: len(names)], strict=True))


def _against(gram: Array) -> Array:
    """Expected log evidence of each hypothesis (row) at one scale against each other (column)."""
    alone = np.diag(gram)
    taken = gram**2 / (alone + PRIOR_WIDTH**-2)[None, :]
    return np.asarray(0.5 * np.maximum(alone[:, None] - taken, 0.0))
