"""A diagnosis as a folder that another person repeats: records, model, options, and the answer."""

from __future__ import annotations

import hashlib
import json
import math
import platform
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import partial
from importlib.metadata import entry_points, version
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from unmodeled.arguments import checked
from unmodeled.data import Record, read_record, write_record
from unmodeled.errors import DataError, InvalidParameter
from unmodeled.files import (
    LARGEST_FILE,
    check_writable,
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
from unmodeled.fit.inclusion import Including, including
from unmodeled.fit.model import Candidate, Effect, Model, Origin, Parameter, Ready
from unmodeled.fit.priors import Exposed
from unmodeled.fit.simulator import Simulator
from unmodeled.library.defaults import chosen_effects
from unmodeled.loading import GROUP, LoadedModel, load_model
from unmodeled.report.petab import write_petab
from unmodeled.search.options import Options
from unmodeled.search.progress import Progress
from unmodeled.search.records import ready_records
from unmodeled.search.result import Result

__all__ = ["Given", "Repeated", "Verification", "verify"]

#: Format and version of case.json.
FORMAT, VERSION = "unmodeled case", 1
#: Two numbers agree if they differ by less than this share of their 95 % interval, or of the
#: larger one: far below what an answer means, and above the rounding of other processors.
OF_INTERVAL, OF_VALUE = 0.02, 1e-3
#: Probabilities agree if they differ by less than this [1].
OF_PROBABILITY = 0.01
#: Fields of an effect that are stored: numbers and words, which can be disputed without its code.
OF_EFFECT = ("scale", "sign", "lower", "upper", "weight", "shapes")


# ------------------------------------------------------------------------------------ as JSON


_STORED = {c.__name__: c for c in (Parameter, Exposed, Effect)}


def _stored(value: Any) -> Any:
    """A value as JSON types: every bit of a number, infinite ones as texts.

    Raises
    ------
    TypeError
        It is something else, such as a function.
    """
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else str(float(value))
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, Mapping):
        return {str(k): _stored(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_stored(v) for v in value]
    if type(value) in _STORED.values() and is_dataclass(value):
        own = {
            f.name: v
            for f in fields(value)
            if (v := getattr(value, f.name)) is not f.default and v != f.default
        }
        return {"class": type(value).__name__} | {k: _stored(v) for k, v in own.items()}
    raise TypeError(f"{type(value).__name__} cannot be stored")


def _read(value: Any) -> Any:
    """The value of :func:`_stored`; lists become tuples."""
    if isinstance(value, dict):
        own = {k: _read(v) for k, v in value.items()}
        return _STORED[own.pop("class")](**own) if "class" in own else own
    if isinstance(value, list):
        return tuple(_read(v) for v in value)
    return float(value) if value in ("inf", "-inf", "nan") else value


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

    def write(self, folder: Path, result: Result, *, force: bool) -> None:
        """Write case.json, README.txt, and the folders records, model and petab.

        Parameters
        ----------
        folder
            Folder with the report.
        result
            Result of the diagnosis.
        force
            False: existing files are not overwritten.
        """
        check_writable(folder / "case.json", force=force)
        kept: list[Path] = []
        rows = [self._record(folder, k, kept, force=force) for k in range(len(self.records))]
        base, included = _without_included(self.model)
        origin, why = _origin_of(base)
        copied, left = "", [why] if why else []
        if origin is not None and is_file(source := Path(_split(origin.name)[0])):
            copied, more = _copy(source, folder / "model", kept, force=force)
            left += more
        default = {
            e.name for e in chosen_effects(self.ready.model, self.ready.records, None, ())[0]
        }
        own = [e.name for e in self.tested if e.name not in default]
        if own and not _has_effects(origin):
            left.append(
                f"the effects {', '.join(own)} are functions of a script: let a Python file define "
                "them as effects, beside the model"
            )
        arguments = {} if origin is None else dict(origin.arguments)
        try:
            arguments = _stored(arguments)
        except TypeError as error:
            left.append(f"an argument of its model: {error}; let a Python file define the model")
            origin, arguments = None, {}
        name = "" if origin is None else origin.name
        stored = {
            "format": FORMAT,
            "version": VERSION,
            "made_with": _versions(),
            "model": {
                "name": self.model.name,
                "made_by": None if origin is None else origin.made_by,
                "file": f"model/{copied}" if copied else "",
                "object": _split(name)[1] if copied else name,
                "arguments": arguments,
                "included": [{"effect": c.name, "shape": _stored(c.shape)} for c in included],
                "parameters": [_stored(p) for p in self.model.parameters],
            },
            "candidates": [dict(_numbers_of(e)) for e in self.tested],
            "records": rows,
            "hold_out": _stored(self.hold_out),
            "options": _stored({f.name: getattr(self.options, f.name) for f in fields(Options)}),
            "not_stored": left,
        }
        text = _readme(folder.name, stored)
        known = self.model.parameters, self.tested
        write_petab(folder / "petab", result, *known, force=force)
        kept.append(folder / "report.json")
        stored["sha256"] = {p.relative_to(folder).as_posix(): _sha256(p) for p in kept}
        whole = json.dumps(stored, indent=1, ensure_ascii=False, allow_nan=False)
        write_text(folder / "case.json", whole + "\n", force=force)
        write_text(folder / "README.txt", text, force=force)

    def _record(self, folder: Path, k: int, kept: list[Path], *, force: bool) -> dict[str, Any]:
        """Write a record, and tell how it is read again."""
        record = self.records[k]
        slug = re.sub(r"[^0-9A-Za-z_.-]+", "_", record.name)[:60].strip("._") or "record"
        path = make_folder(folder / "records") / f"{k + 1:02d}_{slug}.csv"
        kept += [write_record(record, path, force=force), path.with_suffix(".toml")]
        own = {"inputs": [*record.inputs], "outputs": [*record.outputs]}
        return {"file": f"records/{path.name}", "name": record.name, **own}


def _numbers_of(effect: Effect) -> Iterator[tuple[str, Any]]:
    """What is stored of an effect: that which can be disputed."""
    yield from (("name", effect.name), ("component", effect.component), ("unit", effect.unit))
    for name in OF_EFFECT:
        try:
            yield name, _stored(getattr(effect, name))
        except TypeError:  # a shape of another kind is that of the effect
            continue


def _without_included(model: Model) -> tuple[Model, list[Candidate]]:
    """The model without the effects that became a part of it, and these."""
    included: list[Candidate] = []
    while isinstance(model, Including):
        included = [*model._own, *included]
        model = model._base
    return model, included


def _has_effects(origin: Origin | None) -> bool:
    """Whether what makes a model also makes effects: an extension, or a file that defines them."""
    if origin is None or origin.made_by != "load_model":
        return False
    file, attribute = _split(origin.name)
    text = read_text(Path(file), most=LARGEST_FILE) if attribute else "effects"
    return re.search(r"^(def )?effects\b", text, re.MULTILINE) is not None


def _split(name: str) -> tuple[str, str]:
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
    function = getattr(model, "_function", None)
    code = getattr(function, "__code__", None)
    if function is not None and code is not None and is_file(Path(code.co_filename)):
        top = function.__qualname__ == function.__name__ != "<lambda>"
        if top and origin is not None and function.__module__ != "__main__":
            return replace(origin, name=f"{code.co_filename}:{function.__name__}"), ""
    what = "a function" if origin is not None else "an object"
    why = f"the model {model.name} is {what} of a script or a session, which no file holds alone"
    return (origin, why) if origin is not None else (None, why)


def _copy(source: Path, folder: Path, kept: list[Path], *, force: bool) -> tuple[str, list[str]]:
    """Copy the file of a model, and those to which an XML file refers.

    Returns its place in the folder, and what is not copied.
    """
    found, outside = _with_parts(source) if source.suffix == ".xml" else ({source}, [])
    base = source.absolute().parent
    for path in sorted(found):
        target = folder / path.absolute().relative_to(base)
        for parent in reversed(target.relative_to(folder.parent).parents[:-1]):
            make_folder(folder.parent / parent)
        data = read_input(path, most=LARGEST_FILE)
        kept.append(write_file(target, partial(_put, data=data), force=force))
    return source.name, [f"{path}, to which {source.name} refers" for path in outside]


def _put(path: Path, data: bytes) -> None:
    path.write_bytes(data)


def _with_parts(source: Path) -> tuple[set[Path], list[str]]:
    """Files of a MuJoCo model below its folder, and others to which it refers."""
    base, found, outside = source.absolute().parent, {source.absolute()}, []
    todo, folders = [source.absolute()], [Path()]
    names: list[str] = []
    while todo:
        root = ElementTree.fromstring(read_input(todo.pop(), most=LARGEST_FILE))
        for element in root.iter():
            folders += [Path(v) for k, v in element.attrib.items() if k.endswith("dir")]
            name = element.get("file")
            if name and element.tag == "include" and (base / name) not in found:
                todo.append(base / name)
                found.add(base / name)
            elif name:
                names.append(name)
    for name in names:
        there = [base / d / name for d in folders if is_file(base / d / name)]
        inside = [p for p in there if ".." not in p.parts and p.is_relative_to(base)]
        found |= set(inside[:1])
        outside += [] if inside else [name]
    return found, outside


def _sha256(path: Path) -> str:
    with open_input(path, most=LARGEST_FILE) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _versions() -> dict[str, str]:
    """Versions of the programs that make an answer, and the hash of this package."""
    names = ["unmodeled", "numpy", "scipy"]
    names += [e.dist.name for e in entry_points(group=GROUP) if e.dist is not None]
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
        "petab/: the searched sets of causes as files of PEtab Select.",
        "",
        "Repeat it, and compare the numbers:",
        f"    unmodeled verify {folder}{' --model FILE.py:NAME' if left else ''}",
        "Change a prior, a candidate or an option in case.json, and see what it does.",
        "Verify executes a Python model: only repeat cases that you trust.",
    ]
    lines += ["", "Not stored:", *(f"- {text}" for text in left)] if left else []
    return "\n".join(lines) + "\n"


