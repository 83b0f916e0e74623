"""Finished fits of interrupted diagnoses: which ones a new diagnosis can use, or why none.

The folder has a subfolder for each set of model, records and options on which fits depend. Who
changes one of them and changes it back finds his fits again.
"""

from __future__ import annotations

import dataclasses
import json
import shutil
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any

from feltmb.data import Record
from feltmb.errors import DataError
from feltmb.files import Store, digest_of, is_file, package_digest, read_json, write_text
from feltmb.fit.model import Effect, Model
from feltmb.gap.findings import listed
from feltmb.gap.options import Options
from feltmb.gap.proof import Outcome

__all__ = ["discard", "remaining", "resumed"]

#: Options of which the stored fits depend.
OF_FITS = ("segment", "good_enough")
#: File that describes the diagnosis to which the fits of a folder belong.
HEAD = "diagnosis.json"
#: Letters of the digest that are the name of a subfolder.
NAME_LENGTH = 12
#: Number of changes that are listed.
MOST_NAMES = 4


def resumed(
    folder: Path,
    model: Model,
    effects: Sequence[Effect],
    records: Sequence[Record],
    held_out: Sequence[str],
    options: Options,
    tabulated: Outcome,
) -> tuple[Store, str]:
    """Find the store of a diagnosis in a folder, and tell which of its fits are used.

    A function of the user cannot be compared; ``tabulated``, its result before any fit, is compared
    in its place.
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
    store = Store(folder / digest_of(own)[:NAME_LENGTH])
    head = _head(store.folder)
    now = datetime.now().isoformat(" ", "minutes")
    if head is not None:
        now = head["begun"]
        told = f"resumes the diagnosis of {now}: {_finished(store, effects)}"
        if other := _changed(head["search"], soft):
            told += f"; {_some(other)} changed, which other fits may need"
    else:
        told = f"starts anew{_why(folder, own)}"
    store.folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"begun": now, "fits": own, "search": soft}, indent=1)
    write_text(store.folder / HEAD, text + "\n", force=True)
    return store, told


def discard(fits: Path) -> None:
    """Delete the fits of a finished diagnosis; those of other diagnoses remain."""
    shutil.rmtree(fits, ignore_errors=True)
    with suppress(OSError):  # not empty
        fits.parent.rmdir()


def remaining(folder: Path) -> str:
    """What is told of the fits that are still in a folder; empty: there are none."""
    files = [p for p in folder.rglob("*") if p.name != HEAD and p.is_file()]
    if not files:
        return ""
    size = max(sum(p.stat().st_size for p in files) / 1e6, 0.1)
    return (
        f"{folder} keeps finished fits of interrupted runs (about {size:.1f} MB), from which "
        "they continue. Delete this folder if you do not need them"
    )


def _why(folder: Path, own: Mapping[str, str]) -> str:
    """What differs from the most similar diagnosis of the folder."""
    found = [h for h in map(_head, sorted(folder.glob("*"))) if h is not None]
    if not found:
        return ": the folder holds no unfinished diagnosis"
    found.sort(key=lambda h: h["begun"], reverse=True)
    near = min(found, key=lambda h: len(_changed(h["fits"], own)))
    changed = _changed(near["fits"], own)
    # The model is computed for the records: it differs if they do.
    what = [n for n in changed if not n.startswith("the model")] or changed
    return f", because {_some(what)} changed since {near['begun']}; the fits of then are kept"


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


def _head(folder: Path) -> dict[str, Any] | None:
    path = folder / HEAD
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
    several = len(found - {()})
    sets = "1 set" if several == 1 else f"{several} sets"
    parts = ["fits of the model"] if () in found else []
    if several:
        parts.append(f"{sets} with {len(tried)} of {len(effects)} candidates")
    return f"{listed(parts)} are reused"
