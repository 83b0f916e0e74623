"""Couplings in a user's rates: pairs of coordinates between which a force acts.

A force F(q - r s) between the coordinates q and s with the inertias m and n gives q'' = -F / m and
s'' = r F / n. So each acceleration depends on the motion of the other body, and the ratio of both
derivatives is that of the inertias, wherever the bodies are. Where nothing else acts on one of the
bodies, its acceleration is constant along q = r s, which tells r.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from unmodeled.data import Array
from unmodeled.models.coordinates import Coordinate, Coupling, force_unit, has_si_forces
from unmodeled.units import same_unit

Values = Mapping[str, Array]
#: Step of central differences as a share of a value, with which rounding and curvature count alike.
STEP = float(np.cbrt(np.finfo(np.float64).eps))


@dataclass(frozen=True)
class Slopes:
    """Derivatives of rates by states, (points,)."""

    rates: Callable[[Values, Values], Values]
    """Rates by name of the state, from states and parameters."""
    states: Values
    parameters: Values

    def by(self, rate: str, state: str) -> Array:
        """Derivative of a rate by a state."""
        step = STEP * self.states[state]
        moved = ({**self.states, state: self.states[state] + s} for s in (step, -step))
        above, below = (self.rates(x, self.parameters)[rate] for x in moved)
        return (above - below) / (2.0 * step)

    def doubled(self, name: str) -> Slopes:
        """The derivatives with twice a parameter."""
        return replace(self, parameters={**self.parameters, name: 2.0 * self.parameters[name]})


@dataclass(frozen=True)
class Found:
    """Couplings in the rates."""

    couplings: tuple[Coupling, ...] = ()
    assumed: tuple[str, ...] = ()
    """Names of the couplings whose ratio is taken as 1, because the rates do not tell it."""
    untold: tuple[str, ...] = ()
    """Names of couplings that are left out, because nothing tells their ratio."""


def couplings_in(
    coordinates: Sequence[Coordinate], tabulated: Slopes, varied: Slopes, masses: Mapping[str, str]
) -> Found:
    """Couplings between coordinates, in the order of these.

    Parameters
    ----------
    coordinates
        Coordinates that may be coupled.
    tabulated, varied
        Derivatives with the tabulated parameters, and with other ones at each point.
    masses
        Units of the parameters that may be inertias, by name.
    """
    found: list[Coupling] = []
    assumed: list[str] = []
    untold: list[str] = []
    own = {n for c in coordinates for n in (c.position, c.speed)}
    between = [n for n in tabulated.states if n not in own]
    for one, other in itertools.combinations(coordinates, 2):
        with np.errstate(all="ignore"):
            pair = _pair(one, other, between, tabulated, varied)
            plain = all(has_si_forces(c.travel_unit) for c in (one, other))
            known = masses if plain else {}
            if not pair.ways or (inertias := _inertias(pair, tabulated, known)) is None:
                continue
            ratio, told = (pair.ratio, True) if pair.position else _ratio(pair, tabulated, varied)
        name = f"between {pair.first.name} and {pair.second.name}"
        if not told:
            (assumed if ratio else untold).append(name)
        if not ratio:
            continue
        parts = [
            replace(c, inertia=inertia, unit=force_unit(c.travel_unit, inertia))
            for c, inertia in zip((pair.first, pair.second), inertias, strict=True)
        ]
        found.append(
            Coupling(
                name=name,
                found=True,
                first=parts[0],
                second=parts[1],
                ratio=ratio,
                unit=parts[0].unit,
                position=pair.position,
                position_scale=pair.scale,
            )
        )
    return Found(tuple(found), tuple(assumed), tuple(untold))


@dataclass(frozen=True)
class _Pair:
    """Two coordinates, and the states by which their accelerations tell the force between them."""

    first: Coordinate
    second: Coordinate
    position: str = ""
    """State that is in proportion to the difference of both positions; empty: there is none."""
    scale: float = 1.0
    """Difference of the positions per value of this state."""
    ratio: float = 0.0
    """Ratio, if the rate of this state tells it."""
    ways: tuple[tuple[str, str], ...] = ()

    def pulls(self, slopes: Slopes, way: tuple[str, str]) -> tuple[Array, Array]:
        """Derivatives of both accelerations, which are in proportion to 1 / inertia."""
        factor = -self.ratio if way[0] == way[1] else 1.0
        return factor * slopes.by(self.first.speed, way[0]), slopes.by(self.second.speed, way[1])


def _pair(
    one: Coordinate,
    other: Coordinate,
    between: Sequence[str],
    tabulated: Slopes,
    varied: Slopes,
) -> _Pair:
    """The pair with the ways in which its accelerations depend on the other body.

    ``between``: states of no coordinate, one of which may be the deflection of the coupling.
    """
    pair = _Pair(one, other)
    for state in between if not (one.position and other.position) else ():
        by_one, by_other = (varied.by(state, c.speed) for c in (one, other))
        speeds = by_one * varied.states[one.speed] + by_other * varied.states[other.speed]
        rate = varied.rates(varied.states, varied.parameters)[state]
        if by_one.all() and by_other.all() and _alike(rate, speeds):
            ratio = -by_other / by_one
            if _alike(ratio, ratio[0]):
                scale = 1.0 / float(tabulated.by(state, one.speed)[0])
                pair = _Pair(one, other, state, _rounded(scale), _rounded(ratio[0]))
    first, second, state = pair.first, pair.second, pair.position
    ways = ((state, state) if state else (second.position, first.position),
            (second.speed, first.speed))  # fmt: skip
    known = [way for way in ways if all(way)]
    return replace(
        pair, ways=tuple(w for w in known if all(v.any() for v in pair.pulls(tabulated, w)))
    )


def _inertias(
    pair: _Pair, slopes: Slopes, masses: Mapping[str, str]
) -> tuple[str | float | None, str | float | None] | None:
    """Inertias of both bodies: parameters, or numbers in proportion; None: no force couples them.

    Without a parameter, the inertia of the first is None, and forces on it are accelerations.
    """
    pulls = [pair.pulls(slopes, way) for way in pair.ways]
    shares = np.concatenate([b / a for a, b in pulls])
    shares = shares[np.isfinite(shares) & (shares != 0.0)]
    if not (shares.size and shares[0] > 0.0 and _alike(shares, shares[0])):
        return None
    one, other = _names(pair, slopes, masses, pulls)
    value = {m: float(slopes.parameters[m][0]) for m in masses}
    share = float(shares[0])  # of the inertia of the first in that of the second
    if one and other and _alike(value[one], share * value[other]):
        return one, other
    if other and not one:
        return _rounded(share * value[other]), other
    one = None if other else one
    return one, _rounded((value[one] if one else 1.0) / share)


def _names(
    pair: _Pair, slopes: Slopes, masses: Mapping[str, str], pulls: Sequence[tuple[Array, Array]]
) -> list[str | None]:
    """The parameter that is the inertia of each body: twice as large, it halves the pulls."""
    heavy = {m: [pair.pulls(slopes.doubled(m), way) for way in pair.ways] for m in masses}
    names: list[str | None] = []
    for k, body in enumerate((pair.first, pair.second)):
        unit = "kg m^2" if same_unit(body.travel_unit, "rad") else "kg"
        halved = [
            m
            for m, others in heavy.items()
            if same_unit(masses[m], unit)
            and all(_alike(2.0 * o[k], v[k]) for o, v in zip(others, pulls, strict=True))
        ]
        names.append(halved[0] if len(halved) == 1 else None)
    return names


def _ratio(pair: _Pair, tabulated: Slopes, varied: Slopes) -> tuple[float, bool]:
    """Displacement of the first body per displacement of the second, and whether the rates tell it.

    Each acceleration tells a ratio, and a wrong one if something else pulls at its body too. A
    wrong one varies with the parameters, or differs from the others. If none is told, it is 1 for
    equal units, unless the wrong ones exclude that: a pull at the first body lowers its ratio, and
    one at the second raises its. 0: nothing tells it.
    """
    at, there = (
        np.array([_row(of, c.speed, *w) for w in pair.ways for c in (pair.first, pair.second)])
        for of in (tabulated, varied)
    )
    good = np.isfinite(at + there).all(axis=0)  # elsewhere nothing acts, as within a clearance
    at, there = at[:, good], there[:, good]
    told = [
        _rounded(row[0])
        for i, row in enumerate(at)
        if row.size
        and _alike(row, row[0])
        and any(_alike(there[i], v) for v in (row[0], *there[:i], *there[i + 1 :]))
    ]
    equal = same_unit(pair.first.travel_unit, pair.second.travel_unit)
    if equal and 1.0 in told:
        return 1.0, True
    most = [r for r in dict.fromkeys(told) if told.count(r) == max(map(told.count, told))]
    if len(most) == 1:
        return most[0], True
    return float(equal and at.size > 0 and at.min() <= 1.0 <= at.max()), False


def _row(slopes: Slopes, rate: str, by_second: str, by_first: str) -> Array:
    """Ratio along which a rate is constant."""
    return -slopes.by(rate, by_second) / slopes.by(rate, by_first)


def _alike(values: Array | float, other: Array | float) -> bool:
    return bool(np.allclose(values, other, atol=0.0))


def _rounded(value: float) -> float:
    """A value without the error of differences."""
    return float(f"{value:.6g}")
