"""Models as files: what is written of a model and of the effects that were found."""

from __future__ import annotations

from collections.abc import Sequence
from functools import singledispatch
from pathlib import Path

from unmodeled.data import Array
from unmodeled.files import check_suffix, write_text
from unmodeled.models.model import Candidate, Model, check_shapes


@singledispatch
def text(model: Model) -> str:
    """The unchanged file as :func:`write` would write it; empty: a changed one is no text."""
    del model
    return ""


@singledispatch
def suffixes(model: Model) -> tuple[str, ...]:
    """Endings of the files that :func:`write` can write, the usual one first."""
    del model
    return (".toml",)


@singledispatch
def numbers(
    model: Model, theta: Array, included: Sequence[Candidate], magnitudes: Array
) -> tuple[dict[str, float], dict[str, float]]:
    """Values of the parameters, and magnitudes of the effects that are no parameters.

    Parameters
    ----------
    model, theta, included, magnitudes
        As for :func:`write`.
    """
    check_shapes(model, included, {"theta": theta, "magnitudes": magnitudes})
    values = {p.name: float(v) for p, v in zip(model.parameters, theta, strict=True)}
    return values, {c.name: float(m) for c, m in zip(included, magnitudes, strict=True)}


@singledispatch
def write(
    model: Model,
    path: Path,
    theta: Array,
    included: Sequence[Candidate],
    magnitudes: Array,
    *,
    provenance: str = "",
    force: bool = False,
) -> Path:
    """Write the model with these values to a file: by default the numbers, as TOML.

    Parameters
    ----------
    model
        The model; for a class with files of its own, ``write.register`` names its function.
    path
        File to be written.
    theta
        Values of the parameters [their units], (p,).
    included
        Candidates that are part of the model.
    magnitudes
        Their magnitudes [their units], (k,).
    provenance
        Text about the origin of the values, for the file.
    force
        False: an existing file is not overwritten.

    Raises
    ------
    InvalidParameter
        The ending is not one of :func:`suffixes`, or the format cannot represent an effect.
    """
    import tomlkit

    check_suffix(path, *suffixes(model))
    document = tomlkit.document()
    document.add(tomlkit.comment(f"{model.name}: {provenance}"))
    listed = (*model.effects, *(c.effect for c in included))
    units = {n: e.unit for e in listed for n in (e.name, str(e.data))}
    units |= {p.name: p.unit for p in model.parameters}
    for title, found in zip(
        ("parameters", "effects"), numbers(model, theta, included, magnitudes), strict=True
    ):
        table = tomlkit.table()
        for key, value in found.items():
            table.add(key, float(f"{value:.9g}"))
            table[key].comment(units.get(key, "1"))
        if found:
            document.add(title, table)
    return write_text(path, tomlkit.dumps(document), force=force)


#: Writing of the numbers, whatever the class of the model.
write_numbers = write.dispatch(Model)