# ----------------------------------------------------------------------------------- repeating


@dataclass(frozen=True)
class Repeated:
    """A number or a text of an answer, and of its repetition."""

    what: str
    unit: str
    stored: float | str | None
    again: float | str | None
    """None: the answer does not have it."""
    agrees: bool


@dataclass(frozen=True, eq=False)
class Verification:
    """A repeated diagnosis beside the stored one."""

    rows: tuple[Repeated, ...]
    """Files that changed, then all numbers."""
    notes: tuple[str, ...]
    """Other versions, and why the answers may differ."""
    report: Any
    """The repeated diagnosis, a :class:`unmodeled.Report`."""

    @property
    def agrees(self) -> bool:
        """Whether all files, texts and numbers agree."""
        return all(r.agrees for r in self.rows)

    def __str__(self) -> str:
        wrong = [r for r in self.rows if not r.agrees]
        count = f"{len(self.rows) - len(wrong)} of {len(self.rows)}"
        head = "The answer is the same" if self.agrees else "The answer is another one"
        lines = [f"{head}: {count} files, words and numbers agree."]
        lines += [
            f"- {r.what}: {_told(r.stored, r.unit)} in the case, {_told(r.again, r.unit)} now"
            for r in wrong
        ]
        return "\n".join([*lines, *(f"note: {n}" for n in self.notes)])


