"""Forward selection by BIC with lmfit: what an engineer writes in an afternoon.

lmfit minimizes (``least_squares``) and tells the BIC, n ln(S/n) + k ln n. The candidate with the
lowest one is added while it falls by more than 10 ("very strong", Kass and Raftery 1995), at most
five. Shape numbers are fitted with the magnitude.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import lmfit
import numpy as np

from causes.engines.workbench import Ended, Fitted, Workbench
from unmodeled.search.problem import Members

__all__ = ["run"]

MOST, FALL = 5, 10.0


def _fit(bench: Workbench, members: Members, start: Fitted) -> tuple[float, Fitted]:
    """BIC of lmfit, and the fit."""
    s = bench.setting(members, start)
    parameters = lmfit.Parameters()
    names = [f"z{k}" for k in range(s["z"].size)]
    for name, z, low, high in zip(names, s["z"], s["low"], s["high"], strict=True):
        parameters.add(name, z, min=low, max=high)

    def values(given: Any) -> np.ndarray:
        known: Mapping[str, float] = given.valuesdict()
        return np.array([known[n] for n in names])

    out = lmfit.minimize(
        lambda p: s["residual"](values(p)), parameters, method="least_squares",
        jac=lambda p: s["slopes"](values(p)), x_scale="jac", ftol=1e-5, max_nfev=40,
    )  # fmt: skip
    return float(out.bic), bench.fitted(members, s, values(out.params), float(out.chisqr))


def run(folder: Path, seconds: float) -> dict[str, Any]:
    """Candidates that are added while BIC falls."""
    bench = Workbench(folder, seconds)
    best = bench.fit(())
    lowest, best = _fit(bench, (), best)
    said = ""
    with contextlib.suppress(Ended), bench.limited():
        said = "the limit ended the search"  # a step that has not seen all candidates is none
        while len(best.members) < MOST:
            shapes = {bench.name(m): m.shape for m in best.members}
            tried = []
            for name in bench.places.keys() - shapes.keys():
                (new,) = bench.shaped([name], best)
                members = bench.members([*shapes, name], {**shapes, name: new.shape})
                tried.append(_fit(bench, members, best))
            bic, fitted = min(tried, key=lambda one: one[0], default=(lowest, best))
            if bic > lowest - FALL:
                break
            lowest, best = bic, fitted
        said = ""
    return bench.answer(best, version=lmfit.__version__, said=said)
