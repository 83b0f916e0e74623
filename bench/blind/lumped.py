"""Networks of lumped masses with exact sensitivities: description by names, one call a batch.

A description names its parameters; a :class:`Network` turns it into the arrays of the C++ extension
``blind._network`` (folder ``network``), which is built at the first import: fixed-step Runge-Kutta
4, derivatives of the discrete scheme by forward differentiation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from blind.build import build_network
from unmodeled.errors import InvalidParameter

build_network()

from blind._network import LumpedNetwork  # noqa: E402

__all__ = ["Network"]

Array = NDArray[np.float64]

_SUMS = {
    "contact": ("offset", "stiffness", "exponent", "loss"),
    "spring": ("offset", "stiffness", "damping", "cubic"),
    "friction": ("viscous", "coulomb", "sliding_speed", "quadratic"),
    "drive": ("constant",),
}


class Network:
    """Masses joined by contacts, springs, friction and drives, seen by sensors.

    Parameters
    ----------
    description
        ``masses``: {coordinate: value}. ``elements``: list of dicts with ``name``, ``kind``
        (contact, spring, friction, drive), ``coordinates`` {name: factor}, ``hidden`` {name:
        factor}, ``input`` factor, and the values of the kind; contacts may have ``gates`` (dicts
        with ``coordinates``, ``offset``, ``width``). ``hidden``: {name: {kind: lag|mode, sources:
        [element], gain, time (lag: s) or omega (mode: rad/s), damping}}. ``sensors``: {output:
        {coordinates, hidden, offset, scale, gauge_offset, delay, flexibility, element}}.
        ``input``: {gain, offset, delay}. A value is a number, the name of a parameter or a list of
        them, which is summed; ``-name`` subtracts.
    parameters
        Names, in the order of the parameter vectors of :meth:`simulate`. Units: SI.
    sample_time
        Of inputs and outputs [s].
    substeps
        Steps of the integrator a sample.
    """

    def __init__(
        self,
        description: Mapping[str, Any],
        parameters: Sequence[str],
        *,
        sample_time: float,
        substeps: int = 4,
    ) -> None:
        self.parameters = tuple(parameters)
        self._index = {name: i for i, name in enumerate(self.parameters)}
        self._constants: list[float] = []
        self.coordinates = tuple(description["masses"])
        self.elements = tuple(e["name"] for e in description["elements"])
        hidden = description.get("hidden", {})
        self.hidden = tuple(hidden)
        self.outputs = tuple(description["sensors"])
        self.sample_time = sample_time
        core: dict[str, Any] = {
            "masses": [self._sum(m) for m in description["masses"].values()],
            "elements": [self._element(e) for e in description["elements"]],
            "hidden": [
                {
                    "mode": h["kind"] == "mode",
                    "sources": [self._place(s, self.elements, "element") for s in h["sources"]],
                    "gain": self._sum(h["gain"]),
                    "time": self._sum(h["omega"] if h["kind"] == "mode" else h["time"]),
                    "damping": self._sum(h.get("damping", 0.0)),
                }
                for h in hidden.values()
            ],
            "sensors": [self._sensor(s) for s in description["sensors"].values()],
            "input": {k: self._sum(v) for k, v in description.get("input", {}).items()},
            "sample_time": sample_time,
            "substeps": substeps,
        }
        core["parameters"] = len(self.parameters) + len(self._constants)
        self._core = LumpedNetwork(core)
        self.states: tuple[str, ...] = (
            *self.coordinates,
            *(f"{q}_speed" for q in self.coordinates),
        )
        for name, h in hidden.items():
            self.states += (name, f"{name}_rate") if h["kind"] == "mode" else (name,)

    def _place(self, name: str, names: Sequence[str], what: str) -> int:
        if name not in names:
            raise InvalidParameter(
                f"lumped network: no {what} {name!r}; there is {', '.join(names)}"
            )
        return list(names).index(name)

    def _sum(self, value: Any) -> list[tuple[int, float]]:
        if isinstance(value, str):
            sign, name = (-1.0, value[1:]) if value.startswith("-") else (1.0, value)
            return [(self._place(name, self.parameters, "parameter"), sign)]
        if isinstance(value, (list, tuple)):
            return [candidate for v in value for candidate in self._sum(v)]
        if value == 0.0:
            return []
        self._constants.append(float(value))
        return [(len(self.parameters) + len(self._constants) - 1, 1.0)]

    def _travel(self, d: Mapping[str, Any]) -> dict[str, Any]:
        return {
            "coordinates": [
                (self._place(q, self.coordinates, "coordinate"), float(f))
                for q, f in d.get("coordinates", {}).items()
            ],
            "hidden": [
                (self._place(h, self.hidden, "hidden state"), float(f))
                for h, f in d.get("hidden", {}).items()
            ],
            "input": float(d.get("input", 0.0)),
            "offset": self._sum(d.get("offset", 0.0)),
        }

    def _element(self, d: Mapping[str, Any]) -> dict[str, Any]:
        if d["kind"] not in _SUMS:
            raise InvalidParameter(
                f"lumped network: element of kind {d['kind']!r}, expected {', '.join(_SUMS)}"
            )
        core = {"kind": d["kind"], **self._travel(d)}
        core.update({k: self._sum(d.get(k, 0.0)) for k in _SUMS[d["kind"]]})
        core["gates"] = [
            {**self._travel(g), "width": self._sum(g["width"])} for g in d.get("gates", ())
        ]
        return core

    def _sensor(self, d: Mapping[str, Any]) -> dict[str, Any]:
        core = self._travel(d)
        for key in ("scale", "gauge_offset", "delay", "flexibility"):
            core[key] = self._sum(d.get(key, 0.0))
        if "element" in d:
            core["element"] = self._place(d["element"], self.elements, "element")
        return core

    def simulate(
        self,
        parameters: Array,
        inputs: Sequence[Array],
        segments: NDArray[np.intc],
        starts: Array,
        *,
        wanted: Sequence[int] = (),
        wanted_states: Sequence[int] = (),
        forces: bool = False,
        unknown: Array | None = None,
    ) -> tuple[Array, Array, Array, Array, Array]:
        """Simulate segments from their start states.

        Parameters
        ----------
        parameters
            (rows, parameters), SI.
        inputs
            Recorded inputs, each (n,).
        segments
            (S, 4): input, first sample, number of sample steps, row of the parameters.
        starts
            (S, states), in the order of ``states``.
        wanted, wanted_states
            Parameters and start states (indices) to differentiate by.
        forces
            Whether the forces of the elements are wanted.
        unknown
            Forces on the coordinates [N], (S, coordinates, knots), linear between knots.

        Returns
        -------
        outputs (sum of steps + 1, outputs); ends (S, states); d_outputs and d_ends with a last
        axis of columns: parameters wanted, then start states wanted; forces (samples, elements).
        """
        rows = np.atleast_2d(parameters)
        full = np.hstack([rows, np.tile(self._constants, (rows.shape[0], 1))])
        result: tuple[Array, Array, Array, Array, Array] = self._core.simulate(
            full,
            list(inputs),
            segments,
            starts,
            list(wanted),
            list(wanted_states),
            forces,
            unknown,
        )
        return result
