"""A diagnosis that somebody else stored is repeated, and the answers are compared."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from unmodeled.arguments import checked
from unmodeled.data import Record, read_record
from unmodeled.diagnosis import diagnose
from unmodeled.errors import DataError, InvalidParameter
from unmodeled.files import is_file, read_json
from unmodeled.fit import fmu, mujoco
from unmodeled.fit.inclusion import including
from unmodeled.fit.model import Candidate, Effect, Model
from unmodeled.fit.simulator import Simulator
from unmodeled.library.defaults import chosen_effects
from unmodeled.loading import LoadedModel, load_model
from unmodeled.report.case import (
    FORMAT,
    OF_EFFECT,
    VERSION,
    as_made,
    file_and_name,
    sha256_of,
    versions,
)
from unmodeled.search.options import Options
from unmodeled.search.progress import Progress
from unmodeled.search.records import ready_records
from unmodeled.search.result import Result

#: Two numbers agree if they differ by less than this share of their 95 % interval, or of the
#: larger one: far below what an answer means, and above the rounding of other processors.
OF_INTERVAL, OF_VALUE = 0.02, 1e-3
#: Probabilities agree if they differ by less than this [1].
OF_PROBABILITY = 0.01


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
    progress: Callable[[Progress], None] | None = None,
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
    progress
        As for :func:`unmodeled.diagnose`.

    Raises
    ------
    DataError
        The folder holds no case, or a file of it is missing.
    InvalidParameter
        The model is not stored and not given, or it does not have the parameters or the candidates
        of the case.
    """
    folder = Path(folder)
    case, stored = _opened(folder)
    rows = [
        Repeated(f"file {name}", "1", "the stored hash", "changed", agrees=False)
        for name, digest in case["sha256"].items()
        if sha256_of(folder / name) != digest
    ]
    records = tuple(
        read_record(folder / r["file"], inputs=r["inputs"], outputs=r["outputs"])
        for r in case["records"]
    )
    loaded, effects = _model_again(folder, case, model, records)
    options = Options(**as_made(case["options"]))
    report = diagnose(
        loaded,
        effects,
        records,
        hold_out=as_made(case["hold_out"]),
        options=options if seconds is None else replace(options, seconds=seconds),
        progress=progress,
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
    shapes = {i["effect"]: as_made(i["shape"]) for i in case["model"]["included"]}
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
    priors = {p.name: p for p in map(as_made, case["model"]["parameters"])}
    own = {p.name: p for p in model.parameters}
    if own.keys() != priors.keys():
        raise InvalidParameter(
            f"{folder}: the model {base.name} has the parameters {', '.join(own) or 'none'}, the "
            f"case {', '.join(priors) or 'none'}: expected the same ones"
        )
    if other := {n: p for n, p in priors.items() if p != own[n]}:
        model = model.with_parameters(other)
    numbers = ({k: as_made(v) for k, v in c.items() if k in OF_EFFECT} for c in case["candidates"])
    return model, tuple(replace(pool[n], **v) for n, v in zip(wanted, numbers, strict=True))


def _loaded(folder: Path, stored: Mapping[str, Any], given: str) -> LoadedModel:
    """The model as it was made, from its copy or from what is given instead."""
    kind, file = stored["made_by"], stored["file"]
    included = [i["effect"] for i in stored["included"]]
    parameters = [p for p in map(as_made, stored["parameters"]) if p.name not in included]
    name = given or (str(folder / file) if file else "")
    name += f":{stored['object']}" if file and not given and stored["object"] else ""
    name = name or stored["object"]
    if not name:
        raise InvalidParameter(
            f"{folder}: its model {stored['name']} is not stored, because no file holds it; name "
            "one by --model FILE.py:NAME (in Python model=)"
        )
    arguments = as_made(stored["arguments"])
    if kind in ("fmu", "mujoco") and not file_and_name(name)[1]:
        make = fmu if kind == "fmu" else mujoco
        return LoadedModel(make(name, parameters=parameters, **arguments), default=True)
    loaded = load_model(name, **(arguments if kind == "load_model" else {}))
    if kind == "Simulator" and isinstance(loaded.model, Simulator):
        return replace(
            loaded, model=Simulator(loaded.model.function, parameters=parameters, **arguments)
        )
    return loaded


def _notes(case: Mapping[str, Any], stored: Mapping[str, Any], report: Result) -> Iterator[str]:
    """Why answers may differ."""
    before, now = case["made_with"], versions()
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
