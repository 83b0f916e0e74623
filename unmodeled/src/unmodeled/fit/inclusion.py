"""A model that includes effects: the magnitudes of the effects become parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from unmodeled.arguments import checked
from unmodeled.data import Array, Record
from unmodeled.errors import InvalidParameter
from unmodeled.models.elsewhere import Means, by_means, cached, resumed
from unmodeled.models.model import (
    Batch,
    Candidate,
    Effect,
    Jobs,
    Model,
    Parameter,
    Ready,
    Sensitivity,
    SensitivityRequest,
    State,
)
from unmodeled.models.writing import numbers, suffixes, text, write


@checked
def including(
    model: Model,
    included: Sequence[Candidate | Effect],
    magnitudes: Sequence[float] | None = None,
    sds: Sequence[float] | None = None,
) -> Including:
    """The model with effects as a part of it, which can be fitted and diagnosed like any model.

    Parameters
    ----------
    included
        Effects (their first shape counts) or included effects; ``report.model.included`` of a
        diagnosis.
    magnitudes
        Start values of their fit [units of the effects], in the same order; default: zero. With a
        prior, its mean.
    sds
        Standard deviations of the priors of the magnitudes [units of the effects], finite, > 0;
        default: no priors.

    Raises
    ------
    InvalidParameter
        A magnitude is out of the bounds of its effect. The model cannot simulate one of the
        effects. An effect is one of a sensor or an input: correct the records instead of the model.

    Examples
    --------
    A tank with a leak that is known by now, 0.01 1/s within 10 %:

    >>> from unmodeled import Equations, including, library
    >>> tank = Equations(
    ...     lambda t, x, u, p: (u.inflow,), states={"V": (0.0, 0.01, "m^3")},
    ...     inputs={"inflow": "m^3/s"},
    ... )
    >>> leaky = including(tank, [library.leak("V", scale=0.01)], [0.01], [0.001])
    >>> [p.name for p in leaky.parameters]
    ['leak V']
    """
    chosen = tuple(t if isinstance(t, Candidate) else Candidate(t, t.shapes[0]) for t in included)
    values = (
        np.zeros(len(chosen)) if magnitudes is None else np.asarray(magnitudes, dtype=np.float64)
    )
    widths = np.full(len(chosen), np.inf) if sds is None else np.asarray(sds, dtype=np.float64)
    if faults := _faults(model, chosen, values, widths):
        raise InvalidParameter("including: " + "; ".join(faults))
    out = Including(model, chosen, values)
    own = {t.name: w for t, w in zip(chosen, widths, strict=True)}
    return out.with_parameters({p.name: replace(p, sd=float(own[p.name])) for p in out.own})


def _faults(model: Model, chosen: Sequence[Candidate], values: Array, widths: Array) -> list[str]:
    """What prevents effects from being a part of a model."""
    faults = [
        f"{given.size} {what} for {len(chosen)} effects"
        for given, what in ((values, "magnitudes"), (widths, "standard deviations"))
        if given.shape != (len(chosen),)
    ]
    faults += [f"a standard deviation of {w:g}, expected > 0" for w in widths if not w > 0.0]
    if not faults:
        faults += [
            f"{t.name} = {v:g}, expected a value in [{t.effect.bounds[0]:g}, "
            f"{t.effect.bounds[1]:g}] {t.effect.unit}"
            for t, v in zip(chosen, values, strict=True)
            if not t.effect.bounds[0] <= v <= t.effect.bounds[1]
        ]
    names = [p.name for p in model.parameters]
    for t in chosen:
        if t.effect.observe is not None or t.effect.excite is not None:
            faults.append(f"{t.name} is not an effect of the machine: correct the records instead")
        elif not model.accepts(t.effect):
            faults.append(f"the model {model.name} cannot simulate {t.name}")
        if t.name in names:
            faults.append(f"{t.name} is the name of a parameter already")
        names.append(t.name)
    return faults


#: What is that of the model without the effects.
_AS_BASE = ("outputs", "units", "ports", "difference_step", "cheap_derivatives", "input_modes",
            "input_names", "any_inputs", "inputs", "effects")  # fmt: skip


@checked
class Including(Model):
    """Result of :func:`including`.

    Its last parameters are the magnitudes of the effects.
    """

    base: Model
    """The model without the effects."""
    included: tuple[Candidate, ...]
    """The effects."""

    def __init__(self, model: Model, included: tuple[Candidate, ...], magnitudes: Array):
        if magnitudes.shape != (len(included),):
            raise InvalidParameter(
                f"including: magnitudes has shape {magnitudes.shape}, expected {(len(included),)}"
            )
        self.base = model
        self.included = included
        self.name = f"{model.name} with {', '.join(t.name for t in included)}"
        self.parameters = model.parameters + tuple(
            Parameter(
                name=t.name,
                value=float(size),
                unit=t.effect.unit,
                lower=t.effect.bounds[0],
                upper=t.effect.bounds[1],
                component=t.effect.component,
                scale=t.effect.scale,
            )
            for t, size in zip(included, magnitudes, strict=True)
        )
        for name in _AS_BASE:
            setattr(self, name, getattr(model, name))

    def _with(self, base: Model) -> Including:
        """The same effects, with their parameters, in another version of the original model."""
        own = self.own
        out = Including(base, self.included, np.array([p.value for p in own]))
        out.parameters = base.parameters + own
        return out

    @property
    def own(self) -> tuple[Parameter, ...]:
        """Parameters that are the magnitudes of the effects."""
        return self.parameters[len(self.base.parameters) :]

    def with_parameters(self, parameters: Mapping[str, Parameter]) -> Including:
        """See :meth:`~unmodeled.fit.Model.with_parameters`."""
        names = {p.name for p in self.own}
        base = {n: p for n, p in parameters.items() if n not in names}
        out = self._with(self.base.with_parameters(base) if base else self.base)
        out.parameters = tuple(parameters.get(p.name, p) for p in out.parameters)
        return out

    def states(self, included: Sequence[Candidate] = ()) -> tuple[State, ...]:
        """States of the model, followed by the hidden states of all included effects."""
        states = self.base.states((*self.included, *included))
        mine = len(self.base.states(self.included))
        return tuple(replace(s, hidden=False) if i < mine else s for i, s in enumerate(states))

    def ready(self, records: Sequence[Record]) -> Ready:
        """The prepared model with the same effects."""
        base = self.base.ready(records)
        return replace(base, model=self._with(base.model))

    def tabulated(self) -> Including:
        """See :class:`~unmodeled.fit.Model`."""
        out = self._with(self.base.tabulated())
        out.parameters = self.parameters
        return out

    def accepts(self, effect: Effect) -> bool:
        """Whether the original model accepts an effect that is not yet included."""
        return effect.name not in [t.name for t in self.included] and self.base.accepts(effect)

    def found(
        self, theta: Array, included: Sequence[Candidate], magnitudes: Array
    ) -> tuple[Array, tuple[Candidate, ...], Array]:
        """Numbers of the original model: parameters, effects and their magnitudes."""
        count = len(self.base.parameters)
        sizes = np.concatenate([theta[count:], magnitudes])
        return theta[:count], (*self.included, *included), sizes

    def events(self, record: Record, outputs: Mapping[str, Array]) -> list[tuple[str, float]]:
        """Events of the original model."""
        return self.base.events(record, outputs)

    def simulate(self, record: Record, jobs: Jobs) -> Array:
        """See :class:`~unmodeled.fit.Model`."""
        return self.base.simulate(record, self._inner(jobs))

    def simulate_all(self, batches: Sequence[Batch]) -> list[Array]:
        """See :class:`~unmodeled.fit.Model`."""
        return self.base.simulate_all([(record, self._inner(jobs)) for record, jobs in batches])

    def motion(self, record: Record, jobs: Jobs) -> Array | None:
        """See :class:`~unmodeled.fit.Model`."""
        return self.base.motion(record, self._inner(jobs))

    def _inner(self, jobs: Jobs) -> Jobs:
        """The jobs of the original model."""
        count = len(self.base.parameters)
        sizes = [jobs.theta[:, count:], *([jobs.magnitudes] if jobs.included else [])]
        return replace(
            jobs,
            theta=jobs.theta[:, :count],
            included=(*self.included, *jobs.included),
            magnitudes=np.hstack(sizes),
        )

    def sensitivities(  # noqa: D102
        self, requests: Sequence[SensitivityRequest]
    ) -> list[Sensitivity]:
        # Derivatives of the original model; those by the included magnitudes become parameters.
        count = len(self.base.parameters)
        inner = []
        for request in requests:
            request.check(self)
            inner.append(
                replace(
                    request,
                    theta=request.theta[:count],
                    included=(*self.included, *request.included),
                    magnitudes=np.concatenate([request.theta[count:], request.sizes]),
                    by_theta=[i for i in request.parameters_of(self) if i < count],
                    shape_changes=tuple(
                        replace(c, effect=c.effect + len(self.included))
                        for c in request.shape_changes
                    ),
                )
            )
        found = self.base.sensitivities(inner)
        return [self._outer(r.parameters_of(self), s) for r, s in zip(requests, found, strict=True)]

    def _outer(self, wanted: tuple[int, ...], s: Sensitivity) -> Sensitivity:
        """Derivatives by the parameters of this model, from those of the original model."""
        count, own = len(self.base.parameters), len(self.included)
        base = [i for i in wanted if i < count]
        order = [base.index(i) if i < count else len(base) + i - count for i in wanted]
        by_outputs = np.concatenate([s.d_theta, s.d_magnitudes[..., :own]], axis=-1)
        return replace(
            s,
            d_theta=by_outputs[..., order],
            d_magnitudes=s.d_magnitudes[..., own:],
        )


@by_means.register
def _(model: Including, means: Means) -> Including:
    out = model._with(by_means(model.base, means))
    out.parameters = model.parameters
    return out


@cached.register
def _(model: Including) -> str:
    return cached(model.base)


@resumed.register
def _(model: Including) -> str:
    return resumed(model.base)


@text.register
def _(model: Including) -> str:
    return text(model.base)


@suffixes.register
def _(model: Including) -> tuple[str, ...]:
    return suffixes(model.base)


@write.register
def _(model: Including, path: Path, *found: Any, **given: Any) -> Path:
    # Written by the original model; its effects are part of the written effects.
    return write(model.base, path, *model.found(*found), **given)


@numbers.register
def _(model: Including, *found: Any) -> tuple[dict[str, float], dict[str, float]]:
    return numbers(model.base, *model.found(*found))
