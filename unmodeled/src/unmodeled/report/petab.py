"""The searched sets of causes as files of PEtab Select, which other programs of selection read."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from unmodeled.files import make_folder, write_text
from unmodeled.fit.model import Effect, Parameter
from unmodeled.search.result import Result

#: Smallest probability of a set: that of others is rounded to zero.
LEAST = 1e-300
#: Name of the model space.
SPACE = "causes"


@dataclass(frozen=True)
class _Column:
    """A cause as a column of the model space."""

    cause: str
    name: str
    """Identifier of the column."""
    members: tuple[tuple[str, str, float], ...]
    """Identifier, text and value of the magnitude, then of the numbers of its shape; more than one:
    the column is a metaparameter."""

    @property
    def magnitude(self) -> str:
        return self.members[0][0]


def write_petab(
    folder: Path,
    result: Result,
    parameters: Sequence[Parameter],
    effects: Sequence[Effect],
    *,
    force: bool,
) -> None:
    """Write problem.yaml, model_space.tsv, models.yaml, petab.yaml and parameters.tsv.

    The criterion is -2 times the logarithm of the posterior probability of a set, under the name
    BIC, which approximates it except for a constant. An effect with shapes is a metaparameter: its
    magnitude and the numbers of its shape are estimated together, or not at all.

    Parameters
    ----------
    folder
        Folder of the files.
    result
        Result of the diagnosis.
    parameters, effects
        Parameters of the model, and effects that were tested.
    force
        False: existing files are not overwritten.
    """
    names = _Names()
    rows = [_parameter_row(names.new(p.name), p) for p in parameters]
    by_name = {e.name: e for e in effects}
    causes = dict.fromkeys([*by_name, *(c for s in result.sets for c in s.causes)])
    columns = [_column(names, cause, by_name.get(cause)) for cause in causes]
    rows += [
        f"{name}\t{text}\tlin\t-inf\tinf\t{value!r}\t1\t\t"
        for c in columns
        for name, text, value in c.members
    ]
    head = "parameterId parameterName parameterScale lowerBound upperBound nominalValue estimate"
    head += " objectivePriorType objectivePriorParameters"
    space = ["model_subspace_id", "model_subspace_petab_yaml", *(c.name for c in columns)]
    cells = [SPACE, "petab.yaml", *("0;estimate" for _ in columns)]
    groups = [line for c in columns if len(c.members) > 1 for line in _group(c)]
    problem = ["format_version: 1.0.0", "criterion: BIC", "method: forward",
               "model_space_files:", "- model_space.tsv"]  # fmt: skip
    at = make_folder(folder)
    for name, lines in {
        "problem.yaml": [*problem, *(["metaparameters:", *groups] if groups else [])],
        "petab.yaml": ["format_version: 1", "parameter_file: parameters.tsv", "problems:", "- {}"],
        "parameters.tsv": [head.replace(" ", "\t"), *rows],
        "model_space.tsv": ["\t".join(space), "\t".join(cells)],
        "models.yaml": list(_models(result, columns, groups)),
    }.items():
        write_text(at / name, "\n".join(lines) + "\n", force=force)


class _Names:
    """Identifiers of PEtab: letters, digits and underscores."""

    def __init__(self) -> None:
        self._used: set[str] = set()

    def new(self, name: str) -> str:
        """A new identifier that resembles a name."""
        plain = re.sub(r"[^0-9A-Za-z]+", "_", name).strip("_") or "x"
        plain = f"x_{plain}" if plain[0].isdigit() else plain
        found, number = plain, 1
        while found in self._used:
            number += 1
            found = f"{plain}_{number}"
        self._used.add(found)
        return found


def _text(name: str, unit: str) -> str:
    return re.sub(r"\s+", " ", f"{name} [{unit}]")


def _parameter_row(name: str, p: Parameter) -> str:
    prior = f"normal\t{p.value!r};{p.sd!r}" if 0.0 < p.sd < math.inf else "\t"
    bounds = f"{p.lower!r}\t{p.upper!r}\t{p.value!r}"
    return f"{name}\t{_text(p.name, p.unit)}\tlin\t{bounds}\t{int(p.sd > 0.0)}\t{prior}"


def _column(names: _Names, cause: str, effect: Effect | None) -> _Column:
    if effect is None or effect.shapes == (None,):
        name = names.new(cause)
        unit = "1" if effect is None else effect.unit
        return _Column(cause, name, ((name, _text(cause, unit), 0.0),))
    name = names.new(cause)
    shape = effect.shapes[0] if isinstance(effect.shapes[0], tuple) else (effect.shapes[0],)
    members = [(names.new(f"{cause} magnitude"), _text(cause, effect.unit), 0.0)]
    for k, value in enumerate(shape):
        what = effect.shape_names[k] if k < len(effect.shape_names) else f"shape {k + 1}"
        number = float(value) if isinstance(value, int | float) else 0.0  # a text: its place
        members.append((names.new(f"{cause} {what}"), f"{cause}: {what}", number))
    return _Column(cause, name, tuple(members))


def _group(column: _Column, indent: str = "  ") -> Iterator[str]:
    yield f"{indent}{column.name}:"
    yield from (f"{indent}- {name}" for name, *_ in column.members)


def _models(result: Result, columns: Sequence[_Column], groups: Iterable[str]) -> Iterator[str]:
    """Lines of the fitted sets."""
    for s in result.sets:
        chosen = [int(c.cause in s.causes) for c in columns]
        mark = f"{SPACE}-{''.join(map(str, chosen))}"
        yield f"- model_subspace_id: {SPACE}"
        yield f"  model_subspace_indices: {chosen}"
        yield f"  criteria: {{BIC: {-2.0 * math.log(max(s.probability, LEAST)):.9e}}}"
        yield f"  model_hash: {mark}"
        yield "  model_subspace_petab_yaml: petab.yaml"
        size = dict(zip(s.causes, s.magnitudes, strict=False))
        values = [
            f"{c.magnitude}: {size[c.cause]:.9e}"
            for c in columns
            if math.isfinite(size.get(c.cause, math.nan))
        ]
        yield f"  estimated_parameters: {{{', '.join(values)}}}"
        yield f"  model_id: {mark}"
        options = zip(columns, chosen, strict=True)
        told = [f"{c.name}: {'estimate' if k else 0}" for c, k in options]
        yield f"  parameters: {{{', '.join(told)}}}"
        if groups:
            yield "  metaparameters:"
            yield from (f"  {line}" for line in groups)
        yield "  predecessor_model_hash: virtual_initial_model-"