def _told(value: float | str | None, unit: str) -> str:
    if value is None:
        return "nothing"
    return f"{value:.6g}{'' if unit == '1' else f' {unit}'}" if isinstance(value, float) else value


@checked
def verify(
    folder: str | Path,
    *,
    model: str = "",
    seconds: float | None = None,
    tell: Callable[[Progress], None] | None = None,
) -> Verification:
    """Repeat the diagnosis of a folder that :meth:`Report.write` wrote, and compare the answers.

    Two numbers agree if they differ by less than 2 % of their 95 % interval or 0.1 % of the larger
    one, probabilities if they differ by less than 0.01. A Python model is executed: only repeat
    cases that you trust.

    Parameters
    ----------
    folder
        The folder.
    model
        Model instead of the stored one, as for :func:`load_model`, such as ``model.py:cart``;
        default: the stored one. It gets the stored priors.
    seconds
        Limit of time [s]; default: that of the case.
    tell
        As for :func:`unmodeled.diagnose`.

    Raises
    ------
    DataError
        The folder holds no case, or a file of it is missing.
    InvalidParameter
        The model is not stored and not given, or it does not have the parameters or the candidates
        of the case.
    """
    from unmodeled.diagnosis import diagnose

    folder = Path(folder)
    case, stored = _opened(folder)
    rows = [
        Repeated(f"file {name}", "1", "the stored hash", "changed", agrees=False)
        for name, digest in case["sha256"].items()
        if _sha256(folder / name) != digest
    ]
    records = tuple(
        read_record(folder / r["file"], inputs=r["inputs"], outputs=r["outputs"])
        for r in case["records"]
    )
    loaded, effects = _model_again(folder, case, model, records)
    options = Options(**_read(case["options"]))
    report = diagnose(
        loaded,
        effects,
        records,
        hold_out=_read(case["hold_out"]),
        options=options if seconds is None else replace(options, seconds=seconds),
        tell=tell,
    )
    rows += _compared(stored, report.as_dict())
    return Verification(tuple(rows), tuple(_notes(case, stored, report)), report)


