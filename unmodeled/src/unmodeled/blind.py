"""How often a diagnosis is right on the user's own machine: known effects are withheld from it.

Each case draws the parameters of the model from their priors, adds one effect of the list with a
magnitude from its prior, and simulates the inputs of the records with the noise of their sensors.
The diagnosis gets the simulated records only. Machine and model share their equations, so that the
result is an upper bound: a real machine differs from its model in more than one effect.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from unmodeled.arguments import checked
from unmodeled.chain import fault_of
from unmodeled.data import Array, Record
from unmodeled.diagnosis import diagnose
from unmodeled.errors import DataError, Error, InvalidParameter
from unmodeled.fit.observe import observe
from unmodeled.models.model import Candidate, Effect, Model, Ready
from unmodeled.search.fit import empty_point
from unmodeled.search.linear import EvaluationRequest, start_states, theta_at
from unmodeled.search.options import Options
from unmodeled.search.problem import Problem
from unmodeled.search.records import noise_of_channel, prepare, ready_records, split_records
from unmodeled.search.result import OUTCOMES, Case, Reason, Result, Verdict
from unmodeled.search.search import model_alone

#: Norm of the change of the records by an effect from which it is clear [standard deviations].
CLEAR = 5.0


@dataclass(frozen=True)
class Withheld:
    """Cases of :func:`withhold`, and how often the diagnosis was right."""

    cases: tuple[Case, ...]

    def shares(self) -> dict[str, tuple[float, float, float, int]]:
        """Shares with their 95 % intervals (Wilson), and the number of cases.

        Outcomes among the cases with a clear effect (a signal-to-noise ratio of at least 5), quiet
        ones and false alarms among those without an effect, and "intervals" that contain the truth.
        """
        clear = [c.outcome for c in self.cases if c.effect and c.signal_to_noise >= CLEAR]
        empty = [c.outcome for c in self.cases if not c.effect]
        hits = {word: (clear.count(word), len(clear)) for word in OUTCOMES[:5]}
        hits |= {word: (empty.count(word), len(empty)) for word in OUTCOMES[5:7]}
        covered, intervals = (sum(getattr(c, k) for c in self.cases)
                              for k in ("covered", "intervals"))  # fmt: skip
        hits["intervals"] = covered, intervals
        return {word: _share(*pair) for word, pair in hits.items() if pair[1]}

    def rows(self) -> list[dict[str, Any]]:
        """One row per effect: cases, median signal-to-noise ratio, number of each outcome."""
        out = []
        for name in dict.fromkeys(c.effect for c in self.cases):
            cases = [c for c in self.cases if c.effect == name]
            row: dict[str, Any] = {"effect": name, "cases": len(cases)}
            row["signal_to_noise"] = float(np.median([c.signal_to_noise for c in cases]))
            out.append(row | {word: sum(c.outcome == word for c in cases) for word in OUTCOMES})
        return out

    def as_dict(self) -> dict[str, Any]:
        """Results as plain data for JSON."""
        return {
            "shares": self.shares(),
            "rows": self.rows(),
            "cases": [asdict(c) for c in self.cases],
        }


def _share(hits: int, count: int) -> tuple[float, float, float, int]:
    from scipy.stats import binomtest

    interval = binomtest(hits, count).proportion_ci(method="wilson")
    return hits / count, float(interval.low), float(interval.high), count


def _outcome(effect: str, result: Result) -> str:
    """One of :data:`OUTCOMES`, given the name of the withheld effect."""
    answer = [(n,) for n in result.named] + list(result.classes)
    if not answer:
        quiet = "silent" if effect else "quiet"
        return "unknown" if result.verdict is Verdict.UNKNOWN else quiet
    if not effect:
        return "false alarm"
    contained = len(answer) == 1 and effect in {n.cause for n in answer[0]}
    return "wrong" if not contained else "right" if result.named else "class"


@checked
def withhold(
    model: Model,
    effects: Sequence[Effect],
    records: Sequence[Record],
    *,
    cases: int | None = None,
    seed: int = 0,
    only: Sequence[str] | None = None,
    hold_out: Sequence[str] | None = None,
    options: Options | None = None,
    progress: Callable[[int, int, Case], None] | None = None,
) -> Withheld:
    """Withhold effects of a list in turn and count how often the diagnosis is right.

    Parameters
    ----------
    model, effects, records
        As in :func:`unmodeled.diagnose`. Inputs, times, sensors and noise of the records are used;
        the measured outputs are replaced. Unknown start states, and parameters without a prior, are
        those of a fit of the model to the measured outputs.
    cases
        Number of cases; default: one without an effect and one for each effect, in turn.
    seed
        Seed of all random numbers, together with the number of the case.
    only
        Names of the effects that are withheld; default: all. The diagnosis always gets all effects.
    hold_out
        Held-out records, as in :func:`unmodeled.diagnose`.
    options
        Options of each diagnosis.
    progress
        ``progress(done, total, case)`` is called after every case. Ctrl-C ends the run; the result
        has the finished cases.

    Raises
    ------
    InvalidParameter, DataError
        Arguments are out of range, or model, effects and records do not fit together.
    """
    known = {e.name: e for e in effects}
    turns = ["", *(known if only is None else only)]
    total = len(turns) if cases is None else cases
    unknown = ", ".join(n for n in turns[1:] if n not in known)
    if unknown:
        raise InvalidParameter(f"only: no effect {unknown}; there are {', '.join(known) or 'none'}")
    if total < 1 or seed < 0:
        raise InvalidParameter(f"cases = {total}, seed = {seed}: expected >= 1 and >= 0")
    split_records(records, hold_out)
    machine = _machine(ready_records(model, records), effects, options or Options())
    done: list[Case] = []
    for number in range(total):
        effect = known.get(turns[number % len(turns)])
        rng = np.random.default_rng([seed, number])
        try:
            done.append(machine.diagnosed(number, effect, rng, hold_out))
        except KeyboardInterrupt:
            if not done:
                raise
            break
        if progress is not None:
            progress(len(done), total, done[-1])
    return Withheld(tuple(done))


@dataclass(frozen=True)
class _Machine:
    """A model that generates records instead of measurements."""

    problem: Problem
    """All records are fitted ones."""
    effects: Sequence[Effect]
    options: Options
    theta: Array
    """Parameters [their units]; those without a prior are used."""
    starts: tuple[Array, ...]
    """Start states of the records [their units]; those without a prior are used."""

    def diagnosed(
        self,
        number: int,
        effect: Effect | None,
        rng: np.random.Generator,
        hold_out: Sequence[str] | None,
    ) -> Case:
        """One case."""
        case = Case(number, "" if effect is None else effect.name, 0.0, "", 0.0)
        given, theta = () if effect is None else (_drawn(effect, rng),), self._parameters(rng)
        try:
            shown, ratio = self._records(theta, given, rng)
            for candidate, size in given:
                case = replace(case, magnitude=size, unit=candidate.effect.unit)
            case = replace(case, signal_to_noise=ratio)
            model, options = self.problem.model, self.options
            report = diagnose(model, self.effects, shown, hold_out=hold_out, options=options)
        except Error as fault:
            return replace(case, error=str(fault))
        if Reason.INTERRUPTED in report.reasons:
            raise KeyboardInterrupt  # the diagnosis has answered it with its fits so far
        true = {p.name: v for p, v in zip(model.parameters, theta, strict=True)}
        for e in (e for e in self.effects if e.name == case.effect):
            if e.tolerance_parameter in true:  # one number has both deviations
                true[e.tolerance_parameter] += e.tolerance_ratio * case.magnitude
        answer = [(n,) for n in report.named] + list(report.classes)
        within = [p.low <= true[p.name] <= p.high for p in report.parameters]
        within += [n.low <= case.magnitude <= n.high for group in answer for n in group
                   if n.cause == case.effect and not n.parameter]  # fmt: skip
        return replace(
            case,
            outcome=_outcome(case.effect, report),
            verdict=report.verdict.name,
            answer=tuple(tuple(n.cause for n in group) for group in answer),
            covered=int(sum(within)),
            intervals=len(within),
        )

    def _parameters(self, rng: np.random.Generator) -> Array:
        """Parameters from their priors."""
        z, parameters = rng.standard_normal(self.theta.size), self.problem.model.parameters
        drawn = [p.value + p.sd * v if math.isfinite(p.sd) else known
                 for p, known, v in zip(parameters, self.theta, z, strict=True)]  # fmt: skip
        return np.asarray(
            np.clip(drawn, [p.lower for p in parameters], [p.upper for p in parameters])
        )

    def _records(
        self, theta: Array, given: _Given, rng: np.random.Generator
    ) -> tuple[list[Record], float]:
        """Records of a machine with an effect, and the signal-to-noise ratio of the effect."""
        model = self.problem.model
        shown, square = [], 0.0
        for observed, known in zip(self.problem.fit, self.starts, strict=True):
            record, start = observed.as_measured, known.copy()
            for q in (q for q in observed.local if q.kind == "start" and q.weight > 1e-4):
                start[q.index] = q.mean + q.scale * rng.standard_normal()
            perturbed = theta + [p.process_sd * rng.standard_normal() for p in model.parameters]
            clean, y = (_outputs(model, record, perturbed, start, some) for some in ((), given))
            outputs: dict[str, Array] = {}
            drawn: dict[tuple[str, float], float] = {}
            for c, name in zip(self.problem.channels, self.problem.names, strict=True):
                if name not in record.outputs:
                    continue
                measured = np.isfinite(record.outputs[name])
                if not np.isfinite(y[measured, c]).all():
                    raise InvalidParameter(
                        f"record {record.name}: the machine gives no number for {name} at drawn "
                        "parameters"
                    )
                change = (y[:, c] - clean[:, c]) / noise_of_channel(record, name).sd(clean[:, c])
                square += float(np.sum(change[measured] ** 2))
                outputs[name] = np.where(
                    measured, _readings(record, name, y[:, c], drawn, rng), np.nan
                )
            inputs = {k: u + record.input_sigma.get(k, 0.0) * rng.standard_normal(u.size)
                      for k, u in record.inputs.items()}  # fmt: skip
            sensors = {k: v for k, v in record.sensors.items() if k in outputs}
            shown.append(replace(record, outputs=outputs, inputs=inputs, sensors=sensors))
        return shown, math.sqrt(square)


#: An effect and its magnitude, or nothing.
_Given = tuple[tuple[Candidate, float], ...]


def _machine(ready: Ready, effects: Sequence[Effect], options: Options) -> _Machine:
    for r in ready.records:
        for n, y in r.outputs.items():
            if r.sensors[n].sigma is None and np.unique(y[np.isfinite(y)]).size < 2:
                raise DataError(
                    f"record {r.name}: nothing was measured of {n}, and its sensor has no noise; "
                    "expected sigma, or a measured record"
                )
    problem = prepare(ready, effects, (), options)
    planned = not problem.motion.any()
    point = empty_point(problem, (), problem.fit) if planned else model_alone(problem).point
    ask = EvaluationRequest((), point, problem.fit)
    starts = tuple(start_states(problem, ask, r) for r in range(len(problem.fit)))
    return _Machine(problem, effects, options, theta_at(problem, point.x), starts)


def _drawn(effect: Effect, rng: np.random.Generator) -> tuple[Candidate, float]:
    """A shape of an effect, and a magnitude from its prior: normal, within its limits."""
    shape = effect.shapes[int(rng.integers(len(effect.shapes)))]
    low, high = effect.bounds
    size = float(effect.scale * rng.standard_normal())
    size = size if low <= size <= high else -size  # half-normal distribution
    return Candidate(effect, shape), float(np.clip(size, low, high))


def _outputs(model: Model, record: Record, theta: Array, start: Array, given: _Given) -> Array:
    """Outputs of a machine, (n, ny)."""
    included = tuple(c for c, _ in given)
    states = [*start, *(s.start for s in model.states(included)[start.size :])]
    sizes = np.array([size for _, size in given])
    return observe(model, record, theta, np.array(states), included, sizes)


def _readings(
    record: Record,
    name: str,
    y: Array,
    drawn: dict[tuple[str, float], float],
    rng: np.random.Generator,
) -> Array:
    """Readings of a sensor with its unknown errors and its noise.

    ``drawn``: sizes of faults that are common to channels, by fault and standard deviation.
    """
    sensor = record.sensors[name]
    for kind, sd in sensor.unknown.items():
        fault, size = fault_of(kind), drawn.get((kind, sd))
        if size is None:
            size = float(sd * rng.standard_normal())
        if fault.common:
            drawn[kind, sd] = size
        y = fault.act(record, y[None], size)[0]
    noise = noise_of_channel(record, name).without_rounding(sensor.quantum)
    y = y + noise.draw(record.time, rng, y)
    return np.round(y / sensor.quantum) * sensor.quantum if sensor.quantum > 0.0 else y
