"""The channels of a model and of records: which columns are its inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import singledispatch

from unmodeled.data import InputMode, Record
from unmodeled.models.model import Model, Ready


@singledispatch
def matched(model: Model, records: Sequence[Record]) -> Ready:
    """The model and the records with the same channels.

    A column of a record that is an input of the model becomes an input. A model that does not
    state its channels takes them from the records.
    """
    notes: list[str] = []
    return Ready(model, tuple(_with_inputs(r, model, notes) for r in records), tuple(notes))


def _with_inputs(record: Record, model: Model, notes: list[str]) -> Record:
    """The record with the columns that are inputs of the model as inputs."""
    modes: Mapping[InputMode, Sequence[str]] = model.input_modes or {record.input_mode: ()}
    for mode, names in sorted(modes.items(), key=lambda m: m[0] != record.input_mode):
        place: dict[str, str] = {}
        for name in (*model.inputs, *names):
            known = [n for n in (name, *model.input_names.get(name, ()))]
            found = [n for n in known if n in record.inputs or n in record.outputs]
            place |= {name: found[0]} if found else {}
        moved = {n: c for n, c in place.items() if n not in record.inputs}
        if len(place) < len(model.inputs) + len(names):
            continue
        if not moved:
            return record
        which = ", ".join(moved.values())
        inputs = "are inputs" if len(moved) > 1 else "is an input"
        notes.append(f"{record.name}: {which} {inputs} of the model {model.name}")
        return record.with_columns_as_inputs(moved, mode)
    return record


#: Columns that are inputs become inputs, whatever the class of the model.
with_same_channels = matched.dispatch(Model)
