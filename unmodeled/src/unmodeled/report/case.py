"""A diagnosis as a folder that another person repeats: records, model, options, and the answer."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from importlib.metadata import entry_points, version
from pathlib import Path
from typing import Any

from unmodeled.data import Record, write_record
from unmodeled.errors import InvalidParameter
from unmodeled.files import (
    LARGEST_FILE,
    beside,
    is_file,
    make_folder,
    open_input,
    package_digest,
    read_input,
    read_json,
    read_text,
    write_file,
    write_text,
)
from unmodeled.fit.inclusion import Including
from unmodeled.fit.mjcf_parts import MJCF, Parts, parts_of
from unmodeled.lazy import lazy_import
from unmodeled.models.model import Candidate, Effect, Model, Origin, Ready
from unmodeled.report.values import FORMAT, VERSION, as_stored
from unmodeled.search.options import Options

#: Fields of an effect that are stored: numbers and words, which can be disputed without its code.
OF_EFFECT = ("scale", "sign", "lower", "upper", "weight", "shapes")


# ------------------------------------------------------------------------------------- writing


@dataclass(frozen=True, eq=False)
class Given:
    """What a diagnosis was given, for those who repeat it."""

    model: Model
    ready: Ready
    """Model and records as they were fitted."""
    tested: Sequence[Effect]
    records: tuple[Record, ...]
    hold_out: Sequence[str] | str | None
    options: Options

    def write(self, folder: Path) -> None:
        """Write case.json, README.txt, and the folders records and model.

        Parameters
        ----------
        folder
            New folder with the report.
        """
        kept: list[Path] = []
        rows = [self._record(folder, k, kept) for k in range(len(self.records))]
        base, included = _without_included(self.model)
        origin, why = _origin_of(base)
        copied, left = "", [why] if why else []
        outside: list[str] = []
        if origin is not None and is_file(source := Path(file_and_name(origin.name)[0])):
            copied, outside, more = _copy(source, folder / "model", kept)
            left += more
        left += self._own_effects(origin)
        arguments = {} if origin is None else dict(origin.arguments)
        try:
            arguments = as_stored(arguments)
        except TypeError as error:
            left.append(f"an argument of its model: {error}; let a Python file define the model")
            origin, arguments = None, {}
        name = "" if origin is None else origin.name
        stored = {
            "format": FORMAT,
            "version": VERSION,
            "made_with": versions(),
            "model": {
                "name": self.model.name,
                "made_by": None if origin is None else origin.made_by,
                "file": f"model/{copied}" if copied else "",
                "object": file_and_name(name)[1] if copied else name,
                "arguments": arguments,
                "included": [{"effect": c.name, "shape": as_stored(c.shape)} for c in included],
                "parameters": [as_stored(p) for p in self.model.parameters],
                "outside": outside,
            },
            "candidates": [dict(_numbers_of(e)) for e in self.tested],
            "records": rows,
            "hold_out": as_stored(self.hold_out),
            "options": as_stored({f.name: getattr(self.options, f.name) for f in fields(Options)}),
            "not_stored": left,
        }
        text = _readme(folder.name, stored)
        kept.append(folder / "report.json")
        stored["sha256"] = {p.relative_to(folder).as_posix(): sha256_of(p) for p in kept}
        whole = json.dumps(stored, indent=1, ensure_ascii=False, allow_nan=False)
        write_text(folder / "case.json", whole + "\n")
        write_text(folder / "README.txt", text)

    def _own_effects(self, origin: Origin | None) -> Iterator[str]:
        """Tell the effects that only a script knows."""
        chosen_effects = lazy_import("unmodeled.library.defaults:chosen_effects")
        chosen = chosen_effects(self.ready.model, self.ready.records, None, ())[0]
        own = [e.name for e in self.tested if e.name not in {c.name for c in chosen}]
        if own and not _has_effects(origin):
            yield (
                f"the effects {', '.join(own)} are functions of a script: let a Python file define "
                "them as effects, beside the model"
            )

    def _record(self, folder: Path, k: int, kept: list[Path]) -> dict[str, Any]:
        """Write a record, and tell how it is read again."""
        record = self.records[k]
        slug = re.sub(r"[^0-9A-Za-z_.-]+", "_", record.name)[:60].strip("._") or "record"
        path = make_folder(folder / "records") / f"{k + 1:02d}_{slug}.csv"
        kept += [write_record(record, path), path.with_suffix(".toml")]
        own = {"inputs": [*record.inputs], "outputs": [*record.outputs]}
        return {"file": f"records/{path.name}", "name": record.name, **own}


def _numbers_of(effect: Effect) -> Iterator[tuple[str, Any]]:
    """What is stored of an effect: that which can be disputed."""
    yield from (("name", effect.name), ("component", effect.component), ("unit", effect.unit))
    for name in OF_EFFECT:
        try:
            yield name, as_stored(getattr(effect, name))
        except TypeError:  # a shape of another kind is that of the effect
            continue


def _without_included(model: Model) -> tuple[Model, list[Candidate]]:
    """The model without the effects that became a part of it, and these."""
    included: list[Candidate] = []
    while isinstance(model, Including):
        included = [*model.included, *included]
        model = model.base
    return model, included


def _has_effects(origin: Origin | None) -> bool:
    """Whether what makes a model also makes effects: an extension, or a file that defines them."""
    if origin is None or origin.made_by != "load_model":
        return False
    file, attribute = file_and_name(origin.name)
    text = read_text(Path(file), most=LARGEST_FILE) if attribute else "effects"
    return re.search(r"^(def )?effects\b", text, re.MULTILINE) is not None


def file_and_name(name: str) -> tuple[str, str]:
    """File and name in it of ``FILE.py:NAME``."""
    stem, mark, attribute = name.rpartition(".py:")
    return (f"{stem}.py", attribute) if mark else (name, "")


def _origin_of(model: Model) -> tuple[Origin | None, str]:
    """How a model is made again, and if that is not known, why."""
    origin = model.origin
    if origin is not None and origin.name:
        return origin, ""
    for title, module in list(sys.modules.items()):  # a model of an imported file
        file = getattr(module, "__file__", None) or ""
        if title != "__main__" and file.endswith(".py"):
            for name, value in list(vars(module).items()):
                if value is model:
                    return Origin("load_model", f"{file}:{name}"), ""
    function = getattr(model, "function", None)
    code = getattr(function, "__code__", None)
    if function is not None and code is not None and is_file(Path(code.co_filename)):
        top = function.__qualname__ == function.__name__ != "<lambda>"
        if top and origin is not None and function.__module__ != "__main__":
            return replace(origin, name=f"{code.co_filename}:{function.__name__}"), ""
    what = "a function" if origin is not None else "an object"
    why = f"the model {model.name} is {what} of a script or a session, which no file holds alone"
    return (origin, why) if origin is not None else (None, why)


def _copy(source: Path, folder: Path, kept: list[Path]) -> tuple[str, list[str], list[str]]:
    """Copy the file of a model, and the files that it names, as they lie beside one another.

    Returns its place in the folder, the places of the files that are outside its own folder, and
    what is not copied.
    """
    source = Path(os.path.normpath(source.absolute()))
    parts = parts_of(source) if source.suffix.lower() in MJCF else Parts({source: 0})
    own = [p for p in parts.sizes if p not in parts.absolute]
    base = Path(os.path.commonpath([p.parent for p in own]))
    for path in sorted(own):
        target = folder / path.relative_to(base)
        for parent in reversed(target.relative_to(folder.parent).parents[:-1]):
            make_folder(folder.parent / parent)
        data = read_input(path, most=LARGEST_FILE)
        kept.append(write_file(target, partial(_put, data=data)))
    outside = [p for p in own if not p.is_relative_to(source.parent)]
    left = [f"{p}, which {source.name} names by an absolute path" for p in sorted(parts.absolute)]
    places = (p.relative_to(base).as_posix() for p in (source, *sorted(outside)))
    return next(places), [*places], left


def _put(path: Path, data: bytes) -> None:
    path.write_bytes(data)


def files_of_case(folder: Path) -> list[Path]:
    """Files of an earlier case in a folder, as they were written."""
    if not is_file(folder / "case.json"):
        return []
    from pydantic import ValidationError

    from unmodeled.report.stored import Stored  # a diagnosis needs no schema

    try:
        digests = Stored.model_validate(read_json(folder / "case.json")).sha256
        files = {beside(folder, n, "case.json"): d for n, d in digests.items()}
    except (InvalidParameter, ValidationError):
        return []  # of another version or another program
    return [p for p, digest in files.items() if is_file(p) and sha256_of(p) == digest]


def sha256_of(path: Path) -> str:
    """SHA-256 of a file."""
    with open_input(path, most=LARGEST_FILE) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def versions() -> dict[str, str]:
    """Versions of the programs that make an answer, and the hash of this package."""
    names = ["unmodeled", "numpy", "scipy"]
    names += [
        e.dist.name
        for e in entry_points(group=lazy_import("unmodeled.loading:GROUP"))
        if e.dist is not None
    ]
    found = {n: version(n) for n in dict.fromkeys(names)}
    return {**found, "python": platform.python_version(), "code": package_digest("unmodeled")}


def _readme(folder: str, case: Mapping[str, Any]) -> str:
    """What the folder holds, and how it is repeated."""
    left = case["not_stored"]
    model = case["model"]
    lines = [
        f"Diagnosis of {model['name']} with unmodeled {case['made_with']['unmodeled']}.",
        "",
        "report.html, report.txt, report.json: the answer.",
        "case.json: model with its priors, candidates, options, versions, and hashes of the files.",
        "records/: the measured runs, in SI units. model/: the file of the model, if there is one.",
        "",
        "Repeat it, and compare the numbers:",
        f"    unmodeled verify {folder}{' --model FILE.py:NAME' if left else ''}",
        "Change a prior, a candidate or an option in case.json, and see what it does.",
        "Verify executes the code of a Python model or an FMU: only repeat cases that you trust.",
    ]
    if outside := model["outside"]:
        lines += ["", "Of the model, from outside its folder:", *(f"- model/{p}" for p in outside)]
    lines += ["", "Not stored:", *(f"- {text}" for text in left)] if left else []
    return "\n".join(lines) + "\n"
