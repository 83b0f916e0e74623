"""FAMoS of PEtab Select by AICc: forward, backward, lateral and swaps, from the model alone."""

from __future__ import annotations

import contextlib
import io
import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import Any

import petab_select
from petab_select.constants import CANDIDATE_SPACE, TERMINATE, UNCALIBRATED_MODELS, Criterion

from causes.engines.workbench import Ended, Fitted, Workbench

__all__ = ["run"]


def _problem(folder: Path, names: list[str]) -> Any:
    """A model space: every candidate is zero or estimated."""
    ids = [f"c{k}" for k in range(len(names))]
    space = ["model_subspace_id\tmodel_subspace_petab_yaml\t" + "\t".join(ids),
             "causes\tpetab.yaml\t" + "\t".join("0;estimate" for _ in ids)]  # fmt: skip
    head = "parameterId\tparameterScale\tlowerBound\tupperBound\tnominalValue\testimate"
    rows = [head, *(f"{i}\tlin\t-1e9\t1e9\t0\t1" for i in ids)]
    parts = {
        "space.tsv": space,
        "parameters.tsv": rows,
        "petab.yaml": ["format_version: 1", "parameter_file: parameters.tsv", "problems:", "- {}"],
        "problem.yaml": ["format_version: 1.0.0", "criterion: AICc", "method: famos",
                         "model_space_files:", "- space.tsv", "candidate_space_arguments:",
                         "  critical_parameter_sets: []", "  swap_parameter_sets:",
                         "  - [" + ", ".join(ids) + "]"],
    }  # fmt: skip
    for name, lines in parts.items():
        (folder / name).write_text("\n".join(lines) + "\n", encoding="utf-8")
    return petab_select.Problem.from_yaml(folder / "problem.yaml")


def run(folder: Path, seconds: float) -> dict[str, Any]:
    """The set of the lowest AICc that FAMoS finds within the limit."""
    bench = Workbench(folder, seconds)
    names = list(bench.places)
    base = bench.fit(())
    best, said, known = base, "", {}
    if not names:
        return bench.answer(base, version=version("petab-select"))

    def fitted(some: tuple[str, ...]) -> Fitted:
        if some not in known:
            nearest = max((k for k in known if set(k) <= set(some)), key=len, default=())
            known[some] = bench.fit(bench.shaped(some, base), known.get(nearest, base))
        return known[some]

    known[()] = base
    with (
        tempfile.TemporaryDirectory() as place,
        contextlib.redirect_stdout(io.StringIO()),
        contextlib.suppress(Ended),
        bench.limited(),
    ):
        said = "the limit ended the search"
        problem, space, ended = _problem(Path(place), names), None, False
        while not ended:
            step = petab_select.ui.start_iteration(problem=problem, candidate_space=space)
            models = step[UNCALIBRATED_MODELS]
            for model in models:
                ids = model.get_estimated_parameter_ids(full=False)
                own = fitted(tuple(n for k, n in enumerate(names) if f"c{k}" in ids))
                model.set_criterion(Criterion.AICC, own.aicc)
                best = min(best, own, key=lambda f: f.aicc)
            out = petab_select.ui.end_iteration(
                problem=problem, candidate_space=step[CANDIDATE_SPACE], calibrated_models=models
            )
            space, ended = out[CANDIDATE_SPACE], out[TERMINATE]
        said = ""
    return bench.answer(best, version=version("petab-select"), said=said)
