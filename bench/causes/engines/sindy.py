"""Sparse regression on the columns of the candidates, by pysindy and by scikit-learn.

The model is fitted alone. The columns are the derivatives of the outputs by the magnitude of each
candidate, with each of its shapes, without what parameters and starts can take up. Most outputs are
no full state, so that derivatives of states by differences, which SINDy needs otherwise, are
unknown. Columns have one length. The threshold of the sequentially thresholded least squares is the
one with the lowest BIC of a grid (Mangan et al. 2017); the penalty of LASSO is that of five-fold
cross-validation.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from causes.engines.workbench import Workbench

__all__ = ["lasso", "run"]


#: Thresholds: shares of the rms of the residual.
GRID = np.geomspace(1e-3, 1.0, 25)


def _columns(folder: Path, seconds: float) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Names, columns of length 1 a sample, and the residual in its rms."""
    bench = Workbench(folder, seconds)
    some = bench.each_shape()
    rest, columns = bench.projected(bench.fit(()), some)
    size = np.sqrt((columns**2).mean(axis=0))
    left = float(np.sqrt((rest**2).mean()))
    names = [bench.name(m) for m, length in zip(some, size, strict=True) if length > 0.0]
    return names, columns[:, size > 0.0] / size[size > 0.0], rest / max(left, 1e-300)


def _told(names: list[str], sizes: np.ndarray, version: str) -> dict[str, Any]:
    named = [n for n, v in zip(names, sizes, strict=True) if v != 0.0]
    return {"named": list(dict.fromkeys(named)), "version": version}


def run(folder: Path, seconds: float) -> dict[str, Any]:
    """Sequentially thresholded least squares of pysindy; ridge 0.05, its default."""
    import pysindy

    names, columns, rest = _columns(folder, seconds)
    best, n = np.zeros(len(names)), rest.size
    lowest = n * np.log(np.mean(rest**2)) if names else 0.0
    for threshold in GRID if names else ():
        fit = pysindy.STLSQ(threshold=threshold, alpha=0.05).fit(columns, rest[:, None])
        sizes = np.ravel(fit.coef_)
        bic = n * np.log(np.mean((rest - columns @ sizes) ** 2)) + np.log(n) * np.sum(sizes != 0.0)
        if bic < lowest:
            lowest, best = bic, sizes
    return _told(names, best, pysindy.__version__)


def lasso(folder: Path, seconds: float) -> dict[str, Any]:
    """LASSO of scikit-learn."""
    import sklearn
    from sklearn.linear_model import LassoCV

    names, columns, rest = _columns(folder, seconds)
    if not names:
        return _told([], np.empty(0), sklearn.__version__)
    fit = LassoCV(cv=5, fit_intercept=False).fit(columns, rest)
    return _told(names, fit.coef_, sklearn.__version__)