def _opened(folder: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """case.json and report.json of a folder whose files are all there."""
    path = folder / "case.json"
    if not is_file(path):
        raise DataError(
            f"{folder}: holds no case.json, expected a folder that report.write or "
            "unmodeled diagnose --out wrote"
        )
    case = read_json(path)
    known = isinstance(case, dict) and case.get("format") == FORMAT
    if not known or case.get("version") != VERSION:
        got = f"{case.get('format')} {case.get('version')}" if isinstance(case, dict) else "a list"
        raise DataError(f"{path}: got {got}, expected {FORMAT} {VERSION}")
    needed = ("model", "candidates", "records", "options", "sha256", "hold_out")
    if lacking := [k for k in needed if k not in case]:
        raise DataError(f"{path}: lacks {', '.join(lacking)}")
    wrong = [n for n in case["sha256"] if Path(n).is_absolute() or ".." in Path(n).parts]
    missing = [n for n in case["sha256"] if not wrong and not is_file(folder / n)]
    if wrong or missing:
        what = "names files outside of the folder" if wrong else "lacks files"
        raise DataError(f"{folder}: {what}: {', '.join(wrong or missing)}")
    return case, read_json(folder / "report.json")


def _model_again(
    folder: Path, case: Mapping[str, Any], given: str, records: Sequence[Record]
) -> tuple[Model, tuple[Effect, ...]]:
    """Model and candidates of a case, with the stored priors."""
    loaded = _loaded(folder, case["model"], given)
    base = loaded.model
    pool = {e.name: e for e in loaded.with_records(records).effects}
    wanted = [c["name"] for c in case["candidates"]]
    shapes = {i["effect"]: _read(i["shape"]) for i in case["model"]["included"]}
    if {*wanted, *shapes} - pool.keys():
        ready = ready_records(base, records)
        pool = {e.name: e for e in chosen_effects(ready.model, ready.records, None, ())[0]} | pool
    if missing := [n for n in (*wanted, *shapes) if n not in pool]:
        raise InvalidParameter(
            f"{folder}: no effect {', '.join(missing)} is known for the model {base.name}; let a "
            "Python file define it as one of its effects, and name the file by --model (in Python "
            "model=)"
        )
    model = base
    if shapes:
        model = including(base, [Candidate(pool[n], s) for n, s in shapes.items()])
    priors = {p.name: p for p in map(_read, case["model"]["parameters"])}
    own = {p.name: p for p in model.parameters}
    if own.keys() != priors.keys():
        raise InvalidParameter(
            f"{folder}: the model {base.name} has the parameters {', '.join(own) or 'none'}, the "
            f"case {', '.join(priors) or 'none'}: expected the same ones"
        )
    if other := {n: p for n, p in priors.items() if p != own[n]}:
        model = model.with_parameters(other)
    numbers = ({k: _read(v) for k, v in c.items() if k in OF_EFFECT} for c in case["candidates"])
    return model, tuple(replace(pool[n], **v) for n, v in zip(wanted, numbers, strict=True))


def _loaded(folder: Path, stored: Mapping[str, Any], given: str) -> LoadedModel:
    """The model as it was made, from its copy or from what is given instead."""
    from unmodeled.fit import fmu, mujoco

    kind, file = stored["made_by"], stored["file"]
    included = [i["effect"] for i in stored["included"]]
    parameters = [p for p in map(_read, stored["parameters"]) if p.name not in included]
    name = given or (str(folder / file) if file else "")
    name += f":{stored['object']}" if file and not given and stored["object"] else ""
    name = name or stored["object"]
    if not name:
        raise InvalidParameter(
            f"{folder}: its model {stored['name']} is not stored, because no file holds it; name "
            "one by --model FILE.py:NAME (in Python model=)"
        )
    arguments = _read(stored["arguments"])
    if kind in ("fmu", "mujoco") and not _split(name)[1]:
        make = fmu if kind == "fmu" else mujoco
        return LoadedModel(make(name, parameters=parameters, **arguments), default=True)
    loaded = load_model(name, **(arguments if kind == "load_model" else {}))
    if kind == "Simulator" and isinstance(loaded.model, Simulator):
        return replace(
            loaded, model=Simulator(loaded.model._function, parameters=parameters, **arguments)
        )
    return loaded


def _notes(case: Mapping[str, Any], stored: Mapping[str, Any], report: Result) -> Iterator[str]:
    """Why answers may differ."""
    before, now = case["made_with"], _versions()
    for name in sorted({*before, *now} - {"code"}):
        if before.get(name) != now.get(name):
            yield f"{name} {before.get(name, 'none')} in the case, {now.get(name, 'none')} here"
    if before.get("unmodeled") == now["unmodeled"] and before.get("code") != now["code"]:
        yield "unmodeled has another code than that of the case, with the same version"
    if not (report.complete and stored.get("complete", True)):
        which = "the repeated" if stored.get("complete", True) else "the stored"
        yield f"{which} search ended at its limit of time: answers then depend on the processor"


def _compared(stored: Mapping[str, Any], again: Mapping[str, Any]) -> Iterator[Repeated]:
    """The numbers of two answers, in the order of a report."""
    yield _text_row("verdict", stored["verdict"], again["verdict"])
    for what, key in (("named causes", "named"), ("classes", "classes")):
        yield _text_row(what, *(_causes(r[key]) for r in (stored, again)))
    groups = (
        ("", "named", "cause", "magnitude"),
        ("parameter ", "parameters", "name", "value"),
    )
    for lead, table, key, value in groups:
        one, other = ({x[key]: x for x in _listed(r, table)} for r in (stored, again))
        for name in dict.fromkeys([*one, *other]):
            pair = one.get(name), other.get(name)
            known = [p for p in pair if p is not None]
            width = max(_number(p["high"]) - _number(p["low"]) for p in known)
            for what in (value, "low", "high"):
                values = [None if p is None else _number(p[what]) for p in pair]
                title = f"{lead}{name}{'' if what == value else f', {what}'}"
                yield _number_row(title, known[0]["unit"], values, OF_INTERVAL * width)
            if table == "named":
                values = [None if p is None else _number(p["probability"]) for p in pair]
                yield _number_row(f"{name}, probability", "1", values, OF_PROBABILITY)
    one, other = ({c["name"]: c for c in r["channels"]} for r in (stored, again))
    for name in dict.fromkeys([*one, *other]):
        pair = one.get(name), other.get(name)
        unit = next(p["unit"] for p in pair if p is not None)
        for what in ("tabulated", "calibrated", "explained", "noise"):
            values = [None if p is None else _number(p[what]) for p in pair]
            yield _number_row(f"residual of {name}, {what}", unit, values, 0.0)
    values = [_number(r["nothing"]) for r in (stored, again)]
    yield _number_row("no cause is missing, probability", "1", values, OF_PROBABILITY)
    gains = [None if (g := r["held_out_gain"]) is None else _number(g[0]) for r in (stored, again)]
    yield _number_row("held-out residual with the causes, share", "1", gains, OF_PROBABILITY)


def _listed(answer: Mapping[str, Any], table: str) -> list[dict[str, Any]]:
    """Rows of a table of an answer; those of classes are told beside the named causes."""
    more = [n for group in answer["classes"] for n in group] if table == "named" else []
    return [*answer[table], *more]


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)


def _causes(found: Sequence[Any]) -> str:
    names = [f"({_causes(n)})" if isinstance(n, list) else n["cause"] for n in found]
    return ", ".join(sorted(names)) or "none"


def _text_row(what: str, one: str, other: str) -> Repeated:
    return Repeated(what, "1", one, other, one == other)


def _number_row(what: str, unit: str, values: Sequence[float | None], permitted: float) -> Repeated:
    one, other = values
    if one is None or other is None:
        return Repeated(what, unit, one, other, one is other)
    same = one == other or (math.isnan(one) and math.isnan(other))
    permitted = (permitted if math.isfinite(permitted) else 0.0) + OF_VALUE * max(
        abs(one), abs(other)
    )
    return Repeated(what, unit, one, other, same or abs(one - other) <= permitted)
