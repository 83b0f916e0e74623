"""A model that includes effects: what was a cause to be found is now one more parameter."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from feltmb.arguments import checked
from feltmb.data import Array, Record
from feltmb.errors import InvalidParameter
from feltmb.fit.model import (
    Effect,
    Integers,
    Job,
    Lanes,
    Model,
    Parameter,
    Ready,
    Sensitivity,
    Simulated,
    State,
    Term,
    check_windows,
)

__all__ = ["Including", "including"]


@checked
def including(
    model: Model, terms: Sequence[Term | Effect], sizes: Sequence[float] | None = None
) -> Including:
    """The model with effects as part of it, to be fitted and diagnosed in its turn.

    Parameters
    ----------
    terms
        Effects (their first shape counts) or terms; ``report.model.terms`` of a diagnosis.
    sizes
        Where their fit starts [units of the effects], in the same order; default: zero.

    Raises
    ------
    InvalidParameter
        The model cannot simulate one of them, or it is an effect of a sensor or an input: there
        the records must be mended, not the model.
    """
    chosen = tuple(t if isinstance(t, Term) else Term(t, t.shapes[0]) for t in terms)
    values = np.zeros(len(chosen)) if sizes is None else np.asarray(sizes, dtype=np.float64)
    faults = []
    if values.shape != (len(chosen),):
        faults.append(f"{values.size} sizes for {len(chosen)} effects")
    names = [p.name for p in model.parameters]
    for t in chosen:
        if t.effect.observe is not None or t.effect.excite is not None:
            faults.append(f"{t.name} is no part of the machine: mend the records instead")
        elif not model.accepts(t.effect):
            faults.append(f"the model {model.name} cannot simulate {t.name}")
        if t.name in names:
            faults.append(f"{t.name} is the name of a parameter already")
        names.append(t.name)
    if faults:
        raise InvalidParameter("including: " + "; ".join(faults))
    return Including(model, chosen, values)


@checked
class Including(Model):
    """See :func:`including`; sizes of the effects are its last parameters, without a prior."""

    def __init__(self, model: Model, terms: tuple[Term, ...], sizes: Array):
        if sizes.shape != (len(terms),):
            raise InvalidParameter(
                f"including: sizes has shape {sizes.shape}, expected {(len(terms),)}"
            )
        self._base = model
        self._own = terms
        self._sizes = sizes
        self.name = f"{model.name} with {', '.join(t.name for t in terms)}"
        self.parameters = model.parameters + tuple(
            Parameter(
                name=t.name,
                value=float(np.clip(size, *t.effect.bounds)),
                unit=t.effect.unit,
                lower=t.effect.bounds[0],
                upper=t.effect.bounds[1],
                component=t.effect.component,
                scale=t.effect.scale,
            )
            for t, size in zip(terms, sizes, strict=True)
        )
        self.outputs = model.outputs
        self.units = model.units
        self.least_samples = model.least_samples
        self.ports = model.ports
        self.window = model.window
        self.difference_step = model.difference_step
        self.chaotic = model.chaotic
        self.from_rest = model.from_rest
        self.together = model.together
        self.input_modes = model.input_modes
        self.inputs = tuple(getattr(model, "inputs", ()))

    def states(self, terms: Sequence[Term] = ()) -> tuple[State, ...]:
        """States of the model, hidden ones of the included effects, those of the terms."""
        states = self._base.states((*self._own, *terms))
        mine = len(self._base.states(self._own))
        return tuple(replace(s, hidden=False) if i < mine else s for i, s in enumerate(states))

    def forget(self) -> None:
        """That of the model."""
        self._base.forget()

    def ready(self, records: Sequence[Record]) -> Ready:
        """The ready model with the same effects."""
        base = self._base.ready(records)
        return replace(base, model=Including(base.model, self._own, self._sizes))

    def accepts(self, effect: Effect) -> bool:
        """What the model accepts, but for what it includes."""
        return effect.name not in [t.name for t in self._own] and self._base.accepts(effect)

    def guess(self, record: Record, windows: Integers) -> Array:
        """As the model guesses; hidden states at their prior mean."""
        states = self.states()
        starts = np.tile([s.start for s in states], (len(windows), 1))
        seen = self._base.guess(record, windows)
        starts[:, : seen.shape[1]] = seen
        return starts

    def events(self, record: Record, outputs: Mapping[str, Array]) -> list[tuple[str, float]]:
        """As the model finds them."""
        return self._base.events(record, outputs)

    def simulate(self, record: Record, lanes: Lanes) -> Simulated:
        """See :class:`~feltmb.fit.Model`."""
        return self._base.simulate(record, self._inner(lanes))

    def _inner(self, lanes: Lanes) -> Lanes:
        """Lanes of the model: what is included is among its terms."""
        count = len(self._base.parameters)
        sizes = lanes.sizes if lanes.terms else np.zeros((lanes.count, 0))
        return replace(
            lanes,
            theta=lanes.theta[:, :count],
            terms=(*self._own, *lanes.terms),
            sizes=np.hstack([lanes.theta[:, count:], sizes]),
        )

    def finer(self, jobs: Sequence[Job]) -> Model:
        """See :class:`~feltmb.fit.Model`."""
        base = self._base.finer([(record, self._inner(lanes)) for record, lanes in jobs])
        return self if base is self._base else Including(base, self._own, self._sizes)

    @property
    def core(self) -> Model:
        """That of the model."""
        return self._base.core

    def asking(self, ask: Callable[[Sequence[Job]], list[Simulated]]) -> Model:
        """See :class:`~feltmb.fit.Model`."""
        out = copy.copy(self)
        out._base = self._base.asking(ask)
        return out

    def sensitivities(
        self,
        record: Record,
        theta: Array,
        windows: Integers,
        starts: Array,
        terms: tuple[Term, ...] = (),
        sizes: Array | None = None,
        *,
        by_theta: Sequence[int] | None = None,
        by_starts: bool = True,
        candidates: tuple[Term, ...] = (),
    ) -> Sensitivity:
        """Those of the model; the derivatives by the included sizes move to the parameters."""
        given = np.zeros(len(terms)) if sizes is None else sizes
        check_windows(self, record, windows, starts, terms, given, theta)
        count, own = len(self._base.parameters), len(self._own)
        wanted = list(range(count + own)) if by_theta is None else list(by_theta)
        base = [i for i in wanted if i < count]
        s = self._base.sensitivities(
            record,
            theta[:count],
            windows,
            starts,
            (*self._own, *terms),
            np.concatenate([theta[count:], given]),
            by_theta=base,
            by_starts=by_starts,
            candidates=candidates,
        )
        order = [base.index(i) if i < count else len(base) + i - count for i in wanted]
        by_outputs = np.concatenate([s.d_theta, s.d_sizes[..., :own]], axis=-1)
        by_ends = np.concatenate([s.d_theta_ends, s.d_sizes_ends[..., :own]], axis=-1)
        return replace(
            s,
            d_theta=by_outputs[..., order],
            d_theta_ends=by_ends[..., order],
            d_sizes=s.d_sizes[..., own:],
            d_sizes_ends=s.d_sizes_ends[..., own:],
        )
