"""Which finished fits of an interrupted diagnosis a new one can use, and why it can use none."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

from feltmb.data import Record
from feltmb.errors import DataError
from feltmb.files import Store, digest_of, is_file, package_digest, read_json, write_text
from feltmb.fit.model import Effect, Model
from feltmb.gap.findings import listed
from feltmb.gap.options import Options
from feltmb.gap.proof import Outcome

__all__ = ["resumed"]

#: Options of which the stored fits depend.
OF_FITS = ("segment", "good_enough")
#: File that describes the diagnosis to which the fits of a folder belong.
HEAD = "diagnosis.json"
#: Number of changes that are listed.
MOST_NAMES = 4


def resumed(
    store: Store,
    model: Model,
    effects: Sequence[Effect],
    records: Sequence[Record],
    held_out: Sequence[str],
    options: Options,
    tabulated: Outcome,
) -> str:
    """Compare a diagnosis with that of a store, and return which of its fits are used.

    Fits of another model, of other records or of another version are deleted. A function of the
    user cannot be compared; ``tabulated``, its result before any fit, is compared in its place.
    """
    own = {
        "the version of feltmb": package_digest(),
        **_records(records, held_out),
        **{f"the option {n}": digest_of(repr(getattr(options, n))) for n in OF_FITS},
        **_model(model, tabulated),
    }
    soft = {
        "the effects": digest_of([(e.name, e.scale, e.bounds, repr(e.shapes)) for e in effects]),
        **{
            f"the option {f.name}": digest_of(repr(getattr(options, f.name)))
            for f in dataclasses.fields(options)
            if f.name not in (*OF_FITS, "resume")
        },
    }
    path = store.folder / HEAD
    head = _head(store)
    now = datetime.now().isoformat(" ", "minutes")
    told = "starts anew: the folder holds no unfinished diagnosis"
    if head is not None:
        changed = _changed(head["fits"], own)
        if changed:
            # The model is computed for the records: it differs if they do.
            what = [n for n in changed if not n.startswith("the model")] or changed
            told = f"starts anew, because {_some(what)} changed since {head['begun']}"
            store.clear()
        else:
            now = head["begun"]
            told = f"resumes the diagnosis of {now}: {_finished(store, effects)}"
            if other := _changed(head["search"], soft):
                told += f"; {_some(other)} changed, which other fits may need"
    store.folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"begun": now, "fits": own, "search": soft}, indent=1)
    write_text(path, text + "\n", force=True)
    return told


def _records(records: Sequence[Record], held_out: Sequence[str]) -> dict[str, str]:
    out = {}
    for r in records:
        signals = [v for _, v in sorted({**r.inputs, **r.outputs}.items())]
        about = [sorted(r.sensors.items()), sorted(r.input_sigma.items()), r.name in held_out]
        out[f"record {r.name}"] = digest_of(r.time, *signals, repr(about))
    return out


def _model(model: Model, tabulated: Outcome) -> dict[str, str]:
    out = {
        f"the model ({p.name})": digest_of([p.value, p.sd, p.lower, p.upper, p.process_sd])
        for p in model.parameters
    }
    return out | {"the model": digest_of(model.name, *(x.residual for x in tabulated.fit.linears))}


def _head(store: Store) -> dict[str, Any] | None:
    path = store.folder / HEAD
    if not is_file(path):
        return None
    try:
        found = read_json(path)
    except DataError:
        return None
    known = isinstance(found, dict) and found.keys() == {"begun", "fits", "search"}
    return found if known else None


def _changed(old: Mapping[str, str], new: Mapping[str, str]) -> list[str]:
    """Names whose digests differ, or that only one of both has."""
    return [n for n in {**new, **old} if old.get(n) != new.get(n)]


def _some(names: Sequence[str]) -> str:
    """The first names as a part of a sentence."""
    more = len(names) - MOST_NAMES
    return listed([*names[:MOST_NAMES], *([f"{more} more"] if more > 0 else [])])


def _finished(store: Store, effects: Sequence[Effect]) -> str:
    """The stored fits in words."""
    found = {tuple(d.get("effects", ())) for d in store.stored() if "key" in d}
    tried = {n for names in found for n in names} & {e.name for e in effects}
    if not found:
        return "it had finished no fit, so that nothing is reused"
    alone = "fits of the model and " if () in found else ""
    several = len(found - {()})
    fits = "1 set" if several == 1 else f"{several} sets"
    return f"{alone}{fits} with {len(tried)} of {len(effects)} candidates are reused"
